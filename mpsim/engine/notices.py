"""Delays warnings and log lines until the simulation holds no lock, because a handler may wait for a reader."""

import logging
import warnings
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any

from mpsim.errors import level_of_caller

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
    """Warnings and log lines that wait, in order, until the simulation can be read again.

    If a filter turns one into an error, or Ctrl-C comes between, the rest is given later.
    """

    def __init__(self) -> None:
        self._waiting: deque[tuple[Once | None, Callable[[], None]]] = deque()

    def warn(self, text: str, kind: type[Warning], once: Once | None = None) -> None:
        """Note a warning; one with `once` only if it has not been given and does not wait already."""
        if once is not None and (once.given or any(each is once for each, _ in self._waiting)):
            return

        def say() -> None:
            warn(text, kind)
            if once is not None:
                once.given = True

        self._waiting.append((once, say))

    def log(self, text: str, *values: Any, level: int = logging.WARNING) -> None:
        """Note a line of the log."""
        self._waiting.append((None, lambda: logger.log(level, text, *values)))

    def give(self) -> None:
        """Give all that wait."""
        while self._waiting:
            _, say = self._waiting.popleft()
            say()

    def give_beside(self, error: Exception) -> None:
        """Give all that wait while an error is being raised; a warning that is an error becomes a note of it."""
        while self._waiting:
            try:
                self.give()
            except Warning as warning:
                error.add_note(f"{type(warning).__name__}: {warning}")
