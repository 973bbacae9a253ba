"""Functions of time correlations: displacements, velocity autocorrelation, scattering, diffusion constant."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.errors import InputError, NotRecordedError
from mpsim.measure.multiple_tau import MultipleTau, trapezoid
from mpsim.measure.statistics import Measure

Floats = NDArray[np.float64]

Route = Literal["displacement", "velocity"]
"""Where a diffusion constant comes from: the growth of displacements, or the velocity autocorrelation."""

SQUARES, VELOCITIES, WAVES = 0, 1, 2
"""Numbers of the quantities that are correlated; WAVES is that of the first wave number."""

MOST_WAVE_NUMBERS = 64
"""Wave numbers at most: each takes a cosine per disc, axis and lag at every sample."""

CHUNK = 2**16
"""Numbers that are multiplied together: they fit the cache of a core."""

DECAYED = 0.02
"""Fraction of its value at lag 0 to which the velocity autocorrelation must have decayed where diffusion begins."""

OVERLAP = 25
"""Lags in a run from which on errors of displacements are known. At 20 lags those of a random walk are true to 5 %, at
14 they are too small by a factor of 1.3, at 10 of 1.6, as displacements from most time origins overlap."""

DIFFUSIVE_FRACTION = 40
"""Diffusion is taken by default at lags up to the time gathered over this, where errors are known."""


@dataclass(frozen=True)
class TimeCorrelation:
    """A correlation function at the lags that a run has reached.

    Attributes:
        lag: shape (L,), rising [time].
        width: shape (L,), half the width of the triangular window of lags over which a value is averaged, because
            velocities are averaged over blocks; 0 where the value belongs to that lag alone [time].
        measures: L values, each with its standard error and, as `samples`, the number of time origins.

    >>> found = TimeCorrelation(np.array([0.0, 1.0]), np.zeros(2), (Measure(1.0, 0.1, 9), Measure(0.5, 0.2, 8)))
    >>> len(found), found[1], found.value.tolist(), found.error.tolist(), found.settled.tolist()
    (2, 0.50(20), [1.0, 0.5], [0.1, 0.2], [True, True])
    """

    lag: Floats
    width: Floats
    measures: tuple[Measure, ...]

    @property
    def value(self) -> Floats:
        """Shape (L,) [of the function]."""
        return np.array([each.value for each in self.measures])

    @property
    def error(self) -> Floats:
        """Standard errors, shape (L,), NaN where unknown [of the function]."""
        return np.array([each.error for each in self.measures])

    @property
    def settled(self) -> NDArray[np.bool_]:
        """Whether the run was long enough to know the error, shape (L,); if not, it is a bound (see `Measure`)."""
        return np.array([each.settled for each in self.measures], np.bool_)

    def __len__(self) -> int:
        return len(self.measures)

    def __getitem__(self, index: int) -> Measure:
        try:
            return self.measures[index]
        except IndexError:
            raise IndexError(f"the correlation has {len(self)} lags; got index {index}.") from None


@dataclass
class Motion:
    """Accumulated data on the motion of some discs.

    Attributes:
        correlator: of samples of shape (2, D, 2), positions and velocities.
        discs: numbers of the discs, shape (D,).
        latest: the last sample.
        interval: between two samples [time].
        constant: whether the mean square of the velocities cannot change.
        memory: that of heat baths at least, 0 without any [time].
        heated: number of discs in the box, which baths heat.
    """

    correlator: MultipleTau
    discs: NDArray[np.int64]
    latest: Floats
    interval: float
    constant: bool
    memory: float = 0.0
    heated: int = 0

    @property
    def _bath(self) -> tuple[int, float, int] | None:
        """As `BlockSums.combined` takes it."""
        return (VELOCITIES, self.memory / self.interval, self.heated) if self.memory else None

    @property
    def lags(self) -> Floats:
        """Lags that have time origins, shape (L,) [time]: the first ones of the correlator."""
        return np.multiply(
            self.correlator.lags[: np.count_nonzero(self.correlator.blocks.origins())], self.interval, dtype=np.float64
        )

    def measure(self, quantity: int, lag: int) -> Measure:
        """One quantity at one lag, given by its index."""
        if lag == 0 and quantity != VELOCITIES:  # nothing has moved
            return Measure(float(quantity >= WAVES), 0.0, self.correlator.blocks.samples)
        weights = np.zeros(len(self.correlator.lags))
        weights[lag] = 1.0
        constant = self.constant and quantity == VELOCITIES and lag == 0
        found = self.correlator.blocks.combined(quantity, weights, constant, self._bath)
        return found if quantity == VELOCITIES else self._if_long_enough(found, lag)

    def _if_long_enough(self, found: Measure, lag: int) -> Measure:
        """What was found from displacements up to a lag; not settled if too many of them overlap."""
        long_enough = self.correlator.blocks.samples >= OVERLAP * self.correlator.lags[lag]
        return found if long_enough else replace(found, settled=False, upper=False)

    def function(self, quantity: int) -> TimeCorrelation:
        """One quantity at all lags."""
        lags = self.lags
        averaged = np.multiply(self.correlator.width[: len(lags)] - 1, self.interval, dtype=np.float64)
        width = averaged if quantity == VELOCITIES else np.zeros(len(lags))
        return TimeCorrelation(lags, width, tuple(self.measure(quantity, lag) for lag in range(len(lags))))

    def diffusion(self, start: float | None, end: float | None, route: Route) -> Measure:
        """As `Correlations.diffusion`."""
        lags = self.lags
        low, high = self._window(lags, start, end)
        weights = np.zeros(len(self.correlator.lags))
        if route == "displacement":
            weights[[low, high]] = np.array([-1.0, 1.0]) / (4 * (lags[high] - lags[low]))
            weights[low] *= low > 0  # nothing has moved at lag 0
        else:
            fraction = np.clip((lags[high] - lags) / (lags[high] - lags[low]), 0.0, 1.0)[: high + 1]
            weights[: high + 1] = trapezoid(lags[: high + 1]) * fraction / 2
        quantity = SQUARES if route == "displacement" else VELOCITIES
        found = self.correlator.blocks.combined(quantity, weights, bath=self._bath)
        found = self._if_long_enough(found, high) if route == "displacement" else found
        velocity = self.measure(VELOCITIES, low)
        bound = max(DECAYED * self.measure(VELOCITIES, 0).value, 2 * velocity.error)
        return found if abs(velocity.value) <= bound else replace(found, settled=False, upper=False)

    def _window(self, lags: Floats, start: float | None, end: float | None) -> tuple[int, int]:
        """Indices of the lags nearest to start and end."""
        samples = self.correlator.blocks.samples
        latest = samples * self.interval / DIFFUSIVE_FRACTION * (1 + 1e-9)
        high = int(np.searchsorted(lags, latest, side="right")) - 1 if end is None else _nearest("end", end, lags)
        if high < 1:
            raise NotRecordedError(
                f"diffusion needs at least {DIFFUSIVE_FRACTION} samples, or an end after the first lag; got {samples} "
                f"samples and end = {end}. Run longer, or give another end."
            )
        if start is None:
            return min(_nearest("start", lags[high] / 2, lags), high - 1), high
        low = _nearest("start", start, lags)
        if low >= high:
            raise InputError(
                f"start must be before end, by one gathered lag at least; got start = {start!r} and end = "
                f"{float(lags[high]):g}. Give an earlier start."
            )
        return low, high


def correlator(wave_numbers: Floats, points: int, levels: int) -> MultipleTau:
    """The correlator of samples of positions and velocities, shape (2, D, 2)."""

    def some(now: Floats, then: Floats) -> Floats:
        discs, k = now.shape[1], len(then)
        moved = now[0] - then[:, 0]
        squares = np.square(moved).reshape(k, -1).sum(axis=1) / discs
        products = (now[1] * then[:, 1]).reshape(k, -1).sum(axis=1) / discs
        waves = [np.cos(q * moved).reshape(k, -1).sum(axis=1) / (2 * discs) for q in wave_numbers.tolist()]
        return np.stack([squares, products, *waves], axis=1)

    def product(now: Floats, then: Floats) -> Floats:
        rows = max(CHUNK // now[0].size, 1)
        return np.concatenate([some(now, then[first : first + rows]) for first in range(0, len(then), rows)])

    def merge(first: Floats, second: Floats) -> Floats:
        return np.stack([second[0], (first[1] + second[1]) / 2])

    return MultipleTau(product, merge, 2 + len(wave_numbers), points, levels)


def _nearest(name: str, lag: float, lags: Floats) -> int:
    """Index of the gathered lag that is nearest, if `lag` is not beyond them."""
    checks.non_negative(name, lag, "[time]")
    if lag > lags[-1] * (1 + 1e-9):
        raise InputError(
            f"{name} must be a lag that the run has reached, at most {float(lags[-1]):g}; got {lag!r}. Run longer, or "
            "give an earlier one."
        )
    return int(np.abs(lags - lag).argmin())
