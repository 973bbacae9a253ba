"""Discs placed in a scene: neighbours found by cell, overlaps removed, Monte Carlo moves."""

import math
from collections import namedtuple
from typing import Any, NamedTuple

from mpsim.kernels.compiling import compiled, inlined, linked
from mpsim.kernels.geometry import AX, AY, BX, BY, POLYGON, RADIUS, concerns, nearest_image

# --- Points in the order of cells, so that neighbours in the box are neighbours in memory
#
# With discs and candidates at random places in memory, each look at a neighbour waits for memory. Sorted, ten million
# of them take a fraction of the time.
#
# Kernels that take a range do a piece of the work, so that threads can share it. Each writes its own elements, or
# values that do not depend on which thread writes them, or when.

UNDECIDED, TAKEN, REJECTED = range(3)


class ByCell(NamedTuple):
    """Points in the order (cell, number); cells are numbered column by column.

    x, y: float64 (N,) [length]; number: int32 (N,), of the point, in the order in which points were given.
    start: int32 (columns * rows + 1,), first slot of each cell. per_x, per_y: columns and rows per length [1/length].
    """

    x: Any
    y: Any
    number: Any
    start: Any
    columns: Any
    rows: Any
    per_x: Any
    per_y: Any


@inlined
def place_of(x, y, points):
    """Column and row of the cell in which a place lies; rounding may put it beyond the last."""
    column, row = int(x * points.per_x), int(y * points.per_y)
    return min(column, points.columns - 1), min(row, points.rows - 1)


@compiled
def count_points(places, points):
    """Count more points, shape (M, 2), in the cells: that of cell c in start[c + 1]."""
    for k in range(places.shape[0]):
        column, row = place_of(places[k, 0], places[k, 1], points)
        points.start[column * points.rows + row + 1] += 1


@compiled
def place_points(places, number, points, first, last):
    """Put more points, numbered from `number` on, into the next slots of their cells, of columns [first, last).

    start[c + 1]: the first free slot of cell c; when all are placed, it is the end of the cell.
    """
    if first == last:
        return
    for k in range(places.shape[0]):
        x, y = places[k, 0], places[k, 1]
        column, row = place_of(x, y, points)
        if first <= column < last:
            cell = column * points.rows + row
            slot = points.start[cell + 1]
            points.start[cell + 1] = slot + 1
            points.x[slot], points.y[slot], points.number[slot] = x, y, number + k


@inlined
def rows_near(column, row, points):
    """First slot and one past the last of the cells row - 1, row and row + 1 of a column."""
    cell = column * points.rows
    return points.start[cell + max(row - 1, 0)], points.start[cell + min(row + 2, points.rows)]


@inlined
def overlaps_any(x, y, discs, diameter):
    """Whether a disc at (x, y) would overlap one of the discs sorted by cell."""
    column, row = place_of(x, y, discs)
    for beside in range(max(column - 1, 0), min(column + 2, discs.columns)):
        first, last = rows_near(beside, row, discs)
        for other in range(first, last):
            dx, dy = discs.x[other] - x, discs.y[other] - y
            if dx * dx + dy * dy < diameter * diameter:
                return True
    return False


@inlined
def find_obstacle(slot, points, state, diameter):
    """An earlier taken point within a diameter; else an undecided one; -1 if there is neither."""
    x, y, number = points.x[slot], points.y[slot], points.number[slot]
    column, row = place_of(x, y, points)
    found = -1
    for beside in range(max(column - 1, 0), min(column + 2, points.columns)):
        first, last = rows_near(beside, row, points)
        for other in range(first, last):
            if points.number[other] < number and state[other] != REJECTED:
                dx, dy = points.x[other] - x, points.y[other] - y
                if dx * dx + dy * dy < diameter * diameter:
                    if state[other] == TAKEN:
                        return other
                    found = other
    return found


@compiled
def take_sequentially(points, state, waiting, diameter, begin, end):
    """Decide which points in slots [begin, end) random sequential addition takes.

    These are the points that overlap no earlier taken point.

    A point is decided after those that it overlaps, which are kept in `waiting` meanwhile. Returns whether all are
    decided; where `waiting` was too short, another call decides more.
    """
    complete = True
    for slot in range(begin, end):
        waiting[0] = slot
        depth = 1 if state[slot] == UNDECIDED else 0
        while depth > 0:
            other = find_obstacle(waiting[depth - 1], points, state, diameter)
            if other < 0 or state[other] == TAKEN:
                state[waiting[depth - 1]] = TAKEN if other < 0 else REJECTED
                depth -= 1
            elif depth < waiting.size:
                waiting[depth] = other
                depth += 1
            else:
                complete = False
                depth = 0
    return complete


@compiled
def number_taken(points, state, order, most):
    """Number the taken points, in the order of their numbers, at most the first `most`. Returns how many.

    order: int32 (N,), by the number of a point; -1 for points without one.
    """
    for slot in range(points.x.size):
        order[points.number[slot]] = state[slot]
    taken = 0
    for number in range(order.size):
        if order[number] == TAKEN and taken < most:
            order[number] = taken
            taken += 1
        else:
            order[number] = -1
    return taken


@compiled
def copy_taken(points, order, x, y):
    """Copy the points that are taken to their places in `order`."""
    for slot in range(points.x.size):
        place = order[points.number[slot]]
        if place >= 0:
            x[place], y[place] = points.x[slot], points.y[slot]


