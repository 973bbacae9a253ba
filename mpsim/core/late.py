"""What is imported when it is first needed: optional packages, and what upper packages do for objects of lower ones."""

import importlib
from typing import Any

from mpsim.errors import OutputError


def named(place: str) -> Any:
    """What a text such as "mpsim.core.late:named" stands for; its module is imported if need be.

    >>> named("mpsim.core.late:named") is named
    True
    """
    module, _, name = place.partition(":")
    return getattr(importlib.import_module(module), name)


def imported(module: str, what: str, extra: str, instead: str) -> Any:
    """A module of an optional package.

    Args:
        module: its name, which begins with that of the package.
        what: needs it.
        extra: of mpsim, which installs it.
        instead: what to do without it.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise OutputError(
            f"{what} needs the package {module.partition('.')[0]}, which cannot be imported ({error}). Install it by "
            f"`pip install 'mpsim[{extra}]'`, or {instead}."
        ) from None


VIEWS: dict[str, str] = {}
"""Functions of upper packages for objects of lower ones, such as pictures of scenes: `mpsim/__init__.py` names them."""


def view(name: str, *arguments: Any) -> Any:
    """Call a function of VIEWS."""
    return named(VIEWS[name])(*arguments)
