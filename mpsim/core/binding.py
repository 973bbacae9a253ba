"""Binds an observer to the first simulation that it sees, until that goes back to a snapshot."""

import weakref
from typing import Any


class Binding:
    """Refers to the first simulation that it is compared with, and does not keep it alive."""

    def __init__(self) -> None:
        self._first: weakref.ref[Any] | None = None
        self._restores = 0

    @property
    def exists(self) -> bool:
        """Whether there has been a first object."""
        return self._first is not None

    def refusal(self, one: Any) -> str:
        """To what an observer belongs that cannot go on with a simulation, in words; "" if it can.

        It can if this is the first simulation, and that has not gone back since.
        """
        if self._first is None:
            self._first, self._restores = weakref.ref(one), getattr(one, "restores", 0)
        first = self._first()
        if first is not one:
            owner = "which is gone by now" if first is None else str(first)
            return f"one simulation, {owner}; got another, {one}"
        if getattr(one, "restores", 0) != self._restores:
            return f"frames that may be undone, as sim.restore(...) was called; got {one} again"
        return ""
