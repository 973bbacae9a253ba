"""How fast the discs of a state are, as a fraction of what their steps allow."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.features.packing_bounds import densest_packing
from mpsim.scene.scene import Scene

Pieces = Sequence[tuple[int, int]]

DENSE = 0.7
"""Packing from which on discs are taken for a crystal."""


@dataclass(frozen=True)
class Speeds:
    """How fast the discs of a state are, compared with what a step allows.

    Attributes:
        disc: index of the one whose displacement in a step is the largest fraction of its limit; -1: there is none,
            or it is still to come.
        speed: of it, or its component between two walls [length/time].
        limit: displacement that it may make in a step: its radius, or its free distance between walls; infinite where
            there is no disc [length].
        between: "" or the axis between whose walls that is.
        collision_rate: collisions of a disc with others, estimated [1/time].
        mean_speed: root mean square [length/time].
        smallest: radius of the smallest disc [length].
        when: in words, when discs were or will be so fast; "": now.
    """

    disc: int = -1
    speed: float = 0.0
    limit: float = math.inf
    between: str = ""
    collision_rate: float = 0.0
    mean_speed: float = 0.0
    smallest: float = math.inf
    when: str = ""

    def fraction(self, dt: float) -> float:
        """Displacement of the fastest disc in a step of length dt, as a fraction of its limit."""
        return self.speed * dt / self.limit

    def or_faster(self, other: "Speeds | None") -> "Speeds":
        """These, with the fastest disc of a moment before if it was faster (but for rounding)."""
        if other is None or other.fraction(1 + 1e-5) < self.fraction(1.0):
            return self
        return replace(other, collision_rate=self.collision_rate, mean_speed=self.mean_speed, smallest=self.smallest)


def speeds_of(
    velocity: NDArray[Any],
    radius: NDArray[np.float64],
    scene: Scene,
    time: float = 0.0,
    present: NDArray[np.bool_] | None = None,
) -> Speeds:
    """Speeds of discs.

    Args:
        velocity: shape (N, 2), in the order of the scene's discs, so that no sum depends on another one [length/time].
        radius: shape (N,) [length].
        scene: whose box it is.
        time: at which it is looked at: a wall may have moved [time].
        present: which discs have not left, shape (N,); None: all are there.
    """
    if present is not None:
        index = np.flatnonzero(present)
        found = speeds_of(velocity[index], radius[index], scene, time)
        return replace(found, disc=int(index[found.disc])) if found.disc >= 0 else found
    if not len(velocity):
        return Speeds()
    sides = sides_at(scene, time)
    found, squares = _fastest(velocity, radius, sides, scene.periodic)
    return _with_means(found, squares, radius, sides, [(0, len(radius))])


def speeds_at_start(scene: Scene) -> Speeds:
    """Speeds of the discs of a scene, looked at piece by piece."""
    if not scene.count:
        return Speeds()
    radii, sides, pieces = scene.radii, sides_at(scene, 0.0), list(scene.pieces())
    found, squares = Speeds(), 0.0
    for first, velocity in scene.velocities_in_pieces():
        each, more = _fastest(velocity, radii[first : first + len(velocity)], sides, scene.periodic)
        found = max(found, replace(each, disc=first + each.disc), key=lambda speeds: speeds.fraction(1.0))
        squares += more
    return _with_means(found, squares, radii, sides, pieces)


def _fastest(
    velocity: NDArray[Any], radius: NDArray[np.float64], sides: tuple[float, float], periodic: tuple[bool, bool]
) -> tuple[Speeds, float]:
    """The disc that moves the largest fraction of its limit, and the sum of the squares of all speeds."""
    vx, vy = (np.ascontiguousarray(column, np.float64) for column in velocity.T)
    squares = vx * vx
    squares += vy * vy
    total, largest = float(squares.sum()), float(radius.max())
    speed = np.sqrt(squares, out=squares)
    worst = int(np.divide(speed, radius).argmax())
    found = Speeds(worst, float(speed[worst]), float(radius[worst]))
    for axis, (v, length) in enumerate(zip((vx, vy), sides, strict=True)):
        if periodic[axis] or length - 2 * largest >= largest:
            continue
        free = length - 2 * radius
        # Where there is no room at all, or rounding's worth of it, a disc stands between the walls as it should.
        free = np.where(free > 1e-6 * length, free, np.inf)
        worst = int((np.abs(v) / free).argmax())
        between = Speeds(worst, float(abs(v[worst])), float(free[worst]), "xy"[axis])
        found = max(found, between, key=lambda speeds: speeds.fraction(1.0))
    return found, total


def _with_means(
    found: Speeds, squares: float, radius: NDArray[np.float64], sides: tuple[float, float], pieces: Pieces
) -> Speeds:
    """The fastest disc with what is said of all: squares is the sum of those of their speeds."""
    mean_speed = math.sqrt(squares / len(radius))
    rate = estimated_collision_rate(radius, mean_speed, sides, pieces)
    return replace(found, collision_rate=rate, mean_speed=mean_speed, smallest=float(radius.min()))


def sides_at(scene: Scene, time: float) -> tuple[float, float]:
    """Width and height of the box at a time [length]."""
    low, high = scene.walls_at(time)
    width, height = (high - low).tolist()
    return width, height


def estimated_collision_rate(
    radius: NDArray[np.float64], speed: float, sides: tuple[float, float], pieces: Pieces
) -> float:
    """Collisions of a disc with others per time, after Enskog: 2 sqrt(pi) n sigma g sqrt(kT/m).

    g, the pair correlation at contact: of a fluid (Henderson 1975), or above packing 0.7 of a crystal by its free
    volume, (Z - 1) / (2 packing) with Z = 2 / (1 - packing / densest).

    Args:
        radius: of each disc, shape (N,) [length].
        speed: root mean square [length/time].
        sides: width and height of the box [length].
        pieces: first disc and the one after the last of pieces of all discs, which are summed one by one.
    """
    area = sides[0] * sides[1]
    squares = sum(float((radius[first:last] * radius[first:last]).sum()) for first, last in pieces)
    packing = math.pi * squares / area
    if speed == 0 or len(radius) < 2:
        return 0.0
    densest = densest_packing(float(radius.min()), float(radius.max()))
    if packing >= densest:
        return math.inf
    if packing <= DENSE:
        at_contact = (1 - 7 * packing / 16) / (1 - packing) ** 2
    else:
        at_contact = (2 / (1 - packing / densest) - 1) / (2 * packing)
    density = (len(radius) - 1) / area
    return 2 * math.sqrt(math.pi) * density * 2 * float(radius.mean()) * at_contact * speed / math.sqrt(2)
