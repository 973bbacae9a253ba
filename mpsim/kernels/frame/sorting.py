"""The grid: discs counted and sorted into cells, column by column, by several workers at once.

Cells are numbered column by column. Each column has an empty ghost cell below its first and above its last row, and
an empty ghost column follows the last one, so that no neighbour needs a test for the edge of the box.
start[cell] is the first disc of a cell and start[cell + 1] one past its last.
"""

import numpy as np

from mpsim.kernels.compiling import compiled, inlined
from mpsim.kernels.machine import nonnegative

ORDERED_AT_ONCE = 64
"""Discs whose order is looked at together."""


@compiled
def bin_discs(discs, low, high, parameters, control):
    """Cell of each disc of a slice."""
    # 32-bit throughout: the loop then is vector code. The last row and column also hold what rounding puts beyond.
    last_column, last_row = np.int32(control.columns - 1), np.int32(control.rows - 1)
    stride, ghost = np.int32(control.rows + 2), np.int32(1)
    x, y, cells = discs.x[low:high], discs.y[low:high], discs.cell[low:high]
    cells_per_x, cells_per_y = parameters.cells_per_x, parameters.cells_per_y
    for i in range(high - low):
        column = min(np.int32(x[i] * cells_per_x), last_column)
        row = min(np.int32(y[i] * cells_per_y), last_row)
        cells[i] = column * stride + row + ghost


@inlined
def cells_of(team, worker, control):
    """First cell of a worker's columns and one past the last; the last worker has whatever lies beyond the grid."""
    stride = control.rows + 2
    if worker == control.workers - 1:
        return team[worker].first_column * stride, control.cells
    return team[worker].first_column * stride, team[worker].last_column * stride


@compiled
def count_cells(discs, start, outbox, sent, team, worker, control):
    """Count own discs per cell, and list those that moved into another worker's columns.

    The list lies in the slice's own section of `outbox`; sent[w] says how many of it go to worker w.
    """
    mine = team[worker]
    first_cell, last_cell = cells_of(team, worker, control)
    start[first_cell + 1 : last_cell + 1] = 0
    sent[:] = 0
    left = 0
    low, high = mine.low, mine.high
    for i in range(low, high):
        cell = nonnegative(discs.cell[nonnegative(i)])
        if first_cell <= cell < last_cell:
            start[cell + 1] += 1
        else:
            outbox[low + left] = i
            left += 1
            for other in range(control.workers):
                first, last = cells_of(team, other, control)
                sent[other] += first <= cell < last
    mine.outbox = left
    mine.kept = high - low - left


@compiled
def count_immigrants(discs, start, outbox, team, worker, control):
    """Add to the counts the discs that other workers list and that now lie in own columns."""
    first_cell, last_cell = cells_of(team, worker, control)
    for other in range(control.workers):
        for k in range(team[other].low, team[other].low + team[other].outbox):
            cell = discs.cell[outbox[k]]
            if first_cell <= cell < last_cell:
                start[cell + 1] += 1


@compiled
def first_slot_of(team, sent, worker, control):
    """First slot of a worker's discs after the sort: how many discs the workers before it will hold."""
    slot = 0
    for before in range(worker):
        slot += team[before].kept
        for other in range(control.workers):
            slot += sent[other, before]
    return slot


@compiled
def counts_to_starts(start, first_cell, last_cell, slot):
    """Exclusive prefix sum: start[cell + 1], a count, becomes the slot of the cell's first disc. Returns the end."""
    counts = start[first_cell + 1 : last_cell + 1]
    for cell in range(counts.size):
        count = counts[cell]
        counts[cell] = slot
        slot += count
    return slot


@inlined
def place(source, i, target, start):
    """Copy disc i to the next free slot of its cell. When all are placed, start[cell + 1] is the cell's end."""
    cell = nonnegative(source.cell[i])
    slot = nonnegative(start[cell + 1])
    start[cell + 1] = slot + 1
    target.x[slot] = source.x[i]
    target.y[slot] = source.y[i]
    target.vx[slot] = source.vx[i]
    target.vy[slot] = source.vy[i]
    target.id[slot] = source.id[i]
    target.cell[slot] = cell
    place_radius(source.radius, i, target.radius, slot)


@inlined
def place_radius(source, i, target, slot):
    """The radius goes along, where each disc has its own."""
    if source is not None:
        target[slot] = source[i]


@inlined
def swap_radii(radius, i, j):
    """Exchange the radii of two discs, where each has its own."""
    if radius is not None:
        radius[i], radius[j] = radius[j], radius[i]


@compiled
def place_all(source, target, start, outbox, team, worker, control):
    """Place the slice's discs that stayed, then those that arrive from other workers."""
    mine = team[worker]
    first_cell, last_cell = cells_of(team, worker, control)
    if mine.outbox == 0:
        for i in range(mine.low, mine.high):
            place(source, nonnegative(i), target, start)
    else:
        for i in range(mine.low, mine.high):
            if first_cell <= source.cell[i] < last_cell:
                place(source, nonnegative(i), target, start)
    for other in range(control.workers):
        for k in range(team[other].low, team[other].low + team[other].outbox):
            if first_cell <= source.cell[outbox[k]] < last_cell:
                place(source, outbox[k], target, start)


@inlined
def swap(discs, i, j):
    """Exchange two discs of one cell."""
    discs.x[i], discs.x[j] = discs.x[j], discs.x[i]
    discs.y[i], discs.y[j] = discs.y[j], discs.y[i]
    discs.vx[i], discs.vx[j] = discs.vx[j], discs.vx[i]
    discs.vy[i], discs.vy[j] = discs.vy[j], discs.vy[i]
    discs.id[i], discs.id[j] = discs.id[j], discs.id[i]
    swap_radii(discs.radius, i, j)


@inlined
def is_out_of_order(discs, low, high):
    """Whether a disc of [low, high) has a lower id than the one before it in the same cell. Vector code."""
    cells, cells_before = discs.cell[low:high], discs.cell[low - 1 : high - 1]
    ids, ids_before = discs.id[low:high], discs.id[low - 1 : high - 1]
    found = np.int32(0)
    for i in range(high - low):
        found |= np.int32((cells[i] == cells_before[i]) & (ids[i] < ids_before[i]))
    return found != 0


@compiled
def order_by_id(discs, low, high):
    """Insertion sort by id inside each cell. Discs that stay in a cell are in order already, so this seldom acts."""
    for block in range(nonnegative(low) + 1, high, ORDERED_AT_ONCE):
        end = min(block + ORDERED_AT_ONCE, high)
        if is_out_of_order(discs, block, end):
            for i in range(block, end):
                k = i
                while k > low and discs.cell[k] == discs.cell[k - 1] and discs.id[k] < discs.id[k - 1]:
                    swap(discs, k, k - 1)
                    k -= 1


@compiled
def sort(source, target, start, outbox, team, sent, worker, control):
    """Counting sort of the discs of own columns; afterwards the worker's slice is what lies there."""
    slot = first_slot_of(team, sent, worker, control)
    count_immigrants(source, start, outbox, team, worker, control)
    end = counts_to_starts(start, *cells_of(team, worker, control), slot)
    place_all(source, target, start, outbox, team, worker, control)
    order_by_id(target, slot, end)
    return slot, end
