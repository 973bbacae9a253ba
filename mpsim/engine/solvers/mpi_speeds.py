"""Speeds of the discs of all ranks."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mpsim.core.sizes import kept_sizes
from mpsim.core.state import State
from mpsim.engine.solvers.base import NewDiscs
from mpsim.engine.solvers.mpi_ranks import Communicator
from mpsim.engine.solvers.speeds import Part as SpeedsOfPart
from mpsim.engine.solvers.speeds import Speeds, Walls, sides_at, speeds_together
from mpsim.scene.scene import Scene


class There(NamedTuple):
    """What all ranks know.

    Attributes:
        scene: in force.
        time: as it counts it [time].
        radii: of all discs, shape (N,) [length].
        present: which of them are there, shape (N,); None: all.
    """

    scene: Scene
    time: float
    radii: NDArray[np.float64]
    present: NDArray[np.bool_] | None


def speeds_on_ranks(
    there: There, own: tuple[NDArray[np.int64], State], new: NewDiscs | None, ranks: Communicator
) -> Speeds:
    """Speeds of the discs of all ranks, those that are about to be added included: of one rank.

    Args:
        there: what all know.
        own: numbers of own discs, rising, and their state.
        new: discs that are about to be added; None: none are.
        ranks: which all call this.
    """
    scene, time, radii, present = there
    sides, count, (numbers, state) = sides_at(scene, time), len(radii), own
    velocity = state.velocity
    if new is not None:
        radii = kept_sizes(radii, new.radius)
        present = None if present is None else np.append(present, np.ones(len(new.position), bool))
        if ranks.rank == 0:
            numbers = np.append(numbers, range(count, len(radii)))
            velocity = np.append(velocity, new.velocity, 0)
    part = SpeedsOfPart.of(numbers, velocity, radii[numbers], Walls(sides, scene.periodic, scene.largest_radius))
    return speeds_together(part, ranks.all_of, radii if present is None else radii[present], sides)
