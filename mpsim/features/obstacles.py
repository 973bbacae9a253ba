"""Obstacles: fixed discs and polylines, all made of capsules. Checked when made; immutable."""

# pyright: reportUnnecessaryIsInstance=false
# Arguments are checked when the program runs as well, for callers without a type checker.

from __future__ import annotations

import weakref
from dataclasses import dataclass
from itertools import chain, pairwise
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mpsim.core import checks
from mpsim.core.machine import garbage_collection_paused
from mpsim.errors import InputError
from mpsim.features import capsules
from mpsim.features.capsules import Deepest
from mpsim.features.feature import AddedDiscs, Feature, Floats, Invalidation, Shapes

if TYPE_CHECKING:
    from mpsim.scene.scene import Scene

LARGEST_OBSTACLES = 1_000_000
"""More obstacles than this are taken for a mistake."""


@dataclass(frozen=True)
class FixedDisc:
    """A disc that never moves, such as a peg.

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
        """The disc as one capsule of length 0: (ax, ay, bx, by, radius) [length]."""
        place: Any = self.position
        x, y = place
        return [(x, y, x, y, self.radius)]


FixedDisc.__init__ = checks.known_names()(FixedDisc.__init__)


@dataclass(frozen=True)
class Polyline:
    """A chain of straight walls that discs cannot cross from either side, such as a funnel, a channel or a bin.

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
        """A capsule for each straight wall: (ax, ay, bx, by, radius) [length]."""
        points: Any = self.points
        return [(ax, ay, bx, by, self.thickness / 2) for (ax, ay), (bx, by) in pairwise(points)]


Polyline.__init__ = checks.known_names()(Polyline.__init__)


Obstacle = FixedDisc | Polyline


def fixed_discs(position: NDArray[np.float64], radius: float | NDArray[np.float64]) -> list[FixedDisc]:
    """Many FixedDiscs at once, from numbers that were checked before.

    Args:
        position: finite, shape (K, 2) [length].
        radius: > 0, of all or of each, shape (K,) [length].
    """
    made: list[FixedDisc] = []
    radii = np.broadcast_to(radius, len(position)).tolist()
    with garbage_collection_paused():
        for (x, y), each in zip(position.tolist(), radii, strict=True):
            disc = object.__new__(FixedDisc)
            vars(disc).update(position=(x, y), radius=each)
            made.append(disc)
    return made


