"""What becomes of open simulations when nobody holds them any more, when the program ends, or when it forks."""

import atexit
import multiprocessing.util  # whose end at exit must be registered before ours
import os
import threading
import weakref
from typing import Any, NamedTuple, Protocol

from mpsim.engine.access import Access
from mpsim.interrupts import interrupts_held_back

assert multiprocessing.util
weakref.finalize(Access(), id, None).detach()  # so is the end of finalizers, which threads must not make meanwhile


class Closable(Protocol):
    """What must be closed: a solver."""

    def close(self) -> None:
        """Give back workers and block. May be called again, and whatever of them there is."""
        ...


class _Open(NamedTuple):
    """What is open, and what closes it when its simulation is collected."""

    solver: Closable
    closing: "weakref.finalize[Any, Any]"


_open: dict[Access, _Open] = {}
"""What closes each open simulation. Not by weak references: Ctrl-C in a callback of one is printed, and lost."""

_end = threading.RLock()
"""Held for good by the thread that ends the program: others that come to it stop there."""


def closing_of(simulation: Any, solver: Closable, access: Access) -> "weakref.finalize[Any, Any]":
    """What closes a solver once: when called, when its simulation is collected, or at the end of the program.

    A thread that comes here after the end of the program has begun stops for good, with nothing to be closed.
    """
    with _end:
        closing = weakref.finalize(simulation, _close, solver, access)
        closing.atexit = False  # `_close_all` does it
        _open[access] = _Open(solver, closing)
    return closing


def _close(solver: Closable, access: Access) -> None:
    """Close a solver, and whole: Ctrl-C pressed once more would leave half of it behind. It takes a bounded time."""
    with interrupts_held_back(), access.closing:
        solver.close()
        _open.pop(access, None)


@atexit.register
def _close_all() -> None:
    """Close what a program leaves open when it ends.

    Registered after multiprocessing's own end, so it runs before that, which would ask the workers to end by SIGTERM,
    a signal they leave to the coordinator, and wait for them for ever.
    """
    with interrupts_held_back():
        _end.acquire()
        while ours := [access for access in list(_open) if not access.forked]:
            access = ours[0]
            # Never let go: a daemon thread that uses the simulation stops at these, where it is whole, and the
            # interpreter ends while it waits.
            access.over = True
            access.turn.acquire()
            access.whole.acquire()
            if access in _open:
                solver, closing = _open[access]
                closing.detach()
                _close(solver, access)  # again, if a daemon thread was just collecting it


def _drop_copies() -> None:
    """In a fork: unmap what belongs to the parent, so that the fork does not keep it alive.

    Without any lock: who holds it may not exist here.
    """
    global _end  # noqa: PLW0603
    _end = threading.RLock()
    for solver, closing in list(_open.values()):
        closing.detach()
        with interrupts_held_back():
            solver.close()
    _open.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_drop_copies)
