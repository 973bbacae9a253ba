"""One thread at a time changes a simulation; others are refused at once, and may read whole states meanwhile."""

import asyncio
import gc
import os
import threading
import time
from functools import cache

import pytest
from support.compare import overlapping_pairs
from support.processes import assert_clean, blocks_of, run_script
from support.scenes import ALONE, digest_after, lattice, simulate
from support.selection import long_but

import mpsim
from mpsim.engine import batch_size
from mpsim.engine.solvers import events

METHODS = list(ALONE)
PATIENCE = 100
"""Seconds after which a thread counts as hung, on a busy machine."""

CHANGES = {
    "run": lambda sim: sim.run(frames=1),
    "add": lambda sim: sim.add((0.1, 0.1), (0.0, 0.0)),
    "save": lambda sim: sim.save("/dev/null/never"),
    "close": lambda sim: sim.close(),
}


class Running:
    """A simulation that another thread runs in the `with` block, which ends that run; then `error` is what ended it."""

    def __init__(self, sim):
        self.error = None
        self._sim, self._stop, self._begun = sim, threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="runner", daemon=True)

    def __enter__(self):
        self._thread.start()
        assert self._begun.wait(PATIENCE)
        return self

    def __exit__(self, *exception):
        self._stop.set()
        self._thread.join(PATIENCE)
        assert not self._thread.is_alive(), "the run hangs"

    def _run(self):
        try:
            self._sim.run(frames=10**9, progress=self._progress)
        except BaseException as error:
            self.error = error

    def _progress(self, done, of):
        self._begun.set()
        if self._stop.is_set():
            raise ZeroDivisionError


@pytest.mark.parametrize("method", METHODS)
def test_a_change_from_another_thread_is_refused_at_once_and_names_both(method):
    with simulate(lattice(20, 20), method=method, workers=2) as sim:
        with Running(sim) as running:
            for name, change in CHANGES.items():
                started = time.perf_counter()
                with pytest.raises(mpsim.errors.BusyError) as caught:
                    change(sim)
                assert time.perf_counter() - started < 5, "it waited"
                assert str(caught.value).startswith(
                    f"run() of thread 'runner' is in progress; {name}() of thread 'MainThread' was refused. "
                )
        assert isinstance(running.error, ZeroDivisionError), f"the run was disturbed by {running.error!r}"
        frame = sim.frame  # and the lock was let go by the exception
        sim.run(frames=3)
        assert sim.digest() == digest_after(lattice(20, 20), frame + 3, method=ALONE[method])


