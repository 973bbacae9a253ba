"""Scene, and the random scenes: no overlap, exact packing and temperature, no drift, the same for the same seed."""

import math

import numpy as np
import pytest
from support.compare import overlapping_pairs
from support.scenes import gas, simulate

import mpsim

ROOM = {"width": 60.0, "height": 60.0, "position": np.zeros((0, 2)), "velocity": np.zeros((0, 2)), "radius": 0.25}


def test_a_scene_may_say_how_long_it_should_run(tmp_path):
    scene = mpsim.Scene.random(count=5, packing=0.1, radius=0.5, duration=20)
    assert scene.duration == 20.0
    assert scene.starting_from(mpsim.State(scene.position, -scene.velocity)).duration == 20.0
    scene.save(tmp_path / "scene.toml")
    assert mpsim.Scene.load(tmp_path / "scene.toml").duration == 20.0
    with simulate(scene) as sim:
        path = sim.save(tmp_path / "run")
    with mpsim.Simulation.resume(path) as sim:
        assert sim.scene.duration == 20.0
    without = mpsim.Scene.random(count=5, packing=0.1, radius=0.5)
    assert without.duration is None
    assert without.digest() == scene.digest(), "no bit of a run depends on it"


@pytest.mark.parametrize("duration", [0, -1, float("nan"), float("inf"), "long", True])
def test_a_duration_must_be_a_time(duration):
    with pytest.raises(mpsim.InputError, match=r"duration must be a (finite )?number > 0 \[time\]; got"):
        mpsim.Scene(**ROOM, duration=duration)


def test_a_scene_keeps_read_only_copies():
    position = np.array([[2.0, 2.0], [4.0, 3.0]])
    scene = mpsim.Scene(width=8, height=6, position=position, velocity=np.zeros((2, 2)), radius=0.5)
    position[0] = 0
    assert scene.position[0].tolist() == [2, 2]
    for array in (scene.position, scene.velocity):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
    assert scene.packing == pytest.approx(2 * math.pi * 0.25 / 48)
    assert (scene.gravity, scene.acceleration) == (None, None)


def test_discs_may_touch_walls_and_each_other():
    scene = mpsim.Scene(width=2, height=1, position=[[0.5, 0.5], [1.5, 0.5]], velocity=np.zeros((2, 2)), radius=0.5)
    assert scene.count == 2


def test_a_disc_beyond_the_wall_by_rounding_is_allowed_and_by_more_is_not():
    places = [[0.3 * (1 - 1e-16), 0.3]]
    mpsim.Scene(width=3, height=3, position=places, velocity=[[0, 0]], radius=0.3)
    with pytest.raises(mpsim.InputError, match=r"position\[0\] must lie"):
        mpsim.Scene(width=3, height=3, position=[[0.3 - 1e-9, 0.3]], velocity=[[0, 0]], radius=0.3)


def test_the_text_of_a_scene_names_what_it_has():
    assert repr(gas(20, 0.2)) == "<Scene: 20 discs of radius 0.5 in 8.86227 x 8.86227, packing 0.2>"
    assert repr(gas(20, 0.2, gravity=(0, -1))).endswith("packing 0.2, gravity>")
    nobody = mpsim.Scene(width=3, height=3, position=np.zeros((0, 2)), velocity=np.zeros((0, 2)), radius=np.zeros(0))
    assert repr(nobody) == "<Scene: 0 discs in 3 x 3, packing 0>"


@pytest.mark.parametrize("packing", [0.001, 0.1, 0.3, 0.4, 0.41, 0.5, 0.6, 0.7, 0.75, 0.8])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_random_scene_has_no_overlap_and_exactly_the_packing_asked_for(packing, seed):
    scene = mpsim.Scene.random(count=3000, packing=packing, radius=0.25, seed=seed)
    assert scene.packing == pytest.approx(packing, rel=1e-12)
    i, j, distance = overlapping_pairs(scene.position, 0.5)
    assert not len(i), f"seed {seed}: discs {i[0]} and {j[0]} overlap by {0.5 - distance[0]:.3g}"


@pytest.mark.parametrize("size", [(30, 3), (3, 30), (200, 1.05), (7.7, 9.1)])
def test_a_random_scene_fits_boxes_of_any_shape(size):
    count = int(0.5 * size[0] * size[1] / (math.pi / 4))
    scene = mpsim.Scene.random(count=count, width=size[0], height=size[1], radius=0.5, seed=3)
    assert (scene.width, scene.height, scene.count) == (*size, count)
    assert not len(overlapping_pairs(scene.position, 1.0)[0])


@pytest.mark.parametrize("count", [2, 3, 10, 5000])
@pytest.mark.parametrize("temperature", [1.0, 0.01, 2.5, 0.0])
def test_a_random_scene_has_exactly_the_temperature_asked_for_and_no_drift(count, temperature):
    scene = mpsim.Scene.random(count=count, packing=0.2, radius=0.5, temperature=temperature, seed=4)
    assert (scene.velocity**2).mean() == pytest.approx(temperature, rel=1e-12)
    assert np.abs(scene.velocity.sum(axis=0)).max() <= 1e-12 * count * math.sqrt(temperature)


