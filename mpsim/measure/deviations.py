"""From runs to errors: how far a candidate's averages lie from the reference's, with standard errors."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.measure.statistics import Measure

RESOLVED = 3.0
"""Standard errors by which a difference must exceed zero to count as seen: a table holds hundreds of them, of which
two would let one in twenty through by chance."""

CERTAIN = 2.0
"""Standard errors that are added to an error when it is held against a budget."""

RELATIVE = ("pressure", "collision_rate")
"""Measures whose error is a part of the reference's value."""

ABSOLUTE = ("overlap", "largest_overlap", "momentum_drift")
"""Measures that are plain values, 0 in an exact run by definition; the others are differences from the reference."""


@dataclass(frozen=True)
class Deviation:
    """An error with its own standard error, both in the unit of the measure (see `tradeoff`).

    Attributes:
        value: the error.
        error: its standard error.
        freedom: degrees of freedom of the standard error, which few runs know badly: so many standard errors of a
            t-distribution count as RESOLVED, or CERTAIN, of a normal one.

    >>> Deviation(-0.0192, 0.0006), Deviation(0.0004, 0.0006)
    (-0.01920(60), not resolved: 0.00040(60))
    >>> Deviation(0.04, 0.01).resolved, Deviation(0.04, 0.01, freedom=7).resolved
    (True, False)
    """

    value: float
    error: float
    freedom: float = math.inf

    @property
    def resolved(self) -> bool:
        """Whether the difference is seen at all above the noise of both runs."""
        return abs(self.value) > _quantile(RESOLVED, self.freedom) * self.error

    @property
    def noise(self) -> float:
        """What the standard error leaves open: CERTAIN of them, more where few runs know it badly."""
        return _quantile(CERTAIN, self.freedom) * self.error

    @property
    def bound(self) -> float:
        """Size that the error has at most, noise included: what a budget is compared with."""
        return abs(self.value) + self.noise

    @property
    def shown(self) -> float:
        """Size that is claimed for the error: its own where it is resolved, else its bound."""
        return abs(self.value) if self.resolved else self.bound

    @property
    def least(self) -> float:
        """Size that an error has to come below to be seen as smaller: its own, or the noise that hides it."""
        return abs(self.value) if self.resolved else self.noise

    def __repr__(self) -> str:
        text = repr(Measure(self.value, self.error, 1))
        return text if self.resolved or not self.bound else f"not resolved: {text}"


def _quantile(normal: float, freedom: float) -> float:
    """Quantile of a t-distribution where that of a normal one is `normal` (Wallace 1959; too large, if anything)."""
    if math.isinf(freedom):
        return normal
    normal *= (8 * freedom + 3) / (8 * freedom + 1)
    return math.sqrt(freedom * math.expm1(normal**2 / freedom))


def deviations(
    found: Sequence[dict[str, Any]], reference: Sequence[dict[str, Any]], measures: Sequence[str]
) -> dict[str, Deviation]:
    """Errors of long runs for the named measures of replicas.LONG.

    Args:
        found, reference: what `replicas.long_run` gave, two of each at least.
        measures: names.
    """
    results = {}
    for name in measures:
        ours, theirs = (np.array([run[name] for run in runs], dtype=float) for runs in (found, reference))
        if name == "largest_overlap":
            results[name] = Deviation(float(ours.max()), float(ours.max(axis=1).std(ddof=1)), len(ours) - 1)
        elif name == "overlap":
            results[name] = _ratio(ours, np.array([run["met"] for run in found], dtype=float))
        elif name in ABSOLUTE:
            results[name] = _mean(ours)
        elif name == "speed_distribution":
            results[name] = _distance(ours, theirs)
        else:
            results[name] = _difference(ours, theirs, name in RELATIVE)
    return results


