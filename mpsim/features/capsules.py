"""Capsules (segments with a radius), of which all obstacles are made: distances to them, and those near a point.

A capsule is a row of numbers, named in `kernels.geometry`; one of length 0 is a disc, and with a radius below 0 a
container: a circle that is solid outside. Nothing here compares every disc with every capsule: time and memory grow
with the number of capsules and of close pairs.
"""

import math
from collections.abc import Callable, Iterator
from itertools import pairwise, product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mpsim.core.checks import Floats
from mpsim.errors import InputError
from mpsim.kernels.geometry import ENDS, POLYGON, RADIUS, ROW, concerns

Integers = NDArray[np.int64]
Pairs = tuple[Integers, Integers]

CELLS_PER_CAPSULE = 16
"""Grid cells per capsule, about."""

MOST_LISTED = 2**23
"""Entries of all cell lists together, about; LISTED_EACH adds to it. Making them takes less than a second. A grid of
CELLS_PER_CAPSULE has more only if capsules fill the box several hundred times over, or thousands cross all of it."""

LISTED_EACH = 32
"""Further entries allowed per capsule: as many as discs on a lattice need that touch each other."""

MOST_COMPARED = 2**31
"""Largest number of pairs of a disc and a capsule near it that are compared: a few minutes."""

MOST_PAIRS = 1_000_000
"""Pairs of a capsule and a cell or disc that are handled together: about 100 MB."""

FEW_DISCS = 64
"""Number of discs up to which comparing each with every capsule is quicker than making a grid of all."""


class Images(NamedTuple):
    """Capsules with their images beyond periodic borders.

    capsule: shape (M, ROW). source: index of the capsule that each is an image of, shape (M,). shift:
    displacement of the image, shape (M, 2) [length].
    """

    capsule: Floats
    source: Integers
    shift: Floats


class CellLists(NamedTuple):
    """A grid over the box: which capsules are near each cell, in ascending order.

    near: where the list of each cell begins in `listed`, column-major, shape (columns * rows + 1,). grid: columns and
    rows. per_length: cells per length along x and y [1/length].
    """

    near: NDArray[np.int32]
    listed: NDArray[np.int32]
    grid: Integers
    per_length: Floats


def of_discs(position: ArrayLike, radius: ArrayLike) -> Floats:
    """Discs, of one radius or one each, as capsules, shape (N, ROW)."""
    places = np.asarray(position)
    found = np.zeros((len(places), ROW))
    found[:, :2] = found[:, 2:4] = places
    found[:, RADIUS] = radius
    return found


def shifted(capsules: Floats, by: Floats) -> Floats:
    """Capsules displaced by (x, y) [length]."""
    found = capsules.copy()
    found[:, ENDS] += np.tile(by, 2)
    return found


def polygons(capsules: Floats) -> list[slice]:
    """The rows of each polygon that is solid inside."""
    number = capsules[:, POLYGON]
    first = np.flatnonzero(np.append(0.0, number[:-1]) != number).tolist()
    return [slice(a, b) for a, b in pairwise([*first, len(number)]) if number[a] > 0]


def distance(position: Floats, capsules: Floats) -> Floats:
    """Distance from centres (..., 2) to surfaces of capsules (..., ROW), negative where solid, shape (...) [length]."""
    a, radius = capsules[..., :2], capsules[..., RADIUS]
    along, r = capsules[..., 2:4] - a, position - a
    squared = along[..., 0] ** 2 + along[..., 1] ** 2
    fraction = (r[..., 0] * along[..., 0] + r[..., 1] * along[..., 1]) / np.where(squared > 0, squared, 1)
    gap = r - np.clip(fraction, 0, 1)[..., None] * along
    away = np.hypot(gap[..., 0], gap[..., 1])
    return np.where(radius < 0, -away, away) - radius


def gaps(position: Floats, radius: Any, capsules: Floats) -> Floats:
    """Distance between discs and capsules, negative where they overlap, infinite if it does not concern them."""
    return np.where(concerns(capsules, ..., radius), distance(position, capsules) - radius, np.inf)


