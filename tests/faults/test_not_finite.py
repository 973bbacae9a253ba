"""A disc that is not finite ends the run with its name, in the frame that meets it, under every method."""

import re

import numpy as np
import pytest
from support.internals import write
from support.scenes import gas, split
from support.selection import FORKS, long_but

import mpsim

pytestmark = [pytest.mark.compiled, FORKS]

BEFORE = 7
METHODS = [("naive", 1), ("grid", 1), ("parallel", 3)]


def begin(method, workers, precision="float64", count=300):
    settings = {"method": method, "workers": workers, "start_method": "fork", "precision": precision}
    return mpsim.Simulation(gas(count, 0.3, seed=1), **split(settings))


def error_of(changes, method, workers, precision="float64", count=300):
    """What a run raises after values were written into discs, {disc: {field: value}}: no input can bring them there."""
    with begin(method, workers, precision, count) as sim:
        sim.run(frames=BEFORE)
        for disc, values in changes.items():
            write(sim, disc, **values)
        with pytest.raises(mpsim.DivergedError) as caught:
            sim.run(frames=5)
        with pytest.raises(mpsim.errors.ClosedError):
            sim.run(frames=1)
        assert sim.frame == BEFORE
    return caught.value


@pytest.mark.parametrize(
    ("method", "workers", "precision"),
    long_but(
        [(*method, precision) for method in METHODS for precision in ("float64", "float32")],
        *((*method, "float64") for method in METHODS),
    ),
)
def test_a_disc_that_is_not_finite_is_named_with_frame_position_and_velocity(method, workers, precision):
    """The lowest of several, whichever worker meets it; the first and the last; any coordinate."""
    error = error_of({200: {"x": np.nan, "y": 3.0, "vx": 0.0, "vy": 0.0}}, method, workers, precision)
    assert (error.particle, error.frame) == (200, BEFORE)
    assert np.isnan(error.position[0])
    assert (error.position[1], *error.velocity) == (3.0, 0.0, 0.0)
    assert re.search(r"disc 200 is not finite in frame 7: position \(nan, 3.0\), velocity \(0.0, 0.0\)", str(error))
    assert "smaller dt" in str(error), "the text must say what to do"
    several = {disc: {"vx": np.nan} for disc in (280, 211, 23, 100, 24)}
    assert error_of(several, method, workers, precision).particle == 23
    for disc in (0, 299):
        assert error_of({disc: {"y": np.nan}}, method, workers, precision).particle == disc
    for number, value in enumerate([np.nan, np.inf, -np.inf, np.inf]):
        field = ["x", "y", "vx", "vy"][number]
        assert error_of({37: {field: value}}, method, workers, precision, 60).particle == 37, (field, value)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::mpsim.FastWarning")
def test_the_frame_of_an_overflow_inside_a_long_run_does_not_depend_on_the_workers():
    """Disc 0 is so fast that its mirrored velocity overflows when it meets disc 1, many frames later.

    The control: what is finite goes on, clamped to the box.
    """
    others = [[0.5 + 1.25 * (k % 60), 20 + 1.25 * (k // 60)] for k in range(5000)]
    position = np.array([[1.0, 2.0], [1.45, 9.25], *others])
    velocity = np.zeros_like(position)
    velocity[0] = (0.0, 10.0)
    scene = mpsim.Scene(width=80, height=200, position=position, velocity=velocity, radius=0.5)
    settings, found = {"law": "reflect", "precision": "float32", "dt": 0.01, "contact": "push"}, []
    for method, workers in [("grid", 1)] + [("parallel", 3)] * 4:
        with mpsim.Simulation(scene, mpsim.Settings(method=method, workers=workers, **settings)) as sim:
            write(sim, 0, vx=3e38)
            with pytest.raises(mpsim.DivergedError) as caught:
                sim.run(frames=10_000)
        found.append((caught.value.particle, caught.value.frame))
    assert found == [found[0]] * 5
    assert found[0][1] > 10, "the overflow must happen in the middle of the run"
    with begin("grid", 1, "float32", 60) as sim:
        write(sim, 5, vx=1e30)
        sim.run(frames=20)
        assert np.isfinite(sim.state.position).all()
