"""Processes that make the same calls in the same order (MPI ranks), or one process alone."""

from collections.abc import Callable
from typing import Any, Protocol, TypeVar

Result = TypeVar("Result")


class Team(Protocol):
    """What such processes tell each other.

    Attributes:
        rank: number of this one; the first is 0.
        size: number of them.
    """

    rank: int
    size: int

    def all_of(self, value: Any) -> list[Any]:
        """What each has handed over, in their order."""
        ...

    def once(self, act: Callable[[], Result]) -> Result:
        """What an act gives that the first alone does; what it raises, all raise."""
        ...

    def on_all(self, act: Callable[[], Result]) -> Result:
        """What an act gives that each does for itself; what one of them raises, all raise."""
        ...


def raise_first(errors: list[Exception]) -> None:
    """Raise the first error that a process has noted, where there is one."""
    if errors:
        raise errors[0]


class Alone:
    """One process.

    >>> Alone().all_of("a"), Alone().once(lambda: 1), Alone().on_all(lambda: 2)
    (['a'], 1, 2)
    """

    rank: int = 0
    size: int = 1

    def all_of(self, value: Any) -> list[Any]:
        """Its value."""
        return [value]

    def once(self, act: Callable[[], Result]) -> Result:
        """What an act gives."""
        return act()

    def on_all(self, act: Callable[[], Result]) -> Result:
        """What an act gives."""
        return act()
