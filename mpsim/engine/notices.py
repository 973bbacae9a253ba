"""Warnings and lines of the log that a simulation gives where it holds nothing: who gets them may wait for a reader."""

import logging
import warnings
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from mpsim.core.errors import level_of_caller

logger: logging.Logger = logging.getLogger("mpsim")


@dataclass
class Once:
    """A warning that is given once. Attribute given: whether it was; not where a filter makes an error of it."""

    given: bool = False


class Notices:
    """What is to be said, in order, once the simulation is whole and free to be read.

    What a filter turns into an error, or Ctrl-C comes before, keeps nothing of the rest from being said later.
    """

    def __init__(self) -> None:
        self._waiting: deque[tuple[Once | None, Callable[[], None]]] = deque()

    def warn(self, text: str, kind: type[Warning], once: Once | None = None) -> None:
        """Note a warning, unless it is to be given once, and was, or waits already."""
        if once is not None and (once.given or any(each is once for each, _ in self._waiting)):
            return

        def say() -> None:
            warnings.warn(text, kind, stacklevel=level_of_caller())
            if once is not None:
                once.given = True

        self._waiting.append((once, say))

    def log(self, text: str, *values: Any, level: int = logging.WARNING) -> None:
        """Note a line of the log."""
        self._waiting.append((None, lambda: logger.log(level, text, *values)))

    def give(self) -> None:
        """Say what waits."""
        while self._waiting:
            _, say = self._waiting.popleft()
            say()

    def give_beside(self, error: Exception) -> None:
        """Say what waits while an error is on its way, which a warning that is an error, too, must not replace."""
        while self._waiting:
            try:
                self.give()
            except Warning as warning:
                error.add_note(f"{type(warning).__name__}: {warning}")
