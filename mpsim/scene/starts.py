"""Starts: given arrays, lattices of which any range can be computed, random positions, thermal velocities."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.core.checks import Floats
from mpsim.core.state import Box
from mpsim.errors import InputError
from mpsim.features.capsules import distance, gaps, is_within, shifted, with_images
from mpsim.features.edges import BOUNDARIES
from mpsim.features.obstacles import Circle, Obstacle, Polyline, capsules_of
from mpsim.kernels import placement
from mpsim.kernels.geometry import ENDS, POLYGON, RADIUS, ROW

# --- Messages about overlaps at the start of a scene


def overlaps_in_words(scene: Any) -> str:
    """Overlaps of discs with each other and with obstacles; "" without any. See `Scene.overlaps_at_start`."""
    if scene._on_lattice is not None:  # displacements are shorter than half of the gaps; there are no obstacles
        return ""
    words: list[str] = []
    pairs = overlaps(scene.position, scene.radius, Room((scene.width, scene.height), scene.periodic))
    if pairs.worst:
        discs = "discs {} and {}".format(*pairs.worst)
        words.append(
            f"1 pair of discs overlaps at the start: {discs}, by {pairs.largest:.3g}"
            if pairs.pairs == 1
            else f"{pairs.pairs} pairs of discs overlap at the start, {discs} deepest, by {pairs.largest:.3g}"
        )
    return "; ".join(filter(None, [*words, overlap_of_obstacles(scene)]))


def overlap_of_obstacles(scene: Any) -> str:
    """Overlaps of discs with obstacles in words; "" without any."""
    deepest = None if scene._on_lattice is not None else scene._deepest(scene.position, scene.radii)
    if deepest is None:
        return ""
    if deepest.number == 1:
        return f"disc {deepest.disc} overlaps {deepest.where} at the start, by {deepest.depth:.3g}"
    return (
        f"{deepest.number} discs overlap an obstacle at the start, disc {deepest.disc} and {deepest.where} deepest, "
        f"by {deepest.depth:.3g}"
    )


# --- The box, and parts of it

LATTICES = ("square", "hexagonal")

LARGEST_LATTICE = 10_000_000
"""More sites than this are taken for a mistake in the spacing."""

SLACK = 1e-9
"""Sites that are beyond the far edge of a region by less than this, for rounding, belong to it [spacing]."""

LARGEST_RADIUS = 1e140
"""Largest radius for random places; its inverse is the smallest. Areas and their sums then fit float64 [length]."""

Region = tuple[float, float, float, float]
"""x_low, y_low, x_high, y_high of the region in which centres lie [length]."""


def check_region(name: str, value: Any) -> Region | Obstacle:
    """Part of a box for discs: x_low, y_low, x_high, y_high of their centres, or a shape around them."""
    if isinstance(value, Circle) or (isinstance(value, Polyline) and value.is_closed):
        return value
    x_low, y_low, x_high, y_high = checks.finite_array(name, value, (4,), "(4,)").tolist()
    if x_low > x_high or y_low > y_high:
        raise InputError(f"{name} must be [x_low, y_low, x_high, y_high], low before high; got {checks.brief(value)}.")
    return x_low, y_low, x_high, y_high


def is_in(region: Region | Obstacle, position: Floats) -> NDArray[np.bool_]:
    """Which points, shape (N, 2), are in a part of a box, shape (N,)."""
    if isinstance(region, Polyline):
        return is_within(position, capsules_of((region,)))
    if isinstance(region, Circle):
        return distance(position, np.abs(capsules_of((region,))[0])) <= 0
    low, high = np.reshape(np.asarray(region), (2, 2))
    return np.asarray(((position >= low) & (position <= high)).all(axis=1), np.bool_)


class Room(NamedTuple):
    """A box, and what is in it where discs are placed.

    size: width and height [length]. periodic: whether x, and whether y, is. capsules: obstacles, and discs as capsules
    of length 0, shape (K, ROW). walls: (x_low, x_high, y_low, y_high), if some start inside.
    """

    size: tuple[float, float]
    periodic: tuple[bool, bool] = (False, False)
    capsules: Floats = np.zeros((0, ROW))
    walls: Box | None = None


def side_for(packing: float, area: float, largest: float, boundary: tuple[str, str]) -> float:
    """Side of the square box in which discs have a given packing fraction [length].

    It is at least one diameter of the largest disc, or two in a periodic box, so that no disc touches its own image.
    area: of all discs together. largest: radius.
    """
    side = max(math.sqrt(area / packing), 2 * max(BOUNDARIES[word].least_diameters for word in boundary) * largest)
    if not math.isfinite(side):
        raise InputError(f"packing must leave the box finite; got {packing:g}. Use a larger one.")
    return side


def area_of_discs(radius: float | Floats, count: int) -> float:
    """Area of discs together [length^2]; radii whose areas overflow or vanish in float64 are refused."""
    radii = np.atleast_1d(radius)
    bad = radii[(radii > LARGEST_RADIUS) | (radii < 1 / LARGEST_RADIUS)]
    if len(bad):
        raise InputError(
            f"radius must be from {1 / LARGEST_RADIUS:g} to {LARGEST_RADIUS:g}, so that areas fit float64; "
            f"got {bad[0]:g}. Use other units."
        )
    return math.pi * float((radius**2).sum()) if isinstance(radius, np.ndarray) else count * math.pi * radius**2


def demand_room(largest: float, width: float, height: float, boundary: tuple[str, str]) -> None:
    """Refuse a box that does not hold its largest disc, along a periodic axis two of them."""
    for length, kind in zip((width, height), (BOUNDARIES[word] for word in boundary), strict=True):
        if 2 * largest * kind.least_diameters > length:
            raise InputError(
                f"radius must be at most {kind.largest_radius}, {length / (2 * kind.least_diameters):g} here; "
                f"got {largest!r}. Use smaller discs or a larger box."
            )


def box_for(
    count: int,
    radius: float | Floats,
    packing: float | None,
    width: float | None,
    height: float | None,
    boundary: tuple[str, str],
) -> tuple[float, float]:
    """Width and height, from either a packing fraction (square box) or the two lengths themselves."""
    if (packing is None) == (width is None and height is None) or (width is None) != (height is None):
        raise InputError(
            "the box must be given either by packing or by width and height; "
            f"got packing={packing!r}, width={width!r}, height={height!r}."
        )
    area, largest = area_of_discs(radius, count), float(np.max(radius, initial=0.0)) or 1.0
    if width is not None and height is not None:
        width, height = checks.positive("width", width, "[length]"), checks.positive("height", height, "[length]")
        demand_room(largest, width, height, boundary)
        return width, height
    side = side_for(fraction_of_the_area(packing), area, largest, boundary)
    return side, side


def fraction_of_the_area(given: float | None) -> float:
    """A packing, checked; 40, meant as per cent, is answered as such."""
    part = checks.positive("packing", given, "(a fraction of the area)")
    if 1 < part < 100:
        raise InputError(f"packing must be a fraction of the area; got {part:g}. {part:g} % is {part / 100:g}.")
    return part


# --- Sites of a lattice


class Sites(NamedTuple):
    """Sites of a lattice, numbered row by row from the lower left corner (0, 0) of a region.

    Attributes:
        kind: "square" or "hexagonal": rows sqrt(3)/2 of the spacing apart, every other one shifted by half of it.
        spacing: between neighbours [length].
        rows: number of rows.
        odd, even: sites in each odd row (first, third, ...), and in each even one.
    """

    kind: str
    spacing: float
    rows: int
    odd: int
    even: int

    @classmethod
    def fitting(cls, kind: str, width: float, height: float, spacing: float) -> Sites:
        """Those in a region: width along the rows, height across them [length]; none if one of these is below 0."""
        if width < 0 or height < 0:
            return cls(kind, spacing, 0, 0, 0)
        rise, shift = _shape(kind)
        up, across = (min(length / spacing + SLACK, 1e12) for length in (height / rise, width))
        return cls(kind, spacing, int(up) + 1, int(across) + 1, int(across - shift + 1))

    @property
    def number(self) -> int:
        """How many there are."""
        return (self.rows + 1) // 2 * self.odd + self.rows // 2 * self.even

    def between(self, first: int, last: int) -> Floats:
        """Sites first to last - 1, shape (last - first, 2): along the rows, and across them [length]."""
        rise, shift = _shape(self.kind)
        pair, column = np.divmod(np.arange(first, last), max(self.odd + self.even, 1))
        in_even = column >= self.odd
        row = 2 * pair + in_even
        return np.column_stack([column - self.odd * in_even + shift * in_even, row * rise]) * self.spacing


def _shape(kind: str) -> tuple[float, float]:
    """Distance of two rows, and shift of the even ones, as fractions of the spacing."""
    return (math.sqrt(3) / 2, 0.5) if kind == "hexagonal" else (1.0, 0.0)


def widest_spacing(kind: str, lengths: Callable[[float], tuple[float, float]], count: int) -> float:
    """The widest spacing at which a region holds `count` sites, by bisection: fewer fit at a wider spacing [length].

    lengths: of the region along and across the rows for a spacing, at most those at spacing 0 [length].
    """

    def enough(spacing: float) -> bool:
        return Sites.fitting(kind, *lengths(spacing), spacing).number >= count

    longest = max(lengths(0.0))
    high = min(4 * longest, max(longest, 1e300)) or 1.0
    low = high
    for _ in range(100):
        if enough(low):
            break
        low /= 2
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if enough(middle) else (low, middle)
    return low


def lattice_sites(
    kind: str, region: Region | Obstacle, spacing: float | None = None, count: int | None = None
) -> Floats:
    """Sites of a lattice, row by row from the lower left corner of a region, shape (K, 2) [length].

    Args:
        kind: "square" or "hexagonal": rows sqrt(3)/2 of the spacing apart, every other one shifted by half of it.
        region: that contains the sites.
        spacing: between neighbours [length], > 0; None: the widest at which `count` sites fit.
        count: number of sites; None: as many as fit.

    >>> lattice_sites("square", (0, 0, 2, 1), spacing=1.0).tolist()
    [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [0.0, 1.0], [1.0, 1.0], [2.0, 1.0]]
    >>> lattice_sites("hexagonal", (0, 0, 2, 1), spacing=1.0, count=4).round(3).tolist()
    [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [0.5, 0.866]]
    """
    if isinstance(region, Obstacle):
        raise InputError(f"region of a lattice must be [x_low, y_low, x_high, y_high]; got {region!r}. Use 'random'.")
    width, height = region[2] - region[0], region[3] - region[1]
    if spacing is None:
        spacing = widest_spacing(kind, lambda _: (width, height), count or 1)
    sites = Sites.fitting(kind, width, height, spacing)
    if count is not None and sites.number < count:
        raise InputError(
            f"count must be at most {sites.number}, the sites of a {kind} lattice of spacing {spacing:g} in the region "
            f"{region_in_words(region)}; got {count}. Use a smaller spacing or a larger region."
        )
    if sites.number > LARGEST_LATTICE:
        raise InputError(
            f"spacing must leave at most {LARGEST_LATTICE} sites in the region {region_in_words(region)}; got "
            f"{spacing:g}. Use a larger spacing or a smaller region."
        )
    found = sites.between(0, sites.number if count is None else count) + np.array(region[:2])
    return np.minimum(found, region[2:])  # the slack of Sites.fitting may put them outside by a rounding


def region_in_words(region: Region | Floats) -> str:
    """A rectangle, given by its corners x_low, y_low, x_high, y_high, as its ranges of x and y."""
    return f"[{region[0]:g}, {region[2]:g}] x [{region[1]:g}, {region[3]:g}]"


# --- Random positions among discs and obstacles, and thermal velocities

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

CANDIDATES = 16
"""Positions tried for a small disc, of which the one with least overlap is taken."""


def random_places(
    radius: float | Floats, count: int, room: Room, region: Region | Obstacle | None, rng: np.random.Generator
) -> Floats:
    """Random centres of discs that overlap neither each other nor what is in the box, shape (count, 2) [length].

    In an empty box these are the positions of Scene.random. A region ends a diameter before the images of its discs.

    Args:
        radius: of all, or of each, shape (count,) [length], > 0.
        region: that contains the centres, or a shape around the discs; None: what walls and containers leave.
    """
    area_of_discs(radius, count)  # which refuses extreme radii
    box, periodic, capsules, walls = room
    corner, (width, height), largest = np.zeros(2), box, float(np.max(radius, initial=0.0))
    wraps, margin = periodic, float(np.min(radius, initial=math.inf)) if count else 0.0
    shape = None
    if isinstance(region, Obstacle):
        around = capsules_of((region,))
        around[:, POLYGON] = -1
        if isinstance(region, Circle):
            around[:, [RADIUS, POLYGON]] = -region.radius, 0
        capsules, shape, region = np.concatenate([capsules, around]), region, None
    region = region or _inside(capsules, walls, box, margin)
    if region is not None:
        corner, beyond = np.array(region[:2]) - margin, np.add(region[:2], box) - 2 * largest
        width, height = np.where(periodic, np.minimum(region[2:], beyond), region[2:]) - corner + margin
        wraps = (False, False)
    if min(width, height) < 0 and shape is not None:
        rule = f"reach into the box of {box[0]:g} x {box[1]:g}"
        raise checks.refusal("the shape around discs", rule, checks.brief(shape), "Move it into the box.")
    if min(width, height) < 2 * largest:
        raise InputError(
            f"radius must be at most half the room, {min(width, height) / 2:g} here; got {largest!r}. "
            "Use smaller discs."
        )
    part = corner[0], corner[1], corner[0] + width, corner[1] + height
    near = _near(Room(box, (False, False) if region is None else periodic, capsules), part, 2 * largest)
    radii = np.broadcast_to(radius, count)
    packing = math.pi * float((radii**2).sum()) / _area(width, height, near)
    if packing > LARGEST_PACKING:
        raise InputError(
            f"packing must be at most {LARGEST_PACKING} for random places; got {packing:.3g}. "
            "Use fewer or smaller discs, or a larger box, which Scene.compressed makes smaller."
        )
    if not count:
        return np.empty((0, 2))
    if isinstance(radius, float) and not len(near) and not any(wraps):
        return _random_equal(count, radius, Room((width, height)), rng) + corner
    rest = Room((width, height), wraps, shifted(near, -corner))
    return _random_polydisperse(radii.astype(np.float64), rest, rng) + corner


def _near(room: Room, region: Region, reach: float) -> Floats:
    """Capsules, and images of them, that reach into a region, shape (K, ROW); polygons as a whole."""
    every, _, shift = with_images(room.capsules, room.size, room.periodic, reach)
    every[shift.any(axis=1), POLYGON] = 0  # what is in the box is in no image
    (ax, ay, bx, by), radius, (x_low, y_low, x_high, y_high) = every[:, ENDS].T, every[:, RADIUS], region
    apart_x = (np.maximum(ax, bx) + radius < x_low) | (np.minimum(ax, bx) - radius > x_high)
    apart_y = (np.maximum(ay, by) + radius < y_low) | (np.minimum(ay, by) - radius > y_high)
    return every[~(apart_x | apart_y) | (radius < 0) | (every[:, POLYGON] != 0)]


def _inside(capsules: Floats, walls: Box | None, box: tuple[float, float], radius: float) -> Region | None:
    """The rectangle in which walls and containers leave room for discs of a radius; None: all of the box."""
    circles, polygon = (capsules[capsules[:, column] < 0] for column in (RADIUS, POLYGON))
    if not len(circles) + len(polygon) and walls is None:
        return None
    x_low, x_high, y_low, y_high = walls or (0.0, box[0], 0.0, box[1])
    low = [*(circles[:, :2] + circles[:, RADIUS, None]), np.array([x_low, y_low])]
    high = [*(circles[:, :2] - circles[:, RADIUS, None]), np.array([x_high, y_high])]
    if len(polygon):
        low.append(polygon[:, :2].min(axis=0))
        high.append(polygon[:, :2].max(axis=0))
    (x_low, y_low), (x_high, y_high) = np.max(low, axis=0) + radius, np.min(high, axis=0) - radius
    return x_low, y_low, x_high, y_high


def _area(width: float, height: float, capsules: Floats) -> float:
    """Area of a rectangle, or of the smallest container if that is less [length^2]."""
    return min([width * height, *(math.pi * radius**2 for radius in capsules[:, RADIUS] if radius < 0)])


def _random_equal(count: int, radius: float, room: Room, rng: np.random.Generator) -> Floats:
    """Random centres of equal discs without overlap, shape (count, 2), between four walls.

    Raises:
        InputError: if none of the lattices tried holds that many discs.
    """
    radii, (width, height) = np.full(count, radius), room.size
    packing = count * math.pi * radius**2 / (width * height)
    if count * math.pi * radius**2 <= SPARSE_PACKING * width * height:  # not `packing`, which is rounded once more
        discs = _crowd(np.zeros((count, 2)), radii, room)
        if _add_all(discs, rng):
            return np.column_stack([discs.x, discs.y])
    sites = _lattice(count, width, height, 2 * radius)
    chosen = sites[np.sort(rng.permutation(len(sites))[:count])]
    discs = _crowd(chosen, radii, room)
    longest = 2 * radius * max(0.02, 0.6 * (math.sqrt(0.9069 / packing) - 1))
    for _ in range(SWEEPS):
        placement.shuffle(discs, rng.uniform(-longest, longest, (count, 2)), 1.0)
    return np.column_stack([discs.x, discs.y])[rng.permutation(count)]


def _lattice(count: int, width: float, height: float, diameter: float) -> Floats:
    """Sites of the widest lattice, of staggered or straight rows, that holds `count` discs: shape (>= count, 2)."""
    free_x, free_y = width - diameter, height - diameter
    best_gap, best = -1.0, (1, 1, 0.0, math.inf, math.inf)
    most_rows = min(count, int(free_y / (diameter * math.sqrt(3) / 2)) + 1)
    for rows in range(1, most_rows + 1):
        columns = math.ceil(count / rows)
        for stagger in (0.0, 0.5):
            dx = free_x / (columns - 1 + stagger) if columns - 1 + stagger > 0 else math.inf
            dy = free_y / (rows - 1) if rows > 1 else math.inf
            diagonal = math.hypot(stagger * dx, dy) if rows > 1 else math.inf
            gap = min(dx, diagonal, 2 * dy)
            if gap > best_gap:
                best_gap, best = gap, (rows, columns, stagger, dx, dy)
    if best_gap < diameter * (1 + 1e-9):
        raise InputError(
            f"{count} discs of radius {diameter / 2:g} do not fit a box of {width:g} x {height:g} in regular rows "
            f"(the best rows leave {best_gap:.6g} between centres, {diameter:g} is needed). "
            "Use fewer or smaller discs, or a larger box, which Scene.compressed can shrink."
        )
    rows, columns, stagger, *steps = best
    row = np.repeat(np.arange(rows), columns)
    column = np.tile(np.arange(columns), rows) + stagger * (row % 2)
    step_x, step_y = (0.0 if math.isinf(step) else step for step in steps)  # of a single column, or row
    return np.column_stack([column * step_x, row * step_y]).astype(np.float64) + diameter / 2


def _random_polydisperse(radius: Floats, room: Room, rng: np.random.Generator) -> Floats:
    """Random centres of discs of any radii without overlap, shape (N, 2).

    Up to SPARSE_PACKING, discs are placed by random sequential addition, the largest first. Denser arrangements start
    from a jittered lattice; overlaps are removed pair by pair, and Monte Carlo steps follow. The same seed gives the
    same positions. radius: of each disc, shape (N,) [length].
    """
    count = len(radius)
    discs, (width, height) = _crowd(np.zeros((count, 2)), radius, room), room.size
    packing = math.pi * float((radius**2).sum()) / _area(width, height, discs.capsule)
    if not (packing <= SPARSE_PACKING and _add_all(discs, rng)):
        if not any(_remove_overlaps(discs, packing, overshoot, rng) for overshoot in OVERSHOOT):
            raise InputError(
                f"{count} discs of packing {packing:.3g} could not be placed in a box of {width:g} x {height:g} "
                "without overlap. Use fewer or smaller discs, or a larger box, which Scene.compressed can shrink."
            )
        longest = 2 * radius * max(0.02, 0.6 * (math.sqrt(0.9069 / packing) - 1))
        for _ in range(SWEEPS):
            placement.shuffle(discs, rng.uniform(-1, 1, (count, 2)) * longest[:, None], 1 + GAP)
    return np.column_stack([discs.x, discs.y])


def _add_all(discs: placement.Crowd, rng: np.random.Generator) -> bool:
    """Random sequential addition, the largest first; False if not all discs could be placed."""
    discs.head[:] = placement.EMPTY
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


def thermal_velocities(count: int, temperature: float, mass: float | Floats | None, rng: np.random.Generator) -> Floats:
    """Normally distributed velocities, shape (count, 2) [length/time].

    For 2 discs or more the total momentum is zero, and velocities are scaled so that the mean of m v_x^2 and m v_y^2 is
    exact. temperature: kT [mass length^2/time^2]. mass: of all or of each, shape (count,) [mass]; None: 1.
    """
    velocity = rng.normal(size=(count, 2))
    masses = np.broadcast_to(1.0 if mass is None else mass, count)[:, None]
    velocity /= np.sqrt(masses)
    if count < 2:
        return velocity * math.sqrt(temperature)
    velocity -= velocity.mean(axis=0) if mass is None else (masses * velocity).sum(axis=0) / masses.sum()
    with np.errstate(over="ignore"):
        mean = float((masses * velocity**2).mean())
    if not math.isfinite(mean):  # masses so small that squares of velocities are beyond float64
        mean = float(((np.sqrt(masses) * velocity) ** 2).mean())
    return velocity * (math.sqrt(temperature) / math.sqrt(mean))


# --- Overlaps of given positions, and moves that avoid them

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


def overlaps(position: Floats, radius: float | Floats, room: Room, rounding: float | None = None) -> Overlap:
    """The overlapping pairs of discs at positions, shape (N, 2). O(N).

    radius: of all discs, or of each, shape (N,) [length]. rounding: depth up to which discs touch [length]; None: that
    of float64 coordinates in the box.
    """
    slack = TOUCHING * float(np.finfo(np.float64).eps) * max(room.size) if rounding is None else rounding
    worst = np.zeros(2, np.int64)
    discs = _crowd(position, np.broadcast_to(np.asarray(radius, np.float64), len(position)), room)
    pairs, largest, total = placement.count_overlaps(discs, slack, worst)
    i, j = worst.tolist()
    return Overlap(int(pairs), float(largest), float(total) / max(pairs, 1), (i, j) if pairs else None)


def displaced(position: Floats, radius: Floats, room: Room, moves: Floats) -> Floats:
    """Centres after moving each disc along x, then along y, shape (N, 2).

    A move that leads to an overlap or out of the box is rejected. moves: displacements, shape (N, 2) [length].
    """
    if not len(position):
        return position
    discs = _crowd(position, radius, room)
    for axis in (0, 1):
        placement.shuffle(discs, moves * (np.arange(2) == axis), 1 + GAP)
    return np.column_stack([discs.x, discs.y])


def pushed_aside(position: Floats, radius: Floats, room: Room, scale: float) -> Floats | None:
    """Centres of discs after moving those apart that overlap each other or capsules, shape (N, 2); None: no room.

    A disc that is trapped between capsules and walls begins again from a random place beside its own.

    The arguments are those of `displaced`; scale: factor of the radii, a little above 1, for which there must be room.
    """
    rng, places = np.random.default_rng(0), position
    edge = np.where(room.periodic, 0.0, radius[:, None])
    for attempt in range(PUSHES):
        discs = _crowd(places, radius, room)
        for _ in range(PUSH_ROUNDS):
            if not placement.crowded(discs, scale):
                return np.column_stack([discs.x, discs.y])
            placement.part(discs, scale * (1 + ROOM), 0.0)
        places = np.column_stack([discs.x, discs.y])
        trapped = gaps(places[:, None], radius[:, None], room.capsules).min(axis=1, initial=np.inf)[:, None] < 0
        jumps = (1 + attempt / 2) * radius[:, None] * rng.uniform(-1, 1, places.shape)
        places = np.clip(places + trapped * jumps, edge, np.array(room.size) - edge)
    return None


def _crowd(position: NDArray[np.floating], radius: Floats, room: Room) -> placement.Crowd:
    """Discs at copies of these centres, shape (N, 2), in the lists of their cells.

    Radii within a factor of two share a level and its grid.
    """
    (x, y), size = np.array(position.T, np.float64, order="C"), room.size
    binary = np.frexp(radius)[1]
    present, level = np.unique(binary, return_inverse=True)
    largest = np.array([radius[binary == power].max() for power in present], np.float64)
    counts = np.bincount(level, minlength=len(present))
    side = np.maximum(2 * largest, np.sqrt(size[0] * size[1] / np.maximum(counts, 1)))
    # In a thin box, too, no level has more cells than about one per disc.
    columns, rows = (np.clip(length / side, 1, np.maximum(counts, 1)).astype(np.int64) for length in size)
    cells, reach = columns * rows, REACH * float(largest.max(initial=0.0))
    images = with_images(room.capsules, size, room.periodic, reach)
    seen = room.capsules[images.source]
    seen[images.shift.any(axis=1), POLYGON] = 0  # what is in the box is in no image
    discs = placement.Crowd(
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
        bool(room.periodic[0]),
        bool(room.periodic[1]),
        seen,
        images.shift,
    )
    placement.link(discs)
    return discs


# --- Equal discs on a lattice that fills the box; each is computed from its number alone
#
# They are numbered column by column, so that consecutive discs form a strip of the box. Random numbers come from
# blocks of discs: each has a stream of its own (Philox, Salmon et al. 2011), which only the seed and the number of the
# block determine. In each block, and so in total, velocities have zero momentum and the exact temperature.

BLOCK = 4096
"""Discs of a block at most, whose random numbers are drawn together."""

BLOCKS_OF_A_PIECE = 16
"""Blocks that are looked at together where all discs are looked at."""

DISPLACEMENT = 0.9
"""Largest displacement from a site, as a fraction of half of the gap between two discs on their sites."""

LEAST_GAP = 1e-7, 128 * 2.0**-52
"""Gap between two discs on their sites, as fractions of their diameter and of the box: it covers all rounding."""

PLACES, VELOCITIES = 0, 1
"""What a stream of random numbers is for."""


@dataclass(frozen=True)
class Lattice:
    """Discs near the sites of a hexagonal lattice.

    Args:
        count: number of discs, >= 0.
        radius: of each [length].
        width, height: of the box [length], which holds the discs: see `demand_sites`.
        periodic: whether x, and whether y, is.
        temperature: kT: the mean of v_x^2 and v_y^2, masses being 1 [length^2/time^2].
        seed: of the random numbers, from 0 to 2^63 - 1.

    >>> lattice = Lattice(1000, 0.5, 60.0, 20.0, (False, False), 1.0, seed=1)
    >>> lattice.positions(990, 1000).round(2).tolist() == lattice.position[990:].round(2).tolist()
    True
    """

    count: int
    radius: float
    width: float
    height: float
    periodic: tuple[bool, bool]
    temperature: float
    seed: int

    def __getstate__(self) -> dict[str, Any]:
        """The numbers above, without arrays that were made of them."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @cached_property
    def position(self) -> Floats:
        """Centres of all discs, shape (count, 2), read-only [length]."""
        return checks.read_only(self.positions(0, self.count))

    @cached_property
    def velocity(self) -> Floats:
        """Velocities of all discs, shape (count, 2), read-only [length/time]."""
        return checks.read_only(self.velocities(0, self.count))

    def positions(self, first: int, last: int) -> Floats:
        """Centres of discs first to last - 1, shape (last - first, 2) [length]."""
        sites, low, high, most = self._sites, *self._region, self._largest_displacement

        def made(begin: int, end: int, rng: np.random.Generator) -> Floats:
            displacement = most * (2 * rng.random((end - begin, 2)) - 1)
            # Columns of the box are the rows of the lattice.
            place = np.minimum(low + sites.between(begin, end)[:, ::-1], high) + displacement
            for axis in (0, 1):
                if not self.periodic[axis]:  # a wall mirrors displacements, which makes none of them longer
                    along = high[axis] - np.abs(high[axis] - (low[axis] + np.abs(place[:, axis] - low[axis])))
                    place[:, axis] = np.clip(along, low[axis], high[axis])
            return place

        return self._in_blocks(PLACES, made, first, last)

    def velocities(self, first: int, last: int) -> Floats:
        """Velocities of discs first to last - 1, shape (last - first, 2) [length/time]."""

        def made(begin: int, end: int, rng: np.random.Generator) -> Floats:
            return thermal_velocities(end - begin, self.temperature, None, rng)

        return self._in_blocks(VELOCITIES, made, first, last)

    def digest_of_some(self) -> str:
        """Hex digest of the first discs, which shows whether the same numbers are drawn as elsewhere."""
        some = 0, min(self.count, BLOCK)
        digest = hashlib.blake2b(digest_size=16)
        for array in (self.positions(*some), self.velocities(*some)):
            digest.update(np.ascontiguousarray(array, "<f8").tobytes())
        return digest.hexdigest()

    def pieces(self) -> Iterator[tuple[int, int]]:
        """Pieces of all discs, as (first disc, one after the last), each of at most BLOCKS_OF_A_PIECE blocks."""
        blocks = self._blocks
        ends = [*range(0, blocks, BLOCKS_OF_A_PIECE), blocks]
        return pairwise(self._first_of(block) for block in ends)

    def _in_blocks(
        self, stream: int, make: Callable[[int, int, np.random.Generator], Floats], first: int, last: int
    ) -> Floats:
        """What `make` makes of discs begin to end - 1, whole blocks of them, cut to first to last - 1."""
        found = np.empty((last - first, 2))
        block = ((first + 1) * self._blocks - 1) // max(self.count, 1)
        begin = self._first_of(block)
        while begin < last:
            end = self._first_of(block + 1)
            bits = np.random.Philox(key=_key(self.seed, stream), counter=_key(0, 0, 0, block))
            low, high = max(begin, first), min(end, last)
            found[low - first : high - first] = make(begin, end, np.random.Generator(bits))[low - begin : high - begin]
            block, begin = block + 1, end
        return found

    @property
    def _blocks(self) -> int:
        """Number of blocks, of nearly equal sizes, so that only a single disc is alone in one."""
        return max(-(-self.count // BLOCK), 1)

    def _first_of(self, block: int) -> int:
        return self.count * block // self._blocks

    @cached_property
    def _sites(self) -> Sites:
        spacing = widest_spacing("hexagonal", self._lengths, max(self.count, 1))
        return Sites.fitting("hexagonal", *self._lengths(spacing), spacing)

    @property
    def most(self) -> int:
        """Number of discs that the box would hold in this way."""
        of_diameter, of_box = LEAST_GAP
        spacing = 2 * self.radius * (1 + of_diameter) + of_box * max(self.width, self.height)
        return Sites.fitting("hexagonal", *self._lengths(spacing), spacing).number

    def _lengths(self, spacing: float) -> tuple[float, float]:
        """Lengths of the region of the sites along y and along x, between walls or periodic borders [length]."""
        x, y = (
            length - (spacing if wraps else 2 * self.radius)
            for length, wraps in zip((self.width, self.height), self.periodic, strict=True)
        )
        return y, x

    @cached_property
    def _region(self) -> tuple[Floats, Floats]:
        """Lower left and upper right corner of the region of the sites [length]."""
        low = np.where(self.periodic, self._sites.spacing / 2, self.radius)
        return low, np.array([self.width, self.height]) - low

    @cached_property
    def _largest_displacement(self) -> Floats:
        """Along x and along y: no disc goes farther than DISPLACEMENT of half of the gap, whatever the direction."""
        low, high = self._region
        gap = max(self._sites.spacing - 2 * self.radius, 0.0)  # a single disc has no neighbour
        return np.minimum(DISPLACEMENT * gap / 2 / math.sqrt(2), np.where(self.periodic, np.inf, (high - low) / 2))


def demand_sites(lattice: Lattice, packing: float | None) -> None:
    """Refuse more discs than there is room for on a lattice in their box. packing: that was given for it, if any."""
    if lattice.count > lattice.most:
        name, remedy = "count", "Use fewer or smaller discs, or a larger box"
        if packing is not None:
            name, remedy = "packing", f"Use one below {packing:g}"
        raise InputError(
            f"{name} must leave room for a hexagonal lattice, which has at most {lattice.most} discs of radius "
            f"{lattice.radius:g} in a box of {lattice.width:g} x {lattice.height:g}; got {lattice.count}. {remedy}."
        )


def demand_equal_discs(radius: Any, others: dict[str, Any]) -> None:
    """Refuse, by name, arguments of Scene for which discs on a lattice would differ or have no place."""
    instead = "Use Scene.random, or give the places of the discs."
    if np.ndim(radius):
        got = f"an array of shape {np.shape(radius)}"
        raise checks.refusal("radius of discs on a lattice", "be one number for all", got, instead)
    if others.get("mass") is not None:
        rule = "be left out for discs on a lattice, which have mass 1 each"
        raise checks.refusal("mass", rule, "one or more", instead)


def demand_whole_box(scene: Any) -> None:
    """Refuse anything inside the box of a scene with discs on a lattice: capsules, or a wall that starts inside."""
    if len(scene._capsules_at(0.0)):
        rule = "be left out for discs on a lattice, which fills the box"
        raise checks.refusal("obstacles", rule, "one or more", "Use Scene.random, whose discs keep clear of them.")
    for wall in scene._moving_walls:
        if (place := wall.place(0.0)) != (0.0, scene.width, 0.0, scene.height)[wall.edge]:
            rule = "be its wall for discs on a lattice, which fills the box"
            instead = "Leave it out, or give the places of the discs."
            raise checks.refusal(f"start of the {wall.name}", rule, f"{place:g}", instead)


def _key(*numbers: int) -> NDArray[np.uint64]:
    return np.array(numbers, np.uint64)


@dataclass(frozen=True, eq=False)
class GivenStart:
    """Places and velocities that were given, arrays of shape (N, 2), read-only, with the methods of a Lattice."""

    position: Floats
    velocity: Floats

    @property
    def count(self) -> int:
        return len(self.position)

    def positions(self, first: int, last: int) -> Floats:
        return self.position[first:last]

    def velocities(self, first: int, last: int) -> Floats:
        return self.velocity[first:last]

    def pieces(self) -> Iterator[tuple[int, int]]:
        return iter([(0, self.count)])


Start = Lattice | GivenStart


def start_of(position: Any, velocity: Any) -> Start:
    """What a scene starts from: arrays, checked, or the lattice that Scene.lattice hands over in place of both."""
    if isinstance(position, Lattice):
        return position
    places = checks.finite_array("position", position, (None, 2), "(N, 2)")
    rows = f"({len(places)}, 2), one row per row of position"
    return GivenStart(places, checks.finite_array("velocity", velocity, (len(places), 2), rows))
