"""Obstacles: fixed discs and polylines, all made of capsules. Checked when made; immutable."""

# pyright: reportUnnecessaryIsInstance=false
# Arguments are checked when the program runs as well, for callers without a type checker.

import contextlib
import gc
from collections.abc import Generator
from dataclasses import dataclass
from itertools import chain, pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mpsim.core import checks
from mpsim.core.errors import InputError

LARGEST_OBSTACLES = 1_000_000
"""More obstacles than this are taken for a mistake."""


@dataclass(frozen=True)
class FixedDisc:
    """A disc that never moves: a peg.

    Args:
        position: centre (x, y) [length], in the box.
        radius: [length], > 0.

    Raises:
        InputError: naming the argument, its rule and the value received.

    >>> FixedDisc((2, 3), 0.5).capsules()
    [(2.0, 3.0, 2.0, 3.0, 0.5)]
    """

    position: ArrayLike
    radius: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", checks.point("position of a FixedDisc", self.position))
        object.__setattr__(self, "radius", checks.positive("radius of a FixedDisc", self.radius, "[length]"))

    def capsules(self) -> list[tuple[float, float, float, float, float]]:
        """Segments with a radius, as the kernels take all obstacles: (ax, ay, bx, by, radius); here one of length 0."""
        place: Any = self.position
        x, y = place
        return [(x, y, x, y, self.radius)]


@dataclass(frozen=True)
class Polyline:
    """A chain of straight walls, solid from both sides: a funnel, a channel, a bin.

    Args:
        points: corners, shape (K, 2), K >= 2 [length], in the box; neighbours differ.
        thickness: of the walls [length], >= 0.

    Raises:
        InputError: naming the argument, its rule and the value received.

    >>> Polyline([(0, 0), (1, 0), (1, 2)]).capsules()
    [(0.0, 0.0, 1.0, 0.0, 0.0), (1.0, 0.0, 1.0, 2.0, 0.0)]
    """

    points: ArrayLike
    thickness: float = 0.0

    def __post_init__(self) -> None:
        points = checks.finite_array("points of a Polyline", self.points, (None, 2), "(K, 2)")
        check_lines(points, np.array([points.shape[0]]))
        thickness = checks.non_negative("thickness of a Polyline", self.thickness, "[length]")
        object.__setattr__(self, "points", tuple((float(x), float(y)) for x, y in points))
        object.__setattr__(self, "thickness", thickness)

    def capsules(self) -> list[tuple[float, float, float, float, float]]:
        """Segments with a radius, as the kernels take all obstacles: (ax, ay, bx, by, radius)."""
        points: Any = self.points
        return [(ax, ay, bx, by, self.thickness / 2) for (ax, ay), (bx, by) in pairwise(points)]


Obstacle = FixedDisc | Polyline


def fixed_discs(position: NDArray[np.float64], radius: float | NDArray[np.float64]) -> list[FixedDisc]:
    """Many FixedDiscs of numbers that are checked already, at once.

    Args:
        position: finite, shape (K, 2) [length].
        radius: > 0, of all or of each, shape (K,) [length].
    """
    made: list[FixedDisc] = []
    radii = np.broadcast_to(radius, len(position)).tolist()
    with _garbage_collection_paused():
        for (x, y), each in zip(position.tolist(), radii, strict=True):
            disc = object.__new__(FixedDisc)
            vars(disc).update(position=(x, y), radius=each)
            made.append(disc)
    return made


