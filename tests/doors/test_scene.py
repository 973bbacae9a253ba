"""Scenes: given, at random, on a lattice, compressed, from a state; what they recommend, and what is refused."""

import copy
import hashlib
import math
import pickle
import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from support.compare import overlapping_pairs
from support.refusals import GOOD, assert_refused
from support.scenes import after, box_of, gas, lattice, scene_of

import mpsim
from mpsim import (
    Emitter,
    FixedDisc,
    InputError,
    Oscillation,
    Path,
    Piston,
    Polyline,
    Rotation,
    Scene,
    Settings,
    State,
    Translation,
)

pytestmark = pytest.mark.plain

NAN = math.nan


# --- what is refused

SCENES = {
    "nan in position": ({"position": [[2, 2], [4, NAN]]}, ["position must be finite", "position[1, 1] is nan"]),
    "by more than rounding": ({"position": [[0.5 - 1e-9, 3], [4, 3]]}, ["position[0] must lie in"]),
    "radius of another shape": ({"radius": [0.5] * 3}, ["radius must have shape () or (2,)", "(3,)"]),
    "a large disc by the wall": ({"radius": [2.5, 0.5]}, ["position[0] must lie in [2.5, 5.5] x [2.5, 3.5]"]),
    "too large for a periodic axis": ({"radius": [0.5, 1.6], "boundary": ("walls", "periodic")},
                                      ["at most a quarter of a periodic axis, 1.5 here", "1.6", "larger box"]),
    "height missing": ({"height": None}, ["height must be a finite number > 0", "got None"]),
    "an unknown boundary": ({"boundary": "perodic"}, ["boundary must be one of", "Did you mean 'periodic'?"]),
    "beyond a periodic edge": ({"boundary": "periodic", "position": [[2, 2], [8.5, 3]]},
                               ["position[1] must lie in [0, 8] x [0, 6]", "(8.5, 3.0)"]),
    "an obstacle outside": ({"obstacles": FixedDisc((9, 1), 1)}, ["obstacles[0] must lie in the box", "(9.0, 1.0)"]),
    "an unknown edge": ({"absorbing": "botom"}, ["absorbing must be one of", "Did you mean 'bottom'?"]),
    "a periodic edge that absorbs": ({"absorbing": "left", "boundary": ("periodic", "walls")},
                                     ["absorbing must name a wall", "'left'", "periodic along x", "another edge"]),
    "a piston on a periodic axis": ({"piston": Piston("top", -1, 3), "boundary": ("walls", "periodic")},
                                    ["piston must name a wall", "'top'", "periodic along y"]),
    "an absorbing piston": ({"piston": Piston("top", -1, 3), "absorbing": "top"},
                            ["piston must not be an absorbing edge", "'top'", "Choose one"]),
    "a piston that stops outside": ({"piston": Piston("left", 1, 9)}, ["stop of the piston", "(0, 8)", "9"]),
    "a piston that leaves no room": ({"piston": Piston("left", 1, 7.5)}, ["room for the largest disc", "0.5"]),
    "a start outside": ({"piston": Piston("right", -1, 3, start=11)}, ["start of the piston must lie in the box"]),
    "a piston that leaves the box": ({"piston": Piston("left", motion=Oscillation((0.5, 0), 1))},
                                     ["the motion of the piston must keep the left wall in the box", "[-0.5, 0.5]"]),
    "a piston without an end": ({"piston": Piston("left", motion=Translation((0.5, 0)))}, ["[0, 8]; got [0, inf]"]),
    "a motion that leaves no room": ({"piston": Piston("left", motion=Translation((1, 0), 7.5))},
                                     ["motion of the piston must leave room for the largest disc", "got 7.5"]),
    "a wall that runs without friction": ({"piston": Piston("top", surface_velocity=1)}, ["wall_friction", "got 1"]),
    "two of one wall": ({"piston": [Piston("top", -1, 4), Piston("left", 1, 1), Piston("top", -1, 5)]},
                        ["at most one Piston for each wall; got more for 'top'", "Leave one"]),
    "two that meet": ({"piston": [Piston("top", -1, 2), Piston("bottom", 1, 2)]},
                      ["stop of the top piston must leave room for the largest disc"]),
    "no piston": ({"piston": ["left"]}, ["piston must be an mpsim.Piston, or a list of them; got str"]),
    "a disc behind the piston": ({"piston": Piston("right", -1, 3, start=4)}, ["position[1] must lie in [0.5, 3.5]"]),
    "pictures": ({"picture_interval": 0}, ["picture_interval must be a finite number > 0 [time]; got 0"]),
    "a measure": ({"measures": ["presure"]}, ["measures must be one of", "got 'presure'. Did you mean 'pressure'?"]),
}  # fmt: skip

