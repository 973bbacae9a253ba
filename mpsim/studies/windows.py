"""Errors of scenes that change with time: windows along the duration, and the stationary part, where there is one."""

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Runs = NDArray[np.float64]
"""A measure in each piece of each run, shape (runs, pieces)."""

WINDOWS = 8
"""Windows along the duration in which a changing scene is compared."""

TREND = 3.0
"""Standard errors that a trend, or the first piece, may show by chance in a series that is called stationary. Each is
looked for in some ten series of a scene, so that two would be too few."""

LATEST = 0.5
"""Fraction of the duration after which a stationary part is no longer what the scene is about."""

FEWEST = 4
"""Pieces of a stationary part, at least: fewer cannot show a trend."""

SEEN = 4.0
"""Standard errors by which something must exceed zero for an error to be a fraction of it: of what a few of many runs
have, the fraction would be that of these few."""

SAME = 1e-9
"""Relative scatter of runs below which they are one run: what is smaller is rounding, which has had time to grow."""


def steady_from(series: Runs, least: int = 0) -> int | None:
    """First piece of the longest stationary end of a series that is not 0, or None if none begins before LATEST.

    Stationary: over the runs, which are independent, neither the slope, nor the first piece against the others, nor the
    first half against the second differs from nothing by more than TREND of its standard errors (few runs: more).

    Args:
        series: shape (runs, pieces).
        least: first piece that may be taken.

    >>> noise = np.random.default_rng(1).normal(size=(16, 16))
    >>> steady_from(10 + noise), steady_from(10 + noise + np.arange(16)), steady_from(noise + 50 * (np.arange(16) < 3))
    (0, None, 3)
    """
    pieces = series.shape[1]
    for first in range(least, min(int(LATEST * pieces), pieces - FEWEST) + 1):
        rest = series[:, first:]
        if rest.any() and not any(abs(each) > quantile(TREND, len(series) - 1) for each in _contrasts(rest)):
            return first
    return None


def _contrasts(series: Runs) -> list[float]:
    """Slope, first piece, and first half of a series against nothing, in standard errors (of a normal one)."""
    pieces = series.shape[1]
    slope = np.arange(pieces) - (pieces - 1) / 2
    first = np.where(np.arange(pieces) == 0, 1.0, -1 / (pieces - 1))
    half = np.where(np.arange(pieces) < pieces // 2, 1 / (pieces // 2), -1 / (pieces - pieces // 2))
    found: list[float] = []
    for weights in (slope, first, half):
        each = series @ weights
        error = float(each.std(ddof=1)) / math.sqrt(len(each))
        mean = float(each.mean())
        rounding = SAME * float(np.abs(series).max(initial=0.0)) * float(np.abs(weights).sum())
        found.append(0.0 if abs(mean) <= rounding else mean / error if error else math.inf)
    return found


@dataclass(frozen=True)
class Spans:
    """Where along the duration errors are taken.

    Attributes:
        pieces: (first, end) of each span, in pieces.
        number: of pieces of the duration.
        stationary: whether it is one span in which nothing changes with time.
        steady: from which piece on nothing changes with time; None: from none on, or too late.
    """

    pieces: tuple[tuple[int, int], ...]
    number: int
    stationary: bool
    steady: int | None = None

    def mean(self, series: Runs) -> Runs:
        """Means over each span, shape (runs, spans)."""
        return np.stack([series[:, first:end].mean(axis=1) for first, end in self.pieces], axis=1)

    @property
    def ends(self) -> tuple[float, float]:
        """From where to where, as fractions of the duration."""
        return self.pieces[0][0] / self.number, self.pieces[-1][1] / self.number


def spans_of(series: Runs, least: int = 0, there: Runs | None = None) -> Spans:
    """One span where a series is stationary from `least` on, or else windows along its duration.

    A transient counts: what settles is wrong while it does, and how long that takes is a matter of noise. Windows are
    those in which there is something; where there is too little in every one for it to be seen, all of the duration.

    Args:
        series: shape (runs, pieces).
        least: first piece of a stationary end.
        there: what is not 0 in a window in which there is something, shape (runs, pieces); None: the series.
    """
    pieces = series.shape[1]
    steady = steady_from(series, least)
    if steady == least:
        return Spans(((least, pieces),), pieces, stationary=True, steady=steady)
    edges = np.unique(np.linspace(0, pieces, min(WINDOWS, pieces) + 1).astype(int)).tolist()
    windows = Spans(tuple(itertools.pairwise(edges)), pieces, stationary=False, steady=steady)
    seen = is_seen(windows.mean(series if there is None else there))
    chosen = tuple(span for span, there in zip(windows.pieces, seen, strict=True) if there)
    return replace(windows, pieces=chosen or ((0, pieces),))


def is_seen(means: Runs) -> NDArray[np.bool_]:
    """Whether the means of runs, shape (runs, ...), together are far enough from zero to be a unit."""
    return np.abs(means.mean(axis=0)) > SEEN * means.std(axis=0, ddof=1) / math.sqrt(len(means))


def alike(series: Runs) -> bool:
    """Whether all runs are one run, to rounding."""
    means = series.mean(axis=1)
    return bool(np.ptp(means) <= SAME * float(np.abs(means).max(initial=0.0)))


def quantile(normal: float, freedom: float) -> float:
    """Quantile of a t-distribution where that of a normal one is `normal` (Wallace 1959; too large, if anything)."""
    if math.isinf(freedom):
        return normal
    normal *= (8 * freedom + 3) / (8 * freedom + 1)
    return math.sqrt(freedom * math.expm1(normal**2 / freedom))
