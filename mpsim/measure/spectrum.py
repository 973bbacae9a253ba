"""Error of the mean of a correlated series, from its spectrum at low frequencies.

The mean of n samples has the variance S(0) / n, where S is the spectral density, S(0) the sum of all autocovariances.
These may be positive (a slow quantity) or negative (impulses on a wall: a disc that has just hit one returns only after
it has crossed the box). S is even in the frequency, so that near 0 it deviates from S(0) only quadratically; averages
over blocks of length B have an error of order 1/B.
"""

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

LEAST = 16
"""Smallest number of ordinates of the periodogram in a fit: S(0) is then known to 38 %, its root to 19 %."""

MOST = 128
"""Largest number: S(0) is then known to 13 %, its root to 7 %."""

CURVATURE_DEVIANCE = 6.0
"""Deviance by which a curve with one more parameter must fit better: by chance it does in one case of 70."""

AGREED = 3.0
"""Standard errors within which fits to fewer ordinates must agree with the chosen one."""


_SLOPES: NDArray[np.float64] = np.concatenate([[0.0], np.geomspace(0.05, 5000.0, 27)])
_COARSE: NDArray[np.float64] = np.concatenate([[0.0], np.geomspace(0.1, 5000.0, 15)])
"""Slopes to try, for one curve and for quotients of two."""


@dataclass(frozen=True)
class AtZero:
    """S(0), and the fit that it comes from.

    Attributes:
        density: S(0) [of the series, squared].
        slope: r of the curve S(0) / (1 + r u^2), or -r of S(0) exp(r u^2), with u = k / ordinates.
        ordinates: number of ordinates used.
        slower: correlation time of a slow component below faster ones, as a fraction of the length of the series; 0
            if there is none.
    """

    density: float
    slope: float
    ordinates: int
    slower: float = 0.0

    @property
    def correlation_time(self) -> float:
        """Longest correlation time found, as a fraction of the length of the series; 0 if S rises."""
        return max(_correlation_time(self.slope, self.ordinates), self.slower)


def _correlation_time(slope: float, ordinates: int) -> float:
    """Correlation time whose spectrum falls with this slope, as a fraction of the length of the series."""
    return math.sqrt(max(slope, 0.0)) / (2 * math.pi * ordinates)


def at_zero(series: NDArray[np.float64]) -> AtZero:
    """Spectral density of a series at frequency 0.

    Ordinates I_k of the periodogram are independent and exponentially distributed with mean S(k / n). A curve is fitted
    to the first K of them by maximum likelihood: S(0) / (1 + r k^2), for an exponential correlation, or S(0) exp(r k^2)
    if S rises. K is the largest of 16, 32, 64, 128 at which the fit is good: a quotient (1 + r k^2) / (1 + s k^2) does
    not fit better by more than CURVATURE_DEVIANCE, and fits to fewer ordinates, with standard errors of 1.5 / sqrt(K)
    in log S(0), agree with it within AGREED. If a quotient fits better at any K, and falls (s > r), there is a slow
    component besides faster ones, such as white noise: its correlation time counts as well.

    Args:
        series: shape (n,), n >= 3 [any]. Fewer than 2 LEAST + 1 samples have fewer than LEAST ordinates.

    Source: Heidelberger & Welch, Commun. ACM 24, 233 (1981), who fit a polynomial by least squares to the logarithms;
    the likelihood: Whittle, J. R. Stat. Soc. B 15, 125 (1953), as in CODA (Plummer et al., R News 6, 7, 2006).

    >>> found = at_zero(np.random.default_rng(0).normal(0, 2, 500))
    >>> round(found.density, 1), found.ordinates
    (4.0, 128)
    """
    n = len(series)
    periodogram = (np.abs(np.fft.rfft(series - series.mean())) ** 2 / n)[1 : (n - 1) // 2 + 1]
    if not periodogram[:LEAST].any():
        return AtZero(0.0, 0.0, min(LEAST, len(periodogram)))
    found, bent, slower = _fit(periodogram[:LEAST])
    fits, slowest = [found], slower if bent > CURVATURE_DEVIANCE else 0.0
    while 2 * fits[-1].ordinates <= min(len(periodogram), MOST):
        fit, bent, slower = _fit(periodogram[: 2 * fits[-1].ordinates])
        fits.append(fit)
        if bent > CURVATURE_DEVIANCE:
            slowest = max(slowest, slower)
        elif all(map(_agrees(fit), fits)):
            found = fit
    return replace(found, slower=slowest)


def _agrees(fit: AtZero) -> Callable[[AtZero], bool]:
    """A test whether another fit, to fewer ordinates, gives the same density within its error."""
    return lambda other: abs(math.log(fit.density / other.density)) <= AGREED * 1.5 / math.sqrt(other.ordinates)


def _fit(ordinates: NDArray[np.float64]) -> tuple[AtZero, float, float]:
    """The curve, the deviance by which a quotient fits better, and the correlation time of a falling quotient."""
    slopes, one, two = _curves(len(ordinates))
    densities, deviances = _likelihood(ordinates, one)
    best = int(deviances.argmin())
    found = AtZero(float(densities[best]), float(slopes[best]), len(ordinates))
    bent = _likelihood(ordinates, two)[1]
    rise, fall = (float(_COARSE[k]) for k in divmod(int(bent.argmin()), len(_COARSE)))
    return found, float(deviances[best] - bent.min()), _correlation_time(fall if fall > rise else 0.0, len(ordinates))


@functools.cache
def _curves(ordinates: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Slopes, and log S / S(0) at each ordinate, shape (slopes, ordinates), of the curves and of the quotients."""
    squares = (np.arange(1, ordinates + 1) / ordinates) ** 2
    rises = _SLOPES[(_SLOPES > 0) & (_SLOPES < 30)]
    slopes = np.concatenate([_SLOPES, -rises])
    one = np.concatenate([-np.log1p(_SLOPES[:, None] * squares), rises[:, None] * squares])
    half = np.log1p(_COARSE[:, None] * squares)
    return slopes, one, (half[:, None] - half[None]).reshape(-1, ordinates)


def _likelihood(ordinates: NDArray[np.float64], logs: NDArray[np.float64]) -> tuple[NDArray, NDArray]:
    """For each curve the density at 0 of maximum likelihood, and -2 log likelihood there."""
    densities = (ordinates * np.exp(-logs)).mean(axis=1)
    return densities, 2 * (len(ordinates) * (np.log(densities) + 1) + logs.sum(axis=1))
