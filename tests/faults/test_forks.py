"""Forks of a process with a simulation, and foreign ones that attach to its block: nothing is shared by accident."""

import concurrent.futures
import contextlib
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from support.processes import (
    SHARED_MEMORY,
    Script,
    assert_clean,
    assert_nothing_left_of,
    blocks_of,
    is_gone,
    run_script,
    wait_until,
)
from support.scenes import ALONE, digest_after, lattice, simulate
from support.selection import FORKS, long_but

import mpsim

pytestmark = [pytest.mark.compiled, FORKS]

METHODS = list(ALONE)
CHILDREN = {
    **{method: {"method": method} for method in METHODS},
    "parallel by fork": {"method": "parallel", "start_method": "fork"},
    "parallel by spawn": {"method": "parallel", "start_method": "spawn"},
}
"""Settings of what a fork runs, by name."""

PATIENCE = 150  # seconds that a fork may take, on a busy machine, before it counts as hung


def in_fork(act):
    """What `act` returns or raises in a fork of this process, which then ends at once, whatever it has open."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        signal.alarm(PATIENCE)
        outcome = None
        try:
            outcome = act()
        except BaseException as error:
            outcome = error
        finally:
            with contextlib.suppress(BaseException), open(writing, "wb") as pipe:
                pickle.dump(outcome, pipe)
            os._exit(0)
    os.close(writing)
    with open(reading, "rb") as pipe:
        text = pipe.read()
    assert os.waitpid(child, 0)[1] == 0, "the fork was ended by a signal"
    return pickle.loads(text)


kept = []


def run_kept():
    """What a pool's process runs: it finds the task in what it has inherited, since no task can be pickled."""
    return kept[-1]()


def fork_executor(act):
    """The same in a process of a pool that forks."""
    kept.append(act)
    context = multiprocessing.get_context("fork")
    with concurrent.futures.ProcessPoolExecutor(1, mp_context=context) as pool:
        return pool.submit(run_kept).result(PATIENCE)


def fork_process(act):
    """The same in a multiprocessing.Process that is forked."""
    ours, theirs = multiprocessing.Pipe()
    child = multiprocessing.get_context("fork").Process(target=lambda: theirs.send(act()))
    child.start()
    assert ours.poll(PATIENCE), "the fork hangs"
    found = ours.recv()
    child.join(PATIENCE)
    return found


FORKS = {"os.fork": in_fork, "executor": fork_executor, "process": fork_process}
MATRIX = [(parent, fork, child) for parent in METHODS for fork in FORKS for child in CHILDREN]
FEW = [("parallel", "os.fork", "parallel by fork"), ("grid", "process", "event"), ("event", "executor", "parallel")]


@pytest.mark.slow
@pytest.mark.parametrize(("parent", "fork", "child"), long_but(MATRIX, *FEW))
def test_a_fork_can_have_simulations_of_its_own(parent, fork, child):
    """Whatever its parent has run: gunicorn --preload, a pool that forks, os.fork."""
    settings = CHILDREN[child]
    with simulate(lattice(20, 20), method=parent, workers=2) as sim:
        sim.run(frames=5)
        found = FORKS[fork](lambda: digest_after(lattice(12, 12), 20, workers=2, **settings))
        sim.run(frames=5)
        assert sim.digest() == digest_after(lattice(20, 20), 10, method=ALONE[parent])
    assert found == digest_after(lattice(12, 12), 20, method=ALONE[settings["method"]])


GIVEN = {
    "run": {"frames": 3}, "add": {"position": (0.1, 0.1), "velocity": (0.0, 0.0)},
    "set": {"ids": 0, "velocity": (0, 0)},
    "kick": {"ids": 0, "impulse": (0.5, 0.0)}, "remove": {"ids": 0}, "change": {"passes": 2},
    "add_wall": {"wall": [(0.1, 0.1), (0.2, 0.1)]}, "save": {"path": "/dev/null/never"},
    "state_between": {"first": 1, "last": 3}, "once": {"act": lambda: 0},
    "nearest": {"x": 1.0, "y": 1.0}, "within": {"shape": ((0, 0), (1, 1))},
}  # fmt: skip
HARMLESS = {"close", "scene", "settings", "resume", "replay", "from_snapshot"}


def tried(sim):
    """What each public name of a simulation does in a fork."""
    found = {}
    for name in set(dir(mpsim.Simulation)) - HARMLESS:
        if name.startswith("_"):
            continue
        try:
            value = getattr(sim, name)
            found[name] = value(*GIVEN.get(name, {}).values()) if callable(value) else value
        except Exception as error:
            found[name] = f"{type(error).__name__}: {error}"
    sim.close()
    sim.close()
    return {name: str(value) for name, value in found.items()}, repr(sim), sim.scene.count


