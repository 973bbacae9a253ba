"""Where discs may be and are before the first frame: walls of the box, random places, overlaps."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mpsim.core.state import State, moved_into
from mpsim.errors import InputError
from mpsim.features.capsules import gaps, with_images
from mpsim.kernels import placement
from mpsim.kernels.geometry import POLYGON, RADIUS, ROW
from mpsim.kernels.placement import EMPTY, sweep

if TYPE_CHECKING:
    from mpsim.scene.scene import Scene

# --- Where the walls of a scene's box are, and whether discs are between them; states of boxes that lie elsewhere


def placed(state: State, scene: Scene) -> State:
    """A state in the coordinates of its scene, each disc at its image in the box.

    A state of a file has a box of its own, which may begin anywhere, and discs that other programs have not wrapped.
    Walls at rest coincide. A state without a box has that of the scene.

    >>> from mpsim import Scene
    >>> scene = Scene(width=4, height=4, position=[[1, 1]], velocity=[[0, 0]], radius=0.5, boundary="periodic")
    >>> placed(State(np.array([[-1.0, 11.0]]), np.zeros((1, 2)), box=(-2, 2, 2, 6)), scene).position.tolist()
    [[1.0, 1.0]]
    """
    box = scene.box if state.box is None else state.box
    corner, moving = [box[0], box[2]], [wall.edge for wall in scene._moving_walls]
    for low in (0, 2):
        if low in moving:  # of two walls that move, none tells where the box begins: as in states of this scene
            corner[low // 2] = 0.0 if low + 1 in moving else box[low + 1] - (scene.width, scene.height)[low // 2]
    return moved_into(state, box, scene.periodic, (corner[0], corner[1]))


# --- Positions of discs before the first frame: random ones without overlap, and the overlaps of given ones

LARGEST_PACKING = 0.8
SPARSE_PACKING = 0.4
"""Packing up to which random sequential addition needs few attempts per disc; it jams at 0.547 (Feder 1980)."""

SWEEPS = 100
"""Monte Carlo moves per disc of a dense start: enough to shuffle a fluid, quick at a million discs."""

REACH = 4
"""Distance from an obstacle at which discs may feel it while they are enlarged, in radii of the largest."""

GAP = 1e-12
"""Least gap between random discs, as a fraction of the sum of their radii, so that no rounding makes them overlap."""

JAMMING = 0.84
"""Packing fraction at which random arrangements of discs jam (O'Hern et al., Phys. Rev. E 68, 011306, 2003)."""

ENLARGEMENT = 0.3
"""Fraction of the growth from the packing wanted to JAMMING by which radii are enlarged while overlaps are removed."""

OVERSHOOT = (0.8, 0.5, 0.0)
"""How much farther than needed overlapping discs are moved apart, one attempt each: more is quicker, less is safer."""

REMOVAL_ROUNDS = 1000
"""Rounds of overlap removal in one attempt; 250 were enough for 100,000 discs of two sizes at packing 0.8."""

ROOM = 1e-3
"""Relative enlargement of the radii while discs are pushed aside, so that finitely many rounds are enough."""

PUSHES, PUSH_ROUNDS = 6, 60
"""Attempts to push discs aside, and rounds of each."""

MOST_CELLS = 100_000_000
"""Largest number of cells of the grid for equal discs, one disc each; a larger box needs coarser cells."""

CANDIDATES = 16
"""Positions tried for a small disc, of which the one with least overlap is taken."""

WALLS = (False, False)

TOUCHING = 8
"""Overlaps of up to this many units in the last place of the box's size count as touching: the rounding error of two
coordinates. Less would report discs that were pushed exactly apart, more would hide real overlaps."""


@dataclass(frozen=True)
class Overlap:
    """Overlapping pairs of discs.

    Attributes:
        pairs: number of pairs closer than the sum of their radii.
        largest: depth of the deepest pair, sum of radii minus distance [length]; 0 without pairs.
        mean: mean depth of the overlapping pairs [length]; 0 without pairs.
        worst: the deepest pair, (i, j) with i < j; None without pairs.
    """

    pairs: int
    largest: float
    mean: float
    worst: tuple[int, int] | None


def overlaps(
    position: NDArray[np.float64],
    radius: float | NDArray[np.float64],
    size: tuple[float, float],
    periodic: tuple[bool, bool] = WALLS,
    rounding: float | None = None,
) -> Overlap:
    """The overlapping pairs of discs at positions, shape (N, 2). O(N).

    radius: of all discs, or of each, shape (N,) [length]. rounding: depth up to which discs touch [length]; None: that
    of float64 coordinates in the box.
    """
    slack = TOUCHING * float(np.finfo(np.float64).eps) * max(size) if rounding is None else rounding
    worst = np.zeros(2, np.int64)
    x, y = (np.ascontiguousarray(column, dtype=np.float64) for column in position.T)
    discs = _by_size(x, y, np.broadcast_to(np.asarray(radius, np.float64), len(position)), size, periodic)
    placement.link(discs)
    pairs, largest, total = placement.count_overlaps(discs, slack, worst)
    i, j = worst.tolist()
    return Overlap(int(pairs), float(largest), float(total) / max(pairs, 1), (i, j) if pairs else None)


def _by_size(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    radius: NDArray[np.float64],
    size: tuple[float, float],
    periodic: tuple[bool, bool],
    capsules: NDArray[np.float64] | None = None,
) -> placement.Crowd:
    """Discs as `overlap_removal` takes them: radii within a factor of two share a level and its grid."""
    binary = np.frexp(radius)[1]
    present, level = np.unique(binary, return_inverse=True)
    largest = np.array([radius[binary == power].max() for power in present], np.float64)
    counts = np.bincount(level, minlength=len(present))
    side = np.maximum(2 * largest, np.sqrt(size[0] * size[1] / np.maximum(counts, 1)))
    # In a thin box, too, no level has more cells than about one per disc.
    columns, rows = (np.clip(length / side, 1, np.maximum(counts, 1)).astype(np.int64) for length in size)
    cells, solid = columns * rows, np.zeros((0, ROW)) if capsules is None else capsules
    images = with_images(solid, size, periodic, REACH * float(largest.max(initial=0.0)))
    seen = solid[images.source]
    seen[images.shift.any(axis=1), POLYGON] = 0  # what is in the box is in no image
    return placement.Crowd(
        x,
        y,
        np.ascontiguousarray(radius, dtype=np.float64),
        level.astype(np.int64),
        np.full(int(cells.sum()), placement.EMPTY, np.int64),
        np.full(len(x), placement.EMPTY, np.int64),
        columns,
        rows,
        np.cumsum(cells) - cells,
        largest,
        float(size[0]),
        float(size[1]),
        bool(periodic[0]),
        bool(periodic[1]),
        seen,
        images.shift,
    )


def random_polydisperse(
    radius: NDArray[np.float64],
    width: float,
    height: float,
    rng: np.random.Generator,
    periodic: tuple[bool, bool] = WALLS,
    capsules: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """Random centres of discs of any radii without overlap, shape (N, 2), in a box that may be periodic.

    Up to SPARSE_PACKING, discs are placed by random sequential addition, the largest first. Denser arrangements start
    from a jittered lattice; overlaps are removed pair by pair, and Monte Carlo steps follow. The same seed gives the
    same positions. radius: of each disc, shape (N,) [length]. capsules: obstacles, shape (K, ROW).
    """
    count = len(radius)
    if count == 0:
        return np.empty((0, 2))
    discs = _by_size(np.zeros(count), np.zeros(count), radius, (width, height), periodic, capsules)
    packing = math.pi * float((radius**2).sum()) / area_of(width, height, discs.capsule)
    if not (packing <= SPARSE_PACKING and _add_all(discs, rng)):
        if not any(_remove_overlaps(discs, packing, overshoot, rng) for overshoot in OVERSHOOT):
            raise InputError(
                f"{count} discs of packing {packing:.3g} could not be placed in a box of {width:g} x {height:g} "
                f"without overlap in {len(OVERSHOOT)} attempts. Use fewer or smaller discs, or a larger box, which "
                "Scene.compressed can shrink; walls and obstacles take up space in small boxes."
            )
        longest = 2 * radius * max(0.02, 0.6 * (math.sqrt(0.9069 / packing) - 1))
        for _ in range(SWEEPS):
            placement.shuffle(discs, rng.uniform(-1, 1, (count, 2)) * longest[:, None], 1 + GAP)
    return np.column_stack([discs.x, discs.y])


def area_of(width: float, height: float, capsules: NDArray[np.float64]) -> float:
    """Area of a rectangle, or of the smallest container if that is less [length^2]."""
    return min([width * height, *(math.pi * radius**2 for radius in capsules[:, RADIUS] if radius < 0)])


def displaced(
    position: NDArray[np.float64],
    radius: NDArray[np.float64],
    size: tuple[float, float],
    periodic: tuple[bool, bool],
    capsules: NDArray[np.float64],
    moves: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Centres after moving each disc along x, then along y, shape (N, 2).

    A move that leads to an overlap or out of the box is rejected. moves: displacements, shape (N, 2) [length].
    capsules: obstacles, shape (K, ROW).
    """
    if not len(position):
        return position
    x, y = (np.array(column, dtype=np.float64) for column in position.T)
    discs = _by_size(x, y, radius, size, periodic, capsules)
    placement.link(discs)
    for axis in (0, 1):
        placement.shuffle(discs, moves * (np.arange(2) == axis), 1 + GAP)
    return np.column_stack([discs.x, discs.y])


def pushed_aside(
    position: NDArray[np.float64],
    radius: NDArray[np.float64],
    size: tuple[float, float],
    periodic: tuple[bool, bool],
    capsules: NDArray[np.float64],
    scale: float,
) -> NDArray[np.float64] | None:
    """Centres of discs after moving those apart that overlap each other or capsules, shape (N, 2); None: no room.

    A disc that is trapped between capsules and walls begins again from a random place beside its own.

    The arguments are those of `displaced`; scale: factor of the radii, a little above 1, for which there must be room.
    """
    rng, places = np.random.default_rng(0), position
    edge = np.where(periodic, 0.0, radius[:, None])
    for attempt in range(PUSHES):
        x, y = np.array(places.T, np.float64, order="C")
        discs = _by_size(x, y, radius, size, periodic, capsules)
        placement.link(discs)
        for _ in range(PUSH_ROUNDS):
            if not placement.crowded(discs, scale):
                return np.column_stack([discs.x, discs.y])
            placement.part(discs, scale * (1 + ROOM), 0.0)
        places = np.column_stack([discs.x, discs.y])
        trapped = gaps(places[:, None], radius[:, None], capsules).min(axis=1, initial=np.inf)[:, None] < 0
        jumps = (1 + attempt / 2) * radius[:, None] * rng.uniform(-1, 1, places.shape)
        places = np.clip(places + trapped * jumps, edge, np.array(size) - edge)
    return None


def _add_all(discs: placement.Crowd, rng: np.random.Generator) -> bool:
    """Random sequential addition, the largest first; False if not all discs could be placed."""
    order = np.argsort(-discs.radius, kind="stable")
    placed, attempts = 0, 0
    while placed < len(order) and attempts < 200 * len(order) + 1000:
        candidates = rng.random((2 * (len(order) - placed) + 16, 2))
        placed = int(placement.add_sequentially(discs, order, placed, candidates, 1 + GAP))
        attempts += len(candidates)
    return placed == len(order)


def _remove_overlaps(discs: placement.Crowd, packing: float, overshoot: float, rng: np.random.Generator) -> bool:
    """Spread the discs evenly, then remove overlaps; False if some are left after REMOVAL_ROUNDS."""
    count = len(discs.x)
    columns = max(round(math.sqrt(count * discs.width / discs.height)), 1)
    rows = math.ceil(count / columns)
    sites = np.sort(rng.permutation(columns * rows)[:count])[rng.permutation(count)]
    candidates = rng.random((count, CANDIDATES, 2))
    candidates[:, 0] = (np.column_stack(np.divmod(sites, rows)) + 0.2 + 0.6 * candidates[:, 0]) / [columns, rows]
    # With slightly enlarged radii finitely many rounds are enough, and no discs touch in the end.
    scale = 1 + max(ENLARGEMENT * (math.sqrt(JAMMING / packing) - 1), 1e-4)
    discs.head[:] = placement.EMPTY
    placement.throw(discs, np.argsort(-discs.radius, kind="stable"), candidates, scale)
    for done in range(REMOVAL_ROUNDS):
        placement.part(discs, scale, overshoot)
        if done % 10 == 9 and not placement.crowded(discs, 1 + GAP):
            return True
    return False


def random_places(
    count: int, width: float, height: float, radius: float, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Random centres of equal discs without overlap, shape (count, 2), between four walls.

    Raises:
        InputError: if none of the lattices tried holds that many discs.
    """
    if count == 0:
        return np.empty((0, 2))
    diameter, radii = 2 * radius, np.full(count, radius)
    cells_per_length = math.sqrt(2) / diameter * (1 - 1e-12)
    if (width * cells_per_length + 1) * (height * cells_per_length + 1) > MOST_CELLS + 100 * count:
        return random_polydisperse(radii, width, height, rng)
    if count * math.pi * radius**2 <= SPARSE_PACKING * width * height:
        discs = _by_size(np.zeros(count), np.zeros(count), radii, (width, height), WALLS)
        if _add_all(discs, rng):
            return np.column_stack([discs.x, discs.y])
    sites = _lattice(count, width, height, diameter)
    chosen = sites[np.sort(rng.permutation(len(sites))[:count])]
    x, y = np.ascontiguousarray(chosen[:, 0]), np.ascontiguousarray(chosen[:, 1])
    grid = np.full((int(width * cells_per_length) + 1, int(height * cells_per_length) + 1), EMPTY, np.int32)
    grid[(x * cells_per_length).astype(int), (y * cells_per_length).astype(int)] = np.arange(count)
    packing = count * math.pi * radius**2 / (width * height)
    longest = diameter * max(0.02, 0.6 * (math.sqrt(0.9069 / packing) - 1))
    for _ in range(SWEEPS):
        moves = rng.uniform(-longest, longest, (count, 2))
        sweep(x, y, grid, moves, radius, width - radius, height - radius, diameter, cells_per_length)
    return np.column_stack([x, y])[rng.permutation(count)]


def _lattice(count: int, width: float, height: float, diameter: float) -> NDArray[np.float64]:
    """Sites of the widest lattice, of staggered or straight rows, that holds `count` discs: shape (>= count, 2)."""
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
            "Use fewer or smaller discs, or a larger box, which Scene.compressed can shrink; walls take up space in "
            "small boxes."
        )
    rows, columns, stagger = best
    row = np.repeat(np.arange(rows), columns)
    column = np.tile(np.arange(columns), rows) + stagger * (row % 2)
    step_x = free_x / (columns - 1 + stagger) if columns - 1 + stagger > 0 else 0.0
    step_y = free_y / (rows - 1) if rows > 1 else 0.0
    return np.column_stack([column * step_x, row * step_y]).astype(np.float64) + diameter / 2
