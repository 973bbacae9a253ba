"""Functions of the state along a run: correlations in time, by a multiple-tau scheme, and time series.

Level 0 keeps the last `points` samples and correlates each new one with all of them: lags 0, 1, ..., points - 1.
Level 1 gets every second sample, or two neighbours merged into one, and so on: level l has lags of k 2^l samples,
with k from points / 2 to points - 1. Lags are then spaced evenly on a logarithmic scale, and each doubling of the
longest one costs `points` samples of memory.

    level 0   o o o o o o o o o o o o o o o o      lags 0 1 2 3 4 5 6 7
    level 1    o   o   o   o   o   o   o   o               8  10  12  14
    level 2        o       o       o       o              16  20  24  28      (points = 8)

Sums of products are kept separately for parts of the run; errors follow from the scatter of the parts.

Source: Ramirez, Sukumaran, Vorselaars & Likhtman, J. Chem. Phys. 133, 154103 (2010), with m = 2; from the hardware
correlators of light scattering (Schaetzel, 1985).
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mpsim.core import checks, files
from mpsim.core.archive import DAMAGE, ArrayFile, save_arrays
from mpsim.core.checks import Binding, Floats
from mpsim.core.state import State
from mpsim.errors import InputError, NotRecordedError, reason_of
from mpsim.features.feature import adds_discs, conserves_energy, mean_mass, removes_discs
from mpsim.measure.observables import is_heated, memory_of_baths
from mpsim.measure.statistics import (
    FEWEST_BLOCKS,
    Equilibration,
    Measure,
    average_beside,
    energy_in_bath,
    equilibration,
)
from mpsim.scene.scene import Scene

if TYPE_CHECKING:
    from mpsim.engine.simulation import Simulation


# --- A correlation function, and the data from which it comes

Route = Literal["displacement", "velocity"]
"""Where a diffusion constant comes from: the growth of displacements, or the velocity autocorrelation."""

SQUARES, VELOCITIES, WAVES = 0, 1, 2
"""Numbers of the quantities that are correlated; WAVES is that of the first wave number."""

MOST_PARTS = 256
"""Parts of a run whose sums are kept apart. When all are in use, neighbours are added up: there are then 128."""

CHUNK = 2**16  # numbers that are multiplied together: they fit the cache of a core

DECAYED = 0.02
"""Fraction of its value at lag 0 to which the velocity autocorrelation must have decayed where diffusion begins."""

OVERLAP = 25
"""Lags in a run from which on errors of displacements are known. At 20 lags those of a random walk are true to 5 %, at
14 they are too small by a factor of 1.3, at 10 of 1.6, as displacements from most time origins overlap."""

DIFFUSIVE_FRACTION = 40
"""Diffusion is taken by default at lags up to the time gathered over this, where errors are known."""


@dataclass(frozen=True)
class TimeCorrelation:
    """A correlation function at the lags that a run has reached.

    Attributes:
        lag: shape (L,), rising [time].
        width: shape (L,), half the width of the triangular window of lags over which a value is averaged, because
            velocities are averaged over blocks; 0 where the value belongs to that lag alone [time].
        measures: L values, each with its standard error and, as `samples`, the number of time origins.

    >>> found = TimeCorrelation(np.array([0.0, 1.0]), np.zeros(2), (Measure(1.0, 0.1, 9), Measure(0.5, 0.2, 8)))
    >>> len(found), found[1], found.value.tolist(), found.error.tolist(), found.settled.tolist()
    (2, 0.50(20), [1.0, 0.5], [0.1, 0.2], [True, True])
    """

    lag: Floats
    width: Floats
    measures: tuple[Measure, ...]

    @property
    def value(self) -> Floats:
        """Shape (L,) [of the function]."""
        return np.array([each.value for each in self.measures])

    @property
    def error(self) -> Floats:
        """Standard errors, shape (L,), NaN where unknown [of the function]."""
        return np.array([each.error for each in self.measures])

    @property
    def settled(self) -> NDArray[np.bool_]:
        """Whether the run was long enough to know the error, shape (L,); if not, it is a bound (see `Measure`)."""
        return np.array([each.settled for each in self.measures], np.bool_)

    def __len__(self) -> int:
        return len(self.measures)

    def __getitem__(self, index: int) -> Measure:
        return self.measures[index]


@dataclass(eq=False)
class Motion:
    """Accumulated data on the motion of some discs, from samples of shape (2, D, 2), positions and velocities.

    discs: their numbers. every, dt: frames between two samples, and time of one. constant: whether the mean square of
    the velocities cannot change. memory: that of heat baths at least, 0 without any [time]. count: number of discs in
    the box. samples: number taken so far. span: samples of one part of the run.
    """

    wave_numbers: Floats
    points: int
    levels: int
    discs: NDArray[np.int64]
    every: int
    dt: float
    constant: bool
    memory: float
    count: int
    samples: int = 0
    span: int = 1

    def __post_init__(self) -> None:
        self.interval: float = self.every * self.dt
        self.lags: NDArray[np.int64] = lags_of(self.points, self.levels)  # rising, in samples
        # Of each part and lag: products whose later sample lies in the part, and their number, one a time origin
        self.sums: Floats = np.zeros((MOST_PARTS, len(self.lags), WAVES + len(self.wave_numbers)))
        self.counts: NDArray[np.int64] = np.zeros((MOST_PARTS, len(self.lags)), np.int64)
        # Of each level that has samples: the last ones in a ring, and how many came since the last `restart`
        self.recent: list[Floats] = []
        self.received: list[int] = []
        self.latest: Floats = np.zeros((2, len(self.discs), 2))

    # --- samples

    def restart(self) -> None:
        """Start anew after a gap in the samples: no product spans it. The sums so far are kept."""
        self.received = [0] * len(self.received)

    def add(self, sample: Floats) -> None:
        """Add the next sample; of two that are merged, the positions are the later ones, the velocities the mean."""
        if self.samples == MOST_PARTS * self.span:
            half = MOST_PARTS // 2
            for each in (self.sums, self.counts):
                each[:half] = each[0::2] + each[1::2]
                each[half:] = 0
            self.span *= 2
        self.samples += 1
        self.latest = sample
        for level in range(self.levels):
            before = self._take(level, sample)
            if before is None:
                return
            sample = np.stack([sample[0], (before[1] + sample[1]) / 2])

    def _take(self, level: int, sample: Floats) -> Floats | None:
        """Correlate a sample with the earlier ones of a level. Returns the first of a pair that it completes."""
        points = self.points
        if level == len(self.recent):
            self.recent.append(np.zeros((points, *sample.shape)))
            self.received.append(0)
        ring, number = self.recent[level], self.received[level]
        ring[number % points] = sample
        self.received[level] = number + 1
        lags = np.arange(points // 2 if level else 0, min(number + 1, points))
        if len(lags):
            begin = points + (level - 1) * points // 2 if level else 0
            part, places = (self.samples - 1) // self.span, slice(begin, begin + len(lags))
            self.sums[part, places] += self._products(sample, ring[(number - lags) % points])
            self.counts[part, places] += 1
        return ring[(number - 1) % points] if number % 2 else None

    def _products(self, now: Floats, then: Floats) -> Floats:
        """Products of a sample with k earlier ones, shape (k, 2 + wave numbers)."""
        rows = max(CHUNK // now[0].size, 1)
        found: list[Floats] = []
        for first in range(0, len(then), rows):
            some = then[first : first + rows]
            discs, k = now.shape[1], len(some)
            moved = now[0] - some[:, 0]
            squares = np.square(moved).reshape(k, -1).sum(axis=1) / discs
            products = (now[1] * some[:, 1]).reshape(k, -1).sum(axis=1) / discs
            waves = [np.cos(q * moved).reshape(k, -1).sum(axis=1) / (2 * discs) for q in self.wave_numbers.tolist()]
            found.append(np.stack([squares, products, *waves], axis=1))
        return np.concatenate(found)

    # --- functions

    def reached(self) -> Floats:
        """Lags that have time origins, the first ones of `lags` [time]."""
        return np.multiply(self.lags[: np.count_nonzero(self.counts.sum(axis=0))], self.interval, dtype=np.float64)

    def function(self, quantity: int) -> TimeCorrelation:
        """One quantity at all lags."""
        lags, width = self.reached(), np.zeros(len(self.lags))
        if quantity == VELOCITIES:
            half = self.points // 2
            width = np.repeat(2 ** np.arange(self.levels), [self.points] + [half] * (self.levels - 1)) - 1
        measures = tuple(self.measure(quantity, lag) for lag in range(len(lags)))
        return TimeCorrelation(lags, np.multiply(width[: len(lags)], self.interval, dtype=np.float64), measures)

    def measure(self, quantity: int, lag: int) -> Measure:
        """One quantity at one lag, given by its index."""
        if lag == 0 and quantity != VELOCITIES:  # nothing has moved
            return Measure(float(quantity >= WAVES), 0.0, self.samples)
        weights = np.zeros(len(self.lags))
        weights[lag] = 1.0
        if quantity == VELOCITIES:
            return self._combined(quantity, weights, constant=self.constant and lag == 0)
        return self._if_long_enough(self._combined(quantity, weights), lag)

    def diffusion(self, start: float | None, end: float | None, route: Route) -> Measure:
        """As `Correlations.diffusion`."""
        lags = self.reached()
        low, high = self._window(lags, start, end)
        weights = np.zeros(len(self.lags))
        if route == "displacement":
            weights[[low, high]] = np.array([-1.0, 1.0]) / (4 * (lags[high] - lags[low]))
            weights[low] *= low > 0  # nothing has moved at lag 0
            found = self._if_long_enough(self._combined(SQUARES, weights), high)
        else:
            steps = np.diff(lags[: high + 1])
            trapezoid = (np.concatenate([[0.0], steps]) + np.concatenate([steps, [0.0]])) / 2
            fraction = np.clip((lags[high] - lags) / (lags[high] - lags[low]), 0.0, 1.0)[: high + 1]
            weights[: high + 1] = trapezoid * fraction / 2
            found = self._combined(VELOCITIES, weights)
        velocity = self.measure(VELOCITIES, low)
        bound = max(DECAYED * self.measure(VELOCITIES, 0).value, 2 * velocity.error)
        return found if abs(velocity.value) <= bound else replace(found, settled=False, upper=False)

    def _window(self, lags: Floats, start: float | None, end: float | None) -> tuple[int, int]:
        """Indices of the lags nearest to start and end."""
        latest = self.samples * self.interval / DIFFUSIVE_FRACTION * (1 + 1e-9)
        high = int(np.searchsorted(lags, latest, side="right")) - 1 if end is None else _nearest("end", end, lags)
        if high < 1:
            raise NotRecordedError(
                f"diffusion needs at least {DIFFUSIVE_FRACTION} samples, or an end after the first lag; got "
                f"{self.samples} samples and end = {end}. Run longer, or give another end."
            )
        if start is None:
            return min(_nearest("start", lags[high] / 2, lags), high - 1), high
        low = _nearest("start", start, lags)
        if low >= high:
            got = f"start = {start!r} and end = {float(lags[high]):g}"
            raise checks.refusal("start", "be before end, by one gathered lag at least", got, "Give an earlier start.")
        return low, high

    def _if_long_enough(self, found: Measure, lag: int) -> Measure:
        """A result from displacements up to a lag; not settled if too many of them overlap."""
        return found if self.samples >= OVERLAP * self.lags[lag] else replace(found, settled=False, upper=False)

    def _combined(self, quantity: int, weights: Floats, constant: bool = False) -> Measure:
        """A weighted sum of the means at all lags, with its error; the mean at one lag if one weight is 1.

        The error is that of the mean of a series of parts, `average_beside`, in which part j has the value
        R + (a_j - R b_j) / mean(b) at each lag: a_j the sum there, b_j the number of origins, R the mean.
        """
        used = np.flatnonzero(weights)
        counts = self.counts[: -(-self.samples // self.span), used]
        origins = counts.sum(axis=0)
        if not len(used) or (origins == 0).any():
            return Measure(math.nan, math.nan, 0, settled=False)
        first = int((counts > 0).argmax(axis=0).max())  # the first part that has all lags
        parts = slice(first, len(counts))
        means = self.sums[:, :, quantity].sum(axis=0)[used] / origins
        value = float((weights[used] * means).sum())
        counts = counts[first:]
        residues = (self.sums[parts, used, quantity] - means * counts) / counts.mean(axis=0)
        series = value + (residues * weights[used]).sum(axis=1)
        slow = None
        if self.memory and len(series) >= FEWEST_BLOCKS:
            energy = self.sums[parts, 0, VELOCITIES] / self.counts[parts, 0]
            slow = energy_in_bath(energy, self.memory / self.interval / (len(series) * self.span), self.count)
        found = average_beside(slow, series, constant=constant)
        return Measure(value, found.error, int(origins.min()), found.settled, found.upper)

    # --- files

    def to_arrays(self) -> dict[str, Any]:
        """Numbers and arrays by name, from which `of_arrays` makes it again."""
        used = -(-self.samples // self.span)
        return {each.name: getattr(self, each.name) for each in fields(self)} | {
            "latest": self.latest,
            "sums": self.sums[:used],
            "counts": self.counts[:used],
            "received": np.array(self.received, np.int64),
            "recent": np.array(self.recent),
        }

    @classmethod
    def of_arrays(cls, arrays: Mapping[str, Any]) -> Motion:
        """The data of which `to_arrays` made these; further names are left out."""
        motion = cls(*(arrays[each.name] for each in fields(cls)))
        used = len(arrays["counts"])
        motion.counts[:used], motion.sums[:used] = arrays["counts"], arrays["sums"]
        motion.received, motion.latest = arrays["received"].tolist(), arrays["latest"].copy()
        motion.recent = [each.copy() for each in arrays["recent"]]
        return motion


def lags_of(points: int, levels: int) -> NDArray[np.int64]:
    """Lags of these levels, in samples: 0, 1, 2, 3, 4, 6, 8, 12 of three levels of four points."""
    further = (2**level * np.arange(points // 2, points) for level in range(1, levels))
    return np.concatenate([np.arange(points), *further])


def _nearest(name: str, lag: float, lags: Floats) -> int:
    """Index of the gathered lag that is nearest, if `lag` is not beyond them."""
    checks.non_negative(name, lag, "[time]")
    if lag > lags[-1] * (1 + 1e-9):
        rule = f"be a lag that the run has reached, at most {float(lags[-1]):g}"
        raise checks.refusal(name, rule, f"{lag!r}", "Run longer, or give an earlier one.")
    return int(np.abs(lags - lag).argmin())


# --- Correlations in time along a run: displacements, velocities and scattering, averaged over discs and time origins

FORMAT = 3  # version of the file
LEVELS = 20  # levels without `longest`: with 16 points the longest lag is 7.8 million samples
MOST_WAVE_NUMBERS = 64  # wave numbers at most: each takes a cosine per disc, axis and lag at every sample

MOST_BYTES = 2**30
"""Memory for recent positions and velocities at most: 20 levels of 16 points for 100,000 discs."""

MOST_LOOKS = 10**12  # samples in the longest lag at most

_ONE_EACH = "Make one for each; measure.independent_average takes means over them."


class Correlations:
    """An observer for `Simulation.run(observe=...)` that averages correlations in time over discs and time origins.

    Displacements are exact in a periodic box too: the solver counts every crossing of a border (`State.unwrapped`). A
    motion common to all discs counts as displacement; `Scene.random` starts without one.

    Lags are 0, 1, ..., points - 1 sampling intervals, and then points/2 lags in each doubling (multiple-tau scheme).
    Positions are compared exactly at the given lag. At longer lags, velocities are first averaged over 2, 4, ...
    samples; the value is then an average over lags within `TimeCorrelation.width`, at most 2/points of the lag.

    Errors, by `block_average` from up to 256 parts of the run, are those of the average over this run, at its energy or
    that of a heat bath. If a run is too short for a lag, or for the memory of a bath, `settled` is False. After a pause
    between two samples, or a change of discs between two runs, averages continue, but no lag spans the interruption.

    Args:
        every: frames between two samples, >= 1. A tenth of the mean free time resolves the decay of velocities.
        start: simulated time at which sampling starts, >= 0 [time], for example after equilibration.
        discs: numbers of the discs to follow, shape (D,), each once; None: all.
        wave_numbers: shape (K,), > 0, for `scattering` [1/length].
        longest: longest lag, > 0 [time]; None: 7.8 million sampling intervals.
        points: samples kept at each level, even, from 4 to 256.
        path: name of a file (.npz) that is written with each checkpoint of the run, for `load`; None: no file.

    Raises:
        InputError: naming the argument, its rule and the value received; in the run, if the discs followed would need
            more than 1 GiB, are not there, or do not stay; if dt has changed, or the simulation is another one.

    Source: Ramirez et al., J. Chem. Phys. 133, 154103 (2010); Frenkel & Smit, Understanding Molecular Simulation
    (2002), sect. 4.4.

    >>> import mpsim
    >>> scene = mpsim.Scene.random(count=50, packing=0.2, radius=0.5, seed=1, boundary="periodic")
    >>> correlations = mpsim.Correlations(every=2, wave_numbers=[1.0])
    >>> with mpsim.Simulation(scene, mpsim.Settings(dt=0.05, method="grid")) as sim:
    ...     report = sim.run(until=200, observe=correlations)
    >>> correlations.msd.lag[:4].round(9).tolist(), round(correlations.velocity[0].value, 9)
    ([0.0, 0.1, 0.2, 0.3], 2.0)
    >>> bool(abs(correlations.diffusion().value - correlations.diffusion(route="velocity").value) < 0.1)
    True
    """

    def __init__(
        self,
        every: int = 1,
        *,
        start: float = 0.0,
        discs: ArrayLike | None = None,
        wave_numbers: ArrayLike = (),
        longest: float | None = None,
        points: int = 16,
        path: str | os.PathLike[str] | None = None,
    ):
        self.every: int = checks.whole("every", every, 1, 10**12, "1 samples every frame.")
        self.start: float = checks.non_negative("start", start, "[time]")
        self.wave_numbers: Floats = checks.finite_array("wave_numbers", wave_numbers, (None,), "(K,)")
        if len(self.wave_numbers) > MOST_WAVE_NUMBERS or (self.wave_numbers <= 0).any():
            rule = f"be at most {MOST_WAVE_NUMBERS} numbers > 0 [1/length]"
            got = checks.brief(self.wave_numbers.tolist())
            raise checks.refusal("wave_numbers", rule, got, "Leave out the others.")
        self._discs = None if discs is None else _numbers(discs)
        self._longest = None if longest is None else checks.positive("longest", longest, "[time]")
        self._points = checks.whole("points", points, 4, 256, "16 is usual.")
        if points % 2:
            raise InputError(f"points must be even, as half of them are kept for each doubling; got {points}. Use 16.")
        self.path: Path | None = None if path is None else files.ending_as("run.npz", path, "Correlations")
        if self.path is not None and self.path.exists():
            raise InputError(
                f"path of Correlations must be that of a new file; {str(self.path)!r} is there already. Continue it by "
                "mpsim.Correlations.load(path), or give another name."
            )
        self._motion: Motion | None = None
        self._bound: tuple[float, int] | None = None  # dt and number of discs at the first sample
        self._owner = Binding("Correlations", _ONE_EACH)
        self._frame: int = -1  # of the last sample that counted
        self._continuing = False  # whether samples up to that one are those of a run that is done again

    def observe(self, sim: Simulation, collisions: int) -> None:
        """Take a sample of the present frame, unless it has one already.

        Args:
            sim: the simulation, always the same.
            collisions: not used.
        """
        self._bind_or_check(sim)
        if sim.frame < self._frame or sim.time < self.start - 1e-6 * sim.settings.dt:
            return
        motion = self._motion = self._motion or self._begin(sim)
        sample = _sample(sim, motion)
        if sim.frame == self._frame:
            if checks.equal(sample, motion.latest):
                self._continuing = False
                return
            if self._continuing:
                raise InputError(
                    f"Correlations can be continued only with the simulation they belong to; at frame {sim.frame} "
                    "they contain other positions or velocities. Use the file that was written with its checkpoint."
                )
            motion.restart()  # discs were changed between two runs
        elif sim.frame != self._frame + self.every:
            motion.restart()
        motion.add(sample)
        self._frame, self._continuing = sim.frame, False

    def _bind_or_check(self, sim: Simulation) -> None:
        """Bind to a simulation the first time; afterwards make sure that it is the same, and has not changed."""
        self._owner.bind_or_check(sim)
        now = sim.settings.dt, sim.count
        self._bound = self._bound or now
        if self._bound != now:
            raise InputError(
                f"Correlations need the same dt and number of discs throughout, {self._bound}; got {now} at frame "
                f"{sim.frame}. Use new ones from here on."
            )

    def _begin(self, sim: Simulation) -> Motion:
        """Data at the first sample."""
        what = "discs of Correlations"
        if self._discs is None and (adds_discs(sim.scene) or removes_discs(sim.scene)):
            raise checks.refusal(what, "be given where discs enter or leave", "None", "Give some that stay.")
        discs = np.arange(sim.count) if self._discs is None else self._discs
        if not len(discs) or discs.max() >= sim.count:
            rule, got = f"be at least one, below {sim.count}, the number of discs", checks.brief(discs.tolist())
            raise checks.refusal(what, rule, got, "Give numbers of discs that are there.")
        interval = self.every * sim.settings.dt
        levels = self._levels(interval)
        sums = MOST_PARTS * len(lags_of(self._points, levels)) * (3 + len(self.wave_numbers)) * 8
        needed = levels * self._points * len(discs) * 4 * 8 + sums
        if needed > MOST_BYTES:
            raise InputError(
                f"Correlations may keep {MOST_BYTES:,} bytes at most; {len(discs):,} discs at lags up to "
                f"{2 ** (levels - 1) * (self._points - 1) * interval:g} need {needed:,}. Give discs=... or longest=..."
            )
        constant = len(discs) == sim.count and sim.scene.mass is None and conserves_energy(sim.scene)
        square = float(np.square(sim.state.velocity, dtype=np.float64).mean())
        heated = is_heated(sim.scene) and square > 0
        memory = memory_of_baths(sim.scene, square * mean_mass(sim.scene)) if heated else 0.0
        dt = sim.settings.dt
        return Motion(self.wave_numbers, self._points, levels, discs, self.every, dt, constant, memory, sim.count)

    def _levels(self, interval: float) -> int:
        if self._longest is None:
            return LEVELS
        if (intervals := self._longest / interval) > MOST_LOOKS:
            rule, got = f"be at most {MOST_LOOKS:g} sampling intervals of {interval:g}", f"{self._longest:g}"
            raise checks.refusal("longest", rule, got, "Give a shorter lag, or sample less often.")
        levels = 1
        while 2 ** (levels - 1) * (self._points - 1) < math.ceil(intervals):
            levels += 1
        return levels

    @property
    def msd(self) -> TimeCorrelation:
        """Mean squared displacement, <|r(t) - r(0)|^2> [length^2]; <v^2> t^2 at short times, 4 D t at long ones.

        Raises:
            NotRecordedError: before the first sample.
        """
        return self._gathered().function(SQUARES)

    @property
    def velocity(self) -> TimeCorrelation:
        """Velocity autocorrelation, <v(t).v(0)> [length^2/time^2]; 2 kT/m at lag 0 in equilibrium.

        Raises:
            NotRecordedError: before the first sample.
        """
        return self._gathered().function(VELOCITIES)

    def scattering(self, wave_number: float) -> TimeCorrelation:
        """Self intermediate scattering function, <cos(k (x(t) - x(0)))> averaged over x and y [1].

        It tends to exp(-k^2 D t) at long times.

        Args:
            wave_number: k, one of those given at the start [1/length].

        Raises:
            InputError: if it is not one of these.
            NotRecordedError: before the first sample.
        """
        k = checks.positive("wave_number", wave_number, "[1/length]")
        at = np.flatnonzero(np.isclose(self.wave_numbers, k, rtol=1e-12, atol=0.0))
        if not len(at):
            rule = f"be one of those that were gathered, {self.wave_numbers.tolist()}"
            raise checks.refusal("wave_number", rule, f"{k!r}", f"Give Correlations(wave_numbers=[{k!r}]).")
        return self._gathered().function(WAVES + int(at[0]))

    def diffusion(
        self, start: float | None = None, end: float | None = None, *, route: Route = "displacement"
    ) -> Measure:
        """Diffusion constant D from lags between start and end [length^2/time].

        From displacements, it is (MSD(end) - MSD(start)) / (4 (end - start)). From velocities, it is half the integral
        of their autocorrelation from 0 to t, averaged over t from start to end, with an error of the trapezoidal rule
        of order (sampling interval / mean free time)^2 / 12. State the lags and the number of discs with the result: in
        two dimensions D(t) grows like log t in an infinite fluid (Alder & Wainwright 1970), and in a periodic box
        approaches a value that depends on its size.

        Args:
            start, end: lags [time]; the nearest recorded lags are used. None: end is 1/40 of the sampled time, start is
                half of end.
            route: "displacement" or "velocity".

        Returns:
            D with its error. Not settled if the run is too short, or if the motion at `start` is not yet diffusive: the
            velocity autocorrelation there still exceeds its error and the fraction DECAYED of its value at lag 0.

        Raises:
            InputError: for lags that were not recorded, or start >= end.
            NotRecordedError: if there were too few samples.

        Source: Einstein (1905); Green (1954), Kubo (1957).
        """
        checks.choice("route", route, ("displacement", "velocity"))
        return self._gathered().diffusion(start, end, route)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write everything recorded so far to a file, for `load`; an existing file is replaced.

        Args:
            path: ends in .npz.

        Raises:
            InputError: for another ending.
            NotRecordedError: before the first sample.
            OutputError: if it cannot be written.
        """
        arrays = self._gathered().to_arrays() | {"format": FORMAT, "start": self.start, "frame": self._frame}
        return save_arrays("a file of Correlations", files.ending_as("run.npz", path, "Correlations"), arrays)

    def keep(self) -> None:
        """Write the file at `path`, if there is one: a run does so before it writes a checkpoint."""
        if self.path is not None and self._motion is not None:
            self.save(self.path)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Correlations:
        """Read what `save` or a run with checkpoints has written, to observe the resumed simulation.

        That may resume at an earlier frame: samples that are in the file are not taken again, and the averages have the
        bits of an uninterrupted run. The file is written with each further checkpoint.

        Args:
            path: of the file.

        Raises:
            InputError: if it is not such a file.

        >>> import tempfile, mpsim
        >>> scene = mpsim.Scene.random(count=50, packing=0.2, radius=0.5, seed=1)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     first = mpsim.Correlations(path=f"{folder}/run.npz")
        ...     with mpsim.Simulation(scene) as sim:
        ...         report = sim.run(frames=50, observe=first, checkpoint=f"{folder}/run.mpsim")
        ...     again = mpsim.Correlations.load(f"{folder}/run.npz")
        ...     with mpsim.Simulation.resume(f"{folder}/run.mpsim") as sim:
        ...         report = sim.run(frames=50, observe=again)
        >>> again.msd[0].samples
        101
        """
        source = files.ending_as("run.npz", path, "Correlations")
        try:
            with files.opened(source) as file, ArrayFile(file) as arrays:
                found = {name: arrays.read(name) for name in arrays.names}
            saved: dict[str, Any] = {name: each if each.ndim else each.item() for name, each in found.items()}
            if saved["format"] != FORMAT:
                raise ValueError(f"it is of version {saved['format']}, and {FORMAT} is read")
            again = cls(**{name: saved[name] for name in ("every", "start", "discs", "wave_numbers", "points")})
            again._bound, again._motion = (saved["dt"], saved["count"]), Motion.of_arrays(saved)
            again._frame, again._continuing = saved["frame"], True
        except (OSError, *DAMAGE) as error:
            why = f"{str(source)!r} ({reason_of(error):.200})"
            raise checks.refusal("a file of Correlations", "be one that mpsim has written", why) from None
        again.path = source
        return again

    def __repr__(self) -> str:
        if self._motion is None:
            return "<Correlations: nothing gathered yet>"
        samples, discs = self._motion.samples, len(self._motion.discs)
        return f"<Correlations: {samples} samples of {discs} discs, lags up to {self._motion.reached()[-1]:g}>"

    def _gathered(self) -> Motion:
        if self._motion is None:
            raise NotRecordedError(
                "Correlations have gathered nothing yet. Give them to sim.run(..., observe=correlations), and let the "
                f"run pass start = {self.start:g}."
            )
        return self._motion


