"""Imports optional packages when they are first needed, and explains what is missing."""

import importlib
from typing import Any

from mpsim.errors import OutputError


def imported(module: str, what: str, extra: str, instead: str) -> Any:
    """A module of such a package.

    Args:
        module: its name, which begins with that of the package.
        what: needs it.
        extra: of mpsim, which installs it.
        instead: what to do without it.

    Raises:
        OutputError: if it cannot be imported.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise OutputError(
            f"{what} needs the package {module.partition('.')[0]}, which cannot be imported ({error}). Install it by "
            f"`pip install 'mpsim[{extra}]'`, or {instead}."
        ) from None
