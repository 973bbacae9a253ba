"""Deprecated names of Scene (docs/policy.md)."""

import warnings
from typing import TYPE_CHECKING, Any

from mpsim.core.errors import level_of_caller

NEW_NAMES = {
    "among": "capsule_index",
    "another": "redrawn",
    "drawn_by": "redraw_with",
    "has_others": "can_redraw",
}


class OldNames:
    """Makes old names of attributes work, with a warning."""

    if not TYPE_CHECKING:  # for which every name would be an attribute

        def __getattr__(self, name: str) -> Any:
            """The attribute of the new name."""
            if name not in NEW_NAMES:
                raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
            text = f"Scene.{name} is now called Scene.{NEW_NAMES[name]}; the old name ends in 0.3."
            warnings.warn(text, DeprecationWarning, stacklevel=level_of_caller())
            return getattr(self, NEW_NAMES[name])
