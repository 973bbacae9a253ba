"""What becomes of open simulations when nobody holds them any more, when the program ends, or when it forks."""

import atexit
import multiprocessing.util  # whose end at exit must be registered before ours
import os
import weakref
from typing import Any, Protocol

from mpsim.engine.access import Access
from mpsim.interrupts import interrupts_held_back

assert multiprocessing.util

_open: "dict[Access, weakref.finalize[Any, Any]]" = {}
"""What closes each open simulation. Not by weak references: Ctrl-C in a callback of one is printed, and lost."""


class Closable(Protocol):
    """What must be closed: a solver."""

    def close(self) -> None:
        """Give back workers and block. May be called again, and whatever of them there is."""
        ...


def closing_of(simulation: Any, solver: Closable, access: Access) -> "weakref.finalize[Any, Any]":
    """What closes a solver once: when called, when its simulation is collected, or at the end of the program."""
    closing = weakref.finalize(simulation, _close, solver, access)
    closing.atexit = False  # `_close_all` does it
    _open[access] = closing
    return closing


def _close(solver: Closable, access: Access) -> None:
    """Close a solver, and whole: Ctrl-C pressed once more would leave half of it behind. It takes a bounded time."""
    with interrupts_held_back():
        solver.close()
        _open.pop(access, None)


@atexit.register
def _close_all() -> None:
    """Close what a program leaves open when it ends.

    Registered after multiprocessing's own end, so it runs before that, which would ask the workers to end by SIGTERM,
    a signal they leave to the coordinator, and wait for them for ever.
    """
    with interrupts_held_back():
        for access, closing in list(_open.items()):
            if not access.forked:
                # Never let go: a daemon thread that runs the simulation stops at these, between two slices, and the
                # interpreter ends while it waits.
                access.over = True
                access.turn.acquire()
                access.whole.acquire()
                closing()


def _drop_copies() -> None:
    """In a fork: unmap what belongs to the parent, so that the fork does not keep it alive."""
    for closing in list(_open.values()):
        closing()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_drop_copies)
