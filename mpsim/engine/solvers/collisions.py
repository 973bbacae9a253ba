"""The logs of collisions of a solver, and the table made from them."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.engine.workers.arrays import ArraySpec
from mpsim.features import capsules
from mpsim.kernels import collision_log as log
from mpsim.scene.scene import Scene

TABLE = np.dtype(
    [
        ("frame", np.int64),  # the number that the simulation's `frame` has at the end of the frame in which it happens
        ("time", np.float64),  # since the start [time]
        ("kind", np.int64),  # DISC, WALL or OBSTACLE
        ("i", np.int64),  # a disc; the lower number of two
        ("j", np.int64),  # the other disc, the edge of the box (an index of EDGES), or the index of the obstacle
        ("impulse", np.float64, (2,)),  # along the normal, on disc i [mass length/time]
        ("tangential_impulse", np.float64, (2,)),  # across it, on disc i [mass length/time]
        ("place", np.float64, (2,)),  # where they touch [length]
    ]
)
"""A collision, as observers are given it."""

ROOM, ROOM_OF_A_DISC = 4096, 2
"""Rows of all logs together: so many, and so many more for each disc."""


def specs_of(count: int, workers: int, least: int = 0) -> dict[str, ArraySpec]:
    """The arrays of the logs in a block, with room for at least so many rows in each."""
    room = max((ROOM + ROOM_OF_A_DISC * count) // workers, least, 1)
    return {
        log.ROWS: ArraySpec(log.COLLISION, (workers, room)),
        log.STATE: ArraySpec(np.dtype(np.int64), (workers, log.STATE_SIZE)),
    }


def longest(arrays: Mapping[str, Any]) -> int:
    """Rows of the longest log, those that did not fit included."""
    return int(arrays[log.STATE][:, log.COUNT].max())


def fit(arrays: Mapping[str, Any]) -> bool:
    """Whether all rows have fitted the logs."""
    return longest(arrays) <= arrays[log.ROWS].shape[1]


def emptied(arrays: Mapping[str, Any]) -> NDArray[Any]:
    """The rows of all logs that are not to be taken back, which they then hold no more. Called between two commands."""
    found = []
    for rows, state in zip(arrays[log.ROWS], arrays[log.STATE], strict=True):
        agreed, count = int(state[log.AGREED]), min(int(state[log.COUNT]), len(rows))
        found.append(rows[:agreed].copy())
        rows[: count - agreed] = rows[agreed:count].copy()
        state[log.COUNT] -= agreed
        state[log.AGREED] = 0
    return np.concatenate(found)


def table_of(rows: NDArray[Any], frame: Any, time: Any, scene: Scene) -> NDArray[Any]:
    """The table of some rows, in its one order: TABLE.

    The order is that of frame, time, disc, and partner; where all of these are equal, whatever else tells two apart.

    Args:
        rows: of the logs, with numbers of discs as in the scene.
        frame, time: of each.
        scene: of the simulation.
    """
    table = np.zeros(len(rows), TABLE)
    table["frame"], table["time"] = frame, time
    for name in ("kind", "i", "j", "impulse", "tangential_impulse", "place"):
        table[name] = rows[name]
    _name_obstacles(table, scene)
    _put_lower_disc_first(table)
    for axis, length in enumerate((scene.width, scene.height)):
        if scene.periodic[axis]:
            place = np.mod(table["place"][:, axis], length)
            table["place"][:, axis] = np.where(place == length, 0.0, place)
    return in_order(table)


def in_order(table: NDArray[Any]) -> NDArray[Any]:
    """A table in the order of `table_of`; itself, if it is in order."""
    before, after = table[:-1], table[1:]
    late = (before["frame"] > after["frame"]) | ((before["frame"] == after["frame"]) & (before["time"] > after["time"]))
    if late.any():
        table = table[np.lexsort((table["time"], table["frame"]))]
    same = (table["frame"][1:] == table["frame"][:-1]) & (table["time"][1:] == table["time"][:-1])
    if same.any():
        tied = np.append(same, False) | np.append(False, same)
        table, ties = table.copy(), table[tied]
        vectors = [ties[name][:, axis] for name in ("impulse", "place") for axis in (1, 0)]
        table[tied] = ties[np.lexsort((*vectors, ties["kind"], ties["j"], ties["i"], ties["time"], ties["frame"]))]
    return table


def _name_obstacles(table: NDArray[Any], scene: Scene) -> None:
    met = table["kind"] == log.OBSTACLE
    if met.any():
        table["j"][met] = _obstacle_of_row(scene)[table["j"][met]]


def _obstacle_of_row(scene: Scene) -> NDArray[np.int64]:
    """Index of the obstacle to which each capsule of the kernels belongs, images included."""
    size = scene.width, scene.height
    source = capsules.with_images(scene.capsules, size, scene.periodic, scene.largest_radius).source
    return np.repeat(np.arange(len(scene.obstacles)), [len(each.capsules()) for each in scene.obstacles])[source]


def _put_lower_disc_first(table: NDArray[Any]) -> None:
    swapped = (table["kind"] == log.DISC) & (table["i"] > table["j"])
    table["i"][swapped], table["j"][swapped] = table["j"][swapped], table["i"][swapped]
    table["impulse"][swapped] *= -1
    table["tangential_impulse"][swapped] *= -1


def no_collisions() -> NDArray[Any]:
    """An empty table."""
    return np.zeros(0, TABLE)


def joined(tables: list[NDArray[Any]]) -> NDArray[Any]:
    """Several tables as one."""
    return np.concatenate([no_collisions(), *tables])
