"""Whether there is room for discs: clear of obstacles, and where a piston stops."""

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mpsim.errors import InputError
from mpsim.features import discs_in_obstacles

if TYPE_CHECKING:
    from mpsim.scene import Scene


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


def shortest_box(radius: NDArray[np.float64], number: NDArray[np.float64], across: float, walls: bool) -> float:
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


def check_clear(scene: "Scene", name: str, position: NDArray[np.float64], radius: NDArray[np.float64]) -> None:
    """Refuse discs that overlap an obstacle, which would put them beside it.

    Args:
        scene: whose box it is.
        name: of the argument, for the text of the error.
        position: centres, shape (N, 2) [length].
        radius: one each, shape (N,) [length].

    Raises:
        InputError: naming the disc that is deepest in an obstacle.
    """
    size = (scene.width, scene.height)
    discs, disc, owner, depth = discs_in_obstacles(position, radius, scene.obstacles, size, scene.periodic)
    if discs:
        raise InputError(
            f"{name}[{disc}] must be one radius from every obstacle; got {tuple(position[disc].tolist())}, "
            f"{depth:.3g} inside obstacles[{owner}] with radius {radius[disc]:g}. Move the disc or the obstacle."
        )


def check_end(scene: "Scene", name: str, radius: NDArray[np.float64], number: NDArray[np.float64]) -> None:
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
