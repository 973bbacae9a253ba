"""Ctrl-C at moments at which it could only do harm, and SIGTERM where it would leave something behind."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def interrupts_held_back() -> Iterator[None]:
    """Let Ctrl-C wait until the end of the block, then give it to whoever handles it.

    For starting a process, which half started would belong to nobody (one started in here inherits a blocked SIGINT, so
    that its start prints no traceback), and for loading compiled kernels: an exception in a callback of the compiler
    takes the process down. Blocking alone does not hold Ctrl-C back: the signal may go to another thread, of a
    numerical library say.
    """
    came: list[int] = []
    in_main_thread = threading.current_thread() is threading.main_thread()
    handler, before = signal.getsignal(signal.SIGINT), signal.pthread_sigmask(signal.SIG_BLOCK, ())
    held = {number for number in signal.valid_signals() if callable(signal.getsignal(number))} | {signal.SIGINT}
    try:
        signal.pthread_sigmask(signal.SIG_BLOCK, held)
        if in_main_thread:
            signal.signal(signal.SIGINT, lambda *_: came.append(1))
        yield
    finally:
        try:
            if in_main_thread:
                signal.signal(signal.SIGINT, handler)
            if came:  # also if the block has raised
                signal.raise_signal(signal.SIGINT)
        finally:  # last: whatever waits now comes, and may raise
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def terminated_by_exit() -> Iterator[None]:
    """Let SIGTERM end the program by SystemExit(143) in this block, so that what the block has open is closed.

    Only where nobody handles it, so that it would end the process at once; in the main thread, which handles signals.
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