def test_one_random_disc_and_none_are_scenes_too():
    one = mpsim.Scene.random(count=1, packing=0.5, radius=0.5, seed=5)
    assert np.isfinite(one.velocity).all()
    assert mpsim.Scene.random(count=1, packing=0.78, radius=0.5, seed=5).position.tolist() != []
    none = mpsim.Scene.random(count=0, packing=0.5, radius=0.5)
    assert (none.count, none.width, none.height) == (0, 1, 1)


@pytest.mark.parametrize("packing", [0.2, 0.6])
def test_the_same_seed_gives_the_same_scene_and_another_seed_another(packing):
    one, again, other = (mpsim.Scene.random(count=200, packing=packing, radius=0.5, seed=s) for s in (6, 6, 7))
    assert one.position.tobytes() == again.position.tobytes()
    assert one.velocity.tobytes() == again.velocity.tobytes()
    assert one.position.tobytes() != other.position.tobytes()
    assert one.velocity.tobytes() != other.velocity.tobytes()


def test_the_random_numbers_of_the_user_are_left_alone():
    state = np.random.get_state()[1].tobytes()  # noqa: NPY002
    mpsim.Scene.random(count=100, packing=0.6, radius=0.5, seed=8)
    assert np.random.get_state()[1].tobytes() == state  # noqa: NPY002


def test_a_dense_random_scene_is_no_lattice():
    """Monte Carlo moves have shuffled it: distances to the nearest neighbour scatter, rows are not straight."""
    scene = mpsim.Scene.random(count=2000, packing=0.6, radius=0.5, seed=9)
    rows = np.unique(np.round(scene.position[:, 1], 3))
    assert len(rows) > 1500


def test_neighbours_in_space_are_not_neighbours_in_number():
    """Discs are numbered at random, so that the order of contacts is not that of a lattice."""
    scene = mpsim.Scene.random(count=2000, packing=0.6, radius=0.5, seed=10)
    steps = np.hypot(*np.diff(scene.position, axis=0).T)
    assert np.median(steps) > scene.width / 4


def test_features_of_a_random_scene_are_passed_on():
    scene = mpsim.Scene.random(count=3, packing=0.2, radius=0.5, gravity=(0, -1), acceleration=np.ones((3, 2)))
    assert scene.gravity.tolist() == [0, -1]
    assert scene.acceleration.shape == (3, 2)
    with pytest.raises(TypeError, match="colour"):
        mpsim.Scene.random(count=3, packing=0.2, radius=0.5, colour="red")


def test_overlapping_discs_are_reported_with_the_worst_pair():
    position = [[2, 2], [2.9, 2], [5, 5], [6, 6], [5.25, 5]]
    scene = mpsim.Scene(width=9, height=9, position=position, velocity=np.zeros((5, 2)), radius=0.5)
    with pytest.warns(mpsim.OverlapWarning, match=r"2 pairs of discs overlap.*discs 2 and 4 deepest, by 0.75"):
        sim = mpsim.Simulation(scene, mpsim.Settings(method="grid"))
    sim.close()


def test_discs_at_one_point_are_an_overlap_of_a_whole_diameter():
    scene = mpsim.Scene(width=9, height=9, position=[[2, 2], [2, 2]], velocity=np.zeros((2, 2)), radius=0.5)
    with pytest.warns(mpsim.OverlapWarning, match="1 pair of discs overlaps at the start: discs 0 and 1, by 1"):
        sim = mpsim.Simulation(scene, mpsim.Settings(method="grid"))
    sim.close()


def test_touching_discs_are_no_overlap():
    """Rounding of the coordinates does not count. (Warnings are errors in these tests.)"""
    place = np.stack(np.divmod(np.arange(100), 10), axis=1) * 0.6 + 0.3
    scene = mpsim.Scene(width=6, height=6, position=place, velocity=np.zeros((100, 2)), radius=0.3)
    with mpsim.Simulation(scene, mpsim.Settings(method="grid")) as sim:
        assert sim.count == 100


def test_the_warning_points_at_the_users_line():
    scene = mpsim.Scene(width=9, height=9, position=[[2, 2], [2, 2]], velocity=np.zeros((2, 2)), radius=0.5)
    with pytest.warns(mpsim.OverlapWarning) as caught:
        mpsim.Simulation(scene, mpsim.Settings(method="grid")).close()
    assert caught[0].filename == __file__


@pytest.mark.parametrize("radius", [1e200, [1.0, 1e200], 1e-200, 5e-324])
@pytest.mark.parametrize("box", [{"packing": 0.5}, {"width": 3e200, "height": 3e200}])
def test_radii_whose_areas_float64_cannot_hold_are_refused(radius, box):
    """They ended in an OverflowError, a warning of NumPy, a division by zero, or a box of the wrong size."""
    with pytest.raises(mpsim.InputError, match=r"radius must be from 1e-140 to 1e\+140, so that areas fit float64"):
        mpsim.Scene.random(count=2, radius=radius, **box)


@pytest.mark.parametrize("radius", [1e139, 1e-139])
def test_packing_is_a_ratio_at_any_scale(radius):
    assert mpsim.Scene.random(count=20, radius=radius, packing=0.3).packing == pytest.approx(0.3)


def test_velocities_of_very_light_discs_have_their_temperature():
    """Their squares are beyond float64; they came out as 0, with a warning of NumPy."""
    scene = mpsim.Scene.random(count=20, packing=0.1, radius=0.5, mass=1e-307, temperature=2.0, seed=1)
    assert ((np.sqrt(scene.masses)[:, None] * scene.velocity) ** 2).mean() == pytest.approx(2.0)
