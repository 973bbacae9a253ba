"""The command `mpsim`, which only collects the commands of the other modules.

Results go to standard output, progress and errors to standard error. Exit codes: 0 done, 1 failed, with a sentence that
says why, 2 wrong usage or input, 130 Ctrl-C.
"""

import logging
import sys
import warnings
from typing import Any

import click

from mpsim.cli import misc, run, trade, view
from mpsim.cli.terminal import INTERRUPTED, Compiling, Interrupted, in_options
from mpsim.core.interpreter import ready_for_interrupts
from mpsim.core.progress import above
from mpsim.errors import InputError, MpsimError, SceneFileError
from mpsim.kernels.compiling import announced_by

ELSEWHERE = {
    "compare": "`mpsim tradeoff SCENE` compares settings, and `mpsim view SCENE --beside event` two of them live.",
    "draw": "`mpsim plot RUN` draws the results of a run; in Python, mpsim.draw draws a state.",
    "live": "`mpsim view SCENE` opens the live view; in a notebook, mpsim.live does.",
    "measure": "`mpsim run SCENE --measure NAME` measures during a run.",
    "sweep": "Sweeps are made in Python, with mpsim.sweep.",
}
"""Where to find what is no command, though the library or other programs have it by this name."""


class Refused(click.ClickException):
    """Input that breaks a rule."""

    exit_code = 2


class Commands(click.Group):
    """A group of commands in which an error of mpsim is a sentence and exit code 1 or 2, not a traceback."""

    def invoke(self, ctx: click.Context) -> Any:
        with warnings.catch_warnings(), announced_by(Compiling(ctx.meta)):
            warnings.showwarning = _show_warning
            try:
                ready_for_interrupts()
                return super().invoke(ctx)
            except (KeyboardInterrupt, Interrupted) as stop:
                click.echo(str(stop) or "Interrupted.", err=True)
                ctx.exit(INTERRUPTED)
            except BrokenPipeError:  # the reader of the output has closed it
                raise
            except (MpsimError, OSError, MemoryError) as error:
                kind = Refused if isinstance(error, InputError) else click.ClickException
                raise kind(self._text(error, ctx.invoked_subcommand)) from error

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args[0] in ELSEWHERE:
            ctx.fail(f"No such command {args[0]!r}. {ELSEWHERE[args[0]]}")
        return super().resolve_command(ctx, args)

    def _text(self, error: Exception, name: str | None) -> str:
        """What an error says, in the words of the command."""
        if isinstance(error, OSError) and error.filename is not None and error.strerror:
            return f"{str(error.filename)!r} must be a file or folder that can be used; it cannot ({error.strerror})."
        text = str(error) or type(error).__name__
        command = self.commands.get(name or "")
        return text if command is None or isinstance(error, SceneFileError) else in_options(text, command)


def _show_warning(message: Warning | str, category: type[Warning], filename: str, lineno: int, *_: Any) -> None:
    own, context = issubclass(category, UserWarning), click.get_current_context(silent=True)
    words = str(message) if context is None else in_options(str(message), context.command)
    text = f"Warning: {words}" if own else warnings.formatwarning(message, category, filename, lineno)
    if not above(text):
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
  mpsim tradeoff gas --out gas.csv                 measure cost and error of many settings
"""


@click.group(
    cls=Commands, epilog=EXAMPLES, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110}
)
@click.version_option(package_name="mpsim", prog_name="mpsim")
@click.option("-v", "--verbose", is_flag=True, help="Also report which files are read and which choices are made.")
def main(verbose: bool) -> None:
    """Simulate many hard discs in two dimensions, with the same bits on any number of cores.

    SCENE is the name of a scene that comes with mpsim or a path to a .toml file.
    """
    if verbose:
        handler = logging.StreamHandler(sys.stderr)
        handler.setFormatter(logging.Formatter("%(message)s"))
        logging.getLogger("mpsim").addHandler(handler)
        logging.getLogger("mpsim").setLevel(logging.INFO)
        click.get_current_context().call_on_close(lambda: logging.getLogger("mpsim").removeHandler(handler))


for command in (
    misc.scenes,
    misc.show,
    run.run,
    run.resume,
    misc.plot,
    misc.animate,
    view.view,
    trade.tune,
    trade.tradeoff,
    misc.warmup,
    misc.clean,
):
    main.add_command(command)
