"""What the exact solver's kernels are given of features, apart from columns of discs; the scene alone decides it."""

from typing import Any

from mpsim.features.capsules import lists_of_cells
from mpsim.features.obstacles import OBSTACLES
from mpsim.kernels.events.features.capsules import Capsules
from mpsim.scene.scene import Scene


def given(scene: Scene, cells: tuple[int, int]) -> dict[str, Any]:
    """Arrays and records by their names in `hooks.Features`, for so many columns and rows of cells."""
    return {"capsules": _capsules(scene, cells)} if len(scene.capsules) else {}


def _capsules(scene: Scene, cells: tuple[int, int]) -> Capsules:
    """The scene's capsules, listed by cells."""
    capsule = OBSTACLES.arrays(scene)["capsule"]
    lists, shift = lists_of_cells(capsule, (scene.width, scene.height), scene.largest_radius, cells)
    return Capsules(capsule, lists.near, lists.listed, int(lists.grid[1]), shift)
