"""A command on the ranks of MPI: the first one speaks for all, and the end of one is the end of all."""

import contextlib
import io
import time
import warnings
from collections.abc import Iterator
from typing import Any

import click

from mpsim.cli import terminal
from mpsim.core.errors import InputError
from mpsim.engine.solvers.mpi_ranks import library

PATIENCE = 2.0
"""Seconds for which a rank that fails waits for the others to fail as well."""

DELIVERY = 0.5
"""Seconds between the last words of a rank and the end of the job, when `mpiexec` drops what it has not read."""


@contextlib.contextmanager
def one_voice(on_ranks: bool) -> Iterator[bool]:
    """Let the first rank alone print. Gives whether this one is it; without ranks it is.

    What fails on all ranks, the first one tells, and all end. What fails on some of them, these tell, and end the job:
    the others would wait for them for ever.

    Raises:
        InputError: if there is no MPI.
    """
    if not on_ranks:
        yield True
        return
    world = library().COMM_WORLD.Dup()  # on which nobody else calls: ranks come to their end between any two calls
    speaks = world.rank == 0
    try:
        with contextlib.ExitStack() as stack:
            if not speaks:
                terminal.be_quiet()
                stack.enter_context(contextlib.redirect_stdout(io.StringIO()))
                stack.enter_context(warnings.catch_warnings())
                warnings.simplefilter("ignore")
            yield speaks
    except BaseException as error:
        if not _all_fail(world):
            click.echo(f"mpsim: rank {world.rank}: {type(error).__name__}: {error}", err=True)
            time.sleep(DELIVERY)
            library().COMM_WORLD.Abort(_code_of(error))
        if speaks:
            raise
        raise SystemExit(_code_of(error)) from None


def _all_fail(world: Any) -> bool:
    """Whether all ranks come here within PATIENCE."""
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