def is_within(position: Floats, sides: Floats) -> NDArray[np.bool_]:
    """Whether points, shape (N, 2), are in a polygon, whose sides are capsules, shape (K, ROW) [length]."""
    (x, y), inside = position.T, np.zeros(len(position), bool)
    for ax, ay, bx, by in sides[:, ENDS].tolist():
        if ay != by:
            inside ^= ((ay > y) != (by > y)) & (x < ax + (y - ay) * (bx - ax) / (by - ay))
    return inside


def with_images(capsules: Floats, size: tuple[float, float], periodic: tuple[bool, bool], reach: float) -> Images:
    """Capsules, and their images one period away along periodic axes if a disc in the box can touch them.

    A container, which does not cross such an axis, has none. size: width and height of the box. reach: radius of the
    largest disc [length].
    """
    found = Images(capsules, np.arange(len(capsules)), np.zeros((len(capsules), 2)))
    for axis, length in enumerate(size):
        if periodic[axis] and len(capsules):
            step = length * np.eye(2)[axis]
            moved = [shifted(found.capsule, sign * step) for sign in (1, -1)]
            shift = np.concatenate([found.shift, found.shift + step, found.shift - step])
            every = Images(np.concatenate([found.capsule, *moved]), np.tile(found.source, 3), shift)
            ends, margin = every.capsule[:, [axis, axis + 2]], reach + every.capsule[:, RADIUS]
            near = (ends.max(axis=1) > -margin) & (ends.min(axis=1) < length + margin)
            near = np.where(every.capsule[:, RADIUS] < 0, ~shift.any(axis=1), near)
            found = Images(every.capsule[near], every.source[near], every.shift[near])
    return found


def next_ends(capsules: Floats) -> NDArray[np.int32]:
    """For each end, 2 k (a) and 2 k + 1 (b), the next one at its place with its radius, in a circle, shape (2 K,).

    >>> next_ends(np.array([[0.0, 0, 1, 0, 0], [1, 0, 2, 1, 0], [1, 0, 3, 0, 0.5]])).tolist()
    [0, 2, 1, 3, 4, 5]
    """
    ends = _ends(capsules)
    order = np.lexsort(ends.T)
    begins = np.append(True, (ends[order[1:]] != ends[order[:-1]]).any(axis=1))
    following, found = np.roll(order, -1), np.empty(len(order), np.int32)
    following[np.roll(begins, -1)] = order[begins]
    found[order] = following
    return found


def _ends(capsules: Floats) -> Floats:
    """Place and radius of each end, a and b of each capsule in turn, shape (2 K, 3) [length]."""
    return np.column_stack([capsules[:, ENDS].reshape(-1, 2), np.repeat(capsules[:, RADIUS], 2)])


def cut_at_ends(capsules: Floats, lists: CellLists, size: tuple[float, float]) -> Floats:
    """Halves of the segments on which ends of others lie, each from such an end, to be joined by `next_ends`.

    A wall below a floor has its end on it, as ends that differ by rounding lie on each other: neither sticks out.
    capsules: images included. lists: `cell_lists` of them. size: width and height of the box [length].
    """
    straight, found = (capsules[:, :2] != capsules[:, 2:4]).any(axis=1), [np.zeros((0, ROW))]
    if straight.any():
        ends = _ends(capsules)
        slack = 8 * np.finfo(np.float64).eps * max(size)
        low, high = (bound(capsules[:, :2], capsules[:, 2:4]) for bound in (np.minimum, np.maximum))
        for end, index in _listed_pairs(ends[:, :2], lists):
            near = straight[index] & (ends[end, 2] == capsules[index, RADIUS])
            for axis in range(2):
                near &= (ends[end, axis] >= low[index, axis] - slack) & (ends[end, axis] <= high[index, axis] + slack)
            place, line = ends[end[near]], capsules[index[near]]
            thin = line.copy()
            thin[:, RADIUS] = 0
            on = distance(place[:, :2], thin) <= slack
            on &= (place[:, :2] != line[:, :2]).any(axis=1) & (place[:, :2] != line[:, 2:4]).any(axis=1)
            for other in (line[on, :2], line[on, 2:4]):
                half = line[on]
                half[:, :2], half[:, 2:4] = place[on, :2], other
                found.append(half[np.hypot(*(half[:, 2:4] - half[:, :2]).T) > slack])
    halves = np.concatenate(found)
    return halves[np.unique(halves[:, : RADIUS + 1], axis=0, return_index=True)[1]]


