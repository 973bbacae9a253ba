"""The sort of a step: discs in the order (column, row, id), for any number of workers.

Cells are numbered column by column. Each column has an empty ghost cell below its first and above its last row, and
an empty ghost column follows the last one, so that no neighbour needs a test for the edge of the box.
start[cell] is the first disc of a cell and start[cell + 1] one past its last.

The order is a function of the discs alone, so it does not matter how it is obtained: each worker repairs the previous
one if few of its discs have changed cells (`incremental_sort.py`), else sorts all (`counting_sort.py`).
"""

import numpy as np

from mpsim.kernels.compiling import inlined, linked
from mpsim.kernels.features.hooks import after_binning
from mpsim.kernels.frame.counting_sort import sort_anew
from mpsim.kernels.frame.incremental_sort import list_arrivals
from mpsim.kernels.frame.motion import move_block, note_not_finite
from mpsim.kernels.frame.sharing import first_slot_of, immigrants_of, section_of
from mpsim.kernels.layout import Discs
from mpsim.kernels.machine import LANES, changed_lanes, lowest_bit, nonnegative
from mpsim.kernels.optional import slice_of

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
