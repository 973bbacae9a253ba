"""Defers signals while handling them would do harm; turns SIGTERM into a clean exit."""

import _signal  # type: ignore[import-not-found]
import ctypes
import inspect
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

_NUMBERS = tuple(int(number) for number in signal.valid_signals())

_handler_of: Callable[[int], Any] = _signal.getsignal
"""`signal.getsignal` makes enumeration members: for all signals that takes as long as a short run."""

_act = ctypes.CDLL(None).sigaction
_act.argtypes = [ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p]

_ACTION_BYTES = 512
"""At least the size of the C structure of a signal action, which is stored as it is."""


@contextmanager
def interrupts_held_back() -> Iterator[None]:
    """Defer signals that Python code handles, Ctrl-C above all, until the end of the block.

    For starting a process: one that is half started would have no owner. (One started in here inherits a blocked
    SIGINT, so that its start prints no traceback.) And for loading compiled kernels: an exception in a callback of the
    compiler ends the process. Blocking alone is not enough: the system may deliver a signal to another thread, such as
    one of a numerical library, and the main thread then runs its handler.
    """
    held = _Held()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    try:
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        held.begin()
        yield
    finally:
        try:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)  # while no handler can raise yet
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
        self._handlers: dict[int, Callable[[int, FrameType | None], Any]] = {}
        self._actions: dict[int, Any] = {}

    def begin(self) -> None:
        """From now on only record which signals come."""
        if threading.current_thread() is not threading.main_thread():
            return
        found = {number: handler for number in _NUMBERS if callable(handler := _handler_of(number))}
        self._actions = {number: _action(number) for number in found}
        self._handlers = found
        _holding.append(self)
        for number in self._handlers:
            signal.signal(number, self._note)

    def _note(self, number: int, frame: object) -> None:
        if number not in self._came:  # a pending signal is delivered once, as by the system
            self._came.append(number)

    def put_back(self) -> None:
        """Restore all handlers, even if one of them runs at once and raises.

        So are settings that Python does not know of: `siginterrupt`, and `faulthandler.register` with chain.
        """
        remaining, raised = list(self._handlers), None
        while remaining:
            try:
                while remaining:
                    number = remaining[-1]
                    signal.signal(number, self._handlers[number])
                    _act(number, self._actions[number], None)
                    remaining.pop()
            except BaseException as error:
                raised = error
        if self in _holding:
            _holding.remove(self)
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


def _action(number: int) -> Any:
    """The system's action for a signal, as a C structure."""
    action = ctypes.create_string_buffer(_ACTION_BYTES)
    _act(number, None, action)
    return action


def _is_default(number: int) -> bool:
    """Whether a signal has the system's default action; the handler's address comes first in the structure."""
    return not any(_action(number).raw[: ctypes.sizeof(ctypes.c_void_p)])


_holding: list[_Held] = []
"""Blocks of the main thread that defer signals now, the outermost first."""


def _let_go_in_fork() -> None:
    """In a fork made by another thread than the one that defers signals: nothing else here would restore them."""
    if _holding and _holding[0].thread != threading.get_ident():
        _holding[0].put_back()
        _holding.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_let_go_in_fork)


class Handled:
    """A signal that a function handles until `put_back`, which restores the earlier handler. For the main thread.

    That may be C code that Python does not know, of faulthandler or of a program that embeds Python. Where
    `signal.getsignal` returned None for it, it returns SIG_DFL afterwards, as for every handler installed later.
    """

    def __init__(self, number: int, handler: Callable[[int, FrameType | None], Any]):
        self._number = number
        self._action = _action(number)
        before = signal.getsignal(number)
        self._before = signal.SIG_DFL if before is None else before
        signal.signal(number, handler)

    def put_back(self) -> None:
        """Restore the earlier handler."""
        signal.signal(self._number, self._before)
        _act(self._number, self._action, None)


class Noted:
    """A signal that is noted, from `begin` to `end`, for somebody who looks at `came` now and then.

    Only the main thread can have it noted. In a fork, where nobody looks, it does what it did before.

    Attributes:
        came: whether it has come.
    """

    def __init__(self, number: int):
        self.came: bool = False
        self._number = number
        self._creator = os.getpid()
        self._handled: Handled | None = None

    def begin(self) -> None:
        """From now on note it."""
        if threading.current_thread() is threading.main_thread():
            self._handled = Handled(self._number, self._note)

    def end(self) -> None:
        """Restore the earlier handler. May be called again."""
        handled, self._handled = self._handled, None
        if handled is not None:
            handled.put_back()

    def send_again(self) -> None:
        """After `end`: let it do what it does without us."""
        signal.raise_signal(self._number)

    def _note(self, number: int, frame: FrameType | None) -> None:
        if os.getpid() != self._creator and self._handled is not None:
            self._handled.put_back()
            signal.raise_signal(number)
        self.came = True


@contextmanager
def terminated_by_exit() -> Iterator[None]:
    """Turn SIGTERM into SystemExit(143) in this block, so that open resources of the block are closed.

    Only where it has no handler, C code included, so that it would end the process at once; only in the main thread,
    which runs handlers.
    """
    in_main_thread = threading.current_thread() is threading.main_thread()
    if not in_main_thread or signal.getsignal(signal.SIGTERM) != signal.SIG_DFL or not _is_default(signal.SIGTERM):
        yield
        return
    signal.signal(signal.SIGTERM, _exit)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _exit(number: int, frame: object) -> None:
    raise SystemExit(128 + number)
