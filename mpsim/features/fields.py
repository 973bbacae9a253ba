"""Fields: gravity, one acceleration for all discs, and an acceleration of each disc."""

from typing import Any, ClassVar

import numpy as np

from mpsim.core import checks
from mpsim.core.columns import ACCELERATION, Column
from mpsim.errors import InputError
from mpsim.features.feature import Feature, Floats, PerDisc, SceneLike, Shapes, lattice_sites


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
    several = False
    vectors: ClassVar[dict[str, str]] = {"gravity": "[gx, gy], one acceleration for all discs"}
    drives = "gravity"

    def is_in(self, scene: SceneLike) -> bool:
        """Whether it is given, zeros included."""
        return scene.gravity is not None

    def shapes(self, scene: SceneLike, capacity: int, real: np.dtype) -> Shapes:
        """(gx, gy)."""
        return {} if scene.gravity is None else {"gravity": (real, (2,))}

    def fill(self, scene: SceneLike, arrays: dict[str, Any], margin: float) -> None:
        """Write it."""
        if scene.gravity is not None:
            arrays["gravity"][:] = scene.gravity

    def description(self, scene: SceneLike) -> str:
        """Its components."""
        x, y = self.of(scene)
        return f"({x:g}, {y:g})"

    def record(self, scene: SceneLike) -> list[float] | None:
        """A list."""
        return None if scene.gravity is None else scene.gravity.tolist()

    def cost_examples(self, side: float, pitch: float) -> dict[str, Any]:
        """A small one, downwards."""
        return {"gravity": (0.0, -0.1)}


class Acceleration(Feature):
    """The argument `acceleration`."""

    argument = "acceleration"
    several = False
    per_disc: ClassVar[dict[str, PerDisc]] = {"acceleration": PerDisc(check_acceleration, components=("ax", "ay"))}
    not_exact = "acceleration per disc, under which the relative motion of two discs is not uniform"
    columns: ClassVar[tuple[Column, ...]] = (ACCELERATION,)

    def is_in(self, scene: SceneLike) -> bool:
        """Whether it is given, zeros included."""
        return scene.acceleration is not None

    def description(self, scene: SceneLike) -> str:
        """That discs have it, not the rows."""
        return "one per disc"

    def record(self, scene: SceneLike) -> bool:
        """Whether discs have it."""
        return self.is_in(scene)

    def cost_examples(self, side: float, pitch: float) -> dict[str, Any]:
        """Small random ones."""
        return {"acceleration per disc": np.random.default_rng(2).normal(size=(lattice_sites(side, pitch), 2)) * 0.1}
