"""The speed above which a disc ends a command: the number that kernels compare with, and what they have found."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mpsim.engine.solvers.speeds import Speeds
from mpsim.kernels import layout


class SpeedLimit(NamedTuple):
    """Displacement in a step above which a disc is too fast.

    Attributes:
        fraction: of the radius; infinite: never.
        gain: speed that is added to that of each disc before [length/time].
    """

    fraction: float = math.inf
    gain: float = 0.0

    def square(self, dt: float, common: float | None, smallest: float, precision: str) -> float:
        """Value of the parameter `fast`, with which kernels compare squares.

        Args:
            dt: of a step [time].
            common: radius of all discs; None where they have their own [length].
            smallest: radius [length].
            precision: of the run.
        """
        if math.isinf(self.fraction) or smallest <= 0:
            return math.inf
        rate = max(self.fraction / dt - self.gain / smallest, 0.0) * (1.0 if common is None else common)
        number = np.finfo(precision)
        if rate > math.sqrt(float(number.max)):
            return math.inf  # no speed of this precision is so large
        return max(rate * rate, float(number.tiny))


def disc_too_fast(arrays: dict[str, Any], radii: NDArray[np.float64], own: bool, frame: int) -> Speeds | None:
    """The fastest disc of the last frame if it was too fast, reported once; None where there was none.

    Args:
        arrays: of the block.
        radii: of all discs, shape (N,) [length].
        own: whether discs have radii of their own, so that `fast` is of speeds per radius.
        frame: the last one.
    """
    team = arrays["team"]
    worker = int(np.lexsort((team["fastest_disc"], -team["fastest"]))[0])
    fraction, disc = float(team[worker].fastest) / layout.FASTEST_SCALE, int(team[worker].fastest_disc)
    if fraction == 0:
        return None
    team["fastest"] = 0
    radius = float(radii[disc])
    speed = fraction * math.sqrt(float(arrays["parameters"].fast)) * (radius if own else 1.0)
    return Speeds(disc, speed, radius, when=f"in frame {frame}")
