"""Whether there is room for discs: clear of obstacles, and where a piston stops."""

import functools
import math
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mpsim.core.errors import InputError
from mpsim.features import capsules as geometry
from mpsim.features.capsules import Among
from mpsim.features.emitters import Emitter
from mpsim.features.obstacles import Obstacle, owner_of
from mpsim.features.piston import Piston

Floats = NDArray[np.float64]


class Surroundings(Protocol):
    """What discs must have room among: a scene."""

    width: float
    height: float
    radius: float | Floats
    mass: Floats | None
    obstacles: tuple[Obstacle, ...]
    emitters: tuple[Emitter, ...]
    absorbing: tuple[str, ...]
    piston: Piston | None

    @property
    def periodic(self) -> tuple[bool, bool]:
        """Whether x, and whether y, is periodic."""
        ...

    @property
    def capsules(self) -> Floats:
        """Obstacles as segments with a radius, shape (K, 5)."""
        ...

    @property
    def among(self) -> Among:
        """The obstacles in their box."""
        ...

    def walls_at(self, time: float) -> tuple[Floats, Floats]:
        """Corners of the box at a time, the least and the largest."""
        ...

    def check_inside(self, name: str, position: Floats, radius: float | Floats, time: float = 0.0) -> None:
        """Refuse discs that are not in the box."""
        ...


ROUND = 33
"""Corners of the polygon in half a circle."""

SHRUNK = 1e-6
"""Fraction of a radius by which obstacles are grown less: a channel just as wide as a disc must stay one."""

TOUCH = 1e-9
"""Fraction of the coordinates below which a polygon is taken to touch a side, or another one."""

RADII = 16
"""Radii at most for which discs as large or larger are counted against the room among obstacles."""

HOLES = 100
"""Obstacles at most, the largest, that count in that: each pair of them is looked at."""


def densest_packing(smallest: float, largest: float) -> float:
    """Packing fraction above which no discs with radii from `smallest` to `largest` can be arranged in the plane.

    Florian's bound (Rend. Circ. Mat. Palermo 9, 300, 1960): three discs in touch, two of them the largest and one the
    smallest, are nowhere denser. For equal discs it is the hexagonal lattice (Thue 1910). Copies of a box side by side
    fill the plane, so it holds in any box, with walls and without.

    >>> round(densest_packing(1, 1), 4), round(densest_packing(0.5, 1), 4)
    (0.9069, 0.9158)
    """
    q = smallest / largest
    corner = math.pi * q * q + 2 * (1 - q * q) * math.asin(q / (1 + q))
    return corner / (2 * q * math.sqrt(2 * q + 1))


def shortest_box(radius: Floats, number: Floats, across: float, walls: bool) -> float:
    """Length below which no box between two walls, `across` wide, holds so many discs of each radius [length].

    For equal discs between four walls it is Oler's inequality, which counts the room that is lost at walls (Acta Math.
    105, 19, 1961): n points a diameter d apart lie in a convex region of area A and perimeter P only if
    n <= 2 A / (sqrt(3) d^2) + P / (2 d) + 1. Else that of the packing fraction.

    Args:
        radius, number: shape (K,) [length].
        across: width of the box [length].
        walls: whether there are walls across as well, not a periodic border.

    >>> round(shortest_box(np.array([0.5]), np.array([50.0]), 10.0, walls=True), 3)  # packing 0.8705
    4.511
    """
    count = float(number.sum())
    if not count:
        return 0.0
    smallest, largest = float(radius[number > 0].min()), float(radius[number > 0].max())
    area = math.pi * float((number * radius**2).sum())
    length = area / (densest_packing(smallest, largest) * across)
    diameter, free = 2 * largest, across - 2 * largest
    if walls and smallest == largest and free >= 0:
        least = (count - 1 - free / diameter) / (2 * free / (math.sqrt(3) * diameter**2) + 1 / diameter)
        length = max(length, least + diameter)
    return length


def most_equal(radius: float, low: tuple[float, float], high: tuple[float, float], obstacles: Floats) -> float:
    """Number of equal discs above which no arrangement of them between four walls and among obstacles exists.

    Folkman and Graham (Canad. Math. Bull. 12, 745, 1969; of regions with holes Graham, Witsenhausen and Zassenhaus,
    Discrete Math. 2, 1972): n points a diameter d apart lie in a region of area A, perimeter P and Euler characteristic
    chi only if n <= 2 A / (sqrt(3) d^2) + P / (2 d) + chi. Centres lie in the box less one radius, outside obstacles
    grown by one. Any larger region bounds them too: so each grown obstacle is a polygon inside it, and those that
    overlap one that counts more, that would not lower the bound, or that are not among the largest, are left out.

    Args:
        radius: of all discs [length].
        low, high: corners (x, y) of the box [length].
        obstacles: those in it as capsules, shape (K, 5) [length].

    >>> peg = np.array([[2, 3, 2, 3, 1.9]])
    >>> round(most_equal(0.5, (0, 0), (6, 6), peg[:0]), 2), round(most_equal(0.5, (0, 0), (6, 6), peg), 2)
    (39.87, 25.23)
    """
    return _most_equal(radius, low, high, _largest(obstacles).tobytes())


