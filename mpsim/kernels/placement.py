"""Discs placed in a scene: random sequential addition, overlaps removed, Monte Carlo moves."""

import math
from collections import namedtuple

from mpsim.kernels.compiling import compiled, inlined
from mpsim.kernels.geometry import AX, AY, BX, BY, POLYGON, RADIUS, concerns, nearest_image

# --- Discs of any sizes, with or without periodic axes, among capsules: finds overlaps, separates and shuffles discs
#
# Discs whose radii lie within a factor of two share a level, and a level has a grid of its own, of cells no narrower
# than its largest disc. A search visits a few cells of each level, so it is fast however much the sizes of the discs
# differ.

EMPTY = -1


# x, y, radius: shape (N,) [length]. level: of each disc, (N,). head: first disc of every cell of every level, all EMPTY
# at first; following: next disc in the same cell, (N,). columns, rows, first (index in head), largest (radius): one per
# level. width, height [length] and periodic_x, periodic_y: the box. capsule: (K, ROW), the sides of a polygon one after
# another; shift: how far each is displaced, as an image is, (K, 2) [length].
Crowd = namedtuple(
    "Crowd",
    "x y radius level head following columns rows first largest width height periodic_x periodic_y capsule shift",
)


@inlined
def span(place, reach, length, cells, periodic):
    """The cells that hold every centre within `reach` of a place along one axis: (first, last), to be taken modulo."""
    low = math.floor((place - reach) * cells / length)
    high = math.floor((place + reach) * cells / length)
    if not periodic:
        return min(max(low, 0), cells - 1), min(max(high, 0), cells - 1)
    return (0, cells - 1) if high - low + 1 >= cells else (low, high)


@inlined
def cell_of(crowd, i):
    """Index in `head` of the cell where disc i is."""
    level = crowd.level[i]
    columns, rows = crowd.columns[level], crowd.rows[level]
    column = min(max(int(crowd.x[i] * columns / crowd.width), 0), columns - 1)
    row = min(max(int(crowd.y[i] * rows / crowd.height), 0), rows - 1)
    return crowd.first[level] + column * rows + row


@inlined
def enter(crowd, i):
    """Put disc i into the list of its cell."""
    cell = cell_of(crowd, i)
    crowd.following[i] = crowd.head[cell]
    crowd.head[cell] = i


@inlined
def leave(crowd, i):
    """Remove disc i from the list of its cell."""
    cell = cell_of(crowd, i)
    j = crowd.head[cell]
    if j == i:
        crowd.head[cell] = crowd.following[i]
        return
    while crowd.following[j] != i:
        j = crowd.following[j]
    crowd.following[j] = crowd.following[i]


@inlined
def settle(crowd, i, px, py):
    """Move disc i, already in a list, to a place inside the walls, or through a periodic border."""
    leave(crowd, i)
    radius = crowd.radius[i]
    if crowd.periodic_x:
        crowd.x[i] = px - math.floor(px / crowd.width) * crowd.width
    else:
        crowd.x[i] = min(max(px, radius), crowd.width - radius)
    if crowd.periodic_y:
        crowd.y[i] = py - math.floor(py / crowd.height) * crowd.height
    else:
        crowd.y[i] = min(max(py, radius), crowd.height - radius)
    enter(crowd, i)


@inlined
def look(crowd, px, py, radius, mover, scale, slack):
    """Overlaps of a disc at (px, py) with discs other than `mover`: (how many, the deepest, its depth, sum of depths).

    Radii count times `scale`, and two discs closer than their sum by no more than `slack` [length] do not overlap.
    """
    number, partner, worst, total = 0, EMPTY, 0.0, 0.0
    for level in range(crowd.columns.size):
        columns, rows = crowd.columns[level], crowd.rows[level]
        reach = scale * (radius + crowd.largest[level])
        left, right = span(px, reach, crowd.width, columns, crowd.periodic_x)
        bottom, top = span(py, reach, crowd.height, rows, crowd.periodic_y)
        for c in range(left, right + 1):
            for r in range(bottom, top + 1):
                j = crowd.head[crowd.first[level] + (c % columns) * rows + r % rows]
                while j != EMPTY:
                    touching = scale * (radius + crowd.radius[j])
                    contact = touching - slack
                    dx = nearest_image(crowd.x[j] - px, crowd.width, crowd.periodic_x)
                    dy = nearest_image(crowd.y[j] - py, crowd.height, crowd.periodic_y)
                    square = dx * dx + dy * dy
                    if j != mover and contact > 0.0 and square < contact * contact:
                        number += 1
                        depth = touching - math.sqrt(square)
                        total += depth
                        if depth > worst:
                            partner, worst = j, depth
                    j = crowd.following[j]
    return number, partner, worst, total


