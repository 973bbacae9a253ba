"""Functions of time correlations, and the multiple-tau scheme that collects them.

Level 0 keeps the last `points` samples and correlates each new one with all of them: lags 0, 1, ..., points - 1.
Level 1 gets every second sample, or two neighbours merged into one, and so on: level l has lags of k 2^l samples,
with k from points / 2 to points - 1. Lags are then spaced evenly on a logarithmic scale, and each doubling of the
longest one costs `points` samples of memory.

    level 0   o o o o o o o o o o o o o o o o      lags 0 1 2 3 4 5 6 7
    level 1    o   o   o   o   o   o   o   o               8  10  12  14
    level 2        o       o       o       o              16  20  24  28      (points = 8)

Sums of products are kept separately for parts of the run; errors follow from the scatter of the parts: see
`BlockSums`.

Source: Ramirez, Sukumaran, Vorselaars & Likhtman, J. Chem. Phys. 133, 154103 (2010), with m = 2; from the hardware
correlators of light scattering (Schaetzel, 1985).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.errors import InputError, NotRecordedError
from mpsim.measure.statistics import FEWEST_BLOCKS, Measure, average_beside, energy_in_bath

# --- The multiple-tau scheme: correlations at lags from one sample to millions, in bounded memory, as samples arrive

Floats = NDArray[np.float64]

MOST_PARTS = 256
"""Parts of a run whose sums are kept apart. When all are in use, neighbours are added up: there are then 128."""


class BlockSums:
    """Sums of products for up to MOST_PARTS equal parts of a run, each as long as a power of two samples.

    Args:
        lags, quantities: how many there are.

    Attributes:
        samples: taken so far.
        span: samples of one part.
        sums: shape (MOST_PARTS, lags, quantities), of products whose later sample lies in the part.
        counts: shape (MOST_PARTS, lags), number of these products: one for each time origin.
    """

    def __init__(self, lags: int, quantities: int):
        self.samples: int = 0
        self.span: int = 1
        self.sums: Floats = np.zeros((MOST_PARTS, lags, quantities))
        self.counts: NDArray[np.int64] = np.zeros((MOST_PARTS, lags), np.int64)

    def begin_sample(self) -> None:
        """Begin another sample: products added from now on belong to it."""
        if self.samples == MOST_PARTS * self.span:
            half = MOST_PARTS // 2
            for each in (self.sums, self.counts):
                each[:half] = each[0::2] + each[1::2]
                each[half:] = 0
            self.span *= 2
        self.samples += 1

    def add(self, lags: slice, values: Floats) -> None:
        """Products of the present sample with earlier ones, shape (lags, quantities)."""
        part = (self.samples - 1) // self.span
        self.sums[part, lags] += values
        self.counts[part, lags] += 1

    def origins(self) -> NDArray[np.int64]:
        """Number of time origins of each lag, shape (lags,)."""
        return self.counts.sum(axis=0)

    def means(self, quantity: int) -> Floats:
        """Mean product at each lag, shape (lags,); NaN where there is none."""
        origins = self.origins()
        totals = self.sums[:, :, quantity].sum(axis=0)
        return np.divide(totals, origins, out=np.full(len(origins), np.nan), where=origins > 0)

    def combined(
        self, quantity: int, weights: Floats, constant: bool = False, bath: tuple[int, float, int] | None = None
    ) -> Measure:
        """A weighted sum of the means at all lags, with its error; the mean at one lag if one weight is 1.

        The error is that of the mean of a series of parts, `average_beside`, in which part j has the value
        R + (a_j - R b_j) / mean(b) at each lag: a_j the sum there, b_j the number of origins, R the mean.

        Args:
            quantity: its number.
            weights: shape (lags,) [any].
            constant: as in `average_beside`.
            bath: if there is a heat bath, the quantity whose mean at lag 0 is the energy, the memory of the bath in
                samples, and the number of discs that it heats.
        """
        used = np.flatnonzero(weights)
        counts = self.counts[: -(-self.samples // self.span), used]
        if not len(used) or (counts.sum(axis=0) == 0).any():
            return Measure(float("nan"), float("nan"), 0, settled=False)
        first = int((counts > 0).argmax(axis=0).max())  # the first part that has all lags
        means = self.means(quantity)[used]
        value, origins = float((weights[used] * means).sum()), int(counts.sum(axis=0).min())
        counts = counts[first:]
        residues = (self.sums[first : first + len(counts), used, quantity] - means * counts) / counts.mean(axis=0)
        series = value + (residues * weights[used]).sum(axis=1)
        slow = None
        if bath is not None and len(series) >= FEWEST_BLOCKS:
            energy, memory, discs = bath
            parts = slice(first, first + len(series))
            values = self.sums[parts, 0, energy] / self.counts[parts, 0]
            slow = energy_in_bath(values, memory / (len(series) * self.span), discs)
        found = average_beside(slow, series, constant=constant)
        return Measure(value, found.error, origins, found.settled, found.upper)


class MultipleTau:
    """A correlator of samples that come at equal intervals.

    Args:
        product: called with a sample and earlier ones, shape (k, ...), gives products of shape (k, quantities).
        merge: called with two neighbouring samples of a level, the earlier one first, gives that of the next level.
        quantities: how many products there are.
        points: samples that each level keeps, even, >= 4.
        levels: how many, >= 1.

    Attributes:
        lags: shape (L,), rising, in samples.
        width: shape (L,), samples that each sample of a level stands for, 2^level.
        blocks: sums for parts of the run.
        recent: of each level that has samples, its last ones, shape (points, ...), in a ring.
        received: samples that each of these levels has got since the last `restart`.

    >>> found = MultipleTau(lambda now, then: (now * then)[:, None], lambda a, b: (a + b) / 2, 1, points=4, levels=3)
    >>> for sample in (1.0, 2.0, 3.0, 4.0, 5.0, 6.0):
    ...     found.add(np.float64(sample))
    >>> found.lags.tolist(), found.blocks.origins().tolist()
    ([0, 1, 2, 3, 4, 6, 8, 12], [6, 5, 4, 3, 1, 0, 0, 0])
    >>> found.blocks.means(0)[:5].tolist()  # at lag 4: (5.5 + ...) of merged pairs, 1.5 and 5.5
    [15.166666666666666, 14.0, 12.5, 10.666666666666666, 8.25]
    """

    def __init__(
        self,
        product: Callable[[Any, Floats], Floats],
        merge: Callable[[Any, Any], Any],
        quantities: int,
        points: int = 16,
        levels: int = 20,
    ):
        self._product = product
        self._merge = merge
        self._points = points
        self._levels = levels
        self.lags: NDArray[np.int64] = lags_of(points, levels)
        self.width: NDArray[np.int64] = np.repeat(2 ** np.arange(levels), [points] + [points // 2] * (levels - 1))
        self.blocks: BlockSums = BlockSums(len(self.lags), quantities)
        self.recent: list[Floats] = []
        self.received: list[int] = []

    def restart(self) -> None:
        """Start anew after a gap in the samples: no product spans it. The sums so far are kept."""
        self.received = [0] * len(self.received)

    def add(self, sample: Any) -> None:
        """Add the next sample."""
        self.blocks.begin_sample()
        for level in range(self._levels):
            before = self._take(level, sample)
            if before is None:
                return
            sample = self._merge(before, sample)

    def _take(self, level: int, sample: Any) -> Any:
        """Correlate a sample with the earlier ones of a level. Returns the first of a pair that it completes."""
        if level == len(self.recent):
            self.recent.append(np.zeros((self._points, *np.shape(sample))))
            self.received.append(0)
        ring, number, points = self.recent[level], self.received[level], self._points
        ring[number % points] = sample
        self.received[level] = number + 1
        lags = np.arange(points // 2 if level else 0, min(number + 1, points))
        if len(lags):
            begin = points + (level - 1) * points // 2 if level else 0
            values = self._product(sample, ring[(number - lags) % points])
            self.blocks.add(slice(begin, begin + len(lags)), values)
        return ring[(number - 1) % points] if number % 2 else None


def lags_of(points: int, levels: int) -> NDArray[np.int64]:
    """Lags of a correlator, in samples, shape (L,).

    >>> lags_of(4, 3).tolist()
    [0, 1, 2, 3, 4, 6, 8, 12]
    """
    return np.concatenate(
        [np.arange(points), *(2**level * np.arange(points // 2, points) for level in range(1, levels))]
    )


def levels_for(longest: int, points: int) -> int:
    """The smallest number of levels whose longest lag is at least this many samples.

    >>> levels_for(15, 16), levels_for(16, 16), levels_for(31, 16)
    (1, 2, 3)
    """
    level = 1
    while 2 ** (level - 1) * (points - 1) < longest:
        level += 1
    return level


def trapezoid(lags: Sequence[float] | Floats) -> Floats:
    """Weights of the trapezoidal rule for rising abscissas, shape (L,).

    >>> trapezoid([0.0, 1.0, 3.0]).tolist()
    [0.5, 1.5, 1.0]
    """
    steps = np.diff(np.asarray(lags, np.float64))
    return (np.concatenate([[0.0], steps]) + np.concatenate([steps, [0.0]])) / 2


# --- Functions of time correlations: displacements, velocity autocorrelation, scattering, diffusion constant


Route = Literal["displacement", "velocity"]
"""Where a diffusion constant comes from: the growth of displacements, or the velocity autocorrelation."""

SQUARES, VELOCITIES, WAVES = 0, 1, 2
"""Numbers of the quantities that are correlated; WAVES is that of the first wave number."""

MOST_WAVE_NUMBERS = 64
"""Wave numbers at most: each takes a cosine per disc, axis and lag at every sample."""

CHUNK = 2**16
"""Numbers that are multiplied together: they fit the cache of a core."""

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
        try:
            return self.measures[index]
        except IndexError:
            raise IndexError(f"the correlation has {len(self)} lags; got index {index}.") from None


@dataclass
class Motion:
    """Accumulated data on the motion of some discs.

    Attributes:
        correlator: of samples of shape (2, D, 2), positions and velocities.
        discs: numbers of the discs, shape (D,).
        latest: the last sample.
        interval: between two samples [time].
        constant: whether the mean square of the velocities cannot change.
        memory: that of heat baths at least, 0 without any [time].
        heated: number of discs in the box, which baths heat.
    """

    correlator: MultipleTau
    discs: NDArray[np.int64]
    latest: Floats
    interval: float
    constant: bool
    memory: float = 0.0
    heated: int = 0

    @property
    def _bath(self) -> tuple[int, float, int] | None:
        """As `BlockSums.combined` takes it."""
        return (VELOCITIES, self.memory / self.interval, self.heated) if self.memory else None

    @property
    def lags(self) -> Floats:
        """Lags that have time origins, shape (L,) [time]: the first ones of the correlator."""
        return np.multiply(
            self.correlator.lags[: np.count_nonzero(self.correlator.blocks.origins())], self.interval, dtype=np.float64
        )

    def measure(self, quantity: int, lag: int) -> Measure:
        """One quantity at one lag, given by its index."""
        if lag == 0 and quantity != VELOCITIES:  # nothing has moved
            return Measure(float(quantity >= WAVES), 0.0, self.correlator.blocks.samples)
        weights = np.zeros(len(self.correlator.lags))
        weights[lag] = 1.0
        constant = self.constant and quantity == VELOCITIES and lag == 0
        found = self.correlator.blocks.combined(quantity, weights, constant, self._bath)
        return found if quantity == VELOCITIES else self._if_long_enough(found, lag)

    def _if_long_enough(self, found: Measure, lag: int) -> Measure:
        """What was found from displacements up to a lag; not settled if too many of them overlap."""
        long_enough = self.correlator.blocks.samples >= OVERLAP * self.correlator.lags[lag]
        return found if long_enough else replace(found, settled=False, upper=False)

    def function(self, quantity: int) -> TimeCorrelation:
        """One quantity at all lags."""
        lags = self.lags
        averaged = np.multiply(self.correlator.width[: len(lags)] - 1, self.interval, dtype=np.float64)
        width = averaged if quantity == VELOCITIES else np.zeros(len(lags))
        return TimeCorrelation(lags, width, tuple(self.measure(quantity, lag) for lag in range(len(lags))))

    def diffusion(self, start: float | None, end: float | None, route: Route) -> Measure:
        """As `Correlations.diffusion`."""
        lags = self.lags
        low, high = self._window(lags, start, end)
        weights = np.zeros(len(self.correlator.lags))
        if route == "displacement":
            weights[[low, high]] = np.array([-1.0, 1.0]) / (4 * (lags[high] - lags[low]))
            weights[low] *= low > 0  # nothing has moved at lag 0
        else:
            fraction = np.clip((lags[high] - lags) / (lags[high] - lags[low]), 0.0, 1.0)[: high + 1]
            weights[: high + 1] = trapezoid(lags[: high + 1]) * fraction / 2
        quantity = SQUARES if route == "displacement" else VELOCITIES
        found = self.correlator.blocks.combined(quantity, weights, bath=self._bath)
        found = self._if_long_enough(found, high) if route == "displacement" else found
        velocity = self.measure(VELOCITIES, low)
        bound = max(DECAYED * self.measure(VELOCITIES, 0).value, 2 * velocity.error)
        return found if abs(velocity.value) <= bound else replace(found, settled=False, upper=False)

    def _window(self, lags: Floats, start: float | None, end: float | None) -> tuple[int, int]:
        """Indices of the lags nearest to start and end."""
        samples = self.correlator.blocks.samples
        latest = samples * self.interval / DIFFUSIVE_FRACTION * (1 + 1e-9)
        high = int(np.searchsorted(lags, latest, side="right")) - 1 if end is None else _nearest("end", end, lags)
        if high < 1:
            raise NotRecordedError(
                f"diffusion needs at least {DIFFUSIVE_FRACTION} samples, or an end after the first lag; got {samples} "
                f"samples and end = {end}. Run longer, or give another end."
            )
        if start is None:
            return min(_nearest("start", lags[high] / 2, lags), high - 1), high
        low = _nearest("start", start, lags)
        if low >= high:
            raise InputError(
                f"start must be before end, by one gathered lag at least; got start = {start!r} and end = "
                f"{float(lags[high]):g}. Give an earlier start."
            )
        return low, high


def correlator(wave_numbers: Floats, points: int, levels: int) -> MultipleTau:
    """The correlator of samples of positions and velocities, shape (2, D, 2)."""

    def some(now: Floats, then: Floats) -> Floats:
        discs, k = now.shape[1], len(then)
        moved = now[0] - then[:, 0]
        squares = np.square(moved).reshape(k, -1).sum(axis=1) / discs
        products = (now[1] * then[:, 1]).reshape(k, -1).sum(axis=1) / discs
        waves = [np.cos(q * moved).reshape(k, -1).sum(axis=1) / (2 * discs) for q in wave_numbers.tolist()]
        return np.stack([squares, products, *waves], axis=1)

    def product(now: Floats, then: Floats) -> Floats:
        rows = max(CHUNK // now[0].size, 1)
        return np.concatenate([some(now, then[first : first + rows]) for first in range(0, len(then), rows)])

    def merge(first: Floats, second: Floats) -> Floats:
        return np.stack([second[0], (first[1] + second[1]) / 2])

    return MultipleTau(product, merge, 2 + len(wave_numbers), points, levels)


def _nearest(name: str, lag: float, lags: Floats) -> int:
    """Index of the gathered lag that is nearest, if `lag` is not beyond them."""
    checks.non_negative(name, lag, "[time]")
    if lag > lags[-1] * (1 + 1e-9):
        raise InputError(
            f"{name} must be a lag that the run has reached, at most {float(lags[-1]):g}; got {lag!r}. Run longer, or "
            "give an earlier one."
        )
    return int(np.abs(lags - lag).argmin())
