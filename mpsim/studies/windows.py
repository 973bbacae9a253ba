"""Scenes that change with time: windows along the duration, and the stationary state, if there is one."""

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Runs = NDArray[np.float64]
"""A measure in each piece of each run, shape (runs, pieces)."""

WINDOWS = 8
"""Number of windows along the duration in which a changing scene is compared."""

TREND = 3.0
"""Largest trend of a stationary series, in standard errors. About ten series of a scene are tested, so that two would
be too few."""

LATEST = 0.5
"""Latest start of a stationary state, as a fraction of the duration: a later one does not represent the scene."""

FEWEST = 4
"""Smallest number of pieces of a stationary state: fewer cannot show a trend."""

SEEN = 4.0
"""Standard errors by which a mean must exceed zero to be the unit of a relative error: else a few of the runs would
dominate it."""

SAME = 1e-9
"""Relative scatter below which runs count as equal: smaller differences are rounding errors that have grown."""


def steady_from(series: Runs, least: int = 0) -> int | None:
    """First piece from which on a series is stationary and not 0, or None if there is none before LATEST.

    Stationary: over the independent runs neither the slope, nor the first piece against the others, nor the first half
    against the second differs from 0 by more than TREND standard errors (more for few runs).

    Args:
        series: shape (runs, pieces).
        least: first piece to consider.

    >>> noise = np.random.default_rng(1).normal(size=(16, 16))
    >>> steady_from(10 + noise), steady_from(10 + noise + np.arange(16)), steady_from(noise + 50 * (np.arange(16) < 3))
    (0, None, 3)
    """
    pieces = series.shape[1]
    for first in range(least, min(int(LATEST * pieces), pieces - FEWEST) + 1):
        rest = series[:, first:]
        if rest.any() and not any(abs(each) > t_from_z(TREND, len(series) - 1) for each in _contrasts(rest)):
            return first
    return None


def _contrasts(series: Runs) -> list[float]:
    """Slope, first piece minus the others, and first half minus second half of a series, in standard errors."""
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
    """Time spans in which errors are taken.

    Attributes:
        pieces: (first, end) of each span, in pieces.
        number: of pieces of the duration.
        stationary: whether it is a single span in which nothing changes with time.
        steady: piece from which on nothing changes with time; None if there is none, or too late.
    """

    pieces: tuple[tuple[int, int], ...]
    number: int
    stationary: bool
    steady: int | None = None

    def mean(self, series: Runs) -> Runs:
        """Mean over each span, shape (runs, spans)."""
        return np.stack([series[:, first:end].mean(axis=1) for first, end in self.pieces], axis=1)

    @property
    def ends(self) -> tuple[float, float]:
        """Start and end of all spans together, as fractions of the duration."""
        return self.pieces[0][0] / self.number, self.pieces[-1][1] / self.number


def spans_of(series: Runs, least: int = 0, there: Runs | None = None) -> Spans:
    """One span if a series is stationary from `least` on, or else windows along its duration.

    A later stationary state does not make it one span: errors of the transient count, and its length depends on noise.
    Windows without a significant signal are left out; if none has one, the whole duration is taken.

    Args:
        series: shape (runs, pieces).
        least: first piece that may be stationary.
        there: the signal that each window must have, shape (runs, pieces); None: the series.
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
    """Whether the mean over runs, shape (runs, ...), is far enough from zero to be a unit."""
    return np.abs(means.mean(axis=0)) > SEEN * means.std(axis=0, ddof=1) / math.sqrt(len(means))


def alike(series: Runs) -> bool:
    """Whether all runs are equal, to rounding."""
    means = series.mean(axis=1)
    return bool(np.ptp(means) <= SAME * float(np.abs(means).max(initial=0.0)))


def t_from_z(z: float, freedom: float) -> float:
    """Quantile of a t-distribution with so many degrees of freedom at the level of a standard normal quantile z.

    Source: Wallace, Ann. Math. Stat. 30, 1121 (1959); if anything too large.
    """
    if math.isinf(freedom):
        return z
    z *= (8 * freedom + 3) / (8 * freedom + 1)
    return math.sqrt(freedom * math.expm1(z**2 / freedom))