def check_lines(points: NDArray[np.float64], lengths: NDArray[Any]) -> None:
    """Refuse points that are no Polylines, one after the other.

    Args:
        points: of all, finite, shape (K, 2) [length].
        lengths: how many of them each has, shape (L,): whole numbers >= 2 that add up to K.

    Raises:
        InputError: naming points or lengths, the rule and the values received.
    """
    wrong = (lengths > len(points)) | (lengths != np.floor(lengths)) | ((lengths < 2) & (len(lengths) > 1))
    if wrong.any() or lengths.sum() != len(points):
        raise InputError(
            f"lengths must be whole numbers >= 2 that add up to {len(points)}, the rows of points; got "
            f"{checks.brief(lengths[:20].tolist())}. Correct them, or leave them out for one line."
        )
    ends = np.cumsum(lengths.astype(np.int64))
    same = (points[1:] == points[:-1]).all(axis=1)
    same[ends[:-1] - 1] = False  # where the next one begins
    if same.any() or (lengths < 2).any():
        line = min(int(np.searchsorted(ends, int(same.argmax()) if same.any() else 0, "right")), len(ends) - 1)
        some = points[np.append(0, ends)[line] : ends[line]][:20].tolist()
        raise InputError(
            "points of a Polyline must be at least two, neighbours at different places; got "
            f"{checks.brief(some)}. Use a FixedDisc for a point."
        )


def polylines(
    points: NDArray[np.float64], lengths: NDArray[Any], thickness: float | NDArray[np.float64]
) -> list[Polyline]:
    """Many Polylines of numbers that are checked already, at once.

    Args:
        points, lengths: as of `check_lines`.
        thickness: >= 0, of all or of each, shape (L,) [length].
    """
    made: list[Polyline] = []
    ends = np.cumsum(lengths.astype(np.int64)).tolist()
    thick = np.broadcast_to(thickness, len(lengths)).tolist()
    with _garbage_collection_paused():
        corners: list[tuple[float, float]] = [(x, y) for x, y in points.tolist()]
        for first, last, each in zip([0, *ends], ends, thick, strict=False):  # one beginning more than ends
            line = object.__new__(Polyline)
            vars(line).update(points=tuple(corners[first:last]), thickness=each)
            made.append(line)
    return made


@contextlib.contextmanager
def _garbage_collection_paused() -> Generator[None]:
    """No search for garbage meanwhile: of a million objects that all stay it takes four fifths of the time."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def capsules_of(obstacles: tuple[Obstacle, ...]) -> NDArray[np.float64]:
    """All obstacles as segments with a radius, shape (K, 5): ax, ay, bx, by, radius [length]."""
    numbers = chain.from_iterable(chain.from_iterable(obstacle.capsules() for obstacle in obstacles))
    return np.fromiter(numbers, np.float64).reshape(-1, 5)


def owner_of(capsule: int, obstacles: tuple[Obstacle, ...]) -> int:
    """Index of the obstacle that a row of `capsules_of` belongs to.

    >>> owner_of(2, (FixedDisc((1, 1), 1), Polyline([(0, 0), (1, 0), (1, 2)])))
    1
    """
    return int(np.searchsorted(np.cumsum([len(each.capsules()) for each in obstacles]), capsule, side="right"))


def check_obstacles(obstacles: object, width: float, height: float) -> tuple[Obstacle, ...]:
    """The obstacles as a tuple, if each is one and lies in the box."""
    each_of: Any = obstacles
    chosen = (each_of,) if isinstance(each_of, Obstacle) else tuple(each_of)
    if len(chosen) > LARGEST_OBSTACLES:
        raise InputError(
            f"obstacles must be at most {LARGEST_OBSTACLES:,}; got {len(chosen):,}. Use fewer: a Polyline is one."
        )
    for index, obstacle in enumerate(chosen):
        if not isinstance(obstacle, Obstacle):
            raise InputError(
                f"obstacles[{index}] must be an mpsim.FixedDisc or mpsim.Polyline; got {type(obstacle).__name__}."
            )
    ends = capsules_of(chosen)[:, :4].reshape(-1, 2)
    outside = (ends < 0).any(axis=1) | (ends[:, 0] > width) | (ends[:, 1] > height)
    if outside.any():
        first = int(outside.argmax())
        raise InputError(
            f"obstacles[{owner_of(first // 2, chosen)}] must lie in the box, [0, {width:g}] x [0, {height:g}]; got a "
            f"point {tuple(ends[first].tolist())}. Move it, or enlarge the box."
        )
    return chosen
