"""Binds an observer to the first simulation that it sees."""

import weakref


class Binding:
    """Refers to the first object that it is compared with, and does not keep it alive.

    >>> binding = Binding()
    >>> first, other = {1}, {2}
    >>> binding.is_to(first), binding.is_to(other), binding.is_to(first)
    (True, False, True)
    >>> str(binding)
    '{1}'
    >>> del first
    >>> str(binding)
    'which is gone by now'
    """

    def __init__(self) -> None:
        self._first: weakref.ref[object] | None = None

    @property
    def exists(self) -> bool:
        """Whether there has been a first object."""
        return self._first is not None

    def is_to(self, one: object) -> bool:
        """Whether this is the first object, which it is if there was none before."""
        if self._first is None:
            self._first = weakref.ref(one)
        return self._first() is one

    def __str__(self) -> str:
        first = None if self._first is None else self._first()
        return "which is gone by now" if first is None else str(first)
