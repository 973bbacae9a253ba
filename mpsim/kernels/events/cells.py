"""The cells of the exact solver: lists of discs, images across a periodic border, and the search for overlaps."""

import math

from mpsim.kernels.compiling import compiled, inlined
from mpsim.kernels.events.state import COLUMN, ROW, X, Y


@inlined
def value_of(values, common, i):
    """A property of disc i: its own, or the one all discs share."""
    if values is None:
        return common
    return values[i]


@inlined
def wrapped(cell, cells, length, periodic):
    """A neighbouring cell and the shift of its image along one axis: (cell or -1 for none, shift)."""
    if cell < 0:
        return (cell + cells, -length) if periodic else (-1, 0.0)
    if cell >= cells:
        return (cell - cells, length) if periodic else (-1, 0.0)
    return cell, 0.0


@inlined
def nearest_image(difference, length, periodic):
    """One component of a relative position, to the nearest image."""
    if periodic and difference > 0.5 * length:
        return difference - length
    if periodic and difference < -0.5 * length:
        return difference + length
    return difference


@inlined
def leave_list(i, cell, store):
    """Take disc i out of the list of its cell."""
    j = store.cell_head[cell]
    if j == i:
        store.cell_head[cell] = store.cell_next[i]
        return
    while store.cell_next[j] != i:
        j = store.cell_next[j]
    store.cell_next[j] = store.cell_next[i]


@inlined
def enter_list(i, cell, store):
    """Put disc i into the list of a cell."""
    store.cell_next[i] = store.cell_head[cell]
    store.cell_head[cell] = i


@compiled
def link_cells(store, box):
    """Enter every disc of a scene just placed in the list of its cell."""
    store.cell_head[:] = -1
    for i in range(store.disc.shape[0]):
        enter_list(i, store.event[i, ROW] * box.columns + store.event[i, COLUMN], store)


@compiled
def worst_overlap(store, box):
    """The deepest overlap of a scene just placed: (particle, particle, depth [length]); (-1, -1, 0.0) for none.

    Linear in the number of discs: a scene so crowded that the search would not be stops at the worst so far.
    """
    link_cells(store, box)
    disc = store.disc
    worst = 0.0
    pair = (-1, -1)
    tests = 0
    for i in range(disc.shape[0]):
        ri = value_of(store.radius, box.radius, i)
        for row_ahead in range(store.event[i, ROW] - 1, store.event[i, ROW] + 2):
            row, shift_y = wrapped(row_ahead, box.rows, box.height, box.periodic_y)
            for column_ahead in range(store.event[i, COLUMN] - 1, store.event[i, COLUMN] + 2):
                column, shift_x = wrapped(column_ahead, box.columns, box.width, box.periodic_x)
                j = store.cell_head[row * box.columns + column] if row >= 0 and column >= 0 else -1
                while j >= 0:
                    rx = (disc[j, X] - disc[i, X]) + shift_x
                    ry = (disc[j, Y] - disc[i, Y]) + shift_y
                    depth = ri + value_of(store.radius, box.radius, j) - math.sqrt(rx * rx + ry * ry)
                    if j != i and depth > worst:
                        worst = depth
                        pair = (store.order[i], store.order[j])
                    tests += 1
                    j = store.cell_next[j]
        if tests > 1_000_000 + 200 * disc.shape[0] and worst > 0.0:
            break
    return min(pair), max(pair), worst
