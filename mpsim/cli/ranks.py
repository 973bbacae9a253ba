"""Commands on MPI ranks: the first rank prints and writes; if one rank ends, all end."""

import contextlib
import io
import logging
import signal
import time
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import click

from mpsim.cli import terminal
from mpsim.core.deferred_signals import Noted
from mpsim.engine.solvers.mpi_ranks import library
from mpsim.errors import InputError
from mpsim.output.first_rank import FirstRank

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
    terminal.be_quiet()
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
    if isinstance(error, (KeyboardInterrupt, terminal.Interrupted)):
        return terminal.INTERRUPTED
    return 2 if isinstance(error, (InputError, click.UsageError)) else 1
