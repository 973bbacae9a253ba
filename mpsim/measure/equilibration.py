"""The start of the stationary part of a series, by the marginal standard error rule."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mpsim.core import checks
from mpsim.errors import InputError
from mpsim.measure.statistics import Measure, block_average

FEWEST_BATCHES = 10
"""Batches from which on the rule says something."""


@dataclass(frozen=True)
class Equilibration:
    """Where the stationary part of a series begins.

    Attributes:
        start: number of samples to leave out, which is the index of the first stationary one [1].
        found: False if the series is too short, or never becomes stationary.
        measure: mean of the stationary part, with its error [of the series]; not settled if no stationary part was
            found.
    """

    start: int
    found: bool
    measure: Measure


@checks.known_names()
def equilibration(series: ArrayLike, *, batch: int = 5) -> Equilibration:
    """Where to start averaging a series, so that its mean is not biased by the initial transient.

    The series is averaged over batches of five samples, y_1 ... y_k, and the first d batches are left out. The d is
    chosen that minimizes the sum of (y_i - mean)^2 over the other batches, divided by (k - d)^2. Leaving out more of
    the transient reduces the scatter; leaving out more of the stationary part reduces only the number of batches. The
    start is not found if the minimum is in the middle of the series, or if the rest is correlated over so long a time
    that the error of its mean is not settled: the series may still be drifting.

    The rule sees only the series. It cannot detect transients slower than the series, and it takes a metastable state
    for a stationary one.

    Args:
        series: shape (n,), n >= 10 batches, samples at equal intervals in time, from the start [any].
        batch: number of samples in a batch, >= 1; it matters little if a batch is short compared with the correlation
            time.

    Raises:
        InputError: if the series is not finite, not one-dimensional or too short, or batch is out of range.

    Source: White, Simulation 69, 323 (1997); with batches of five, MSER-5: White, Cobb & Spratt, Proc. Winter
    Simulation Conference (2000), 755.

    >>> noise = np.random.default_rng(1).normal(size=2000)
    >>> found = equilibration(5 + noise + 20 * np.exp(-np.arange(2000) / 50))
    >>> found.start, found.found, found.measure
    (185, True, 5.004(24))
    """
    samples = checks.finite_array("series", series, (None,), "(n,)")
    batch = checks.whole("batch", batch, 1, 10**9, "5 is usual.")
    number = len(samples) // batch
    if number < FEWEST_BATCHES:
        raise InputError(
            f"series must hold at least {FEWEST_BATCHES} batches of {batch} samples to find its stationary part; got "
            f"{len(samples)} samples. Record more of them, or give a smaller batch."
        )
    scatter = marginal_errors(samples[: number * batch].reshape(number, batch).mean(axis=1))
    first = int(scatter.argmin())
    rest = samples[first * batch :]
    measure = block_average(rest)
    found = first < len(scatter) - 1 and (measure.settled or not np.ptp(rest))
    return Equilibration(first * batch, found, measure if found else replace(measure, settled=False, upper=False))


def marginal_errors(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """For d = 0, 1, ..., k/2: sum of (y_i - mean)^2 over all but the first d values, over (k - d)^2 [of y, squared].

    >>> marginal_errors(np.array([9.0, 1.0, 1.0, 1.0])).tolist()
    [3.0, 0.0, 0.0]
    """
    number, half = len(values), len(values) // 2
    shifted = values - values[half:].mean()  # so that a stationary part keeps its digits
    left = number - np.arange(half + 1)
    sums, squares = (np.cumsum(each[::-1])[::-1][: half + 1] for each in (shifted, shifted**2))
    return np.maximum(squares - sums**2 / left, 0.0) / left**2