def cell_lists(capsules: Floats, size: tuple[float, float], reach: float) -> CellLists:
    """A grid whose cells list every capsule that a disc with its centre in the cell can touch.

    capsules: images included. size: width and height of the box. reach: radius of the largest disc [length].
    """
    side = max(2 * reach, math.sqrt(size[0] * size[1] / (CELLS_PER_CAPSULE * (len(capsules) + 1))))
    side = max(side, max(size) * 8 / _most(capsules))  # of a channel 10^16 times as long as it is wide, too

    def grid(k: int) -> tuple[Integers, Floats]:
        number = np.array([max(int(length / (side * 2.0**k)), 1) for length in size])
        return number, number / np.array(size)

    return _lists(capsules, reach, grid)[0]


def lists_of_cells(
    capsules: Floats, size: tuple[float, float], reach: float, cells: tuple[int, int]
) -> tuple[CellLists, int]:
    """`cell_lists` for a grid of columns and rows: (lists, shift), each list that of 2^shift cells along each axis."""
    finest = np.array(cells)
    return _lists(capsules, reach, lambda k: (-(-finest >> k), finest / (2.0**k * np.array(size))))


def _most(capsules: Floats) -> int:
    return MOST_LISTED + LISTED_EACH * len(capsules)


def _lists(capsules: Floats, reach: float, grid: Callable[[int], tuple[Integers, Floats]]) -> tuple[CellLists, int]:
    """The lists of the first grid for which they are short enough, and its number.

    Each grid is coarser than the one before: columns and rows, and cells per length. Where capsules overlap, small
    cells would each list nearly all of them.
    """
    which = 0
    while True:
        number, per_length = grid(which)
        # A disc may be a rounding outside its cell; a thousandth of the cell is far more than that.
        margin = reach + math.hypot(*(0.5 / per_length)) * 1.001
        if number.prod() == 1 or _cells_in_reach(capsules, margin, per_length, number) <= _most(capsules):
            break
        which += 1
    columns, rows = number.tolist()
    pairs = [cell * len(capsules) + index for index, cell in _cells_near(capsules, margin, per_length, columns, rows)]
    every = np.concatenate([np.zeros(0, np.int64), *pairs])
    del pairs
    every.sort()
    cell, index = np.divmod(every, max(len(capsules), 1))
    near = np.append(0, np.cumsum(np.bincount(cell, minlength=columns * rows)))
    ordered = np.append(index, 0).astype(np.int32)
    return CellLists(near.astype(np.int32), ordered, number, per_length), which


def _cells_in_reach(capsules: Floats, margin: float, per_length: Floats, number: Integers) -> int:
    """About how many cells are within `margin` of the surface of a capsule, summed over all capsules.

    For each the area of the capsule enlarged by the margin, or of its bounding rectangle in the box, if that is less.
    A sum of whole numbers, each computed by operations that round alike on every machine, so that the grid is the same.
    """
    with np.errstate(over="ignore"):  # a radius may be as large as a float can be
        reach = np.minimum((margin + _extent(capsules)[:, None]) * per_length, number)
    ends = capsules[:, ENDS].reshape(-1, 2, 2) * per_length
    inside = np.clip([ends.min(axis=1) - reach, ends.max(axis=1) + reach], 0, number)
    across = (ends[:, 1] - ends[:, 0]) * reach[:, ::-1]
    grown = math.pi * reach.prod(axis=1) + 2 * np.sqrt(across[:, 0] ** 2 + across[:, 1] ** 2)
    return int(np.ceil(np.minimum((inside[1] - inside[0]).prod(axis=1), grown)).astype(np.int64).sum())