@inlined
def off_capsules(crowd, px, py, radius):
    """Where to put a disc at (px, py) out of the capsule, or the polygon, that it overlaps most: (x, y, depth)."""
    x, y, worst = px, py, 0.0
    inside, nearest, toward_x, toward_y = False, math.inf, 0.0, 0.0
    for k in range(crowd.capsule.shape[0]):
        if not concerns(crowd.capsule, k, radius):
            continue
        ax, ay = crowd.capsule[k, AX], crowd.capsule[k, AY]
        bx, by = crowd.capsule[k, BX] - ax, crowd.capsule[k, BY] - ay
        rx, ry = px - ax - crowd.shift[k, 0], py - ay - crowd.shift[k, 1]
        square = bx * bx + by * by
        fraction = min(max((rx * bx + ry * by) / square, 0.0), 1.0) if square > 0.0 else 0.0
        gx, gy = rx - fraction * bx, ry - fraction * by
        distance = math.sqrt(gx * gx + gy * gy)
        if crowd.capsule[k, RADIUS] < 0.0:  # a container
            distance = -distance
        depth = radius + crowd.capsule[k, RADIUS] - distance
        if depth > worst:
            worst = depth
            away = depth / distance if distance != 0.0 else 0.0
            x, y = px + gx * away, py + gy * away + (depth if distance == 0.0 else 0.0)
        polygon = crowd.capsule[k, POLYGON]
        if polygon != 0.0:
            if (ry < 0.0) != (ry < by) and rx < ry * bx / by:
                inside = not inside
            if 0.0 < distance < nearest:
                nearest, toward_x, toward_y = distance, -gx / distance, -gy / distance
            if k + 1 == crowd.capsule.shape[0] or crowd.capsule[k + 1, POLYGON] != polygon:
                depth = nearest + radius + crowd.capsule[k, RADIUS]
                if inside == (polygon > 0.0) and worst < depth < math.inf:
                    x, y, worst = px + depth * toward_x, py + depth * toward_y, depth
                inside, nearest = False, math.inf
    return x, y, worst


@compiled
def link(crowd):
    """Enter every disc in the list of its cell."""
    crowd.head[:] = EMPTY
    for i in range(crowd.x.size):
        enter(crowd, i)


@compiled
def count_overlaps(crowd, slack, worst):
    """Overlapping pairs among linked discs: (how many, largest depth, sum of depths); worst receives the deepest."""
    twice, deepest, total = 0, 0.0, 0.0
    for i in range(crowd.x.size):
        number, j, depth, depths = look(crowd, crowd.x[i], crowd.y[i], crowd.radius[i], i, 1.0, slack)
        twice += number
        total += depths
        if depth > deepest:
            deepest = depth
            worst[0], worst[1] = min(i, j), max(i, j)
    return twice // 2, deepest, 0.5 * total


@compiled
def crowded(crowd, scale):
    """Whether any linked disc overlaps another or a capsule."""
    for i in range(crowd.x.size):
        px, py, radius = crowd.x[i], crowd.y[i], crowd.radius[i]
        if off_capsules(crowd, px, py, scale * radius)[2] > 0.0 or look(crowd, px, py, radius, i, scale, 0.0)[0]:
            return True
    return False


@inlined
def place_of(candidate, radius, crowd):
    """A place (x, y) from fractions of where the centre of a disc may be."""
    low_x = 0.0 if crowd.periodic_x else radius
    low_y = 0.0 if crowd.periodic_y else radius
    return low_x + candidate[0] * (crowd.width - 2.0 * low_x), low_y + candidate[1] * (crowd.height - 2.0 * low_y)


