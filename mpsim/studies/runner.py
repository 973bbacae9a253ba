"""What all studies share: tasks run by any executor or in threads, and a file of finished runs."""

import json
import os
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Generic, TypeVar

from mpsim.core import files
from mpsim.core.checks import Closable, refusal
from mpsim.core.files import FileLock
from mpsim.core.machine import usable_cores
from mpsim.errors import InputError, OutputError, reason_of

POLL_SECONDS = 0.2
"""Seconds between two checks for signals while threads run: one delivered to another thread wakes no waiting one."""

MOST_SUBMITTED = 4096
"""Tasks that an executor holds at most: many for each worker of a large cluster, without memory for millions."""

Key = TypeVar("Key")
Task = tuple[Key, tuple[Any, ...]]  # (key, (function, argument, ...))


class Stopped(Exception):  # noqa: N818 - not an error
    """The run is no longer needed."""


class Runner(Closable, Generic[Key]):
    """Runs tasks. Use it in a `with` block, which ends its threads.

    Args:
        executor: any of concurrent.futures; None: threads, one for each core. Kernels release the GIL, so threads use
            every core, and no process has to be started.
    """

    def __init__(self, executor: Executor | None):
        if executor is not None and not isinstance(executor, Executor):
            raise InputError(
                f"executor must be a concurrent.futures.Executor; got {type(executor).__name__}. Use "
                "ProcessPoolExecutor(), Dask's client.get_executor(), mpi4py's MPIPoolExecutor(), or leave it out."
            )
        self._executor = executor
        self._threads: ThreadPoolExecutor | None = None
        self._stop = threading.Event()
        self._pending: dict[Future[Any], Key] = {}
        self._finished: SimpleQueue[Future[Any]] = SimpleQueue()

    def close(self) -> None:
        """End its threads."""
        if self._threads is not None:
            self._stop.set()
            self._threads.shutdown(cancel_futures=True)

    def run(
        self, tasks: Iterable[Task[Key]], keep: Callable[[Key, Future[Any]], None], show: Callable[[int], None]
    ) -> None:
        """Run tasks. After an interrupt, those that have not begun are cancelled, and those that are done are kept.

        Args:
            tasks: read as far as they are handed over. In threads of this runner, an event that asks the function to
                raise Stopped is its last argument.
            keep: called in this thread, when a task is done. After an executor has broken, futures hold its error.
            show: called after it with the number of tasks that are done.
        """
        if self._executor is None and self._threads is None:
            self._threads = ThreadPoolExecutor(usable_cores(), "mpsim-study")
        left, done = iter(tasks), 0
        try:
            while self._hand_over(left):
                try:
                    future = self._finished.get(timeout=POLL_SECONDS)
                except Empty:
                    continue
                keep(self._pending.pop(future), future)
                done += 1
                show(done)
        except BaseException:
            for future in tuple(self._pending):
                future.cancel()
            try:
                self.close()
            finally:
                for future, key in self._pending.items():
                    if future.done() and not future.cancelled() and future.exception() is None:
                        keep(key, future)
            raise

    def _hand_over(self, tasks: Iterator[Task[Key]]) -> bool:
        """Hand over what there is room for; returns whether anything is pending."""
        while len(self._pending) < MOST_SUBMITTED and (task := next(tasks, None)) is not None:
            key, call = task
            future = self._submitted(call)
            self._pending[future] = key
            future.add_done_callback(self._finished.put)
        return bool(self._pending)

    def _submitted(self, call: tuple[Any, ...]) -> Future[Any]:
        """The future of a task; it holds the error of an executor that has broken, or could not send the task."""
        try:
            if self._executor is not None:
                return self._executor.submit(*call)
            assert self._threads is not None
            return self._threads.submit(*call, self._stop)
        except Exception as error:
            if isinstance(error, RuntimeError) and not isinstance(error, BrokenExecutor):
                got = f"{type(self._executor).__name__}, which does not ({error})"
                instead = "Make one that is not shut down, and call inside its `with` block."
                raise refusal("executor", "accept tasks", got, instead) from error
            future = Future[Any]()
            future.set_exception(error)
            return future


# --- The file of a study: a head, and one line of JSON for each finished run
#
# A line is written by one system call when its run is done. So Ctrl-C leaves complete lines, and a kill leaves at most
# one incomplete line, which the next study removes. Only one study at a time may use the file.

MOST_BYTES = 2**32  # largest size of a file: some ten million runs of a sweep


