"""Access to a simulation from one process and one thread at a time; its warnings, and its end when left open."""

from __future__ import annotations

import functools
import logging
import multiprocessing.util
import os
import threading
import time
import warnings
import weakref
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Concatenate, ParamSpec, TypeVar

from mpsim.core.deferred_signals import interrupts_held_back
from mpsim.errors import BusyError, ForkedError, level_of_caller

if TYPE_CHECKING:
    from mpsim.engine.simulation import Simulation
    from mpsim.engine.solvers.base import Solver

# --- Delays warnings and log lines until the simulation holds no lock, because a handler may wait for a reader

logger: logging.Logger = logging.getLogger("mpsim")


_catching: ContextVar[tuple[tuple[tuple[type[Warning], ...], list[str]], ...]] = ContextVar("_catching", default=())
"""Kinds that are caught and the texts found, the innermost first."""


def warn(text: str, kind: type[Warning]) -> None:
    """Give a warning of a simulation, on the line that called mpsim."""
    for kinds, texts in _catching.get():
        if issubclass(kind, kinds):
            texts.append(text)
            return
    warnings.warn(text, kind, stacklevel=level_of_caller())


@contextmanager
def caught(*kinds: type[Warning]) -> Iterator[list[str]]:
    """Catch the warnings of these kinds that simulations in this thread would give; yields the list of their texts.

    Unlike `warnings.catch_warnings`, it can be used in several threads at once.

    >>> with caught(UserWarning) as texts:
    ...     warn("too fast", UserWarning)
    >>> texts
    ['too fast']
    """
    texts: list[str] = []
    token = _catching.set(((kinds, texts), *_catching.get()))
    try:
        yield texts
    finally:
        _catching.reset(token)


@dataclass
class Once:
    """A warning that is given once. Attribute given: whether it has been; False if a filter made an error of it."""

    given: bool = False


class Notices:
    """Warnings and log lines that wait, in order, until the simulation can be read again: attribute `waiting`.

    If a filter turns one into an error, or Ctrl-C comes between, the rest is given later.
    """

    def __init__(self) -> None:
        self.waiting: deque[tuple[Once | None, Callable[[], None]]] = deque()

    def warn(self, text: str, kind: type[Warning], once: Once | None = None) -> None:
        """Note a warning; one with `once` only if it has not been given and does not wait already."""
        if once is not None and (once.given or any(each is once for each, _ in self.waiting)):
            return

        def say() -> None:
            warn(text, kind)
            if once is not None:
                once.given = True

        self.waiting.append((once, say))

    def log(self, text: str, *values: Any, level: int = logging.WARNING) -> None:
        """Note a line of the log."""
        self.waiting.append((None, lambda: logger.log(level, text, *values)))

    def give(self) -> None:
        """Give all that wait."""
        while self.waiting:
            _, say = self.waiting.popleft()
            say()

    def give_beside(self, error: Exception) -> None:
        """Give all that wait while an error is being raised; a warning that is an error becomes a note of it."""
        while self.waiting:
            try:
                self.give()
            except Warning as warning:
                error.add_note(f"{type(warning).__name__}: {warning}")


# --- Access to a simulation: only from the process that made it, and from one thread at a time
#
# Compiled code reads and writes the block without asking, so every public door of a simulation asks here first. What
# changes a simulation is `exclusive`: it is refused at once while another thread is at it. What only reads is
# `reading`: another thread's turn comes between two slices of frames, so that it never sees half of two frames.
#
# Python code can be interrupted by Ctrl-C after any call. So what must be undone is undone by a plain store in a
# `finally`, or is a lock of `threading` in a `with` statement, which Ctrl-C cannot come between.

R = TypeVar("R")

GIVE_WAY = 0.0002
"""Seconds between checks by a reader that lets a run continue first."""


