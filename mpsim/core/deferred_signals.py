"""Signals at moments at which they could only do harm, and SIGTERM where it would leave something behind."""

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
"""That of `signal` makes members of an enumeration: for all signals that takes as long as a short run."""

_act = ctypes.CDLL(None).sigaction
_act.argtypes = [ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p]

_ACTION_BYTES = 512
"""At least the size of the C structure of an action, which is kept as it is."""


@contextmanager
def interrupts_held_back() -> Iterator[None]:
    """Let signals that Python code handles, Ctrl-C above all, wait until the end of the block; then they are handled.

    For starting a process, which half started would belong to nobody (one started in here inherits a blocked SIGINT, so
    that its start prints no traceback), and for loading compiled kernels: an exception in a callback of the compiler
    takes the process down. Blocking alone holds nothing back: the system may give a signal to another thread, of a
    numerical library say, and the main thread then runs its handler.
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
    """Signals that wait, and what handled them: in the main thread, which alone runs handlers."""

    def __init__(self) -> None:
        self.thread: int = threading.get_ident()
        self._came: list[int] = []
        self._handlers: dict[int, Callable[[int, FrameType | None], Any]] = {}
        self._actions: dict[int, Any] = {}

    def begin(self) -> None:
        """Note from now on what comes, and do nothing else."""
        if threading.current_thread() is not threading.main_thread():
            return
        found = {number: handler for number in _NUMBERS if callable(handler := _handler_of(number))}
        self._actions = {number: _action(number) for number in found}
        self._handlers = found
        _holding.append(self)
        for number in self._handlers:
            signal.signal(number, self._note)

    def _note(self, number: int, frame: object) -> None:
        if number not in self._came:  # one that waits does so once, in the system, too
            self._came.append(number)

    def put_back(self) -> None:
        """Let the handlers act again: all of them, also where one acts at once, and raises.

        What Python does not know of an action comes back, too: `siginterrupt`, and `faulthandler.register` with chain.
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
        """Give what has come to who handles it; once each, also where one raises."""
        if self._came:
            number = self._came.pop(0)
            try:
                self._handlers[number](number, inspect.currentframe())
            finally:
                self.deliver()


def _action(number: int) -> Any:
    """What the system does at a signal, as C has it."""
    action = ctypes.create_string_buffer(_ACTION_BYTES)
    _act(number, None, action)
    return action


def _is_default(number: int) -> bool:
    """Whether the system itself acts at a signal; the address of what handles it comes first in an action."""
    return not any(_action(number).raw[: ctypes.sizeof(ctypes.c_void_p)])


_holding: list[_Held] = []
"""Blocks of the main thread that hold signals back now, the outermost first."""


def _let_go_in_fork() -> None:
    """In a fork: another thread than the one that holds signals back made it, so nobody here would put them back."""
    if _holding and _holding[0].thread != threading.get_ident():
        _holding[0].put_back()
        _holding.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_let_go_in_fork)


class Handled:
    """A signal that a function handles until `put_back`: then what handled it before does, in the main thread.

    That may be C code that Python does not know: of faulthandler, or of a program that embeds Python. Where
    `signal.getsignal` said None of it, it says SIG_DFL afterwards, as for all that comes after the start of Python.
    """

    def __init__(self, number: int, handler: Callable[[int, FrameType | None], Any]):
        self._number = number
        self._action = _action(number)
        before = signal.getsignal(number)
        self._before = signal.SIG_DFL if before is None else before
        signal.signal(number, handler)

    def put_back(self) -> None:
        """Let what handled the signal before do so again."""
        signal.signal(self._number, self._before)
        _act(self._number, self._action, None)


@contextmanager
def terminated_by_exit() -> Iterator[None]:
    """Let SIGTERM end the program by SystemExit(143) in this block, so that what the block has open is closed.

    Only where nobody handles it, C code included, so that it would end the process at once; in the main thread, which
    handles signals.
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