class RunFile(Closable):
    """A file of finished runs. Use it in a `with` block; without a path it holds nothing.

    Args:
        path: of the file, or None.
        what: the kind of study in words.
        version: of its lines.

    Attributes:
        head: facts of the study that began the file; empty for a new one.
    """

    def __init__(self, path: str | os.PathLike[str] | None, what: str, version: int):
        self.head: dict[str, Any] = {}
        self._what, self._format = what, f"mpsim {what} {version}"
        self._lines: list[bytes] = []
        self._descriptor = -1
        if path is not None:
            self._open(path)

    def close(self) -> None:
        """Hand the file to the disk, and to the next study."""
        if self._descriptor >= 0:
            descriptor, self._descriptor = self._descriptor, -1
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)
                self._lock.release()

    def demand(self, **title: Any) -> None:
        """Refuse the file of another study, by the first fact in which it differs."""
        for name, wanted in {"format": self._format, **title}.items() if self.head else ():
            has, asked = (json.dumps(each, ensure_ascii=False) for each in (self.head.get(name), wanted))
            if json.loads(has) != json.loads(asked):
                raise InputError(
                    f"path must be a file of the same {self._what}, or none yet; {self._path} has {name} {has:.200}, "
                    f"and this {self._what} {name} {asked:.200}. Give another path, or remove the file."
                )

    def begin(self, title: dict[str, Any], take: Callable[[dict[str, Any]], object], **further: Any) -> None:
        """Read the runs in the file, or begin a new one.

        Args:
            title: facts that identify the study.
            take: called with each run.
            further: facts for the head of a new file, in which others may differ.
        """
        if self._descriptor < 0:
            return
        self.demand(**title)
        for number, line in enumerate(self._lines, start=2):
            row = self._parsed(number, line)
            try:
                take(row)
            except (KeyError, TypeError, ValueError) as error:
                raise self._unreadable(f"line {number} is not a row: {type(error).__name__} {error}") from None
        os.ftruncate(self._descriptor, self._whole if self._lines else 0)
        if not self._lines:  # the head is written anew, for what was put right before any run was done
            self.append({"format": self._format, **title, **further})
        self._lines = []

    def append(self, line: dict[str, Any]) -> None:
        """Add a run.

        Raises:
            OutputError: if it cannot be written; the file is as it was before.
        """
        if self._descriptor < 0:
            return
        content = (json.dumps(line) + "\n").encode()
        before = os.fstat(self._descriptor).st_size
        try:
            written = 0
            while written < len(content):
                written += os.write(self._descriptor, content[written:])
        except OSError as error:
            os.ftruncate(self._descriptor, before)
            raise OutputError(
                f"the file of a {self._what} must have room on its disk; {self._path} cannot be written "
                f"({error.strerror}). Make room and call again: the runs that it holds are not repeated."
            ) from error

    def _open(self, path: str | os.PathLike[str]) -> None:
        flags = os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW | os.O_CLOEXEC
        try:
            self._path = Path(path)
            files.check_target(self._path)
            self._descriptor = os.open(self._path, flags, 0o666)
            self._lock = FileLock(self._path)
        except OutputError:
            os.close(self._descriptor)
            raise InputError(
                f"path must be a file that no other {self._what} has; {self._path} is being written by another one, of "
                "this process or another. Wait for its end, or give another path."
            ) from None
        except (OSError, TypeError, ValueError) as error:  # the last two: no path at all
            rule, got = "be a file in a folder that can be written to", getattr(error, "strerror", None) or error
            raise refusal("path", rule, f"{path!r} ({got})", "Make the folder, or give another path.") from None
        try:
            self._read()
        except BaseException:
            self.close()
            raise

    def _read(self) -> None:
        """Read head and whole lines."""
        begin = f'{{"format": "mpsim {self._what} '.encode()
        try:
            content = files.content(self._path, MOST_BYTES)
        except (OSError, ValueError) as error:
            raise self._unreadable(reason_of(error)) from None
        if content and not (content.startswith(begin) or begin.startswith(content)):
            raise self._unreadable(f"it does not begin with {begin.decode()}")
        if whole := content.rpartition(b"\n")[0]:
            head, *self._lines = whole.split(b"\n")
            self.head, self._whole = self._parsed(1, head), len(whole) + 1

    def _parsed(self, number: int, line: bytes) -> dict[str, Any]:
        try:
            return dict(json.loads(line))
        except (ValueError, TypeError, RecursionError) as error:
            raise self._unreadable(f"line {number}: {error}") from None

    def _unreadable(self, reason: str) -> InputError:
        return InputError(
            f"path must be a file of an earlier {self._what}, or none yet; {self._path} cannot be read as one "
            f"({reason:.200}). Give another path, or remove the file."
        )