class Use:
    """One call that is in progress, named `what`, of a thread, nested in `outer`.

    Attribute in_callback: whether it stands in a callback, where the same thread may use the simulation, too. It dies
    with the use, so that no exception of a callback leaves it behind.
    """

    __slots__ = ("in_callback", "outer", "thread", "what")

    def __init__(self, what: str):
        self.what: str = what
        self.thread: int = threading.get_ident()
        self.outer: Use | None = None
        self.in_callback: bool = False


class Access:
    """Who made a simulation, and who is using it now.

    Attributes:
        use: of the thread that may change the simulation; None: it is not in use. It ends by a plain store.
        state_lock: lock that is held by whoever moves discs or reads from another thread.
        reader_lock: lock that is held by whoever waits for `state_lock` in another thread; a run takes it between two
            slices, and so lets the reader in.
        readers: identifiers of the threads that wait for their turn to read, or have it.
        waiting: whether who runs frames waits until those have read; who comes now reads after the next slice, or
            threads that read again and again would stop the run.
        changing: above 0 while the thread of `use` moves the simulation to another block, say: then even the same
            thread, from a signal handler, must not look.
        reader: identifier of the thread that is reading; 0: none.
        closing: lock that is held by whoever closes the solver.
        ending: whether the program is ending, by a thread that holds `reader_lock` for good.
        notices: what is to be said when `state_lock` is let go.
    """

    def __init__(self) -> None:
        self.creator: int = os.getpid()
        self.use: Use | None = None
        self.state_lock: Any = threading.RLock()
        self.reader_lock: Any = threading.RLock()
        self.readers: dict[int, bool] = {}
        self.waiting: bool = False
        self.changing: int = 0
        self.reader: int = 0
        self.closing: Any = threading.RLock()
        self.ending: bool = False
        self.notices: Notices = Notices()
        self._claiming = threading.RLock()

    @property
    def forked(self) -> bool:
        """Whether this process is a fork of the one that made the simulation."""
        return os.getpid() != self.creator

    def demand_own_process(self) -> None:
        """Refuse the use in another process, before looking at the block or at a lock, whose holder may be missing."""
        if os.getpid() != self.creator:
            raise ForkedError(
                f"this simulation was made by process {self.creator} and cannot be used in process {os.getpid()}, a "
                "fork of it: workers and shared memory belong to the process that made them. Take sim.state before "
                "the fork, make a simulation in the fork, or resume one there from a checkpoint."
            )

    def claim(self, use: Use) -> None:
        """Make this call the one in progress, unless another one is; callbacks of `run` may do anything but run."""
        self.demand_own_process()
        self.stop_if_ending()
        with self._claiming:
            held = self.use
            if held is None:
                free = self.reader != use.thread
            else:
                free = held.thread == use.thread and held.in_callback and use.what != held.what
            if free:
                use.outer, self.use = held, use
                return
        raise self.busy(use.what, held)

    @contextmanager
    def moving(self) -> Iterator[None]:
        """Context in which nobody may read the state, not even a signal handler of this thread; holds `state_lock`."""
        with self.state_lock:
            self.changing += 1
            try:
                yield
            finally:
                self.changing -= 1

    def let_readers_in(self) -> None:
        """Let the threads read that wait for it, between two slices of frames; not in a fork made by a callback."""
        self.demand_own_process()
        if self.readers:
            self.waiting = True  # until the next slice has begun
            with self.reader_lock:
                pass
        self.stop_if_ending()

    def stop_if_ending(self) -> None:
        """Block this thread forever if another one is ending the program.

        Called where `state_lock` is about to be taken: that goes to whoever comes first, so a thread that takes it
        again and again would keep it from the one that waits.
        """
        if self.ending:
            with self.reader_lock:
                pass

    def read_in_turn(self, read: Callable[[], R]) -> R:
        """Read between two slices of frames that another thread may be running."""
        here = threading.get_ident()
        nested = here in self.readers  # a signal handler, in the middle of what this thread is reading
        while self.waiting and not nested:
            time.sleep(GIVE_WAY)
        try:
            self.readers[here] = True
            with self.reader_lock, self.state_lock:
                before = self.reader
                try:
                    self.reader = here
                    return read()
                finally:
                    self.reader = before
        finally:
            if not nested:
                self.readers.pop(here, None)

    def busy(self, refused: str, held: Use | None) -> BusyError:
        """The error for a refused call, which names the call in progress too; `held` None: a read of this thread."""
        here = threading.get_ident()
        held = held or Use("reading")
        if held.thread == here:
            who = "the same thread"
            advice = (
                "A simulation cannot be used from within a call that is changing it: set a flag in a signal handler, "
                "and act on it in a callback of the run, or when that call has returned."
            )
        else:
            who = f"thread {_name_of(here)!r}"
            advice = (
                "One thread at a time may change a simulation: wait for that call to return, or give each thread a "
                "simulation of its own. Its state may be read from any thread."
            )
        return BusyError(
            f"{held.what} of thread {_name_of(held.thread)!r} is in progress; {refused} of {who} was refused. {advice}"
        )


