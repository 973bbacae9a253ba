"""Arguments, shared by the commands."""

import dataclasses
import functools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from mpsim.core.progress import above
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.scene import scenefile
from mpsim.scene.scene import settings_for
from mpsim.scene.scenefile import SceneFile
from mpsim.scene.settings import CONTACTS, LAWS, METHODS, MOST_WORKERS, ON_FAST, PRECISIONS, Settings

INTERRUPTED = 130  # exit code after Ctrl-C, that of a shell


class Number(click.FloatRange):
    """A finite number in a range."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{str(value)!r} must be a finite number.", param, ctx)
        return number


POSITIVE, NOT_NEGATIVE = Number(0, min_open=True), Number(0)
PATH, FILE = click.Path(path_type=Path), click.Path(dir_okay=False, path_type=Path)


class Share(click.ParamType):
    """A number above 0, which may have a per cent sign, and is less than `below`.

    >>> Share().convert("1%", None, None)
    0.01
    """

    name = "error"

    def __init__(self, below: float = math.inf):
        self._below = below

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        text = str(value).strip()
        try:
            number = float(text.removesuffix("%")) * (0.01 if text.endswith("%") else 1)
        except ValueError:
            number = math.nan
        if not 0 < number < self._below:  # nor NaN
            less = "" if self._below == math.inf else f" and less than {self._below:.0%}"
            self.fail(f"{value!r} must be a number > 0{less}, such as 0.05 or 5%.", param, ctx)
        return float(f"{number:.15g}")  # 7 * 0.01 is 0.07 but for rounding


class Interrupted(Exception):  # noqa: N818 - it is no error
    """Ctrl-C was pressed; the text says what has been done and kept."""


def complete_scene(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Names of scenes for a shell, and files."""
    names = [CompletionItem(name) for name in scenefile.names() if name.startswith(incomplete)]
    return [*names, CompletionItem(incomplete, type="file")]


def existing_refused(path: Path, force: bool) -> None:
    """Refuse to overwrite a file unless --force was given."""
    if path.exists() and not force:
        raise click.UsageError(f"{str(path)!r} exists already, and is not overwritten. Give another name, or --force.")


SETTINGS: dict[str, tuple[click.ParamType, str]] = {
    "--dt": (POSITIVE, "Time step of a frame."),
    "--method": (click.Choice(METHODS), "How colliding pairs are found; event is exact."),
    "--workers": (click.IntRange(1, MOST_WORKERS), "Processes; default: at most one per core."),
    "--contact": (click.Choice(CONTACTS), "How overlaps are resolved. impact: second order in dt; push: first order."),
    "--law": (click.Choice(LAWS), "elastic conserves momentum; reflect mirrors velocities, as in the report."),
    "--precision": (click.Choice(PRECISIONS), "Number format of positions and velocities."),
    "--passes": (click.IntRange(1, 1000), "Searches for contacts in each step."),
    "--substeps": (click.IntRange(1, 1_000_000), "Steps in each frame."),
    "--on-fast": (click.Choice(ON_FAST), "What to do if discs move too far in a step."),
    "--contact-time": (POSITIVE, "event: impacts within this time of the previous one lose no energy."),
}


def option(names: str, kind: click.ParamType, text: str, default: Any = None, **more: Any) -> Callable[..., Any]:
    """An option that takes a value; names: as click takes them, with spaces between. A default is shown in the help."""
    shown_too = default is not None
    return click.option(*names.split(), type=kind, help=text, default=default, show_default=shown_too, **more)


def together(*options: Callable[..., Any]) -> Callable[..., Any]:
    """Several options, which the help shows in this order, as one decorator."""
    return lambda command: functools.reduce(lambda made, option: option(made), reversed(options), command)


settings_options = together(*(option(name, kind, text) for name, (kind, text) in SETTINGS.items()))
"""The settings as options; `settings_of` puts them together."""


def settings_of(file: SceneFile, options: dict[str, Any]) -> Settings:
    """The settings that the scene recommends, replaced by the options that were given."""
    given = {name: value for name, value in options.items() if value is not None}
    settings = dataclasses.replace(settings_for(file.scene, None), **given)
    if capabilities_of(settings).on_ranks:
        raise click.UsageError(
            f"A command runs in one process and its workers; method {settings.method!r} is for programs on the ranks "
            "of MPI. Give --method grid, which has the same bits."
        )
    return settings


def _note_quiet(ctx: click.Context, param: click.Parameter | None, quiet: bool) -> bool:
    ctx.meta[_QUIET] = quiet  # for what is shown by those whom no command calls
    return quiet


_QUIET = f"{__name__}.quiet"

quiet_option = click.option("-q", "--quiet", is_flag=True, help="Show no progress.", callback=_note_quiet)
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON.")
force_option = click.option("--force", is_flag=True, help="Replace an existing file.")


def say_compiling(meta: dict[str, Any], text: str | None) -> None:
    """Say on standard error that kernels are compiled; nothing with --quiet. meta: of the context of the command."""
    if text is not None and not meta.get(_QUIET) and not above(text):
        click.echo(text, err=True)
