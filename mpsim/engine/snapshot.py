"""`Snapshot`: a moment of a simulation in memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mpsim.engine.solvers.base import SolverState, Terms, count_in

if TYPE_CHECKING:
    from mpsim.engine.changes import Change
    from mpsim.engine.emission import Progress
    from mpsim.scene.scene import Scene
    from mpsim.scene.settings import Settings


@dataclass(frozen=True, eq=False, repr=False)
class Snapshot:
    """Copies of all that the next frame of a simulation depends on, by `Simulation.snapshot`.

    `Simulation.restore` goes back to it, any number of times, and `Simulation.from_snapshot` starts another simulation
    from it. It stays valid when its simulation is closed, and is freed like any other object.

    Attributes:
        frame, time: number of frames since the start, and simulated time [time].
        start: scene and settings at the start of the simulation.
        changes: made since the start, as in `Simulation.journal`.
        terms: scene and settings in force, and since when.
        arrays: of the discs, read-only.
        emission: how far the emitters were.

    >>> from mpsim import Scene, Simulation
    >>> with Simulation(Scene.random(count=50, packing=0.2, radius=0.5, seed=1)) as sim:
    ...     snap = sim.snapshot()
    ...     report = sim.run(frames=10)
    ...     sim.restore(snap)
    >>> snap
    <Snapshot: 50 discs, frame 0, time 0>
    """

    frame: int
    time: float
    start: tuple[Scene, Settings]
    changes: tuple[Change, ...]
    terms: Terms
    arrays: SolverState
    emission: Progress

    def __post_init__(self) -> None:
        for array in self.arrays.values():
            if isinstance(array, np.ndarray):
                array.flags.writeable = False

    @property
    def count(self) -> int:
        """Number of discs, removed ones included."""
        return count_in(self.arrays)

    @property
    def nbytes(self) -> int:
        """Memory of its arrays [bytes]: 32 a disc for smooth discs in steps, 100 with `event`."""
        shared = [id(self.arrays[name]) for name in ("radii", "masses")]  # with the simulation
        return sum(array.nbytes for array in self.arrays.values() if id(array) not in shared)

    def __repr__(self) -> str:
        return f"<Snapshot: {self.count} discs, frame {self.frame}, time {self.time:g}>"
