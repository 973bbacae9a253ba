"""Ctrl-C is one KeyboardInterrupt, SIGTERM a checkpoint; a user's handler is served, and the state stays whole."""

import contextlib
import itertools
import json
import os
import signal
import statistics
import threading
import time
from multiprocessing.process import BaseProcess

import pytest
from support.checkpoints import frame_in
from support.compare import assert_inside_and_finite, assert_same_bits, overlapping_pairs
from support.processes import Script, assert_nothing_left_of, blocks_of, is_gone
from support.scenes import gas, lattice, split, state_after
from support.selection import FORKS, long_but, slow_but

import mpsim

pytestmark = [pytest.mark.compiled, FORKS]

ENDS_WITHIN = {"running": 2.0, "starting": 10.0}
"""Seconds from Ctrl-C to the end of the process. A slice of frames is 0.05 s, ending Python and workers the rest, on a
busy machine; each of two workers that are still starting gets 2 s to come to its senses before it is ended."""

SMALL = lattice(9, 9)


def begin(scene, method="grid", **settings):
    return mpsim.Simulation(scene, **split({"method": method, "start_method": "fork", **settings}))


@contextlib.contextmanager
def handled(number, handler):
    before = signal.signal(number, handler)
    try:
        yield
    finally:
        signal.signal(number, before)


# --- Ctrl-C that ends a program

SCRIPT = """
import mpsim
from support.scenes import lattice, split

scene = lattice(100, 100)
print("starting")
with mpsim.Simulation(scene, **split(dict(method="parallel", workers=3, start_method="{start}"))) as sim:
    print("running")
    sim.run(frames=10**9)
"""


def interrupt(text, after, delay, warm=False):
    """Run a script, press Ctrl-C a while after it has printed a word, and check how it ends."""
    with Script(text, warm=warm) as script:
        while script.line() != after:
            pass
        time.sleep(delay)
        pressed = time.monotonic()
        script.send_to_group(signal.SIGINT)
        outcome = script.finish(15)
        took = time.monotonic() - pressed
        assert_nothing_left_of(script.pid)
    assert outcome.code == -signal.SIGINT, f"{outcome.code}: {outcome.err}"
    # It may come while functools or the compiler handles an exception of its own: then that one's is written above.
    tracebacks = outcome.err.count("Traceback") - outcome.err.count("During handling of the above exception")
    assert tracebacks == 1, f"more or less than one traceback:\n{outcome.err}"
    assert outcome.err.rstrip().endswith("KeyboardInterrupt"), outcome.err
    assert "Exception ignored" not in outcome.err, outcome.err
    assert took < ENDS_WITHIN[after], f"it took {took:.1f} s to end"


@pytest.mark.timeout(60)
@pytest.mark.parametrize(
    ("start", "after"), slow_but([("fork", "running"), ("spawn", "starting")], ("fork", "running"))
)
def test_ctrl_c_is_one_keyboard_interrupt(start, after):
    interrupt(SCRIPT.format(start=start), after, 0.4, warm=start == "fork")


@pytest.mark.long
@pytest.mark.timeout(900)
@pytest.mark.parametrize("start", ["fork", "spawn", "forkserver"])
def test_ctrl_c_at_any_moment_is_one_keyboard_interrupt(start):
    for attempt in range(25):
        interrupt(SCRIPT.format(start=start), "starting", attempt * 0.06)


@pytest.mark.timeout(60)
@pytest.mark.parametrize(
    "start", [pytest.param("fork", marks=pytest.mark.slow), pytest.param("forkserver", marks=pytest.mark.long)]
)
def test_a_storm_of_interrupts_leaves_nothing_behind(start):
    """As somebody presses who loses patience. What such a script still prints is in Python's hands."""
    with Script(SCRIPT.format(start=start)) as script:
        while script.line() != "running":
            pass
        pressed = 0
        while not is_gone(script.pid) and pressed < 2000:
            with contextlib.suppress(ProcessLookupError):
                script.send_to_group(signal.SIGINT)
            pressed += 1
            time.sleep(0.0005)
        outcome = script.finish(15)
        assert_nothing_left_of(script.pid)
    assert outcome.code == -signal.SIGINT, f"{outcome.code}: {outcome.err}"
    assert "worker_main" not in outcome.err, f"a worker's traceback:\n{outcome.err}"
    assert pressed > 1, "a control: once is no storm"


# --- Ctrl-C after which a simulation goes on