RANDOM = {
    "packing 40": ({"packing": 40}, ["packing must be a fraction of the area; got 40. 40 % is 0.4."]),
    "neither": ({"packing": None}, ["the box must be given either by packing or by width and height", "packing=None"]),
    "walls in the way": ({"packing": None, "width": 2.5, "height": 1.9, "count": 4},
                         ["4 discs of radius 0.5 do not fit", "is needed", "larger box"]),
    "sizes in the way": ({"count": 4, "radius": [0.5, 0.5, 0.5, 0.4], "packing": 0.79}, ["4 discs of packing 0.79"]),
    "areas": ({"radius": 1e200}, ["radius must be from 1e-140 to 1e+140, so that areas fit float64"]),
}  # fmt: skip

LATTICE = {
    "radii": ({"radius": [0.5] * 10}, ["radius of discs on a lattice must be one number", "(10,)", "Scene.random"]),
    "mass": ({"mass": [2.0] * 10}, ["mass must be left out", "mass 1 each", "Scene.random"]),
    "obstacles": ({"obstacles": FixedDisc((1, 1), 0.1)}, ["obstacles must be left out", "fills the box"]),
    "packing": ({"packing": 0.95}, ["packing must leave room", "at most", "got 10", "below 0.95"]),
    "a small box": ({"packing": None, "width": 3, "height": 3},
                    ["count must leave room", "at most 6 discs of radius 0.5 in a box of 3 x 3", "got 10"]),
    "a piston inside": ({"packing": None, "width": 30, "height": 30, "piston": Piston("left", 0.1, 2.0, start=1.0)},
                        ["start of the piston must be its wall", "got 1", "Leave it out"]),
}  # fmt: skip

PARTS = {
    "a peg without a radius": (lambda: FixedDisc((1, 1), 0), ["radius of a FixedDisc", "> 0"]),
    "a piston that stops nowhere": (lambda: Piston("left", 1, 0), ["stop of a Piston", "> 0"]),
    "speed and motion": (
        lambda: Piston("left", 1.0, motion=Translation((1, 0), 3)),
        ["a Piston must have either a speed and a stop, or a motion, or", "alone; got speed and motion"],
    ),
    "a piston at rest": (
        lambda: Piston("left"),
        ["either a speed and a stop, or a motion, or a surface_velocity alone; got none of them"],
    ),
    "a speed alone": (lambda: Piston("left", 1.0), ["either a speed and a stop, or a motion", "alone; got speed."]),
    "a piston that turns": (
        lambda: Piston("left", motion=Rotation((0, 0), 1)),
        ["motion of a Piston must not be a Rotation", "Polyline"],
    ),
    "a piston along its wall": (
        lambda: Piston("top", motion=Oscillation((0.5, 1), 1)),
        ["motion of a Piston must be along y alone", "amplitude=(0.5, 1.0)"],
    ),
    "a piston on the spot": (lambda: Piston("top", motion=Path([0, 1], [(0, 1), (0, 1)])), ["along y alone"]),
    "a period that is no number": (lambda: Piston("top", motion=Oscillation((0, 1), math.nan)), ["period", "nan"]),
    "a start beyond": (lambda: Piston("right", -1, 3, start=2), ["start of a Piston must lie at or above its stop, 3"]),
}


def few(**others):
    return Scene.random(**{"count": 9, "packing": 0.5, "radius": 0.5, "seed": 1} | others)


COMPRESSED = {
    "packing in per cent": (lambda: few().compressed(82), ["packing must be a fraction of", "82 % is 0.82."]),
    "packing below": (lambda: few().compressed(0.4), ["above that of the scene, 0.5", "got 0.4"]),
    "above, of mixtures": (lambda: few(radius=[0.5, 0.4, 0.3] * 3).compressed(0.95), ["below 0.9", "got 0.95"]),
    "no disc": (lambda: Scene(width=1, height=1, position=(), velocity=(), radius=0.1).compressed(0.5), ["discs"]),
    "at rest": (lambda: few(temperature=0).compressed(0.7), ["velocity must not be 0", "temperature"]),
    "too fast": (lambda: Scene(**GOOD | {"velocity": [[1e200, 0]] * 2}).compressed(0.7), ["below 1e+140", "1e+200"]),
    "overlap": (lambda: Scene(**GOOD | {"position": [[1, 1], [1.5, 1]]}).compressed(0.6),
                ["do not overlap", "discs 0 and 1, by 0.5", "Move them apart"]),
    "obstacles": (lambda: few(packing=0.2, obstacles=FixedDisc((2, 2), 0.1)).compressed(0.7), ["with obstacles"]),
    "emitters": (lambda: few(packing=0.2, emitters=Emitter((1, 1), (1, 0), interval=1)).compressed(0.7), ["emitters"]),
    "a periodic box too small": (lambda: few(count=4, packing=0.4, boundary="periodic").compressed(0.85),
                                 ["packing must leave the largest disc room, 2 of them", "more discs"]),
}  # fmt: skip


