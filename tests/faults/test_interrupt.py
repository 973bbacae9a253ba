"""Ctrl-C, which reaches coordinator and workers alike, is one KeyboardInterrupt; the state stays whole."""

import contextlib
import itertools
import math
import os
import signal
import statistics
import threading
import time
from multiprocessing.process import BaseProcess

import pytest
from support.compare import assert_inside_and_finite, assert_same_bits, overlapping_pairs
from support.processes import Script, assert_nothing_left_of, blocks_of, is_gone
from support.scenes import lattice, simulate, state_after
from support.selection import long_but

import mpsim
from mpsim.engine.solvers import event_windows, events
from mpsim.engine.workers import pool

ENDS_WITHIN = {"running": 2.0, "starting": 5.0}
"""Seconds from Ctrl-C to the end of the process. A slice of frames is 0.05 s, ending Python and workers the rest, on a
busy machine; a worker that is still starting gets 2 s to come to its senses before it is ended."""

SCRIPT = """
import mpsim
from support.scenes import lattice

scene = lattice(100, 100)
print("starting")
with mpsim.Simulation(scene, mpsim.Settings(method="{method}", workers=3), start_method="{start}") as sim:
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


@pytest.mark.slow
@pytest.mark.timeout(60)
@pytest.mark.parametrize("start", long_but(["fork", "spawn", "forkserver"], "forkserver"))
def test_an_interrupt_during_a_run_is_one_keyboard_interrupt(start):
    interrupt(SCRIPT.format(method="parallel", start=start), "running", 0.3)


@pytest.mark.timeout(60)
@pytest.mark.parametrize("method", ["naive", "grid"])
def test_an_interrupt_on_one_process_is_one_keyboard_interrupt(method):
    interrupt(SCRIPT.format(method=method, start="fork"), "running", 0.1, warm=True)


def interrupt_again_and_again(start, pause):
    """Press Ctrl-C until the script has ended, as somebody does who loses patience; how often that was.

    What such a script still prints is in Python's hands: its own end is interrupted too.
    """
    with Script(SCRIPT.format(method="parallel", start=start)) as script:
        while script.line() != "running":
            pass
        pressed = 0
        while not is_gone(script.pid) and pressed < 2000:
            with contextlib.suppress(ProcessLookupError):
                script.send_to_group(signal.SIGINT)
            pressed += 1
            time.sleep(pause)
        outcome = script.finish(15)
        assert_nothing_left_of(script.pid)
    assert outcome.code == -signal.SIGINT, f"{outcome.code}: {outcome.err}"
    assert "worker_main" not in outcome.err, f"a worker's traceback:\n{outcome.err}"
    return pressed


@pytest.mark.slow
@pytest.mark.timeout(60)
@pytest.mark.parametrize("pause", long_but([0.0005, 0.01], 0.0005))
@pytest.mark.parametrize("start", ["fork", "forkserver"])
def test_a_storm_of_interrupts_leaves_nothing_behind(start, pause, figures):
    pressed = interrupt_again_and_again(start, pause)
    assert pressed > 1, "a control: once is no storm"
    deed = f"Ctrl-C every {pause * 1000:g} ms until the end"
    figures.note("R8", f"parallel on 3, {start}", deed, "nothing is left", f"nothing; pressed {pressed} times")


def test_an_interrupt_while_a_simulation_closes_comes_after_it_is_closed(monkeypatch):
    stop = pool.WorkerPool.stop

    def interrupt_and_stop(self):
        signal.raise_signal(signal.SIGINT)
        stop(self)

    sim = simulate(lattice(9, 9), method="parallel", workers=2)
    pids = sim.pids
    monkeypatch.setattr(pool.WorkerPool, "stop", interrupt_and_stop)
    with pytest.raises(KeyboardInterrupt):
        sim.close()
    assert all(map(is_gone, pids))
    assert blocks_of(os.getpid()) == set()


WHILE_LOADING = """
import signal
from numba.core.registry import cpu_target
import mpsim
from support.scenes import lattice