def _sample(sim: Simulation, motion: Motion) -> Floats:
    """Positions and velocities of the discs that are followed, shape (2, D, 2)."""
    state = sim.state
    if not (here := state.present[motion.discs]).all():
        gone = int(motion.discs[int((~here).argmax())])
        raise InputError(
            f"discs of Correlations must stay in the box; disc {gone} has left it by frame {sim.frame}. Follow others."
        )
    return np.stack([state.unwrapped[motion.discs], np.asarray(state.velocity[motion.discs], np.float64)])


def _numbers(values: ArrayLike | Iterable[int]) -> NDArray[np.int64]:
    """Numbers of discs, each once, in the order given."""
    try:
        found = np.asarray(values)
    except ValueError:  # rows of several lengths
        found = np.zeros(0)
    whole = found.ndim == 1 and found.dtype.kind in "iu"
    if not whole or ((found < 0) | (found >= 2**62)).any() or len(np.unique(found)) != len(found):
        rule = "be numbers of discs, shape (D,), whole, >= 0, each once"
        raise checks.refusal("discs", rule, checks.brief(values), "Use discs=range(100), for instance.")
    return found.astype(np.int64)


# --- A function of the state as a time series along a run


class Series:
    """An observer for `Simulation.run(observe=...)` that records a function of the state every few frames.

    The series is kept in memory only, at 16 bytes a sample; `mpsim run --out` writes a table to a file. A frame is
    recorded once.

    Args:
        function: called as function(state, scene), gives a number [any], such as `measure.temperature`.
        every: frames between two samples, >= 1.

    Raises:
        InputError: naming the argument, its rule and the value received; in the run, if the function gives no number,
            or the simulation is another one.

    >>> import mpsim
    >>> scene = mpsim.Scene.random(count=50, packing=0.2, radius=0.5, seed=1)
    >>> kurtosis = mpsim.measure.Series(lambda state, scene: mpsim.measure.speed_kurtosis(state), every=10)
    >>> with mpsim.Simulation(scene, mpsim.Settings(dt=0.02, method="grid")) as sim:
    ...     report = sim.run(frames=1000, observe=kurtosis)
    >>> len(kurtosis.value), kurtosis.time[-1].round(9)
    (101, np.float64(20.0))
    """

    def __init__(self, function: Callable[[State, Scene], float], every: int = 1):
        if not callable(function):
            rule, instead = "be called as function(state, scene)", "Use mpsim.measure.temperature, for instance."
            raise checks.refusal("function of a Series", rule, checks.brief(function), instead)
        self.every: int = checks.whole("every", every, 1, 10**12, "1 samples every frame.")
        self._function = function
        self._owner = Binding("a Series", _ONE_EACH)
        self._frame = -1
        self._rows: list[tuple[float, float]] = []

    def observe(self, sim: Simulation, collisions: int) -> None:
        """Record the value at the present frame, unless it has been recorded.

        Args:
            sim: the simulation, always the same.
            collisions: not used.
        """
        self._owner.bind_or_check(sim)
        if sim.frame <= self._frame:
            return
        value = checks.number("what function of a Series gives", self._function(sim.state, sim.scene), "a number")
        self._rows.append((sim.time, value))
        self._frame = sim.frame

    @property
    def time(self) -> Floats:
        """Times of the samples, shape (n,) [time]."""
        return np.array([time for time, _ in self._rows])

    @property
    def value(self) -> Floats:
        """Values of the function, shape (n,) [of the function]."""
        return np.array([value for _, value in self._rows])

    def equilibration(self, *, batch: int = 5) -> Equilibration:
        """Where the stationary part of the series begins, from `measure.equilibration` of its values.

        Args:
            batch: number of samples in a batch.

        Raises:
            InputError: if there are too few values, or one is not finite.
        """
        return equilibration(self.value, batch=batch)

    def __repr__(self) -> str:
        return f"<Series: {len(self._rows)} values>"
