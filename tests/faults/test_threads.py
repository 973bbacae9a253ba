"""One thread at a time changes a simulation; others are refused at once, and may read whole states meanwhile."""

import gc
import logging
import os
import signal
import threading
import time
import warnings
from functools import cache

import pytest
from support.compare import overlapping_pairs
from support.processes import blocks_of, in_another_thread
from support.scenes import ALONE, digest_after, lattice, simulate
from support.selection import FORKS, long_but

import mpsim

pytestmark = [pytest.mark.compiled, FORKS]

METHODS = list(ALONE)
PATIENCE = 100  # seconds after which a thread counts as hung, on a busy machine


def begin(scene, method, **settings):
    return simulate(scene, method=method, workers=2, start_method="fork", **settings)


# --- changes

CHANGES = {
    "run": lambda sim: sim.run(frames=1),
    "add": lambda sim: sim.add((0.1, 0.1), (0.0, 0.0)),
    "save": lambda sim: sim.save("/dev/null/never"),
    "close": lambda sim: sim.close(),
}


@pytest.mark.parametrize("method", long_but(METHODS, "parallel", "event"))
def test_a_change_from_another_thread_is_refused_at_once_and_names_both(method):
    def progress(done, of):
        begun.set()
        if stop.is_set():
            raise ZeroDivisionError

    def run():
        try:
            sim.run(frames=10**9, progress=progress)
        except BaseException as error:
            ended.append(error)

    stop, begun, ended = threading.Event(), threading.Event(), []
    with begin(lattice(20, 20), method) as sim:
        thread = threading.Thread(target=run, name="runner", daemon=True)
        thread.start()
        assert begun.wait(PATIENCE)
        for name, change in CHANGES.items():
            started = time.perf_counter()
            with pytest.raises(mpsim.errors.BusyError) as caught:
                change(sim)
            assert time.perf_counter() - started < 5, "it waited"
            rule = f"run() of thread 'runner' is in progress; {name}() of thread 'MainThread' was refused. "
            assert str(caught.value).startswith(rule)
        stop.set()
        thread.join(PATIENCE)
        assert isinstance(ended[0], ZeroDivisionError), f"the run was disturbed by {ended}"
        frame = sim.frame  # and the lock was let go by the exception
        sim.run(frames=3)
        assert sim.digest() == digest_after(lattice(20, 20), frame + 3, method=ALONE[method])


