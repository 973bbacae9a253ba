"""Places of discs before the first frame: random ones without overlap, and the overlaps of given ones."""

import math

import numpy as np
from numpy.typing import NDArray

from mpsim.errors import InputError
from mpsim.kernels.placing import EMPTY, add_sequentially, find_overlaps, sweep

LARGEST_PACKING = 0.8
SPARSE_PACKING = 0.4
"""Up to here random sequential addition needs few attempts per disc; it jams at 0.547 (Feder 1980)."""

SWEEPS = 100
"""Monte Carlo moves per disc of a dense start: enough to shuffle a fluid, quick at a million discs."""


def overlaps(
    position: NDArray[np.float64], width: float, height: float, diameter: float
) -> tuple[int, tuple[int, int], float]:
    """Number of overlapping pairs, the deepest pair (i < j) and its depth [length]. O(N).

    Pairs closer than rounding of their coordinates (a few units in the last place of the box) do not count.
    """
    count = len(position)
    diameter -= 8 * np.finfo(np.float64).eps * max(width, height)
    side = max(diameter, math.sqrt(width * height / max(count, 1)))
    heads = np.full((int(width / side) + 1, int(height / side) + 1), EMPTY, np.int32)
    worst = np.zeros(2, np.int64)
    x, y = np.ascontiguousarray(position[:, 0]), np.ascontiguousarray(position[:, 1])
    pairs, least = find_overlaps(x, y, heads, np.empty(count, np.int32), diameter, 1 / side, 1 / side, worst)
    return int(pairs), (int(worst[0]), int(worst[1])), float(diameter - least)


def random_places(
    count: int, width: float, height: float, radius: float, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Centres of `count` discs without overlap, shape (count, 2), at random in the box.

    Raises:
        InputError: if no arrangement that is tried holds so many discs.
    """
    if count == 0:
        return np.empty((0, 2))
    diameter = 2 * radius
    cells_per_length = math.sqrt(2) / diameter * (1 - 1e-12)
    grid = np.full((int(width * cells_per_length) + 1, int(height * cells_per_length) + 1), EMPTY, np.int32)
    x, y = np.empty(count), np.empty(count)
    span = np.array([width, height]) - diameter
    placed, attempts = 0, 0
    sparse = count * math.pi * radius**2 <= SPARSE_PACKING * width * height
    while sparse and placed < count and attempts < 200 * count + 1000:
        candidates = radius + rng.random((2 * (count - placed) + 16, 2)) * span
        placed = int(add_sequentially(x, y, grid, placed, candidates, diameter, cells_per_length))
        attempts += len(candidates)
    if placed == count:
        return np.column_stack([x, y])
    sites = _lattice(count, width, height, diameter)
    chosen = sites[np.sort(rng.permutation(len(sites))[:count])]
    x, y = np.ascontiguousarray(chosen[:, 0]), np.ascontiguousarray(chosen[:, 1])
    grid[:] = EMPTY
    grid[(x * cells_per_length).astype(int), (y * cells_per_length).astype(int)] = np.arange(count)
    packing = count * math.pi * radius**2 / (width * height)
    longest = diameter * max(0.02, 0.6 * (math.sqrt(0.9069 / packing) - 1))
    for _ in range(SWEEPS):
        moves = rng.uniform(-longest, longest, (count, 2))
        sweep(x, y, grid, moves, radius, width - radius, height - radius, diameter, cells_per_length)
    return np.column_stack([x, y])[rng.permutation(count)]


def _lattice(count: int, width: float, height: float, diameter: float) -> NDArray[np.float64]:
    """Sites of the widest lattice (staggered or straight rows) that holds `count` discs, shape (sites >= count, 2)."""
    free_x, free_y = width - diameter, height - diameter
    best_gap, best = -1.0, (1, 1, 0.0)
    most_rows = min(count, int(free_y / (diameter * math.sqrt(3) / 2)) + 1)
    for rows in range(1, most_rows + 1):
        columns = math.ceil(count / rows)
        for stagger in (0.0, 0.5):
            dx = free_x / max(columns - 1 + stagger, 1e-300) if columns - 1 + stagger > 0 else math.inf
            dy = free_y / (rows - 1) if rows > 1 else math.inf
            diagonal = math.hypot(stagger * dx, dy) if rows > 1 else math.inf
            gap = min(dx, diagonal, 2 * dy)
            if gap > best_gap:
                best_gap, best = gap, (rows, columns, stagger)
    if best_gap < diameter * (1 + 1e-9):
        raise InputError(
            f"{count} discs of radius {diameter / 2:g} do not fit a box of {width:g} x {height:g} in regular rows "
            f"(the best rows leave {best_gap:.6g} between centres, {diameter:g} is needed). "
            "Use fewer or smaller discs, or a larger box; walls cost space in small boxes."
        )
    rows, columns, stagger = best
    row = np.repeat(np.arange(rows), columns)
    column = np.tile(np.arange(columns), rows) + stagger * (row % 2)
    step_x = free_x / (columns - 1 + stagger) if columns - 1 + stagger > 0 else 0.0
    step_y = free_y / (rows - 1) if rows > 1 else 0.0
    return np.column_stack([column * step_x, row * step_y]).astype(np.float64) + diameter / 2
