"""Registry through which upper packages offer functions to objects of lower ones, such as pictures of scenes.

An object asks for it by name. mpsim/__init__.py registers the functions when mpsim is imported.
"""

from collections.abc import Callable
from typing import Any

_registered: dict[str, Callable[..., Any]] = {}


def register(name: str, function: Callable[..., Any]) -> None:
    """Make `view(name, ...)` call `function`."""
    _registered[name] = function


def view(name: str, *arguments: Any) -> Any:
    """Call the function registered under a name."""
    return _registered[name](*arguments)
