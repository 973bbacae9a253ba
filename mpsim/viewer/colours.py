"""Maps the speeds of discs to colours, one byte per disc."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mpsim.core.state import State
from mpsim.engine.solvers.in_place import InPlace
from mpsim.kernels.painting import paint_speeds

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
    """A piecewise linear scale: byte 0 at speed 0, KNEE at `usual`, FASTEST at `fastest`.

    Attributes:
        usual: > 0 [length/time].
        fastest: >= LEAST_RATIO * usual [length/time].
    """

    usual: float
    fastest: float

    def colours(self, discs: InPlace, out: NDArray[np.uint8], *, plain: bool = False) -> None:
        """Write the colour of each disc into `out`, ordered by disc number.

        plain: in Python, without a compiled kernel.

        >>> from mpsim.engine.solvers.in_place import in_place
        >>> speeds, out = np.array([0.0, 1.0, 2.0, 6.0]), np.zeros(4, np.uint8)
        >>> state = State(np.zeros((4, 2)), np.stack([speeds, 0 * speeds], axis=1))
        >>> SpeedScale(2.0, 6.0).colours(in_place(state, (0, 1, 0, 1), 0, 0.0, np.ones(4)), out)
        >>> out.tolist()
        [0, 112, 223, 254]
        """
        steep = (FASTEST - KNEE) / (self.fastest / self.usual - 1)
        paint = getattr(paint_speeds, "py_func", paint_speeds) if plain else paint_speeds
        paint(discs.vx, discs.vy, discs.number, self.usual, KNEE, steep, FASTEST, out)
        if discs.absent is not None:
            out[discs.absent] = ABSORBED


def scale_of(state: State) -> SpeedScale:
    """The scale for the speeds of a state; if all discs are at rest, a scale from 0 to about 1.

    >>> speeds = np.arange(1.0, 101.0)
    >>> scale = scale_of(State(np.zeros((100, 2)), np.stack([speeds, 0 * speeds], axis=1)))
    >>> round(scale.usual, 3), round(scale.fastest, 3)
    (98.02, 111.646)
    """
    speeds = np.hypot(*state.velocity[state.present].T).astype(np.float64)
    fastest = float(speeds.max(initial=0.0))
    if not fastest > 0:
        return SpeedScale(1.0, LEAST_RATIO)
    usual = float(np.quantile(speeds[:: len(speeds) // MOST_SAMPLED + 1], USUAL))
    usual = max(usual, fastest / 1000)  # where nearly all are at rest
    return SpeedScale(usual, max(fastest, LEAST_RATIO * usual))
