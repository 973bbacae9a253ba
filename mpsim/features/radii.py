"""Radii that differ from disc to disc."""

from typing import Any, ClassVar

import numpy as np

from mpsim.core import checks
from mpsim.features.feature import Feature, Floats, PerDisc, SceneLike, Shapes, extent, lattice_sites
from mpsim.kernels import records


def check_radius(value: Any, count: int) -> float | Floats:
    """One radius for all discs, or one each, checked [length]."""
    return checks.one_or_each("radius", value, count, "[length]")


def has_radii(scene: SceneLike) -> bool:
    """Whether discs of the scene differ in size, those of its emitters included."""
    return np.ndim(scene.radius) > 0 or any(emitter.radius not in (None, scene.radius) for emitter in scene.emitters)


class Radii(Feature):
    """The argument `radius`. Grid and giants among the discs are the solver's: `mpsim.engine.feature_arrays`."""

    argument = "radius"
    several = False
    per_disc: ClassVar[dict[str, PerDisc]] = {"radius": PerDisc(check_radius, unit="[length]", default=None)}

    def is_in(self, scene: SceneLike) -> bool:
        """Whether kernels must know them: see `has_radii`."""
        return has_radii(scene)

    def shapes(self, scene: SceneLike, capacity: int, real: np.dtype) -> Shapes:
        """Radii in both buffers of the discs, sorted with them; the radius above which discs are giants."""
        if not has_radii(scene):
            return {}
        buffers = {f"{buffer}.radius": (real, (capacity + records.PADDING,)) for buffer in "ab"}
        return {**buffers, "giants": (real, (1,))}

    def cost_examples(self, side: float, pitch: float) -> dict[str, Any]:
        """Up to those of the other scenes, which fit the lattice."""
        return {"radii": np.random.default_rng(2).uniform(0.3, 0.5, lattice_sites(side, pitch))}

    def brief(self, scene: SceneLike) -> str:
        """Nothing: the repr of a scene begins with them."""
        return ""

    def description(self, scene: SceneLike) -> str:
        """Nothing: the line of the discs has their range."""
        return ""

    def record(self, scene: SceneLike) -> list[float]:
        """The least and the largest."""
        return extent(scene.radii)
