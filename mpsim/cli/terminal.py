"""Arguments, progress bars and MPI ranks, shared by the commands."""

import contextlib
import dataclasses
import io
import logging
import math
import re
import signal
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from mpsim.core import checks
from mpsim.core.deferred_signals import Noted
from mpsim.core.progress import Show, above, shown
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.engine.solvers.mpi_ranks import library
from mpsim.errors import InputError
from mpsim.output.frames import FirstRank
from mpsim.scene import scenefile
from mpsim.scene.scene import settings_for
from mpsim.scene.scenefile import SceneFile
from mpsim.scene.settings import CONTACTS, LAWS, METHODS, MOST_WORKERS, ON_FAST, PRECISIONS, Settings

# --- Kinds of arguments and progress bars, shared by the commands

INTERRUPTED = 130
"""Exit code after Ctrl-C, that of a shell."""


class Positive(click.ParamType):
    """A number above 0. `percent`: it may have a per cent sign; `below`: it must be less than this.

    >>> Positive(percent=True).convert("1%", None, None)
    0.01
    """

    _zero = False

    def __init__(self, what: str = "number", percent: bool = False, below: float = math.inf):
        self.name = what
        self._percent = percent
        self._below = below

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The number that a text stands for."""
        text = str(value).strip()
        scale = 0.01 if self._percent and text.endswith("%") else 1.0
        try:
            number = float(text[:-1] if scale != 1 else text) * scale
        except ValueError:
            number = math.nan
        if not math.isfinite(number) or number < 0 or (number == 0 and not self._zero):
            example = "0.05 or 5%" if self._percent else "0.05"
            self.fail(f"{value!r} must be a number {'>=' if self._zero else '>'} 0, such as {example}.", param, ctx)
        if number >= self._below:
            self.fail(f"{value!r} must be less than {self._below:.0%}. Give a smaller one, such as 5%.", param, ctx)
        # 7 * 0.01 is 0.07 but for rounding
        return float(f"{number:.15g}")


class NonNegative(Positive):
    """A number that may be 0.

    >>> NonNegative().convert("0", None, None)
    0.0
    """

    _zero = True


class Whole(click.IntRange):
    """A whole number in a range; the error says which, and suggests one.

    >>> Whole(1).convert("5.5", None, None)
    Traceback (most recent call last):
        ...
    click.exceptions.BadParameter: '5.5' must be a whole number >= 1. Give 5 or 6.
    """

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """The number that a text stands for."""
        try:
            return super().convert(value, param, ctx)
        except click.BadParameter:
            pass
        numbers = f">= {self.min}" if self.max is None else f"from {self.min} to {self.max}"
        with contextlib.suppress(ValueError, OverflowError):  # of what is no number, or infinite
            low = math.floor(float(value))
            near = [each for each in (low, low + 1) if float(value) % 1 and self._fits(each)]
            hint = f" Give {' or '.join(map(str, near))}." if near else ""
            self.fail(f"{str(value)!r} must be a whole number {numbers}.{hint}", param, ctx)
        self.fail(f"{str(value)!r} must be a whole number {numbers}.", param, ctx)

    def _fits(self, number: int) -> bool:
        return (self.min is None or number >= self.min) and (self.max is None or number <= self.max)


class OneOf(click.Choice[str]):
    """One of some words; the error suggests one that is similar.

    >>> OneOf(("warn", "substep")).convert("substp", None, None)
    Traceback (most recent call last):
        ...
    click.exceptions.BadParameter: 'substp' is not one of 'warn', 'substep'. Did you mean 'substep'?
    """

    def get_invalid_choice_message(self, value: Any, ctx: click.Context | None) -> str:
        meant = checks.near(value, self.choices)
        words = super().get_invalid_choice_message(value, ctx)
        return f"{words} Did you mean {meant!r}?" if meant else words


class Interrupted(Exception):  # noqa: N818 - it is no error
    """Ctrl-C was pressed; the text says what has been done and kept."""


def complete_scene(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Names of scenes for a shell, and files."""
    names = [CompletionItem(name) for name in scenefile.names() if name.startswith(incomplete)]
    return [*names, CompletionItem(incomplete, type="file")]


