"""Runs tasks through any executor, or in threads of its own."""

import os
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Generic, TypeVar

from mpsim.core import files
from mpsim.core.machine import usable_cores
from mpsim.errors import InputError

POLL_SECONDS = 0.2
"""Seconds between two checks for signals while threads run: one delivered to another thread wakes no waiting one."""

MOST_SUBMITTED = 4096
"""Tasks that an executor holds at most: many for each worker of a large cluster, without memory for millions."""

Key = TypeVar("Key")
Task = tuple[Key, tuple[Any, ...]]
"""(key, (function, argument, ...))"""


class Stopped(Exception):  # noqa: N818 - not an error
    """The run is no longer needed."""


class Runner(Generic[Key]):
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

    def __enter__(self) -> "Runner[Key]":
        return self

    def __exit__(self, *exception: object) -> None:
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
                self.__exit__()
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
                raise InputError(
                    f"executor must accept tasks; got {type(self._executor).__name__}, which does not ({error}). Make "
                    "one that is not shut down, and call inside its `with` block."
                ) from error
            future = Future[Any]()
            future.set_exception(error)
            return future


def checked_path(path: str | os.PathLike[str]) -> Path:
    """A path that can be written, checked before the long work.

    Raises:
        InputError: if it cannot.
    """
    try:
        files.check_target(Path(path))
    except (OSError, TypeError, ValueError) as error:  # the last two: no path at all
        raise InputError(
            f"path must be a file in a folder that can be written to; got {path!r} "
            f"({getattr(error, 'strerror', None) or error}). Make the folder, or give another path."
        ) from None
    return Path(path)
