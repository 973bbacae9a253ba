"""Masses other than 1."""

from typing import Any, ClassVar

import numpy as np

from mpsim.core import checks
from mpsim.core.columns import MASS, Column
from mpsim.features.feature import Feature, PerDisc, SceneLike, extent, lattice_sites


def has_masses(scene: SceneLike) -> bool:
    """Whether discs of the scene have masses other than 1, those of its emitters included."""
    return scene.mass is not None or any(emitter.mass not in (None, 1) for emitter in scene.emitters)


class Masses(Feature):
    """The argument `mass`."""

    argument = "mass"
    several = False
    per_disc: ClassVar[dict[str, PerDisc]] = {"mass": PerDisc(checks.masses, unit="[mass]", default=1.0)}
    columns: ClassVar[tuple[Column, ...]] = (MASS,)

    def is_in(self, scene: SceneLike) -> bool:
        """Whether kernels must know them: see `has_masses`."""
        return has_masses(scene)

    def cost_examples(self, side: float, pitch: float) -> dict[str, Any]:
        """Up to four times as heavy as the lightest."""
        return {"masses": np.random.default_rng(2).uniform(0.5, 2.0, lattice_sites(side, pitch))}

    def brief(self, scene: SceneLike) -> str:
        """Only of the discs at the start."""
        return "" if scene.mass is None else "mass"

    def description(self, scene: SceneLike) -> str:
        """Nothing: the line of the discs has their range."""
        return ""

    def record(self, scene: SceneLike) -> list[float]:
        """The least and the largest."""
        return extent(scene.masses)
