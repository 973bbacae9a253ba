"""A second stage beside the first, and how far they have come apart."""

import contextlib
import copy
import dataclasses
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from mpsim.core.state import State
from mpsim.engine.changes import ADD, PARAMETERS, WALL, Change
from mpsim.engine.parameters import OF_SETTINGS
from mpsim.engine.report import Report
from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.errors import ClosedError, InputError, MpsimError
from mpsim.measure.observables import trajectory_error
from mpsim.measure.registry import refusal
from mpsim.measure.statistics import Measure, block_average
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings
from mpsim.viewer.undo import Moments

# --- Compares two stages: distance between corresponding discs, counts, times, and the time at which the stages
#     diverge
#
# Hard discs are chaotic: any difference between two runs grows until the position of a disc in one run says nothing
# about the same disc in the other. From then on their distance means nothing, and only averages can be compared.

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


# --- A second stage: it starts from the same scene with other settings, and is kept at the same time as the first

SNAPSHOT = 0
"""Number of the moment that a user has marked. The moments before changes have numbers from 1."""

WHOLE = 1e-9
"""Relative deviation from a whole number that counts as rounding."""


class Steps(NamedTuple):
    """How the frames of the second stage correspond to those of the first.

    Attributes:
        first, second: frames of both stages at one moment, from which later frames are counted.
        each: frames of the second stage in one frame of the first, >= 1.
    """

    first: int
    second: int
    each: int


class _Mark(NamedTuple):
    steps: Steps
    taken: int
    comparison: Comparison


