"""Runs independent tasks on any executor, yields results as they come, and cancels those that have not started."""

from collections.abc import Iterable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future
from queue import Empty, SimpleQueue
from typing import Any, Generic, TypeVar

from mpsim.errors import InputError

POLL_SECONDS = 0.2
"""Seconds between two checks for signals while threads run: one delivered to another thread wakes no waiting one."""

MOST_SUBMITTED = 4096
"""Tasks that an executor holds at most: many for each worker of a large cluster, without memory for millions."""

Key = TypeVar("Key")


def checked_executor(executor: Any) -> Executor | None:
    """An executor, or None, checked.

    Raises:
        InputError: if it is not an executor.
    """
    if executor is not None and not isinstance(executor, Executor):
        raise InputError(
            f"executor must be a concurrent.futures.Executor; got {type(executor).__name__}. Use "
            "ProcessPoolExecutor(), Dask's client.get_executor(), mpi4py's MPIPoolExecutor(), or leave it out."
        )
    return executor


class Submissions(Generic[Key]):
    """Tasks that are handed to an executor, at most MOST_SUBMITTED of them at a time.

    Args:
        executor: any of concurrent.futures.
        tasks: (key, (function, argument, ...)) each; read as far as tasks are handed over.
    """

    def __init__(self, executor: Executor, tasks: Iterable[tuple[Key, tuple[Any, ...]]]):
        self._executor = executor
        self._tasks = iter(tasks)
        self._pending: dict[Future[Any], Key] = {}
        self._finished: SimpleQueue[Future[Any]] = SimpleQueue()

    def finished(self) -> Iterator[tuple[Key, Future[Any]]]:
        """Each key with its future, when that is done. After an executor has broken, futures hold its error."""
        while self._submit():
            try:
                future = self._finished.get(timeout=POLL_SECONDS)
            except Empty:
                continue
            yield self._pending.pop(future), future

    def _submit(self) -> bool:
        """Hand over what there is room for; returns whether anything is pending."""
        while len(self._pending) < MOST_SUBMITTED and (task := next(self._tasks, None)) is not None:
            key, call = task
            future = self._future(call)
            self._pending[future] = key
            future.add_done_callback(self._finished.put)
        return bool(self._pending)

    def _future(self, call: tuple[Any, ...]) -> Future[Any]:
        """The future of a task; it holds the error of an executor that has broken, or could not send the task."""
        try:
            return self._executor.submit(*call)
        except Exception as error:
            if isinstance(error, RuntimeError) and not isinstance(error, BrokenExecutor):
                raise InputError(
                    f"executor must accept tasks; got {type(self._executor).__name__}, which does not ({error}). Make "
                    "one that is not shut down, and call inside its `with` block."
                ) from error
            future = Future[Any]()
            future.set_exception(error)
            return future

    def cancel(self) -> None:
        """Cancel the tasks that have not started."""
        for future in tuple(self._pending):
            future.cancel()

    def left(self) -> Iterator[tuple[Key, Future[Any]]]:
        """Tasks that have succeeded, and that `finished` has not yielded."""
        for future, key in self._pending.items():
            if future.done() and not future.cancelled() and future.exception() is None:
                yield key, future