def _extent(capsules: Floats) -> Floats:
    """Distance up to which each is solid: its radius, infinite for a container, shape (K,) [length]."""
    return np.where(capsules[:, RADIUS] < 0, np.inf, capsules[:, RADIUS])


class CapsuleIndex:
    """Capsules in a box, for repeated queries of how deep discs overlap them.

    The first FEW_DISCS discs are compared with every capsule; then discs of similar size share a grid, which is kept.
    """

    def __init__(self, capsules: Floats, size: tuple[float, float], periodic: tuple[bool, bool]):
        self._capsules = capsules
        self._filled = polygons(capsules)
        self._box = size, periodic
        self._asked = 0
        self._grids: dict[int, tuple[Images, CellLists]] = {}

    def depths(self, position: Floats, radius: Floats) -> Floats:
        """How deep each disc in the box is in what it overlaps most, images included; 0 outside all, shape (N,).

        Raises:
            InputError: if more than MOST_COMPARED pairs of a disc and a capsule are near each other.
        """
        depth, powers = np.zeros(len(position)), np.frexp(radius)[1]
        self._asked += len(position)
        if self._asked <= FEW_DISCS:
            powers[:] = powers.max(initial=0)
        for power in np.unique(powers).tolist():
            images, lists = self._near(power)
            discs = np.flatnonzero(powers == power)
            for number, capsule in _listed_pairs(position[discs], lists):
                # The disc is shifted, not the capsule: rounded as its own coordinates are.
                place, rows = position[discs[number]] - images.shift[capsule], self._capsules[images.source[capsule]]
                np.maximum.at(depth, discs[number], -gaps(place, radius[discs[number]], rows))
        shifts = [(0.0, -length, length) if wraps else (0.0,) for length, wraps in zip(*self._box, strict=True)]
        for part, shift in product(self._filled, product(*shifts)):
            sides = self._capsules[part]
            inside = np.flatnonzero(is_within(position - shift, sides) & concerns(sides, 0, radius))
            if len(inside):
                away = distance(position[inside, None] - shift, sides).min(axis=1) + 2 * sides[0, RADIUS]
                depth[inside] = np.maximum(depth[inside], away + radius[inside])
        return depth

    def _near(self, power: int) -> tuple[Images, CellLists]:
        """Capsules with images, and those near each place, for discs of radii below 2^power."""
        if power in self._grids:
            return self._grids[power]
        reach = math.ldexp(1.0, power)
        images = with_images(self._capsules, *self._box, reach)
        if self._asked <= FEW_DISCS:
            every = np.arange(len(images.capsule), dtype=np.int32)
            return images, CellLists(np.array([0, len(every)], np.int32), every, np.array([1, 1]), np.zeros(2))
        self._grids[power] = images, cell_lists(images.capsule, self._box[0], reach)
        return self._grids[power]


def _listed_pairs(position: Floats, lists: CellLists) -> Iterator[Pairs]:
    """Discs and the capsules that their cells list, in chunks of pairs: indices of both."""
    column, row = np.clip(position * lists.per_length, 0, lists.grid - 1).astype(np.int64).T
    cell = column * lists.grid[1] + row
    first, last = (lists.near[each].astype(np.int64) for each in (cell, cell + 1))
    compared = int((last - first).sum())
    if compared > MOST_COMPARED:
        raise InputError(
            f"obstacles must not lie on each other so much that more than {MOST_COMPARED:,} pairs of a disc and "
            f"an obstacle are near; got {compared:,} of {len(position):,} discs. Use fewer or smaller obstacles."
        )
    for chosen in _chunks(last - first) if compared else ():
        disc, place = _expanded(first[chosen], last[chosen])
        yield np.arange(len(position))[chosen][disc], lists.listed[place].astype(np.int64)