class Pair:
    """The second of two stages. Both start from the scene. The first one runs, and this one follows it.

    Args:
        scene: scene of both stages.
        settings: settings of the second stage. Its dt must be that of the first stage divided by a whole number. The
            exact solver has no steps, so it gets the dt of the first stage.
        dt: dt of the first stage [time], > 0.

    Attributes:
        sim: the simulation of the second stage.
        comparison: compares both stages.
        skipped: number of changes by hand that the second stage refused, because a disc was in the way there.

    Raises:
        InputError: if dt does not fit, or the settings cannot run the scene.

    >>> from mpsim import Scene
    >>> scene = Scene.random(count=20, packing=0.2, radius=0.5, seed=1)
    >>> with Simulation(scene, Settings(dt=0.02, method="grid")) as first:
    ...     pair = Pair(scene, Settings(method="event"), dt=0.02)
    ...     seconds = pair.follow(first, first.run(frames=10))
    ...     pair.sim.frame, pair.sim.time == first.time
    (10, True)
    >>> pair.close()
    """

    def __init__(self, scene: Scene, settings: Settings, dt: float):
        self._settings, each = in_step(settings, dt)
        self.sim: Simulation = Simulation(scene, self._settings)
        self.comparison: Comparison = Comparison(scene)
        self.skipped: int = 0
        self._steps = Steps(0, 0, each)
        self._taken = 0  # entries of the first one's journal
        self._moments = Moments()
        self._marks: dict[int, _Mark] = {}  # by the numbers of the moments

    def close(self) -> None:
        """End the second stage. May be called again."""
        self.sim.close()
        with contextlib.suppress(OSError):
            self._moments.close()

    def follow(self, first: Simulation, report: Report) -> float:
        """Run until the frame of the first stage; returns the computing time [s].

        report: report of the first stage since both were last at the same time.
        """
        steps, sim = self._steps, self.sim
        frames = steps.second + (first.frame - steps.first) * steps.each - sim.frame
        if frames <= 0:
            return 0.0
        own, duration = sim.run(frames=frames, measures=measures_of(sim.scene, sim.count)), frames * sim.settings.dt
        self.comparison.first.note(report, duration)
        self.comparison.second.note(own, duration)
        return float(own.frame_seconds.sum())

    # --- changes by hand

    def take(self, first: Simulation, changes: Iterable[Change]) -> None:
        """Apply the new changes of the first stage to this one. Both must be at the same simulated time.

        Changed settings apply only to the first stage, except dt, so that both stay in step. A change that the second
        stage refuses, for example because a disc is in the way, is skipped and counted.

        Args:
            first: the first stage.
            changes: its complete journal.

        Raises:
            InputError: if an added disc or wall finds no free place here, so that the two scenes would differ.
        """
        for change in list(changes)[self._taken :]:
            self._taken += 1
            self._take(first, change)

    def _take(self, first: Simulation, change: Change) -> None:
        values = dict(change.values)
        if change.what == PARAMETERS:
            if "dt" in values:
                self._renew_steps(first, values["dt"])
            values = {name: value for name, value in values.items() if name not in OF_SETTINGS}
            if not values:
                return
        try:
            getattr(self.sim, change.what)(**values)
        except ClosedError:
            raise
        except MpsimError as error:
            if change.what in (ADD, WALL):
                raise InputError(
                    "a second stage must have the discs and walls of the first one; there was no room for one that was "
                    f"added: {error} Reset restarts both."
                ) from error
            self.skipped += 1

    def _renew_steps(self, first: Simulation, dt: float) -> None:
        """Fit the frames of this stage to a new dt of the first stage, and change its own dt as little as possible."""
        exact = not capabilities_of(self._settings).has_steps
        own = dt if exact else fitting(self._settings.dt, dt)
        each = round(dt / own)
        if self.sim.settings.dt != own:
            self.sim.change(dt=own)
        self._steps = Steps(first.frame, self.sim.frame, each)

    # --- earlier moments

    def mark(self, number: int) -> None:
        """Remember this moment under the number that it has in the first stage, which can go back to it."""
        self._moments.keep(number, self.sim)
        self._marks[number] = _Mark(self._steps, self._taken, copy.deepcopy(self.comparison))

    @property
    def bytes_of_moments(self) -> Mapping[int, int]:
        """Bytes of the checkpoint of each moment, by number."""
        return self._moments.sizes

    def forget_all_but(self, numbers: Iterable[int]) -> None:
        """Forget all moments except SNAPSHOT and these: the first stage can go back to no others."""
        for number in self._marks.keys() - {SNAPSHOT, *numbers}:
            self._moments.forget(number)
            del self._marks[number]

    def back(self, number: int) -> None:
        """Go back to a moment.

        Raises:
            InputError: if it is not remembered.
        """
        self.sim = self._moments.back(number, self.sim)
        mark = self._marks[number]
        self._steps, self._taken, self.comparison = mark.steps, mark.taken, copy.deepcopy(mark.comparison)


def fitting(own: float, dt: float) -> float:
    """The dt of a second stage, rounded so that a whole number of its steps is one step of the first stage [time].

    >>> fitting(0.003, dt=0.01), fitting(0.02, dt=0.01)
    (0.0033333333333333335, 0.01)
    """
    return dt / max(round(dt / own), 1)


def in_step(settings: Settings, dt: float) -> tuple[Settings, int]:
    """Settings of a second stage that fit the first one, and the number of its frames in one frame of the first.

    Args:
        settings: requested settings of the second stage.
        dt: dt of the first stage [time].

    Raises:
        InputError: if they do not fit.

    >>> in_step(Settings(method="grid", dt=0.005), dt=0.02)[1], in_step(Settings(method="event"), dt=0.02)[1]
    (4, 1)
    """
    if not capabilities_of(settings).has_steps:
        return dataclasses.replace(settings, dt=dt), 1
    each = round(dt / settings.dt)
    if each < 1 or abs(dt / settings.dt - each) > WHOLE * each:
        raise InputError(
            f"dt of a second stage must be that of the first one, {dt:g}, or a whole fraction of it; got "
            f"{settings.dt:g}. Use Settings(dt={dt / max(each, 1):g})."
        )
    return dataclasses.replace(settings, dt=dt / each), each
