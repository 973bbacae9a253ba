"""The multiple-tau scheme: correlations at lags from one sample to millions, in bounded memory, as samples arrive.

Level 0 keeps the last `points` samples and correlates each new one with all of them: lags 0, 1, ..., points - 1.
Level 1 gets every second sample, or two neighbours merged into one, and so on: level l has lags of k 2^l samples, with
k from points / 2 to points - 1. Lags are then spaced evenly on a logarithmic scale, and each doubling of the longest
one costs `points` samples of memory.

    level 0   o o o o o o o o o o o o o o o o      lags 0 1 2 3 4 5 6 7
    level 1    o   o   o   o   o   o   o   o               8  10  12  14
    level 2        o       o       o       o              16  20  24  28      (points = 8)

Sums of products are kept separately for parts of the run; errors follow from the scatter of the parts: see `BlockSums`.

Source: Ramirez, Sukumaran, Vorselaars & Likhtman, J. Chem. Phys. 133, 154103 (2010), with m = 2; from the hardware
correlators of light scattering (Schaetzel, 1985).
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.measure.statistics import FEWEST_BLOCKS, Measure, average_beside, energy_in_bath

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
