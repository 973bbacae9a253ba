"""Speeds of discs relative to what the step allows, and the limit with which kernels compare them."""

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mpsim.core.columns import ranges
from mpsim.features.properties import densest_packing
from mpsim.scene.scene import Scene

# --- Speeds of the discs of a state, relative to what the step allows

DENSE = 0.7  # packing from which on discs are taken for a crystal


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
        pinched: index of a disc that surfaces are about to press through one another; -1: there is none.
        pressed: whether discs were deep in each other.
    """

    disc: int = -1
    speed: float = 0.0
    limit: float = math.inf
    between: str = ""
    collision_rate: float = 0.0
    mean_speed: float = 0.0
    smallest: float = math.inf
    when: str = ""
    pinched: int = -1
    pressed: bool = False

    def fraction(self, dt: float) -> float:
        """Displacement of the fastest disc in a step of length dt, as a fraction of its limit."""
        return self.speed * dt / self.limit

    def or_faster(self, other: "Speeds") -> "Speeds":
        """These, with the fastest disc of a moment before if it was faster (but for rounding)."""
        if other.fraction(1 + 1e-5) < self.fraction(1.0):
            return self
        return replace(other, collision_rate=self.collision_rate, mean_speed=self.mean_speed, smallest=self.smallest)


def speeds_of(
    velocity: NDArray[Any],
    radius: NDArray[np.float64],
    scene: Scene,
    time: float = 0.0,
    numbers: NDArray[np.int64] | None = None,
) -> Speeds:
    """Speeds of discs.

    Args:
        velocity: shape (N, 2) [length/time].
        radius: shape (N,) [length].
        scene: whose box it is.
        time: at which it is looked at: a wall may have moved [time].
        numbers: of the discs, shape (N,); None: all are there.
    """
    numbers, sides = np.arange(len(velocity)) if numbers is None else numbers, sides_at(scene, time)
    found = fastest_of(numbers, velocity, radius, sides, scene.periodic, float(radius.max(initial=0.0)))
    return speeds_together(*found, lambda value: [value], radius, sides)


def speeds_at_start(scene: Scene) -> Speeds:
    """Speeds of the discs of a scene, looked at piece by piece."""
    if not scene.count:
        return Speeds()
    radii, sides = scene.radii, sides_at(scene, 0.0)
    fastest, squares, largest = (), 0.0, float(radii.max())
    for first, velocity in scene._velocities_in_pieces():
        last = first + len(velocity)
        numbers = np.arange(first, last)
        found = fastest_of(numbers, velocity, radii[first:last], sides, scene.periodic, largest)
        fastest, squares = faster_of(fastest, found[0]), squares + float(found[1].sum())
    return _with_means(fastest, squares / len(radii), radii, sides)


def speeds_together(
    fastest: tuple[Speeds, ...],
    squares: NDArray[np.float64],
    all_of: Callable[[Any], list[Any]],
    radius: NDArray[np.float64],
    sides: tuple[float, float],
) -> Speeds:
    """Speeds of discs of which each of several processes has a part: what `speeds_of` finds of all of them.

    Args:
        fastest, squares: `fastest_of` the discs of this process; each disc is of one.
        all_of: what all processes hand over, in an order of theirs.
        radius: of all discs, shape (N,) [length].
        sides: width and height of the box [length].
    """
    count, told = len(radius), all_of((fastest, float(squares.max(initial=0.0))))
    fastest, largest = functools.reduce(faster_of, [each[0] for each in told]), max(each[1] for each in told)
    if not count:
        return Speeds()
    mean_square = largest
    if 0 < largest < math.inf:  # a sum of whole multiples of a unit, so small that n fit 63 bits, depends on no order
        exponent = math.frexp(largest)[1] + count.bit_length() - 62
        own = int(np.rint(np.ldexp(squares, -exponent)).astype(np.int64).sum())
        mean_square = math.ldexp(sum(all_of(own)), exponent) / count
    return _with_means(fastest, mean_square, radius, sides)


def fastest_of(
    numbers: NDArray[np.int64],
    velocity: NDArray[Any],
    radius: NDArray[np.float64],
    sides: tuple[float, float],
    periodic: tuple[bool, bool],
    largest_radius: float,
) -> tuple[tuple[Speeds, ...], NDArray[np.float64]]:
    """The fastest of some discs, and the squares of the speeds of each, shape (K,) [length^2/time^2].

    The fastest are those whose displacement in a step is the largest fraction of their limit: in any direction, and
    between two walls where these are narrow. Of equal ones the one of the lowest number.

    Args:
        numbers: of the discs, rising, shape (K,).
        velocity: shape (K, 2) [length/time].
        radius: shape (K,) [length].
        sides, periodic: of the box [length].
        largest_radius: of all discs [length].
    """
    if not len(numbers):
        return (), np.zeros(0)
    vx, vy = (np.ascontiguousarray(column, np.float64) for column in velocity.T)
    squares = vx * vx
    squares += vy * vy
    speed = np.sqrt(squares)
    worst = int((speed / radius).argmax())
    found = [Speeds(int(numbers[worst]), float(speed[worst]), float(radius[worst]))]
    for axis, (v, length) in enumerate(zip((vx, vy), sides, strict=True)):
        if periodic[axis] or length - 2 * largest_radius >= largest_radius:
            continue
        free = length - 2 * radius
        # Where there is no room at all, or rounding's worth of it, a disc stands between the walls as it should.
        free = np.where(free > 1e-6 * length, free, np.inf)
        worst = int((np.abs(v) / free).argmax())
        found.append(Speeds(int(numbers[worst]), float(abs(v[worst])), float(free[worst]), "xy"[axis]))
    return tuple(found), squares


def faster_of(some: tuple[Speeds, ...], others: tuple[Speeds, ...]) -> tuple[Speeds, ...]:
    """Of two parts' fastest discs, one for each direction, the faster ones; of a part without discs there are none."""
    if not some or not others:
        return some or others
    return tuple(
        max(pair, key=lambda speeds: (speeds.fraction(1.0), -speeds.disc)) for pair in zip(some, others, strict=True)
    )