@pytest.mark.parametrize(
    ("make", "parts"),
    [
        *[(lambda change=change: Scene(**(GOOD | change)), parts) for change, parts in SCENES.values()],
        *[(lambda change=change: Scene.random(**{"count": 10, "radius": 0.5, "packing": 0.3} | change), parts)
          for change, parts in RANDOM.values()],
        *[(lambda change=change: Scene.lattice(**{"count": 10, "radius": 0.5, "packing": 0.3} | change), parts)
          for change, parts in LATTICE.values()],
        *PARTS.values(),
        *COMPRESSED.values(),
    ],
    ids=[
        *SCENES, *(f"random: {each}" for each in RANDOM), *(f"lattice: {each}" for each in LATTICE), *PARTS,
        *(f"compressed: {each}" for each in COMPRESSED),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_with_name_rule_value_and_remedy(make, parts):
    assert_refused(parts, make)


# --- given scenes


def test_a_scene_keeps_read_only_copies_and_refuses_assignments():
    position, radius, mass = np.array([[2.0, 2.0], [4.0, 3.0]]), np.array([0.5, 0.25]), np.array([1.0, 3.0])
    scene = Scene(**GOOD | {"position": position, "radius": radius, "mass": mass})
    position[0] = radius[0] = mass[0] = 0
    assert (scene.position[0].tolist(), scene.radius[0], scene.mass[0]) == ([2, 2], 0.5, 1)
    for array in (scene.position, scene.velocity, scene.radius, scene.mass):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
    for each in (scene, copy.deepcopy(scene), pickle.loads(pickle.dumps(scene))):
        for name in ("gravity", "position", "thermostat", "gravty"):
            with pytest.raises(InputError, match=rf"^{name} of a Scene cannot be assigned; got 3\. Make another"):
                setattr(each, name, 3)
        assert each.digest() == scene.digest()
    named = type("Named", (Scene,), {}).random(count=9, packing=0.1, radius=0.5)
    named.label = "an attribute of its own"
    with pytest.raises(InputError, match=r"gravity of a Named cannot be deleted\. Make another Scene; "):
        del named.gravity


def test_discs_may_touch_to_rounding_and_what_is_equal_for_all_counts_as_one():
    Scene(width=2, height=1, position=[[0.5, 0.5], [1.5, 0.5]], velocity=np.zeros((2, 2)), radius=0.5)
    Scene(width=3, height=3, position=[[0.3 * (1 - 1e-16), 0.3]], velocity=[[0, 0]], radius=0.3)
    same = Scene(**GOOD | {"radius": [0.5, 0.5], "mass": [1.0, 1.0]})
    assert (same.radius, same.mass, Scene(**GOOD, mass=2.0).masses.tolist()) == (0.5, None, [2, 2])
    wide = Scene(**GOOD, emitters=Emitter((4, 3), (0, 1), every=1, radius=0.75))
    assert (wide.smallest_radius, wide.largest_radius) == (0.5, 0.75)
    for empty in ([], np.empty((0, 2)), ()):
        none = Scene(width=5, height=5, position=empty, velocity=empty, radius=0.5)
        assert (none.count, none.packing, none.position.shape) == (0, 0, (0, 2))


def test_the_text_and_packing_of_a_scene_are_of_the_box_at_the_start():
    assert repr(gas(20, 0.2)) == "<Scene: 20 discs of radius 0.5 in 8.86227 x 8.86227, packing 0.2>"
    assert repr(gas(20, 0.2, gravity=(0, -1))).endswith("packing 0.2, gravity>")
    nobody = Scene(width=3, height=3, position=np.zeros((0, 2)), velocity=np.zeros((0, 2)), radius=np.zeros(0))
    assert repr(nobody) == "<Scene: 0 discs in 3 x 3, packing 0>"
    piston = Piston("right", -1, 4, start=5)
    scene = Scene(width=20, height=10, position=[[1, 1], [3, 3]], velocity=np.zeros((2, 2)), radius=0.5, piston=piston)
    assert repr(scene) == "<Scene: 2 discs of radius 0.5 in 5 x 10 of 20 x 10, packing 0.0314, piston>"
    assert repr(Piston("right", -1, 3)) == "Piston(wall='right', speed=-1.0, stop=3.0)", "digests are as before"


# --- overlaps at the start


def test_overlaps_are_told_with_the_deepest_and_the_users_line():
    still = np.zeros((5, 2))
    scene = Scene(width=9, height=9, position=[[2, 2], [2.9, 2], [5, 5], [6, 6], [5.25, 5]], velocity=still, radius=0.5)
    with pytest.warns(
        mpsim.OverlapWarning, match=r"2 pairs of discs overlap.*discs 2 and 4 deepest, by 0.75"
    ) as caught:
        mpsim.Simulation(scene, Settings(method="naive")).close()
    assert caught[0].filename == __file__
    place = np.stack(np.divmod(np.arange(100), 10), axis=1) * 0.6 + 0.3
    touching = Scene(width=6, height=6, position=place, velocity=np.zeros((100, 2)), radius=0.3)
    assert touching.overlaps_at_start() == "", "rounding does not count"
    one = Scene(width=9, height=9, position=[[2, 2], [2, 2]], velocity=still[:2], radius=0.5)
    assert one.overlaps_at_start() == "1 pair of discs overlaps at the start: discs 0 and 1, by 1"
    assert one.starting_from(State([[2.0, 2.0], [3.5, 2.0]], one.velocity)).overlaps_at_start() == ""


def test_overlaps_are_found_through_periodic_borders_and_with_obstacles():
    walls = [FixedDisc((4, 3), 0.1), Polyline([(7.9, 0.5), (7.9, 1.0)], thickness=0.2)]
    places = np.array([[0.1, 5.0], [7.7, 5.0], [0.2, 0.75], [4.4, 3.0]])
    how = {"width": 8, "height": 6, "velocity": np.zeros((4, 2)), "radius": [0.4, 0.2, 0.3, 0.35], "obstacles": walls}
    assert Scene(position=places, boundary="periodic", **how).overlaps_at_start() == (
        "1 pair of discs overlaps at the start: discs 0 and 1, by 0.2; "
        "2 discs overlap an obstacle at the start, disc 2 and obstacles[1] deepest, by 0.1"
    )
    control = Scene(position=np.clip(places, 0.4, None), **how)
    assert control.overlaps_at_start() == "disc 3 overlaps obstacles[0] at the start, by 0.05"
    with pytest.warns(mpsim.OverlapWarning, match=r"disc 3 overlaps obstacles\[0\].*method='event' lets them leave"):
        mpsim.Simulation(control, Settings(method="event")).close()


@hypothesis_settings(max_examples=20)
@given(st.integers(0, 2**32), st.integers(2, 40), st.floats(3, 40), st.floats(3, 40), st.floats(0.05, 1))
def test_overlaps_are_those_of_all_pairs(seed, count, width, height, diameter):
    position = diameter / 2 + np.random.default_rng(seed).random((count, 2)) * (np.array([width, height]) - diameter)
    scene = Scene(width=width, height=height, position=position, velocity=np.zeros((count, 2)), radius=diameter / 2)
    i, j, distance = overlapping_pairs(position, diameter * (1 - 1e-9))
    told = scene.overlaps_at_start()
    assert (told == "") == (not len(i))
    if told:
        first = np.lexsort((j, i, distance))[0]
        assert told.startswith(f"{len(i)} pair")
        assert f"discs {i[first]} and {j[first]}" in told


# --- at random

SIZES = {
    "one size": np.full(60, 0.5),
    "two sizes": np.repeat([0.5, 0.35], 30),
    "many sizes": np.geomspace(0.1, 1.0, 60),
    "a giant": np.append(np.full(59, 0.2), 0.9),
}


def deepest(scene):
    """Depth of the deepest overlap, over all pairs; negative: the narrowest gap."""
    r = scene.position[:, None] - scene.position[None]
    for axis, length in enumerate((scene.width, scene.height)):
        r[..., axis] -= scene.periodic[axis] * length * np.round(r[..., axis] / length)
    depth = scene.radii[:, None] + scene.radii[None] - np.hypot(r[..., 0], r[..., 1])
    return depth[np.triu_indices(scene.count, 1)].max()


@pytest.mark.parametrize(
    ("sizes", "packing", "boundary"),
    [
        ("one size", 0.7, "periodic"),
        ("two sizes", 0.6, "walls"),
        ("many sizes", 0.5, ("periodic", "walls")),
        ("a giant", 0.2, "periodic"),
    ],
)
def test_random_discs_of_any_size_have_no_overlap_and_exactly_the_packing_asked_for(sizes, packing, boundary):
    scene = Scene.random(count=60, radius=SIZES[sizes], packing=packing, boundary=boundary, seed=1)
    assert scene.packing == pytest.approx(packing, rel=1e-12)
    assert deepest(scene) < 0
    assert scene.overlaps_at_start() == ""


@pytest.mark.long
def test_many_random_discs_reach_the_largest_packing():
    for packing in (0.4, 0.41, 0.8):
        scene = Scene.random(count=30_000, packing=packing, radius=0.25, seed=2)
        assert not len(overlapping_pairs(scene.position, 0.5)[0])
        counts = np.histogram2d(*scene.position.T, bins=10, range=[[0, scene.width]] * 2)[0]
        assert ((counts - 300) ** 2 / 300).sum() < 150, "they fill the box evenly"
        assert len(np.unique(scene.position[:, 1].round(3))) > 12_000, "and are no lattice"
        steps = np.hypot(*np.diff(scene.position, axis=0).T)
        assert np.median(steps) > scene.width / 4, "neighbours in space are none in number"


@pytest.mark.parametrize("size", [(3, 30), (60, 1.05)])
def test_random_discs_fit_boxes_of_any_shape_and_keep_clear_of_obstacles(size):
    count = int(0.4 * size[0] * size[1] / (math.pi / 4))
    assert deepest(Scene.random(count=count, width=size[0], height=size[1], radius=0.5, seed=3)) < 0
    walls = [FixedDisc((5, 5), 1.5), Polyline([(1, 8), (4, 12), (9, 12)], thickness=0.3)]
    scene = Scene.random(count=60, radius=0.4, width=15, height=15, obstacles=walls, seed=3)
    assert (deepest(scene) < 0, scene.overlaps_at_start()) == (True, "")


@pytest.mark.parametrize(("count", "temperature"), [(2, 1.0), (3, 0.01), (100, 2.5), (10, 0.0)])
def test_velocities_have_exactly_the_temperature_and_no_momentum(count, temperature):
    mass = np.resize([1.0, 16.0], count)
    for scene in (
        Scene.random(count=count, packing=0.1, radius=0.5, temperature=temperature, seed=4),
        Scene.random(count=count, packing=0.1, radius=0.5, temperature=temperature, seed=4, mass=mass),
        Scene.lattice(count=count, packing=0.2, radius=0.5, temperature=temperature, seed=4),
    ):
        masses = scene.masses[:, None]
        assert (masses * scene.velocity**2).mean() == pytest.approx(temperature, rel=1e-12)
        assert np.abs((masses * scene.velocity).sum(axis=0)).max() <= 1e-11 * count


def test_random_scenes_follow_their_seed_and_leave_other_random_numbers_alone():
    before = np.random.get_state()[1].tobytes()  # noqa: NPY002
    for packing in (0.2, 0.6):
        one, again, other = (Scene.random(count=60, packing=packing, radius=0.5, seed=seed) for seed in (6, 6, 7))
        assert one.digest() == again.digest() != other.digest()
        assert one.digest() == Scene.random(count=60, packing=packing, radius=np.full(60, 0.5), seed=6).digest()
    assert np.random.get_state()[1].tobytes() == before  # noqa: NPY002
    none = Scene.random(count=0, packing=0.5, radius=0.5)
    assert (none.count, none.width, none.height) == (0, 1, 1)
    assert np.isfinite(Scene.random(count=1, packing=0.78, radius=0.5, seed=5).velocity).all()
    tiny = Scene.random(count=20, radius=1e-139, packing=0.3, mass=1e-307, temperature=2.0)
    assert tiny.packing == pytest.approx(0.3)
    assert ((np.sqrt(tiny.masses)[:, None] * tiny.velocity) ** 2).mean() == pytest.approx(2.0)


@pytest.mark.parametrize("name", ["gas", pytest.param("mixture", marks=pytest.mark.long), "brownian"])
def test_another_start_is_of_the_same_kind(name):
    scene = Scene.load(name)
    other = scene.redrawn(1)
    assert other.digest() == scene.redrawn(1).digest() not in (scene.digest(), scene.redrawn(2).digest())
    for what in ("count", "width", "height", "packing", "boundary", "restitution", "duration", "largest_radius"):
        assert getattr(other, what) == getattr(scene, what), what
    energy = [float((each.masses[:, None] * each.velocity**2).sum()) for each in (scene, other)]
    assert energy[1] == pytest.approx(energy[0], rel=1e-9)
    assert other.overlaps_at_start() == ""
    assert other.redrawn(5).digest() != other.digest(), "another start has others, too"
    assert name != "mixture" or not other.velocity[:100].any(), "the heavy ones start at rest, as its file says"


def test_a_scene_that_was_given_has_no_other_start():
    for scene in (Scene.load("cradle"), gas(5, 0.1).starting_from(State(np.ones((5, 2)), np.ones((5, 2))))):
        assert scene._redraw is None
        with pytest.raises(InputError, match=r"drawn at random, by Scene.random, Scene.lattice .*Make other starts"):
            scene.redrawn(1)
    with pytest.raises(InputError, match="seed must be a whole number"):
        gas(5, 0.1).redrawn(-1)


# --- on a lattice


def on_lattice(count=1000, packing=0.5, **others):
    return Scene.lattice(**{"count": count, "radius": 0.5, "packing": packing, "seed": 3} | others)


@pytest.mark.parametrize("boundary", ["walls", "periodic", ("periodic", "walls")], ids=str)
@pytest.mark.parametrize("count", [1, 50, 9000])
def test_a_lattice_has_no_overlap_and_any_range_is_the_slice_of_the_whole(count, boundary):
    scene = on_lattice(count, 0.75 if count > 50 else 0.1, boundary=boundary, gravity=(0, -1))
    assert not len(overlapping_pairs(scene.position, 1 - 1e-12)[0])
    assert scene.overlaps_at_start() == ""
    ends = sorted({0, count, count // 2, *(min(count, each) for each in (1, 4095, 4096))})
    for first in ends:
        for last in (each for each in ends if each >= first):
            assert scene._start.positions(first, last).tobytes() == scene.position[first:last].tobytes()
            assert scene._start.velocities(first, last).tobytes() == scene.velocity[first:last].tobytes()
    pieces = list(scene._start.pieces())
    assert (pieces[0][0], pieces[-1][1]) == (0, count)
    assert [last for _, last in pieces[:-1]] == [first for first, _ in pieces[1:]]
    arrays = scene_of(scene.position, scene.velocity, scene.width, scene.height, boundary=boundary, gravity=(0, -1))
    assert arrays.digest() == scene.digest() == pickle.loads(pickle.dumps(scene)).digest()


@pytest.mark.parametrize("size", [(200.0, 1.1), (50.0, 20.0), (1e6, 1e6)])
def test_a_lattice_fills_boxes_of_any_shape_in_strips(size):
    scene = Scene.lattice(count=40, width=size[0], height=size[1], radius=0.5)
    assert scene.overlaps_at_start() == ""
    assert np.ptp(scene.position[:, 0]) > 0.8 * (size[0] - 1), "as far as the box goes"
    many = on_lattice(20_000)
    for first in range(0, 20_000, 4000):
        assert np.ptp(many._start.positions(first, first + 1000)[:, 0]) < 0.1 * many.width, (
            "neighbours in number are near"
        )
    assert len(np.unique(np.diff(many.position[:100, 1]).round(6))) == 99, "no step is another"
    v = many.velocity
    assert np.abs((v**4).mean(axis=0) - 3).max() < 4 * np.sqrt(96 / 20_000), "velocities are normal"
    assert np.abs((v[4096:] * v[:-4096]).mean(axis=0)).max() < 4 / np.sqrt(20_000), "blocks have their own"
    assert on_lattice(100_000, 0.9).packing > 0.899


def test_a_lattice_is_never_made_as_a_whole_by_looking_at_it():
    scene, count = on_lattice(1_000_000), 125_000
    scene._start.positions(0, 1)
    tracemalloc.start()
    start, some = scene._start, (3 * count, 4 * count)
    rows = start.positions(*some), start.velocities(*some)
    part = tracemalloc.get_traced_memory()[1]
    tracemalloc.reset_peak()
    looks = [repr(scene), scene.packing, len(pickle.dumps(scene)), copy.copy(scene).count, scene.redrawn(2).count]
    peak = tracemalloc.get_traced_memory()[1] - sum(array.nbytes for array in rows)
    tracemalloc.stop()
    assert part < 1.25 * sum(array.nbytes for array in rows)
    assert peak < 4_000_000
    assert looks[2:] == [looks[2], 1_000_000, 1_000_000]
    assert looks[2] < 1000


# --- from a state


def test_what_belongs_to_discs_follows_those_that_stay(tmp_path):
    scene = box_of(
        position=[[2, 2], [5, 2], [8, 2]], velocity=np.zeros((3, 2)), radius=[0.5, 0.25, 0.25], mass=[3, 1, 1],
        acceleration=[[1, 0], [2, 0], [3, 0]], absorbing="top",
    )  # fmt: skip
    for kept in ([True, False, True], [False, True, True], [True, True, True]):
        rest = scene.starting_from(State(scene.position, scene.velocity, present=np.array(kept)))
        assert rest.radii.tolist() == scene.radii[kept].tolist()
        assert rest.masses.tolist() == scene.masses[kept].tolist()
        assert rest.acceleration.tolist() == scene.acceleration[kept].tolist()
        rest.save(tmp_path / "rest.toml")
        assert Scene.load(tmp_path / "rest.toml").digest() == rest.digest()
        assert not rest.acceleration.flags.writeable
    assert scene.starting_from(State(scene.position, scene.velocity, present=np.zeros(3, bool))).count == 0
    for given_ in (gas(9, 0.1), "gas", None):
        with pytest.raises(InputError, match=r"state must be a State; got \w+\. Use sim\.state"):
            scene.starting_from(given_)


@pytest.mark.parametrize("wall", ["left", "top"])
def test_a_piston_goes_on_from_where_it_was(wall):
    """Two runs of a time 1, one after the other, leave it where one of 2 does; discs that it has pushed are inside."""
    axis, upper = divmod(("left", "right", "bottom", "top").index(wall), 2)
    size, speed = (10, 8)[axis], -1.0 if upper else 1.0
    piston = Piston(wall, speed, stop=5 if upper else size - 5)
    scene = box_of(position=[[5, 4], [3, 5]], velocity=[[3, 2], [-2, 1]], piston=piston)
    middle = after(scene, 1, dt=0.05)
    edges = [0, 10, 0, 8]
    edges[2 * axis + upper] += speed
    assert middle.box == pytest.approx(edges)
    there = scene.starting_from(middle)
    assert there.piston.start == middle.box[2 * axis + upper]
    for until in (1, 9):
        assert after(there, until, dt=0.05).box == pytest.approx(after(scene, 1 + until, dt=0.05).box)
    assert np.abs(after(there, 0.01).position - middle.position).max() < 0.1, "no disc may jump"
    arrived = scene.starting_from(after(scene, 9, dt=0.05))
    assert arrived.piston.start == arrived.piston.stop
    assert after(arrived, 1, dt=0.05).box[2 * axis + upper] == piston.stop


@pytest.mark.parametrize("way", ["float32", "float32 held as float64", "float64", "a rounding of float64"])
def test_discs_at_the_walls_stay_at_the_walls_and_those_outside_are_refused(way):
    """In boxes small and large, whose walls are no float32 numbers; 64 roundings are outside."""
    rng, moved, single = np.random.default_rng(3), 0, way.startswith("float32")

    def in_way(array):
        array = array.astype(np.float32) if single else array
        array = array.astype(float) if way.endswith("as float64") else array
        return np.nextafter(array, np.where(array > array.mean(), np.inf, -np.inf)) if "rounding" in way else array

    for _ in range(20):
        width = float(10 ** rng.uniform(-4, 9))
        height = width * float(10 ** rng.uniform(-2, 2))
        radius = min(width, height) * float(rng.uniform(0.001, 0.4))
        corners = np.array([[x, y] for x in (radius, width - radius) for y in (radius, height - radius)])
        scene = Scene(width=width, height=height, position=corners, velocity=np.zeros((4, 2)), radius=radius)
        position = in_way(scene.position)
        there = scene.starting_from(State(position, np.zeros_like(position)))
        low, high = scene.limits(radius)
        assert ((there.position >= low) & (there.position <= high)).all()
        moved += int((there.position != position).any())
        corners[3] += 64 * np.finfo(np.float32 if single else float).eps * max(width, height)
        with pytest.raises(InputError, match=r"position\[3\] must lie in"):
            scene.starting_from(State(in_way(corners), np.zeros((4, 2))))
    assert moved or way == "float64", "no rounding led beyond a wall, which tests nothing"


# --- what scenes recommend

RECOMMENDED = {
    "duration": 3.0, "settings": Settings(dt=0.02, method="naive", passes=2), "picture_interval": 0.2,
    "measures": ("temperature",),
}  # fmt: skip


def test_recommendations_stay_with_a_scene_are_in_no_digest_and_used_by_whoever_runs_it(tmp_path):
    scene, bare = gas(6, 0.1, **RECOMMENDED), gas(6, 0.1)
    scene.save(tmp_path / "scene.toml")
    others = [scene, scene.redrawn(3), pickle.loads(pickle.dumps(scene)), Scene.load(tmp_path / "scene.toml")]
    with mpsim.Simulation(scene) as sim:
        assert sim.settings == RECOMMENDED["settings"]
        sim.run(frames=2)
        others.append(scene.starting_from(sim.state))
        sim.save(tmp_path / "run.mpsim")
    with mpsim.Simulation.resume(tmp_path / "run.mpsim") as again:
        others.append(again.scene)
        assert scene.digest() == bare.digest() == again.scene.digest()
    for each in others:
        assert {name: getattr(each, name) for name in RECOMMENDED} == RECOMMENDED
    assert [getattr(bare, name) for name in RECOMMENDED] == [None, None, None, ()]
    with mpsim.Simulation(scene, Settings(dt=0.05, method="naive")) as sim:
        assert sim.settings.dt == 0.05
    with pytest.raises(InputError, match=r"settings must be mpsim.Settings; got float. Use Settings"):
        mpsim.Simulation(scene, 0.01)


# --- compressed


@pytest.mark.parametrize("boundary", ["walls", "periodic"])
def test_compressed_discs_are_the_same_denser_and_do_not_overlap(boundary):
    sizes = np.resize([0.5, 0.4], 8)
    scene = few(count=8, radius=sizes, mass=sizes**2, boundary=boundary, gravity=(0, -1), duration=7.0)
    dense = scene.compressed(0.65, rate=4.0)
    assert dense.packing == pytest.approx(0.65, rel=1e-14)
    assert dense.width / dense.height == pytest.approx(scene.width / scene.height, rel=1e-14)
    assert (deepest(dense) <= 1e-12, dense.overlaps_at_start()) == (True, "")
    assert (dense.radius == scene.radius).all()
    assert (dense.mass == scene.mass).all()
    assert (dense.gravity.tolist(), dense.duration, dense.boundary) == ([0, -1], 7.0, scene.boundary)
    energy = [(each.masses[:, None] * each.velocity**2).sum() for each in (scene, dense)]
    assert energy[1] == pytest.approx(energy[0], rel=1e-12)
    assert dense.digest() == scene.compressed(0.65, rate=4.0).digest() != scene.compressed(0.65, rate=8.0).digest()
    other = dense.redrawn(3)
    assert other.packing == pytest.approx(0.65, rel=1e-14)
    assert not (other.position == dense.position).any()


def test_compression_has_pinned_bits_in_any_unit_and_says_where_discs_jam():
    scene, dense = lattice(4, 4), lattice(4, 4).compressed(0.7, rate=4.0)
    assert dense.digest() == "62d58c4ef0b453eae79fe578b9edef7b"
    for unit in (2.0**-300, 2.0**300):
        parts = {name: getattr(scene, name) * unit for name in ("width", "height", "radius", "position")}
        other = Scene(**parts, velocity=scene.velocity / unit).compressed(0.7, rate=4.0)
        assert (other.position == dense.position * unit).all()
        assert (other.velocity == dense.velocity / unit).all()
    parts = ["packing 0.9 was not reached", "at rate=10 the discs jammed at a packing of 0.", "rate=1"]
    assert_refused(parts, few(boundary="periodic").compressed, 0.9, rate=10.0)
    with pytest.raises(InputError, match="another start needs a scene that was drawn at random"):
        dense.redrawn(3)


@pytest.mark.parametrize(
    ("count", "packing", "pinned"), [(48, 0.4, "5505c2c448"), (100, 0.5, "e8aecdc362"), (200, 0.7, "def8497751")]
)
def test_random_places_are_the_pinned_ones_also_where_the_way_to_draw_them_changes(count, packing, pinned):
    places = gas(count, packing).position
    assert hashlib.sha1(places.tobytes()).hexdigest()[:10] == pinned
