"""Signals at lines and calls inside constructors and changes: nothing is held by nobody when the exception is gone.

Ctrl-C, and an alarm whose handler raises, as in a program that limits the time of what it calls.
"""

import contextlib
import dis
import multiprocessing
import os
import signal
import sys
import threading

import pytest
from support.processes import blocks_of, in_another_thread
from support.scenes import lattice, simulate
from support.selection import long_but

import mpsim

pytestmark = [pytest.mark.compiled, pytest.mark.timeout(3000)]

METHODS = ["naive", "grid", "parallel", "event"]
SAMPLES = {"naive": 20, "grid": 60, "event": 30, "parallel": 12}  # moments that are tried, spread evenly

MOST = {"naive": 3000, "grid": 3000, "event": 3000, "parallel": 200}
"""Moments that --long tries, spread evenly, too: of parallel, whose workers take a while to start, as time allows."""


class Alarm(Exception):  # noqa: N818
    """A limit of time of a user's program."""


SENDERS = {}  # how to send a signal; this thread gets the others

SIGNALS = {"Ctrl-C": (signal.SIGINT, KeyboardInterrupt), "alarm": (signal.SIGALRM, Alarm)}
LEAVE = contextlib._GeneratorContextManager.__exit__.__code__


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
    """

    def __init__(self, number, kind=signal.SIGINT):
        self.count = 0
        self._number, self._kind = number, kind

    def __enter__(self):
        sys.setprofile(self._in_c)
        sys.settrace(self._in_python)
        return self

    def __exit__(self, *exception):
        sys.settrace(None)
        sys.setprofile(None)

    def _in_python(self, frame, event, argument):
        # Python looks for signals after calls only: not where a door ends by stores, or where contextlib returns.
        # Raised there, the StopIteration that it handles would be left alive for ever.
        if event != "line" or not (frame.f_code.co_name == "door" or frame.f_code is LEAVE or leaves_a_with(frame)):
            self._moment(frame)
        return self._in_python

    def _in_c(self, frame, event, argument):
        if event == "c_return" or (event == "c_call" and argument.__name__ != "__exit__"):  # a lock's, let go before
            self._moment(frame)

    def _moment(self, frame):
        self.count += 1
        if self.count == self._number and drops_exceptions(frame):
            self._number += 1
        elif self.count == self._number:
            SENDERS.get(self._kind, lambda: signal.raise_signal(self._kind))()


def drops_exceptions(frame):
    """Whether Python is in a finalizer, or in a callback of a weak reference, as of garbage of tests before."""
    names = set()
    while frame is not None:
        names.add(frame.f_code.co_name)
        frame = frame.f_back
    return not names.isdisjoint(("__del__", "_remove", "remove"))


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
    """Send a signal at a moment of `act`, which must end by its exception. Returns what is left once that is gone.

    Of a block that nobody owns the collector does not know either. None if `act` had fewer moments this time.
    """
    kind, exception = SIGNALS[name]
    counter = Press(number, kind)
    try:
        with counter:
            act()
        assert counter.count < number, f"{name} at moment {number} was lost"
        return None
    except exception:
        pass
    return resources()


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
FEW = [("Ctrl-C", "Simulation", "parallel"), ("alarm", "Simulation", "event"), ("alarm", "resume", "grid")]


@pytest.mark.slow
@pytest.mark.usefixtures("alarms_raise")
@pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")  # opened by the call at whose return it came
@pytest.mark.parametrize(("name", "how", "method"), long_but(CONSTRUCTORS, *FEW))
def test_a_signal_at_any_line_of_a_constructor_leaves_nothing(name, how, method, request, tmp_path):
    kept = []

    def construct():
        kept.append(make())

    make = constructor(how, lattice(9, 9), mpsim.Settings(method=method, workers=2), tmp_path)
    make().close()
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


MORE = lattice(8, 8, pitch=2.0).position + 1.0
"""Places between those of discs, more than the block has room for."""

CHANGES = {"add": lambda sim: sim.add(MORE, 0 * MORE), "close": lambda sim: sim.close()}


@pytest.mark.slow
@pytest.mark.usefixtures("alarms_raise")
@pytest.mark.parametrize("change", long_but(CHANGES, "add"))
@pytest.mark.parametrize("method", long_but(METHODS, "grid"))
def test_an_alarm_at_any_line_of_a_change_leaves_nothing_but_a_whole_state(method, change, request):
    def left_at(number):
        """Moments of the change; blocks and workers that are left when an alarm has come at one, and it is closed."""
        sim = begin()
        press = Press(number, signal.SIGALRM)
        with contextlib.suppress(Alarm), press:
            CHANGES[change](sim)
        if change == "add":
            with contextlib.suppress(mpsim.errors.ClosedError):
                assert sim.run(frames=2).frames == 2
                assert sim.digest() == whole[sim.count], "half of the discs were added, or others moved"
        sim.close()
        return press.count, (blocks_of(os.getpid()), multiprocessing.active_children())

    begin, whole = lambda: simulate(lattice(9, 9, pitch=2.0), method=method, workers=2), {}
    for name in ("none", "add"):
        with begin() as sim:
            CHANGES.get(name, lambda sim: None)(sim)
            sim.run(frames=2)
            whole[sim.count] = sim.digest()
    moments, _ = left_at(0)
    for number in tried(moments, 40, MOST[method] // 4, request):
        assert left_at(number)[1] == (set(), []), f"moment {number} of {moments}"


@pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")  # as above
@pytest.mark.parametrize("method", long_but(METHODS, "grid"))
def test_ctrl_c_at_any_line_of_a_run_lets_the_simulation_go(method, request):
    """Whoever comes next can use it: another thread, too."""
    with simulate(lattice(9, 9), method=method, workers=2) as sim:
        moments = moments_of(lambda: sim.run(frames=1))
        for number in tried(moments, 60, MOST[method], request):
            with contextlib.suppress(KeyboardInterrupt), Press(number):
                sim.run(frames=1)
            done = in_another_thread(lambda: sim.run(frames=1).frames)
            assert done == 1, f"Ctrl-C at moment {number} of {moments}"


@pytest.mark.parametrize("what", [KeyboardInterrupt, TimeoutError, MemoryError])
def test_an_exception_as_pages_are_reserved_leaves_no_block_while_its_traceback_lives(what, monkeypatch):
    """A time limit of the user is not taken for a refusal of the system."""

    def interrupt(*_):
        raise what

    monkeypatch.setattr(os, "posix_fallocate", interrupt)
    with pytest.raises(what) as caught:
        simulate(lattice(9, 9), method="grid")
    assert blocks_of(os.getpid()) == set()
    del caught
