"""A fork of the process that made a simulation cannot touch it, and can have its own: nothing is shared by accident."""

import concurrent.futures
import contextlib
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import time

import pytest
from support.processes import Script, assert_clean, assert_nothing_left_of, is_gone, run_script, wait_until
from support.scenes import ALONE, digest_after, lattice, simulate
from support.selection import long_but

import mpsim
from mpsim.core.deferred_signals import interrupts_held_back

pytestmark = pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")  # 3.12: a fork of a threaded process

METHODS = list(ALONE)
CHILDREN = {
    **{method: {"method": method} for method in METHODS},
    "parallel by fork": {"method": "parallel", "start_method": "fork"},
    "parallel by spawn": {"method": "parallel", "start_method": "spawn"},
}
"""Settings of what a fork runs, by name."""

PATIENCE = 150
"""Seconds that a fork may take, on a busy machine, before it counts as hung."""


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


def fork_executor(act):
    """The same in a process of a pool that forks."""
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


kept = []


def run_kept():
    """What a pool's process runs: it finds the task in what it has inherited, since no task can be pickled."""
    return kept[-1]()


FORKS = {"os.fork": in_fork, "executor": fork_executor, "process": fork_process}
MATRIX = [(parent, fork, child) for parent in METHODS for fork in FORKS for child in CHILDREN]
FEW = [
    ("parallel", "os.fork", "parallel"),
    ("parallel", "os.fork", "parallel by fork"),
    ("grid", "process", "event"),
    ("event", "executor", "parallel"),
    ("naive", "os.fork", "naive"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("parent", "fork", "child"), long_but(MATRIX, *FEW))
def test_a_fork_can_have_simulations_of_its_own(parent, fork, child):
    """Whatever its parent has run: gunicorn --preload, a pool that forks, os.fork."""
    settings = CHILDREN[child]
    kept.append(lambda: digest_after(lattice(12, 12), 20, workers=2, **settings))
    with simulate(lattice(20, 20), method=parent, workers=2) as sim:
        sim.run(frames=5)
        found = FORKS[fork](kept[-1])
        sim.run(frames=5)
        assert sim.digest() == digest_after(lattice(20, 20), 10, method=ALONE[parent])
    kept.clear()
    assert found == digest_after(lattice(12, 12), 20, method=ALONE[settings["method"]])


DOORS = {
    "run": lambda sim: sim.run(frames=3),
    "add": lambda sim: sim.add((0.1, 0.1), (0.0, 0.0)),
    "set": lambda sim: sim.set(0, velocity=(0.0, 0.0)),
    "kick": lambda sim: sim.kick(0, (0.5, 0.0)),
    "remove": lambda sim: sim.remove(0),
    "change": lambda sim: sim.change(passes=2),
    "add_wall": lambda sim: sim.add_wall([(0.1, 0.1), (0.2, 0.1)]),
    "journal": lambda sim: sim.journal,
    "origin": lambda sim: sim.origin,
    "save": lambda sim: sim.save("/dev/null/never"),
    "state": lambda sim: sim.state,
    "state_between": lambda sim: sim.state_between(1, 3),
    "local_state": lambda sim: sim.local_state(),
    "once": lambda sim: sim.once(lambda: 0),
    "digest": lambda sim: sim.digest(),
    "columns": lambda sim: sim.columns(),
    "frame": lambda sim: sim.frame,
    "time": lambda sim: sim.time,
    "count": lambda sim: sim.count,
    "substeps": lambda sim: sim.substeps,
    "pids": lambda sim: sim.pids,
    "array_names": lambda sim: sim.array_names,
    "radii": lambda sim: sim.radii,
    "masses": lambda sim: sim.masses,
    "absorbed": lambda sim: sim.absorbed,
}


def test_the_doors_are_all_there_are():
    """A new public name of a simulation must be tried here, too."""
    harmless = {"close", "scene", "settings", "resume", "replay"}
    assert set(DOORS) | harmless == {name for name in dir(mpsim.Simulation) if not name.startswith("_")}


def outcomes_of_doors(sim):
    found = {}
    for name, door in DOORS.items():
        try:
            found[name] = repr(door(sim))
        except Exception as error:
            found[name] = f"{type(error).__name__}: {error}"
    sim.close()
    sim.close()
    return found, repr(sim), repr(sim.scene.count)


@pytest.mark.parametrize("method", METHODS)
def test_every_door_is_refused_in_a_fork_and_the_parent_continues_as_if_alone(method):
    with simulate(lattice(20, 20), method=method, workers=2) as sim:
        sim.run(frames=5)
        found, words, count = in_fork(lambda: outcomes_of_doors(sim))
        refused = f"ForkedError: this simulation was made by process {os.getpid()} and cannot be used in process "
        assert {name: text[: len(refused)] for name, text in found.items()} == dict.fromkeys(DOORS, refused)
        assert (words, count) == (f"<Simulation: of process {os.getpid()}>", "400")
        assert sim.frame == 5
        sim.run(frames=5)
        assert sim.digest() == digest_after(lattice(20, 20), 10, method=ALONE[method])


@pytest.mark.parametrize("method", METHODS)
def test_a_callback_that_forks_cannot_bring_the_fork_back_into_the_run(method):
    """`if os.fork() == 0: ...` in a callback, without an end: the fork would drive its parent's discs."""

    def fork(done, of):
        if not children:
            children.append(os.fork())

    children, parent = [], os.getpid()
    with simulate(lattice(9, 9), method=method, workers=2) as sim:
        try:
            sim.run(frames=50, progress=fork)
        except mpsim.errors.ForkedError:
            os._exit(7)
        finally:
            if os.getpid() != parent:
                os._exit(8)
        assert os.waitstatus_to_exitcode(os.waitpid(children[0], 0)[1]) == 7
        assert sim.digest() == digest_after(lattice(9, 9), 50, method=ALONE[method])


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_a_signal_handler_that_forks_cannot_bring_the_fork_back_into_the_run(method):
    """The fork met what was missing of its parent's block: KeyError: 'times'."""

    def fork(frame, event, argument):
        if event == "return" and frame.f_code.co_name in ("_write_command", "_tally"):
            sys.setprofile(None)
            children.append(os.fork())

    children, parent, error = [], os.getpid(), None
    with simulate(lattice(9, 9), method=method, workers=2) as sim:
        sys.setprofile(fork)
        try:
            sim.run(frames=50, measures=["pressure"])
        except Exception as caught:
            error = caught
        finally:
            sys.setprofile(None)
            if os.getpid() != parent:
                os._exit(7 if isinstance(error, mpsim.errors.ForkedError) else 8)
        assert error is None
        assert os.waitstatus_to_exitcode(os.waitpid(children[0], 0)[1]) == 7
        assert sim.digest() == digest_after(lattice(9, 9), 50, method=ALONE[method])


LAST_CALLS = {
    "naive": ("naive_arguments", "_run_command"),
    "grid": ("kernel_arguments", "_run_grid"),
    "parallel": ("kernel_arguments", "_run_grid"),
}
"""The last Python code before a kernel runs, and its caller: the kernel's arguments are there already. `event` has no
such moment."""


class ForkAt:
    """Forks once as a signal handler may: when a function first returns after the call of another.

    The parent waits for the end of the fork.

    Attributes: code (how the fork has ended; None: there was none).
    """

    def __init__(self, name, caller):
        self.code = None
        self._name, self._caller = name, caller
        self._called = False

    def __enter__(self):
        sys.setprofile(self._profile)
        return self

    def __exit__(self, kind, *_):
        sys.setprofile(None)
        if self.code == "fork":
            os._exit(7 if kind is mpsim.errors.ForkedError else 8)

    def _profile(self, frame, event, argument):
        name = frame.f_code.co_name
        self._called |= event == "call" and name == self._caller
        if self._called and event == "return" and name == self._name:
            sys.setprofile(None)
            child = os.fork()
            if child == 0:
                signal.alarm(PATIENCE)
                self.code = "fork"
            else:
                self.code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


@pytest.mark.parametrize("method", LAST_CALLS)
def test_a_fork_just_before_a_kernel_runs_does_not_write_to_the_block_of_its_parent(method):
    """It returns into a call that has all views of the block already, and ran its parent's frames."""
    with simulate(lattice(9, 9), method=method, workers=2) as sim:
        sim.run(frames=5)
        with ForkAt(*LAST_CALLS[method]) as fork:
            assert sim.run(frames=5).frames == 5
        assert (fork.code, sim.frame) == (7, 10)
        sim.run(frames=10)
        assert sim.digest() == digest_after(lattice(9, 9), 20, method=ALONE[method])


@pytest.mark.parametrize("method", LAST_CALLS)
def test_a_fork_in_the_middle_of_reading_gets_no_state(method):
    """Its views of the block would lead to its parent's discs, which may run by now."""
    with simulate(lattice(9, 9), method=method, workers=2) as sim:
        sim.run(frames=5)
        before = sim.digest()
        with ForkAt("live_discs", "places_and_speeds") as fork:
            assert sim.state.digest() == before
        assert fork.code == 7


@pytest.mark.parametrize("held", [True, False])
def test_a_fork_of_another_thread_while_signals_are_held_back_handles_them(held):
    """The thread that held them back does not exist in the fork: Ctrl-C was ignored there for ever."""

    def act():
        for number in (signal.SIGINT, signal.SIGUSR1):
            with contextlib.suppress(KeyboardInterrupt):
                signal.raise_signal(number)
                caught.append(0)
        return caught, signal.getsignal(signal.SIGINT) is before

    caught, found, before = [], [], signal.getsignal(signal.SIGINT)
    mine = signal.signal(signal.SIGUSR1, lambda number, _: caught.append(number))
    now = threading.Event()
    thread = threading.Thread(target=lambda: now.wait() and found.append(in_fork(act)))
    thread.start()  # one that is started while signals are held back never gets Ctrl-C
    try:
        with interrupts_held_back() if held else contextlib.nullcontext():
            with interrupts_held_back() if held else contextlib.nullcontext():
                now.set()
                thread.join()
                assert (signal.getsignal(signal.SIGINT) is before) is not held, "the control"
                signal.raise_signal(signal.SIGUSR1)
                signal.raise_signal(signal.SIGUSR1)
            assert caught == ([] if held else [signal.SIGUSR1] * 2)
        assert caught == ([signal.SIGUSR1] if held else [signal.SIGUSR1] * 2), "that of the parent, once"
    finally:
        signal.signal(signal.SIGUSR1, mine)
    assert found == [([signal.SIGUSR1, 0], True)]
    assert signal.getsignal(signal.SIGINT) is before


def test_a_fork_of_another_thread_during_a_run_that_writes_checkpoints_ends_on_sigterm(tmp_path):
    """SIGTERM asked for a checkpoint, and for an end after it, which nobody would write or do there."""

    def progress(done, of):
        if not found:
            thread = threading.Thread(target=lambda: found.append(in_fork(act)))
            thread.start()
            thread.join()

    def act():
        signal.raise_signal(signal.SIGTERM)
        return "lives on"

    found, before = [], signal.signal(signal.SIGTERM, lambda *_: (_ for _ in ()).throw(SystemExit(7)))
    try:
        with simulate(lattice(9, 9), method="grid") as sim:
            assert sim.run(frames=20, checkpoint=tmp_path / "run", progress=progress).frames == 20
    finally:
        signal.signal(signal.SIGTERM, before)
    assert isinstance(found[0], SystemExit)


@pytest.mark.slow
def test_a_fork_that_ends_like_a_program_is_silent_and_takes_nothing_away():
    """Its end runs what is registered for the end of the parent."""
    outcome = run_script(
        """
        import gc, os, sys
        from support.scenes import lattice, simulate

        sim = simulate(lattice(20, 20), method="parallel", workers=2)
        sim.run(frames=2)
        child = os.fork()
        if child == 0:
            sys.exit(0)
        print(os.waitpid(child, 0)[1])
        child = os.fork()
        if child == 0:
            del sim
            gc.collect()
            sys.exit(0)
        print(os.waitpid(child, 0)[1])
        sim.run(frames=2)
        print(sim.frame)
        """,
        flags=("-W", "error", "-W", "ignore:This process:DeprecationWarning"),
    )
    assert_clean(outcome)
    assert outcome.out == "0\n0\n4\n"


def test_workers_end_with_their_coordinator_although_a_fork_of_it_lives_on():
    """A fork holds the other ends of all pipes open, which would tell workers that their coordinator is gone."""
    text = """
    import os, time, warnings
    from support.scenes import lattice, simulate

    warnings.filterwarnings("ignore", "This process", DeprecationWarning)  # 3.12: fork beside threads
    sim = simulate(lattice(20, 20), method="parallel", workers=2)
    sim.run(frames=2)
    child = os.fork()
    if child == 0:
        time.sleep(100)
    print(child, *sim.pids)
    time.sleep(100)
    """
    with Script(text, warm=True) as script:
        child, worker = map(int, script.line().split())
        script.send(signal.SIGKILL)
        assert wait_until(lambda: is_gone(worker), 5), "the worker has outlived its coordinator"
        assert not is_gone(child), "the control: the fork lives"
        os.kill(child, signal.SIGKILL)
        script.finish(10)
        assert_nothing_left_of(script.pid)


@pytest.mark.long
@pytest.mark.timeout(600)
def test_a_fork_while_another_thread_starts_workers_can_start_its_own():
    """Locks that the other thread holds would never be let go in the fork."""
    stop, made = threading.Event(), []

    def start_again_and_again():
        while not stop.is_set():
            with simulate(lattice(9, 9), method="parallel", workers=2):
                made.append(1)

    thread = threading.Thread(target=start_again_and_again)
    thread.start()
    try:
        for _ in range(3):
            time.sleep(0.03)
            found = in_fork(lambda: digest_after(lattice(9, 9), 5, method="parallel", workers=2))
            assert found == digest_after(lattice(9, 9), 5, method="grid")
    finally:
        stop.set()
        thread.join()
    assert made, "the control: the thread has started some"


MASKED = """
import multiprocessing, signal, sys
from support.scenes import lattice, simulate

def masked(queue):
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    queue.put((signal.SIGINT in blocked, "mpsim.engine.workers.forkserver" in sys.modules))

if __name__ == "__main__":
    with simulate(lattice(9, 9), method="parallel", workers=2, start_method="forkserver") as sim:
        sim.run(frames=2)
    context = multiprocessing.get_context("forkserver")
    queue = context.Queue()
    process = context.Process(target=masked, args=(queue,))
    process.start()
    print(*queue.get())
    process.join()
"""


@pytest.mark.slow
def test_ctrl_c_reaches_processes_that_the_fork_server_starts_for_the_program():
    """The server was started while Ctrl-C was blocked for the sake of a worker; all that it started inherited it."""
    outcome = run_script(MASKED)
    assert_clean(outcome)
    assert outcome.out == "False True\n", "and the second word, the control: it is the server that mpsim started"
