"""Frames asked for one by one are those of long runs, whatever comes between them; so are their reports, kept."""

import _thread
import contextlib
import itertools
import os
import random
import signal
import threading
import time

import numpy as np
import pytest
from support.internals import write
from support.processes import in_another_thread
from support.scenes import gas, simulate, zoo
from support.selection import FORKS, long_but

import mpsim

pytestmark = [pytest.mark.compiled, FORKS]

EVERY = 250  # frames between two of the things that come between


def interrupted(sim, rng):
    """By Ctrl-C, anywhere in calls of a frame each."""
    sim.run(frames=1)
    with contextlib.suppress(KeyboardInterrupt):
        threading.Timer(rng.uniform(0, 0.003), _thread.interrupt_main).start()
        for _ in range(EVERY // 2):
            sim.run(frames=1)
        time.sleep(10)


def used_by_a_fork(sim, rng):
    if not (child := os.fork()):
        try:
            sim.run(frames=1)
        except mpsim.errors.ForkedError:
            os._exit(0)
        os._exit(1)
    assert os.waitpid(child, 0)[1] == 0


BETWEEN = {
    "set": lambda sim, rng: sim.set(rng.randrange(100), velocity=(rng.uniform(-1, 1), rng.uniform(-1, 1))),
    "an observer": lambda sim, rng: sim.run(frames=3, observe=mpsim.Collisions()),
    "a dead worker": lambda sim, rng: [os.kill(pid, signal.SIGKILL) for pid in sim.pids],
    "Ctrl-C": interrupted, "a thread": lambda sim, rng: in_another_thread(lambda: sim.run(2)), "a fork": used_by_a_fork,
}  # fmt: skip


def played(by, method, frames):
    """Digest after frames in calls of so many, with the same things between them, and how a disc that is none ends."""
    rng, ends, names = random.Random(1), [], itertools.cycle(BETWEEN)
    with simulate(gas(100, 0.4), method=method, workers=2, on_worker_death="restart", dt=0.01) as sim:
        while sim.frame < frames:
            for _ in range(EVERY // by):
                sim.run(frames=by)
            BETWEEN[next(names)](sim, rng)
            sim.run(frames=-sim.frame % EVERY)
            ends.append((sim.frame, sim.digest()))
        if method != "event":  # whose discs are checked where they are changed
            write(sim, 7, vx=np.nan)
            with pytest.raises(mpsim.DivergedError) as caught:
                sim.run(frames=by)
            ends.append((caught.value.particle, caught.value.frame))
    return ends


@pytest.mark.parametrize(
    ("method", "frames"),
    long_but(
        [(method, frames) for method in ("naive", "grid", "event", "parallel") for frames in (5_000, 100_000)],
        ("parallel", 5_000), ("event", 5_000),
    ),
)  # fmt: skip
def test_calls_of_one_frame_end_as_calls_of_many(method, frames):
    assert played(1, method, frames) == played(EVERY, method, frames)


@pytest.mark.parametrize("method", long_but(["naive", "grid"], "naive"))
def test_reports_of_single_frames_kept_beyond_the_end_are_those_of_one_run(method):
    with simulate(zoo("heated"), method=method) as sim:
        kept = [sim.run(frames=1) for _ in range(300)]
        done = sim.work
    with simulate(zoo("heated"), method=method) as sim:
        whole = sim.run(frames=300)
    assert np.concatenate([each.times for each in kept], axis=1).shape == whole.times.shape
    assert sum(each.collisions for each in kept) == whole.collisions > 100
    assert done == pytest.approx(whole.work, rel=1e-12)
    assert {name: sum(each.work[name] for each in kept) for name in done} == pytest.approx(whole.work, rel=1e-12)
    assert len({each.work["left"] for each in kept}) > 2, "each has that of its own time"
