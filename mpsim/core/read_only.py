"""Objects that refuse assignments, which would be ignored or leave them unchecked."""

import functools
import inspect
from typing import Any, ClassVar

from mpsim.core.checks import brief
from mpsim.core.errors import InputError


class ReadOnly:
    """An object whose public attributes are set by its `__init__`, each once, and by nobody else.

    >>> class Box(ReadOnly):
    ...     _instead = "Make another Box"
    ...     def __init__(self, width):
    ...         self.width = width
    >>> Box(3).width = 4
    Traceback (most recent call last):
        ...
    mpsim.InputError: width of a Box cannot be assigned; got 4. Make another Box.
    """

    _instead: ClassVar[str] = ""
    """What to do instead of an assignment."""

    def __setattr__(self, name: str, value: Any) -> None:
        if not name.startswith("_") and (name in vars(self) or name not in _set_by_init(type(self))):
            raise InputError(
                f"{name} of a {type(self).__name__} cannot be assigned; got {brief(value)}. {self._instead}."
            )
        super().__setattr__(name, value)


@functools.cache
def _set_by_init(cls: type) -> frozenset[str]:
    """Arguments of `__init__` that become attributes: those that are not properties, or have a default in the class."""
    return frozenset(name for name in inspect.signature(cls).parameters if not hasattr(cls, name))