@pytest.mark.parametrize("method", long_but(METHODS, "parallel", "event"))
def test_threads_that_all_want_to_run_lose_no_frame(method):
    """They did: counts of frames that nobody had run, hangs, and segmentation faults."""
    done, refused = [], []

    def run_often(sim):
        for _ in range(50):
            try:
                sim.run(frames=5)
                done.append(5)
            except mpsim.errors.BusyError as error:
                refused.append(error)
                time.sleep(0.0005)

    with simulate(lattice(12, 12), method=method, workers=2) as sim:
        threads = [threading.Thread(target=run_often, args=(sim,)) for _ in range(3)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(PATIENCE)
        assert sim.frame == sum(done) > 0
        assert sim.digest() == digest_after(lattice(12, 12), sum(done), method=ALONE[method])
    assert len(done) + len(refused) == 150


FRAMES = 300


@cache
def whole_frames(method):
    """Digests of each frame of a scene."""
    with simulate(lattice(40, 40), method=ALONE[method]) as sim:
        return {sim.digest()} | {sim.run(frames=1) and sim.digest() for _ in range(FRAMES)}


def is_whole(state, method):
    """Whether a state is one of those of the scene; of `event` one of an instant, which may lie inside a frame.

    Then no two discs overlap, and no energy is missing.
    """
    if method != "event":
        return state.digest() in whole_frames(method)
    energy = (lattice(40, 40).velocity ** 2).sum()
    overlaps = len(overlapping_pairs(state.position, 1 - 1e-11)[0])
    return not overlaps and (state.velocity**2).sum() == pytest.approx(energy, rel=1e-11)


def one_of_each(states):
    """States without repetitions."""
    return {state.digest(): state for state in states}.values()


@pytest.fixture
def short_slices(monkeypatch):
    """Readers come by more often."""
    monkeypatch.setattr(batch_size, "MOST_SECONDS", 0.0002)
    monkeypatch.setattr(events, "FEWEST_EVENTS", 50)
    monkeypatch.setattr(events, "SECONDS_AT_ONCE", 0.002)


def read_in_a_run(sim, read):
    """What a second thread reads while the simulation runs FRAMES frames; and at how many slices the run stopped."""

    def look():
        while not over:
            found.append(read(sim))

    def now_and_then(done, of):
        """On a busy machine the run may be over before the reader's turn comes: let it come once in five slices."""
        slices.append(done)
        before, end = len(found), time.monotonic() + PATIENCE
        while len(slices) % 5 == 0 and len(found) == before and time.monotonic() < end:
            time.sleep(0.001)

    found, over, slices = [], [], []
    reader = threading.Thread(target=look)
    reader.start()
    try:
        sim.run(frames=FRAMES, progress=now_and_then)
    finally:
        over.append(True)
        reader.join(PATIENCE)
    return found, slices


@pytest.mark.slow
@pytest.mark.parametrize("method", long_but(METHODS, "grid", "parallel", "event"))
def test_a_state_that_another_thread_reads_is_whole(method, short_slices):
    """Never half of two frames, nor of two instants."""
    with simulate(lattice(40, 40), method=method, workers=2) as sim:
        states, slices = read_in_a_run(sim, lambda sim: sim.state)
    found = one_of_each(states)
    assert len(found) > 2, "too few were read while it ran"
    assert all(is_whole(state, method) for state in found)
    assert slices[-1] == FRAMES, "readers have stopped the run from continuing"


@pytest.mark.parametrize("method", long_but(METHODS, "grid", "parallel", "event"))
def test_control_arrays_that_are_read_past_the_lock_are_torn(method):
    for _ in range(20):
        with simulate(lattice(40, 40), method=method, workers=2) as sim:
            states = read_in_a_run(sim, lambda sim: sim._solver.state())[0]
        if not all(is_whole(state, method) for state in one_of_each(states)):
            return
    pytest.fail("no torn state was read: the test above would notice nothing")


def test_many_readers_do_not_stop_a_run_from_continuing():
    def read():
        while not over:
            sim.state  # noqa: B018
            reads.append(1)

    over, reads = [], []
    with simulate(lattice(12, 12), method="grid") as sim:
        readers = [threading.Thread(target=read) for _ in range(4)]
        for reader in readers:
            reader.start()
        try:
            sim.run(frames=20_000)
        finally:
            over.append(True)
            for reader in readers:
                reader.join(PATIENCE)
        assert sim.frame == 20_000
    assert reads, "the control: somebody has read"


class Observing:
    """An observer that does something with the simulation."""

    every = 5

    def __init__(self, act):
        self.act, self.found = act, []

    def look(self, sim, collisions):
        self.found.append(self.act(sim))


@pytest.mark.parametrize("method", METHODS)
def test_what_callbacks_may_do_and_what_they_may_not(method, tmp_path):
    with simulate(lattice(9, 9), method=method, workers=2) as sim:
        reading = Observing(lambda sim: (sim.frame, sim.count, sim.time, len(sim.radii), sim.digest()))
        saving = Observing(lambda sim: sim.save(tmp_path / "run"))
        sim.run(frames=10, observe=[reading, saving])
        assert [found[0] for found in reading.found] == [0, 5, 10]
        with pytest.raises(
            mpsim.errors.BusyError, match=r"^run\(\) of thread 'MainThread' is in progress; run\(\) of the same"
        ):
            sim.run(frames=10, observe=Observing(lambda sim: sim.run(frames=1)))
        assert sim.run(frames=5).frames == 5, "it was let go"
        with pytest.raises(mpsim.errors.ClosedError):
            sim.run(frames=10, observe=Observing(lambda sim: sim.close()))


@pytest.mark.parametrize("where", ["observe", "progress"])
@pytest.mark.parametrize("method", METHODS)
def test_discs_that_a_callback_adds_are_those_that_are_added_between_two_runs(method, where):
    def add(sim):
        k = len(added)
        sim.add((2.5 + 4 * k, 2.5), (0.25, 1.0))  # where nobody is
        added.append(sim.frame)

    scene, added = lattice(9, 9, pitch=4.0), []
    with simulate(scene, method=method, workers=2) as sim:
        given = Observing(add) if where == "observe" else lambda *_: len(added) < 3 and add(sim)
        sim.run(frames=30, **{where: given})
        found, count = sim.digest(), sim.count
    assert count == 81 + len(added) > 81
    with simulate(scene, method=ALONE[method]) as sim:
        frames, added = added, []
        for frame in frames:
            sim.run(frames=frame - sim.frame)
            add(sim)
        sim.run(frames=30 - sim.frame)
        assert sim.digest() == found


@pytest.mark.parametrize("error", [ZeroDivisionError, KeyboardInterrupt, SystemExit])
@pytest.mark.parametrize("where", ["observe", "progress"])
def test_whatever_a_callback_raises_the_next_thread_can_continue(where, error):
    def fail(*_):
        raise error

    found = []
    with simulate(lattice(9, 9), method="grid") as sim:
        with pytest.raises(error):
            sim.run(frames=50, **{where: Observing(fail) if where == "observe" else fail})
        frame = sim.frame
        thread = threading.Thread(target=lambda: found.append(sim.run(frames=2).frames))
        thread.start()
        thread.join(PATIENCE)
        assert found == [2]
        assert sim.digest() == digest_after(lattice(9, 9), frame + 2, method="grid")


def test_the_callback_of_a_run_may_wait_for_a_thread_that_reads():
    """In a callback a run is between two slices: the other thread must not wait for it."""
    found = []

    def wait_for_a_reader(done, of):
        thread = threading.Thread(target=lambda: found.append(sim.frame))
        thread.start()
        thread.join(PATIENCE)

    with simulate(lattice(9, 9), method="grid") as sim:
        sim.run(frames=3, progress=wait_for_a_reader)
    assert found
    assert found[-1] == 3


@pytest.mark.parametrize("method", long_but(METHODS, "grid"))
def test_asyncio_runs_in_a_thread_and_reads_in_the_loop(method):
    async def main():
        read = []
        with simulate(lattice(20, 20), method=method, workers=2) as sim:
            run = asyncio.create_task(asyncio.to_thread(sim.run, frames=3000))
            while not run.done():
                read.append(await asyncio.to_thread(lambda: sim.frame))
                await asyncio.sleep(0.01)
            report = await run
            return read, report.frames, sim.digest()

    read, ran, digest = asyncio.run(main())
    assert read == sorted(read)
    assert (ran, digest) == (3000, digest_after(lattice(20, 20), 3000, method=ALONE[method]))


@pytest.mark.parametrize("method", long_but(METHODS, "parallel"))
def test_garbage_that_another_thread_collects_is_closed_there(method):
    sim = simulate(lattice(9, 9), method=method, workers=2)
    sim.run(frames=2)
    sim._itself = sim  # a cycle: only the collector finds it
    assert blocks_of(os.getpid())
    del sim
    thread = threading.Thread(target=gc.collect)
    thread.start()
    thread.join(PATIENCE)
    assert blocks_of(os.getpid()) == set()


AT_THE_END = """
import atexit, faulthandler, os, signal, sys, threading, time
import mpsim
from support.scenes import digest_after, lattice, simulate

faulthandler.enable()
nowhere = open(os.devnull, "w")
sim, other = (simulate(lattice(20, 20), method="{method}", workers=2) for _ in range(2))
atexit.register(lambda: print("at exit", other.run(frames=5).frames, other.digest() == expected))
expected = digest_after(lattice(20, 20), 5, method="{alone}")
begun = threading.Event()
threading.Thread(target=lambda: sim.run(frames=10**9, progress=lambda *_: begun.set()), daemon=True).start()
threading.Thread(target=lambda: [sim.state for _ in iter(int, 1)], daemon=True).start()
third = simulate(lattice(20, 20), method="{method}", workers=2)
slow = lambda *_: [time.sleep(0.01) or third.frame for _ in range(50)]
threading.Thread(target=lambda: third.run(frames=10**9, progress=slow), daemon=True).start()
signal.signal(signal.SIGUSR1, lambda *_: print("frame", sim.frame > 0))
begun.wait()
signal.raise_signal(signal.SIGUSR1)
for _ in range(20):
    faulthandler.dump_traceback(nowhere, all_threads=True)
    time.sleep(0.01)
"""


@pytest.mark.slow
@pytest.mark.parametrize("method", long_but(METHODS, "parallel"))
def test_a_program_may_end_while_daemon_threads_run_and_read(method):
    """With faulthandler's dumps, a handler of a signal that reads, and something left to do at exit.

    The dumps are asked for by a thread that holds the interpreter. Those of `dump_traceback_later` do not: they look
    into frames that are running, and then end a program of two counting threads by SIGSEGV now and then, too.
    """
    outcome = run_script(AT_THE_END.format(method=method, alone=ALONE[method]))
    assert_clean(outcome)
    assert outcome.out == "frame True\nat exit 5 True\n"


def test_a_subinterpreter_is_refused_by_name():
    """NumPy only warns there, and the first kernel took the process down."""
    outcome = run_script(
        """
        try:
            import _interpreters as interpreters
        except ImportError:
            import _xxsubinterpreters as interpreters
        import sys

        other = interpreters.create("legacy") if sys.version_info >= (3, 13) else interpreters.create(isolated=False)
        text = f"import sys; sys.path[:] = {sys.path!r}; import mpsim"
        try:
            run = interpreters.exec if sys.version_info >= (3, 13) else interpreters.run_string
            print(run(other, text))
        except Exception as error:
            print(error)
        interpreters.destroy(other)
        """,
        flags=(),
    )
    assert outcome.code == 0, outcome.err
    assert "mpsim cannot be imported in a subinterpreter" in outcome.out
