"""Runs long work in a thread of its own, and can cancel it."""

import threading
from collections.abc import Callable

CLOSING_SECONDS = 5.0
"""Longest time that `stop` waits for cancelled work to end."""

Check = Callable[[], None]
"""The work calls this from time to time. It raises an exception once the work was cancelled."""


class _GivenUpError(Exception):
    """The work was cancelled."""


class Background:
    """Runs one piece of work at a time.

    Args:
        name: name of the thread.

    >>> found, work = [], Background("an example")
    >>> work.start(lambda check: found.append(1))
    >>> work.wait()
    >>> found
    [1]
    """

    def __init__(self, name: str):
        self._name = name
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()

    def start(self, work: Callable[[Check], None]) -> None:
        """Start the work, which is called with a `Check`. Work that is still running is cancelled."""
        self.stop()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=_do, args=(work, self._stop), name=self._name, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Cancel the work; it ends at its next check."""
        self._stop.set()
        self.wait(CLOSING_SECONDS)
        self._thread = None

    def wait(self, seconds: float | None = None) -> None:
        """Wait until the work ends, for at most this time [s]; None: without a limit."""
        if self._thread is not None:
            self._thread.join(seconds)


def _do(work: Callable[[Check], None], stop: threading.Event) -> None:
    def check() -> None:
        if stop.is_set():
            raise _GivenUpError

    try:
        work(check)
        check()
    except _GivenUpError:
        pass
