"""The sort of a step: discs in the order (column, row, id), for any number of workers.

Cells are numbered column by column. Each column has an empty ghost cell below its first and above its last row, and
an empty ghost column follows the last one, so that no neighbour needs a test for the edge of the box.
start[cell] is the first disc of a cell and start[cell + 1] one past its last.

The order is a function of the discs alone, so it does not matter how it is obtained: each worker repairs the previous
one if few of its discs have changed cells (`incremental_sort.py`), else sorts all (`counting_sort.py`).
"""

import numpy as np

from mpsim.kernels.compiling import inlined, linked, slice_of
from mpsim.kernels.features.hooks import after_binning
from mpsim.kernels.frame.incremental_sort import list_arrivals
from mpsim.kernels.frame.motion import move_block, note_not_finite
from mpsim.kernels.frame.sharing import cells_of, copy_disc, first_slot_of, immigrants_of, section_of, swap_discs
from mpsim.kernels.machine import LANES, changed_lanes, lowest_bit, nonnegative
from mpsim.kernels.records import Discs

# --- The counting sort: sorts a worker's discs from any order

ORDERED_AT_ONCE = 64
"""Discs whose order is looked at together."""


@linked
def count_discs(discs, start, changes, team, worker, control):
    """Count the discs of own cells: those of the slice, and those that other workers list."""
    mine = team[worker]
    first_cell, last_cell = cells_of(team, worker, control)
    start[first_cell + 1 : last_cell + 1] = 0
    for i in range(mine.low, mine.high):
        cell = discs.cell[nonnegative(i)]
        if first_cell <= cell < last_cell:
            start[nonnegative(cell) + 1] += 1
    for other in range(control.members):
        for k in range(team[other].low, team[other].low + team[other].outbox):
            cell = discs.cell[changes.outbox[k]]
            if first_cell <= cell < last_cell:
                start[cell + 1] += 1


@linked
def counts_to_starts(start, first_cell, last_cell, slot):
    """Exclusive prefix sum: start[cell + 1], a count, becomes the slot of the cell's first disc."""
    counts = start[first_cell + 1 : last_cell + 1]
    for cell in range(counts.size):
        count = counts[cell]
        counts[cell] = slot
        slot += count


@inlined
def place(source, i, target, start):
    """Copy disc i to the next free slot of its cell. When all are placed, start[cell + 1] is the cell's end."""
    cell = nonnegative(source.cell[i])
    slot = nonnegative(start[cell + 1])
    start[cell + 1] = slot + 1
    copy_disc(source, i, target, slot)


@linked
def place_all(source, target, start, changes, team, worker, control):
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
    for other in range(control.members):
        for k in range(team[other].low, team[other].low + team[other].outbox):
            if first_cell <= source.cell[changes.outbox[k]] < last_cell:
                place(source, changes.outbox[k], target, start)


@inlined
def is_out_of_order(discs, low, high):
    """Whether a disc of [low, high) has a lower id than the one before it in the same cell. Vector code."""
    cells, cells_before = discs.cell[low:high], discs.cell[low - 1 : high - 1]
    ids, ids_before = discs.id[low:high], discs.id[low - 1 : high - 1]
    found = np.int32(0)
    for i in range(high - low):
        found |= np.int32((cells[i] == cells_before[i]) & (ids[i] < ids_before[i]))
    return found != 0


@linked
def order_by_id(discs, low, high):
    """Insertion sort by id inside each cell. Discs that stay in a cell are already in order, so this seldom acts."""
    for block in range(nonnegative(low) + 1, high, ORDERED_AT_ONCE):
        end = min(block + ORDERED_AT_ONCE, high)
        if is_out_of_order(discs, block, end):
            for i in range(block, end):
                k = i
                while k > low and discs.cell[k] == discs.cell[k - 1] and discs.id[k] < discs.id[k - 1]:
                    swap_discs(discs, k, k - 1)
                    k -= 1


@linked
def sort_anew(source, target, start, changes, team, worker, control, slot, end):
    """Counting sort of the discs of own columns into the slots [slot, end) of the other buffer."""
    count_discs(source, start, changes, team, worker, control)
    counts_to_starts(start, *cells_of(team, worker, control), slot)
    place_all(source, target, start, changes, team, worker, control)
    order_by_id(target, slot, end)


