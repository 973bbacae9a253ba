"""Signals at every line and every call inside a constructor: nothing is held by nobody, at once, not at the exit.

Ctrl-C, and an alarm whose handler raises, as in a program that limits the time of what it calls.
"""

import contextlib
import dis
import gc
import multiprocessing
import os
import signal
import sys
import threading
from multiprocessing import resource_tracker
from pathlib import Path

import pytest
from support.processes import SHARED_MEMORY, Script, assert_nothing_left_of, blocks_of, run_script
from support.scenes import gas, lattice, simulate
from support.selection import long_but

import mpsim
from mpsim.engine.coordinator import Coordinator
from mpsim.engine.workers import shared

METHODS = ["naive", "grid", "parallel", "event"]
SAMPLES = {"naive": 20, "grid": 60, "event": 30, "parallel": 12}
"""Moments that the default suite tries, spread evenly."""

MOST = {"naive": 8000, "grid": 8000, "event": 8000, "parallel": 400}
"""Moments that --long tries, spread evenly, too: of parallel, whose workers take a while to start, as time allows."""


WHOLE_AT_RETURN = Coordinator._begin.__code__
"""What has returned when a simulation is whole."""


class Alarm(Exception):  # noqa: N818
    """A limit of time of a user's program."""


SENDERS = {}
"""How to send a signal; this thread gets the others."""

SIGNALS = {"Ctrl-C": (signal.SIGINT, KeyboardInterrupt), "alarm": (signal.SIGALRM, Alarm)}


@pytest.fixture
def alarms_raise():
    """An alarm raises, and the system gives it to another thread: what the main thread has blocked is no help then."""

    def ring(*_):
        raise Alarm

    def send():
        try:
            signal.pthread_kill(other.ident, signal.SIGALRM)
        finally:
            os.read(heard, 1)  # now it is there, and Python has noted it

    before, over = signal.signal(signal.SIGALRM, ring), threading.Event()
    heard, tell = os.pipe()
    os.set_blocking(tell, False)
    signal.set_wakeup_fd(tell, warn_on_full_buffer=False)
    other = threading.Thread(target=over.wait, name="other")
    other.start()
    SENDERS[signal.SIGALRM] = send
    yield
    del SENDERS[signal.SIGALRM]
    over.set()
    other.join()
    signal.set_wakeup_fd(-1)
    os.close(heard)
    os.close(tell)
    signal.signal(signal.SIGALRM, before)


class Press:
    """Sends this process a signal once, at the `number`-th line, call or return of Python code in the `with` block.

    A return of a function in C counts, too: that is when Python really looks for signals. The signal is a real one, so
    that it waits where signals are held back.

    Attributes:
        count: of such moments so far.
        made: whether a simulation was whole before: who catches the exception then holds it.
    """

    def __init__(self, number, kind=signal.SIGINT):
        self.count = 0
        self.made = False
        self._number, self._kind = number, kind

    def __enter__(self):
        sys.setprofile(self._in_c)
        sys.settrace(self._in_python)
        return self

    def __exit__(self, *exception):
        sys.settrace(None)
        sys.setprofile(None)

    def _in_python(self, frame, event, argument):
        if event == "return" and frame.f_code is WHOLE_AT_RETURN and self.count + 1 <= self._number:
            self.made = True
        # A door ends by stores. Python looks for signals after calls only.
        if event != "line" or not (frame.f_code.co_name == "door" or leaves_a_with(frame)):
            self._moment()
        return self._in_python

    def _in_c(self, frame, event, argument):
        if event == "c_return" or (event == "c_call" and argument.__name__ != "__exit__"):  # a lock's, let go before
            self._moment()

    def _moment(self):
        self.count += 1
        if self.count == self._number:
            SENDERS.get(self._kind, lambda: signal.raise_signal(self._kind))()


