"""Data of features for the kernels of the exact solver, apart from columns."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.core.columns import EXITS, in_state
from mpsim.core.state import State
from mpsim.engine.solvers.base import Origin
from mpsim.features.capsules import lists_of_cells
from mpsim.features.obstacles import OBSTACLES
from mpsim.features.thermostat import probability_of
from mpsim.kernels.events.features.capsules import Capsules
from mpsim.kernels.events.features.piston import Wall
from mpsim.scene.scene import Scene


def given(scene: Scene, cells: tuple[int, int], dt: float, origin: Origin) -> dict[str, Any]:
    """Arrays and records by their names in `hooks.Features`, for so many columns and rows of cells.

    dt: length of a frame [time]. origin: from which frames and the clock count.
    """
    found: dict[str, Any] = {"capsules": _capsules(scene, cells)} if len(scene.capsules) else {}
    if (bath := scene.thermostat) is not None:
        found["thermostat"] = (probability_of(bath, dt), bath.temperature, bath.seed, origin.frame)
    if (wall := scene.moving_wall) is not None:
        edge, start, stop, speed, began = wall[1:]
        found["moving_wall"] = Wall(edge, start, stop, speed, wall.arrival, began - origin.time)
    return found


def absorbed_in(found: dict[str, NDArray[Any]], count: int) -> NDArray[np.bool_]:
    """Which discs have been absorbed, shape (count,), by their columns."""
    return found[EXITS.name][:, 0] != 0 if EXITS.name in found else np.zeros(count, bool)


def state_of(scene: Scene, time: float, found: dict[str, NDArray[Any]], radii: NDArray[np.float64]) -> State:
    """The state at a time [time] of discs whose columns are given by name; it takes over these arrays.

    A wall that moves is where it is then, and present discs on it, of these radii [length], are not a rounding beyond.
    Absent discs stay where they left, and have nothing that does not rest.
    """
    absorbed = absorbed_in(found, len(radii))
    found = {
        name: found[name] for name in ("position", "velocity", *(each.name for each in in_state())) if name in found
    }
    for column in in_state():
        if column.name in found and not column.rests:
            found[column.name][absorbed] = 0
    if (wall := scene.moving_wall) is not None:
        least, most = (limit[..., wall.axis] for limit in scene.limits(radii, time))
        along = found["position"][:, wall.axis]
        np.clip(along, least, most, out=along, where=~absorbed)
    return State(**found, present=~absorbed, box=scene.box_at(time))


def _capsules(scene: Scene, cells: tuple[int, int]) -> Capsules:
    """The scene's capsules, listed by cells."""
    capsule = OBSTACLES.arrays(scene)["capsule"]
    lists, shift = lists_of_cells(capsule, (scene.width, scene.height), scene.largest_radius, cells)
    return Capsules(capsule, lists.near, lists.listed, int(lists.grid[1]), shift)
