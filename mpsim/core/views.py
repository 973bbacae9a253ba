"""What upper packages do for objects of lower ones: pictures of a scene, tables of a trade-off study, files.

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
