"""Progress of runs, studies and commands on standard error: fraction done, rate, time left.

It is a line of a terminal or a notebook, which is rewritten; elsewhere nothing is shown.
"""

import importlib
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from mpsim.core import checks

Show = Callable[[int, int, str], None]  # called as show(done, of, what)

OFTEN = 0.1  # seconds between two states of the line


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


@contextmanager
def shown(progress: bool | Show | None) -> Iterator[Show]:
    """A function that shows progress: on standard error if that is True, or the one that is given.

    Args:
        progress: what to do with it; None and False: nothing.
    """
    stream = sys.stderr
    is_notebook = type(stream).__module__.startswith("ipykernel")
    is_terminal = stream is not None and stream.isatty() and os.environ.get("TERM") != "dumb"
    if callable(progress):
        yield progress
    elif not (progress and (is_terminal or is_notebook)):
        yield lambda done, of, what: None
    else:
        rich = importlib.import_module("rich.progress")  # for those who see it alone: it takes long
        bar = rich.Progress(
            rich.TextColumn("{task.description}", markup=False),
            rich.BarColumn(20),
            rich.MofNCompleteColumn(),
            "{task.fields[rate]}",
            rich.TimeRemainingColumn(),
            console=rich.Console(file=stream, force_terminal=True, force_jupyter=False),
            auto_refresh=False,  # by a thread, which a fork would not have
            transient=is_terminal,
            redirect_stdout=False,
            redirect_stderr=False,
            get_time=time.monotonic,
        )
        with bar:
            _bars.append(bar)
            try:
                yield _show_on(bar)
            finally:
                _bars.remove(bar)


@contextmanager
def of_frames(progress: bool | Callable[[int, int], None] | None, what: str = "frames") -> Iterator[Any]:
    """As `shown`, of a function that is called as progress(done, of); None where nothing is to be shown."""
    if callable(progress) or not progress:
        yield progress or None
    else:
        with shown(True) as show:
            yield lambda done, of: show(done, of, what)


_bars: list[Any] = []
"""What is shown now, each a rich.progress.Progress."""


def above(text: str) -> bool:
    """Print a text above the line that is shown now; False if none is."""
    if _bars:
        _bars[-1].console.print(text, markup=False, emoji=False, highlight=False, soft_wrap=True)
    return bool(_bars)


def _show_on(bar: Any) -> Show:
    """The function that shows progress on a bar."""
    task, due = bar.add_task("", visible=False, rate=""), 0.0

    def show(done: int, of: int, what: str) -> None:
        nonlocal due
        if (done, of) == (0, 1):  # which announces what comes
            above(what)
            return
        bar.update(task, completed=done, total=of, description=what, visible=True)
        if (now := time.monotonic()) >= due:
            due, speed = now + OFTEN, bar.tasks[0].speed or 0.0
            rate = f"{speed:,.0f}/s" if speed >= 100 else f"{speed:.3g}/s" if speed else ""
            bar.update(task, rate=rate, refresh=True)

    return show
