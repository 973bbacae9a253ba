"""What commands share: kinds of arguments, progress, JSON."""

import json
import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import click

SPARSE = 10.0
"""Seconds between two lines of progress where nobody watches a terminal."""

Progress = Callable[[int, int, str], None]
"""Called as progress(done, of, what)."""


class Positive(click.ParamType):
    """A number above 0; `percent`: perhaps with a per cent sign.

    >>> Positive(percent=True).convert("1%", None, None)
    0.01
    """

    def __init__(self, what: str = "number", percent: bool = False):
        self.name = what
        self._percent = percent

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The number that a text stands for."""
        text = str(value).strip()
        scale = 0.01 if self._percent and text.endswith("%") else 1.0
        try:
            number = float(text[:-1] if scale != 1 else text) * scale
        except ValueError:
            number = math.nan
        if not (math.isfinite(number) and number > 0):
            example = "0.05 or 5%" if self._percent else "0.05"
            self.fail(f"{value!r} must be a number > 0, such as {example}.", param, ctx)
        # 7 * 0.01 is 0.07 but for rounding
        return float(f"{number:.15g}")


def quiet_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """The option --quiet."""
    return click.option("-q", "--quiet", is_flag=True, help="Show no progress.")(command)


@contextmanager
def progress(quiet: bool) -> Iterator[Progress | None]:
    """A bar on a terminal, a line now and then elsewhere, nothing under --quiet. On standard error."""
    if quiet:
        yield None
    elif sys.stderr.isatty():
        with _bar() as bar:
            yield bar
    else:
        yield _Lines()


@contextmanager
def _bar() -> Iterator[Progress]:
    from rich import progress as rich_progress  # noqa: PLC0415 - only where somebody watches
    from rich.console import Console  # noqa: PLC0415

    columns = (
        rich_progress.TextColumn("{task.description:40.40}", markup=False),
        rich_progress.BarColumn(),
        rich_progress.MofNCompleteColumn(),
        rich_progress.TimeElapsedColumn(),
    )
    with rich_progress.Progress(*columns, console=Console(stderr=True), transient=True) as display:
        task = display.add_task("starting", total=None)
        yield lambda done, of, what: display.update(task, completed=done, total=of, description=what)


class _Lines:
    """One line every SPARSE seconds."""

    def __init__(self) -> None:
        self._last = time.monotonic()

    def __call__(self, done: int, of: int, what: str) -> None:
        if time.monotonic() - self._last >= SPARSE:
            self._last = time.monotonic()
            click.echo(f"{done} of {of}: {what}", err=True)


def json_text(value: Any) -> str:
    """Plain values as JSON; a number that JSON lacks becomes null."""
    return json.dumps(_plain(value), indent=1, ensure_ascii=False)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(name): _plain(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
