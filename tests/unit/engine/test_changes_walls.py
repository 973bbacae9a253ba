"""Walls put up between two frames: who meets them, where they have room, and what can be measured then."""

import contextlib
import re

import numpy as np
import pytest
from support.scenes import simulate
from support.selection import long_but
from support.sessions import METHODS, room

import mpsim


@pytest.mark.slow
@pytest.mark.parametrize("words", long_but(list(METHODS), "grid"))
def test_a_wall_is_met_from_both_sides_once_it_stands(words):
    """Both discs would meet in the middle; a removed one is not in the way of the wall."""
    scene = mpsim.Scene(
        width=12, height=4, position=[[2, 2], [10, 2], [6, 2]], velocity=[[2, 0], [-2, 0], [0, 0]], radius=0.5
    )
    with simulate(scene, dt=0.01, contact="impact", **METHODS[words]) as sim:
        wall = {"points": [(6, 0), (6, 4)], "thickness": 0.5}
        with pytest.raises(mpsim.InputError, match=r"a wall must be clear of all discs; got disc 2 at \(6.0, 2.0\)"):
            sim.add_wall(**wall)
        sim.remove(2)
        sim.run(frames=50)
        sim.add_wall(**wall)
        sim.run(frames=150)
        assert sim.state.velocity.tolist() == [[-2, 0], [2, 0], [0, 0]]
        assert sim.state.position[:2, 0] == pytest.approx([4.5, 7.5], abs=1e-9), "having turned at 5.25 and 6.75"
        assert sim.scene.obstacles == (mpsim.Polyline(**wall),)
        assert scene.obstacles == (), "the scene that was given is as it was"
        sim.run(frames=400)
        assert sim.state.position[0, 0] < 5.3, "and for good"


@pytest.mark.parametrize(
    ("features", "text"),
    [
        (
            {"emitters": mpsim.Emitter((4, 4), (1, 0), every=5)},
            r"the position of emitters\[0\] must be one radius from",
        ),
        ({"obstacles": mpsim.FixedDisc((5, 5), 1)}, None),
    ],
)
def test_a_wall_leaves_the_other_parts_of_a_scene_their_room(features, text):
    scene = mpsim.Scene(width=12, height=12, position=[[9, 9]], velocity=[[0, 0]], radius=0.5, **features)
    with (
        simulate(scene) as sim,
        contextlib.nullcontext() if text is None else pytest.raises(mpsim.InputError, match=text),
    ):
        sim.add_wall([(3, 4), (6, 4)])
        assert len(sim.scene.obstacles) == 2, "one more than before"


@pytest.mark.parametrize(
    ("wall", "text"),
    [
        (
            {"points": [(3, 4), (13, 4)]},
            "points of a wall must be in the box, [0, 12] x [0, 12]; points[1] is (13.0, 4.0)",
        ),
        (
            {"points": [(3, -1), (6, 4)]},
            "points of a wall must be in the box, [0, 12] x [0, 12]; points[0] is (3.0, -1.0)",
        ),
        ({"points": [(3, 4)]}, "points of a Polyline must be at least two"),
        ({"points": [(3, 4), (6, 4)], "thickness": -1}, "thickness of a Polyline must be a finite number >= 0"),
    ],
)
def test_a_wall_is_refused_in_the_words_of_its_door(wall, text):
    scene = mpsim.Scene(width=12, height=12, position=[[9, 9]], velocity=[[0, 0]], radius=0.5)
    with simulate(scene) as sim:
        with pytest.raises(mpsim.InputError, match=re.escape(text)):
            sim.add_wall(**wall)
        assert sim.scene.obstacles == ()


@pytest.mark.slow
def test_measures_that_mean_nothing_among_obstacles_are_nan_for_a_run_in_which_a_wall_is_put_up():
    class Puts:
        every = 10

        def look(self, sim, collisions):
            if sim.frame == 20:
                sim.add_wall([(0, 0), (0, 3)])

    with simulate(room(20), method="grid") as sim:
        found = sim.run(frames=30, measures=["momentum_drift", "temperature"], observe=Puts()).measures
        assert np.isnan(found["momentum_drift"].value)
        assert found["temperature"].value > 0
        with pytest.raises(mpsim.InputError, match="obstacles, whose impulses are not counted"):
            sim.run(frames=1, measures=["momentum_drift"])
