"""Radii, masses, gravity and accelerations; restitution and friction of contacts."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.core.checks import Floats
from mpsim.core.columns import ACCELERATION, MASS, SPIN, Column
from mpsim.errors import InputError
from mpsim.features.feature import Feature, Invalidation, PerDisc

if TYPE_CHECKING:
    from mpsim.scene.scene import Scene

# --- Radii that differ from disc to disc


def check_radius(value: Any, count: int) -> float | Floats:
    """One radius for all discs, or one each, checked [length]."""
    return checks.one_or_each("radius", value, count, "[length]")


def has_radii(scene: Scene) -> bool:
    """Whether discs of the scene differ in size, those of its emitters included."""
    return np.ndim(scene.radius) > 0 or any(emitter.radius not in (None, scene.radius) for emitter in scene.emitters)


def densest_packing(smallest: float, largest: float) -> float:
    """Packing fraction above which no discs with radii from `smallest` to `largest` can be arranged in the plane.

    Florian's bound (Rend. Circ. Mat. Palermo 9, 300, 1960): no arrangement is denser than three touching discs, two of
    the largest radius and one of the smallest. For equal discs it is the hexagonal lattice (Thue 1910). Copies of a box
    side by side fill the plane, so it holds in any box, with walls and without.

    >>> round(densest_packing(1, 1), 4), round(densest_packing(0.5, 1), 4)
    (0.9069, 0.9158)
    """
    q = smallest / largest
    corner = math.pi * q * q + 2 * (1 - q * q) * math.asin(q / (1 + q))
    return corner / (2 * q * math.sqrt(2 * q + 1))


class Radii(Feature):
    """The argument `radius`. Its arrays, grid and giants are the solver's: `mpsim.engine.feature_arrays`."""

    argument = "radius"
    several: ClassVar[bool | None] = False
    per_disc: ClassVar[dict[str, PerDisc]] = {"radius": PerDisc(check_radius, unit="[length]", default=None)}

    def is_in(self, scene: Scene) -> bool:
        return has_radii(scene)

    def brief(self, scene: Scene) -> str:
        return ""


# --- Fields: gravity, one acceleration for all discs, and an acceleration of each disc


def check_gravity(value: Any) -> Floats | None:
    """(gx, gy), checked [length/time^2]."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        down = -abs(float(value)) if abs(value) < 1e300 else -9.81  # an example, where a float cannot hold it
        raise InputError(
            f"gravity must be two numbers, along x and y; got {checks.brief(value)}. Downwards it is "
            f"(0, {down:g}), in a scene file [0.0, {down}]."
        )
    return None if value is None else checks.finite_array("gravity", value, (2,), "(2,)")


def check_acceleration(value: Any, count: int) -> Floats | None:
    """One row for each disc, checked [length/time^2]."""
    if value is None:
        return None
    return checks.finite_array("acceleration", value, (count, 2), f"({count}, 2), one row per row of position")


class Gravity(Feature):
    """The argument `gravity`."""

    argument = "gravity"
    several: ClassVar[bool | None] = False
    vectors: ClassVar[tuple[str, ...]] = ("gravity",)
    drives = "gravity"

    def arrays(self, scene: Scene, real: np.dtype) -> dict[str, NDArray[Any]]:
        return {"gravity": self.of(scene).astype(real)}

    def description(self, scene: Scene) -> str:
        x, y = self.of(scene)
        return f"({x:g}, {y:g})"


class Acceleration(Feature):
    """The argument `acceleration`."""

    argument = "acceleration"
    several: ClassVar[bool | None] = False
    per_disc: ClassVar[dict[str, PerDisc]] = {"acceleration": PerDisc(check_acceleration, components=("ax", "ay"))}
    not_exact = "acceleration per disc, under which the relative motion of two discs is not uniform"
    columns: ClassVar[tuple[Column, ...]] = (ACCELERATION,)

    def description(self, scene: Scene) -> str:
        return "one per disc"


# --- Masses other than 1


def has_masses(scene: Scene) -> bool:
    """Whether discs of the scene have masses other than 1, those of its emitters included."""
    return scene.mass is not None or any(emitter.mass not in (None, 1) for emitter in scene.emitters)


class Masses(Feature):
    """The argument `mass`."""

    argument = "mass"
    several: ClassVar[bool | None] = False
    per_disc: ClassVar[dict[str, PerDisc]] = {"mass": PerDisc(checks.masses, unit="[mass]", default=1.0)}
    columns: ClassVar[tuple[Column, ...]] = (MASS,)

    def is_in(self, scene: Scene) -> bool:
        return has_masses(scene)

    def brief(self, scene: Scene) -> str:
        return "" if scene.mass is None else "mass"


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
        raise checks.refusal(name, "be a number >= 0, or infinity for contacts that never slide", checks.brief(value))
    return number
