"""The colours of discs, as one byte per disc: of their speeds, or of numbers from a program."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mpsim.core import checks
from mpsim.core.state import State
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


# --- Numbers from a program

LOW, MIDDLE = FASTEST - KNEE, FASTEST // 2
"""The lowest 2 % of the values have bytes below LOW, as the highest 2 % have bytes above KNEE. A disc without a value
has the byte MIDDLE."""

PERCENTILES = (0, 2, 98, 100)
"""Percentiles of the values that have the bytes 0, LOW, KNEE and FASTEST; between them the scale is linear."""


class OwnColours:
    """Colours discs by numbers from `own_colours`, read for each picture; None: by their speeds."""

    def __init__(self, values: NDArray[np.float64] | None):
        self._values = values
        self._corners: list[float] = []

    def bytes_of(self, discs: InPlace) -> NDArray[np.uint8] | None:
        """The colour of each disc, ordered by disc number; None: by speed."""
        if self._values is None:
            return None
        count = len(discs.number)
        values = np.full(count, math.nan)
        known = self._values[:count]
        values[: len(known)] = known
        here, colours = np.isfinite(values), np.full(count, MIDDLE, np.uint8)
        if here.any():
            corners = np.percentile(values[here], PERCENTILES)
            self._corners = corners.tolist()
            if corners[0] < corners[-1]:
                colours[here] = np.interp(values[here], corners, (0, LOW, KNEE, FASTEST)) + 0.5
        if discs.absent is not None:
            colours[discs.absent] = ABSORBED
        return colours

    def told(self) -> dict[str, Any]:
        """What the legend of a page needs: the percentiles of the scale, none for speeds."""
        return {"values": self._corners}


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
