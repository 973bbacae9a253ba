"""Radii, masses, gravity and accelerations."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.core.columns import ACCELERATION, MASS, Column
from mpsim.errors import InputError
from mpsim.features.feature import Feature, Floats, PerDisc

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

    def description(self, scene: Scene) -> str:
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

    def description(self, scene: Scene) -> str:
        return ""