def in_options(text: str, command: click.Command) -> str:
    """A message of the library in the words of a command, whose options stand for arguments.

    >>> command = click.Command("run", params=[click.Option(["--on-fast"]), click.Option(["--dt"])])
    >>> in_options("Use dt=0.079 or on_fast='substep', or Settings(dt=0.05)", command)
    'Use --dt 0.079 or --on-fast substep, or --dt 0.05'
    >>> in_options("dt must be a finite number > 0", command)
    '--dt must be a finite number > 0'
    """
    options = {str(each.name): each.opts[0] for each in command.params if isinstance(each, click.Option)}
    if not options:
        return text
    names = "|".join(map(re.escape, options))

    def option(found: re.Match[str]) -> str:
        return f"{options[found[1]]} {found[2].strip(chr(39))}"

    text = re.sub(rf"\bSettings\(((?:{names})=[^()]*)\)", lambda found: found[1].replace(", ", " "), text)
    text = re.sub(rf"\b({names})=('[\w-]+'|[\w.+-]*\w)", option, text)
    rule = rf"^({names})(?= must\b)|(?<= must not come with )({names})\b(?: or ({names})\b)?"
    return re.sub(rule, lambda found: " or ".join(options[name] for name in found.groups() if name), text)


def existing_refused(path: Path, force: bool) -> None:
    """Refuse to overwrite a file unless --force was given.

    Raises:
        click.UsageError: naming the file.
    """
    if path.exists() and not force:
        raise click.UsageError(f"{str(path)!r} exists already, and is not overwritten. Give another name, or --force.")


def settings_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """The settings as options; `settings_of` puts them together."""
    for option in reversed(
        [
            click.option("--dt", type=Positive("time"), help="Time step of a frame."),
            click.option("--method", type=OneOf(METHODS), help="How colliding pairs are found; event is exact."),
            click.option("--workers", type=Whole(1, MOST_WORKERS), help="Processes; default: at most one per core."),
            click.option(
                "--contact",
                type=OneOf(CONTACTS),
                help="How overlaps are resolved. impact: second order in dt; push: first order.",
            ),
            click.option(
                "--law",
                type=OneOf(LAWS),
                help="elastic conserves momentum; reflect mirrors velocities, as in the report.",
            ),
            click.option("--precision", type=OneOf(PRECISIONS), help="Number format of positions and velocities."),
            click.option("--passes", type=Whole(1, 1000), help="Searches for contacts in each step."),
            click.option("--substeps", type=Whole(1, 1_000_000), help="Steps in each frame."),
            click.option("--on-fast", type=OneOf(ON_FAST), help="What to do if discs move too far in a step."),
            click.option(
                "--contact-time",
                type=Positive("time"),
                help="event: impacts within this time of the previous one lose no energy.",
            ),
        ]
    ):
        command = option(command)
    return command


def settings_of(file: SceneFile, options: dict[str, Any], on_ranks: bool = False) -> Settings:
    """The settings that the scene recommends, replaced by the options that were given.

    on_ranks: whether the command can run on ranks.
    """
    given = {name: value for name, value in options.items() if value is not None}
    settings = dataclasses.replace(settings_for(file.scene, None), **given)
    if not on_ranks and capabilities_of(settings).on_ranks:
        raise click.UsageError(
            f"This command runs in one process, and method {settings.method!r} on ranks. Give --method grid, "
            "which has the same bits."
        )
    return settings


def json_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """The option --json."""
    return click.option("--json", "as_json", is_flag=True, help="Print JSON.")(command)


def quiet_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """The option --quiet."""
    return click.option("-q", "--quiet", is_flag=True, help="Show no progress.", callback=_note_quiet)(command)


def be_quiet() -> None:
    """Show no progress from now on, as with --quiet."""
    _note_quiet(click.get_current_context(), None, True)


def _note_quiet(ctx: click.Context, param: click.Parameter | None, quiet: bool) -> bool:
    ctx.meta[_QUIET] = quiet  # for what is shown by those whom no command calls
    return quiet


_QUIET = f"{__name__}.quiet"


