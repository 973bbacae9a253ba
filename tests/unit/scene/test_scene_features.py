"""What a scene may have besides discs in a box: every rule with its text, random scenes of all kinds, overlaps."""

import numpy as np
import pytest

from mpsim import Emitter, FixedDisc, InputError, Piston, Polyline, Scene, Settings, Simulation
from mpsim.features.piston import PISTON

PLACES = [[2.0, 2.0], [4.0, 3.0]]


def scene_of(**changes):
    arguments = {"width": 8.0, "height": 6.0, "position": PLACES, "velocity": np.zeros((2, 2)), "radius": 0.5}
    return Scene(**(arguments | changes))


WRONG = {
    "radius of another shape": ({"radius": [0.5] * 3}, ["radius must have shape () or (2,)", "(3,)"]),
    "radius not positive": ({"radius": [0.5, 0.0]}, ["radius must be > 0 [length]", "radius[1] is 0.0"]),
    "radius not finite": ({"radius": [0.5, np.nan]}, ["radius must be finite", "radius[1] is nan"]),
    "mass of another shape": ({"mass": [1.0]}, ["mass must have shape () or (2,)", "(1,)"]),
    "mass not positive": ({"mass": [1.0, -2.0]}, ["mass must be > 0 [mass]", "mass[1] is -2.0"]),
    "a large disc by the wall": (
        {"radius": [2.5, 0.5]},
        ["position[0] must lie in [2.5, 5.5] x [2.5, 3.5]", "(2.0, 2.0)"],
    ),
    "too large for the box": ({"radius": [0.5, 3.5]}, ["at most half the box, 3 here", "3.5", "larger box"]),
    "too large for a periodic axis": (
        {"radius": [0.5, 1.6], "boundary": ("walls", "periodic")},
        ["at most a quarter of a periodic axis, 1.5 here", "1.6", "larger box"],
    ),
    "an unknown boundary": ({"boundary": "perodic"}, ["boundary must be one of", "Did you mean 'periodic'?"]),
    "three boundaries": ({"boundary": ("walls",) * 3}, ["one for x and one for y"]),
    "beyond a periodic edge": (
        {"boundary": "periodic", "position": [[2, 2], [8.5, 3]]},
        ["position[1] must lie in [0, 8] x [0, 6]", "(8.5, 3.0)"],
    ),
    "an obstacle of another kind": ({"obstacles": [1]}, ["obstacles[0] must be an mpsim.FixedDisc", "int"]),
    "an obstacle outside": ({"obstacles": FixedDisc((9, 1), 1)}, ["obstacles[0] must lie in the box", "(9.0, 1.0)"]),
    "an emitter of another kind": ({"emitters": [1]}, ["emitters[0] must be an mpsim.Emitter", "int"]),
    "an emitter outside": (
        {"emitters": Emitter((0.2, 3), (1, 0), every=1)},
        ["the position of emitters[0] must lie in [0.5, 7.5]", "(0.2, 3.0)"],
    ),
    "an emitter without a radius": (
        {"radius": [0.5, 0.4], "emitters": Emitter((2, 3), (1, 0), every=1)},
        ["emitters[0] must have a radius", "got None"],
    ),
    "an emitter without a mass": (
        {"mass": [1, 2], "emitters": Emitter((2, 3), (1, 0), every=1)},
        ["emitters[0] must have a mass", "got None"],
    ),
    "an unknown edge": ({"absorbing": "botom"}, ["absorbing must be one of", "Did you mean 'bottom'?"]),
    "a periodic edge that absorbs": (
        {"absorbing": "left", "boundary": ("periodic", "walls")},
        ["absorbing must name a wall", "'left'", "periodic along x", "another edge"],
    ),
    "a piston of another kind": ({"piston": 1}, ["piston must be an mpsim.Piston", "int"]),
    "a piston on a periodic axis": (
        {"piston": Piston("top", -1, 3), "boundary": ("walls", "periodic")},
        ["piston must name a wall", "'top'", "periodic along y"],
    ),
    "an absorbing piston": (
        {"piston": Piston("top", -1, 3), "absorbing": "top"},
        ["piston must not be an absorbing edge", "'top'", "Choose one"],
    ),
    "a piston that stops outside": ({"piston": Piston("left", 1, 9)}, ["stop of the piston", "(0, 8)", "9"]),
    "a piston that leaves no room": ({"piston": Piston("left", 1, 7.5)}, ["room for the largest disc", "0.5"]),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_broken_rule_is_named_with_the_value(case):
    changes, words = WRONG[case]
    with pytest.raises(InputError) as raised:
        scene_of(**changes)
    for word in words:
        assert word in str(raised.value), f"{word!r} is missing in {str(raised.value)!r}"


PARTS = {
    "a peg without a radius": (lambda: FixedDisc((1, 1), 0), ["radius of a FixedDisc", "> 0"]),
    "a peg at no point": (lambda: FixedDisc((1, 1, 1), 1), ["position of a FixedDisc", "shape (2,)"]),
    "a wall of one corner": (lambda: Polyline([(0, 0)]), ["at least two", "Use a FixedDisc"]),
    "a wall that stands still": (lambda: Polyline([(0, 0), (0, 0)]), ["at different places"]),
    "a wall of no shape": (lambda: Polyline([(0, 0, 0)]), ["points of a Polyline", "(K, 2)"]),
    "a negative thickness": (lambda: Polyline([(0, 0), (1, 0)], -1), ["thickness of a Polyline", ">= 0"]),
    "an emitter of no frames": (lambda: Emitter((0, 0), (1, 0), every=0), ["every of an Emitter", "from 1"]),
    "an emitter of no discs": (lambda: Emitter((0, 0), (1, 0), every=1, limit=0), ["limit of an Emitter", "no end"]),
    "an emitter of no size": (
        lambda: Emitter((0, 0), (1, 0), every=1, radius=0),
        ["radius of an Emitter", "> 0 [length]"],
    ),
    "an emitter of no mass": (lambda: Emitter((0, 0), (1, 0), every=1, mass=-1), ["mass of an Emitter", "> 0 [mass]"]),
    "a piston of no wall": (lambda: Piston("front", 1, 1), ["wall of a Piston", "'front'"]),
    "a piston that pulls": (lambda: Piston("right", 1, 1), ["must point into the box", "< 0 for the right wall"]),
    "a piston at rest": (lambda: Piston("left", 0, 1), ["must point into the box", "> 0 for the left wall"]),
    "a piston without an end": (lambda: Piston("left", 1, 0), ["stop of a Piston", "> 0"]),
}


@pytest.mark.parametrize("case", PARTS)
def test_a_part_checks_itself(case):
    make, words = PARTS[case]
    with pytest.raises(InputError) as raised:
        make()
    for word in words:
        assert word in str(raised.value), f"{word!r} is missing in {str(raised.value)!r}"


def test_what_is_equal_for_all_counts_as_one():
    scene = scene_of(radius=[0.5, 0.5], mass=[1.0, 1.0])
    assert (scene.radius, scene.mass) == (0.5, None)
    assert scene_of(mass=2.0).masses.tolist() == [2, 2]
    assert (scene_of(radius=[0.5, 0.25]).smallest_radius, scene_of(radius=[0.5, 0.25]).largest_radius) == (0.25, 0.5)
    wide = scene_of(emitters=Emitter((4, 3), (0, 1), every=1, radius=0.75))
    assert (wide.smallest_radius, wide.largest_radius) == (0.5, 0.75)


def test_arrays_are_read_only_copies():
    radius, mass = np.array([0.5, 0.25]), np.array([1.0, 3.0])
    scene = scene_of(radius=radius, mass=mass)
    radius[0] = mass[0] = 9
    assert (scene.radius[0], scene.mass[0]) == (0.5, 1.0)
    for array in (scene.radius, scene.mass):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


def test_packing_and_repr_are_of_the_box_at_the_start():
    scene = Scene(
        width=20, height=10, position=[[1, 1], [3, 3]], velocity=np.zeros((2, 2)), radius=0.5,
        piston=Piston("right", -1, 4, start=5),
    )  # fmt: skip
    assert scene.packing == pytest.approx(2 * np.pi * 0.25 / 50)
    assert repr(scene) == "<Scene: 2 discs of radius 0.5 in 5 x 10 of 20 x 10, packing 0.0314, piston>"


def test_what_is_computed_of_obstacles_is_of_those_that_a_scene_has():
    """A changed scene begins as a copy, in which nothing of what was computed of the other may stay."""

    def start(x):
        peg = FixedDisc((x, 2), 0.5)
        return Scene(width=9, height=4, position=[[1, 2]], velocity=[[1, 0]], radius=0.5, obstacles=peg)

    scene, other = start(4), start(6)
    with Simulation(scene, Settings(method="grid")) as sim:
        sim.run(until=4)
    changed = scene.changed(obstacles=other.obstacles)
    assert changed.capsules.tolist() == other.capsules.tolist()
    with Simulation(changed, Settings(method="grid")) as sim:
        sim.run(until=4)
        replaced = sim.digest()
    with Simulation(other, Settings(method="grid")) as sim:
        sim.run(until=4)
        assert sim.digest() == replaced


def test_a_second_moving_wall_is_refused(monkeypatch):
    """It was ignored. The control: one is fine."""
    moving = scene_of(piston=Piston("left", 0.1, 1.0))
    assert moving.moving_wall is not None
    monkeypatch.setattr("mpsim.scene.walls.FEATURES", (PISTON, PISTON))
    with pytest.raises(InputError, match="at most one wall that moves; got piston and piston"):
        _ = moving.moving_wall
