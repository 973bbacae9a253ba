"""A piston: a wall of the box that moves. Checked when made; immutable."""

# pyright: reportUnnecessaryIsInstance=false
# Arguments are checked when the program runs as well, for callers without a type checker.

from dataclasses import dataclass
from typing import Any

from mpsim.core import checks
from mpsim.core.errors import InputError
from mpsim.features.edges import EDGES, demand_wall


@dataclass(frozen=True)
class Piston:
    """A wall of the box that moves at constant speed.

    Args:
        wall: "left", "right", "bottom" or "top".
        speed: along x or y [length/time]; a right wall with a negative speed compresses.
        stop: coordinate at which it comes to rest [length], in the box, on the way. There must be room for all discs
            then.
        start: coordinate at which it begins [length], between its wall and stop, which may be both: a piston that has
            arrived. None: at its wall.

    Raises:
        InputError: naming the argument, its rule and the value received.

    >>> Piston("right", speed=-0.5, stop=3).stop
    3.0
    """

    wall: str
    speed: float
    stop: float
    start: float | None = None

    def __post_init__(self) -> None:
        checks.choice("wall of a Piston", self.wall, EDGES)
        speed = float(checks.finite_array("speed of a Piston", self.speed, (), "()"))
        if speed == 0 or (speed < 0) != (self.wall in ("right", "top")):
            raise InputError(
                f"speed of a Piston must point into the box, {'< 0' if self.wall in ('right', 'top') else '> 0'} for "
                f"the {self.wall} wall; got {speed:g}. Turn its sign, or leave the piston out."
            )
        object.__setattr__(self, "speed", speed)
        object.__setattr__(self, "stop", checks.positive("stop of a Piston", self.stop, "[length]"))
        if self.start is not None:
            start = checks.non_negative("start of a Piston", self.start, "[length]")
            if (self.stop - start) * speed < 0:
                side = "at or above" if speed < 0 else "at or below"
                raise InputError(
                    f"start of a Piston must lie {side} its stop, {self.stop:g}, to which it moves; got {start:g}. "
                    "Leave it out for a piston that starts at its wall."
                )
            object.__setattr__(self, "start", start)

    def __repr__(self) -> str:
        start = "" if self.start is None else f", start={self.start!r}"
        return f"Piston(wall={self.wall!r}, speed={self.speed!r}, stop={self.stop!r}{start})"


def check_piston(
    piston: Any, boundary: tuple[str, str], width: float, height: float, absorbing: tuple[str, ...]
) -> Piston | None:
    """The piston, if it is one, moves a wall, and stops in the box."""
    if piston is None:
        return None
    if not isinstance(piston, Piston):
        raise InputError(f"piston must be an mpsim.Piston; got {type(piston).__name__}.")
    demand_wall("piston", piston.wall, boundary)
    if piston.wall in absorbing:
        raise InputError(f"piston must not be an absorbing edge; got {piston.wall!r} for both. Choose one.")
    length = width if piston.wall in ("left", "right") else height
    if not 0 < piston.stop < length:
        raise InputError(f"stop of the piston must lie in the box, in (0, {length:g}); got {piston.stop:g}.")
    if piston.start is not None and piston.start > length:
        raise InputError(f"start of the piston must lie in the box, in [0, {length:g}]; got {piston.start:g}.")
    return piston
