"""Error of the mean of a correlated series, from its spectrum at low frequencies.

The mean of n samples has the variance S(0) / n, where S is the spectral density, S(0) the sum of all autocovariances.
Whether these are positive (a slow quantity) or negative (impulses on a wall: a disc that has just hit one comes back
only after it has crossed the box) makes no difference here, as it does for blocks: S is even in the frequency, and
differs from S(0) only by its square, where averages over blocks of length B differ by 1/B.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

LEAST = 16
"""Ordinates of the periodogram to which a curve is fitted, at least: S(0) is then known to 38 %, its root to 19 %."""

MOST = 128
"""And at most: then it is known to 13 %, its root to 7 %."""

BENT = 3.0
"""Deviance by which a term of fourth order must improve the fit to count: it does so by chance in one case of 12."""

AGREED = 2.5
"""Standard errors within which fits to fewer ordinates must agree with the one that is taken."""


class AtZero(NamedTuple):
    """S(0), and from what.

    Attributes:
        density: S(0) [of the series, squared].
        slope: change of log S from frequency 0 to the highest ordinate that was used.
        ordinates: how many were used.
    """

    density: float
    slope: float
    ordinates: int


def at_zero(series: NDArray[np.float64]) -> AtZero:
    """Spectral density of a series at frequency 0.

    Ordinates I_k of the periodogram are independent and exponentially distributed about S(k / n). The curve
    log S = c0 + c1 k^2 is fitted to the first K of them by its likelihood. K is the largest of 16, 32, 64, 128 to which
    it fits: a term c2 k^4 does not improve it by more than BENT, and fits to fewer ordinates, of variance 9 / (4 K) in
    log S(0), agree with it within AGREED.

    Args:
        series: shape (n,), n >= 3 [any]. Fewer than 2 LEAST + 1 samples have fewer than LEAST ordinates.

    Source: Heidelberger & Welch, Commun. ACM 24, 233 (1981); likelihood in place of least squares: Whittle, J. R. Stat.
    Soc. B 15, 125 (1953), as in CODA (Plummer, Best, Cowles & Vines, R News 6, 7, 2006).

    >>> found = at_zero(np.random.default_rng(0).normal(0, 2, 500))
    >>> round(found.density, 1), found.ordinates
    (4.0, 128)
    """
    n = len(series)
    periodogram = (np.abs(np.fft.rfft(series - series.mean())) ** 2 / n)[1 : (n - 1) // 2 + 1]
    found = AtZero(*_fit(periodogram[:LEAST], 1)[0], min(LEAST, len(periodogram)))
    if found.density == 0:
        return found
    fits = [found]
    while 2 * fits[-1].ordinates <= min(len(periodogram), MOST):
        used = 2 * fits[-1].ordinates
        curve, deviance = _fit(periodogram[:used], 1)
        fits.append(AtZero(*curve, used))
        if deviance - _fit(periodogram[:used], 2)[1] <= BENT and all(map(_agrees(fits[-1]), fits)):
            found = fits[-1]
    return found


def _agrees(fit: AtZero) -> Callable[[AtZero], bool]:
    """Whether another fit, to fewer ordinates, gives the same density within its own error."""
    return lambda other: abs(math.log(fit.density / other.density)) <= AGREED * 1.5 / math.sqrt(other.ordinates)


def _fit(ordinates: NDArray[np.float64], degree: int) -> tuple[tuple[float, float], float]:
    """Value at 0 and slope of a curve log S = polynomial in k^2, and its deviance: Fisher's scoring, damped."""
    mean = float(ordinates.mean())
    if mean == 0:
        return (0.0, 0.0), 0.0
    scaled = ordinates / mean
    powers = ((np.arange(1, len(scaled) + 1) / len(scaled))[:, None] ** 2) ** np.arange(degree + 1)
    inverse = np.linalg.pinv(powers.T @ powers)
    curve = np.zeros(degree + 1)
    for _ in range(50):
        step = inverse @ (powers.T @ (scaled * np.exp(-np.clip(powers @ curve, -40, 40)) - 1))
        longest = float(np.abs(step).max())
        curve += step * min(1.0, 2 / max(longest, 1e-12))
        if longest < 1e-8:
            break
    logs = np.clip(powers @ curve, -40, 40)
    deviance = 2 * float((logs + scaled * np.exp(-logs)).sum())
    return (mean * float(np.exp(np.clip(curve[0], -40, 40))), float(curve[1])), deviance