@pytest.mark.parametrize("method", long_but(METHODS, "parallel", "event"))
def test_every_door_is_refused_in_a_fork_and_the_parent_continues_as_if_alone(method):
    """Also where a callback of a run forks, and the fork comes back into the run of its parent."""

    def fork(done, of):
        if not children:
            children.append(os.fork())

    children, parent = [], os.getpid()
    with simulate(lattice(20, 20), method=method, workers=2, start_method="fork") as sim:
        sim.run(frames=5)
        found, words, count = in_fork(lambda: tried(sim))
        refused = f"ForkedError: this simulation was made by process {os.getpid()} and cannot be used in process "
        assert len(found) > 15
        assert {name: text[: len(refused)] for name, text in found.items()} == dict.fromkeys(found, refused)
        assert (words, count) == (f"<Simulation: of process {os.getpid()}>", 400)
        assert sim.frame == 5
        try:
            sim.run(frames=15, progress=fork)
        except mpsim.errors.ForkedError:
            os._exit(7)
        finally:
            if os.getpid() != parent:
                os._exit(8)
        assert os.waitstatus_to_exitcode(os.waitpid(children[0], 0)[1]) == 7
        assert sim.digest() == digest_after(lattice(20, 20), 20, method=ALONE[method])


PARENT = """
import gc, multiprocessing, os, sys, time, warnings
from support.scenes import lattice, simulate

warnings.filterwarnings("ignore", "This process", DeprecationWarning)  # 3.12: fork beside threads
sim = simulate(lattice(20, 20), method="parallel", workers=2)
sim.run(frames=2)
"""


def test_forks_that_end_like_programs_are_silent_and_take_nothing_away():
    """Their end runs what is registered for the end of the parent; nor does a child of multiprocessing."""
    text = """
if (child := os.fork()) == 0:
    sys.exit(0)
print(os.waitpid(child, 0)[1])
if (child := os.fork()) == 0:
    sim.close()
    del sim
    gc.collect()
    os._exit(0)
print(os.waitpid(child, 0)[1])
child = multiprocessing.get_context("fork").Process(target=print, args=("child",))
child.start()
child.join()
sim.run(frames=2)
print(sim.frame)
"""
    outcome = run_script(PARENT + text, warm=True)
    assert_clean(outcome)
    assert outcome.out == "0\n0\nchild\n4\n"


def test_workers_end_with_their_coordinator_although_a_fork_of_it_lives_on():
    """A fork holds the other ends of all pipes open, which would tell workers that their coordinator is gone."""
    text = """
if (child := os.fork()) == 0:
    time.sleep(100)
print(child, *sim.pids)
time.sleep(100)
"""
    with Script(PARENT + text, warm=True) as script:
        child, worker = map(int, script.line().split())
        script.send(signal.SIGKILL)
        assert wait_until(lambda: is_gone(worker), 5), "the worker has outlived its coordinator"
        assert not is_gone(child), "the control: the fork lives"
        os.kill(child, signal.SIGKILL)
        script.finish(10)
        assert_nothing_left_of(script.pid)


def test_a_daemonic_process_runs_on_one_worker_and_logs_it():
    outcome = run_script(
        """
    import logging, multiprocessing
    from support.scenes import digest_after, lattice, simulate

    def work():
        logging.basicConfig(level=logging.INFO, format="%(name)s: %(message)s", force=True)
        with simulate(lattice(20, 20), method="parallel", workers=3) as sim:
            report = sim.run(frames=20)
            print(report.method, report.workers, sim.digest(), sim.pids)

    print(digest_after(lattice(20, 20), 20, method="grid"))
    child = multiprocessing.get_context("fork").Process(target=work, daemon=True)
    child.start()
    child.join()
    """,
        warm=True,
    )
    digest, line = outcome.out.splitlines()
    assert line == f"parallel 1 {digest} []"
    assert outcome.err.count("\n") == 1, outcome.err
    assert "daemonic" in outcome.err


# --- foreign processes

ATTACH = """
import os, sys
from multiprocessing.shared_memory import SharedMemory
memory = SharedMemory(sys.argv[1])
print(memory.size, flush=True)
{}
"""


@pytest.mark.filterwarnings("ignore::mpsim.FastWarning")  # of a box that is too full
@pytest.mark.parametrize("end", long_but(["memory.close()", "os.abort()"], "memory.close()"))
def test_a_foreign_process_that_attached_to_the_block_or_removed_its_name_does_no_harm(end):
    """Before Python 3.13 its resource tracker removes the block's name as it exits, thinking it a leak of its own.

    The mapping itself lives on in coordinator and workers, so the run must go on, grow, and end without an error.
    """
    more = lattice(16, 16)
    with simulate(lattice(8, 8), method="parallel", workers=3, start_method="fork") as sim:
        sim.run(frames=10)
        (name,) = blocks_of(os.getpid())
        command = [sys.executable, "-c", ATTACH.format(end), name]
        foreign = subprocess.run(command, capture_output=True, timeout=30, check=False)
        assert int(foreign.stdout) > 0, foreign.stderr
        time.sleep(0.3)
        (SHARED_MEMORY / name).unlink(missing_ok=True)
        sim.run(frames=10)
        assert sim.digest() == digest_after(lattice(8, 8), 20, method="grid")
        sim.add(np.clip(more.position[:100], 0.5, 8.5), more.velocity[:100])
        sim.run(frames=2)
        assert sim.count == 164
    assert blocks_of(os.getpid()) == set()
