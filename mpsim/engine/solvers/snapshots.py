"""Snapshots of solvers, and checks of those that come from a file.

The digest of a file tells that it is what was written. A file that was written by hand can have the right
digest; kernels index arrays without looking, so nothing that they follow may lead out of them.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.scene.scene import Scene

Snapshot = dict[str, Any]
"""Everything that the next frame depends on, by name: what a checkpoint holds. Copies, or arrays of `core.chunks` that
are read when they are written. In each there are `radii` and `masses`, float64 of shape (N,), in the order of the
scene's discs, and `progress`, int64 of shape (2,): frames done since the start, and steps (of a solver without steps, a
count of its own)."""

Shapes = dict[str, tuple[np.dtype[Any], tuple[int, ...]]]
"""dtype and shape of arrays, by name."""

MOST_STEPS = 2**60

INTEGER, REAL = np.dtype(np.int64), np.dtype(np.float64)


def count_in(snapshot: Snapshot) -> int:
    """Number of discs in a snapshot."""
    return len(snapshot["radii"])


def shapes_in_each(count: int) -> Shapes:
    """dtype and shape of what every snapshot has."""
    return {"radii": (REAL, (count,)), "masses": (REAL, (count,)), "progress": (INTEGER, (2,))}


def demand(condition: Any, text: str) -> None:
    """Raise ValueError with that text unless the condition is true."""
    if not condition:
        raise ValueError(text)


def check_periods(scene: Scene, image: NDArray[np.int64]) -> None:
    """Raise ValueError unless counts of periods, shape (N, 2), are 0 along axes with walls."""
    demand((image[:, ~np.array(scene.periodic)] == 0).all(), "no disc can have moved through a wall")
