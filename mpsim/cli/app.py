"""The command `mpsim`, which only collects the commands of the other modules.

Results go to standard output, progress and errors to standard error. Exit codes: 0 done, 1 failed, with a sentence that
says why, 2 wrong usage or input, 130 Ctrl-C.
"""

import importlib
import warnings
from functools import partial
from typing import Any

import click

from mpsim.core import late
from mpsim.errors import InputError, MpsimError

COMMANDS = {
    "scenes": "mpsim.cli.misc:scenes",
    "show": "mpsim.cli.misc:show",
    "run": "mpsim.cli.run:run",
    "resume": "mpsim.cli.run:resume",
    "plot": "mpsim.cli.misc:plot",
    "animate": "mpsim.cli.misc:animate",
    "view": "mpsim.cli.view:view",
    "tune": "mpsim.cli.trade:tune",
    "tradeoff": "mpsim.cli.trade:tradeoff",
    "warmup": "mpsim.cli.misc:warmup",
    "clean": "mpsim.cli.misc:clean",
}
"""Where each command is. Only the one that is called is imported: NumPy and Numba alone take half a second."""


class Refused(click.ClickException):
    """Input that breaks a rule."""

    exit_code = 2


class Commands(click.Group):
    """A group of commands in which an error of mpsim is a sentence and exit code 1 or 2, not a traceback."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        return late.named(COMMANDS[cmd_name]) if cmd_name in COMMANDS else super().get_command(ctx, cmd_name)

    def invoke(self, ctx: click.Context) -> Any:
        terminal = importlib.import_module("mpsim.cli.terminal")
        announcing = late.named("mpsim.kernels.compiling:announcing")
        with warnings.catch_warnings(), announcing(partial(terminal.say_compiling, ctx.meta)):
            warnings.showwarning = _show_warning
            try:
                return super().invoke(ctx)
            except (KeyboardInterrupt, terminal.Interrupted) as stop:
                click.echo(str(stop) or "Interrupted.", err=True)
                ctx.exit(terminal.INTERRUPTED)
            except BrokenPipeError:  # the reader of the output has closed it
                raise
            except (MpsimError, OSError, MemoryError) as error:
                kind = Refused if isinstance(error, InputError) else click.ClickException
                raise kind(_text(error)) from error


def _text(error: Exception) -> str:
    """What an error says."""
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        return f"{str(error.filename)!r} must be a file or folder that can be used; it cannot ({error.strerror})."
    return str(error) or type(error).__name__


def _show_warning(message: Warning | str, category: type[Warning], filename: str, lineno: int, *_: Any) -> None:
    own = issubclass(category, UserWarning)
    text = f"Warning: {message}" if own else warnings.formatwarning(message, category, filename, lineno)
    if not late.named("mpsim.core.progress:above")(text):
        click.echo(text, err=True)


EXAMPLES = """\b
Examples:
  mpsim scenes                                     list the scenes that come with mpsim
  mpsim show gas                                   describe a scene
  mpsim run gas --until 50 --out run               simulate it, and write the results to the folder run
  mpsim resume run --until 100                     continue this run
  mpsim plot run                                   draw its results
  mpsim view gas                                   watch the simulation in the browser
  mpsim animate gas gas.gif                        write an animation
  mpsim tune gas --pressure 1%                     find the cheapest settings with at most 1 % error in pressure
  mpsim tradeoff gas --csv > gas.csv               measure cost and error of many settings
"""


@click.group(
    cls=Commands, epilog=EXAMPLES, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110}
)
@click.version_option(package_name="mpsim", prog_name="mpsim")
def main() -> None:
    """Simulate many hard discs in two dimensions, with the same bits on any number of cores.

    SCENE is the name of a scene that comes with mpsim or a path to a .toml file.
    """
