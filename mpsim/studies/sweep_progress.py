"""Progress of a sweep: how many runs are done, how many failed, and how long the rest may take."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, cast

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from mpsim.core import checks
from mpsim.core.durations import duration
from mpsim.core.errors import InputError

SPARSE = 10.0
"""Seconds between two lines of progress without a terminal."""

Show = Callable[[int, int, str], None]
"""Called as show(done, of, what)."""


class Pace:
    """Runs that are done in a sweep, in words.

    Args:
        of: number of all runs.
        done: number of those that a file has.
    """

    def __init__(self, of: int, done: int):
        self.of: int = of
        self.done: int = done
        self.failed: int = 0
        self._first, self._started = done, time.monotonic()

    def add(self, failed: bool) -> None:
        """Count a run."""
        self.done, self.failed = self.done + 1, self.failed + failed

    @property
    def words(self) -> str:
        """Such as "runs, 2 failed, 50 s left"."""
        gained = self.done - self._first
        seconds = time.monotonic() - self._started
        failed = f"{self.failed} failed" if self.failed else ""
        rest = self.of - self.done
        left = f"{duration(rest * seconds / gained)} left" if gained and rest else ""
        return ", ".join(filter(None, ["runs", failed, left]))


def checked_progress(progress: Any) -> bool | Show | None:
    """What shall be done with the progress, checked."""
    if not (progress is None or isinstance(progress, bool) or callable(progress)):
        raise InputError(
            f"progress must be True, False or a function, called as progress(done, of, what); got "
            f"{checks.brief(progress)}. Use True to see it on standard error."
        )
    return cast("bool | Show | None", progress)


@contextmanager
def shown(progress: bool | Show | None) -> Iterator[Show]:
    """A function that shows progress: on standard error if that is True, a bar on a terminal, lines elsewhere."""
    if callable(progress):
        yield progress
    elif not progress:
        yield lambda done, of, what: None
    elif not (console := Console(stderr=True)).is_terminal:
        yield _Lines()
    else:
        columns = (BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}", markup=False))
        with Progress(*columns, console=console) as bar:
            task = bar.add_task("runs", total=None)
            yield lambda done, of, what: bar.update(task, completed=done, total=of, description=what)


class _Lines:
    """A line every SPARSE seconds, and one at the end."""

    def __init__(self) -> None:
        self._last = time.monotonic()

    def __call__(self, done: int, of: int, what: str) -> None:
        if done == of or time.monotonic() - self._last >= SPARSE:
            self._last = time.monotonic()
            print(f"{done} of {of} {what}", file=sys.stderr)
