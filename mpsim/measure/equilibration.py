"""The start of the stationary part of a series, by the marginal standard error rule."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mpsim.core import checks
from mpsim.core.errors import InputError
from mpsim.measure.statistics import Measure, block_average

FEWEST_BATCHES = 10
"""Batches from which on the rule says something."""


@dataclass(frozen=True)
class Equilibration:
    """Where a series has come to its stationary state.

    Attributes:
        start: number of samples to leave out; the first one of the stationary part [1].
        found: False if the series is too short, or never becomes stationary.
        measure: mean of the stationary part, with its error [of the series]; not settled if it was not found.
    """

    start: int
    found: bool
    measure: Measure


def equilibration(series: ArrayLike, *, batch: int = 5) -> Equilibration:
    """Where to cut a series off, so that its mean is not biased by how it began.

    Of averages over batches of five samples, y_1 ... y_k, the first d are left out for which the sum of (y_i - mean)^2
    over the others, divided by (k - d)^2, is least: leaving out more of the transient makes the scatter smaller,
    leaving out more of the stationary part the number. It is not found if the least value is at half of the series, or
    if the rest is correlated over so long that the error of its mean is not settled: it may drift still.

    The rule looks at the series alone. It knows nothing of transients slower than the series, and of a metastable state
    it says that it is stationary.

    Args:
        series: shape (n,), n >= 10 batches, samples at equal intervals in time, from the start [any].
        batch: samples averaged first, >= 1; one that is short beside the correlation time changes little.

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
