"""Places of discs before the first frame: random ones without overlap, and the overlaps of given ones."""

import math

import numpy as np
from numpy.typing import NDArray

from mpsim.core.errors import InputError
from mpsim.kernels.placement import overlap_removal
from mpsim.kernels.placement.placing import EMPTY, add_sequentially, find_overlaps, sweep

LARGEST_PACKING = 0.8
SPARSE_PACKING = 0.4
"""Up to here random sequential addition needs few attempts per disc; it jams at 0.547 (Feder 1980)."""

SWEEPS = 100
"""Monte Carlo moves per disc of a dense start: enough to shuffle a fluid, quick at a million discs."""


GAP = 1e-12
"""Part of the sum of two radii by which random discs stay apart at least, so that no rounding lets them overlap."""

LOOSEST = 0.84
"""Packing at which discs thrown in at random jam (O'Hern et al., Phys. Rev. E 68, 011306, 2003)."""

TIGHT = 0.3
"""Part of the way to that packing by which discs are taken for larger while they are parted."""

BEYOND = (0.8, 0.5, 0.0)
"""How much farther than needed overlapping discs are parted, one attempt each: farther is quicker, nearer is surer."""

PARTINGS = 1000
"""Rounds of parting in one attempt; 250 were enough for 100,000 discs of two sizes at packing 0.8."""

MOST_CELLS = 100_000_000
"""Cells of the grid for equal discs, one disc each, at most; in a larger box cells are as large as its emptiness."""

CANDIDATES = 16
"""Places tried for a small disc that would start deep in a large one."""

WALLS = (False, False)


def overlaps(
    position: NDArray[np.float64],
    width: float,
    height: float,
    diameter: float | NDArray[np.float64],
    periodic: tuple[bool, bool] = WALLS,
) -> tuple[int, tuple[int, int], float]:
    """Number of overlapping pairs, the deepest pair (i < j) and its depth [length]. O(N).

    Pairs closer than rounding of their coordinates (a few units in the last place of the box) do not count.

    Args:
        position: shape (N, 2), in the box [length].
        width, height: of the box [length].
        diameter: of all discs, or of each, shape (N,) [length].
        periodic: along x and along y: a pair is then as close as its nearest images.
    """
    rounding = 8 * np.finfo(np.float64).eps * max(width, height)
    count = len(position)
    worst = np.zeros(2, np.int64)
    x, y = (np.ascontiguousarray(column, dtype=np.float64) for column in position.T)
    if np.ndim(diameter) or any(periodic):
        radius = np.broadcast_to(np.asarray(diameter, np.float64) / 2, count)
        crowd = _crowd(x, y, radius, (width, height), periodic)
        overlap_removal.link(crowd)
        pairs, depth = overlap_removal.count_overlaps(crowd, rounding, worst)
        return int(pairs), (int(worst[0]), int(worst[1])), float(depth)
    diameter = float(diameter) - rounding
    side = max(diameter, math.sqrt(width * height / max(count, 1)))
    # A box so thin that it has one row of cells has no more of them than any other: they may be wider.
    columns, rows = (min(int(length / side) + 1, count + 1) for length in (width, height))
    heads = np.full((columns, rows), EMPTY, np.int32)
    per_x, per_y = min(columns / width, 1 / side), min(rows / height, 1 / side)
    pairs, least = find_overlaps(x, y, heads, np.empty(count, np.int32), diameter, per_x, per_y, worst)
    return int(pairs), (int(worst[0]), int(worst[1])), float(diameter - least)


def _crowd(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    radius: NDArray[np.float64],
    size: tuple[float, float],
    periodic: tuple[bool, bool],
    capsules: NDArray[np.float64] | None = None,
) -> overlap_removal.Crowd:
    """Discs as the kernels of `crowding` take them: radii within a factor of two share a level and its grid."""
    binary = np.frexp(radius)[1]
    present, level = np.unique(binary, return_inverse=True)
    largest = np.array([radius[binary == power].max() for power in present], np.float64)
    counts = np.bincount(level, minlength=len(present))
    side = np.maximum(2 * largest, np.sqrt(size[0] * size[1] / np.maximum(counts, 1)))
    # A box so thin that it has one row of cells has no more of them than any other.
    columns, rows = (np.clip(length / side, 1, np.maximum(counts, 1)).astype(np.int64) for length in size)
    cells = columns * rows
    return overlap_removal.Crowd(
        x,
        y,
        np.ascontiguousarray(radius, dtype=np.float64),
        level.astype(np.int64),
        np.full(int(cells.sum()), overlap_removal.EMPTY, np.int64),
        np.full(len(x), overlap_removal.EMPTY, np.int64),
        columns,
        rows,
        np.cumsum(cells) - cells,
        largest,
        float(size[0]),
        float(size[1]),
        bool(periodic[0]),
        bool(periodic[1]),
        np.zeros((0, 5)) if capsules is None else np.array(capsules, np.float64),
    )


