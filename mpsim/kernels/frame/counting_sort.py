"""The counting sort: sorts a worker's discs from any order."""

import numpy as np

from mpsim.kernels.compiling import inlined, linked
from mpsim.kernels.frame.copying import copy_disc, swap_discs
from mpsim.kernels.frame.sharing import cells_of
from mpsim.kernels.machine import nonnegative

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
