"""The cells of the exact solver: how many there are, the lists of their discs, and the search for overlaps."""

import math

import numpy as np

from mpsim.kernels.compiling import inlined, linked
from mpsim.kernels.events.boundary import cell_beyond, neighbour
from mpsim.kernels.events.calendar import reschedule
from mpsim.kernels.events.features.hooks import is_absent, radius_of
from mpsim.kernels.events.flight import INFINITY
from mpsim.kernels.events.records import BOTTOM, MOST_NEAR
from mpsim.kernels.events.region import counts, here_along, number_of_cell, place_along
from mpsim.kernels.machine import nonnegative


def plan_cells(width, height, largest_diameter, count):
    """(columns, rows) of cells for a box [length].

    A cell is at least one diameter wide, and in a dilute scene wide enough for about one disc in two cells. A
    periodic axis must be two diameters long, or a pair could touch on both sides at once; the scene ensures that.
    """
    roomy = math.sqrt(width * height / (2.0 * max(count, 1)))
    # Slightly wider than a diameter: rounding must not let discs two cells apart touch.
    cell_length = max(largest_diameter * (1.0 + 1e-9), roomy)
    most = max(2 * count, 4)
    return min(max(int(width / cell_length), 1), most), min(max(int(height / cell_length), 1), most)


@inlined
def cell_of(i, store, box):
    """Number of the cell that disc i is in; -1 if it is not in this store."""
    cell = store.event[i].cell
    return number_of_cell(place_along(0, cell[0], store.region, box), cell[1], store.region, box)


@inlined
def particle_of(i, store):
    """The particle of the scene that disc i is."""
    return store.order[store.event[i].number]


@inlined
def leave_list(i, cell, store):
    """Remove disc i from the list of its cell, if the cell is in this store."""
    if cell < 0:
        return
    j = store.cell_head[cell]
    if j == i:
        store.cell_head[cell] = store.cell_next[i]
        return
    while store.cell_next[j] != i:
        j = store.cell_next[j]
    store.cell_next[j] = store.cell_next[i]


@inlined
def enter_list(i, cell, store):
    """Add disc i to the list of a cell, if the cell is in this store."""
    if cell < 0:
        return
    store.cell_next[i] = store.cell_head[cell]
    store.cell_head[cell] = i


@inlined
def cross(i, side, store, box, features):
    """Cell crossing: disc i, whose stored state is current, enters the cell beyond that border."""
    axis = side >> 1
    direction = 1 if side & 1 else -1
    leave_list(i, cell_of(i, store, box), store)
    store.event[i].cell[axis] = cell_beyond(i, axis, direction, store, box, features)
    enter_list(i, cell_of(i, store, box), store)
    store.counter.crossings += counts(store.region)


@inlined
def leave_store(i, store):
    """Disc i has left the region of a store: no disc meets it any more, and it has no further event."""
    store.disc[i].collision_time = store.disc[i].crossing_time = INFINITY
    store.event[i].collision_count += 1
    reschedule(i, store)


@inlined
def block_to_search(i, side, event):
    """The cells to search for disc i: (first column, last column, first row, last row).

    The nine cells around it; right after it has crossed to `side` (-1: it has not) only the three ahead are new.
    """
    column = event[i].cell[0]
    row = event[i].cell[1]
    if side < 0:
        return column - 1, column + 1, row - 1, row + 1
    direction = 1 if side & 1 else -1
    if side < BOTTOM:
        return column + direction, column + direction, row - 1, row + 1
    return column - 1, column + 1, row + direction, row + direction


@inlined
def is_inside(i, store, box):
    """Whether disc i's cell has cells on all sides that are in this store, none of them through a border."""
    cell, region = store.event[i].cell, store.region
    column, row = place_along(0, cell[0], region, box), place_along(1, cell[1], region, box)
    in_store = (column >= 1) & (column < here_along(0, region, box) - 1) & (row >= 1)
    in_store &= row < here_along(1, region, box) - 1
    in_box = (cell[0] >= 1) & (cell[0] < box.columns - 1) & (cell[1] >= 1) & (cell[1] < box.rows - 1)
    return in_store & in_box


@inlined
def gather(first, columns, rows, store, box):
    """Write the discs of a block of cells, from number `first` on, into `store.near`. Returns how many, or MOST_NEAR.

    Whether a cell is empty is unpredictable, so no branch tests it.
    """
    near, found, cell = store.near, 0, first
    for _ in range(columns):
        for row in range(rows):
            i = store.cell_head[nonnegative(cell + row)]
            near[nonnegative(found)] = i
            found += i >= 0
        cell += here_along(1, store.region, box)
    read = 0
    while read < found < MOST_NEAR:
        i = store.cell_next[nonnegative(np.int64(near[nonnegative(read)]))]
        near[nonnegative(found)] = i
        found += i >= 0
        read += 1
    return found


@linked
def link_cells(store, box, features):
    """Enter every disc of a newly placed scene in the list of its cell."""
    store.cell_head[:] = -1
    store.cell_next[:] = -1
    for i in range(store.disc.shape[0]):
        if not is_absent(i, features):
            enter_list(i, cell_of(i, store, box), store)


@linked
def enter_absent(store, box, features):
    """Also enter the discs that have left, in the lists of the cells where they left, so that none is omitted.

    No event may be processed after this until `link_cells`.
    """
    for i in range(store.disc.shape[0]):
        if is_absent(i, features):
            enter_list(i, cell_of(i, store, box), store)


@linked
def deepest_overlap(store, box, features):
    """The deepest overlap of a newly placed scene: (particle, particle, depth [length]); (-1, -1, 0.0) for none.

    Linear in the number of discs: in a scene too crowded for that, the search stops with the worst so far.
    """
    link_cells(store, box, features)
    disc = store.disc
    worst = 0.0
    pair = (-1, -1)
    tests = 0
    for i in range(disc.shape[0]):
        if is_absent(i, features):
            continue
        ri = radius_of(i, box, features)
        first_column, last_column, first_row, last_row = block_to_search(i, -1, store.event)
        for column_ahead in range(first_column, last_column + 1):
            column, shift_x = neighbour(column_ahead, box.columns, box.width, box.periodic_x)
            for row_ahead in range(first_row, last_row + 1):
                row, shift_y = neighbour(row_ahead, box.rows, box.height, box.periodic_y)
                j = store.cell_head[column * box.rows + row] if row >= 0 and column >= 0 else -1
                while j >= 0:
                    rx = (disc[j].position[0] - disc[i].position[0]) + shift_x
                    ry = (disc[j].position[1] - disc[i].position[1]) + shift_y
                    depth = ri + radius_of(j, box, features) - math.sqrt(rx * rx + ry * ry)
                    if j != i and depth > worst:
                        worst = depth
                        pair = (particle_of(i, store), particle_of(j, store))
                    tests += 1
                    j = store.cell_next[j]
        if tests > 1_000_000 + 200 * disc.shape[0] and worst > 0.0:
            break
    return min(pair), max(pair), worst
