"""What upper packages do for objects of lower ones: pictures of a scene, tables of a trade, files.

An object asks for it by name. Who does it is written down in one place, mpsim/__init__.py, when mpsim is imported.
"""

from collections.abc import Callable
from typing import Any

_given: dict[str, Callable[..., Any]] = {}


def give(name: str, function: Callable[..., Any]) -> None:
    """Let `function` be what `view(name, ...)` calls."""
    _given[name] = function


def view(name: str, *arguments: Any) -> Any:
    """What the function given for this name returns."""
    return _given[name](*arguments)
