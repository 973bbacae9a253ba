"""Quantities that the colours of discs show, as one byte per disc."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mpsim.core import checks
from mpsim.core.state import State
from mpsim.engine.observers import Collisions
from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers.base import InPlace
from mpsim.errors import InputError
from mpsim.kernels.output import paint_speeds

# --- Maps the speeds of discs to colours, one byte per disc

KNEE, FASTEST, ABSORBED = 223, 254, 255
"""Bytes of three discs: one at the speed that 98 % of the discs do not reach, the fastest one, and an absent one."""

USUAL = 0.98
"""Fraction of the discs that are slower than the speed at KNEE. Above KNEE, one byte spans a larger range of speeds. So
a few very fast discs do not make all others look dark, and can still be told apart."""

LEAST_RATIO = 1 + (FASTEST - KNEE) / KNEE
"""Smallest ratio of the speed at FASTEST to that at KNEE. At this ratio, both parts of the scale have one slope."""

MOST_SAMPLED = 20_000
"""Largest number of speeds that are sorted to find the scale. If there are more discs, every second, every third, ...
is taken."""


@dataclass(frozen=True)
class SpeedScale:
    """A piecewise linear scale: byte 0 at speed 0, KNEE at `usual`, FASTEST at `fastest`."""

    usual: float  # > 0 [length/time]
    fastest: float  # >= LEAST_RATIO * usual [length/time]

    def colours(self, discs: InPlace, out: NDArray[np.uint8], *, plain: bool = False) -> None:
        """Write the colour of each disc into `out`, ordered by disc number; plain: without a compiled kernel."""
        steep = (FASTEST - KNEE) / (self.fastest / self.usual - 1)
        paint = getattr(paint_speeds, "py_func", paint_speeds) if plain else paint_speeds
        paint(discs.vx, discs.vy, discs.number, self.usual, KNEE, steep, FASTEST, out)
        if discs.absent is not None:
            out[discs.absent] = ABSORBED


def scale_of(state: State) -> SpeedScale:
    """The scale for the speeds of a state; if all discs are at rest, a scale from 0 to about 1."""
    speeds = np.hypot(*state.velocity[state.present].T).astype(np.float64)
    fastest = float(speeds.max(initial=0.0))
    if not fastest > 0:
        return SpeedScale(1.0, LEAST_RATIO)
    usual = float(np.quantile(speeds[:: len(speeds) // MOST_SAMPLED + 1], USUAL))
    usual = max(usual, fastest / 1000)  # where nearly all are at rest
    return SpeedScale(usual, max(fastest, LEAST_RATIO * usual))


# --- Quantities that the colours of discs can show, such as speed, and their scales

CHOICES = ("speed", "worker", "column", "collision", "own")
"""What the colours can show; the column by its parity, which decides the pass that resolves the contacts; collision:
the time since the last one; own: numbers from the user's program."""

LOW, MIDDLE = FASTEST - KNEE, FASTEST // 2
"""The lowest 2 % of the values have bytes below LOW, as the highest 2 % have bytes above KNEE. A disc without a value
has the byte MIDDLE."""

PERCENTILES = (0, 2, 98, 100)
"""Percentiles of the values that have the bytes 0, LOW, KNEE and FASTEST; between them the scale is linear."""


class Colouring:
    """Chooses the colours of the discs of one simulation; own: numbers from `own_colours`, read for each picture."""

    def __init__(self, own: NDArray[np.float64] | None = None):
        self._own = own
        self.by: str = "speed" if own is None else "own"
        self._legend: dict[str, Any] = {}
        self.begin()

    def begin(self) -> None:
        """Forget all collisions: another simulation or another quantity is shown."""
        self._last = np.zeros(0)
        self._since: float | None = None
        self._has_columns: bool | None = None  # not known yet
        self.log: Collisions | None = Collisions(callback=self._collided) if self.by == "collision" else None

    def choices(self, sim: Simulation) -> list[str]:
        """The quantities among CHOICES that this simulation has."""
        if self._has_columns is None:
            self._has_columns = _has_columns(sim)
        there = {"worker": self._has_columns, "column": self._has_columns, "own": self._own is not None}
        return [name for name in CHOICES if there.get(name, True)]

    def choose(self, by: str, sim: Simulation) -> None:
        """Choose the quantity that the colours show, or raise InputError if this simulation does not have it."""
        self.by = checks.choice("by of colour", by, self.choices(sim))
        self.begin()

    def _collided(self, sim: Simulation, table: NDArray[Any]) -> None:
        self._last_of(sim.count)
        for name, rows in (("i", table), ("j", table[table["kind"] == 0])):
            np.maximum.at(self._last, rows[name], rows["time"])

    def _last_of(self, count: int) -> NDArray[np.float64]:
        """Time of the last collision of each disc; -infinity if it has not collided yet."""
        if len(self._last) < count:
            self._last = np.append(self._last, np.full(count - len(self._last), -math.inf))
        return self._last[:count]

    def bytes_of(self, sim: Simulation, discs: InPlace) -> NDArray[np.uint8] | None:
        """The colour of each disc, ordered by disc number; None: colour by speed."""
        self._legend = {}
        if self.by == "speed":
            return None
        if self.by in ("worker", "column"):
            found = sim.columns()
            classes = found.owner if self.by == "worker" else found.of_disc % 2
            number = 2 if self.by == "column" else int(found.owner.max(initial=0)) + 1
            colours = (classes * (FASTEST / max(number - 1, 1))).astype(np.uint8)
            self._legend = {"classes": number}
        elif self.by == "collision":
            self._since = discs.time if self._since is None else self._since
            colours = self._on_scale(discs.time - np.maximum(self._last_of(len(discs.number)), self._since))
        else:
            assert self._own is not None  # otherwise "own" could not have been chosen
            unknown = np.full(max(len(discs.number) - len(self._own), 0), math.nan)
            colours = self._on_scale(np.append(self._own, unknown)[: len(discs.number)])
        if discs.absent is not None:
            colours[discs.absent] = ABSORBED
        return colours

    def _on_scale(self, values: NDArray[np.float64]) -> NDArray[np.uint8]:
        """The bytes of values, on a scale set by percentiles of the finite ones."""
        here, found = np.isfinite(values), np.full(len(values), MIDDLE, np.uint8)
        if not here.any():
            return found
        corners = np.percentile(values[here], PERCENTILES)
        self._legend = {"values": corners.tolist()}
        if corners[0] < corners[-1]:
            found[here] = np.interp(values[here], corners, (0, LOW, KNEE, FASTEST)) + 0.5
        return found

    def told(self, sim: Simulation) -> dict[str, Any]:
        """What the legend of a page needs: the quantity, and the percentiles of its scale or the number of classes."""
        return {"by": self.by, "choices": self.choices(sim), **self._legend}


def _has_columns(sim: Simulation) -> bool:
    """Whether the method sorts discs into columns, which belong to workers."""
    try:
        return sim.columns().number > 0
    except InputError:
        return False


def own_colours(colour: ArrayLike | None, count: int) -> NDArray[np.float64] | None:
    """Check numbers to colour discs by, shape (count,). A float64 array is not copied, so it can be changed later."""
    if colour is None:
        return None
    try:
        found = np.asarray(colour, np.float64)
    except (TypeError, ValueError):
        found = np.zeros(())
    if found.shape != (count,):
        raise InputError(
            f"colour must be an array of {count} numbers, one for each disc; got {checks.brief(colour)}. "
            "Use mpsim.view(sim, colour=values)."
        )
    return found
