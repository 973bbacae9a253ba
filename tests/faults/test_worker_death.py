"""A worker that dies is noticed within a second, and named with its signal, frame and phase; nothing is left."""

import os
import signal
import threading
import time
from contextlib import suppress
from functools import partial
from pathlib import Path

import pytest
from support.internals import block_name, peek
from support.processes import SHARED_MEMORY, Script, assert_nothing_left_of, is_gone, wait_until
from support.scenes import lattice, simulate
from support.selection import long_but

import mpsim

NOTICED_WITHIN = 1.0
"""Seconds between the death and the exception that reports it."""

PHASES = ["move", "sort", "even columns", "odd columns"]


class Killer(threading.Thread):
    """Thread that runs `deed` a moment after the frames have begun, and keeps what it returns or raises."""

    def __init__(self, deed):
        super().__init__()
        self._deed = deed
        self.result, self.error = None, None

    def run(self):
        try:
            time.sleep(0.1)
            self.result = self._deed()
        except BaseException as error:
            self.error = error


def is_stopped(pid):
    """Whether the process has really stopped, which it does a little after the signal."""
    return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "T"


def kill_in_phase(sim, worker, phase):
    """Stop the worker again and again until it is found in this phase; kill it there. Returns when, and its frame."""
    pid = sim.pids[worker - 1]
    for attempt in range(5000):
        os.kill(pid, signal.SIGSTOP)
        assert wait_until(lambda: is_stopped(pid), 2)
        found, frame = peek(sim, worker)
        if found == phase:
            os.kill(pid, signal.SIGKILL)
            return time.monotonic(), frame
        os.kill(pid, signal.SIGCONT)
        time.sleep(0.0005 + attempt % 7 * 0.0003)
    raise AssertionError(f"worker {worker} was never found in phase {phase!r}")


def kill_at_barrier(sim, worker, other):
    """Hold another worker up, so that this one waits at a barrier for certain; kill it there while that one is held."""
    victim, held_up = sim.pids[worker - 1], sim.pids[other - 1]
    os.kill(held_up, signal.SIGSTOP)
    before, now = None, peek(sim, worker)
    while now != before:  # on a busy machine it may be long on its way to the barrier
        time.sleep(0.1)
        before, now = now, peek(sim, worker)
    os.kill(victim, signal.SIGKILL)
    moment = time.monotonic()
    assert wait_until(lambda: is_gone(victim), 5)
    with suppress(ProcessLookupError):  # its death was noticed, and all were stopped
        os.kill(held_up, signal.SIGCONT)
    return moment, now[1]


def death_during_run(deed, workers=3):
    """What a run raises in which `deed(sim)` kills a worker; checks what every death has in common."""
    sim = simulate(lattice(200, 200), method="parallel", workers=workers, precision="float32")
    pids, block = sim.pids, block_name(sim)
    killer = Killer(lambda: deed(sim))
    killer.start()
    with pytest.raises(mpsim.WorkerDiedError) as caught:
        sim.run(frames=10**6)
    noticed = time.monotonic()
    killer.join()
    assert killer.error is None, killer.error
    moment, frame = killer.result
    assert noticed - moment < NOTICED_WITHIN, f"noticed after {noticed - moment:.2f} s"
    assert caught.value.frame == frame
    assert_over(sim, pids, block)
    return caught.value


def assert_over(sim, pids, block):
    """Require that the simulation is closed, its workers gone, and its block removed."""
    assert [is_gone(pid) for pid in pids] == [True] * len(pids)
    assert not (SHARED_MEMORY / block).exists()
    with pytest.raises(mpsim.errors.ClosedError, match="closed after frame"):
        sim.run(frames=1)
    sim.close()


@pytest.mark.slow
@pytest.mark.parametrize("worker", long_but([1, 2], 2))
@pytest.mark.parametrize("phase", PHASES)
def test_a_death_in_any_phase_is_named_in_full(phase, worker):
    error = death_during_run(lambda sim: kill_in_phase(sim, worker, phase))
    assert (error.worker, error.exitcode, error.phase) == (worker, -signal.SIGKILL, phase)
    for word in (f"worker {worker}", str(error.pid), "signal 9 (SIGKILL)", f"frame {error.frame}", f"'{phase}'"):
        assert word in str(error)


@pytest.mark.slow
@pytest.mark.parametrize(("worker", "other"), [(1, 2), (2, 1)])
def test_a_death_at_a_barrier_is_a_death_in_phase_wait(worker, other):
    error = death_during_run(lambda sim: kill_at_barrier(sim, worker, other))
    assert (error.worker, error.exitcode, error.phase) == (worker, -signal.SIGKILL, "wait")


def test_another_signal_is_named_too():
    """Not SIGTERM, which workers leave to the coordinator."""

    def terminate(sim):
        os.kill(sim.pids[0], signal.SIGUSR1)
        return time.monotonic(), None

    sim = simulate(lattice(100, 100), method="parallel", workers=2)
    killer = Killer(lambda: terminate(sim))
    killer.start()
    with pytest.raises(mpsim.WorkerDiedError, match=r"signal 10 \(SIGUSR1\)"):
        sim.run(frames=10**6)
    killer.join()


