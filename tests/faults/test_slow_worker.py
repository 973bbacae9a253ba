"""A worker that is slow, stopped for a while, or out of step makes a run slow, never wrong; waiting costs no CPU."""

import os
import signal
import threading
import time

import psutil
import pytest
from support.compare import assert_same_bits
from support.internals import set_abort
from support.processes import assert_clean, run_script, wait_until
from support.scenes import lattice, simulate, state_after

import mpsim
from mpsim.kernels import layout


@pytest.mark.slow
def test_a_worker_stopped_for_two_seconds_is_waited_for_and_changes_nothing():
    scene, frames = lattice(40, 40), 400
    expected = state_after(scene, frames, method="grid")
    with simulate(scene, method="parallel", workers=3) as sim:
        sim.run(frames=1)
        os.kill(sim.pids[0], signal.SIGSTOP)
        threading.Timer(2, os.kill, (sim.pids[0], signal.SIGCONT)).start()
        started = time.monotonic()
        report = sim.run(frames=frames - 1)
        assert time.monotonic() - started > 1.5, "the worker was not stopped, which tests nothing"
        assert_same_bits(sim.state, expected, "after a stop of 2 s")
    longest = report.frame_seconds.argmax()
    assert report.frame_seconds[longest] > 1.5
    assert report.phase_seconds["wait"][longest, 0] > 1.5, "the time lost must show as waiting"


def test_waiting_for_a_stopped_worker_burns_little_cpu():
    with simulate(lattice(40, 40), method="parallel", workers=2) as sim:
        sim.run(frames=1)
        os.kill(sim.pids[0], signal.SIGSTOP)
        threading.Timer(1.5, os.kill, (sim.pids[0], signal.SIGCONT)).start()
        before = time.process_time()
        sim.run(frames=10)
        spent = time.process_time() - before
    assert spent < 0.75, f"{spent:.2f} s of CPU during 1.5 s of waiting"


ON_ONE_CORE = """
import os, time
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
import mpsim
from support.scenes import lattice, simulate

found = []
for method, workers in (("grid", 1), ("parallel", 3)):
    with simulate(lattice(40, 40), method=method, workers=workers, start_method="fork") as sim:
        sim.run(frames=100)
        started = time.process_time()
        report = sim.run(frames=1000)
        found.append((sim.digest(), float(report.frame_seconds.mean())))
(digest, alone), (same, shared) = found
print(digest == same, shared / alone)
"""


def test_workers_that_share_one_core_are_slow_and_right(figures):
    """A barrier among three on one core means three changes of process; it must not mean three time slices (4 ms)."""
    outcome = run_script(ON_ONE_CORE, warm=True)
    assert_clean(outcome)
    same, factor = outcome.out.split()
    assert same == "True"
    assert float(factor) < 40, f"a frame took {factor} times as long; a time slice at each barrier would be 100"
    found = f"the same, in {float(factor):.1f} times the time"
    figures.note("R13", "parallel on 3", "all pinned to one core", "digest of grid", found)


@pytest.mark.slow
def test_an_idle_pool_burns_no_cpu():
    with simulate(lattice(40, 40), method="parallel", workers=3) as sim:
        sim.run(frames=20)
        time.sleep(0.2)
        workers = [psutil.Process(pid) for pid in sim.pids]
        before = [sum(worker.cpu_times()[:2]) for worker in workers]
        time.sleep(1)
        spent = [sum(worker.cpu_times()[:2]) - start for worker, start in zip(workers, before, strict=True)]
    assert max(spent) < 0.03, f"seconds of CPU in one idle second, by worker: {spent}"


@pytest.mark.slow
def test_a_pool_that_slept_wakes_up_for_the_next_run():
    scene = lattice(20, 20)
    with simulate(scene, method="parallel", workers=3) as sim:
        for pause in (0, 0.001, 0.003, 0.01, 0.1) * 3:
            time.sleep(pause)
            sim.run(frames=2)
        assert_same_bits(sim.state, state_after(scene, 30, method="grid"), "after pauses")


HELD_UP = """
import time
from support.scenes import lattice, simulate

with simulate(lattice(20, 20), method="parallel", workers=2) as sim:
    pool = sim._solver._pool
    wake = pool.wake
    for pause in (0.005, 0.02, 0.1):
        pool.wake = lambda: (wake(), time.sleep(pause))
        time.sleep(0.05)
        sim.run(frames=2)
print("done")
"""


@pytest.mark.slow
def test_a_coordinator_held_up_between_waking_workers_and_giving_the_command_still_gets_them():
    """On a busy machine the coordinator may lose its core at that moment; the workers must not go to sleep for good."""
    outcome = run_script(HELD_UP, bound=20, warm=True)
    assert_clean(outcome)
    assert outcome.out == "done\n"


def test_a_worker_that_does_not_come_in_time_is_an_error_that_says_so():
    sim = simulate(lattice(20, 20), method="parallel", workers=2)
    sim.run(frames=1)
    set_abort(sim, layout.STALLED)
    with pytest.raises(mpsim.errors.WorkerStalledError, match=r"has not reached a barrier within 120 s.*start again"):
        sim.run(frames=1)
    with pytest.raises(mpsim.errors.ClosedError):
        sim.run(frames=1)


@pytest.mark.long
@pytest.mark.timeout(300)
def test_a_worker_stopped_for_good_ends_the_run_and_is_ended_too():
    sim = simulate(lattice(20, 20), method="parallel", workers=3)
    pids = sim.pids
    os.kill(pids[1], signal.SIGSTOP)
    with pytest.raises(mpsim.errors.WorkerStalledError, match="worker 2"):
        sim.run(frames=10)
    assert wait_until(lambda: not any(psutil.pid_exists(pid) for pid in pids), 10)


def test_more_workers_than_cores_are_slow_but_not_catastrophic():
    """A barrier that only spins costs some 4 ms here, five of them a frame; yielding keeps it far below."""
    workers = 2 * (psutil.cpu_count() or 1) + 1
    with simulate(lattice(20, 20), method="parallel", workers=min(workers, 9)) as sim:
        sim.run(frames=20)
        seconds = sim.run(frames=200).frame_seconds
    assert sorted(seconds)[100] < 0.01, f"median frame {sorted(seconds)[100] * 1e3:.2f} ms on {workers} workers"
