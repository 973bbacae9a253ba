"""Calls of a simulation with bad input are refused by name, and change nothing."""

import numpy as np
import pytest
from support.refusals import GOOD, assert_says
from support.scenes import gas, simulate

import mpsim

NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        ({}, ["run needs either frames or until", "frames=None", "until=None"]),
        ({"frames": 3, "until": 1.0}, ["run needs either frames or until", "frames=3", "until=1.0"]),
        ({"frames": -1}, ["frames must be a whole number from 0", "got -1"]),
        ({"frames": 2.5}, ["frames must be a whole number", "got 2.5"]),
        ({"frames": "all"}, ["frames must be a whole number", "got 'all'"]),
        ({"until": NAN}, ["until must be a finite number >= 0", "got nan"]),
        ({"until": INF}, ["until must be a finite number >= 0", "got inf"]),
        ({"until": -1}, ["until must be a finite number >= 0", "got -1"]),
        ({"until": 0.01}, ["until must not lie in the past", "the time is 0.02", "got 0.01"]),
    ],
)
def test_a_bad_run_is_refused_and_the_simulation_goes_on(arguments, parts):
    with simulate(gas(20, 0.2), method="grid", dt=0.01) as sim:
        sim.run(frames=2)
        before = sim.digest()
        with pytest.raises(mpsim.InputError) as caught:
            sim.run(**arguments)
        assert_says(caught, parts)
        assert (sim.frame, sim.digest()) == (2, before)
        assert sim.run(frames=1).frames == 1


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (([1, NAN], [0, 0]), ["position must be finite", "nan"]),
        (([1, 1], [INF, 0]), ["velocity must be finite", "inf"]),
        (([1, 1, 1], [0, 0, 0]), ["position must have shape", "(2,) or (K, 2)"]),
        (([[1, 1], [2, 2]], [0, 0]), ["velocity must have shape (2, 2)", "as position has"]),
        (([0.2, 1], [0, 0]), ["position[0] must lie in", "(0.2, 1.0)"]),
        (([[1, 1], [1, 99]], [[0, 0], [0, 0]]), ["position[1] must lie in", "99"]),
        (([1, 1], [0, 0], [0, 1]), ["acceleration can be given", "this one has none", "numpy.zeros"]),
    ],
)
def test_a_bad_disc_is_not_added(arguments, parts):
    with simulate(gas(20, 0.2), method="grid") as sim:
        before = sim.digest()
        with pytest.raises(mpsim.InputError) as caught:
            sim.add(*arguments)
        assert_says(caught, parts)
        assert (sim.count, sim.digest()) == (20, before)


def test_a_simulation_needs_a_scene_and_settings():
    with pytest.raises(mpsim.InputError, match=r"scene must be an mpsim.Scene; got dict.*Make one with Scene"):
        mpsim.Simulation(GOOD)
    for door in (mpsim.Simulation, mpsim.tradeoff):
        with pytest.raises(mpsim.InputError, match=r"got str. Use mpsim.Scene.load\('gas'\)\."):
            door("gas")
    with pytest.raises(mpsim.InputError, match=r"settings must be mpsim.Settings; got str.*Use Settings"):
        mpsim.Simulation(gas(5, 0.1), "grid")


USES = {
    "run": lambda sim: sim.run(frames=1),
    "state": lambda sim: sim.state,
    "digest": lambda sim: sim.digest(),
    "add": lambda sim: sim.add([1, 1], [0, 0]),
    "count": lambda sim: sim.count,
    "pids": lambda sim: sim.pids,
}


@pytest.mark.slow
@pytest.mark.parametrize("use", USES)
@pytest.mark.parametrize("method", ["naive", "grid", "parallel"])
def test_a_closed_simulation_says_so(method, use):
    with simulate(gas(20, 0.2), method=method, workers=2) as sim:
        sim.run(frames=3)
    with pytest.raises(mpsim.errors.ClosedError, match=r"closed after frame 3.*no state.*`with` block"):
        USES[use](sim)
    assert "closed after frame 3" in repr(sim)
    assert sim.frame == 3


@pytest.mark.parametrize("method", ["naive", "grid", "parallel", "auto"])
def test_an_empty_scene_runs_and_can_grow(method):
    scene = mpsim.Scene.random(count=0, packing=0.3, radius=0.5)
    with simulate(scene, method=method, workers=2) as sim:
        report = sim.run(frames=5)
        assert (report.frames, report.collisions, sim.state.position.shape) == (5, 0, (0, 2))
    box = mpsim.Scene(width=5, height=5, position=np.empty((0, 2)), velocity=np.empty((0, 2)), radius=0.5)
    with simulate(box, method=method, workers=2) as sim:
        sim.run(frames=2)
        sim.add([2, 2], [1, 0])
        sim.add(np.empty((0, 2)), np.empty((0, 2)))
        sim.run(frames=100)
        assert sim.state.position[0].tolist() == pytest.approx([3, 2])


def test_a_frame_so_short_that_it_is_none_in_the_precision_is_refused():
    """1e-50 is 0 in float32: nothing would ever move."""
    with pytest.raises(mpsim.InputError, match=r"dt.*float32"):
        mpsim.Simulation(gas(5, 0.1), mpsim.Settings(dt=1e-50, precision="float32", method="grid"))


def test_values_that_do_not_fit_the_precision_are_refused():
    """1e300 is a finite float64, and infinite in float32: better said at the start than as a divergence."""
    scene = mpsim.Scene(width=5, height=5, position=[[2, 2]], velocity=[[1e300, 0]], radius=0.5)
    with pytest.raises(mpsim.InputError, match="float32"):
        mpsim.Simulation(scene, mpsim.Settings(precision="float32", method="grid"))
    with simulate(gas(20, 0.2), method="grid", precision="float32") as sim, pytest.raises(mpsim.InputError):
        sim.add([1, 1], [1e300, 0])


@pytest.mark.parametrize(
    "given", [{"until": 1e13}, {"until": 1e308}, {"frames": 9, "measures": ["temperature"], "start": 1e308}]
)
def test_times_that_no_run_reaches_are_refused(given):
    name = "start" if "start" in given else "until"
    with simulate(gas(9, 0.1)) as sim:
        with pytest.raises(
            mpsim.InputError, match=rf"^{name} must be at most 1,000,000,000,000 frames of 0\.01; got 1e\+"
        ):
            sim.run(**given)
        assert sim.run(frames=2).frames == 2


def test_only_float32_is_told_to_take_float64():
    for precision, hint in (
        ("float32", r"Use other units or precision='float64'\."),
        ("float64", r"Use other units\."),
    ):
        with (
            simulate(gas(9, 0.1), precision=precision) as sim,
            pytest.raises(mpsim.InputError, match=f"squares fit; .* {hint}$"),
        ):
            sim.set(3, velocity=(1e200, 0))
