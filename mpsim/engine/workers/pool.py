"""The worker processes: start, wake, watch, stop. Nothing else in mpsim uses multiprocessing.Process."""

import multiprocessing
import multiprocessing.process
import multiprocessing.util
import os
import signal
import sys
import threading
import time
import types
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import forkserver, resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import current_process
from typing import Any, TypeVar

import psutil

from mpsim.core.deferred_signals import interrupts_held_back
from mpsim.core.machine import cores_of, keep_off_this_core
from mpsim.engine.workers.shared import SharedBlock, demand_descriptors, refusal_of_process
from mpsim.engine.workers.worker import GRID, NAME, Program, worker_main
from mpsim.errors import ResourceError, WorkerDiedError, WorkerStalledError, is_of_the_system
from mpsim.kernels import records
from mpsim.kernels.waiting import add_to_word, load_word, store_word

# --- Makes Python's fork server import what workers need, without effect on other processes
#
# The server is started while Ctrl-C is blocked, so that workers come up with it blocked: a start prints no traceback.
# Processes of the program that the server starts later must not inherit that.


def _unblock(_: object) -> None:
    """In a process that the server has started: Ctrl-C comes through unless it is a worker."""
    if not current_process().name.startswith(NAME):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


multiprocessing.util.register_after_fork(_unblock, _unblock)


PATIENCE = 2.0  # seconds in which a worker that was told to stop may do so before it is ended by signal

LOOK = 0.05
"""Seconds between two looks at workers whose fork server, which tells of their ends, has itself been ended."""

START_PATIENCE = 1200.0
"""Seconds in which a worker must be ready: it may have to compile every kernel, on a busy machine."""

UNKNOWN = 255  # exit code of a worker whose own nobody can tell any more; multiprocessing takes it for the same

ENOUGH_DESCRIPTORS = 24
"""Descriptors that are open at once, at most, while a worker is started, and with the first the fork server."""

Result = TypeVar("Result")

_hiding = threading.Lock()


