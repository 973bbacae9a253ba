"""The time for which two correct runs of a scene agree, and the check that comparisons are not longer.

Hard discs are chaotic: a difference between two runs, even a single rounding, grows on average as exp(lambda t), where
lambda is the largest Lyapunov exponent. Beyond a horizon the distance between two trajectories is meaningless.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mpsim.core import checks
from mpsim.errors import InputError
from mpsim.measure.statistics import Measure, block_average

AGREEMENT = 20.0
"""Two correct float64 solvers agree for about this many Lyapunov times 1/lambda [1]: at packing 0.3, where lambda =
2.9, for 7 time units. More would need digits that rounding has destroyed, less would waste valid ones."""

ASSERTED = 0.5
"""Fraction of that time up to which a comparison is allowed [1]; the rest is margin for growth above the average."""


@dataclass(frozen=True)
class Predictability:
    """Divergence of two trajectories.

    Attributes:
        rate: largest Lyapunov exponent lambda, with its standard error [1/time].
        lyapunov_time: 1/lambda, in which a difference grows by a factor of e [time].
        horizon: about how long two correct float64 solvers agree, AGREEMENT/lambda [time].
        comparable_until: latest time at which a comparison is allowed, ASSERTED x horizon [time].
    """

    rate: Measure
    lyapunov_time: float
    horizon: float
    comparable_until: float


def predictability(time: ArrayLike, distance: ArrayLike, *, lowest: float = 0.0, highest: float) -> Predictability:
    """Largest Lyapunov exponent and horizon from the distance between two runs whose starts differ a little.

    lambda is the mean growth of log(distance) per time from the first sample at or above `lowest` to the last one
    before the distance first passes `highest`; its error is the block average over the steps. Growth over a finite
    window depends on where the difference starts: average several starts for the exponent itself. Use the exact solver
    for both runs: `contact="push"` erases the difference along the line of centres at each contact.

    Args:
        time: shape (n,), n >= 3, rising in equal steps [time].
        distance: shape (n,), between the two runs at these times, >= 0, such as `trajectory_error(...).rms` [length].
        lowest: growth below this distance, of roundings or a transient, is ignored; >= 0 [length].
        highest: distance above which growth is no longer linear, about 1/1000 diameter; > lowest [length].

    Raises:
        InputError: naming the argument and its rule; if fewer than two steps lie in between, or nothing grew.

    Source: Benettin, Galgani & Strelcyn, Phys. Rev. A 14, 2338 (1976), eq. 6; hard discs: Dellago, Posch & Hoover,
    Phys. Rev. E 53, 1485 (1996).

    >>> time = np.linspace(0, 5, 51)
    >>> found = predictability(time, 1e-12 * np.exp(2 * time), highest=1e-3)
    >>> round(found.rate.value, 9), round(found.lyapunov_time, 9), round(found.comparable_until, 9)
    (2.0, 0.5, 5.0)
    """
    times = checks.finite_array("time", time, (None,), "(n,)")
    distances = checks.finite_array("distance", distance, (len(times),), f"({len(times)},), one per time")
    lowest = checks.non_negative("lowest", lowest, "[length]")
    highest = checks.positive("highest", highest, "[length]")
    step = _equal_step(times)
    if (distances < 0).any() or highest <= lowest:
        raise InputError(
            f"distance must be >= 0, and highest above lowest; got least distance {distances.min():g}, "
            f"lowest={lowest:g}, highest={highest:g}. Give the distance itself, not its logarithm."
        )
    window = _window(distances, lowest, highest)
    if len(window) < 3:
        raise InputError(
            f"distance must have at least 3 samples from lowest={lowest:g} to highest={highest:g} for a growth rate; "
            f"got {len(window)}. Start closer together, sample more often, or move these bounds."
        )
    growth = block_average(np.diff(np.log(window)) / step)
    if growth.value <= 0:
        raise InputError(
            f"distance must grow for a growth rate; got {growth.value:g} per time over {len(window)} samples. Without "
            "growth there is no horizon: compare as long as you like, or run longer to see it."
        )
    rate = growth.value
    return Predictability(growth, 1 / rate, AGREEMENT / rate, ASSERTED * AGREEMENT / rate)


def comparable_until(rate: float) -> float:
    """Time up to which the trajectories of two float64 solvers may be compared, ASSERTED x AGREEMENT / rate [time].

    Args:
        rate: largest Lyapunov exponent [1/time], > 0.

    Raises:
        InputError: unless it is > 0.

    >>> round(comparable_until(2.9), 2)
    3.45
    """
    return ASSERTED * AGREEMENT / checks.positive("rate", rate, "[1/time]")


def require_predictable(time: float, rate: float) -> None:
    """Refuse to compare trajectories at times at which even two correct float64 solvers differ.

    A float32 or stepped run leaves the exact trajectory earlier, by its own error; this is the bound for any run.

    Args:
        time: since both runs had the same state [time], >= 0.
        rate: largest Lyapunov exponent of the scene [1/time], > 0: see `predictability`.

    Raises:
        InputError: if time is beyond comparable_until(rate), or an argument breaks its rule.

    >>> require_predictable(3.0, rate=2.9)
    >>> require_predictable(4.0, rate=2.9)
    Traceback (most recent call last):
    ...
    mpsim.InputError: time of a comparison of trajectories must be at most 3.44828 (half of 20 Lyapunov times \
of 1/2.9); got 4.0. Beyond that two correct solvers differ: compare averages such as pressure, or an earlier time.
    """
    limit = comparable_until(rate)
    if checks.non_negative("time", time, "[time]") > limit:
        raise InputError(
            f"time of a comparison of trajectories must be at most {limit:g} (half of {AGREEMENT:g} Lyapunov times of "
            f"1/{rate:g}); got {time!r}. Beyond that two correct solvers differ: compare averages such as pressure, or "
            "an earlier time."
        )


def _equal_step(times: NDArray[np.float64]) -> float:
    """The step of times that rise in equal steps."""
    steps = np.diff(times)
    if len(times) < 3 or (steps <= 0).any() or np.ptp(steps) > 1e-6 * steps.max():
        raise InputError(
            f"time must hold at least 3 times that rise in equal steps; got {len(times)} times with steps from "
            f"{steps.min(initial=np.inf):g} to {steps.max(initial=-np.inf):g}. Sample every so many frames."
        )
    return float((times[-1] - times[0]) / len(steps))


def _window(distances: NDArray[np.float64], lowest: float, highest: float) -> NDArray[np.float64]:
    """The distances from the first at or above `lowest` (and above 0) to the last before one passes `highest`."""
    beyond = np.flatnonzero(distances > highest)
    stop = int(beyond[0]) if len(beyond) else len(distances)
    # A distance of 0 has no logarithm: if the runs coincided again, start after that.
    low = np.flatnonzero(distances[:stop] == 0)
    start = int(low[-1]) + 1 if len(low) else 0
    above = np.flatnonzero(distances[start:stop] >= lowest)
    return distances[start + int(above[0]) : stop] if len(above) else distances[:0]