def leaves_a_with(frame):
    """Whether the next instructions load the three None with which `__exit__` is called: no call comes in between.

    Where the block returns a value, that is put below them first.
    """
    code, at = frame.f_code, frame.f_lasti
    if code.co_code[at] == dis.opmap["SWAP"]:
        at += 2
    opcodes, (argument, *others) = code.co_code[at : at + 6 : 2], code.co_code[at + 1 : at + 6 : 2]
    same = set(opcodes) == {dis.opmap["LOAD_CONST"]} and set(others) == {argument}
    return same and code.co_consts[argument] is None


def resources():
    """What a process could be left with."""
    descriptors = {name: read_link(name) for name in os.listdir("/proc/self/fd")}
    return (
        blocks_of(os.getpid()),
        {child.pid for child in multiprocessing.active_children()},
        {name: link for name, link in descriptors.items() if link},
        [signal.getsignal(number) for number, _ in SIGNALS.values()],
        signal.pthread_sigmask(signal.SIG_BLOCK, ()),
        {thread.name for thread in threading.enumerate()},
        sys.modules["__main__"],
    )


def read_link(descriptor):
    """What a descriptor leads to; None for that of the listing itself."""
    with contextlib.suppress(FileNotFoundError):
        return os.readlink(f"/proc/self/fd/{descriptor}")


def moments_of(act):
    """How many moments there are."""
    with Press(0) as counter:
        act()
    return counter.count


def pressed_at(number, act, name="Ctrl-C"):
    """Send a signal at a moment of `act`, which must end by its exception. Returns what is left, and was left then.

    None if `act` had fewer moments this time.

    Of a view of the block that the traceback holds the mapping lives as long as that, and with it its descriptor; its
    name is gone before. A whole simulation that the traceback holds goes with it.
    """
    kind, exception = SIGNALS[name]
    counter = Press(number, kind)
    try:
        with counter:
            act()
        assert counter.count < number, f"{name} at moment {number} was lost"
        return None
    except exception:
        blocks, children, *_ = ((), ()) if counter.made else resources()
    now = resources()
    return now[0].union(blocks), now[1].union(children), *now[2:]


