"""The incremental sort: if few discs have changed cells, it repairs the previous order.

Most discs stay in their cells from one step to the next, and those are already in order. The runs between discs that
leave a cell and discs that arrive in one are copied to the other buffer by whole vectors, and the start of each cell is
shifted by the number of arrivals minus departures before it.
"""

from typing import Any, NamedTuple

import numpy as np

from mpsim.kernels.compiling import inlined, linked
from mpsim.kernels.frame.sharing import cells_of, copy_disc, copy_run, section_of
from mpsim.kernels.machine import RUN, add_to_lanes, nonnegative

BUCKET = 64
"""Cells whose arrivals stand in one list."""


@inlined
def buckets_of(first_cell, last_cell, worker):
    """First bucket of a worker's cells and one past the last. Workers share no bucket."""
    first = first_cell // BUCKET + worker
    return first, first + (last_cell - first_cell + BUCKET - 1) // BUCKET


@inlined
def insert_arrival(entry, bucket, changes):
    """Insert an entry into the linked list of a bucket, which is in the order (cell, id)."""
    cell, disc = changes.new_cell[entry], changes.id[entry]
    before, after = np.int64(-1), np.int64(changes.first_arrival[bucket])
    while after >= 0 and (
        changes.new_cell[after] < cell or (changes.new_cell[after] == cell and changes.id[after] < disc)
    ):
        before, after = after, np.int64(changes.next_arrival[after])
    changes.next_arrival[entry] = after
    if before < 0:
        changes.first_arrival[bucket] = entry
    else:
        changes.next_arrival[before] = entry


@linked
def list_arrivals(discs, changes, team, worker, control):
    """List the discs that arrive in own cells, in the order (cell, id)."""
    mine = team[worker]
    first_cell, last_cell = cells_of(team, worker, control)
    first_bucket, last_bucket = buckets_of(first_cell, last_cell, worker)
    changes.first_arrival[first_bucket:last_bucket] = -1
    first, _ = section_of(mine)
    last = nonnegative(first + mine.leavers)
    for other in range(control.members):
        if other != worker:
            for k in range(team[other].low, team[other].low + team[other].outbox):
                i = nonnegative(changes.outbox[k])
                if first_cell <= discs.cell[i] < last_cell:
                    changes.slot[last], changes.new_cell[last], changes.id[last] = i, discs.cell[i], discs.id[i]
                    last += 1
    for entry in range(nonnegative(first), last):
        cell = changes.new_cell[entry]
        if first_cell <= cell < last_cell:
            insert_arrival(entry, first_bucket + (cell - first_cell) // BUCKET, changes)


@inlined
def shift_starts(start, first, last, shift, end):
    """Shift the starts of the cells [first, last); those from `end` on are another worker's, which may use them."""
    cell, last = nonnegative(first), np.int64(last)
    while cell < last and cell + RUN <= end:
        add_to_lanes(start, cell, last - cell, shift)
        cell += RUN
    while cell < last:
        start[cell] += shift
        cell += 1


class Cursor(NamedTuple):
    """The progress of the merge of discs that stay with discs that arrive.

    bucket: the next one to merge. read: the next disc to copy, to slot read + shift. cell: the next one whose start is
    to be shifted. leaver: the next entry in the list of discs that leave.
    """

    bucket: Any
    read: Any
    cell: Any
    shift: Any
    leaver: Any


@inlined
def first_cursor(team, worker, control, slot):
    """The cursor of a merge into the slots from `slot` on."""
    mine = team[worker]
    first_cell, last_cell = cells_of(team, worker, control)
    bucket, _ = buckets_of(first_cell, last_cell, worker)
    leaver, _ = section_of(mine)
    return Cursor(bucket, mine.low, first_cell + 1, slot - mine.low, leaver)


@inlined
def copy_up_to(place, cursor, source, target, start, changes, mine, end, last_cell):
    """Copy the discs up to slot `place`, without those that leave. Returns the cursor, with the bucket it had."""
    bucket, read, cell, shift, leaver = cursor
    last_leaver = section_of(mine)[0] + mine.leavers
    while leaver < last_leaver and changes.slot[leaver] < place:
        copy_run(source, read, changes.slot[leaver], target, read + shift, end)
        read = changes.slot[leaver] + np.int64(1)
        beyond = changes.old_cell[leaver] + np.int64(1)
        shift_starts(start, cell, beyond, shift, last_cell + 1)
        cell = beyond
        shift -= 1
        leaver += 1
    copy_run(source, read, place, target, read + shift, end)
    return Cursor(bucket, np.int64(place), cell, shift, leaver)


@inlined
def place_of(entry, cursor, discs, start, changes):
    """The slot before which an arriving disc belongs, among those of its cell that are still to be copied."""
    cell, disc = nonnegative(changes.new_cell[entry]), changes.id[entry]
    slot = nonnegative(cursor.read if cell < cursor.cell else start[cell])
    end = start[cell + 1]
    while slot < end and discs.id[slot] < disc:
        slot += 1
    return slot


@inlined
def copy_arrival(entry, cursor, source, target, start, changes, last_cell):
    """Copy a disc that arrives. Returns the cursor behind it."""
    bucket, read, cell, shift, leaver = cursor
    copy_disc(source, nonnegative(changes.slot[entry]), target, nonnegative(read + shift))
    beyond = changes.new_cell[entry] + np.int64(1)
    shift_starts(start, cell, beyond, shift, last_cell + 1)
    return Cursor(bucket, read, beyond, shift + 1, leaver)


@linked
def merge_up_to(column, cursor, source, target, start, changes, team, worker, control, end):
    """Copy own discs, in order, to the other buffer, at least up to a column; slots from `end` on belong to others.

    Shifts the starts of their cells, and that of the cell after them. Returns the cursor behind them.
    """
    mine = team[worker]
    first_cell, last_cell = cells_of(team, worker, control)
    first_bucket, last_bucket = buckets_of(first_cell, last_cell, worker)
    if column < mine.last_column:
        cells = column * (control.rows + 2) - first_cell
        last_bucket = min(last_bucket, first_bucket + (cells + BUCKET - 1) // BUCKET)
        if cursor.bucket >= last_bucket:  # a bucket may hold more columns than one call asks for
            return cursor
    while cursor.bucket < last_bucket:
        entry = np.int64(changes.first_arrival[cursor.bucket])
        while entry >= 0:
            place = place_of(entry, cursor, source, start, changes)
            cursor = copy_up_to(place, cursor, source, target, start, changes, mine, end, last_cell)
            cursor = copy_arrival(entry, cursor, source, target, start, changes, last_cell)
            entry = np.int64(changes.next_arrival[entry])
        cursor = Cursor(cursor.bucket + 1, cursor.read, cursor.cell, cursor.shift, cursor.leaver)
    last = min(first_cell + (last_bucket - first_bucket) * BUCKET, last_cell)
    place = mine.high if last == last_cell else start[last]
    cursor = copy_up_to(place, cursor, source, target, start, changes, mine, end, last_cell)
    shift_starts(start, cursor.cell, last + 1, cursor.shift, last_cell + 1)
    return Cursor(cursor.bucket, cursor.read, last + 1, cursor.shift, cursor.leaver)
