"""A signal to the process of the tests."""

import contextlib
import os
import signal
import threading

import pytest


@pytest.fixture
def alarm():
    """Enter `alarm(seconds)`: this process interrupts itself after so long, as Ctrl-C would.

    On a busy machine that may be before the body begins, so enter it inside what expects the interrupt.
    """

    @contextlib.contextmanager
    def ringing(seconds):
        threading.Timer(seconds, os.kill, (os.getpid(), signal.SIGINT)).start()
        yield

    return ringing