@compiled
def keep_taken(points, order):
    """Keep only the taken points, moved to the front, and update the starts of the cells. Returns how many."""
    kept = 0
    slot = 0
    for cell in range(points.start.size - 1):
        end = points.start[cell + 1]
        points.start[cell] = kept
        while slot < end:
            number = points.number[slot]
            if order[number] >= 0:
                points.x[kept], points.y[kept], points.number[kept] = points.x[slot], points.y[slot], order[number]
                kept += 1
            slot += 1
    points.start[points.start.size - 1] = kept
    return kept


@compiled
def reject_overlapping(points, state, discs, diameter, begin, end):
    """Reject the points in slots [begin, end) that overlap one of `discs`, which are sorted by cells of their own."""
    for slot in range(begin, end):
        if state[slot] == UNDECIDED and overlaps_any(points.x[slot], points.y[slot], discs, diameter):
            state[slot] = REJECTED


# --- Monte Carlo moves of equal discs
#
# The occupancy grid has cells of side diameter / sqrt(2), whose diagonal is one diameter, so that a cell holds one
# disc at most and its content is one number. A disc can only overlap discs up to two cells away.

EMPTY = -1


@linked
def is_free(x, y, grid, px, py, mover, diameter, cells_per_length):
    """Whether a disc at (px, py) overlaps no disc except, perhaps, `mover`."""
    columns, rows = grid.shape
    column, row = int(px * cells_per_length), int(py * cells_per_length)
    for c in range(max(column - 2, 0), min(column + 3, columns)):
        for r in range(max(row - 2, 0), min(row + 3, rows)):
            other = grid[c, r]
            if other != EMPTY and other != mover:
                dx, dy = x[other] - px, y[other] - py
                if dx * dx + dy * dy < diameter * diameter:
                    return False
    return True


@compiled
def sweep(x, y, grid, moves, low, x_high, y_high, diameter, cells_per_length):
    """One Monte Carlo move per disc, accepted if it leads into the box and to no overlap (Metropolis et al. 1953)."""
    for i in range(x.size):
        px, py = x[i] + moves[i, 0], y[i] + moves[i, 1]
        inside = (low <= px) & (px <= x_high) & (low <= py) & (py <= y_high)
        if inside and is_free(x, y, grid, px, py, i, diameter, cells_per_length):
            grid[int(x[i] * cells_per_length), int(y[i] * cells_per_length)] = EMPTY
            grid[int(px * cells_per_length), int(py * cells_per_length)] = i
            x[i], y[i] = px, py


# --- Discs of any sizes, with or without periodic axes, among capsules: finds overlaps, separates and shuffles discs
#
# Discs whose radii lie within a factor of two share a level, and a level has a grid of its own, of cells no narrower
# than its largest disc. A search visits a few cells of each level, so it is fast however much the sizes of the discs
# differ.


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
        return max(low, 0), min(high, cells - 1)
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
    """Overlaps of a disc at (px, py) with discs other than `mover`: (how many, the deepest, its depth [length]).

    Radii count times `scale`, and two discs closer than their sum by no more than `slack` [length] do not overlap.
    """
    number, partner, worst = 0, EMPTY, 0.0
    for level in range(crowd.columns.size):
        columns, rows = crowd.columns[level], crowd.rows[level]
        reach = scale * (radius + crowd.largest[level])
        left, right = span(px, reach, crowd.width, columns, crowd.periodic_x)
        bottom, top = span(py, reach, crowd.height, rows, crowd.periodic_y)
        for c in range(left, right + 1):
            for r in range(bottom, top + 1):
                j = crowd.head[crowd.first[level] + (c % columns) * rows + r % rows]
                while j != EMPTY:
                    contact = scale * (radius + crowd.radius[j]) - slack
                    dx = nearest_image(crowd.x[j] - px, crowd.width, crowd.periodic_x)
                    dy = nearest_image(crowd.y[j] - py, crowd.height, crowd.periodic_y)
                    square = dx * dx + dy * dy
                    if j != mover and contact > 0.0 and square < contact * contact:
                        number += 1
                        depth = contact - math.sqrt(square)
                        if depth > worst:
                            partner, worst = j, depth
                    j = crowd.following[j]
    return number, partner, worst


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
    """Overlapping pairs among linked discs: (how many, depth of the deepest); worst[0:2] receives the deepest pair."""
    twice, deepest = 0, 0.0
    for i in range(crowd.x.size):
        number, j, depth = look(crowd, crowd.x[i], crowd.y[i], crowd.radius[i], i, 1.0, slack)
        twice += number
        if depth > deepest:
            deepest = depth
            worst[0], worst[1] = min(i, j), max(i, j)
    return twice // 2, deepest


@compiled
def crowded(crowd, scale):
    """Whether any linked disc overlaps another or a capsule."""
    for i in range(crowd.x.size):
        px, py, radius = crowd.x[i], crowd.y[i], crowd.radius[i]
        if off_capsules(crowd, px, py, scale * radius)[2] > 0.0 or look(crowd, px, py, radius, i, scale, 0.0)[0]:
            return True
    return False


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
        low_x = 0.0 if crowd.periodic_x else radius
        low_y = 0.0 if crowd.periodic_y else radius
        px = low_x + candidates[k, 0] * (crowd.width - 2.0 * low_x)
        py = low_y + candidates[k, 1] * (crowd.height - 2.0 * low_y)
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
        low_x = 0.0 if crowd.periodic_x else radius
        low_y = 0.0 if crowd.periodic_y else radius
        least = math.inf
        for choice in range(candidates.shape[1]):
            px = low_x + candidates[k, choice, 0] * (crowd.width - 2.0 * low_x)
            py = low_y + candidates[k, choice, 1] * (crowd.height - 2.0 * low_y)
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
        _, j, depth = look(crowd, crowd.x[i], crowd.y[i], crowd.radius[i], i, scale, 0.0)
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