def assert_whole(sim, scene, frames):
    """Of the exact solver the instant may lie inside a frame: then no two discs overlap, and no energy is missing."""
    if sim.settings.method != "event":
        assert_same_bits(sim.state, state_after(scene, frames, method="grid", contact="impact"), f"frame {frames}")
        return
    state = sim.state
    assert_inside_and_finite(state, scene, f"interrupted in frame {frames}")
    assert len(overlapping_pairs(state.position, 1 - 1e-11)[0]) == 0
    assert (state.velocity**2).sum() == pytest.approx((scene.velocity**2).sum(), rel=1e-11)
    assert frames * sim.settings.dt <= sim.time <= (frames + 1) * sim.settings.dt


@pytest.mark.parametrize(
    ("method", "settings"), [("parallel", {"workers": 3}), ("event", {"dt": 0.01}), ("event", {"dt": 300.0})]
)
def test_an_interrupted_simulation_is_whole_and_goes_on_with_the_same_bits(method, settings):
    """Ctrl-C may come at any instruction: between short frames, or inside long ones."""
    alone = {"method": "grid" if method == "parallel" else method, "contact": "impact", **settings, "workers": 1}
    with begin(SMALL, method, **settings) as sim:
        for attempt in range(2):
            threading.Timer(0.03 + attempt * 0.0137, os.kill, (os.getpid(), signal.SIGINT)).start()
            with pytest.raises(KeyboardInterrupt):
                sim.run(frames=10**9)
            frames = sim.frame
            assert_whole(sim, SMALL, frames)
        sim.run(frames=2)
        assert_same_bits(sim.state, state_after(SMALL, frames + 2, **alone), f"interrupted, last in frame {frames}")
        with pytest.raises(KeyboardInterrupt):
            sim.run(frames=10**6, progress=interrupted)
        assert sim.run(frames=3).frames == 3


def interrupted(done, of):
    raise KeyboardInterrupt


def pressed_while_running(sim, delay):
    """Processor seconds from Ctrl-C until `run` has ended with KeyboardInterrupt, after so long a run."""
    pressed = []

    def press():
        pressed.append(time.process_time())
        os.kill(os.getpid(), signal.SIGINT)

    threading.Timer(delay, press).start()
    with pytest.raises(KeyboardInterrupt):
        sim.run(frames=10**9)
    return time.process_time() - pressed[0]


def longest_silence(sim, seconds):
    """The most processor seconds between two calls of `progress` while one long frame runs so long."""
    calls = [time.process_time()]

    def progress(done, frames):
        assert (done, frames) == (0, 1)
        calls.append(time.process_time())
        if calls[-1] - calls[0] > seconds:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sim.run(frames=1, progress=progress)
    return max(later - earlier for earlier, later in itertools.pairwise(calls))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "side", "dt"),
    long_but([("event", 10, 0.01), ("event", 100, 1e4), ("naive", 60, 0.01)], ("event", 100, 1e4)),
)
def test_ctrl_c_and_progress_come_through_within_a_tenth_of_a_second(method, side, dt):
    """However long a frame is and however many discs there are; of the processor's time, as other processes take some.

    As many frames as a command may hold would take seconds.
    """
    with begin(lattice(side, side), method, dt=dt) as sim:
        took = [pressed_while_running(sim, 0.1 + 0.0137 * attempt) for attempt in range(3)]
        assert statistics.median(took) < 0.15, f"processor seconds from Ctrl-C to the end of run: {took}"
        if dt > 1 and side == 100:
            silences = [longest_silence(sim, 0.3) for _ in range(3)]
            assert statistics.median(silences) < 0.1, f"processor seconds without a call of progress: {silences}"


# --- signals that come while mpsim must not be disturbed


def test_signals_that_come_at_the_birth_and_at_the_end_of_a_block_are_handled_afterwards(monkeypatch):
    """All of them, by what handled them before, though one raises; and nothing is left."""

    def sending(call, *numbers):
        def send(*arguments, **named):
            for number in numbers:
                signal.raise_signal(number)
            return call(*arguments, **named)

        return send

    import _posixshmem  # noqa: PLC0415 - what makes and removes shared memory

    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGCHLD)]
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    with monkeypatch.context() as patch:
        patch.setattr(_posixshmem, "shm_open", sending(_posixshmem.shm_open, signal.SIGINT))
        with pytest.raises(KeyboardInterrupt):
            begin(SMALL)
    assert blocks_of(os.getpid()) == set()
    sim = begin(SMALL, "parallel", workers=2)
    pids = sim.pids
    with monkeypatch.context() as patch:
        patch.setattr(_posixshmem, "shm_unlink", sending(_posixshmem.shm_unlink, signal.SIGINT))
        with pytest.raises(KeyboardInterrupt):
            sim.close()
    assert all(map(is_gone, pids))
    assert blocks_of(os.getpid()) == set()

    def fail(number, frame):
        caught.append((number, frame is not None))
        raise ZeroDivisionError

    caught, numbers = [], (signal.SIGUSR1, signal.SIGUSR2)
    with handled(numbers[0], fail), handled(numbers[1], fail):
        with monkeypatch.context() as patch:
            patch.setattr(_posixshmem, "shm_open", sending(_posixshmem.shm_open, *numbers))
            with pytest.raises(ZeroDivisionError):
                begin(SMALL)
        assert [signal.getsignal(number) for number in numbers] == [fail, fail]
    assert sorted(caught) == [(number, True) for number in numbers]
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGCHLD)] == before
    assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == mask