class WorkerPool:
    """Workers 1 .. workers - 1 of one simulation; worker 0 is the coordinator itself. There are none until `start`.

    So its owner knows of the pool before there is anything to stop.

    Attribute pids: their process numbers, worker 1 first, in a list that stays as it is: another one takes its place.
    """

    def __init__(self, start_method: str | None, program: Program = GRID):
        self._program = program
        # Workers of a fork server are forked from a clean process, so threads here cannot harm them.
        self._context: Any = multiprocessing.get_context(start_method or "forkserver")
        self._control: Any = None
        self._team: Any = None
        self._signals: Any = None  # of all, and then of each worker: it takes NumPy long to get at them in its records
        self._connections: list[Connection] = []
        self._processes: list[Any] = []
        self.pids: list[int] = []
        self._lost: int | None = None
        self._called: dict[int, int] = {}  # the nap in which each worker has been called last
        self._cores: dict[int, set[int]] = {}  # of a worker that is being called
        self._creator = os.getpid()
        self._watch_end = self._watched_end = -1
        self._watcher = threading.Thread(target=self._watch, name="mpsim-watcher", daemon=True)

    def start(self, block: SharedBlock, workers: int) -> None:
        """Start the workers, if any, and wait until they are ready. Whatever stops this, then there are none.

        Raises:
            WorkerDiedError, WorkerStalledError: if a worker ends or fails before it is ready.
            ResourceError: if the system allows no more processes or descriptors.
        """
        self._attach(block)
        if workers == 1:
            return
        if self._context.get_start_method() == "forkserver":
            modules = ["mpsim.engine.workers.pool", self._program.load.__module__, "mpsim.engine.workers.warm"]
            self._context.set_forkserver_preload(modules)
        try:
            for worker in range(1, workers):
                self._start(worker)
            for worker in range(1, workers):
                self._await_ready(worker)
            with interrupts_held_back():
                try:
                    self._watch_end, self._watched_end = os.pipe()
                    self._watcher.start()
                except (OSError, RuntimeError) as error:
                    raise refusal_of_process("the thread that watches the workers", error) from error
        except BaseException:
            self.stop()
            raise

    def _attach(self, block: SharedBlock) -> None:
        self._block, self._control, self._team = block, block.arrays["control"], block.arrays["team"]
        self._signals = [self._control.signals, *(mine.signals for mine in self._team[1:])]

    def wake(self) -> None:
        """Have the workers that sleep come. Ctrl-C may end it: the next call then gives them their cores back."""
        for worker, connection in enumerate(self._connections, start=1):
            nap = load_word(self._signals[worker], records.PARKED)
            if nap and nap != self._called.get(worker) and self._lost is None:  # a lost one's number may be another's
                pid = self.pids[worker - 1]
                cores = self._cores.setdefault(worker, cores_of(pid))
                if nap > 0 and len(cores) > len(self.pids):
                    keep_off_this_core(pid, cores)
                self._send(connection, ("wake", cores, time.monotonic()))
                self._called[worker] = nap
                del self._cores[worker]

    def run(self, kernel: Callable[[], Result]) -> Result:
        """Announce a command, wake the workers that sleep, and call the kernel, which gives the command itself."""
        signals = self._signals[0]
        store_word(signals, records.ANNOUNCED, load_word(signals, records.COMMAND) + 1)
        self.wake()
        try:
            return kernel()
        finally:  # taken back if no command followed, so that the workers may sleep again
            store_word(signals, records.ANNOUNCED, load_word(signals, records.COMMAND))

    def move_to(self, block: SharedBlock) -> None:
        """Let every worker attach to another block. The old one must stay open until this returns."""
        for connection in self._connections:
            self._send(connection, ("attach", block.name, block.specs))
        add_to_word(self._signals[0], records.MAIL, 1)
        for worker in range(1, len(self._processes) + 1):
            self._await_ready(worker)
        self._attach(block)  # only now: the old one tells in which frame a worker has died

    def assert_alive(self) -> None:
        """Raise `failure` if a worker has died, for a command that does without workers."""
        if self._lost is not None:
            raise self.failure()

    def failure(self) -> Exception:
        """The exception for an abort that a worker's death or delay has caused."""
        if self._lost is None:
            late = int(self._team["arrivals"][: len(self._processes) + 1].argmin())
            return WorkerStalledError(
                f"worker {late} has not reached a barrier within {records.PATIENCE / 1e9:g} s. A worker must keep "
                "running. It may be stopped (SIGSTOP, a debugger) or starved; start again, with fewer workers."
            )
        return self._death(self._lost)

    def stop(self) -> None:
        """End all workers, and wait until they are gone. May be called again, and whatever state they are in."""
        if os.getpid() != self._creator:  # a fork of the coordinator: the workers are not its own
            self._control = self._team = self._signals = None
            return
        if self._watcher.is_alive():
            os.write(self._watched_end, b"x")
            if self._watcher is not threading.current_thread():  # where garbage may be collected as well
                self._watcher.join()
        for connection in self._connections:
            self._send(connection, ("stop",))
        if self._connections:
            add_to_word(self._signals[0], records.MAIL, 1)
        for process in self._processes:
            _join(process)
            for end in (process.terminate, process.kill):
                if process.is_alive():
                    end()
                    _join(process)
            if _lives(process.pid):  # without its fork server, `process` knows nothing of it
                with suppress(ProcessLookupError):
                    os.kill(process.pid, signal.SIGKILL)
            process.close()
        for connection in self._connections:
            connection.close()
        for descriptor in (self._watch_end, self._watched_end):
            if descriptor >= 0:
                os.close(descriptor)
        self._watch_end = self._watched_end = -1
        self._processes, self.pids, self._connections = [], [], []
        self._control = self._team = self._signals = None

    def _start(self, worker: int) -> None:
        """Start one worker. Ctrl-C waits until it is recorded."""
        with interrupts_held_back():
            try:
                demand_descriptors(ENOUGH_DESCRIPTORS)
                ours, theirs = self._context.Pipe()
                self._connections.append(ours)
                process = self._context.Process(
                    target=worker_main,
                    args=(worker, theirs, self._block.name, self._block.specs, self._program, self._creator),
                    name=f"{NAME}{worker}",
                    daemon=True,
                )
                try:
                    self._start_process(process)
                finally:
                    theirs.close()
            except (OSError, EOFError) as error:
                if isinstance(error, OSError) and not is_of_the_system(error) and "AF_UNIX" not in str(error):
                    raise
                raise refusal_of_process(f"worker {worker}", error) from error
            self._processes.append(process)
            self.pids = [*self.pids, process.pid]

    def _start_process(self, process: Any) -> None:
        """Start a process, if need be by a new fork server: one that was killed is noticed only by its silence."""
        with _main_module_hidden():
            try:
                process.start()
            except (EOFError, ConnectionError, ChildProcessError):
                if self._context.get_start_method() != "forkserver":
                    raise
                _end_fork_server()
                process.start()

    def _await_ready(self, worker: int) -> None:
        connection, deadline = self._connections[worker - 1], time.monotonic() + START_PATIENCE
        while not connection.poll(LOOK):
            with interrupts_held_back():  # psutil catches exceptions: an interrupt in between would be shown with them
                lost = [number for number, process in enumerate(self._processes, start=1) if not _lives(process.pid)]
            if lost and not connection.poll():
                raise self._death(lost[0], "start-up")
            if time.monotonic() > deadline:
                raise WorkerStalledError(
                    f"worker {worker} was not ready within {START_PATIENCE:g} s. A worker must keep running. It may be "
                    "stopped (SIGSTOP, a debugger) or starved; start again, with fewer workers."
                )
        try:
            kind, text = connection.recv()
        except (EOFError, ConnectionResetError):
            kind, text = "gone", None
        if isinstance(text, ResourceError):
            raise type(text)(f"worker {worker} was refused what it needs: {text}")
        if kind != "ready":
            raise self._death(worker, "start-up", text)

    def _death(self, worker: int, phase: str | None = None, text: str | None = None) -> WorkerDiedError:
        process, mine = self._processes[worker - 1], self._team[worker]
        _join(process)
        code = process.exitcode
        cause = "an unknown cause" if code == UNKNOWN else f"exit code {code}"
        if code is not None and code < 0:
            cause = f"signal {-code} ({signal.Signals(-code).name})"
        connection = self._connections[worker - 1]
        if text is None and connection.poll():
            try:
                text = connection.recv()[1]
            except (EOFError, OSError):
                text = None
        if text:
            cause += f" after an error:\n{text}"
        # A worker that dies right after a command has no time to reset its count; the coordinator's is then 0.
        frame = int(self._control.done + min(mine.frame, self._team[0].frame))
        return WorkerDiedError(worker, process.pid, code, cause, frame, phase or records.PHASES[mine.phase])

    def _watch(self) -> None:
        """Thread: when a worker dies, have all others leave the frame loop. Ends when `stop` asks for it.

        A sentinel also fires when the fork server is ended, which a SIGTERM to the whole group does; its workers live
        on, and are looked at now and then.
        """
        watched = {process.sentinel: worker for worker, process in enumerate(self._processes, start=1)}
        orphans: set[int] = set()
        lost: list[int] = []
        while not lost:
            ready = wait([*watched, self._watch_end], LOOK if orphans else None)
            if self._watch_end in ready or not self._processes:
                return
            orphans |= {watched.pop(sentinel) for sentinel in ready}
            lost = [worker for worker in orphans if not _lives(self._processes[worker - 1].pid)]
        # After a bad state, or when told to stop, workers end as they should.
        signals = self._signals[0]
        ended = load_word(signals, records.ABORT) != records.RUNNING or load_word(signals, records.BAD)
        if not ended:
            self._lost = min(lost)
            store_word(signals, records.ABORT, records.WORKER_LOST)

    @staticmethod
    def _send(connection: Connection, message: tuple[Any, ...]) -> None:
        with suppress(BrokenPipeError, ConnectionResetError):  # that worker is dead; the watcher says so
            connection.send(message)