def random_crowd(
    radius: NDArray[np.float64],
    width: float,
    height: float,
    rng: np.random.Generator,
    periodic: tuple[bool, bool] = WALLS,
    capsules: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """Centres of discs of any radii without overlap, shape (N, 2), at random in a box that may be periodic.

    Up to SPARSE_PACKING by random sequential addition, the largest first. Denser ones start from a jittered lattice,
    are parted pair by pair until none overlap, and then take Monte Carlo steps. The same seed gives the same places.

    Args:
        radius: of each disc, shape (N,) [length].
        width, height: of the box [length].
        rng: the random numbers.
        periodic: along x and along y.
        capsules: to stay clear of, shape (K, 5): ax, ay, bx, by, radius [length].

    Raises:
        InputError: if no arrangement without overlap is found.
    """
    count = len(radius)
    if count == 0:
        return np.empty((0, 2))
    crowd = _crowd(np.zeros(count), np.zeros(count), radius, (width, height), periodic, capsules)
    packing = math.pi * float((radius**2).sum()) / (width * height)
    if not (packing <= SPARSE_PACKING and _add_all(crowd, rng)):
        if not any(_part_all(crowd, packing, beyond, rng) for beyond in BEYOND):
            raise InputError(
                f"{count} discs of packing {packing:.3g} were not brought into a box of {width:g} x {height:g} "
                f"without overlap in {len(BEYOND)} attempts. Use fewer or smaller discs, or a larger box; walls and "
                "obstacles cost space in small boxes."
            )
        longest = 2 * radius * max(0.02, 0.6 * (math.sqrt(0.9069 / packing) - 1))
        for _ in range(SWEEPS):
            overlap_removal.shuffle(crowd, rng.uniform(-1, 1, (count, 2)) * longest[:, None], 1 + GAP)
    return np.column_stack([crowd.x, crowd.y])


def displaced(
    position: NDArray[np.float64],
    radius: NDArray[np.float64],
    size: tuple[float, float],
    periodic: tuple[bool, bool],
    capsules: NDArray[np.float64],
    moves: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Centres after a move of each disc along x and one along y, shape (N, 2).

    A move that leads to an overlap or out of the box is left out.

    Args:
        position: shape (N, 2) [length].
        radius: shape (N,) [length].
        size: width and height of the box [length].
        periodic: along x and along y.
        capsules: what stands in the box, shape (K, 5): ax, ay, bx, by, radius [length].
        moves: displacements, shape (N, 2) [length].
    """
    if not len(position):
        return position
    x, y = (np.array(column, dtype=np.float64) for column in position.T)
    crowd = _crowd(x, y, radius, size, periodic, capsules)
    overlap_removal.link(crowd)
    for axis in (0, 1):
        overlap_removal.shuffle(crowd, moves * (np.arange(2) == axis), 1 + GAP)
    return np.column_stack([crowd.x, crowd.y])


def _add_all(crowd: overlap_removal.Crowd, rng: np.random.Generator) -> bool:
    """Random sequential addition, the largest first; False if the box was full before the end."""
    order = np.argsort(-crowd.radius, kind="stable")
    placed, attempts = 0, 0
    while placed < len(order) and attempts < 200 * len(order) + 1000:
        candidates = rng.random((2 * (len(order) - placed) + 16, 2))
        placed = int(overlap_removal.add_sequentially(crowd, order, placed, candidates, 1 + GAP))
        attempts += len(candidates)
    return placed == len(order)


def _part_all(crowd: overlap_removal.Crowd, packing: float, beyond: float, rng: np.random.Generator) -> bool:
    """Spread the discs evenly, then part those that overlap; False if some still do after PARTINGS rounds."""
    count = len(crowd.x)
    columns = max(round(math.sqrt(count * crowd.width / crowd.height)), 1)
    rows = math.ceil(count / columns)
    sites = np.sort(rng.permutation(columns * rows)[:count])[rng.permutation(count)]
    candidates = rng.random((count, CANDIDATES, 2))
    candidates[:, 0] = (np.column_stack(np.divmod(sites, rows)) + 0.2 + 0.6 * candidates[:, 0]) / [columns, rows]
    # Aiming at discs a little larger ends in finitely many rounds, with none quite touching.
    aim = 1 + max(TIGHT * (math.sqrt(LOOSEST / packing) - 1), 1e-4)
    crowd.head[:] = overlap_removal.EMPTY
    overlap_removal.throw(crowd, np.argsort(-crowd.radius, kind="stable"), candidates, aim)
    for done in range(PARTINGS):
        overlap_removal.part(crowd, aim, beyond)
        if done % 10 == 9 and not overlap_removal.crowded(crowd, 1 + GAP):
            return True
    return False


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
    if (width * cells_per_length + 1) * (height * cells_per_length + 1) > MOST_CELLS + 100 * count:
        return random_crowd(np.full(count, radius), width, height, rng)
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
