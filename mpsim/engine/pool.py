"""The worker processes: start, wake, watch, stop. Nothing else in mpsim uses multiprocessing.Process."""

import multiprocessing
import os
import signal
import sys
import threading
import types
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, wait
from typing import Any

from mpsim.engine.shared import SharedBlock
from mpsim.engine.worker import worker_main
from mpsim.errors import WorkerDied, WorkerStalled
from mpsim.interrupts import interrupts_held_back
from mpsim.kernels import layout
from mpsim.kernels.waiting import add_to_word, load_word, store_word

PATIENCE = 2.0
"""Seconds in which a worker that was told to stop may do so before it is ended by signal."""

_hiding = threading.Lock()


def default_start_method() -> str:
    """forkserver where it exists: its workers are forked from a clean process, so threads here cannot harm them."""
    return "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"


class WorkerPool:
    """Workers 1 .. workers - 1 of one simulation; worker 0 is the coordinator itself.

    Raises:
        WorkerDied: from the constructor too, if a worker ends or fails before it is ready.
    """

    def __init__(self, workers: int, block: SharedBlock, start_method: str | None):
        context = multiprocessing.get_context(start_method or default_start_method())
        if context.get_start_method() == "forkserver":
            context.set_forkserver_preload(["mpsim.engine.worker"])
        self._control: Any = block.arrays["control"]
        self._team: Any = block.arrays["team"]
        self._connections: list[Connection] = []
        self._processes: list[Any] = []
        self._lost: int | None = None
        self._creator = os.getpid()
        self._watch_end, self._watched_end = os.pipe()
        self._watcher = threading.Thread(target=self._watch, name="mpsim-watcher", daemon=True)
        try:
            for worker in range(1, workers):
                self._start(context, worker, block)
            for worker in range(1, workers):
                self._await_ready(worker)
        except BaseException:
            self.stop()
            raise
        self._watcher.start()

    @property
    def pids(self) -> list[int]:
        """Process numbers of the workers, worker 1 first."""
        return [process.pid for process in self._processes]

    def wake(self) -> None:
        """Announce a command and rouse the workers that sleep. The command itself is given by the kernel."""
        store_word(self._control, layout.ANNOUNCED, load_word(self._control, layout.COMMAND) + 1)
        for connection, mine in zip(self._connections, self._team[1:], strict=True):
            if load_word(mine, layout.PARKED):
                self._send(connection, ("wake", None, None))

    def settle(self) -> None:
        """Take the announcement back if no command followed, so that the workers may sleep again."""
        store_word(self._control, layout.ANNOUNCED, load_word(self._control, layout.COMMAND))

    def move_to(self, block: SharedBlock) -> None:
        """Let every worker attach to another block. The old one must stay open until this returns."""
        for connection in self._connections:
            self._send(connection, ("attach", block.name, block.specs))
        add_to_word(self._control, layout.MAIL, 1)
        self._control, self._team = block.arrays["control"], block.arrays["team"]
        for worker in range(1, len(self._processes) + 1):
            self._await_ready(worker)

    def failure(self) -> Exception:
        """The exception for an abort that a worker's death or delay has caused."""
        if self._lost is None:
            late = int(self._team[:, layout.ARRIVALS].argmin())
            return WorkerStalled(
                f"worker {late} has not come to a barrier within {layout.PATIENCE / 1e9:g} s. A worker must keep "
                "running. It may be stopped (SIGSTOP, a debugger) or starved; start again, with fewer workers."
            )
        return self._death(self._lost)

    def stop(self) -> None:
        """End all workers, and wait until they are gone. May be called again, and whatever state they are in."""
        if os.getpid() != self._creator:
            return  # a fork of the coordinator: the workers are not its own
        if self._watcher.is_alive():
            os.write(self._watched_end, b"x")
            self._watcher.join()
        for connection in self._connections:
            self._send(connection, ("stop", None, None))
        if self._connections:
            add_to_word(self._control, layout.MAIL, 1)
        for process in self._processes:
            process.join(PATIENCE)
            for end in (process.terminate, process.kill):
                if process.is_alive():
                    end()
                    process.join(PATIENCE)
            process.close()
        for connection in self._connections:
            connection.close()
        for descriptor in (self._watch_end, self._watched_end):
            if descriptor >= 0:
                os.close(descriptor)
        self._watch_end = self._watched_end = -1
        self._processes, self._connections = [], []
        self._control = self._team = None

    def _start(self, context: Any, worker: int, block: SharedBlock) -> None:
        ours, theirs = context.Pipe()
        process = context.Process(
            target=worker_main,
            args=(worker, theirs, block.name, block.specs),
            name=f"mpsim-worker-{worker}",
            daemon=True,
        )
        with interrupts_held_back():
            with _main_module_hidden():
                process.start()
            theirs.close()
            self._connections.append(ours)
            self._processes.append(process)

    def _await_ready(self, worker: int) -> None:
        connection, process = self._connections[worker - 1], self._processes[worker - 1]
        wait([connection, process.sentinel])
        try:
            kind, text = connection.recv() if connection.poll() else ("gone", None)
        except (EOFError, ConnectionResetError):
            kind, text = "gone", None
        if kind != "ready":
            raise self._death(worker, "start-up", text)

    def _death(self, worker: int, phase: str | None = None, text: str | None = None) -> WorkerDied:
        process, mine = self._processes[worker - 1], self._team[worker]
        process.join(PATIENCE)
        code = process.exitcode
        cause = f"exit code {code}"
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
        frame = int(self._control[layout.DONE] + mine[layout.FRAME])
        return WorkerDied(worker, process.pid, code, cause, frame, phase or layout.PHASES[mine[layout.PHASE]])

    def _watch(self) -> None:
        """Thread: at the first death, tell everybody to leave the frame loop. Ends when told to, without polling."""
        sentinels = {process.sentinel: worker for worker, process in enumerate(self._processes, start=1)}
        ready = wait([*sentinels, self._watch_end])
        # After a bad state, or when told to stop, workers end as they should.
        ended = load_word(self._control, layout.ABORT) != layout.RUNNING or load_word(self._control, layout.BAD)
        if self._watch_end not in ready and not ended:
            self._lost = min(sentinels[sentinel] for sentinel in ready)
            store_word(self._control, layout.ABORT, layout.WORKER_LOST)

    @staticmethod
    def _send(connection: Connection, message: tuple[Any, ...]) -> None:
        with suppress(BrokenPipeError, ConnectionResetError):  # that worker is dead; the watcher says so
            connection.send(message)


@contextmanager
def _main_module_hidden():
    """Keep the new process from importing the user's script again: workers need nothing of it.

    So a script needs no `if __name__ == "__main__"`, and a notebook works like a script.
    """
    with _hiding:
        main = sys.modules.get("__main__")
        sys.modules["__main__"] = types.ModuleType("__main__")
        try:
            yield
        finally:
            if main is not None:
                sys.modules["__main__"] = main
