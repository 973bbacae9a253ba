"""Discs on a lattice: any range is the slice of the whole, none overlap, temperature and momentum are exact."""

import pickle
import tracemalloc

import numpy as np
import pytest
from support.compare import overlapping_pairs
from support.refusals import assert_says

import mpsim
from mpsim import Piston, Scene
from mpsim.scene.lattice import BLOCK, Lattice

COUNTS = [0, 1, 2, 3, 4095, 4096, 4097, 4098, 10_000]
BOUNDARIES = ["walls", "periodic", ("periodic", "walls"), ("walls", "periodic")]


def lattice(count=1000, packing=0.5, **others):
    """Discs of radius 0.5."""
    return Scene.lattice(**{"count": count, "radius": 0.5, "packing": packing, "seed": 3} | others)


def densest(count, boundary):
    """The scene of so many discs at the largest packing at which they have room, by bisection."""
    low, high = 0.0, 1.0
    for _ in range(40):
        middle = (low + high) / 2
        try:
            lattice(count, middle, boundary=boundary)
        except mpsim.InputError:
            high = middle
        else:
            low = middle
    return lattice(count, low, boundary=boundary)


def given(scene):
    """The scene of the same arrays."""
    return Scene(
        width=scene.width, height=scene.height, position=scene.position, velocity=scene.velocity, radius=scene.radius,
        boundary=scene.boundary,
    )  # fmt: skip


