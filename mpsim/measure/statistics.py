"""Means with their standard errors, and stationary parts of series.

The mean of n samples has the variance S(0) / n, where S is the spectral density, S(0) the sum of all autocovariances:
positive of a slow quantity, negative of impulses on a wall, to which a disc returns only after it has crossed the box.
S is even in the frequency, so that near 0 it deviates from S(0) only quadratically; averages over blocks of length B
have an error of order 1/B.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mpsim.core import checks
from mpsim.core.checks import Floats
from mpsim.core.text import RELATIVE_ROUNDING, with_error
from mpsim.errors import InputError

# --- Error of the mean of a correlated series, from its spectrum at low frequencies

LEAST = 16
"""Smallest number of ordinates of the periodogram in a fit: S(0) is then known to 38 %, its root to 19 %."""

MOST = 128  # largest number: S(0) is then known to 13 %, its root to 7 %

CURVATURE_DEVIANCE = 6.0
"""Deviance by which a curve with one more parameter must fit better: by chance it does in one case of 70."""

AGREED = 3.0  # standard errors within which fits to fewer ordinates must agree with the chosen one


_SLOPES: Floats = np.concatenate([[0.0], np.geomspace(0.05, 5000.0, 27)])
_COARSE: Floats = np.concatenate([[0.0], np.geomspace(0.1, 5000.0, 15)])
"""Slopes to try, for one curve and for quotients of two."""


class AtZero(NamedTuple):
    """S(0), and the fit that it comes from.

    density: S(0) [of the series, squared]. slope: r of the curve S(0) / (1 + r u^2), or -r of S(0) exp(r u^2), with
    u = k / ordinates. ordinates: how many of them were used. correlation_time: the longest one found, as a fraction of
    the length of the series; 0 if S rises.
    """

    density: float
    slope: float
    ordinates: int
    correlation_time: float


def at_zero(series: Floats) -> AtZero:
    """Spectral density of a series, shape (n,), n >= 3, at frequency 0. Below 33 samples there are fewer ordinates.

    Ordinates I_k of the periodogram are independent and exponentially distributed with mean S(k / n). A curve is fitted
    to the first K of them by maximum likelihood: S(0) / (1 + r k^2), for an exponential correlation, or S(0) exp(r k^2)
    if S rises. K is the largest of 16, 32, 64, 128 at which the fit is good: a quotient (1 + r k^2) / (1 + s k^2) does
    not fit better by more than CURVATURE_DEVIANCE, and fits to fewer ordinates, with standard errors of 1.5 / sqrt(K)
    in log S(0), agree with it within AGREED. If a quotient fits better at any K, and falls (s > r), there is a slow
    component besides faster ones, such as white noise: its correlation time counts as well.

    Source: Heidelberger & Welch, Commun. ACM 24, 233 (1981), who fit a polynomial by least squares to the logarithms;
    the likelihood: Whittle, J. R. Stat. Soc. B 15, 125 (1953), as in CODA (Plummer et al., R News 6, 7, 2006).

    >>> found = at_zero(np.random.default_rng(0).normal(0, 2, 500))
    >>> round(found.density, 1), found.ordinates
    (4.0, 128)
    """
    n = len(series)
    periodogram = (np.abs(np.fft.rfft(series - series.mean())) ** 2 / n)[1 : (n - 1) // 2 + 1]
    if not periodogram[:LEAST].any():
        return AtZero(0.0, 0.0, min(LEAST, len(periodogram)), 0.0)
    found, bent, slowest = _fit(periodogram[:LEAST])
    fits = [found]
    while 2 * fits[-1].ordinates <= min(len(periodogram), MOST):
        fit, bent, slower = _fit(periodogram[: 2 * fits[-1].ordinates])
        fits.append(fit)
        slowest = max(slowest, slower)
        agreed = (
            abs(math.log(fit.density / each.density)) <= AGREED * 1.5 / math.sqrt(each.ordinates) for each in fits
        )
        if not bent and all(agreed):
            found = fit
    return found._replace(correlation_time=max(found.correlation_time, slowest))


def _fit(ordinates: Floats) -> tuple[AtZero, bool, float]:
    """The curve, whether a quotient fits better, and the correlation time of that one if it falls."""
    slopes, one, two = _curves(len(ordinates))
    densities, deviances = _likelihood(ordinates, one)
    best, slope = int(deviances.argmin()), float(slopes[deviances.argmin()])
    others = _likelihood(ordinates, two)[1]
    bent = bool(deviances[best] - others.min() > CURVATURE_DEVIANCE)
    rise, fall = (float(_COARSE[k]) for k in divmod(int(others.argmin()), len(_COARSE)))
    of_curve, of_quotient = (math.sqrt(max(each, 0.0)) / (2 * math.pi * len(ordinates)) for each in (slope, fall))
    found = AtZero(float(densities[best]), slope, len(ordinates), of_curve)
    return found, bent, of_quotient if bent and fall > rise else 0.0


@functools.cache
def _curves(ordinates: int) -> tuple[Floats, Floats, Floats]:
    """Slopes, and log S / S(0) at each ordinate, shape (slopes, ordinates), of the curves and of the quotients."""
    squares = (np.arange(1, ordinates + 1) / ordinates) ** 2
    rises = _SLOPES[(_SLOPES > 0) & (_SLOPES < 30)]
    slopes = np.concatenate([_SLOPES, -rises])
    one = np.concatenate([-np.log1p(_SLOPES[:, None] * squares), rises[:, None] * squares])
    half = np.log1p(_COARSE[:, None] * squares)
    return slopes, one, (half[:, None] - half[None]).reshape(-1, ordinates)


def _likelihood(ordinates: Floats, logs: Floats) -> tuple[Floats, Floats]:
    """For each curve the density at 0 of maximum likelihood, and -2 log likelihood there."""
    densities = (ordinates * np.exp(-logs)).mean(axis=1)
    return densities, 2 * (len(ordinates) * (np.log(densities) + 1) + logs.sum(axis=1))


# --- Means with their standard errors

FEWEST_BLOCKS = 16
"""Smallest number of samples or blocks for an error: with 16 it is itself known to 1/sqrt(30) = 18 %."""

MOST_BLOCKS = 1024
"""Longer series are averaged in pairs until they are shorter than this: only low frequencies matter for the error."""

MEMORIES = 30.0
"""Length of a series, in correlation times, from which on its error is known; also in periods of alternation."""

RISING = 4.0
"""Rise of log S over the least number of ordinates above which S(0) is too small a fraction of S to be resolved."""

BY_CHANCE = 1.5  # factor by which an error from a series, which is known to 20 %, may be too large by chance

FEWEST_EVENTS = 16
"""Number of events (samples that are not zero) from which on their scatter says more than their number; and number of
changes of a series from which on it may have shown its variation."""


@dataclass(frozen=True, repr=False)
class Measure:
    """A measured value with its standard error. Prints as 2.2399(16): 2.2399 with a standard error of 0.0016.

    Attributes:
        value: the mean [of the quantity].
        error: one standard error [of the quantity], >= 0; NaN if there were too few samples to know it.
        samples: number of samples of the mean.
        settled: False if the series was too short to know the error, which is then a lower bound, printed as 2.24(>16),
            or NaN, printed as 2.24(?).
        upper: True if an error that is not settled is an upper bound, as for a count of few events or none. It is
            printed as 0(<0.018).

    >>> Measure(2.23991, 0.00163, 24)
    2.2399(16)
    >>> Measure(0.0, 0.018, 100, settled=False, upper=True)
    0(<0.018)
    >>> round(Measure(2.23991, 0.00163, 24).deviation(2.2438), 3)
    -2.387
    """

    value: float
    error: float
    samples: int
    settled: bool = True
    upper: bool = False

    def deviation(self, expected: float) -> float:
        """(value - expected) / error: number of standard errors by which the value exceeds the expected one."""
        difference = self.value - expected
        if self.error == 0:
            return 0.0 if difference == 0 else math.copysign(math.inf, difference)
        return difference / self.error

    def __repr__(self) -> str:
        mark = "" if self.settled else "<" if self.upper else ">"
        return with_error(self.value, self.error, mark)

    def __float__(self) -> float:
        """The value alone."""
        return float(self.value)

    def __format__(self, spec: str) -> str:
        """The value alone in a format of numbers, such as f"{pressure:.3f}"; without one, as in `repr`."""
        return format(self.value, spec) if spec else repr(self)


class SlowVariable(NamedTuple):
    """A variable on which a series depends, and whose memory is known: the energy of a gas in a heat bath.

    values: along the series, at equal intervals, shape (k,) [any]. error: standard error of their mean. known: whether
    the series is long enough to know it.
    """

    values: Floats
    error: float
    known: bool


def energy_in_bath(values: Floats, memory: float, count: int) -> SlowVariable:
    """The energy of discs in a heat bath as a slow variable.

    In a run shorter than its memory it hardly changes, and its scatter says nothing. So the error is that of a
    canonical variance, mean^2 / N, with an exponential memory: that of the bath, or a longer one that shows. Where the
    error from the series is larger by more than chance, as of a gas that is not in equilibrium, it counts instead.
    memory: time in which the bath exchanges the energy, as a fraction of the run, > 0 [1]. values: at least
    FEWEST_BLOCKS.
    """
    memory = max(memory, at_zero(values).correlation_time)
    remembered = 2 * memory * (1 - memory * -math.expm1(-1 / memory))  # variance of the mean, over that of the variable
    error = abs(_mean(values)) * math.sqrt(max(remembered, 0.0) / max(count, 1))
    seen = block_average(values).error
    return SlowVariable(values, seen if seen > BY_CHANCE * error else error, memory * MEMORIES <= 1)


def block_average(
    series: ArrayLike, *, event: float | None = None, alternation: float = 0.0, constant: bool = False
) -> Measure:
    """Mean of a correlated series and its standard error, from the spectrum of averages over blocks.

    The spectral density S of averages over at most MOST_BLOCKS blocks is extrapolated to frequency 0, where S(0) /
    number is the variance of the mean. This includes positive correlations, for which block averages give too small
    errors, and negative ones, for which they give too large ones. The error is known to 7 to 19 %. It is not `settled`
    for series

    - of fewer than 33 samples, or shorter than MEMORIES correlation times, as seen from the fall of S. The error is the
      largest of `block_errors`, a lower bound. A slow component is seen only if it is large enough: with 0.3 of the
      amplitude of white noise, and a correlation time of a fifth of 2000 samples, in 94 % of the series; with 0.1, and
      a tenth, only in 31 %, and the errors of the others are too small by a factor of 1.9.
    - whose S rises steeply, or which are shorter than MEMORIES times `alternation`: too short to resolve S(0). The
      error is the last of `block_errors`, an upper bound.
    - with fewer than FEWEST_EVENTS samples that are not zero, such as counts of rare events: the error is that of a
      number of events k, (sqrt(k + 3/4) + 1) times one event, an upper bound; NaN if k = 0 and `event` is not known.
    - that change fewer than FEWEST_EVENTS times, such as a mean over discs that hardly collided: the error is the
      largest of `block_errors`, a lower bound; NaN if they never change, apart from rounding.

    Args:
        series: shape (n,), n >= 1, samples at equal intervals in time, without the initial transient [any].
            Fewer than FEWEST_BLOCKS give an error of NaN.
        event: contribution of one event to a sample, > 0 [of the series]; None: 1 for whole numbers and truth values.
            If the root mean square of the samples that are not zero is larger, it is used.
        alternation: number of samples after which an excess or deficit is known to be compensated, >= 0.
        constant: whether a series that never changes is settled, with the range of its rounding as error: such as the
            energy of an elastic gas, or if each sample counts events of its own.

    Raises:
        InputError: if the series is empty, not finite or not one-dimensional, `event` is not above 0, or `alternation`
            is below 0.

    Source: the spectrum (Heidelberger & Welch, Commun. ACM 24, 233, 1981); few events: Gehrels, Astrophys. J. 303,
    336 (1986), eq. 7 with S = 1, which is Garwood's limit (Biometrika 28, 437, 1936) within 1.5 %.

    >>> block_average(np.random.default_rng(1).normal(5, 1, 10_000))
    4.9891(93)
    >>> block_average(np.zeros(1000, int))
    0(<0.0019)
    >>> block_average(np.full(1000, 2.5)), block_average(np.full(1000, 2.5), constant=True)
    (2.5(?), 2.5(0))
    """
    if event is None and np.asarray(series).dtype.kind in "bui":
        event = 1.0
    samples = checks.finite_array("series", series, (None,), "(n,)")
    event = None if event is None else checks.positive("event", event, "[of the series]")
    alternation = checks.non_negative("alternation", alternation, "[1]")
    n = len(samples)
    _demand("series", n, 1, "sample")
    value = _mean(samples)
    if n < FEWEST_BLOCKS:
        return Measure(value, math.nan, n, settled=False)
    events = samples[samples != 0]
    if len(events) < FEWEST_EVENTS:
        return _of_few_events(value, events, n, event)
    if np.ptp(samples) <= RELATIVE_ROUNDING * abs(value):
        return Measure(value, float(np.ptp(samples)) if constant else math.nan, n, settled=constant)
    changes = np.abs(np.diff(samples)) > RELATIVE_ROUNDING * np.abs(samples).max()
    still = np.count_nonzero(changes) < FEWEST_EVENTS
    blocks = samples - value
    while len(blocks) >= MOST_BLOCKS:
        blocks = _pairs(blocks)
    found = at_zero(blocks)
    steep = found.ordinates == LEAST and -found.slope > RISING
    if not still and (steep or n < MEMORIES * alternation):
        return Measure(value, float(block_errors(samples)[-1]), n, settled=False, upper=True)
    short = still or found.ordinates < LEAST or found.correlation_time * MEMORIES > 1
    error = float(block_errors(samples).max()) if short else math.sqrt(found.density / len(blocks))
    return Measure(value, error, n, settled=not short)


def _of_few_events(value: float, events: Floats, n: int, event: float | None) -> Measure:
    """The mean of n samples of which only few, the given events, or none are not zero."""
    if not len(events) and event is None:
        return Measure(value, math.nan, n, settled=False)
    seen = math.sqrt(float((events**2).mean())) if len(events) else 0.0
    size = max(seen, event or 0.0)  # a bound: the few events may have been small ones
    return Measure(value, (math.sqrt(len(events) + 0.75) + 1) * size / n, n, settled=False, upper=True)


def _pairs(blocks: Floats) -> Floats:
    """Averages of neighbours; of an odd number the last one is dropped."""
    even = len(blocks) // 2 * 2
    return (blocks[0:even:2] + blocks[1:even:2]) / 2


def average_beside(
    slow: SlowVariable | None,
    series: NDArray[Any],
    *,
    event: float | None = None,
    alternation: float = 0.0,
    constant: bool = False,
) -> Measure:
    """`block_average` of a series that depends on a slow variable, if there is one.

    What follows the variable at low frequencies is subtracted. The error is that of the rest and that of the variable
    together, settled only if both are; otherwise it is no upper bound.
    """
    found = block_average(series, event=event, alternation=alternation, constant=constant and slow is None)
    n = len(series)
    if slow is None or n < FEWEST_BLOCKS or np.count_nonzero(series) < FEWEST_EVENTS or not np.ptp(series):
        return found if slow is None or slow.known else replace(found, settled=False, upper=False)
    k, blocks = len(slow.values), np.asarray(series, np.float64) - found.value
    values = slow.values if n == k else np.interp(np.arange(1, n + 1) / n, np.arange(1, k + 1) / k, slow.values)
    averages = values - _mean(values)
    while len(blocks) >= MOST_BLOCKS:
        blocks, averages = _pairs(blocks), _pairs(averages)
    ours, its = (np.fft.rfft(each)[1 : LEAST + 1] for each in (blocks, averages))
    power = float((np.abs(its) ** 2).sum())
    slope = float((ours * its.conj()).real.sum()) / power if power else 0.0
    doubt = float((np.abs(ours - slope * its) ** 2).sum()) / (2 * len(ours) - 1) / power if power else 0.0
    steepness = math.sqrt(slope**2 + doubt)  # in a short run the slope is hardly known
    blocks -= slope * averages
    if np.ptp(blocks) <= 1e-9 * np.ptp(series):  # nothing but the variable
        return replace(found, error=steepness * slow.error, settled=slow.known, upper=False)
    rest = block_average(blocks, alternation=alternation * len(blocks) / n)
    follows = steepness * slow.error
    upper = rest.upper and slow.known and follows < rest.error
    return replace(found, error=math.hypot(rest.error, follows), settled=rest.settled and slow.known, upper=upper)


def ratio_average(numerator: ArrayLike, denominator: ArrayLike) -> Measure:
    """Ratio of two sums and its standard error, such as a mean over a varying number of events.

    The residues a_k - R b_k of the ratio R are a series of mean 0, whose error over the mean of b is that of R.

    Args:
        numerator: a, shape (n,), samples at equal intervals in time [any].
        denominator: b, shape (n,), >= 0: numbers of events [1]. Without events the ratio is 0, and its error NaN.

    Returns:
        The ratio, with the number of events as `samples`. Not `settled` for fewer than FEWEST_EVENTS events.

    Raises:
        InputError: if the series are not finite, of different lengths or not one-dimensional.

    Source: Cochran, Sampling Techniques (Wiley 1977), eq. 6.3.

    >>> ratio_average([3.0, 2.0, 0.0] * 40, [2, 1, 0] * 40).value.__round__(3)
    1.667
    """
    upper = checks.finite_array("numerator", numerator, (None,), "(n,)")
    lower = checks.finite_array("denominator", denominator, (len(upper),), f"({len(upper)},)")
    events = round(float(lower.sum()))
    if not events:
        return Measure(0.0, math.nan, 0, settled=False)
    value = float(upper.sum()) / float(lower.sum())
    residues = block_average(upper - value * lower)
    settled = residues.settled and events >= FEWEST_EVENTS
    error = residues.error / float(lower.mean())
    return Measure(value, error, events, settled, residues.upper and not settled)


def block_errors(series: ArrayLike) -> Floats:
    """Standard errors of the mean from blocks of 1, 2, 4, ... samples: the curve whose plateau is the error.

    It ends at FEWEST_BLOCKS blocks. Each has a relative uncertainty of 1/sqrt(2 (blocks - 1)) (Flyvbjerg & Petersen
    1989, eq. 28).

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
    blocks = blocks - _mean(blocks) if len(blocks) else blocks  # so that small deviations keep their digits
    errors: list[float] = []
    while len(blocks) >= FEWEST_BLOCKS:
        errors.append(float(blocks.std(ddof=1)) / math.sqrt(len(blocks)))
        blocks = _pairs(blocks)
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


