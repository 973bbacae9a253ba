"""Snapshots of stepped solvers: how they are taken, and checks of their content."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.core import columns
from mpsim.engine.columns import columns_of
from mpsim.engine.solvers.discs import places_and_speeds
from mpsim.engine.solvers.snapshots import Shapes, Snapshot, check_periods, demand, shapes_in_each
from mpsim.engine.workers.shared import SharedBlock
from mpsim.scene.scene import Scene

SLACK = 1e-6
"""Fraction of the box by which rounding may have put a centre beyond its limit."""


def taken(block: SharedBlock, radii: NDArray[np.float64], masses: NDArray[np.float64]) -> Snapshot:
    """A snapshot of the discs of a block, in the order of the scene's.

    Args:
        block: with as many discs in it.
        radii, masses: of the discs, shape (N,), read-only [length], [mass].
    """
    arrays, count = block.arrays, len(radii)
    position, velocity = places_and_speeds(block, count)
    found: Snapshot = {"position": position, "velocity": velocity, "radii": radii, "masses": masses}
    for column in columns.COLUMNS:
        if column.kept and column.name in arrays:
            found[column.name] = column.take(arrays[column.name], count)
    control = arrays["control"]
    found["progress"] = np.array([control.done, control.steps])
    return found


def shapes(scene: Scene, real: np.dtype[Any], count: int) -> Shapes:
    """dtype and shape of every array of a snapshot in that precision."""
    found: Shapes = {"position": (real, (count, 2)), "velocity": (real, (count, 2))}
    for column in columns_of(scene):
        if column.kept:
            found[column.name] = column.dtype(real), column.rows(count)
    return found | shapes_in_each(count)


def check(scene: Scene, arrays: Snapshot) -> None:
    """Raise ValueError unless the discs of a snapshot can be in the scene."""
    demand(np.isfinite(arrays["velocity"]).all(), "velocity must be finite")
    _check_places(scene, arrays["position"])
    for column in columns.COLUMNS:
        if column.name in arrays and (column.in_state or column.given):
            demand(np.isfinite(arrays[column.name]).all(), f"{column.name} must be finite")
    if "exits" in arrays:
        gone, *places = arrays["exits"].T
        demand(((gone == 0) | (gone == 1)).all(), "a disc has left or it has not")
        _check_places(scene, np.stack(places, axis=1))
    if "image" in arrays:
        check_periods(scene, arrays["image"])


def _check_places(scene: Scene, position: NDArray[np.floating]) -> None:
    """Centres between walls are in the box; through a periodic border a contact may have moved them."""
    for axis, length in enumerate((scene.width, scene.height)):
        places = position[:, axis]
        demand(np.isfinite(places).all(), "position must be finite")
        inside = (places >= -SLACK * length) & (places <= (1 + SLACK) * length)
        demand(scene.periodic[axis] or inside.all(), "position must be in the box")