def check_lines(points: NDArray[np.float64], lengths: NDArray[Any]) -> None:
    """Refuse points that do not form Polylines, one after the other.

    Args:
        points: of all lines, finite, shape (K, 2) [length].
        lengths: number of points of each line, shape (L,): whole numbers >= 2 that add up to K.

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
    """Many Polylines at once, from numbers that were checked before.

    Args:
        points, lengths: as of `check_lines`.
        thickness: >= 0, of all or of each, shape (L,) [length].
    """
    made: list[Polyline] = []
    ends = np.cumsum(lengths.astype(np.int64)).tolist()
    thick = np.broadcast_to(thickness, len(lengths)).tolist()
    with garbage_collection_paused():
        corners: list[tuple[float, float]] = [(x, y) for x, y in points.tolist()]
        for first, last, each in zip([0, *ends], ends, thick, strict=False):  # one more beginning than ends
            line = object.__new__(Polyline)
            vars(line).update(points=tuple(corners[first:last]), thickness=each)
            made.append(line)
    return made


def capsules_of(obstacles: tuple[Obstacle, ...]) -> NDArray[np.float64]:
    """All obstacles as capsules, shape (K, 5): ax, ay, bx, by, radius [length]."""
    numbers = chain.from_iterable(chain.from_iterable(obstacle.capsules() for obstacle in obstacles))
    return np.fromiter(numbers, np.float64).reshape(-1, 5)


def owner_of(capsule: int, obstacles: tuple[Obstacle, ...]) -> int:
    """Index of the obstacle that a row of `capsules_of` belongs to.

    >>> owner_of(2, (FixedDisc((1, 1), 1), Polyline([(0, 0), (1, 0), (1, 2)])))
    1
    """
    return int(np.searchsorted(np.cumsum([len(each.capsules()) for each in obstacles]), capsule, side="right"))


def check_obstacles(obstacles: object, width: float, height: float) -> tuple[Obstacle, ...]:
    """The obstacles as a tuple, checked; a single one may come without a list."""
    each_of: Any = obstacles
    kinds = OBSTACLES.kinds
    chosen = (each_of,) if isinstance(each_of, kinds) else tuple(each_of)
    if len(chosen) > LARGEST_OBSTACLES:
        raise InputError(
            f"obstacles must be at most {LARGEST_OBSTACLES:,}; got {len(chosen):,}. Use fewer: a Polyline is one."
        )
    for index, obstacle in enumerate(chosen):
        if not isinstance(obstacle, kinds):
            names = " or ".join(f"mpsim.{kind.__name__}" for kind in kinds)
            raise InputError(f"obstacles[{index}] must be an {names}; got {type(obstacle).__name__}.")
    ends = capsules_of(chosen)[:, :4].reshape(-1, 2)
    outside = (ends < 0).any(axis=1) | (ends[:, 0] > width) | (ends[:, 1] > height)
    if outside.any():
        first = int(outside.argmax())
        raise InputError(
            f"obstacles[{owner_of(first // 2, chosen)}] must lie in the box, [0, {width:g}] x [0, {height:g}]; got a "
            f"point {tuple(ends[first].tolist())}. Move it, or enlarge the box."
        )
    return chosen


class Obstacles(Feature):
    """The argument `obstacles`."""

    argument = "obstacles"
    kinds: ClassVar[tuple[type[Any], ...]] = (FixedDisc, Polyline)
    exact: ClassVar[tuple[type[Any], ...]] = (FixedDisc, Polyline)  # kinds that are nothing but their capsules
    excludes = True
    invalidates: ClassVar[tuple[Invalidation, ...]] = (
        Invalidation(
            ("virial", "momentum_drift"),
            "obstacles, whose impulses are not counted",
            "Use 'energy_drift' for the health of a run, 'pressure' for the load on the walls.",
        ),
    )

    def __init__(self) -> None:
        self._made: weakref.WeakKeyDictionary[Any, tuple[Any, dict[str, NDArray[Any]]]] = weakref.WeakKeyDictionary()
        """`arrays` of scenes in use, with what they were made from: each block needs them twice."""

    def check_room(self, scene: Scene, new: AddedDiscs) -> None:
        capsules.check_clear(scene.deepest(new.position, new.radius), new.name, new.position, new.radius)

    def deepest(self, scene: Scene, position: Floats, radius: Floats) -> Deepest | None:
        size = (scene.width, scene.height)
        depth = scene.capsule_index.depths(position, radius)
        number = int((depth > 8 * np.finfo(np.float64).eps * max(size)).sum())
        if not number:
            return None
        worst = int(depth.argmax())
        nearest = capsules.nearest(position[worst], scene.capsules, size, scene.periodic)
        return Deepest(number, worst, f"obstacles[{owner_of(nearest, self.of(scene))}]", float(depth[worst]))

    def shapes(self, scene: Scene, capacity: int, real: np.dtype) -> Shapes:
        return {
            f"capsules.{name}": (real if values.dtype.kind == "f" else values.dtype, values.shape)
            for name, values in self.arrays(scene).items()
        }

    def fill(self, scene: Scene, arrays: dict[str, Any], margin: float) -> None:
        for name, values in self.arrays(scene).items():
            arrays[f"capsules.{name}"][...] = values

    def arrays(self, scene: Scene) -> dict[str, NDArray[Any]]:
        """Capsules, with images beyond periodic borders, and their grid (see `cell_lists`); {} without capsules.

        The grid depends neither on the method nor on the number of discs.
        """
        made_of = (id(scene.capsules), scene.width, scene.height, scene.periodic, scene.largest_radius)
        if scene not in self._made or self._made[scene][0] != made_of:
            self._made[scene] = made_of, _listed(scene)
        return self._made[scene][1]

    def description(self, scene: Scene) -> str:
        return f"{len(self.of(scene))}"

    def record(self, scene: Scene) -> int:
        return len(self.of(scene))

    def cost_examples(self, side: float, pitch: float) -> dict[str, Any]:
        every = np.arange(1, 100, 10) * pitch
        line = Polyline([(0, side / 2), (side / 3, side / 2)])
        return {"100 pegs": [FixedDisc((x, y), 0.1) for x in every for y in every], "a polyline": [line]}


def _listed(scene: Scene) -> dict[str, NDArray[Any]]:
    size = (scene.width, scene.height)
    images = capsules.with_images(scene.capsules, size, scene.periodic, scene.largest_radius)
    if not len(images.capsule):
        return {}
    lists = capsules.cell_lists(images.capsule, size, scene.largest_radius)
    grid = {"near": lists.near, "index": lists.listed, "grid": lists.grid, "per_length": lists.per_length}
    every = np.concatenate([images.capsule, capsules.cut_at_ends(images.capsule, lists, size)])  # these are not listed
    return {"capsule": every, "next_end": capsules.next_ends(every), **grid}


OBSTACLES = Obstacles()