S = TypeVar("S", bound="Simulation")
P = ParamSpec("P")


def exclusive(method: Callable[Concatenate[S, P], R]) -> Callable[Concatenate[S, P], R]:
    """A method that changes a simulation: for the process that made it, and one thread at a time."""
    what = f"{method.__name__.strip('_')}()"

    @functools.wraps(method)
    def door(self: S, *args: P.args, **kwargs: P.kwargs) -> R:
        access, use = self._access, Use(what)
        try:
            access.claim(use)
            result = method(self, *args, **kwargs)
            if access.notices.waiting:
                access.notices.give()
            return result
        except Exception as error:
            access.stop_if_ending()
            access.demand_own_process()  # a fork may have come back into the call, by a signal handler
            access.notices.give_beside(error)
            raise
        finally:
            if access.use is use:  # no call in here: after one, Ctrl-C could come before the store
                access.use = use.outer
                access.waiting = False

    return door


def reading(method: Callable[Concatenate[S, P], R]) -> Callable[Concatenate[S, P], R]:
    """A method that reads a simulation: for the process that made it, and between two slices of frames."""

    @functools.wraps(method)
    def door(self: S, *args: P.args, **kwargs: P.kwargs) -> R:
        access = self._access
        access.demand_own_process()
        use = access.use
        try:
            if use is not None and use.thread == threading.get_ident():  # in a callback: between two slices
                if access.changing:
                    raise access.busy(f"reading {method.__name__}", use)
                access.stop_if_ending()
                with access.state_lock:  # at the end of the program another thread holds it for good
                    return method(self, *args, **kwargs)
            return access.read_in_turn(lambda: method(self, *args, **kwargs))
        finally:
            access.demand_own_process()  # a signal handler may have forked meanwhile: what was read is zeros there

    return door


def _name_of(thread: int) -> str:
    return next((each.name for each in threading.enumerate() if each.ident == thread), str(thread))


# --- Closes simulations that were left open: on garbage collection, at the end of the program, in a fork


_end = threading.RLock()
"""Held for good by the thread that ends the program: others that come to it stop there."""


class Closing:
    """Closes the solver of a simulation, once: when called, when that is collected, or at the end of the program.

    Not a weakref.finalize: a thread that makes one while the program ends breaks off the calls of all others. A thread
    that makes this one then stops for good, with nothing to be closed.

    Attribute alive: whether it is still to be closed.
    """

    def __init__(self, simulation: Any, solver: Solver, access: Access):
        self.alive: bool = True
        self._solver = solver
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
                    self._solver.close()
                finally:
                    _open.pop(self._access, None)  # only now, or the end of the program would not wait for it

    def drop(self) -> None:
        """In a fork: unmap what belongs to the parent. Without any lock, whose holder may not exist here."""
        with interrupts_held_back():
            self.alive = False
            self._reference = None
            self._solver.close()


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
os.register_at_fork(after_in_child=_drop_copies)