@pytest.mark.parametrize("count", COUNTS)
def test_any_range_is_the_slice_of_the_whole(count):
    scene, rng = lattice(count, 0.3), np.random.default_rng(count)
    ends = {0, count, count // 2, *(min(count, each) for each in (1, BLOCK - 1, BLOCK, BLOCK + 1))}
    ranges = [(first, last) for first in ends for last in ends if first <= last]
    ranges += [tuple(sorted(rng.integers(0, count + 1, 2).tolist())) for _ in range(20)]
    for first, last in ranges:
        position, velocity = scene.rows(first, last)
        assert position.tobytes() == scene.position[first:last].tobytes(), (first, last)
        assert velocity.tobytes() == scene.velocity[first:last].tobytes(), (first, last)
        assert position.shape == velocity.shape == (last - first, 2)


@pytest.mark.parametrize("count", COUNTS)
def test_pieces_are_all_discs_one_after_the_other(count):
    pieces = list(lattice(count, 0.3).pieces())
    assert (pieces[0][0], pieces[-1][1]) == (0, count)
    assert [last for _, last in pieces[:-1]] == [first for first, _ in pieces[1:]]


@pytest.mark.parametrize("boundary", BOUNDARIES, ids=str)
@pytest.mark.parametrize("count", [1, 2, 3, 50, 3000])
def test_no_discs_overlap_even_where_they_are_densest(count, boundary):
    """Through borders too, as `overlaps_at_start` of the arrays tells, which also looks whether they are in the box."""
    for scene in (lattice(count, 0.05, boundary=boundary), densest(count, boundary)):
        assert given(scene).overlaps_at_start() == scene.overlaps_at_start() == ""
        assert not len(overlapping_pairs(scene.position, 2 * 0.5 * (1 - 1e-12))[0])


def test_large_boxes_hold_nearly_what_a_plane_holds():
    assert densest(100_000, "walls").packing > 0.902
    assert densest(100_000, "periodic").packing > 0.902


@pytest.mark.parametrize("size", [(200.0, 1.1), (1.1, 200.0), (50.0, 20.0), (1e6, 1e6), (1e3, 1.0)])
def test_boxes_of_any_shape_are_filled(size):
    scene = Scene.lattice(count=40, width=size[0], height=size[1], radius=0.5)
    assert given(scene).overlaps_at_start() == ""
    longer = int(np.argmax(size))
    assert np.ptp(scene.position[:, longer]) > 0.8 * (size[longer] - 1), "as far as the box goes"


def test_discs_that_follow_each_other_are_a_strip():
    scene = lattice(20_000)
    for first in range(0, 20_000, 1000):
        x = scene.rows(first, first + 1000)[0][:, 0]
        assert np.ptp(x) < 0.1 * scene.width
        assert abs(x.mean() / scene.width - (first + 500) / 20_000) < 0.01


def test_discs_are_moved_from_their_sites():
    scene = lattice(20_000)
    steps = np.diff(scene.position[:100, 1])
    assert len(np.unique(steps.round(6))) == 99, "no step is another"
    assert (np.abs(scene.position - lattice(20_000, seed=4).position).max(axis=0) > 0.05).all()


@pytest.mark.parametrize("count", [2, 3, 4095, 4097, 10_000])
@pytest.mark.parametrize("temperature", [1.0, 0.01, 2.5, 0.0])
def test_temperature_and_momentum_are_exact(count, temperature):
    scene = lattice(count, 0.2, temperature=temperature)
    assert (scene.velocity**2).mean() == pytest.approx(temperature, rel=1e-12)
    assert np.abs(scene.velocity.sum(axis=0)).max() <= 1e-12 * count * temperature**0.5


def test_velocities_are_normal_and_independent():
    """Moments and correlations of 200,000 discs, of which one in 1,000 seeds would be off by so much."""
    v = lattice(200_000).velocity
    error = 1 / np.sqrt(len(v))
    assert np.abs((v**3).mean(axis=0)).max() < 4 * np.sqrt(15) * error
    assert np.abs((v**4).mean(axis=0) - 3).max() < 4 * np.sqrt(96) * error
    assert abs((v[:, 0] * v[:, 1]).mean()) < 4 * error
    assert np.abs((v[1:] * v[:-1]).mean(axis=0)).max() < 4 * error
    assert np.abs((v[BLOCK:] * v[:-BLOCK]).mean(axis=0)).max() < 4 * error, "blocks have numbers of their own"


def test_seeds_make_other_discs_and_the_same_seed_the_same():
    one, same, other = lattice(seed=5), lattice(seed=5), lattice(seed=6)
    assert one.digest() == same.digest() != other.digest()
    again = one.redrawn(2)
    assert again.on_lattice is not None
    assert again.digest() == one.redrawn(2).digest() != one.digest()
    assert (again.packing, again.count) == (one.packing, one.count)


def test_an_eighth_takes_the_memory_of_an_eighth():
    scene, count = lattice(2_000_000), 250_000
    scene.rows(0, 1)
    tracemalloc.start()
    rows = scene.rows(3 * count, 4 * count)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    size = sum(array.nbytes for array in rows)
    assert size <= peak < 1.25 * size


@pytest.mark.parametrize("boundary", BOUNDARIES, ids=str)
def test_the_scene_of_the_same_arrays_has_the_same_digest(boundary):
    scene = lattice(70_000, boundary=boundary, gravity=(0, -1))
    arrays = Scene(
        width=scene.width, height=scene.height, position=scene.position, velocity=scene.velocity, radius=0.5,
        boundary=boundary, gravity=(0, -1),
    )  # fmt: skip
    assert arrays.digest() == scene.digest() != given(scene).digest()


def test_a_pickle_holds_the_numbers_not_the_arrays():
    scene = lattice(100_000)
    assert scene.position is scene.position, "kept"
    assert not scene.position.flags.writeable
    sent = pickle.dumps(scene)
    assert len(sent) < 1000
    assert pickle.loads(sent).digest() == scene.digest()


def test_a_saved_scene_is_the_same(tmp_path):
    lattice(100).save(tmp_path / "scene.toml")
    assert Scene.load(tmp_path / "scene.toml").digest() == lattice(100).digest()


def test_a_scene_that_goes_on_from_a_state_has_arrays():
    scene = lattice(100)
    with mpsim.Simulation(scene, mpsim.Settings(dt=0.01, method="naive")) as sim:
        sim.run(frames=2)
        state = sim.state
    there = scene.starting_from(state)
    assert there.on_lattice is None
    assert there.position.tolist() == state.position.tolist()
    assert scene.on_lattice is not None, "the scene itself is as it was"


def test_features_are_passed_on():
    acceleration = np.ones((10, 2))
    scene = lattice(
        10, 0.2, gravity=(0, -1), acceleration=acceleration, restitution=0.9, duration=3.0, absorbing="top",
        piston=Piston("left", 0.1, 1.0), friction=0.5, spin=np.arange(10.0),
    )  # fmt: skip
    assert (scene.restitution, scene.duration, scene.absorbing) == (0.9, 3.0, ("top",))
    assert scene.acceleration.shape == (10, 2)
    assert scene.spin.tolist() == list(range(10))
    with pytest.raises(TypeError, match="colour"):
        lattice(10, colour="red")


BAD = {
    "count below 0": ({"count": -1}, ["count must be a whole number from 0 to 100000000", "got -1"]),
    "count absurd": ({"count": 10**12}, ["count must be a whole number from 0 to 100000000"]),
    "seed below 0": ({"seed": -1}, ["seed must be a whole number", "got -1"]),
    "temperature": ({"temperature": -1}, ["temperature must be a finite number >= 0", "got -1"]),
    "radius 0": ({"radius": 0}, ["radius must be a finite number > 0", "got 0"]),
    "radii": ({"radius": [0.5] * 10}, ["radius of discs on a lattice must be one number", "(10,)", "Scene.random"]),
    "mass": ({"mass": [2.0] * 10}, ["mass must be left out", "mass 1 each", "Scene.random"]),
    "obstacles": (
        {"obstacles": [mpsim.FixedDisc((1, 1), 0.1)]},
        ["obstacles must be left out", "fills the box", "Scene.random"],
    ),
    "an obstacle": ({"obstacles": mpsim.FixedDisc((1, 1), 0.1)}, ["obstacles must be left out"]),
    "packing": ({"packing": 0.95}, ["packing must leave room", "at most", "got 10", "below 0.95"]),
    "a small box": (
        {"packing": None, "width": 3, "height": 3},
        ["count must leave room", "at most 6 discs of radius 0.5 in a box of 3 x 3", "got 10", "larger box"],
    ),
    "no box": ({"packing": None}, ["the box must be given either by packing or by width and height"]),
    "a piston inside": (
        {"packing": None, "width": 30, "height": 30, "piston": Piston("left", 0.1, 2.0, start=1.0)},
        ["start of the piston must be its wall", "got 1", "Leave it out"],
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_lattice_is_refused(case):
    change, parts = BAD[case]
    with pytest.raises(mpsim.InputError) as caught:
        lattice(**{"count": 10} | change)
    assert_says(caught, parts)


def test_blocks_are_of_nearly_equal_sizes():
    """So that none has a single disc, whose velocity would have to be 0."""
    for count in (*COUNTS, 3 * BLOCK + 1):
        start = Lattice(count, 0.5, 1e4, 1e4, (False, False), 1.0, 0)
        ends = [start._first_of(block) for block in range(start._blocks + 1)]
        sizes = np.diff(ends)
        assert (ends[0], ends[-1]) == (0, count)
        assert sizes.max() - sizes.min() <= 1
        assert sizes.max() <= BLOCK
        assert sizes.min() > 1 or count < 2
