"""The line on all pages while kernels are compiled: at the start, or later, as for the first disc that is removed."""

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

from mpsim.kernels.compile_notice import Announcer, announced_by

Tell = Callable[[str | None], None]
"""Takes what is being compiled, or None at the end of it. Called by any thread; must return at once."""


class Listeners:
    """Announces compilation to several listeners, and to the announcer before it.

    As the compiler is one for the process, all are notified of what any of them waits for.

    >>> heard, listeners = [], Listeners()
    >>> with listeners.notifying(heard.append):
    ...     listeners.begin("compiling a small kernel (move), once")
    ...     listeners.end()
    >>> heard
    ['compiling a small kernel (move), once', None]
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._tells: list[Tell] = []
        self._before: Announcer | None = None
        self._installed = ExitStack()
        self._under_way = 0

    @contextmanager
    def notifying(self, tell: Tell) -> Iterator[None]:
        """Notify a listener of what is compiled in this block. Blocks of several threads may end in any order."""
        with self._lock:
            if not self._tells:
                self._before = self._installed.enter_context(announced_by(self))
            self._tells.append(tell)
        try:
            yield
        finally:
            with self._lock:
                self._tells.remove(tell)
                if not self._tells:
                    self._installed.close()

    def begin(self, text: str) -> None:
        """Say what is being compiled."""
        if self._before is not None:
            self._before.begin(text)
        with self._lock:
            self._under_way += 1
            self._tell(text)

    def end(self) -> None:
        """One compilation has ended; others may be under way."""
        if self._before is not None:
            self._before.end()
        with self._lock:
            self._under_way -= 1
            if not self._under_way:
                self._tell(None)

    def _tell(self, text: str | None) -> None:
        for tell in self._tells:
            tell(text)


LISTENERS = Listeners()
"""Those of this process."""