def _with_means(
    fastest: tuple[Speeds, ...], mean_square: float, radius: NDArray[np.float64], sides: tuple[float, float]
) -> Speeds:
    """The fastest disc, with what is said of all."""
    found, mean_speed = max(fastest, key=lambda speeds: speeds.fraction(1.0)), math.sqrt(mean_square)
    rate = estimated_collision_rate(radius, mean_speed, sides)
    return replace(found, collision_rate=rate, mean_speed=mean_speed, smallest=float(radius.min()))


def sides_at(scene: Scene, time: float) -> tuple[float, float]:
    """Width and height of the box at a time [length]."""
    low, high = scene.walls_at(time)
    width, height = (high - low).tolist()
    return width, height


def estimated_collision_rate(radius: NDArray[np.float64], speed: float, sides: tuple[float, float]) -> float:
    """Collisions of a disc with others per time, after Enskog: 2 sqrt(pi) n sigma g sqrt(kT/m).

    g, the pair correlation at contact: of a fluid (Henderson 1975), or above packing 0.7 of a crystal by its free
    volume, (Z - 1) / (2 packing) with Z = 2 / (1 - packing / densest).

    Args:
        radius: of each disc, shape (N,) [length].
        speed: root mean square [length/time].
        sides: width and height of the box [length].
    """
    area = sides[0] * sides[1]
    squares = sum(float(np.square(radius[first:last]).sum()) for first, last in ranges(len(radius)))
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


# --- The speed above which a disc ends a command, with which kernels compare each disc


class SpeedLimit(NamedTuple):
    """Displacement in a step above which a disc is too fast.

    Attributes:
        fraction: of the radius; infinite: never.
        gain: speed that is added to that of each disc before [length/time].
        deep: whether discs that surfaces press, into each other or through one another, are reported.
    """

    fraction: float = math.inf
    gain: float = 0.0
    deep: bool = False

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


Fastest = tuple[int, int]
"""Of a disc that was too fast in a command: its speed over that from which on discs are too fast, times FASTEST_SCALE
(PINCHED, PRESSED: see there; 0: there was none), and its number, times -1, so that of equally fast discs the one of the
least number is the maximum."""


def fastest_in(team: NDArray[Any]) -> Fastest:
    """The fastest that some members of a team have found."""
    return max((int(each.fastest), -int(each.fastest_disc)) for each in team)