@pytest.mark.parametrize("method", long_but(["grid", "parallel", "event"], "parallel"))
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

    with begin(lattice(12, 12), method) as sim:
        threads = [threading.Thread(target=run_often, args=(sim,)) for _ in range(3)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(PATIENCE)
        assert sim.frame == sum(done) > 0
        assert sim.digest() == digest_after(lattice(12, 12), sum(done), method=ALONE[method])
    assert len(done) + len(refused) == 150


# --- readers

FRAMES = 120


@cache
def whole_frames():
    """Digests of each frame of a scene."""
    with simulate(lattice(40, 40), method="grid") as sim:
        return {sim.digest()} | {sim.run(frames=1) and sim.digest() for _ in range(FRAMES)}


def is_whole(state, method):
    """Whether a state is one of those of the scene; of `event` one of an instant, which may lie inside a frame.

    Then no two discs overlap, and no energy is missing.
    """
    if method != "event":
        return state.digest() in whole_frames()
    energy = (lattice(40, 40).velocity ** 2).sum()
    overlaps = len(overlapping_pairs(state.position, 1 - 1e-11)[0])
    return not overlaps and (state.velocity**2).sum() == pytest.approx(energy, rel=1e-11)


def read_in_a_run(sim, read, readers=1):
    """What other threads read while the simulation runs FRAMES frames."""

    def look():
        while not over:
            found.append(read(sim))

    def now_and_then(done, of):
        """On a busy machine the run may be over before the reader's turn comes."""
        before, end = len(found), time.monotonic() + PATIENCE
        while len(found) == before and time.monotonic() < end:
            time.sleep(0.001)

    found, over = [], []
    threads = [threading.Thread(target=look) for _ in range(readers)]
    for thread in threads:
        thread.start()
    try:
        while sim.frame < FRAMES:
            sim.run(frames=20, progress=now_and_then)
    finally:
        over.append(True)
        for thread in threads:
            thread.join(PATIENCE)
    return {state.digest(): state for state in found}.values()


@pytest.mark.parametrize("method", long_but(["grid", "parallel", "event"], "parallel"))
def test_a_state_that_other_threads_read_is_whole_and_they_do_not_stop_a_run(method):
    """Never half of two frames, nor of two instants."""
    with begin(lattice(40, 40), method) as sim:
        states = read_in_a_run(sim, lambda sim: sim.state, readers=3)
        assert sim.frame == FRAMES
    assert len(states) > 2, "too few were read while it ran"
    assert all(is_whole(state, method) for state in states)


def test_garbage_that_another_thread_collects_is_closed_there():
    circle = [begin(lattice(9, 9), "parallel")]
    circle.append(circle)
    circle[0].run(frames=2)
    assert blocks_of(os.getpid())
    del circle
    in_another_thread(gc.collect, PATIENCE)
    assert blocks_of(os.getpid()) == set()


# --- callbacks


class Observing:
    """An observer that does something with the simulation."""

    every = 5

    def __init__(self, act):
        self.act, self.found = act, []

    def observe(self, sim, collisions):
        self.found.append(self.act(sim))


@pytest.mark.parametrize("method", long_but(METHODS, "grid", "event"))
def test_what_callbacks_may_do_and_what_they_may_not(method, tmp_path):
    """What they add is what is added between two runs; a run inside a run is refused."""
    scene, added = lattice(9, 9, pitch=4.0), []

    def add(sim):
        sim.add((2.5 + 4 * len(added), 2.5), (0.25, 1.0))  # where nobody is
        added.append(sim.frame)

    def wait_for_a_reader(done, of):
        """In a callback a run is between two slices: the other thread must not wait for it."""
        read.append(in_another_thread(lambda: sim.frame, PATIENCE))

    read = []
    with begin(scene, method) as sim:
        reading = Observing(lambda sim: (sim.frame, sim.count, sim.time, len(sim.radii), sim.digest()))
        saving = Observing(lambda sim: sim.save(tmp_path / "run"))
        sim.run(frames=10, observe=[reading, saving], progress=wait_for_a_reader)
        assert [found[0] for found in reading.found] == [0, 5, 10]
        assert read[-1] == 10
        rule = r"^run\(\) of thread 'MainThread' is in progress; run\(\) of the same"
        with pytest.raises(mpsim.errors.BusyError, match=rule):
            sim.run(frames=10, observe=Observing(lambda sim: sim.run(frames=1)))
        start = sim.frame
        sim.run(frames=10, observe=Observing(add))
        sim.run(frames=10, progress=lambda *_: len(added) < 5 and add(sim))
        found, count, frames = sim.digest(), sim.count, added
        with pytest.raises(mpsim.errors.ClosedError):
            sim.run(frames=10, observe=Observing(lambda sim: sim.close()))
    assert count == 81 + len(frames) > 84
    with simulate(scene, method=ALONE[method]) as sim:
        sim.run(frames=start)
        added = []
        for frame in frames:
            sim.run(frames=frame - sim.frame)
            add(sim)
        sim.run(frames=start + 20 - sim.frame)
        assert sim.digest() == found


@pytest.mark.parametrize("error", [ZeroDivisionError, KeyboardInterrupt, SystemExit])
def test_whatever_a_callback_raises_the_next_thread_can_continue(error):
    def fail(*_):
        raise error

    with begin(lattice(9, 9), "grid") as sim:
        for given in ({"observe": Observing(fail)}, {"progress": fail}):
            with pytest.raises(error):
                sim.run(frames=50, **given)
            frame = sim.frame
            assert in_another_thread(lambda: sim.run(frames=2).frames, PATIENCE) == 2
            assert sim.digest() == digest_after(lattice(9, 9), frame + 2, method="grid")


# --- warnings, and lines of the log


class Waiting:
    """Waits, each time that it is called, for a thread that reads; `frames` is what it has read."""

    def __init__(self, sim):
        self.frames, self.calls, self._sim = [], 0, sim

    def __call__(self, *given, **named):
        self.calls += 1
        thread = threading.Thread(target=lambda: self.frames.append(self._sim.frame), daemon=True)
        thread.start()
        thread.join(20)


def test_who_gets_a_warning_or_a_line_of_the_log_may_wait_for_a_reader(monkeypatch):
    """They were given while the run held the simulation: a deadlock."""
    with begin(lattice(9, 9), "grid", dt=0.01) as sim, warnings.catch_warnings():
        warnings.simplefilter("always")
        monkeypatch.setattr(warnings, "showwarning", hook := Waiting(sim))
        sim.add((1.2, 1.2), (1000.0, 0.0))
        assert hook.calls == len(hook.frames) == 1
    with begin(lattice(12, 12), "parallel", on_worker_death="restart") as sim:
        handler = logging.Handler()
        handler.emit = Waiting(sim)
        logging.getLogger("mpsim").addHandler(handler)
        try:
            sim.run(frames=5)
            os.kill(sim.pids[0], signal.SIGKILL)
            sim.run(frames=50)
        finally:
            logging.getLogger("mpsim").removeHandler(handler)
        assert handler.emit.calls == len(handler.emit.frames) >= 1
        assert sim.digest() == digest_after(lattice(12, 12), 55, method="grid")


def test_nothing_is_added_as_often_as_the_warning_of_it_is_an_error():
    """The second time the disc was added without a word."""
    with begin(lattice(9, 9), "grid", dt=0.01) as sim:
        for _ in range(2):
            with pytest.raises(mpsim.FastWarning):
                sim.add((1.2, 1.2), (1000.0, 0.0))
            assert sim.count == 81
        with warnings.catch_warnings(record=True) as given:
            warnings.simplefilter("always")
            sim.add((1.2, 1.2), (1000.0, 0.0))
            sim.add((2.4, 1.2), (1000.0, 0.0))
            sim.run(frames=5)
        assert (sim.count, len(given)) == (83, 1), "once it has been given it is not given again"