class Team:
    """The block of a solver with its workers, and what is to take their place, so that `close` always knows of both.

    Attributes block, pool: those in use; until the first `take` there is nothing in them.
    """

    def __init__(self, program: Program = GRID):
        self._program = program
        self.block: SharedBlock = SharedBlock({})
        self.pool: WorkerPool = WorkerPool(None, program)
        self._next_block, self._next_pool = self.block, self.pool

    @contextmanager
    def moving_to(self, block: SharedBlock) -> Iterator[SharedBlock]:
        """Context in which a block is made, filled and manned that `take` then puts to use; given up if that fails."""
        self._next_block, self._next_pool = block, WorkerPool(None, self._program)
        try:
            yield block
        except BaseException:
            self._next_pool.stop()
            block.close()
            raise

    def man(self, workers: int, start_method: str | None, new_workers: bool) -> WorkerPool:
        """Have n workers, this process included, in the block that is next: the present ones, or new ones.

        Raises:
            ResourceError, WorkerDiedError, WorkerStalledError: as `WorkerPool.start`. Of those that move none is left.
        """
        if new_workers:
            self._next_pool = WorkerPool(start_method, self._program)
            self._next_pool.start(self._next_block, workers)
        else:
            self._next_pool = self.pool
            self.pool.move_to(self._next_block)
        return self._next_pool

    def take(self) -> None:
        """Go on in the block that was next; the old one is closed, and its workers end unless they have moved."""
        self.block, self._next_block = self._next_block, self.block
        self.pool, self._next_pool = self._next_pool, self.pool
        if self._next_pool is not self.pool:
            self._next_pool.stop()
        self._next_block.close()

    def close(self) -> None:
        """Stop the workers and remove the block. May be called again, and whatever state they are in."""
        for pool in (self._next_pool, self.pool):
            pool.stop()
        for block in (self._next_block, self.block):
            block.close()


