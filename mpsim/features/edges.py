"""The edges of the box: walls, periodic borders, edges that absorb discs."""

# pyright: reportUnnecessaryIsInstance=false
# Arguments are checked when the program runs as well, for callers without a type checker.

from typing import Any

from mpsim.core import checks
from mpsim.core.errors import InputError

EDGES = ("left", "right", "bottom", "top")
"""The walls of the box: x = 0, x = width, y = 0, y = height."""


def check_boundary(boundary: object) -> tuple[str, str]:
    """Boundary of x and of y, "walls" or "periodic" each; one word stands for both."""
    each_of: Any = boundary
    pair = (each_of, each_of) if isinstance(each_of, str) else tuple(each_of)
    if len(pair) != 2:
        raise InputError(f"boundary must be one word or one for x and one for y; got {boundary!r}.")
    x, y = (checks.choice("boundary", word, ("walls", "periodic")) for word in pair)
    return x, y


def check_edges(absorbing: object, boundary: tuple[str, str]) -> tuple[str, ...]:
    """Names of edges that swallow discs; they must be walls."""
    each_of: Any = absorbing
    names = (each_of,) if isinstance(each_of, str) else tuple(each_of)
    for name in names:
        checks.choice("absorbing", name, EDGES)
        demand_wall("absorbing", name, boundary)
    return tuple(dict.fromkeys(names))


def demand_wall(name: str, edge: str, boundary: tuple[str, str]) -> None:
    """Refuse an edge that is none: beyond it the box repeats."""
    axis = 0 if edge in ("left", "right") else 1
    if boundary[axis] == "periodic":
        raise InputError(
            f"{name} must name a wall; got {edge!r}, and boundary is periodic along {'xy'[axis]}. "
            "Make that axis 'walls', or choose another edge."
        )
