"""What the exact solver's kernels are given of features, apart from columns of discs; the scene alone decides it."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.core.state import State
from mpsim.features.capsules import lists_of_cells
from mpsim.features.obstacles import OBSTACLES
from mpsim.kernels.events.features.capsules import Capsules
from mpsim.scene.scene import Scene


def given(scene: Scene, cells: tuple[int, int]) -> dict[str, Any]:
    """Arrays and records by their names in `hooks.Features`, for so many columns and rows of cells."""
    return {"capsules": _capsules(scene, cells)} if len(scene.capsules) else {}


def state_of(scene: Scene, time: float, found: dict[str, NDArray[Any]], radii: NDArray[np.float64]) -> State:
    """The state at a time [time] of discs whose columns are given by name; it takes over these arrays.

    A wall that moves is where it is then, and discs on it, of these radii [length], are not a rounding beyond.
    """
    low, high = scene.walls_at(time)
    if (wall := scene.moving_wall) is not None:
        least, most = (limit[..., wall.axis] for limit in scene.limits(radii, time))
        np.clip(found["position"][:, wall.axis], least, most, out=found["position"][:, wall.axis])
    return State(**found, box=(float(low[0]), float(high[0]), float(low[1]), float(high[1])))


def _capsules(scene: Scene, cells: tuple[int, int]) -> Capsules:
    """The scene's capsules, listed by cells."""
    capsule = OBSTACLES.arrays(scene)["capsule"]
    lists, shift = lists_of_cells(capsule, (scene.width, scene.height), scene.largest_radius, cells)
    return Capsules(capsule, lists.near, lists.listed, int(lists.grid[1]), shift)
