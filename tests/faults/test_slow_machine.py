"""A slice of frames is a matter of time: where frames are slower than expected, it ends early."""

import time

import pytest
from support.scenes import gas, simulate

from mpsim.engine.workers.arrays import MOST_FRAMES
from mpsim.kernels.layout import SLICE


@pytest.mark.parametrize(("method", "count"), [("naive", 4000), ("grid", 20_000), ("parallel", 20_000)])
def test_a_command_ends_when_its_time_is_up_and_the_frames_done_are_the_right_ones(method, count):
    """As many frames as a command may hold would take seconds here; Ctrl-C and progress must not wait for them."""
    scene = gas(count, 0.4)
    with simulate(scene, method=method, workers=2) as sim:
        started = time.monotonic()
        part = sim._solver.advance(MOST_FRAMES, sim._solver.choice.workers[0])
        took = time.monotonic() - started
        done = part.times.shape[1]
        assert sim.frame == done < MOST_FRAMES, "the command was not too long, which tests nothing"
        assert SLICE * 1e-9 < took < 10 * SLICE * 1e-9, f"{took:.2f} s for {done} frames"
        assert (part.times.sum(axis=2)[0] > 0).all()
        assert part.times[0].sum() * 1e-9 < took
        found = sim.digest()
    with simulate(scene, method=method, workers=1) as sim:
        sim.run(frames=done)
        assert sim.digest() == found
