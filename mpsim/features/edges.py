"""The edges of the box: walls, periodic borders, edges that absorb discs."""

# pyright: reportUnnecessaryIsInstance=false
# Arguments are checked when the program runs as well, for callers without a type checker.

from typing import Any, NamedTuple

from mpsim.core import checks
from mpsim.core.errors import InputError

EDGES = ("left", "right", "bottom", "top")
"""The walls of the box: x = 0, x = width, y = 0, y = height."""


class MovingWall(NamedTuple):
    """A wall of the box that moves at constant speed from start to stop, and rests there.

    name: what it is called in texts. edge: which wall it is, an index of EDGES. start, stop: coordinates [length].
    speed: [length/time].
    """

    name: str
    edge: int
    start: float
    stop: float
    speed: float

    @property
    def axis(self) -> int:
        """The axis along which it moves."""
        return self.edge // 2

    def at(self, time: float) -> float:
        """Its coordinate at a time [length]."""
        place = self.start + self.speed * time
        return max(place, self.stop) if self.speed < 0 else min(place, self.stop)


def check_boundary(boundary: object) -> tuple[str, str]:
    """Boundary of x and of y, each "walls" or "periodic"; one word stands for both."""
    each_of: Any = boundary
    pair = (each_of, each_of) if isinstance(each_of, str) else tuple(each_of)
    if len(pair) != 2:
        raise InputError(f"boundary must be one word or one for x and one for y; got {boundary!r}.")
    x, y = (checks.choice("boundary", word, ("walls", "periodic")) for word in pair)
    return x, y


def demand_wall(name: str, edge: str, boundary: tuple[str, str]) -> None:
    """Refuse an edge along a periodic axis, where there is no wall."""
    axis = 0 if edge in ("left", "right") else 1
    if boundary[axis] == "periodic":
        raise InputError(
            f"{name} must name a wall; got {edge!r}, and boundary is periodic along {'xy'[axis]}. "
            "Make that axis 'walls', or choose another edge."
        )
