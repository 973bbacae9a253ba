"""Closes simulations that were left open: on garbage collection, at the end of the program, in a fork."""

import multiprocessing.util
import os
import threading
import weakref
from typing import Any, Protocol

from mpsim.core.deferred_signals import interrupts_held_back
from mpsim.engine.access import Access


class Closable(Protocol):
    """What must be closed: a solver."""

    def close(self) -> None:
        """Give back workers and block. May be called again, and whatever of them there is."""
        ...


_end = threading.RLock()
"""Held for good by the thread that ends the program: others that come to it stop there."""


class Closing:
    """Closes the solver of a simulation, once: when called, when that is collected, or at the end of the program.

    Not a weakref.finalize: a thread that makes one while the program ends breaks off the calls of all others. A thread
    that makes this one then stops for good, with nothing to be closed.

    Attributes:
        alive: whether it is still to be closed.
        solvers: what then is closed: the solver, and while another takes its place that one, too.
    """

    def __init__(self, simulation: Any, solver: Closable, access: Access):
        self.alive: bool = True
        self.solvers: list[Closable] = [solver]
        self._access = access
        self._reference: object = weakref.ref(simulation, self)
        with _end:
            _open[access] = self

    def __call__(self, _: object = None) -> None:
        """Close it. Ctrl-C waits, as it would leave half of it behind; closing takes a bounded time."""
        with interrupts_held_back(), self._access.closing:
            if self.alive:
                self.alive = False
                self._reference = None  # Ctrl-C in the callback of a reference is printed, and lost
                try:
                    self._close_all()
                finally:
                    _open.pop(self._access, None)  # only now, or the end of the program would not wait for it

    def drop(self) -> None:
        """In a fork: unmap what belongs to the parent. Without any lock, whose holder may not exist here."""
        with interrupts_held_back():
            self.alive = False
            self._reference = None
            self._close_all()

    def _close_all(self) -> None:
        for solver in self.solvers:
            solver.close()


_open: dict[Access, Closing] = {}
"""What closes each open simulation."""


END_PRIORITY = 10
"""Of what multiprocessing does when a process ends: after it has ended its pools, at 15, whose threads may be using a
simulation and are waited for; before it asks the workers to end by SIGTERM, a signal they leave to the coordinator, and
waits for them for ever."""


def _close_all() -> None:
    """Close what a program, or a process of multiprocessing, leaves open when it ends."""
    with interrupts_held_back():
        _end.acquire()
        while ours := [each for each in _open.copy().items() if not each[0].forked]:
            access, closing = ours[0]
            # Never let go: a daemon thread that uses the simulation stops at these, where it is whole, and the
            # interpreter ends while it waits.
            access.ending = True
            access.reader_lock.acquire()
            access.state_lock.acquire()
            closing()


def _drop_copies() -> None:
    """In a fork: do not keep alive what belongs to the parent."""
    global _end  # noqa: PLW0603
    _end = threading.RLock()  # who holds the other may not exist here
    for closing in list(_open.values()):
        closing.drop()
    _open.clear()
    _close_all_at_end()


def _close_all_at_end(_: object = None) -> None:
    """Have this process close what it leaves open. Not by atexit, which processes of multiprocessing do not call."""
    multiprocessing.util.Finalize(None, _close_all, exitpriority=END_PRIORITY)


_close_all_at_end()
multiprocessing.util.register_after_fork(_close_all_at_end, _close_all_at_end)  # and whatever its start method
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_drop_copies)