@pytest.mark.parametrize("start", slow_but(["forkserver", "spawn"], "forkserver"))
def test_a_handler_of_the_user_gets_the_ctrl_c_that_comes_while_a_worker_starts(start, monkeypatch):
    """Whoever handles SIGINT differently, to stop after the current batch for instance, must not get an exception."""
    caught, launch = [], BaseProcess.start

    def start_and_interrupt(process):
        os.kill(os.getpid(), signal.SIGINT)
        launch(process)

    monkeypatch.setattr(BaseProcess, "start", start_and_interrupt)
    with handled(signal.SIGINT, lambda number, frame: caught.append(number)):
        try:
            with begin(SMALL, "parallel", workers=2, start_method=start) as sim:
                assert sim.run(frames=3).frames == 3
        except KeyboardInterrupt:  # which would end the whole test run
            pytest.fail("a KeyboardInterrupt although the user handles SIGINT")
    assert caught == [signal.SIGINT]


# --- SIGTERM

TERMINATED = """
import signal, sys
import mpsim
from support.scenes import lattice, split

{before}
settings = dict(method="{method}", workers={workers}, dt={dt}, start_method="{start}")
sim = mpsim.Simulation(lattice(20, 20), **split(settings))
print("running")
sim.run(frames=10**9{options})
"""


def terminated(path, method="parallel", start="fork", before="", checkpoint=True, dt=0.01):
    """Run, end the whole group by SIGTERM, and require that nothing is left; code and errors."""
    options = f", checkpoint={str(path)!r}, checkpoint_every=10**9" if checkpoint else ""
    workers = 3 if method == "parallel" else 1
    text = TERMINATED.format(method=method, workers=workers, start=start, options=options, before=before, dt=dt)
    with Script(text, warm=start == "fork") as script:
        assert script.line() == "running"
        time.sleep(0.2)
        script.send_to_group(signal.SIGTERM)
        outcome = script.finish(20)
        assert_nothing_left_of(script.pid)
    return outcome.code, outcome.err


@pytest.mark.parametrize(
    ("method", "start", "dt"),
    slow_but(
        [("grid", "fork", 0.01), ("parallel", "fork", 0.01), ("event", "fork", 1e6), ("parallel", "forkserver", 0.01)],
        ("parallel", "fork", 0.01),
        ("event", "fork", 1e6),
    ),
)
def test_sigterm_writes_a_checkpoint_that_goes_on_with_the_same_bits(method, start, dt, tmp_path):
    path, scene = tmp_path / "run", lattice(20, 20)
    assert terminated(path, method, start, dt=dt) == (143, "")
    with mpsim.Simulation.resume(path, workers=1) as sim:
        frame = sim.frame
        if dt > 1:
            assert frame == 0 < sim.time
            return
        assert frame > 0
        sim.run(frames=10)
        alone = "grid" if method == "parallel" else method
        assert sim.digest() == state_after(scene, frame + 10, method=alone, contact="impact").digest()


def test_sigterm_without_a_checkpoint_does_what_it_did(tmp_path):
    assert terminated(tmp_path / "run", checkpoint=False) == (-signal.SIGTERM, "")
    handler = "signal.signal(signal.SIGTERM, lambda *_: sys.exit(7))"
    assert terminated(tmp_path / "run", "grid", checkpoint=False, before=handler) == (7, "")
    assert not list(tmp_path.iterdir())


def test_the_handler_of_sigterm_is_back_after_a_run_and_none_is_lost_that_comes_at_its_end(tmp_path):
    """The progress callback is called after the last checkpoint of the run."""

    def mine(number, frame):
        caught.append(number)

    caught, place = [], tmp_path / "run"
    with handled(signal.SIGTERM, mine), begin(lattice(4, 4)) as sim:
        sim.run(frames=3, checkpoint=place)
        assert signal.getsignal(signal.SIGTERM) is mine
        for frames, at in ((10**9, 0), (5, 5)):
            press = lambda done, of, at=at: done >= at and signal.raise_signal(signal.SIGTERM)  # noqa: E731
            with pytest.raises(SystemExit) as ended:
                sim.run(frames=frames, checkpoint=place, progress=press)
            assert ended.value.code == 143
            assert signal.getsignal(signal.SIGTERM) is mine
            assert frame_in(place) == sim.frame
    assert caught == []