BLOCK = 1024
"""Discs that are moved and binned at a time, so that they are still in the cache."""


@inlined
def bin_discs(discs, low, high, parameters, control):
    """Cell of each disc of a slice; below 0 or beyond the table if another rank has the column."""
    # 32-bit throughout, so the loop is vector code. The last row and column also hold what rounding puts beyond them.
    last_column, last_row = np.int32(control.columns - 1), np.int32(control.rows - 1)
    stride = np.int32(control.rows + 2)
    ghost = np.int32(1) - np.int32(control.columns_before) * stride
    x, y, cells = discs.x[low:high], discs.y[low:high], discs.cell[low:high]
    cells_per_x, cells_per_y = parameters.cells_per_x, parameters.cells_per_y
    for i in range(high - low):
        column = min(np.int32(x[i] * cells_per_x), last_column)
        row = min(np.int32(y[i] * cells_per_y), last_row)
        cells[i] = column * stride + row + ghost


@inlined
def list_leavers(discs, cells, low, high, mine, changes):
    """List the discs of [low, high) whose new cell, in `cells`, differs from the old one, and give them the new one.

    Once the list is full, only their number is counted.
    """
    first, room = section_of(mine)
    found = nonnegative(mine.leavers)
    old = discs.cell[low : high + LANES]  # the last vector may reach beyond
    for block in range(0, high - low, LANES):
        mask = changed_lanes(old, cells, block) & ((1 << min(high - low - block, LANES)) - 1)
        while mask != 0:
            k = nonnegative(block + lowest_bit(mask))
            mask &= mask - 1
            if found < room:
                changes.slot[first + found] = low + k
                changes.old_cell[first + found] = old[k]
                changes.new_cell[first + found] = cells[k]
                changes.id[first + found] = discs.id[low + k]
            found += 1
            old[k] = cells[k]
    mine.leavers = found


@inlined
def find_cells(discs, spare, low, high, changes, features, parameters, control, mine):
    """Cell of each disc of [low, high), and the list of discs whose cell is new.

    spare: the other buffer, whose cells are free until the sort.
    """
    cells = spare.cell[mine.low : mine.low + high - low + LANES]
    x, y, vx, vy, numbers = (
        discs.x[low:high],
        discs.y[low:high],
        discs.vx[low:high],
        discs.vy[low:high],
        discs.id[low:high],
    )
    binned = Discs(x, y, vx, vy, numbers, cells, slice_of(discs.radius, low, high))
    bin_discs(binned, 0, high - low, parameters, control)
    after_binning(binned, 0, high - low, features, control)
    list_leavers(discs, cells, low, high, mine, changes)


@linked
def move_and_bin(discs, spare, changes, features, parameters, control, mine, tally):
    """Advance the slice and find the cells of its discs while they are in the cache. Returns whether all are finite.

    Discs that have changed cells are counted in mine.leavers; mine.listed says whether the list has them all.
    """
    mine.leavers = 0
    finite = True
    for low in range(mine.low, mine.high, BLOCK):
        high = min(low + BLOCK, mine.high)
        finite &= move_block(discs, low, high, features, parameters, control, mine, tally)
        if finite:  # otherwise no disc may be binned by its position
            find_cells(discs, spare, low, high, changes, features, parameters, control, mine)
    if not finite:
        note_not_finite(discs, mine.low, mine.high, control, mine)
    mine.listed = control.in_order == 1 and mine.leavers <= section_of(mine)[1]
    return finite


@linked
def begin_sort(source, target, start, changes, team, sent, worker, control):
    """Sort the discs of own columns into the other buffer, or list what `merge_up_to` needs to do it.

    Returns the slice where they lie there, and whether they must still be merged.
    """
    mine = team[worker]
    immigrants = immigrants_of(sent, worker, control)
    slot = first_slot_of(team, sent, worker, control)
    end = slot + mine.kept + immigrants
    if mine.listed == 1 and mine.leavers + immigrants <= section_of(mine)[1]:
        list_arrivals(source, changes, team, worker, control)
        return slot, end, True
    sort_anew(source, target, start, changes, team, worker, control, slot, end)
    return slot, end, False