@compiled
def add_sequentially(crowd, order, placed, candidates, scale):
    """Try each candidate, (x, y) as fractions of where a centre may be, for the next disc of `order` that has no place.

    A disc takes its place if it overlaps none there yet. Returns the number of discs placed.
    """
    for k in range(candidates.shape[0]):
        if placed == order.size:
            break
        i = order[placed]
        radius = crowd.radius[i]
        px, py = place_of(candidates[k], radius, crowd)
        free = off_capsules(crowd, px, py, scale * radius)[2] == 0.0
        if free and look(crowd, px, py, radius, EMPTY, scale, 0.0)[0] == 0:
            crowd.x[i], crowd.y[i] = px, py
            enter(crowd, i)
            placed += 1
    return placed


@compiled
def throw(crowd, order, candidates, scale):
    """Give each disc of `order` the first of its candidates not deep in another disc, else the least deep one.

    candidates: shape (N, K, 2), (x, y) as fractions of where a centre may be. Deep: by more than the disc's own radius.
    """
    for k in range(order.size):
        i = order[k]
        radius = crowd.radius[i]
        least = math.inf
        for choice in range(candidates.shape[1]):
            px, py = place_of(candidates[k, choice], radius, crowd)
            depth = look(crowd, px, py, radius, EMPTY, scale, 0.0)[2]
            depth = max(depth, off_capsules(crowd, px, py, scale * radius)[2])
            if depth < least:
                least = depth
                crowd.x[i], crowd.y[i] = px, py
            if depth <= radius:
                break
        enter(crowd, i)


@compiled
def part(crowd, scale, beyond):
    """Separate each linked disc from the one it overlaps most, moving the smaller one more; then from capsules.

    beyond: how much farther than necessary, as a fraction of the overlap.
    """
    for i in range(crowd.x.size):
        _, j, depth, _ = look(crowd, crowd.x[i], crowd.y[i], crowd.radius[i], i, scale, 0.0)
        if j != EMPTY:
            dx = nearest_image(crowd.x[j] - crowd.x[i], crowd.width, crowd.periodic_x)
            dy = nearest_image(crowd.y[j] - crowd.y[i], crowd.height, crowd.periodic_y)
            distance = math.sqrt(dx * dx + dy * dy)
            # Two discs at one point separate along x.
            nx, ny = (dx / distance, dy / distance) if distance > 0.0 else (1.0, 0.0)
            depth *= 1.0 + beyond
            mine = depth * crowd.radius[j] / (crowd.radius[i] + crowd.radius[j])
            settle(crowd, i, crowd.x[i] - mine * nx, crowd.y[i] - mine * ny)
            settle(crowd, j, crowd.x[j] + (depth - mine) * nx, crowd.y[j] + (depth - mine) * ny)
        if crowd.capsule.shape[0]:
            px, py, depth = off_capsules(crowd, crowd.x[i], crowd.y[i], scale * crowd.radius[i])
            if depth > 0.0:
                settle(crowd, i, px, py)


@compiled
def shuffle(crowd, moves, scale):
    """One Monte Carlo move per disc, accepted if it leads into the box and to no overlap (Metropolis et al. 1953)."""
    for i in range(crowd.x.size):
        radius = crowd.radius[i]
        px, py = crowd.x[i] + moves[i, 0], crowd.y[i] + moves[i, 1]
        if crowd.periodic_x:
            px -= math.floor(px / crowd.width) * crowd.width
        if crowd.periodic_y:
            py -= math.floor(py / crowd.height) * crowd.height
        inside = crowd.periodic_x or (radius <= px) & (px <= crowd.width - radius)
        inside = inside and (crowd.periodic_y or (radius <= py) & (py <= crowd.height - radius))
        if not inside or off_capsules(crowd, px, py, scale * radius)[2] > 0.0:
            continue
        if look(crowd, px, py, radius, i, scale, 0.0)[0] == 0:
            settle(crowd, i, px, py)