def short_deviations(found: Sequence[dict[str, Any]], measures: Sequence[str]) -> dict[str, Deviation]:
    """Errors of short runs for the named measures of replicas.SHORT, two runs at least."""
    results = {}
    if "trajectory" in measures:
        distances = np.array([run["trajectory"] for run in found])
        results["trajectory"] = _mean(distances[:, None])
    if "missed_collisions" in measures:
        met, exact = np.array([run["collisions"] for run in found], dtype=float).T
        total = exact.sum()
        missed = (exact - met) * len(found) / total if total else np.zeros(len(found))
        results["missed_collisions"] = _mean(missed[:, None])
    return results


def _mean(values: NDArray[np.float64]) -> Deviation:
    """The mean over replicas and pieces."""
    return Deviation(float(values.mean()), float(_error(values)), len(values) - 1)


def _error(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Standard error of the mean over replicas (axis 0) and pieces (axis 1), from the means of the replicas.

    Replicas are independent; pieces of one run are not. Taken as samples they gave 0.6 of the right error for the
    collision rate of a dense gas, whose structure changes slowly, and 2.9 times the right one for the pressure of a
    dilute gas, in which what hits a wall early does not hit it late.
    """
    means = values.mean(axis=1)
    return means.std(axis=0, ddof=1) / np.sqrt(len(means))


def _ratio(depths: NDArray[np.float64], met: NDArray[np.float64]) -> Deviation:
    """Mean depth of all pairs that were met: pieces count by their pairs, and those without any do not count."""
    total = met.sum()
    if not total:
        return Deviation(0.0, 0.0)
    value = float((depths * met).sum() / total)
    residues = ((depths - value) * met).sum(axis=1)
    return Deviation(value, float(residues.std(ddof=1) * math.sqrt(len(met)) / total), len(met) - 1)


CROSSED = math.sqrt(1 + 2 / math.pi)
"""What is added to the error of two halves that choose for each other: where one mode is all the noise, of amplitudes a
and b in the halves, sign(a) b and sign(b) a go together, E(|a| |b|) = 2/pi of a variance."""


def _distance(ours: NDArray[np.float64], theirs: NDArray[np.float64]) -> Deviation:
    """Largest difference of two distributions, of which axis 2 holds the levels.

    Half of the runs choose level and sign for the other half, and the other way round: the largest of many noisy
    differences is never 0, and twice its standard error in one of four tables without any difference.
    """
    halves = [ours[side::2].mean(axis=(0, 1)) - theirs[side::2].mean(axis=(0, 1)) for side in (0, 1)]
    levels = [int(np.abs(half).argmax()) for half in halves]
    value = sum(
        float(math.copysign(1.0, half[level]) * other[level])
        for half, other, level in zip(halves, halves[::-1], levels, strict=True)
    )
    parts = np.array([np.sqrt((_error(values)[levels] ** 2).mean()) for values in (ours, theirs)])
    return Deviation(value / 2, CROSSED * float(np.hypot(*parts)), _freedom(parts, ours, theirs))


def _difference(ours: NDArray[np.float64], theirs: NDArray[np.float64], relative: bool) -> Deviation:
    """Difference of two means, perhaps as a part of the second one."""
    difference = float(ours.mean() - theirs.mean())
    parts = np.array([_error(values) for values in (ours, theirs)])
    unit = abs(float(theirs.mean())) if relative else 1.0
    if unit == 0:
        return Deviation(0.0, 0.0) if difference == 0 else Deviation(math.inf, math.nan)
    return Deviation(difference / unit, float(np.hypot(*parts)) / unit, _freedom(parts, ours, theirs))


def _freedom(parts: NDArray[np.float64], *samples: NDArray[np.float64]) -> float:
    """Degrees of freedom of a difference of two means (Welch, Biometrika 34, 28, 1947)."""
    if not parts.any():
        return math.inf
    shares = (parts / parts.max()) ** 2
    return float(
        shares.sum() ** 2 / sum(share**2 / (len(each) - 1) for share, each in zip(shares, samples, strict=True))
    )
