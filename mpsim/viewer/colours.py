"""Maps numbers of discs to colours, one byte per disc."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mpsim.core.state import State
from mpsim.engine.solvers.in_place import InPlace
from mpsim.kernels.painting import paint_speeds

KNEE, FASTEST, ABSORBED = 223, 254, 255
"""Bytes of the speed that nearly all discs are below, of the fastest disc, and of a disc that has left."""

USUAL = 0.98
"""Part of the discs that are slower than the speed of KNEE. Above it, the scale is steeper in speed, so that a few
fast discs neither darken all others nor look alike."""

LEAST_RATIO = 1 + (FASTEST - KNEE) / KNEE
"""Of both speeds: then the upper part of the scale is nowhere steeper in colour than the lower one."""

MOST_SAMPLED = 20_000
"""Discs whose speeds are sorted for the scale; of more discs every second, every third ... are taken."""


@dataclass(frozen=True)
class SpeedScale:
    """A scale in two straight parts: from speed 0 to `usual`, byte KNEE, and on to `fastest`, byte FASTEST.

    Attributes:
        usual: > 0 [length/time].
        fastest: >= LEAST_RATIO times that [length/time].
    """

    usual: float
    fastest: float

    def colours(self, discs: InPlace, out: NDArray[np.uint8], *, plain: bool = False) -> None:
        """Fill in the colour of each disc, in the order of their numbers; plain: by Python, before kernels are loaded.

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
    """The scale for a state; of discs at rest one that calls any speed fast.

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