def _mean(samples: Floats) -> float:
    """Mean, accurate to the last digits even if all samples are nearly equal."""
    first = samples[0]
    return float(first + (samples - first).mean())


def _demand(name: str, count: int, fewest: int, what: str) -> None:
    if count < fewest:
        raise InputError(f"{name} must hold at least {fewest} {what}; got {count}. Record more of them.")


# --- The start of the stationary part of a series, by the marginal standard error rule

FEWEST_BATCHES = 10  # batches from which on the rule says something


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


def equilibration(series: ArrayLike, *, batch: int = 5) -> Equilibration:
    """Where to start averaging a series, so that its mean is not biased by the initial transient.

    The series is averaged over batches of five samples, y_1 ... y_k. The first d batches are left out, so that the sum
    of (y_i - mean)^2 over the others, divided by (k - d)^2, is least. The start is not found if the minimum is in the
    middle of the series, or if the error of the mean of the rest is not settled: the series may still be drifting. The
    rule cannot detect transients slower than the series, and it takes a metastable state for a stationary one.

    Args:
        series: shape (n,), n >= 10 batches, samples at equal intervals in time, from the start [any].
        batch: number of samples in a batch, >= 1.

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
        rule = f"hold at least {FEWEST_BATCHES} batches of {batch} samples to find its stationary part"
        got, instead = f"{len(samples)} samples", "Record more of them, or give a smaller batch."
        raise checks.refusal("series", rule, got, instead)
    values = samples[: number * batch].reshape(number, batch).mean(axis=1)
    half = number // 2
    shifted = values - values[half:].mean()  # so that a stationary part keeps its digits
    left = number - np.arange(half + 1)
    sums, squares = (np.cumsum(each[::-1])[::-1][: half + 1] for each in (shifted, shifted**2))
    scatter = np.maximum(squares - sums**2 / left, 0.0) / left**2
    first = int(scatter.argmin())
    rest = samples[first * batch :]
    measure = block_average(rest)
    found = first < len(scatter) - 1 and (measure.settled or not np.ptp(rest))
    return Equilibration(first * batch, found, measure if found else replace(measure, settled=False, upper=False))
