"""Means with their standard errors, from correlated and from independent samples, and fitted orders of accuracy."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mpsim import checks
from mpsim.errors import InputError

FEWEST_BLOCKS = 16
"""No error comes from fewer blocks: with 16 it is itself known to 1/sqrt(30) = 18 %, with fewer it is a guess."""


@dataclass(frozen=True, repr=False)
class Measure:
    """A measured value with its standard error. Prints as 2.2399(16): 2.2399 with a standard error of 0.0016.

    Attributes:
        value: the mean [of the quantity].
        error: one standard error [of the quantity], >= 0; NaN where there were too few samples to know it.
        samples: how many samples the value is the mean of.
        settled: False where the series was too short for the error to reach its plateau: the error is then a lower
            bound, and prints as 2.24(>16).

    >>> Measure(2.23991, 0.00163, 24)
    2.2399(16)
    >>> round(Measure(2.23991, 0.00163, 24).deviation(2.2438), 3)
    -2.387
    """

    value: float
    error: float
    samples: int
    settled: bool = True

    def deviation(self, expected: float) -> float:
        """(value - expected) / error: how many standard errors the value lies above what was expected."""
        difference = self.value - expected
        if self.error == 0:
            return 0.0 if difference == 0 else math.copysign(math.inf, difference)
        return difference / self.error

    def __repr__(self) -> str:
        mark = "" if self.settled else ">"
        if not (math.isfinite(self.value) and math.isfinite(self.error)):
            return f"{self.value:.6g}(?)" if math.isnan(self.error) else f"{self.value:.6g}({mark}{self.error:.2g})"
        if self.error == 0:
            return f"{self.value:.12g}({mark}0)"
        power = math.floor(math.log10(max(abs(self.value), self.error)))
        power = power if not -4 <= power < 7 else 0
        scale = 10.0**power
        text = _parenthesis(self.value / scale, self.error / scale, mark)
        return text if power == 0 else f"{text}e{power:+03d}"


def _parenthesis(value: float, error: float, mark: str) -> str:
    """value(error), the error with two digits in units of the value's last one; from 1 on, with its own point."""
    decimals = max(1 - int(f"{error:.1e}".split("e")[1]), 0)
    rounded = f"{error:.{decimals}f}"
    digits = rounded if float(rounded) >= 1 else rounded.replace("0.", "", 1).lstrip("0")
    return f"{value:.{decimals}f}({mark}{digits})"


def block_average(series: ArrayLike) -> Measure:
    """Mean of a correlated series and its standard error, by the blocking method.

    Neighbours are averaged in pairs, again and again; s_k = standard deviation / sqrt(number) of the averages over
    blocks of B = 2^k samples grows with B until blocks are longer than the correlation, then stays on a plateau. The
    block taken is the shortest with B^3 > 2 n (s_k / s_0)^4, where what correlation still hides is about as large as
    the scatter of s_k itself. Blocks are never fewer than FEWEST_BLOCKS; where none of those is long enough, the
    largest s_k is given and the measure is not `settled`. So fewer than 256 samples never settle: they cannot tell
    that they are not correlated. Samples left over by the pairing, 1 in 16 at most, count in the mean only.

    Args:
        series: shape (n,), n >= 1, samples at equal distances in time, after the start has been forgotten [any].
            Fewer than FEWEST_BLOCKS give an error of NaN.

    Raises:
        InputError: if the series is empty, not finite or not one-dimensional.

    Source: Flyvbjerg & Petersen, J. Chem. Phys. 91, 461 (1989), eqs. 20-28; length of the blocks: Wolff, Comput. Phys.
    Commun. 156, 143 (2004), and Lee, Mella & Rappe, J. Chem. Phys. 134, 244103 (2011).

    >>> block_average(np.random.default_rng(1).normal(5, 1, 10_000))
    4.9891(97)
    """
    samples = checks.finite_array("series", series, (None,), "(n,)")
    _demand("series", len(samples), 1, "sample")
    value, errors = _mean(samples), block_errors(samples)
    if len(errors) == 0:
        return Measure(value, math.nan, len(samples), settled=False)
    if errors[0] == 0:
        return Measure(value, 0.0, len(samples), settled=len(samples) >= FEWEST_BLOCKS**2)
    lengths = 2.0 ** np.arange(len(errors))
    long_enough = np.flatnonzero(lengths**3 > 2 * len(samples) * (errors / errors[0]) ** 4)
    if len(long_enough):
        return Measure(value, float(errors[long_enough[0]]), len(samples))
    return Measure(value, float(errors.max()), len(samples), settled=False)


