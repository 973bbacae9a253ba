"""Discs that are added: refused by name, and found free of others as by comparing all."""

import warnings
from typing import Any

import numpy as np
import pytest
from support.many import emitters, pegs_and_emitters, simulated
from support.scenes import simulate

import mpsim
from mpsim.engine import emission, insertion

MIXED = mpsim.Scene(
    width=10, height=10, position=[[2, 2], [5, 5]], velocity=np.zeros((2, 2)), radius=[0.5, 0.25], mass=[1, 2]
)

PLAIN = mpsim.Scene(width=10, height=10, position=[[2, 2]], velocity=np.zeros((1, 2)), radius=0.5)


@pytest.mark.parametrize(
    ("scene", "arguments", "text"),
    [
        (
            MIXED,
            {"mass": 1},
            "radius must be given for added discs, as the discs of this scene have one each; got None",
        ),
        (MIXED, {"radius": 0.5}, "mass must be given for added discs, as the discs of this scene have one each"),
        (MIXED, {"radius": 0, "mass": 1}, "radius of added discs must be > 0 and at most that of the scene's largest"),
        (MIXED, {"radius": 0.6, "mass": 1}, r"largest disc, 0.5; got \[0.6\]"),
        (MIXED, {"radius": 0.5, "mass": -1}, r"mass of added discs must be > 0; got \[-1.0\]"),
        (MIXED, {"radius": [0.1, 0.2], "mass": 1}, r"radius must have shape \(\) or \(1,\); got shape \(2,\)"),
        (MIXED, {"radius": np.nan, "mass": 1}, "radius must be finite"),
        (MIXED, {"radius": "large", "mass": 1}, "radius must be numbers"),
        (PLAIN, {"radius": 0.5}, "radius can be given for added discs only in a scene whose discs have one each; here"),
        (PLAIN, {"mass": 2}, "mass can be given for added discs only in a scene whose discs have one each; here all"),
    ],
)
def test_wrong_radii_and_masses_of_added_discs_are_refused_by_name(scene, arguments, text):
    with simulate(scene, method="naive") as sim:
        with pytest.raises(mpsim.InputError, match=text):
            sim.add([7, 7], [0, 0], **arguments)
        assert sim.count == scene.count, "nothing was added"


def test_added_discs_of_a_mixed_scene_take_one_value_or_one_each():
    with simulate(MIXED, method="naive") as sim:
        sim.add([[7, 7], [8, 2]], np.zeros((2, 2)), radius=[0.1, 0.2], mass=1)
        sim.add([3, 8], [0, 0], radius=0.5, mass=2)
        assert sim.radii.tolist() == [0.5, 0.25, 0.1, 0.2, 0.5]


@pytest.mark.slow
@pytest.mark.parametrize("boundary", ["walls", "periodic"])
def test_discs_that_enter_together_are_those_of_all_comparisons(boundary, monkeypatch):
    """Which of 300 emitters find their places free: by comparison with all discs, and with some."""
    rng = np.random.default_rng(8)
    spouts = [mpsim.Emitter(place, (0, 0), every=1, limit=3) for place in rng.uniform(1, 59, (300, 2))]
    arguments = {"position": rng.uniform(1, 59, (40, 2)), "width": 60, "height": 60, "radius": 1, "boundary": boundary}

    def entered(few):
        monkeypatch.setattr(emission, "FEW_LOOKS", few)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with simulated({**arguments, "emitters": spouts}) as sim:
                sim.run(frames=3)
                return sim.count, sim.digest()

    every = entered(10**9)
    assert 100 < every[0] < 340
    assert entered(32) == entered(1) == every


def test_looks_at_discs_grow_with_the_number_that_enter_together(monkeypatch):
    def compared(count):
        numbers, absolute = [], np.abs
        arguments = {**emitters(count), "position": np.zeros((0, 2))}
        spouts = tuple(mpsim.Emitter(each.position, (0, 0), every=1, limit=1) for each in arguments["emitters"])
        with simulated({**arguments, "emitters": spouts}) as sim, monkeypatch.context() as patch:
            patch.setattr(emission.np, "abs", lambda values: numbers.append(len(values)) or absolute(values))
            sim.run(frames=2)
            assert sim.count == count
        return sum(numbers)

    few, many = compared(400), compared(1600)
    assert 0 < few < many < 10 * few, "quadratic would be 16, in strips it is 8"


def test_looks_at_obstacles_grow_with_the_number_of_discs_that_enter(monkeypatch):
    def compared(obstacles, emitters):
        numbers, hypot = [], np.hypot
        with simulated(pegs_and_emitters(obstacles, emitters)) as sim, monkeypatch.context() as patch:
            patch.setattr(np, "hypot", lambda *values: numbers.append(np.size(values[0])) or hypot(*values))
            sim.run(frames=1)
            assert sim.count == emitters
        return sum(numbers)

    few, many = compared(900, 200), compared(3600, 800)
    assert 0 < few < many < 6 * few, "linear would be 4, of all with all 16"


class NotLookedAt:
    def __array__(self, *_, **__):
        raise AssertionError("all discs are looked at")


def test_discs_that_are_there_are_not_looked_at_where_nothing_presses_them_together():
    """An array over all discs for each one that enters takes the square of their number."""
    box = {"width": 9, "height": 9, "position": [], "velocity": [], "radius": 1}
    place = {"time": 0.0, "name": "position", "position": np.array([4.0, 4.0]), "radius": 1.0}
    present: Any = NotLookedAt()
    assert insertion.hindrance(mpsim.Scene(**box), present=present, **place) is None
    pressed = mpsim.Scene(**box, piston=mpsim.Piston("right", -1, 5.0))
    assert "room for all 26 discs" in str(insertion.hindrance(pressed, present=np.ones(25), **place))
