"""Long work in a thread of its own, which can be cancelled."""

import threading
from collections.abc import Callable

CLOSING_SECONDS = 5.0
"""Time that `stop` waits for work that is given up."""

Check = Callable[[], None]
"""To be called now and then by the work: it raises an exception once that has been given up."""


class _GivenUpError(Exception):
    """The work was given up."""


class Background:
    """One piece of work at a time.

    Args:
        name: of its thread.

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
        """Begin with some work, called with a `Check`; work that is under way is given up."""
        self.stop()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=_do, args=(work, self._stop), name=self._name, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Give the work up, at the next moment at which it checks."""
        self._stop.set()
        self.wait(CLOSING_SECONDS)
        self._thread = None

    def wait(self, seconds: float | None = None) -> None:
        """Wait for the end of the work, at most so long [s]."""
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
