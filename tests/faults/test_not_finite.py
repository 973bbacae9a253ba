"""A disc that is not finite ends the run with its name, in the frame that meets it, under every method."""

import re

import numpy as np
import pytest
from support.internals import write
from support.scenes import gas, simulate
from support.selection import long_but

import mpsim

LAYOUTS = [("naive", 1), ("grid", 1), ("parallel", 1), ("parallel", 2), ("parallel", 3)]
COUNT, BEFORE = 900, 7


def run_with(changes, method, workers, precision="float64", count=COUNT):
    """Write values into discs {particle: {field: value}} after some frames; returns what the next run raises."""
    with simulate(gas(count, 0.3, seed=1), method=method, workers=workers, precision=precision) as sim:
        sim.run(frames=BEFORE)
        for particle, values in changes.items():
            write(sim, particle, **values)
        with pytest.raises(mpsim.DivergedError) as caught:
            sim.run(frames=5)
        with pytest.raises(mpsim.errors.ClosedError):
            sim.run(frames=1)
        assert sim.frame == BEFORE
    return caught.value


@pytest.mark.slow
@pytest.mark.parametrize(("method", "workers"), LAYOUTS)
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_a_nan_is_named_with_particle_frame_position_and_velocity(method, workers, precision):
    error = run_with({500: {"x": np.nan, "y": 3.0, "vx": 0.0, "vy": 0.0}}, method, workers, precision)
    assert (error.particle, error.frame) == (500, BEFORE)
    assert np.isnan(error.position[0])
    assert (error.position[1], *error.velocity) == (3.0, 0.0, 0.0)
    assert re.search(r"disc 500 is not finite in frame 7: position \(nan, 3.0\), velocity \(0.0, 0.0\)", str(error))
    assert "smaller dt" in str(error), "the text must say what to do"


@pytest.mark.slow
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("field", ["x", "y", "vx", "vy"])
@pytest.mark.parametrize(("method", "workers"), [("naive", 1), ("grid", 1), ("parallel", 2)])
def test_any_coordinate_that_is_not_finite_is_noticed(method, workers, field, value):
    error = run_with({37: {field: value}}, method, workers, count=60)
    assert (error.particle, error.frame) == (37, BEFORE)


@pytest.mark.slow
@pytest.mark.parametrize(("method", "workers"), long_but(LAYOUTS, ("grid", 1), ("parallel", 3)))
def test_of_several_bad_discs_the_lowest_is_named(method, workers):
    bad = {particle: {"vx": np.nan} for particle in (880, 411, 23, 300, 24)}
    for _ in range(5):
        assert run_with(bad, method, workers).particle == 23


@pytest.mark.slow
@pytest.mark.parametrize("particle", [0, COUNT - 1])
@pytest.mark.parametrize("workers", [1, 2, 3])
def test_the_first_and_the_last_disc_are_watched_too(workers, particle):
    assert run_with({particle: {"y": np.nan}}, "parallel", workers).particle == particle


def slow_start(extra):
    """Disc 0 drifts up along the left wall towards disc 1; many others keep the workers busy."""
    position = [[1.0, 2.0], [1.45, 9.25], *([0.5 + 1.25 * (k % 60), 20 + 1.25 * (k // 60)] for k in range(extra))]
    velocity = [[0.0, 10.0], [0.0, 0.0], *([0.0, 0.0] for _ in range(extra))]
    return mpsim.Scene(width=80, height=200, position=position, velocity=velocity, radius=0.5)


@pytest.mark.slow
@pytest.mark.parametrize("workers", long_but([2, 3], 3))
@pytest.mark.filterwarnings("ignore::mpsim.FastWarning")
def test_the_frame_of_an_overflow_inside_a_long_run_does_not_depend_on_the_workers(workers):
    """Disc 0 is made so fast that its mirrored velocity overflows when it meets disc 1, many frames later."""
    scene = slow_start(extra=5000)
    settings = {"law": "reflect", "precision": "float32", "dt": 0.01}

    def error_of(**which):
        with simulate(scene, **which, **settings) as sim:
            write(sim, 0, vx=3e38)
            with pytest.raises(mpsim.DivergedError) as caught:
                sim.run(frames=10_000)
        return caught.value.particle, caught.value.frame

    expected = error_of(method="grid")
    assert expected[1] > 10, "the overflow must happen in the middle of the run"
    for run in range(4):
        assert error_of(method="parallel", workers=workers) == expected, f"run {run}"


@pytest.mark.filterwarnings("ignore::mpsim.FastWarning")
def test_a_huge_but_finite_velocity_loses_no_disc():
    """Negative control: what is finite goes on, clamped to the box."""
    with simulate(gas(60, 0.3, seed=1), method="grid", precision="float32") as sim:
        sim.run(frames=BEFORE)
        write(sim, 5, vx=1e30)
        sim.run(frames=20)
        assert np.isfinite(sim.state.position).all()
        assert sim.frame == BEFORE + 20


@pytest.mark.long
@pytest.mark.timeout(600)
def test_a_bad_disc_is_named_alike_a_hundred_times_on_more_workers_than_cores(figures):
    """Workers that are late in leaving one command's barrier must still come to the next one's, bad state or not."""
    bad = {particle: {"vx": np.nan} for particle in (880, 411, 23, 300, 24)}
    for _ in range(100):
        error = run_with(bad, "parallel", 5)
        assert (error.particle, error.frame) == (23, BEFORE)
    figures.note("R17", "parallel on 5", "NaN in 5 of 1000 discs, 100 times", "the lowest disc is named", "100 of 100")