@pytest.mark.parametrize("pause", [0, 0.3])
def test_a_death_between_runs_is_noticed_by_the_next_run(pause):
    sim = simulate(lattice(30, 30), method="parallel", workers=3)
    sim.run(frames=5)
    pids, block, before = sim.pids, block_name(sim), sim.digest()
    os.kill(pids[1], signal.SIGKILL)
    time.sleep(pause)
    if pause:
        assert sim.digest() == before, "the state must stay readable until somebody wants to go on"
    moment = time.monotonic()
    with pytest.raises(mpsim.WorkerDiedError) as caught:
        sim.run(frames=10**6)
    assert time.monotonic() - moment < NOTICED_WITHIN
    assert (caught.value.worker, caught.value.frame) == (2, 5)
    assert_over(sim, pids, block)


@pytest.mark.filterwarnings("ignore::mpsim.FastWarning")  # of discs that are added where others are
def test_a_death_before_a_growth_that_moves_the_workers_is_noticed():
    sim = simulate(lattice(8, 8), method="parallel", workers=2)
    sim.run(frames=5)
    pids, block = sim.pids, block_name(sim)
    os.kill(pids[0], signal.SIGKILL)
    more = lattice(8, 8)
    with pytest.raises(mpsim.WorkerDiedError, match="worker 1"):
        sim.add(more.position[:40], more.velocity[:40])
    assert_over(sim, pids, block)


def test_several_deaths_at_once_are_one_exception():
    sim = simulate(lattice(100, 100), method="parallel", workers=4)
    pids, block = sim.pids, block_name(sim)
    killer = Killer(lambda: [os.kill(pid, signal.SIGKILL) for pid in pids])
    killer.start()
    with pytest.raises(mpsim.WorkerDiedError) as caught:
        sim.run(frames=10**6)
    killer.join()
    assert caught.value.worker in (1, 2, 3)
    assert_over(sim, pids, block)


START_UP = """
import multiprocessing, os, signal, threading, time
import mpsim
from support.scenes import lattice

def kill_the_first_worker():
    while not multiprocessing.active_children():
        time.sleep(0.0005)
    time.sleep({delay})
    os.kill(multiprocessing.active_children()[0].pid, signal.SIGKILL)

threading.Thread(target=kill_the_first_worker).start()
try:
    mpsim.Simulation(lattice(20, 20), mpsim.Settings(method="parallel", workers=2), start_method="{start}")
except mpsim.WorkerDiedError as error:
    print(error.worker, error.exitcode, error.phase)
"""


@pytest.mark.parametrize(
    ("start", "delay"), long_but([("spawn", 0.0), ("spawn", 0.1), ("forkserver", 0.0)], ("spawn", 0.1))
)
def test_a_death_during_start_up_is_named(start, delay):
    with Script(START_UP.format(start=start, delay=delay)) as script:
        outcome = script.finish(30)
        assert outcome.out == "1 -9 start-up\n", outcome.err
        assert (outcome.code, outcome.err) == (0, "")
        assert_nothing_left_of(script.pid)


def test_a_worker_that_raises_hands_over_its_traceback():
    """A worker whose kernels cannot be loaded ends with an error; its text must reach the user."""
    text = """
    import mpsim, mpsim.engine.workers.worker as worker
    from support.scenes import lattice

    def broken(block):
        raise ValueError("the kernels are broken")

    worker.load_kernels = broken
    try:
        mpsim.Simulation(lattice(20, 20), mpsim.Settings(method="parallel", workers=2), start_method="fork")
    except mpsim.WorkerDiedError as error:
        print(error.worker, error.exitcode, error.phase, "ValueError: the kernels are broken" in str(error))
    """
    with Script(text, warm=True) as script:
        assert script.finish(30).out == "1 1 start-up True\n"
        assert_nothing_left_of(script.pid)


def kill_later(pid, delay):
    time.sleep(delay)
    os.kill(pid, signal.SIGKILL)


@pytest.mark.long
@pytest.mark.timeout(900)
def test_a_hundred_deaths_at_random_moments_are_all_noticed(figures):
    for attempt in range(100):
        sim = simulate(lattice(60, 60), method="parallel", workers=3)
        pids, block = sim.pids, block_name(sim)
        killer = Killer(partial(kill_later, pids[attempt % 2], attempt * 0.0007))
        killer.start()
        with pytest.raises(mpsim.WorkerDiedError) as caught:
            sim.run(frames=10**6)
        killer.join()
        assert caught.value.worker == attempt % 2 + 1, f"attempt {attempt}"
        assert_over(sim, pids, block)
    figures.note(
        "R14", "parallel on 3", "a worker killed at 100 moments", "WorkerDiedError, and nothing left", "100 of 100"
    )
