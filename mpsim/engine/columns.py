"""The columns of a scene, which its features determine."""

from collections.abc import Callable
from typing import Any

from mpsim.core.columns import IMAGE, Column
from mpsim.features import FEATURES
from mpsim.scene.scene import Scene

_OWN: tuple[tuple[Column, Callable[[Scene], bool]], ...] = ((IMAGE, lambda scene: any(scene.periodic)),)
"""Those of no feature, and the scenes that have them."""


def columns_of(scene: Scene) -> list[Column]:
    """The columns that the discs of a scene have."""
    own = [column for column, needed in _OWN if needed(scene)]
    return own + [column for feature in FEATURES if feature.has_columns(scene) for column in feature.columns]


def given_in(scene: Scene) -> dict[str, Any]:
    """What a scene gives of its columns, by name; what it leaves out is zero."""
    values = {column.name: getattr(scene, column.name, None) for column in columns_of(scene) if column.given}
    return {name: value for name, value in values.items() if value is not None}