def _largest(obstacles: Floats) -> Floats:
    """The HOLES longest and thickest capsules, shape (K, 5), the largest first."""
    extent = np.hypot(*(obstacles[:, 2:4] - obstacles[:, :2]).T) + obstacles[:, 4]
    return np.asarray(obstacles[np.argsort(-extent, kind="stable")[:HOLES]], np.float64)


@functools.lru_cache(maxsize=64)
def _most_equal(radius: float, low: tuple[float, float], high: tuple[float, float], obstacles: bytes) -> float:
    """`most_equal` among few capsules, which emitters and additions ask for again and again."""
    diameter, sides = 2 * radius, np.subtract(high, low) - 2 * radius
    if (sides < 0).any():
        return 0.0
    corners = np.add(low, radius), np.subtract(high, radius)
    most = 2 * float(sides.prod()) / (math.sqrt(3) * diameter**2) + float(sides.sum()) / diameter + 1
    largest = np.frombuffer(obstacles).reshape(-1, 5)
    holes = [clipped(grown(capsule, radius * (1 - SHRUNK)), *corners) for capsule in largest]
    losses = [(_loss(hole, *corners, diameter), index) for index, hole in enumerate(holes) if len(hole) > 2]
    ends = np.array([[*hole.min(axis=0), *hole.max(axis=0)] if len(hole) else [math.inf] * 4 for hole in holes])
    touch = TOUCH * float(np.abs(corners).max())
    counted: list[int] = []
    for loss, index in sorted(losses, reverse=True):
        if loss <= 0:
            break
        lows, highs = ends[counted, :2], ends[counted, 2:]
        beside = ((lows > ends[index, 2:] + touch) | (highs < ends[index, :2] - touch)).any(axis=1)
        if all(apart(holes[index], holes[counted[other]]) for other in np.flatnonzero(~beside)):
            counted.append(index)
            most -= loss
    return most


def grown(capsule: Floats, radius: float) -> Floats:
    """Corners of a polygon in a segment with a radius, (ax, ay, bx, by, radius), grown by another one, shape (K, 2)."""
    (ax, ay, bx, by, own), half = capsule.tolist(), math.pi / 2
    turn = math.atan2(by - ay, bx - ax) + np.linspace(-half, half, ROUND)
    arc = (own + radius) * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return np.concatenate([arc + np.array([bx, by]), np.array([ax, ay]) - arc])


def clipped(polygon: Floats, low: Floats, high: Floats) -> Floats:
    """What of a convex polygon, shape (K, 2), anticlockwise, lies in a rectangle: corners cut off lie on its sides."""
    for axis, limit, sign in ((0, low[0], 1), (0, high[0], -1), (1, low[1], 1), (1, high[1], -1)):
        beyond = sign * (polygon[:, axis] - limit) < 0
        if not beyond.any():
            continue
        kept: list[Floats] = []
        for start, end in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
            if sign * (start[axis] - limit) >= 0:
                kept.append(start)
            if (start[axis] - limit) * (end[axis] - limit) < 0:
                cut = start + (limit - start[axis]) / (end[axis] - start[axis]) * (end - start)
                cut[axis] = limit
                kept.append(cut)
        polygon = np.array(kept).reshape(-1, 2)
    return polygon


def apart(one: Floats, other: Floats) -> bool:
    """Whether a side of one of two convex polygons, shapes (K, 2), anticlockwise, has the other one behind it."""
    for polygon, beyond in ((one, other), (other, one)):
        along = np.roll(polygon, -1, axis=0) - polygon
        outward = np.stack([along[:, 1], -along[:, 0]], axis=1)
        gap = (beyond @ outward.T).min(axis=0) - (polygon * outward).sum(axis=1)
        if (gap > TOUCH * np.abs(polygon).max() * np.hypot(*along.T)).any():
            return True
    return False


def _loss(hole: Floats, low: Floats, high: Floats, diameter: float) -> float:
    """How many discs fewer the bound has for a convex hole, shape (K, 2), in the rectangle from low to high.

    The hole changes the Euler characteristic by the number of pieces in which it touches the rectangle, less one.
    """
    following = np.roll(hole, -1, axis=0)
    lengths = np.hypot(*(following - hole).T)
    area = 0.5 * float((hole[:, 0] * following[:, 1] - hole[:, 1] * following[:, 0]).sum())
    on_side = ((hole == following) & ((hole == low) | (hole == high))).any(axis=1)
    tolerance = TOUCH * float(np.abs([low, high]).max())
    touching = ((hole <= low + tolerance) | (hole >= high - tolerance)).any(axis=1)
    pieces = int(touching.sum() - on_side.sum())
    gained = float(lengths[~on_side].sum() - lengths[on_side].sum()) / (2 * diameter) + pieces - 1
    return 2 * area / (math.sqrt(3) * diameter**2) - gained


