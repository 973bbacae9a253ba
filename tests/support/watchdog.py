"""The last resort of a session of tests: it ends one that hangs, says what it was at, and takes its processes along.

pytest-timeout bounds each single test, but cannot see a hang between tests, nor in code that lets no thread run.
"""

import ctypes
import faulthandler
import os
import signal
import threading
import time

import pytest

EARLIER = 0.9
"""Fraction of the time after which a worker of xdist says where it is: before the session ends, and it too."""

GRACE = 20
"""Seconds for the names, which machine code that holds the interpreter may keep from being written."""


def end_with_parent() -> None:
    """Kill this process when its parent ends, however that ends and whatever this one is doing."""
    pr_set_pdeathsig = 1
    ctypes.CDLL(None).prctl(pr_set_pdeathsig, signal.SIGKILL)


class Watchdog:
    """A plugin that ends a session after so many seconds, with the names of tests and the stacks of all threads.

    With xdist the session is that of the controller, which knows the tests of all workers, and each worker writes its
    own stacks and ends with the controller.
    """

    def __init__(self, config: pytest.Config, seconds: float):
        self._file = os.dup(2)
        self._worker = hasattr(config, "workerinput")
        self._deadline = time.monotonic() + seconds * (EARLIER if self._worker else 1)
        self._begun: dict[str, float] = {}
        self._failed: list[str] = []
        self._over = threading.Event()
        if self._worker:
            end_with_parent()
        else:
            threading.Thread(target=self._end_session, args=(seconds,), name="watchdog", daemon=True).start()
        self._write_stacks_later()

    def pytest_runtest_logstart(self, nodeid):
        self._begun[nodeid] = time.monotonic()

    def pytest_runtest_logfinish(self, nodeid):
        self._begun.pop(nodeid, None)

    def pytest_runtest_logreport(self, report):
        if report.failed:
            self._failed.append(report.nodeid)

    def pytest_exception_interact(self):
        """Pytest takes faulthandler's timer back after each failure, for a debugger."""
        self._write_stacks_later()

    def stop(self, exit_within: float) -> None:
        """The last test is over: bound what is left of the process. A worker waits for the others, and for its end."""
        self._over.set()
        if self._worker:
            faulthandler.cancel_dump_traceback_later()
        else:
            faulthandler.dump_traceback_later(exit_within, exit=True, file=self._file)

    def _write_stacks_later(self) -> None:
        left = max(self._deadline - time.monotonic(), 0.01)
        faulthandler.dump_traceback_later(left + GRACE * (not self._worker), exit=not self._worker, file=self._file)

    def _end_session(self, seconds: float) -> None:
        if not self._over.wait(seconds):
            os.write(self._file, self._summary(seconds).encode())
            faulthandler.dump_traceback(self._file)
            os._exit(1)

    def _summary(self, seconds: float) -> str:
        now = time.monotonic()
        running = [f"running for {now - begun:.0f} s: {name}\n" for name, begun in list(self._begun.items())]
        failed = [f"failed: {name}\n" for name in self._failed]
        return "".join([f"\nThe session has taken {seconds:.0f} s and is ended.\n", *failed, *running])
