"""The number of collisions since the start of a simulation, for the gauges."""

import math
from collections.abc import Iterable
from typing import Any

from numpy.typing import NDArray

from mpsim.engine.collision_observers import Collisions
from mpsim.engine.report import Report
from mpsim.engine.simulation import Simulation

MOST_LOGGED = 3
"""Largest number of discs for which collisions with walls and obstacles are counted, too. They have to be logged, which
makes frames of many discs slower."""


class CollisionCount:
    """Counts the collisions of a simulation since its start.

    When the simulation goes back to an earlier moment, the count goes back with it.

    Attributes:
        total: number of collisions; NaN if it is not known.

    >>> from mpsim import Scene, Settings
    >>> count = CollisionCount()
    >>> with Simulation(Scene.load("pi"), Settings(method="event", dt=1.0)) as sim:
    ...     count.begin(sim, from_start=True)
    ...     count.end_run(sim, [sim.run(frames=42, observe=count.observers(every=1))])
    >>> count.total, count.with_walls
    (314, True)
    """

    def __init__(self) -> None:
        self.total: float = math.nan
        self._at: dict[int, float] = {}  # moments, by their numbers
        self._log: Collisions | None = None

    def begin(self, sim: Simulation, from_start: bool) -> None:
        """Begin to count for a simulation; from_start: whether all its frames are run here, so the total is known."""
        self.total, self._at, self._log = 0 if from_start else math.nan, {}, None
        if from_start and sim.count <= MOST_LOGGED:
            self._log = Collisions(callback=self._logged)

    @property
    def with_walls(self) -> bool:
        """Whether collisions with walls and obstacles are counted, too."""
        return self._log is not None

    def observers(self, every: int) -> list[Collisions]:
        """Observers for the next run; every: frames between two observations."""
        if self._log is None:
            return []
        self._log.every = every
        return [self._log]

    def _logged(self, sim: Simulation, table: NDArray[Any]) -> None:
        self.total += len(table)

    def so_far(self, sim: Simulation, collisions: int) -> float:
        """The number of collisions so far, during a run; collisions: those between discs since the run began."""
        if self._log is None:
            return self.total + collisions
        self._log.observe(sim, 0)
        return self.total

    def end_run(self, sim: Simulation, reports: Iterable[Report]) -> None:
        """Add the collisions of a run that has ended, from its reports or from the log."""
        if self._log is None:
            self.total += sum(report.collisions for report in reports)
        else:
            self._log.observe(sim, 0)

    def lose(self) -> None:
        """Note that a run ended without a report: the number is unknown until the simulation goes back."""
        self.total = math.nan

    # --- moments

    def mark(self, number: int) -> None:
        """Remember the count of this moment under a number, which may replace an earlier moment."""
        self._at[number] = self.total

    def back(self, number: int) -> None:
        """Go back to the moment of this number; the simulation is another object from now on."""
        self.total = self._at[number]
        if self._log is not None:
            self._log = Collisions(callback=self._logged)

    def forget_all_but(self, numbers: Iterable[int]) -> None:
        """Forget all moments except those with these numbers."""
        self._at = {number: self._at[number] for number in numbers if number in self._at}