engine = cpu_target.target_context.codegen()._engine._ee
load = engine._object_cache_getbuffer

def interrupt_and_load(module):
    print("loading")
    signal.raise_signal(signal.SIGINT)
    return load(module)

engine._object_cache_getbuffer = interrupt_and_load
mpsim.Simulation(lattice(9, 9), mpsim.Settings(method="{method}", workers=2))
print("made")
"""


@pytest.mark.slow
@pytest.mark.parametrize("method", ["naive", "parallel"])
def test_an_interrupt_while_kernels_are_loaded_is_one_keyboard_interrupt(method):
    """Numba loads machine code from a callback of LLVM, in which Python throws a KeyboardInterrupt away."""
    with Script(WHILE_LOADING.format(method=method)) as script:
        outcome = script.finish(30)
        assert_nothing_left_of(script.pid)
    assert "loading" in outcome.out, "the moment was not hit, which tests nothing"
    assert "made" not in outcome.out, f"Ctrl-C was lost:\n{outcome.err}"
    assert outcome.code == -signal.SIGINT
    assert outcome.err.count("Traceback") == 1, outcome.err


STARTS = long_but([("fork", 0.05), ("spawn", 0.2), ("spawn", 0.5), ("forkserver", 0.2)], ("fork", 0.05), ("spawn", 0.5))


@pytest.mark.slow
@pytest.mark.timeout(60)
@pytest.mark.parametrize(("start", "delay"), STARTS)
def test_an_interrupt_while_workers_start_is_one_keyboard_interrupt(start, delay):
    interrupt(SCRIPT.format(method="parallel", start=start), "starting", delay)


@pytest.mark.long
@pytest.mark.timeout(900)
@pytest.mark.parametrize("start", ["fork", "spawn", "forkserver"])
def test_an_interrupt_at_any_moment_is_one_keyboard_interrupt(start, figures):
    for attempt in range(25):
        interrupt(SCRIPT.format(method="parallel", start=start), "starting", attempt * 0.06)
    deed = "Ctrl-C at 25 moments of start-up and run"
    figures.note("R8", f"parallel on 3, {start}", deed, "one KeyboardInterrupt, nothing left", "25 of 25")


@pytest.mark.slow
@pytest.mark.parametrize(("method", "workers"), [("naive", 1), ("grid", 1), ("parallel", 3)])
def test_an_interrupted_simulation_has_a_whole_number_of_frames_and_can_go_on(method, workers, alarm):
    scene = lattice(9, 9)
    with simulate(scene, method=method, workers=workers) as sim:
        for attempt in range(3):
            with pytest.raises(KeyboardInterrupt), alarm(0.06 + attempt * 0.0137):
                sim.run(frames=10**9)
            frames, state = sim.frame, sim.state
            assert frames > 0
            assert_same_bits(state, state_after(scene, frames, method=method), f"interrupted after frame {frames}")
            sim.run(frames=7)
            expected = state_after(scene, frames + 7, method=method)
            assert_same_bits(sim.state, expected, f"7 frames after an interrupt at {frames}")


@pytest.mark.parametrize("start", ["spawn", "forkserver"])
def test_a_handler_of_the_user_gets_the_interrupt_that_comes_while_a_worker_starts(start, monkeypatch):
    """Whoever handles SIGINT differently, to stop after the current batch for instance, must not get an exception."""
    caught = []
    begin = BaseProcess.start

    def start_and_interrupt(process):
        os.kill(os.getpid(), signal.SIGINT)
        begin(process)

    monkeypatch.setattr(BaseProcess, "start", start_and_interrupt)
    before = signal.signal(signal.SIGINT, lambda number, frame: caught.append(number))
    try:
        with simulate(lattice(9, 9), method="parallel", workers=2, start_method=start) as sim:
            assert sim.run(frames=3).frames == 3
    except KeyboardInterrupt:  # which would end the whole test run
        pytest.fail("a KeyboardInterrupt although the user handles SIGINT")
    finally:
        signal.signal(signal.SIGINT, before)
    assert caught == [signal.SIGINT]


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


@pytest.mark.slow
@pytest.mark.parametrize(("side", "dt"), [(10, 0.01), (10, 1e4), (100, 1e4), (1000, 1e4)])
def test_ctrl_c_ends_an_exact_run_within_a_tenth_of_a_second(side, dt):
    """However long a frame is and however many discs there are.

    Of the processor's time: what other processes take of a core is not the run's, which is one busy thread here.
    """
    with simulate(lattice(side, side), method="event", dt=dt) as sim:
        took = [pressed_while_running(sim, 0.1 + 0.0137 * attempt) for attempt in range(5)]
    assert statistics.median(took) < 0.1, f"processor seconds from Ctrl-C to the end of run: {took}"


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
@pytest.mark.parametrize("workers", [1, 2])
def test_an_exact_run_reports_progress_inside_a_long_frame(workers, monkeypatch):
    with simulate(lattice(100, 100), method="event", workers=workers, dt=1e6) as sim:
        assert len(sim.pids) == workers - 1
        silences = [longest_silence(sim, 0.3) for _ in range(5)]
        assert statistics.median(silences) < 0.1, f"processor seconds without a call of progress: {silences}"
        monkeypatch.setattr(events, "SECONDS_AT_ONCE", 0.5)
        monkeypatch.setattr(event_windows, "PATIENCE", 500_000_000)
        assert longest_silence(sim, 1.5) > 0.1, "a control that must be silent for longer"


@pytest.mark.slow
@pytest.mark.parametrize("dt", [0.01, 300.0])
def test_an_interrupted_exact_run_goes_on_with_the_same_bits(dt, alarm):
    """Ctrl-C may come at any instruction around the kernel: often between short frames, inside long ones."""
    scene = lattice(9, 9)
    with simulate(scene, method="event", dt=dt) as sim:
        for attempt in range(6):
            with pytest.raises(KeyboardInterrupt), alarm(0.02 + attempt * 0.0137):
                sim.run(frames=10**9)
            frames, state = sim.frame, sim.state
            assert_inside_and_finite(state, scene, f"interrupted in frame {frames}")
            assert len(overlapping_pairs(state.position, 1 - 1e-11)[0]) == 0
            energy = (state.velocity**2).sum() / (scene.velocity**2).sum()
            assert energy == pytest.approx(1, abs=1e-11)
            assert frames * dt <= sim.time <= (frames + 1) * dt
        sim.run(frames=2)
        expected = state_after(scene, frames + 2, method="event", dt=dt)
        assert_same_bits(sim.state, expected, f"two frames after six interrupts, the last in frame {frames}")


def interrupted(done, of):
    raise KeyboardInterrupt


def test_a_frame_that_was_interrupted_counts_whole():
    """What the walls got before Ctrl-C belongs to the frame: the pressure is per time of whole frames."""
    names = ["pressure", "collision_rate", "momentum_drift"]
    with (
        simulate(lattice(9, 9), method="event", dt=50.0) as whole,
        simulate(lattice(9, 9), method="event", dt=50.0) as sim,
    ):
        expected = whole.run(frames=2, measures=names).measures
        with pytest.raises(KeyboardInterrupt):
            sim.run(frames=2, measures=names, progress=interrupted)
        assert sim.frame == 0 < sim.time
        found = sim.run(frames=2, measures=names).measures
    for name in ("pressure", "collision_rate"):
        assert found[name].value == expected[name].value
    assert math.isnan(found["momentum_drift"].value), "no state of the start of that frame is known"
    assert expected["momentum_drift"].value < 1e-12


def test_an_interrupt_in_the_progress_callback_leaves_the_state_whole():
    scene = lattice(9, 9)
    with simulate(scene, method="grid") as sim:
        with pytest.raises(KeyboardInterrupt):
            sim.run(frames=10**6, progress=interrupted)
        assert_same_bits(sim.state, state_after(scene, sim.frame, method="grid"), "after the callback's interrupt")
        assert isinstance(sim.run(frames=3), mpsim.Report)