def _cells_near(capsules: Floats, margin: float, per_length: Floats, columns: int, rows: int) -> Iterator[Pairs]:
    """Capsules, and column-major numbers of the cells whose centre is within `margin` of their surface.

    First the columns that a capsule reaches, then the rows in each of them: a long oblique capsule is near few of the
    cells in its bounding rectangle.
    """
    with np.errstate(over="ignore"):  # a radius may be as large as a float can be
        reach = margin + _extent(capsules)
        left = np.minimum(capsules[:, 0], capsules[:, 2]) - reach
        right = np.maximum(capsules[:, 0], capsules[:, 2]) + reach
        first, last = _cells(left, right, per_length[0], columns)
    for some in _chunks(last - first):
        index, column = _expanded(first[some], last[some])
        index = index + some.start
        with np.errstate(over="ignore"):
            low, high = _heights(capsules[index], (column + 0.5) / per_length[0], reach[index])
            bottom, top = _cells(low, high, per_length[1], rows)
        for few in _chunks(top - bottom):
            which, row = _expanded(bottom[few], top[few])
            which = which + few.start
            centre = np.stack([column[which], row], axis=1) + 0.5
            near = distance(centre / per_length, capsules[index[which]]) <= margin
            yield index[which][near], (column[which] * rows + row)[near]


def _heights(capsules: Floats, x: Floats, reach: Floats) -> tuple[Floats, Floats]:
    """Least and largest y at which a capsule can be within `reach` of the line at x, shapes (M,) [length]."""
    ax, ay, bx, by = capsules[:, ENDS].T
    wider = reach * (1 + 1e-9) + 1e-9 * np.abs(x)  # rounding must not exclude what is just within
    run = bx - ax
    ends = [
        np.where(run == 0, end, np.clip((x + side - ax) / np.where(run == 0, 1, run), 0, 1)) * (by - ay) + ay
        for side, end in ((-wider, 0.0), (wider, 1.0))
    ]
    return np.minimum(*ends) - wider, np.maximum(*ends) + wider


def _cells(low: Floats, high: Floats, per_length: float, number: int) -> tuple[Integers, Integers]:
    """The first cell between two coordinates along an axis, and the one after the last."""
    first = np.clip(low * per_length, 0, number).astype(np.int64)
    return first, np.minimum(np.clip(high * per_length, -1, number).astype(np.int64) + 1, number)


def _expanded(first: Integers, last: Integers) -> tuple[Integers, Integers]:
    """The whole numbers from first[i] to last[i] - 1 for each i: the values of i, and the numbers."""
    length = np.maximum(last - first, 0)
    which = np.repeat(np.arange(len(first)), length)
    return which, np.arange(len(which)) - np.repeat(np.cumsum(length) - length - first, length)


def _chunks(lengths: NDArray[Any]) -> Iterator[slice]:
    """Consecutive slices of elements whose lengths add up to at most MOST_PAIRS, or of a single longer one."""
    total = np.cumsum(np.maximum(lengths, 0))
    start = 0
    while start < len(total):
        before = int(total[start - 1]) if start else 0
        stop = max(int(np.searchsorted(total, before + MOST_PAIRS, side="right")), start + 1)
        yield slice(start, stop)
        start = stop


class Deepest(NamedTuple):
    """The disc that overlaps an obstacle most.

    number: of discs that overlap one. disc: index of the deepest one. where: name of its obstacle. depth: [length].
    """

    number: int
    disc: int
    where: str
    depth: float


def check_clear(found: Deepest | None, name: str, position: Floats, radius: Floats) -> None:
    """Refuse discs that overlap an obstacle, of which one is the deepest. name: of the argument."""
    if found is not None:
        disc = found.disc
        raise InputError(
            f"{name}[{disc}] must be one radius from every obstacle; got {tuple(position[disc].tolist())}, "
            f"{found.depth:.3g} inside {found.where} with radius {radius[disc]:g}. Move the disc or the obstacle."
        )
