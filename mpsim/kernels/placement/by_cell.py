"""Points in the order of cells, so that neighbours in the box are neighbours in memory.

With discs and candidates at random places in memory, each look at a neighbour waits for memory. Sorted, ten million of
them take a fraction of the time.

Kernels that take a range do a piece of the work, so that threads can share it. Each writes its own elements, or values
that do not depend on which thread writes them, or when.
"""

import math
from typing import Any, NamedTuple

from mpsim.kernels.compiling import compiled, inlined

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


@compiled
def find_overlaps(points, diameter, worst, begin, end):
    """Number of pairs closer than the diameter, and the least distance; worst[0:2] receives the pair that has it.

    Pairs of points in slots [begin, end) with those that follow them. Cells are at least a diameter wide. Of equally
    close pairs, the one with the lowest numbers counts.
    """
    pairs, least = 0, diameter
    for slot in range(begin, end):
        x, y = points.x[slot], points.y[slot]
        column, row = place_of(x, y, points)
        for beside in range(column, min(column + 2, points.columns)):
            first, last = rows_near(beside, row, points)
            if beside == column:
                first = slot + 1
            for other in range(first, last):
                dx, dy = points.x[other] - x, points.y[other] - y
                distance = math.sqrt(dx * dx + dy * dy)
                if distance < diameter:
                    pairs += 1
                    low, high = points.number[slot], points.number[other]
                    low, high = min(low, high), max(low, high)
                    if distance < least or (distance == least and (high, low) < (worst[1], worst[0])):
                        least = distance
                        worst[0], worst[1] = low, high
    return pairs, least


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
