"""The speed above which a disc ends a command, with which kernels compare each disc."""

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


class Fastest(NamedTuple):
    """The fastest disc that was too fast in a command. Of equally fast ones it is that of the least number.

    Attributes:
        fraction: its speed over that from which on discs are too fast, times FASTEST_SCALE; 0: there was none.
        negative_disc: its number, times -1.
    """

    fraction: int = 0
    negative_disc: int = 0


def fastest_in(team: NDArray[Any]) -> Fastest:
    """The fastest that some members of a team have found."""
    return max(Fastest(int(each.fastest), -int(each.fastest_disc)) for each in team)


def disc_too_fast(found: Fastest, fast: float, radii: NDArray[np.float64], own: bool, frame: int) -> Speeds | None:
    """The speed of a disc that was too fast; None where there was none.

    Args:
        found: of the last frame.
        fast: the parameter with which kernels compare.
        radii: of all discs, shape (N,) [length].
        own: whether discs have radii of their own, so that `fast` is of speeds per radius.
        frame: the last one.
    """
    if not found.fraction:
        return None
    disc = -found.negative_disc
    radius = float(radii[disc])
    speed = found.fraction / layout.FASTEST_SCALE * math.sqrt(fast) * (radius if own else 1.0)
    return Speeds(disc, speed, radius, when=f"in frame {frame}")
