"""The boundaries of the box: their kinds, the edges, and walls that move."""

from collections.abc import Iterable
from typing import Any, Literal, NamedTuple, cast

from mpsim.core import checks
from mpsim.errors import InputError
from mpsim.kernels.features.bodies import place_of_wall

BoundaryName = Literal["walls", "periodic"]
Edge = Literal["left", "right", "bottom", "top"]

EDGES: tuple[Edge, ...] = ("left", "right", "bottom", "top")
"""The walls of the box: x = 0, x = width, y = 0, y = height."""


class Boundary(NamedTuple):
    """A kind of boundary, of both ends of an axis.

    Attributes:
        wraps: whether discs that leave at one end enter at the other.
        least_diameters: smallest length of the axis, in diameters of the largest disc: two if discs meet others through
            it, so that none meets its own image.
        largest_radius: what that allows, in words.
    """

    wraps: bool
    least_diameters: int
    largest_radius: str


BOUNDARIES: dict[str, Boundary] = {
    "walls": Boundary(wraps=False, least_diameters=1, largest_radius="half the box"),
    "periodic": Boundary(wraps=True, least_diameters=2, largest_radius="a quarter of a periodic axis"),
}
"""Every kind by the word for it in a scene. Other modules ask for its facts, never for the word."""

WALLED: tuple[BoundaryName, BoundaryName] = ("walls", "walls")  # the boundary of a scene that does not say


class MovingWall(NamedTuple):
    """A wall of the box that moves.

    name: what it is called in texts. edge: which wall it is, an index of EDGES. record, knots: of `MovingWalls`.
    """

    name: str
    edge: int
    record: Any
    knots: Any

    @property
    def axis(self) -> int:
        """The axis along which it moves."""
        return self.edge // 2

    @property
    def speed(self) -> float:
        """The highest that it ever has [length/time]."""
        return float(self.record.fastest)

    @property
    def innermost(self) -> float:
        """Its coordinate where the box is smallest [length]."""
        return float(self.record.low if self.edge % 2 else self.record.high)

    @property
    def rests(self) -> float:
        """Time of the run from which it is at rest; infinity if it never is [time]."""
        return float(self.record.start + self.record.stop)

    def place(self, time: float) -> float:
        """Its coordinate at a time [length]: in float64, as both solvers have it."""
        return float(place_of_wall(self.record, self.knots, time))


def check_boundary(boundary: object) -> tuple[BoundaryName, BoundaryName]:
    """Boundary of x and of y, each one of BOUNDARIES; one word stands for both."""
    each_of: Any = (boundary, boundary) if isinstance(boundary, str) else boundary
    pair: tuple[Any, ...] = tuple(each_of) if hasattr(each_of, "__iter__") else ()
    if len(pair) != 2:
        raise InputError(f"boundary must be one word or one for x and one for y; got {checks.brief(boundary)}.")
    return cast(Any, tuple(checks.choice("boundary", word, BOUNDARIES) for word in pair))


def boundary_of(periodic: Iterable[bool]) -> list[BoundaryName]:
    """The boundary of axes of which each is periodic or has walls.

    >>> boundary_of((True, False))
    ['periodic', 'walls']
    """
    return ["periodic" if each else "walls" for each in periodic]


def wraps_of(boundary: tuple[str, str]) -> tuple[bool, bool]:
    """Whether x, and whether y, wraps."""
    x, y = boundary
    return BOUNDARIES[x].wraps, BOUNDARIES[y].wraps


def demand_wall(name: str, edge: str, boundary: tuple[str, str]) -> None:
    """Refuse an edge at which there is no wall."""
    axis = 0 if edge in ("left", "right") else 1
    if wraps_of(boundary)[axis]:
        raise InputError(
            f"{name} must name a wall; got {edge!r}, and boundary is {boundary[axis]} along {'xy'[axis]}. "
            "Make that axis 'walls', or choose another edge."
        )
