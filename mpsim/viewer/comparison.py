"""Compares two stages: distance between corresponding discs, counts, times, and the time at which the stages diverge.

Hard discs are chaotic: any difference between two runs grows until the position of a disc in one run says nothing about
the same disc in the other. From then on their distance means nothing, and only averages can be compared.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

from mpsim.core.state import State
from mpsim.engine.report import Report
from mpsim.errors import InputError
from mpsim.measure.observables import trajectory_error
from mpsim.measure.run_averages import refusal
from mpsim.measure.statistics import Measure, block_average
from mpsim.scene.scene import Scene

PARTED = 0.5
"""Distance at which two runs have parted, in diameters, root mean square over all discs. A disc that has missed a
collision is displaced by about as much. Later the distance grows to that of unrelated discs."""

SATURATED = 0.01
"""Distance above which the growth is no longer exponential, in diameters, root mean square over all discs."""

MOST_BLOCKS = 128
"""Largest number of blocks of a mean; then each two blocks are merged into one."""


class RunningMean:
    """The mean of a quantity along a run, and its standard error from means over blocks of equal duration.

    >>> mean = RunningMean()
    >>> for value in (1.0, 2.0, 3.0):
    ...     mean.note(value, duration=0.5)
    >>> mean.read().value
    2.0
    """

    def __init__(self) -> None:
        self._blocks: list[float] = []
        self._length = 0.0  # of a block, from the first value on [time]
        self._sum = self._open_for = 0.0  # of the block that is not yet full
        self._all = self._duration = 0.0

    def note(self, value: float, duration: float) -> None:
        """Add the mean over a time interval. Values that are not finite are left out.

        Args:
            value: the mean.
            duration: length of the interval [time], > 0.
        """
        if not math.isfinite(value) or duration <= 0:
            return
        self._length = self._length or duration
        self._all += value * duration
        self._duration += duration
        self._sum += value * duration
        self._open_for += duration
        if self._open_for < self._length * (1 - 1e-9):
            return
        self._blocks.append(self._sum / self._open_for)
        self._sum = self._open_for = 0.0
        if len(self._blocks) >= MOST_BLOCKS:
            self._blocks = [(a + b) / 2 for a, b in zip(self._blocks[::2], self._blocks[1::2], strict=True)]
            self._length *= 2

    def read(self) -> Measure:
        """The mean so far; NaN before the first value. It has no error while there are too few blocks."""
        if not self._duration:
            return Measure(math.nan, math.nan, 0, settled=False)
        found = block_average(self._blocks) if self._blocks else Measure(math.nan, math.nan, 0, settled=False)
        return replace(found, value=self._all / self._duration)


class Count:
    """Counts and times of one stage.

    Attributes:
        collisions: number of contacts resolved.
        seconds: computing time [s].
        time: simulated time [time].
        pressure: mean pressure [force/length].
    """

    def __init__(self) -> None:
        self.collisions: int = 0
        self.seconds: float = 0.0
        self.time: float = 0.0
        self.pressure: RunningMean = RunningMean()

    def note(self, report: Report, duration: float) -> None:
        """Add a run; duration: its simulated time [time]."""
        self.collisions += report.collisions
        self.seconds += float(report.frame_seconds.sum())
        self.time += duration
        if "pressure" in report.measures:
            self.pressure.note(report.measures["pressure"].value, duration)

    @property
    def cost(self) -> float:
        """Computing time divided by simulated time [s/time]; NaN before the first run."""
        return self.seconds / self.time if self.time else math.nan


def measures_of(scene: Scene, count: int) -> tuple[str, ...]:
    """The measures that both stages take along their runs: the pressure, where it is defined.

    >>> measures_of(Scene.random(count=5, packing=0.2, radius=0.5), count=5)
    ('pressure',)
    """
    return () if refusal("pressure", scene, count) else ("pressure",)


@dataclass(frozen=True)
class Distance:
    """Distance between corresponding discs of two states.

    Attributes:
        mean: root mean square over the discs, in diameters of the smallest disc.
        largest: largest distance of one disc, in the same unit.
        disc: number of that disc.
    """

    mean: float
    largest: float
    disc: int


class Comparison:
    """Compares two stages since their common start.

    Args:
        scene: scene of both.

    Attributes:
        first, second: counts and times of each.
        parted: time at which they were first seen to have parted, or were predicted to part [time]; None: not yet.

    >>> from mpsim import Scene
    >>> scene = Scene(width=9, height=9, position=[[2, 2], [5, 5]], velocity=[[1, 0], [0, 1]], radius=0.5)
    >>> there = State(scene.position + [[0.001, 0.0], [0.0, 0.0]], scene.velocity)
    >>> comparison = Comparison(scene)
    >>> round(comparison.look(State(scene.position, scene.velocity), there, time=1.0).largest, 9), comparison.parted
    (0.001, None)
    """

    def __init__(self, scene: Scene):
        self.first: Count = Count()
        self.second: Count = Count()
        self.parted: float | None = None
        self._saturated: float | None = None  # time at which the distance was first seen to reach SATURATED
        self._scene = scene

    def look(self, one: State, other: State, time: float, agree_until: float | None = None) -> Distance | None:
        """The distance between two states at the same time; None where it means nothing.

        The states have parted for good once they are PARTED diameters apart: from then on their distance is chance.
        Discs in a dense packing rarely leave the cages of their neighbours, so their distance may stay below PARTED.
        Therefore states that are at least SATURATED diameters apart also count as parted after `agree_until`.

        Args:
            one: a state.
            other: the other state.
            time: time of both [time].
            agree_until: time until which two correct solvers agree, from the Lyapunov time [time]; None: not known.
        """
        try:
            found = trajectory_error(one, other, self._scene)
        except InputError:  # there are no discs, or a disc was added to only one of them
            return None
        diameter = 2 * self._scene.smallest_radius
        distance = Distance(found.rms / diameter, found.largest / diameter, found.disc)
        if self.parted is None and distance.mean >= PARTED:
            self.parted = time
        if self._saturated is None and distance.mean >= SATURATED:
            self._saturated = time
        if agree_until is not None and agree_until <= time and self._saturated is not None:
            predicted = max(agree_until, self._saturated)
            self.parted = predicted if self.parted is None else min(self.parted, predicted)
        return distance if self.parted is None else None

    def read(self, one: State, other: State, time: float, agree_until: float | None = None) -> dict[str, Any]:
        """The numbers that a page shows, for `wire.text_of`; NaN and None are shown as dashes.

        The arguments are those of `look`.

        `missed` is the number of collisions that the second stage has counted and the first one has not. Once the
        stages have parted, these are different collisions, and only the fraction is meaningful.

        Before the first collision that contributes to it, the pressure is NaN: zero would be no measurement.
        """
        first, second = self.first, self.second
        distance = self.look(one, other, time, agree_until)
        pressures = first.pressure.read(), second.pressure.read()
        values = [each.value or math.nan for each in pressures]
        missed = second.collisions - first.collisions
        return {
            "time": time,
            "distance": None if distance is None else distance.mean,
            "largest": None if distance is None else distance.largest,
            "disc": None if distance is None else distance.disc,
            "parted": self.parted,
            "collisions": [first.collisions, second.collisions],
            "missed": missed if self.parted is None else None,
            "missed_fraction": missed / second.collisions if second.collisions else math.nan,
            "pressure": values,
            "pressure_error": [each.error for each in pressures],
            "pressure_difference": values[0] - values[1],
            "difference_error": math.hypot(*(each.error for each in pressures)),
            "cost": [first.cost, second.cost],
            "cost_ratio": second.cost / first.cost if first.cost and second.time else math.nan,
        }