def discs_in_obstacles(
    scene: Surroundings, position: NDArray[np.float64], radius: NDArray[np.float64]
) -> tuple[int, int, int, float]:
    """Discs that overlap an obstacle: how many, the deepest one, the index of its obstacle, its depth [length].

    Discs that touch one to within rounding of the box's coordinates do not count. Images of obstacles beyond periodic
    borders count as they do.

    Args:
        scene: whose obstacles they are.
        position: in the box, shape (N, 2) [length].
        radius: shape (N,) [length].
    """
    size = (scene.width, scene.height)
    depth = scene.among.depths(position, radius)
    number = int((depth > 8 * np.finfo(np.float64).eps * max(size)).sum())
    if not number:
        return 0, 0, 0, 0.0
    worst = int(depth.argmax())
    nearest = geometry.nearest(position[worst], scene.capsules, size, scene.periodic)
    return number, worst, owner_of(nearest, scene.obstacles), float(depth[worst])


def check_clear(scene: Surroundings, name: str, position: Floats, radius: Floats) -> None:
    """Refuse discs that overlap an obstacle, which would put them beside it.

    Args:
        scene: whose box it is.
        name: of the argument, for the text of the error.
        position: centres, shape (N, 2) [length].
        radius: one each, shape (N,) [length].

    Raises:
        InputError: naming the disc that is deepest in an obstacle.
    """
    discs, disc, owner, depth = discs_in_obstacles(scene, position, radius)
    if discs:
        raise InputError(
            f"{name}[{disc}] must be one radius from every obstacle; got {tuple(position[disc].tolist())}, "
            f"{depth:.3g} inside obstacles[{owner}] with radius {radius[disc]:g}. Move the disc or the obstacle."
        )


def check_emitters(scene: Surroundings) -> None:
    """Refuse emitters that do not know the radius or mass of their discs, or that stand where there is no room.

    Raises:
        InputError: naming an emitter, the rule and what it has.
    """
    for name, common in (("radius", np.ndim(scene.radius) == 0), ("mass", scene.mass is None)):
        lacking = [] if common else [index for index, each in enumerate(scene.emitters) if getattr(each, name) is None]
        if lacking:
            raise InputError(
                f"emitters[{lacking[0]}] must have a {name}, as the discs of this scene have one each; got None."
            )
    if scene.emitters:
        position = np.array([each.position for each in scene.emitters])
        radius = np.array([scene.radius if each.radius is None else each.radius for each in scene.emitters])
        scene.check_inside("the position of emitters", position, radius)
        check_clear(scene, "the position of emitters", position, radius)


def check_end(scene: Surroundings, name: str, radius: Floats, number: Floats) -> None:
    """Refuse more discs than the box can hold where the piston stops.

    Args:
        scene: whose box it is.
        name: of the argument, for the text of the error.
        radius, number: so many discs of each radius, shape (K,) [length].

    Raises:
        InputError: with the shortest box that could hold them.
    """
    if scene.piston is None or scene.absorbing:  # through which there may be few enough in the end
        return
    low, high = scene.walls_at(math.inf)
    along = 0 if scene.piston.wall in ("left", "right") else 1
    length, across = (high - low)[[along, 1 - along]].tolist()
    shortest = shortest_box(radius, number, across, walls=not scene.periodic[1 - along])
    if length < shortest * (1 - 1e-12):
        raise InputError(
            f"{name} must leave room for all {number.sum():g} discs, a box at least {shortest:.4g} long and "
            f"{across:g} across: no arrangement of them is denser; got {scene.piston.stop:g}, which leaves "
            f"{length:g} (packing {math.pi * float((number * radius**2).sum()) / (length * across):.3g}). Let the "
            "piston stop earlier, or use fewer or smaller discs."
        )
    if scene.obstacles and not any(scene.periodic):
        corners: Any = tuple(low.tolist()), tuple(high.tolist())
        _check_among_obstacles(scene, name, radius, number, *corners)


def _check_among_obstacles(
    scene: Surroundings, name: str, radius: Floats, number: Floats, low: tuple[float, float], high: tuple[float, float]
) -> None:
    """Refuse more discs than the box from low to high can hold among its obstacles.

    Of several radii, those as large as one of them or larger have no more room than equal discs of that radius.
    """
    assert scene.piston is not None
    radii, largest = np.unique(radius[number > 0]), _largest(scene.capsules)
    for least in radii[:: math.ceil(len(radii) / RADII) or 1].tolist():
        count, most = float(number[radius >= least].sum()), most_equal(least, low, high, largest)
        if count > most * (1 + 1e-9):
            kind = f"radius {least:g}" + (" or more" if len(radii) > 1 else "")
            raise InputError(
                f"{name} must leave room for all {count:g} discs of {kind} among the obstacles, where no arrangement "
                f"has more than {math.floor(most)}; got {scene.piston.stop:g}, which leaves a box of "
                f"{high[0] - low[0]:g} x {high[1] - low[1]:g}. Let the piston stop earlier, or use fewer or smaller "
                "discs or obstacles."
            )
