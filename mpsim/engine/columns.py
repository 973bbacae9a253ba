"""Which columns by id there are, and which of them a scene has. A new one is a line here, or in its feature."""

from collections.abc import Callable

from mpsim.core.columns import Column
from mpsim.features import FEATURES
from mpsim.scene.scene import Scene


def has_masses(scene: Scene) -> bool:
    """Whether discs of the scene have masses other than 1, those of its emitters included."""
    return scene.mass is not None or any(emitter.mass is not None and emitter.mass != 1 for emitter in scene.emitters)


_OWN: tuple[tuple[Column, Callable[[Scene], bool]], ...] = (
    (Column("mass", kept=False), has_masses),  # every snapshot has the masses of all discs, in float64
    (Column("acceleration", (2,), discs_first=True), lambda scene: scene.acceleration is not None),
    (Column("image", (2,), integer=True), lambda scene: any(scene.periodic)),
)
"""Those of no feature, and the scenes that have them."""

COLUMNS: tuple[Column, ...] = (
    *(column for column, _ in _OWN),
    *(column for feature in FEATURES for column in feature.columns),
)
"""All of them."""


def columns_of(scene: Scene) -> list[Column]:
    """The columns that the discs of a scene have."""
    own = [column for column, needed in _OWN if needed(scene)]
    return own + [column for feature in FEATURES if feature.is_in(scene) for column in feature.columns]