def _lives(pid: int | None) -> bool:
    """Whether a process runs, or is stopped; a zombie does not. If the system does not say, the next look tells."""
    try:
        return psutil.Process(pid).status() not in (psutil.STATUS_ZOMBIE, psutil.STATUS_DEAD)
    except psutil.NoSuchProcess:
        return False
    except (psutil.Error, OSError):  # as without descriptors
        return True


def _join(process: Any) -> None:
    """Wait for a worker to end, for a time.

    Where SIGCHLD is ignored, or the program waits for all children itself, multiprocessing takes it for alive for ever.
    """
    process.join(PATIENCE)
    if process.exitcode is None and not _lives(process.pid):
        process._popen.returncode = UNKNOWN


@contextmanager
def _main_module_hidden():
    """Keep the new process from importing the user's script again: workers need nothing of it.

    So a script needs no `if __name__ == "__main__"`, and a notebook works like a script.
    """
    with _hiding:
        main = sys.modules.get("__main__")
        sys.modules["__main__"] = _Hidden(main)
        try:
            yield
        finally:
            if main is not None:
                sys.modules["__main__"] = main


class _Hidden(types.ModuleType):
    """Placeholder for the main module. Attribute main: that module."""

    def __init__(self, main: types.ModuleType | None):
        super().__init__("__main__")
        self.main = main


def _end_fork_server() -> None:
    """End a fork server that no longer answers."""
    pid = forkserver._forkserver._forkserver_pid  # type: ignore[attr-defined]
    with suppress(ChildProcessError):  # the program has waited for it itself
        if pid is not None and os.waitpid(pid, os.WNOHANG) == (0, 0):
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
    _forget_fork_server()


def _forget_fork_server() -> None:
    """Have multiprocessing start a fork server of its own for the next process."""
    server: Any = forkserver._forkserver  # type: ignore[attr-defined]
    if server._forkserver_pid is not None:
        os.close(server._forkserver_alive_fd)
        server._forkserver_pid = server._forkserver_alive_fd = server._forkserver_address = None


def _leave_to_the_parent() -> None:
    """In a fork: forget what multiprocessing has of the parent's workers; the fork starts its own.

    The parent's fork server answers to the parent alone (python/cpython#86354: its child waits for it, in vain), and a
    thread of the parent that was just starting a worker does not exist here, nor lets go of its locks. The resource
    tracker is shared, as it must be: one of the fork's own would remove what belongs to the parent.
    """
    server: Any = forkserver._forkserver  # type: ignore[attr-defined]
    locks: list[Any] = [_hiding, server._lock, resource_tracker._resource_tracker._lock]  # type: ignore[attr-defined]
    for lock in locks:
        lock._at_fork_reinit()
    main = sys.modules.get("__main__")
    if isinstance(main, _Hidden) and main.main is not None:
        sys.modules["__main__"] = main.main
    _forget_fork_server()
    # Otherwise the end of the fork would end them, or try to wait for them.
    children = multiprocessing.process._children  # type: ignore[attr-defined]
    children -= {child for child in children if child.name.startswith(NAME)}


os.register_at_fork(after_in_child=_leave_to_the_parent)
