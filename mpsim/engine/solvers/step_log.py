"""The log of collisions of stepped solvers."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mpsim.engine.solvers import collisions
from mpsim.engine.solvers.base import Origin
from mpsim.engine.workers.arrays import MOST_FRAMES, ArraySpec
from mpsim.kernels import collision_log
from mpsim.scene.scene import Scene


class Begun(NamedTuple):
    """When a command began, and what then was in force.

    Attributes:
        scene: in force.
        origin: since when it is.
        frame: frames done.
        dt: length of a frame [time].
        substeps: steps of each.
    """

    scene: Scene
    origin: Origin
    frame: int
    dt: float
    substeps: int


class StepLog:
    """What is in the logs of a block, as tables, and how much room there is in them.

    Attributes:
        frames_that_fit: frames that a command may have, so that a log is about half full after it; at least one.
    """

    def __init__(self) -> None:
        self._least = 1
        self._tables: list[NDArray[Any]] = []
        self.frames_that_fit: int = MOST_FRAMES

    def specs(self, count: int, workers: int) -> dict[str, ArraySpec]:
        """The arrays of the logs in a block for so many discs."""
        return collisions.specs_of(count, workers, self._least)

    def begin(self, arrays: Mapping[str, Any]) -> None:
        """Empty the logs for a command."""
        arrays[collision_log.STATE][:] = 0

    def take(self, arrays: Mapping[str, Any], frames: int, begun: Begun) -> bool:
        """Take over what a command of so many frames has left in the logs. False: not all of it has fitted.

        Then a block that is made from now on has room for it.
        """
        longest, room = collisions.longest(arrays), arrays[collision_log.ROWS].shape[1]
        if longest > room:
            self._least = 2 * longest
            return False
        self.frames_that_fit = max(min(frames * room // (2 * longest or 1), 2 * self.frames_that_fit, MOST_FRAMES), 1)
        arrays[collision_log.STATE][:, collision_log.AGREED] = arrays[collision_log.STATE][:, collision_log.COUNT]
        self._tables.append(_table(collisions.emptied(arrays), begun))
        return True

    def taken(self) -> NDArray[Any]:
        """The collisions since the last call."""
        tables, self._tables = self._tables, []
        return collisions.in_order(collisions.joined(tables))


def _table(rows: NDArray[Any], begun: Begun) -> NDArray[Any]:
    step, origin = rows["span"] - 1, begun.origin
    frame, ended = begun.frame + step // begun.substeps, (step % begun.substeps + 1) / begun.substeps
    time = origin.time + ((frame - origin.frame + ended) * begun.dt - rows["time"])
    for edge in range(4):
        hit = (rows["kind"] == collision_log.WALL) & (rows["j"] == edge)
        rows["place"][hit, edge // 2] = _wall_at(begun.scene, edge, time[hit])
    return collisions.table_of(rows, frame + 1, time, begun.scene)


def _wall_at(scene: Scene, edge: int, time: NDArray[np.float64]) -> float | NDArray[np.float64]:
    """Where the wall of an edge is at times [length]."""
    wall = scene.moving_wall
    if wall is None or wall.edge != edge:
        return scene.box[edge]
    return np.array([wall.place(each) for each in time.tolist()])