@contextmanager
def progress(quiet: bool) -> Iterator[Show | None]:
    """Shows progress on standard error; nothing with --quiet."""
    if quiet:
        yield None
    else:
        with shown(True, last=False) as show:
            yield show


class Compiling:
    """Shows that kernels are compiled: a spinner on a terminal, a line elsewhere, nothing with --quiet.

    Args:
        meta: of the context of the command.
    """

    def __init__(self, meta: dict[str, Any]):
        self._meta = meta
        self._spinner: Any = None

    def begin(self, text: str) -> None:
        """Show what is being compiled. On standard error."""
        if self._meta.get(_QUIET):
            return
        if above(text):
            return
        if not sys.stderr.isatty():
            click.echo(text, err=True)
        else:
            from rich.console import Console  # noqa: PLC0415 - only on a terminal

            self._spinner = Console(stderr=True).status(text)
            self._spinner.start()

    def end(self) -> None:
        """Compilation has ended: remove the spinner, leave a line."""
        if self._spinner is not None:
            self._spinner.stop()
            self._spinner = None


# --- Commands on MPI ranks: the first rank prints and writes; if one rank ends, all end

PATIENCE = 2.0
"""Seconds for which a rank that fails waits for the others to fail as well."""

DELIVERY = 0.5
"""Seconds between the last words of a rank and the end of the job, when `mpiexec` drops what it has not read."""


@contextlib.contextmanager
def one_voice(on_ranks: bool) -> Iterator[FirstRank]:
    """Let only the first rank print. Yields that rank, which also writes files; without ranks it is this process.

    An error on all ranks is reported by the first one, and all end. An error on some of them is reported by these, and
    they end the job, as the others would wait for them for ever.

    Raises:
        InputError: if there is no MPI.
    """
    if not on_ranks:
        yield FirstRank()
        return
    world = library().COMM_WORLD.Dup()  # on which nobody else calls: ranks come to their end between any two calls
    speaks = world.rank == 0
    try:
        with contextlib.nullcontext() if speaks else _silence():
            first_rank = FirstRank(library().COMM_WORLD)
            yield first_rank
            first_rank.close()
    except BaseException as error:
        if not _all_fail(world):
            click.echo(f"mpsim: rank {world.rank}: {type(error).__name__}: {error}", err=True)
            time.sleep(DELIVERY)
            library().COMM_WORLD.Abort(_code_of(error))
        if speaks:
            raise
        raise SystemExit(_code_of(error)) from None


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Show nothing: no results, progress, warnings and logs."""
    be_quiet()
    logger, nothing = logging.getLogger("mpsim"), lambda record: False
    logger.addFilter(nothing)
    try:
        with (
            contextlib.redirect_stdout(io.StringIO()),
            contextlib.redirect_stderr(io.StringIO()),
            warnings.catch_warnings(),
        ):
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.removeFilter(nothing)


@contextlib.contextmanager
def interrupts_agreed(first_rank: FirstRank) -> Iterator[Callable[[], None]]:
    """Let Ctrl-C reach all ranks at one place of a run, where all make the call that this yields.

    Otherwise it would reach each of them somewhere else, and the others would wait there for ever. Without ranks,
    Ctrl-C works as usual.
    """
    if first_rank.comm is None:
        yield lambda: None
        return
    noted = Noted(signal.SIGINT)
    noted.begin()

    def raise_if_any() -> None:
        if first_rank.any_of(noted.came):
            raise KeyboardInterrupt

    try:
        yield raise_if_any
    finally:
        noted.end()


def _all_fail(world: Any) -> bool:
    """Whether all ranks arrive here within PATIENCE."""
    all_here, end = world.Ibarrier(), time.monotonic() + PATIENCE
    while not all_here.Test():
        if time.monotonic() > end:
            return False
        time.sleep(0.01)
    return True


def _code_of(error: BaseException) -> int:
    """Exit code of a command that ends by an exception."""
    if isinstance(error, SystemExit):
        return error.code if isinstance(error.code, int) else 1
    if isinstance(error, (KeyboardInterrupt, Interrupted)):
        return INTERRUPTED
    return 2 if isinstance(error, (InputError, click.UsageError)) else 1
