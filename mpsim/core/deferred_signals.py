"""Defers signals while handling them would do harm; turns SIGTERM into a clean exit."""

import _signal  # type: ignore[import-not-found]
import inspect
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

Handler = Callable[[int, FrameType | None], Any]

_NUMBERS = tuple(int(number) for number in signal.valid_signals())

_handler_of: Callable[[int], Any] = _signal.getsignal
_set_handler: Callable[[int, Any], Any] = _signal.signal
_set_mask: Callable[[int, Iterable[int]], set[int]] = _signal.pthread_sigmask
"""Those of `signal` make enumeration members, which takes longer than a short run."""


@contextmanager
def interrupts_held_back() -> Iterator[None]:
    """Defer signals that Python code handles, Ctrl-C above all, until the end of the outermost such block.

    For starting a process: one that is half started would have no owner. (One started in here inherits a blocked
    SIGINT, so that its start prints no traceback.) And for loading compiled kernels: an exception in a callback of the
    compiler ends the process. Blocking alone is not enough: the system may deliver a signal to another thread, such as
    one of a numerical library, and the main thread then runs its handler.
    """
    if _held and threading.current_thread() is threading.main_thread():
        yield
        return
    held = _Held()
    before = _set_mask(signal.SIG_BLOCK, ())
    try:
        _set_mask(signal.SIG_BLOCK, {signal.SIGINT})
        held.begin()
        yield
    finally:
        try:
            _set_mask(signal.SIG_SETMASK, before)  # while no handler can raise yet
        finally:
            try:
                held.put_back()
            finally:
                held.deliver()


class _Held:
    """Deferred signals and their handlers, in the main thread, which alone runs handlers."""

    def __init__(self) -> None:
        self.thread: int = threading.get_ident()
        self._came: list[int] = []
        self._handlers: dict[int, Handler] = {}

    def begin(self) -> None:
        """From now on only record which signals come."""
        if threading.current_thread() is not threading.main_thread():
            return
        self._handlers = {number: handler for number in _NUMBERS if callable(handler := _handler_of(number))}
        _held.append(self)
        for number in self._handlers:
            _set_handler(number, self._note)

    def _note(self, number: int, frame: object) -> None:
        if number not in self._came:  # a pending signal is delivered once, as by the system
            self._came.append(number)

    def put_back(self) -> None:
        """Restore all handlers, even if one of them runs at once and raises."""
        if self in _held:
            _held.remove(self)  # now, as a handler may begin a block of its own
        remaining, raised = list(self._handlers), None
        while remaining:
            try:
                while remaining:
                    _set_handler(remaining[-1], self._handlers[remaining[-1]])
                    remaining.pop()
            except BaseException as error:
                raised = error
        if raised is not None:
            raise raised

    def deliver(self) -> None:
        """Call the handler of each signal that came, once, even if one raises."""
        if self._came:
            number = self._came.pop(0)
            try:
                self._handlers[number](number, inspect.currentframe())
            finally:
                self.deliver()


_held: list[_Held] = []
"""What defers signals in the main thread now; [] if nothing does."""


def _let_go_in_fork() -> None:
    """In a fork made by another thread than the one that defers signals: nothing else here would restore them."""
    if _held and _held[0].thread != threading.get_ident():
        _held[0].put_back()


os.register_at_fork(after_in_child=_let_go_in_fork)


@contextmanager
def terminated_by_exit() -> Iterator[None]:
    """Turn SIGTERM into SystemExit(143) in this block, so that open resources of the block are closed.

    Only where it has no handler, so that it would end the process at once; only in the main thread.
    """
    in_main_thread = threading.current_thread() is threading.main_thread()
    if not in_main_thread or signal.getsignal(signal.SIGTERM) != signal.SIG_DFL:
        yield
        return
    signal.signal(signal.SIGTERM, _exit)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _exit(number: int, frame: object) -> None:
    raise SystemExit(128 + number)
