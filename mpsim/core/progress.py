"""Progress of runs, studies and commands on standard error: fraction done, rate, time left.

On a terminal and in a notebook it is a line that is rewritten; elsewhere, as in a log file, a new line now and then.
"""

import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TextIO

from mpsim.core import checks
from mpsim.core.text import duration

Show = Callable[[int, int, str], None]
"""Called as show(done, of, what)."""

OFTEN, SPARSE = 0.1, 10.0
"""Seconds between two states of a line that is rewritten, and between two lines elsewhere."""

BAR = 20
"""Characters of the bar."""


def checked_progress(progress: Any, call: str) -> Any:
    """What is to be done with the progress: None, a truth value, or a function that is called as `call` says.

    >>> checked_progress(3, "progress(done, of)")
    Traceback (most recent call last):
        ...
    mpsim.InputError: progress must be True, False or a function, called as progress(done, of); got 3. \
Use True to see it on standard error.
    """
    if not (progress is None or isinstance(progress, bool) or callable(progress)):
        rule = f"be True, False or a function, called as {call}"
        raise checks.refusal("progress", rule, checks.brief(progress), "Use True to see it on standard error.")
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
        return
    if not progress or sys.stderr is None:
        yield lambda done, of, what: None
        return
    line = _Line(sys.stderr, is_watched(), last)
    _lines.append(line)
    try:
        yield line
    finally:
        _lines.remove(line)
        line.end()


def above(text: str) -> bool:
    """Print a text above the line that is shown now; False if none is."""
    if _lines:
        _lines[-1].above(text)
    return bool(_lines)


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


class _Line:
    """Progress on a stream: a line that is rewritten if somebody watches, else a new line now and then.

    last: whether the end too is a new line.
    """

    def __init__(self, stream: TextIO, watched: bool, last: bool):
        self._stream, self._watched, self._last = stream, watched, last
        self._due = time.monotonic() + (0.0 if watched else SPARSE)
        self._first: int | None = None
        self._started = 0.0
        self._text = ""

    def __call__(self, done: int, of: int, what: str) -> None:
        if (done, of) == (0, 1):  # which announces what comes
            self.above(what)
            return
        now = time.monotonic()
        if self._first is None or done < self._first:  # less after a run has gone back to a snapshot
            self._first, self._started = done, now
        if now < self._due and not (done >= of and (self._watched or self._last)):
            return
        self._due = now + (OFTEN if self._watched else SPARSE)
        words = ", ".join([what, *self._rate(now, done, of)])
        if self._watched:
            filled = BAR * done // of if of else BAR
            words = words.replace(what, f"{what} [{'#' * filled}{' ' * (BAR - filled)}] {done}/{of}", 1)
            self._write(words[: shutil.get_terminal_size((100, 24)).columns - 1])
        else:
            self.above(f"{done} of {of}: {words}")

    def _rate(self, now: float, done: int, of: int) -> list[str]:
        """Rate since the first call and remaining time, such as ["120/s", "12 s left"]; none before they are known."""
        seconds, gained = now - self._started, done - (self._first or 0)
        if seconds <= 0 or gained <= 0:
            return []
        rate = gained / seconds
        left = [f"{duration((of - done) / rate)} left"] if done < of else []
        return [f"{rate:,.0f}/s" if rate >= 100 else f"{rate:.3g}/s", *left]

    def above(self, text: str) -> None:
        """Print a text above the line."""
        shown = self._text
        self._write("")
        self._stream.write(f"{text}\n")
        self._write(shown)

    def end(self) -> None:
        """The line goes from a terminal; in a notebook it stays."""
        if _is_notebook(self._stream):
            self._stream.write("\n")
        else:
            self._write("")

    def _write(self, text: str) -> None:
        """Show a text in the place of the line."""
        if self._text or text:
            blank = f"\r{' ' * len(self._text)}\r" if len(text) < len(self._text) else "\r"
            self._stream.write(f"{blank}{text}")
        self._stream.flush()
        self._text = text


def _is_notebook(stream: object) -> bool:
    return type(stream).__module__.startswith("ipykernel")
