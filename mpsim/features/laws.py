"""Friction and restitution of contacts."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.core.columns import SPIN, Column
from mpsim.errors import InputError
from mpsim.features.feature import Feature, Invalidation

if TYPE_CHECKING:
    from mpsim.scene.scene import Scene

# --- Restitution: the fraction of the normal velocity that remains after a contact


class Restitution(Feature):
    """The arguments `restitution` and `wall_restitution`."""

    argument = "restitution"
    several: ClassVar[bool | None] = False
    numbers: ClassVar[dict[str, float]] = {"restitution": 1.0, "wall_restitution": 1.0}

    def is_in(self, scene: Scene) -> bool:
        return min(scene.restitution, scene.wall_restitution) < 1

    def brief(self, scene: Scene) -> str:
        return ""

    def description(self, scene: Scene) -> str:
        return f"{scene.restitution:g} of discs, {scene.wall_restitution:g} of walls"


# --- Friction: rough discs, which spin. Contacts change tangential velocities and spins by the law of Walton and
#     Braun


class Friction(Feature):
    """The arguments `friction`, `wall_friction`, `tangential_restitution` and `spin`."""

    argument = "friction"
    numbers: ClassVar[dict[str, float]] = {"friction": 0.0, "wall_friction": 0.0, "tangential_restitution": 0.0}
    law = "elastic"
    columns: ClassVar[tuple[Column, ...]] = (SPIN,)
    invalidates: ClassVar[tuple[Invalidation, ...]] = (
        Invalidation(
            ("virial",),
            "friction, as the virial takes the kinetic energy for constant and leaves tangential impulses out",
            "Use 'pressure', the impulses on the walls.",
        ),
    )

    def is_in(self, scene: Scene) -> bool:
        return scene.friction > 0 or scene.wall_friction > 0 or scene.spin is not None

    def dissipates(self, scene: Scene) -> bool:
        return scene.friction > 0 or scene.wall_friction > 0

    def arrays(self, scene: Scene, real: np.dtype) -> dict[str, NDArray[Any]]:
        parts, tangential = {"friction": 6, "wall_friction": 3}, 1 + scene.tangential_restitution
        laws = {name: (getattr(scene, name), tangential / each) for name, each in parts.items()}
        return {name: np.array(law, real) for name, law in laws.items() if law[0] > 0}

    def description(self, scene: Scene) -> str:
        words = f"{scene.friction:g} of discs, {scene.wall_friction:g} of walls"
        return f"{words}, tangential restitution {scene.tangential_restitution:g}"


def check_friction(
    friction: object, wall_friction: object, tangential_restitution: object, spin: Any, count: int
) -> dict[str, Any]:
    """What a scene keeps of these arguments, by name: nothing if all have their defaults.

    So the digest of a scene of smooth discs does not depend on them.
    """
    kept: dict[str, Any] = {
        "friction": friction_coefficient("friction", friction),
        "wall_friction": friction_coefficient("wall_friction", wall_friction),
        "tangential_restitution": checks.between("tangential_restitution", tangential_restitution, -1, 1),
        "spin": None if spin is None else SPIN.one_each(spin, count),
    }
    smooth = kept["spin"] is None and all(kept[name] == default for name, default in Friction.numbers.items())
    return {} if smooth else kept


def friction_coefficient(name: str, value: object) -> float:
    """A number >= 0, or infinity for contacts that never slide."""
    number = checks.number(name, value, "a number >= 0")
    if math.isnan(number) or number < 0:
        raise InputError(
            f"{name} must be a number >= 0, or infinity for contacts that never slide; got {checks.brief(value)}."
        )
    return number
