"""Progress of runs, studies and commands on standard error: fraction done, rate, time left.

On a terminal and in a notebook it is a line that is rewritten; elsewhere, as in a log file, a new line now and then.
"""

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TextIO

from mpsim.core import checks
from mpsim.core.text import duration
from mpsim.errors import InputError

Show = Callable[[int, int, str], None]
"""Called as show(done, of, what)."""

OFTEN, SPARSE = 0.1, 10.0
"""Seconds between two states of a line that is rewritten, and between two lines elsewhere."""

BAR = 20
"""Characters of the bar."""

WIDTH = 100
"""Columns of a notebook, and of a terminal whose width is unknown."""

ERASE = "\x1b[K"
"""Erases a line of a terminal from the cursor on."""


def checked_progress(progress: Any, call: str) -> Any:
    """What is to be done with the progress: None, a truth value, or a function that is called as `call` says.

    >>> checked_progress(3, "progress(done, of)")
    Traceback (most recent call last):
        ...
    mpsim.InputError: progress must be True, False or a function, called as progress(done, of); got 3. \
Use True to see it on standard error.
    """
    if not (progress is None or isinstance(progress, bool) or callable(progress)):
        raise InputError(
            f"progress must be True, False or a function, called as {call}; got {checks.brief(progress)}. "
            "Use True to see it on standard error."
        )
    return progress


def is_watched() -> bool:
    """Whether standard error is a terminal or a notebook, where a line can be rewritten."""
    terminal = sys.stderr is not None and sys.stderr.isatty() and os.environ.get("TERM") != "dumb"
    return terminal or _is_notebook(sys.stderr)


@contextmanager
def shown(progress: bool | Show | None, *, last: bool = True) -> Iterator[Show]:
    """A function that shows progress: on standard error if that is True, or the one that is given.

    Args:
        progress: what to do with it; None and False: nothing.
        last: whether the end too is a line where no line can be rewritten.
    """
    if callable(progress):
        yield progress
    elif not progress or sys.stderr is None:
        yield lambda done, of, what: None
    elif is_watched():
        line = _Line(sys.stderr)
        _lines.append(line)
        try:
            yield line
        finally:
            _lines.remove(line)
            line.end()
    else:
        yield _Lines(last)


def above(text: str) -> bool:
    """Print a text above the line that is shown now; False if none is."""
    if not _lines:
        return False
    _lines[-1].above(text)
    return True


@contextmanager
def of_frames(progress: bool | Callable[[int, int], None] | None, what: str = "frames") -> Iterator[Any]:
    """As `shown`, of a function that is called as progress(done, of); None where nothing is to be shown."""
    if callable(progress) or not progress:
        yield progress or None
    else:
        with shown(True) as show:
            yield lambda done, of: show(done, of, what)


_lines: list["_Line"] = []
"""Lines that are shown now."""


class _Rate:
    """Rate of progress since the first call, and remaining time."""

    def __init__(self) -> None:
        self._first: int | None = None
        self._started = 0.0

    def words(self, done: int, of: int) -> list[str]:
        """Such as ["120/s", "12 s left"]; none before anything is known."""
        now = time.monotonic()
        if self._first is None or done < self._first:  # less after a run has gone back to a snapshot
            self._first, self._started = done, now
        seconds, gained = now - self._started, done - self._first
        if seconds <= 0 or gained <= 0:
            return []
        rate = gained / seconds
        left = [f"{duration((of - done) / rate)} left"] if done < of else []
        return [f"{rate:,.0f}/s" if rate >= 100 else f"{rate:.3g}/s", *left]


class _Line:
    """A line that is rewritten."""

    def __init__(self, stream: TextIO):
        self._stream = stream
        self._notebook = _is_notebook(stream)
        self._rate = _Rate()
        self._due = 0.0
        self._text = ""

    def __call__(self, done: int, of: int, what: str) -> None:
        if is_announcement(done, of):
            self.above(what)
            return
        now = time.monotonic()
        if now < self._due and done < of:
            return
        self._due = now + OFTEN
        filled = BAR * done // of if of else BAR
        bar = f"[{'#' * filled}{' ' * (BAR - filled)}]"
        text = ", ".join([f"{what} {bar} {done}/{of}", *self._rate.words(done, of)])
        self._write(text[: self._width() - 1])

    def above(self, text: str) -> None:
        """Print a text above the line."""
        shown, self._text = self._text, ""
        start = f"\r{' ' * len(shown)}\r" if self._notebook else ""
        self._stream.write(f"{start}{text}{'' if self._notebook else ERASE}\n")
        self._write(shown)

    def end(self) -> None:
        """The line goes from a terminal; in a notebook it stays."""
        self._stream.write("\n" if self._notebook else ERASE)
        self._stream.flush()

    def _write(self, text: str) -> None:
        """On a terminal the cursor stands before the line, so that other texts replace it."""
        self._stream.write(f"\r{text:<{len(self._text)}}" if self._notebook else f"{text}{ERASE}\r")
        self._stream.flush()
        self._text = text

    def _width(self) -> int:
        try:
            return os.get_terminal_size(self._stream.fileno()).columns or WIDTH
        except (OSError, ValueError):
            return WIDTH


class _Lines:
    """A line every SPARSE seconds, and perhaps one at the end."""

    def __init__(self, last: bool) -> None:
        self._shown = time.monotonic()
        self._rate = _Rate()
        self._last = last

    def __call__(self, done: int, of: int, what: str) -> None:
        if is_announcement(done, of):
            print(what, file=sys.stderr)
            return
        words = self._rate.words(done, of)
        if time.monotonic() - self._shown >= SPARSE or (self._last and done >= of):
            self._shown = time.monotonic()
            print(", ".join([f"{done} of {of}: {what}", *words]), file=sys.stderr)


def is_announcement(done: int, of: int) -> bool:
    """Whether a call of progress announces what comes, rather than what is done."""
    return (done, of) == (0, 1)


def _is_notebook(stream: object) -> bool:
    return type(stream).__module__.startswith("ipykernel")