def tried(moments, samples, most, request):
    """Which moments are tried, the last one included."""
    samples = min(moments, most if request.config.getoption("--long") else samples)
    return sorted({1 + index * (moments - 1) // (samples - 1) for index in range(samples)})


def constructor(how, scene, settings, folder):
    """A way to a simulation, whose kernels are compiled, and whose fork server and tracker run.

    `resume` reads a file, and moves to another block.
    """
    with mpsim.Simulation(scene, settings) as sim:
        sim.run(frames=2)
        path = sim.save(folder / "run.mpsim")
    if how == "resume":
        return lambda: mpsim.Simulation.resume(path, workers=settings.workers)
    return lambda: mpsim.Simulation(scene, settings)


CONSTRUCTORS = [(name, how, method) for name in SIGNALS for how in ("Simulation", "resume") for method in METHODS]
FEW = [("Ctrl-C", "Simulation", "parallel"), ("Ctrl-C", "Simulation", "event"), ("Ctrl-C", "resume", "grid")]


@pytest.mark.slow
@pytest.mark.timeout(3000)
@pytest.mark.usefixtures("alarms_raise")
@pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")  # opened by the call at whose return it came
@pytest.mark.parametrize(("name", "how", "method"), long_but(CONSTRUCTORS, *FEW))
def test_a_signal_at_any_line_of_a_constructor_leaves_nothing(name, how, method, request, tmp_path, figures):
    kept = []

    def construct():
        kept.append(make())

    make = constructor(how, lattice(9, 9), mpsim.Settings(method=method, workers=2), tmp_path)
    make().close()
    gc.collect()
    before = resources()
    moments = moments_of(construct)
    kept.pop().close()
    assert resources() == before, "the control: closed, it leaves nothing"
    numbers = tried(moments, SAMPLES[method] // (1 if how == "Simulation" else 2), MOST[method], request)
    for number in numbers:
        left = pressed_at(number, construct, name)
        if kept:  # it came after the constructor, or not at all
            kept.pop().close()
            left = resources()
        assert left == before, f"{name} at moment {number} of {moments}"
    with make() as sim:
        assert sim.run(frames=2).frames == 2
    what = f"{name} at lines and calls of {'a constructor' if how == 'Simulation' else 'resume'}"
    figures.note("R20", method, what, "nothing is left", f"nothing; {len(numbers)} of {moments} moments tried")


ROOMY = lattice(9, 9, pitch=2.0)
CHANGES = {"add": lambda sim: sim.add((1.5625, 1.5625), (0.0, 0.0)), "close": lambda sim: sim.close()}


def left_of_a_change(change, method, number):
    """Blocks and workers that are left when an alarm has come at a moment of a change, and the simulation is closed."""
    sim = simulate(ROOMY, method=method, workers=2)
    press = Press(number, signal.SIGALRM)
    with contextlib.suppress(Alarm), press:
        CHANGES[change](sim)
    if change == "add":
        with contextlib.suppress(mpsim.errors.ClosedError):
            assert len(sim.state.position) == sim.count in (81, 82)
            assert sim.run(frames=2).frames == 2
    sim.close()
    left = blocks_of(os.getpid()), multiprocessing.active_children()
    del sim
    for name in blocks_of(os.getpid()):
        (SHARED_MEMORY / name).unlink()
        resource_tracker.unregister(f"/{name}", "shared_memory")
    return press.count, left


@pytest.mark.slow
@pytest.mark.timeout(3000)
@pytest.mark.usefixtures("alarms_raise")
@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("method", long_but(METHODS, "event", "grid"))
def test_an_alarm_at_any_line_of_a_change_leaves_nothing(method, change, request):
    moments, _ = left_of_a_change(change, method, 0)
    for number in tried(moments, 60, MOST[method] // 4, request):
        assert left_of_a_change(change, method, number)[1] == (set(), []), f"moment {number} of {moments}"


@pytest.mark.usefixtures("alarms_raise")
def test_control_an_alarm_leaves_a_block_where_signals_are_not_held_back(monkeypatch):
    for module in ("shutdown", "coordinator", "workers.shared"):
        monkeypatch.setattr(f"mpsim.engine.{module}.interrupts_held_back", contextlib.nullcontext)
    monkeypatch.setattr("mpsim.engine.shutdown._open", {})  # what is half closed would be tried for ever at the exit
    moments, _ = left_of_a_change("close", "event", 0)
    assert any(left_of_a_change("close", "event", number)[1] != (set(), []) for number in range(1, moments))


def test_control_a_block_that_nobody_owns_yet_is_noticed(monkeypatch):
    """A constructor that makes the block before anybody knows of it."""

    def construct():
        block = shared.SharedBlock({})
        block._owner = False
        (Path("/dev/shm") / f"mpsim-{os.getpid()}-0123abcd").touch()
        (Path("/dev/shm") / f"mpsim-{os.getpid()}-0123abcd").unlink()

    before, moments = resources(), moments_of(construct)
    try:
        assert any(pressed_at(number, construct) != before for number in range(1, moments + 1))
    finally:
        (Path("/dev/shm") / f"mpsim-{os.getpid()}-0123abcd").unlink(missing_ok=True)


@pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")  # as above
@pytest.mark.parametrize("method", long_but(METHODS, "grid"))
def test_ctrl_c_at_any_line_of_a_run_lets_the_simulation_go(method, request):
    """Whoever comes next can use it: another thread, too."""

    def in_another_thread():
        found.append(sim.run(frames=1).frames)

    found = []
    with simulate(lattice(9, 9), method=method, workers=2) as sim:
        moments = moments_of(lambda: sim.run(frames=1))
        for number in tried(moments, 80, MOST[method], request):
            with contextlib.suppress(KeyboardInterrupt), Press(number):
                sim.run(frames=1)
            thread = threading.Thread(target=in_another_thread)
            thread.start()
            thread.join(100)
            assert found.pop() == 1, f"Ctrl-C at moment {number} of {moments}"


@pytest.mark.parametrize("what", [KeyboardInterrupt, TimeoutError, MemoryError])
@pytest.mark.parametrize("where", ["posix_fallocate", "fill_features"])
def test_ctrl_c_where_it_used_to_leave_the_block_until_the_exit(where, what, monkeypatch):
    """Each of the two raises by itself; a time limit of the user is not taken for a refusal of the system."""

    def interrupt(*_):
        raise what

    monkeypatch.setattr(
        f"os.{where}" if where == "posix_fallocate" else f"mpsim.engine.solvers.block.{where}", interrupt
    )
    with pytest.raises(what) as caught:
        simulate(lattice(9, 9), method="grid")
    assert blocks_of(os.getpid()) == set(), "looked at while the traceback lives"
    del caught


TUNING = """
import mpsim
from mpsim.studies import ensemble
from support.scenes import gas

run = ensemble.long_run
ensemble.long_run = lambda *given: print("running") or run(*given)
mpsim.{call}
print("over")
"""
CALLS = {
    "tune": "tune(gas(20, 0.3), {'pressure': 0.01}, until=1e6)",
    "tradeoff": "tradeoff(gas(20, 0.3), [mpsim.Settings(dt=0.1, method='grid')], until=1e6, replicas=2)",
}


@pytest.mark.slow
@pytest.mark.parametrize("call", long_but(CALLS, "tune"))
def test_sigterm_to_a_search_of_settings_closes_what_it_has_open(call):
    """The resource tracker would complain of blocks that nobody has removed."""
    with Script(TUNING.format(call=CALLS[call]), warm=True) as script:
        while script.line() != "running":
            pass
        script.send(signal.SIGTERM)
        outcome = script.finish(60)
        assert_nothing_left_of(script.pid)
    assert (outcome.code, outcome.err) == (143, "")
    assert "over" not in outcome.out


def test_sigterm_that_the_system_gives_to_another_thread_ends_a_search_too():
    """The main thread waits for its threads meanwhile; it must look now and then, or it would until they are done."""
    text = TUNING.replace(
        'print("running")', "time.sleep(1) or signal.pthread_kill(threading.get_ident(), signal.SIGTERM)"
    )
    outcome = run_script(f"import signal, threading, time\n{text.format(call=CALLS['tune'])}", bound=20, warm=True)
    assert (outcome.code, outcome.out, outcome.err) == (143, "", "")


def test_sigterm_is_left_alone_where_somebody_handles_it():
    caught = []
    before = signal.signal(signal.SIGTERM, lambda *_: caught.append(1))
    try:
        mpsim.tradeoff(
            gas(20, 0.3),
            [mpsim.Settings(dt=0.1, method="grid")],
            until=2.0,
            replicas=2,
            measures=["overlap"],
            progress=lambda *_: caught or signal.raise_signal(signal.SIGTERM),
        )
    finally:
        signal.signal(signal.SIGTERM, before)
    assert caught == [1]
    assert signal.getsignal(signal.SIGTERM) == before


@pytest.mark.slow
def test_a_program_that_is_interrupted_while_it_makes_simulations_ends_without_a_word_of_the_tracker():
    outcome = run_script(
        """
        import os, signal, threading
        import mpsim
        from support.scenes import lattice

        mpsim.Simulation(lattice(9, 9), mpsim.Settings(method="grid")).close()  # Ctrl-C in an import may be lost
        pressed = 0
        for number in range(30):
            timer = threading.Timer(0.0003 * number, os.kill, (os.getpid(), signal.SIGINT))
            try:
                timer.start()
                for _ in range(1000):
                    with mpsim.Simulation(lattice(9, 9), mpsim.Settings(method="grid")):
                        pass
            except KeyboardInterrupt:
                pressed += 1
        print(pressed)
        """,
        flags=(),  # of files that other libraries had open a warning would tell
    )
    assert (outcome.code, outcome.out, outcome.err) == (0, "30\n", "")
