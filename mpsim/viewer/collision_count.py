"""The number of collisions since the start of a simulation, for the gauges."""

import math
from collections.abc import Iterable
from typing import Any

from numpy.typing import NDArray

from mpsim.engine.collision_observers import Collisions
from mpsim.engine.report import Report
from mpsim.engine.simulation import Simulation

MOST_LOGGED = 3
"""Discs up to which collisions with walls and obstacles are counted, too: they have to be logged, which makes frames of
many discs slower."""


class CollisionCount:
    """The collisions of a simulation since its start. It goes back to earlier moments together with the simulation.

    Attributes:
        total: their number; NaN where it is not known.

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
        """Begin with a simulation; from_start: whether all its frames are run here."""
        self.total, self._at, self._log = 0 if from_start else math.nan, {}, None
        if from_start and sim.count <= MOST_LOGGED:
            self._log = Collisions(each=self._logged)

    @property
    def with_walls(self) -> bool:
        """Whether collisions with walls and obstacles are counted, too."""
        return self._log is not None

    def observers(self, every: int) -> list[Collisions]:
        """Observers of the next run; every: frames between two looks."""
        if self._log is None:
            return []
        self._log.every = every
        return [self._log]

    def _logged(self, sim: Simulation, table: NDArray[Any]) -> None:
        self.total += len(table)

    def so_far(self, sim: Simulation, collisions: int) -> float:
        """The number during a run; collisions: between discs since it began."""
        if self._log is None:
            return self.total + collisions
        self._log.look(sim, 0)
        return self.total

    def end_run(self, sim: Simulation, reports: Iterable[Report]) -> None:
        """Add those of a run, from its reports or from the log."""
        if self._log is None:
            self.total += sum(report.collisions for report in reports)
        else:
            self._log.look(sim, 0)

    def lose(self) -> None:
        """A run has ended without a report: the number is not known, until the simulation goes back."""
        self.total = math.nan

    # --- moments

    def mark(self, number: int) -> None:
        """Remember the count at this moment under a number, in place of the one that had it."""
        self._at[number] = self.total

    def back(self, number: int) -> None:
        """Go back to a moment, with another simulation."""
        self.total = self._at[number]
        if self._log is not None:
            self._log = Collisions(each=self._logged)

    def forget_all_but(self, numbers: Iterable[int]) -> None:
        """Forget the moments but for these."""
        self._at = {number: self._at[number] for number in numbers if number in self._at}
