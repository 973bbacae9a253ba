"""Binds an observer to the first simulation that it sees, until that goes back to a snapshot."""

import weakref
from typing import Any

from mpsim.errors import InputError, MpsimError


class Binding:
    """Refers to the first simulation of an observer, and does not keep it alive.

    name, advice, error: the observer in words, what to do with another simulation, and the error to raise.
    """

    def __init__(self, name: str, advice: str, error: type[MpsimError] = InputError):
        self._name, self._advice, self._error = name, advice, error
        self._first: weakref.ref[Any] | None = None
        self._restores = 0

    @property
    def exists(self) -> bool:
        """Whether there has been a first object."""
        return self._first is not None

    def bind_or_check(self, one: Any) -> None:
        """Bind to this simulation the first time; then refuse another one, or this one after it has gone back."""
        if self._first is None:
            self._first, self._restores = weakref.ref(one), getattr(one, "restores", 0)
        first, owner = self._first(), ""
        if first is not one:
            owner = f"one simulation, {'which is gone by now' if first is None else first}; got another, {one}"
        elif getattr(one, "restores", 0) != self._restores:
            owner = f"frames that may be undone, as sim.restore(...) was called; got {one} again"
        if owner:
            raise self._error(f"{self._name} belongs to {owner}. {self._advice}")
