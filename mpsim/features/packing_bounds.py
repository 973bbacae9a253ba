"""Published upper bounds on the number of discs in a box: with walls, without, and among capsules."""

import functools
import math

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

ROUND = 33
"""Corners of the polygon that is inscribed in half a circle."""

SHRUNK = 1e-6
"""Fraction of a radius by which capsules are enlarged less: a channel just as wide as a disc must stay open."""

TOUCH = 1e-9
"""Distance, as a fraction of the coordinates, below which polygons count as touching a side or each other."""

HOLES = 100
"""Number of capsules, the largest ones, that the bound takes into account: each pair of them is tested."""


def densest_packing(smallest: float, largest: float) -> float:
    """Packing fraction above which no discs with radii from `smallest` to `largest` can be arranged in the plane.

    Florian's bound (Rend. Circ. Mat. Palermo 9, 300, 1960): no arrangement is denser than three touching discs, two of
    the largest radius and one of the smallest. For equal discs it is the hexagonal lattice (Thue 1910). Copies of a box
    side by side fill the plane, so it holds in any box, with walls and without.

    >>> round(densest_packing(1, 1), 4), round(densest_packing(0.5, 1), 4)
    (0.9069, 0.9158)
    """
    q = smallest / largest
    corner = math.pi * q * q + 2 * (1 - q * q) * math.asin(q / (1 + q))
    return corner / (2 * q * math.sqrt(2 * q + 1))


def shortest_box(radius: Floats, number: Floats, across: float, walls: bool) -> float:
    """Length below which no box between two walls, `across` wide, holds the given discs [length].

    For equal discs between four walls from Oler's inequality, which includes the space lost at walls (Acta Math. 105,
    19, 1961): n points a diameter d apart lie in a convex region of area A and perimeter P only if n <= 2 A / (sqrt(3)
    d^2) + P / (2 d) + 1. Otherwise it follows from the packing fraction.

    Args:
        radius, number: radii, and the number of discs of each, shape (K,) [length].
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


def largest_number(radius: float, low: tuple[float, float], high: tuple[float, float], capsules: Floats) -> float:
    """Upper bound on the number of equal discs between four walls and among capsules.

    Folkman and Graham (Canad. Math. Bull. 12, 745, 1969; for regions with holes Graham, Witsenhausen and Zassenhaus,
    Discrete Math. 2, 1972): n points a diameter d apart lie in a region of area A, perimeter P and Euler characteristic
    chi only if n <= 2 A / (sqrt(3) d^2) + P / (2 d) + chi. Centres lie in the box less one radius, outside capsules
    enlarged by one. Any larger region is a bound too. So each enlarged capsule is replaced by an inscribed polygon, and
    those are left out that overlap one of more weight, would not lower the bound, or are not among the largest.

    Args:
        radius: of all discs [length].
        low, high: corners (x, y) of the box [length].
        capsules: shape (K, 5): ax, ay, bx, by, radius [length].

    >>> peg = np.array([[2, 3, 2, 3, 1.9]])
    >>> round(largest_number(0.5, (0, 0), (6, 6), peg[:0]), 2), round(largest_number(0.5, (0, 0), (6, 6), peg), 2)
    (39.87, 25.23)
    """
    return _largest_number(radius, low, high, largest_capsules(capsules).tobytes())


def largest_capsules(capsules: Floats) -> Floats:
    """The HOLES longest and thickest capsules, shape (K, 5), the largest first."""
    extent = np.hypot(*(capsules[:, 2:4] - capsules[:, :2]).T) + capsules[:, 4]
    return np.asarray(capsules[np.argsort(-extent, kind="stable")[:HOLES]], np.float64)


@functools.lru_cache(maxsize=64)
def _largest_number(radius: float, low: tuple[float, float], high: tuple[float, float], capsules: bytes) -> float:
    """`largest_number` for few capsules, cached: emitters and insertions ask for it repeatedly."""
    diameter, sides = 2 * radius, np.subtract(high, low) - 2 * radius
    if (sides < 0).any():
        return 0.0
    corners = np.add(low, radius), np.subtract(high, radius)
    most = 2 * float(sides.prod()) / (math.sqrt(3) * diameter**2) + float(sides.sum()) / diameter + 1
    largest = np.frombuffer(capsules).reshape(-1, 5)
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
        if all(are_separated(holes[index], holes[counted[other]]) for other in np.flatnonzero(~beside)):
            counted.append(index)
            most -= loss
    return most


def grown(capsule: Floats, radius: float) -> Floats:
    """Corners of a polygon inscribed in a capsule (ax, ay, bx, by, radius) enlarged by a radius, shape (K, 2)."""
    (ax, ay, bx, by, own), half = capsule.tolist(), math.pi / 2
    turn = math.atan2(by - ay, bx - ax) + np.linspace(-half, half, ROUND)
    arc = (own + radius) * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return np.concatenate([arc + np.array([bx, by]), np.array([ax, ay]) - arc])


def clipped(polygon: Floats, low: Floats, high: Floats) -> Floats:
    """A convex polygon, shape (K, 2), anticlockwise, clipped to a rectangle: new corners lie exactly on its sides."""
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


def are_separated(one: Floats, other: Floats) -> bool:
    """Whether a side of one of two convex polygons, shapes (K, 2), anticlockwise, separates them."""
    for polygon, beyond in ((one, other), (other, one)):
        along = np.roll(polygon, -1, axis=0) - polygon
        outward = np.stack([along[:, 1], -along[:, 0]], axis=1)
        gap = (beyond @ outward.T).min(axis=0) - (polygon * outward).sum(axis=1)
        if (gap > TOUCH * np.abs(polygon).max() * np.hypot(*along.T)).any():
            return True
    return False


def _loss(hole: Floats, low: Floats, high: Floats, diameter: float) -> float:
    """By how many discs a convex hole, shape (K, 2), in the rectangle from low to high lowers the bound.

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