# --- handlers that use a simulation


def test_a_signal_handler_may_read_while_its_thread_is_reading():
    """The run waited for the reader, and the reader, in its handler, for the run."""

    def handler(*_):
        if not stop:
            seen.append(sim.frame)
            signal.setitimer(signal.ITIMER_REAL, 0.001)

    def run_until_seen():
        while len(seen) < 30:
            sim.run(frames=500)

    seen, stop = [], []
    with handled(signal.SIGALRM, handler), begin(lattice(30, 30)) as sim:
        thread = threading.Thread(target=run_until_seen)
        thread.start()
        signal.setitimer(signal.ITIMER_REAL, 0.001)
        while thread.is_alive():
            sim.state  # noqa: B018
        stop.append(True)
        signal.setitimer(signal.ITIMER_REAL, 0)
        assert (sim.frame % 500, seen) == (0, sorted(seen))


# --- searches of settings

CANDIDATES = [mpsim.Settings(dt=dt, method="grid") for dt in (0.1, 0.05)]


def trade(path, **options):
    return mpsim.tradeoff(gas(20, 0.3), CANDIDATES, until=5, replicas=2, path=path, **options)


def kept_in(path):
    return path.read_bytes().splitlines()[1:] if path.exists() else []


@pytest.mark.slow
@pytest.mark.parametrize(("what", "done"), long_but([("accuracy", 13), ("timing", 1)], ("accuracy", 13)))
def test_ctrl_c_keeps_what_a_trade_has_finished_and_the_next_call_does_the_rest_alone(what, done, tmp_path):
    path = tmp_path / "kept.json"

    def press(number, of, kind):
        if (kind, number) == (what, done):
            raise KeyboardInterrupt

    threads = threading.active_count()
    with pytest.raises(KeyboardInterrupt):
        trade(path, progress=press)
    assert threading.active_count() == threads, "no thread goes on"
    kept = len(kept_in(path))
    assert kept >= done
    resumed = trade(path)
    keys = [json.loads(line)["key"] for line in kept_in(path)]
    assert len(set(keys)) == len(keys), "what was kept is not run again"
    assert len(keys) > kept, "the control: the interruption came before the end"
    assert trade(path) == resumed
    assert [row.errors for row in resumed.rows] == [row.errors for row in trade(None).rows]
    assert [each.name for each in tmp_path.iterdir()] == ["kept.json"]


SEARCH = """
import mpsim
from mpsim import Settings
from support.scenes import gas

if __name__ == "__main__":
    print("begun")
    candidates = [Settings(dt=dt, method="grid") for dt in (0.1, 0.05)]
    mpsim.{call}
    print("over")
"""
TRADE = "tradeoff(gas(20, 0.3), candidates, until={until}, replicas=2, path={path!r}, progress=lambda *a: print(*a))"
TUNE = "tune(gas(20, 0.3), {'pressure': 0.01}, until=1e6)"


@pytest.mark.timeout(120)
@pytest.mark.parametrize(
    ("call", "number"),
    slow_but([(TRADE, signal.SIGINT), (TRADE, signal.SIGTERM), (TUNE, signal.SIGTERM)], (TRADE, signal.SIGINT)),
    ids=["trade", "trade, SIGTERM", "tune, SIGTERM"],
)
def test_a_signal_ends_a_search_of_long_runs_within_seconds_and_leaves_nothing(call, number, tmp_path):
    """Each run would take minutes; threads that nobody waits for must not go on, nor may the tracker complain."""
    path = tmp_path / "kept"
    text = call if call == TUNE else call.format(until=1e6, path=str(path))
    with Script(SEARCH.format(call=text), warm=True) as script:
        while not blocks_of(script.pid):
            time.sleep(0.05)
        time.sleep(0.5)
        begun = time.monotonic()
        script.send_to_group(number)
        outcome = script.finish(30)
        took = time.monotonic() - begun
        assert_nothing_left_of(script.pid)
    assert "over" not in outcome.out
    assert took < 4, f"it took {took:.1f} s to end"
    if number == signal.SIGTERM:
        assert (outcome.code, outcome.err) == (143, "")
    else:
        assert outcome.code == -signal.SIGINT, outcome.err
        assert outcome.err.count("Traceback") == 1, outcome.err
        assert outcome.err.rstrip().endswith("KeyboardInterrupt")