def block_errors(series: ArrayLike) -> NDArray[np.float64]:
    """Standard errors of the mean from blocks of 1, 2, 4, ... samples: the curve whose plateau is the error.

    It ends at FEWEST_BLOCKS blocks. Each is known to the fraction 1/sqrt(2 (blocks - 1)) (Flyvbjerg & Petersen 1989,
    eq. 28).

    Args:
        series: shape (n,) [any].

    Returns:
        Shape (levels,), empty for n < FEWEST_BLOCKS [of the series].

    Raises:
        InputError: if the series is not finite or not one-dimensional.

    >>> block_errors([0.0, 1.0] * 16).round(3).tolist()
    [0.09, 0.0]
    """
    blocks = checks.finite_array("series", series, (None,), "(n,)")
    blocks = blocks - _mean(blocks) if len(blocks) else blocks  # small deviations keep their digits
    errors: list[float] = []
    while len(blocks) >= FEWEST_BLOCKS:
        errors.append(float(blocks.std(ddof=1)) / math.sqrt(len(blocks)))
        even = len(blocks) // 2 * 2
        blocks = (blocks[0:even:2] + blocks[1:even:2]) / 2
    return np.array(errors)


def independent_average(values: ArrayLike) -> Measure:
    """Mean of independent values, such as one per random start, with standard error: deviation / sqrt(number).

    Args:
        values: shape (n,), n >= 2 [any].

    Raises:
        InputError: if there are fewer than two values, or they are not finite.

    >>> independent_average([1.0, 2.0, 3.0, 4.0])
    2.50(65)
    """
    samples = checks.finite_array("values", values, (None,), "(n,)")
    _demand("values", len(samples), 2, "independent values")
    value = _mean(samples)
    return Measure(value, float((samples - value).std(ddof=1)) / math.sqrt(len(samples)), len(samples))


def fit_order(h: ArrayLike, bias: ArrayLike, errors: ArrayLike | None = None) -> Measure:
    """Order p of a bias that falls like h^p, by a weighted straight line through log|bias| against log h.

    Args:
        h: shape (k,), k >= 2, step lengths, > 0, at least two different ones [any].
        bias: shape (k,), measured minus exact at each step, all of one sign, none 0 [any].
        errors: shape (k,), one standard error of each bias, > 0, that of the exact value included [of bias]. None:
            all logarithms weigh the same, and at least three points are needed.

    Returns:
        The order, its standard error and k. The error is that of the weights, times the root of chi^2 per degree of
        freedom where that is above 1 (Birge, Phys. Rev. 40, 207, 1932): points off the line, such as those of a step
        too long for the leading order, count as noise. Without `errors`, it is that of the scatter alone.

    Raises:
        InputError: naming the argument and its rule.

    >>> fit_order([0.1, 0.05, 0.02, 0.01], [-0.107, -0.054, -0.022, -0.012], [0.001] * 4)
    0.976(19)
    """
    steps = checks.finite_array("h", h, (None,), "(k,)")
    differences = checks.finite_array("bias", bias, (len(steps),), f"({len(steps)},), one per step length")
    _demand("h", len(steps), 2 if errors is not None else 3, "step lengths")
    if (steps <= 0).any() or len(set(steps.tolist())) == 1:
        raise InputError(f"h must be > 0 and not all equal; got {steps.tolist()}. Measure at two step lengths or more.")
    if len(set(np.sign(differences).tolist())) > 1 or (differences == 0).any():
        raise InputError(
            f"bias must be of one sign and nowhere 0; got {differences.tolist()}. A sign that changes means that noise "
            "or another error is as large: leave out those steps, or run longer."
        )
    weights = np.ones(len(steps))
    if errors is not None:
        deviations = checks.finite_array("errors", errors, (len(steps),), f"({len(steps)},), one per step length")
        if (deviations <= 0).any():
            raise InputError(f"errors must be > 0; got {deviations.tolist()}. Give the standard error of each bias.")
        weights = (differences / deviations) ** 2
    x, y = np.log(steps), np.log(np.abs(differences))
    x, y = x - np.average(x, weights=weights), y - np.average(y, weights=weights)
    spread = float((weights * x**2).sum())
    order = float((weights * x * y).sum()) / spread
    freedom = len(steps) - 2
    scatter = float((weights * (y - order * x) ** 2).sum()) / freedom if freedom else 0.0
    inflation = scatter if errors is None else max(1.0, scatter)
    return Measure(order, math.sqrt(inflation / spread), len(steps))


def _mean(samples: NDArray[np.float64]) -> float:
    """Mean, to the last digits also where all samples are nearly equal."""
    first = samples[0]
    return float(first + (samples - first).mean())


def _demand(name: str, count: int, fewest: int, what: str) -> None:
    if count < fewest:
        raise InputError(f"{name} must hold at least {fewest} {what}; got {count}. Record more of them.")
