"""The pressure of many short runs is that of one run; it is counted only where it is asked for."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from support.scenes import gas

import mpsim
from mpsim.viewer.counting import MOST_PARTS, Counting, bulk_pressure

GRID = mpsim.Settings(method="grid")
PIECES = [1, 1, 5, 40, 1, 2, 100, 50, 1, 199]


def test_many_short_runs_have_the_pressure_of_one():
    scene, counting = gas(300, 0.4), Counting()
    with mpsim.Simulation(scene, GRID) as sim:
        whole = sim.run(frames=sum(PIECES), measures=["pressure", "largest_overlap"])
        expected = whole.measures["pressure"].value, whole.measures["largest_overlap"].value
        digest = sim.digest()
    counting.wanted = True
    with mpsim.Simulation(scene, GRID) as sim:
        for frames in PIECES:
            counting.note(sim.run(frames=frames, measures=counting.measures(sim)))
        assert sim.digest() == digest
    found = counting.numbers()
    assert (found["pressure"], found["largest_overlap"]) == pytest.approx(expected, rel=1e-9)
    counting.forget()
    assert math.isnan(counting.numbers()["pressure"])


def test_nothing_is_measured_that_is_not_wanted_or_not_possible():
    counting = Counting()
    rough = mpsim.Scene(
        width=6, height=6, radius=0.5, position=[[1, 1], [4, 4]], velocity=[[1, 0], [0, 1]], restitution=0.9,
        boundary="periodic",
    )  # fmt: skip
    sim = SimpleNamespace(scene=rough, count=2)  # or its loops would be compiled
    assert counting.measures(sim) == ()
    counting.wanted = True
    assert "pressure" not in counting.measures(sim)
    assert "losses" in counting.numbers()["pressure_note"]


class Some:
    """A report of a run."""

    def __init__(self, pressure, frames):
        self.measures, self.frames = {"pressure": mpsim.measure.Measure(pressure, 0.1, frames)}, frames


def test_there_is_no_pressure_before_frames_and_a_collision_are_counted():
    def counted(*runs):
        counting = Counting()
        for pressure, frames in runs:
            counting.note(Some(pressure, frames))
        return counting.numbers()["pressure"]

    assert math.isnan(counted((0.0, 1)))
    assert math.isnan(counted((2.0, 15)))
    assert math.isnan(counted((0.0, 100)))
    assert counted((2.0, 16)) == 2.0
    assert counted((0.0, 8), (2.0, 8)) == 1.0


def test_parts_stay_few_and_keep_the_mean_and_its_error():
    rng, counting = np.random.default_rng(1), Counting()
    pressures = rng.normal(2.0, 0.5, 40_000)
    for each in pressures:
        counting.note(Some(each, 4))
    found = counting.numbers()
    assert len(counting._parts) < MOST_PARTS
    assert found["pressure"] == pytest.approx(pressures.mean(), rel=1e-9)
    assert found["pressure_error"] == pytest.approx(0.5 / math.sqrt(len(pressures)), rel=0.4)


def test_the_equation_of_state_is_that_of_the_box_now_and_of_equal_discs_without_forces():
    start = gas(300, 0.4)
    side = start.width
    wall = mpsim.Piston("right", stop=side, speed=-1.0)
    scene = mpsim.Scene(width=2 * side, height=side, position=start.position, velocity=start.velocity, radius=0.5,
                        piston=wall)  # fmt: skip
    state, wider = (
        mpsim.State(scene.position, scene.velocity, box=(0.0, right, 0.0, side)) for right in (side, 2 * side)
    )
    assert 0 < bulk_pressure(wider, scene) < 0.4 * bulk_pressure(state, scene)
    heavy = mpsim.Scene(width=6, height=6, radius=0.5, position=[[1, 1]], velocity=[[1, 0]], gravity=(0, -1))
    assert math.isnan(bulk_pressure(mpsim.State(heavy.position, heavy.velocity), heavy))
