"""Objects that refuse assignments, which would be ignored or leave them unchecked."""

from typing import Any, ClassVar, NoReturn

from mpsim.core.checks import brief
from mpsim.errors import InputError


class ReadOnly:
    """An object whose public attributes are set by its `__init__`, each once, and by nobody else.

    A class outside mpsim that inherits from it may add attributes of its own.

    >>> class Box(ReadOnly):
    ...     _instead, _set_once = "Make another Box", frozenset({"width"})
    ...     def __init__(self, width):
    ...         self.width = width
    >>> Box(3).width = 4
    Traceback (most recent call last):
        ...
    mpsim.InputError: width of a Box cannot be assigned; got 4. Make another Box.
    """

    _instead: ClassVar[str] = ""
    """What to do instead of an assignment."""

    _set_once: ClassVar[frozenset[str]] = frozenset()
    """The attributes that `__init__` assigns."""

    def __setattr__(self, name: str, value: Any) -> None:
        if not (name.startswith("_") or self._may_set(name)):
            self._refuse(name, f"assigned; got {brief(value)}")
        super().__setattr__(name, value)

    def __delattr__(self, name: str) -> None:
        if not name.startswith("_") and not self._may_set(name):
            self._refuse(name, "deleted")
        super().__delattr__(name)

    def _may_set(self, name: str) -> bool:
        if name in self._set_once:
            return name not in vars(self)
        own = next(each for each in type(self).__mro__ if each.__module__.startswith("mpsim."))
        return type(self) is not own and not hasattr(own, name)

    def _refuse(self, name: str, what: str) -> NoReturn:
        raise InputError(f"{name} of a {type(self).__name__} cannot be {what}. {self._instead}.")
