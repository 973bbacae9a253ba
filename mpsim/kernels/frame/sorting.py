"""The sort of a step: discs in the order (column, row, id), by workers that share the frame."""

from typing import Any, NamedTuple

import numpy as np

from mpsim.kernels.compiling import compiled, copy_entry, inlined, linked, slice_of, swap_entries
from mpsim.kernels.features.hooks import after_binning
from mpsim.kernels.frame.motion import move_block, note_not_finite
from mpsim.kernels.machine import LANES, RUN, add_to_lanes, changed_lanes, copy_lanes, lowest_bit, nonnegative, now
from mpsim.kernels.records import WAIT, Discs
from mpsim.kernels.waiting import barrier

# --- Discs copied from one place to another: one by one, in runs, or exchanged


@inlined
def copy_disc(source, i, target, slot):
    """Copy disc i to a slot of the other buffer."""
    target.x[slot] = source.x[i]
    target.y[slot] = source.y[i]
    target.vx[slot] = source.vx[i]
    target.vy[slot] = source.vy[i]
    target.id[slot] = source.id[i]
    target.cell[slot] = source.cell[i]
    copy_entry(source.radius, i, target.radius, slot)


@inlined
def copy_run(source, low, high, target, slot, end):
    """Copy the discs [low, high) to the slots from `slot` on.

    Copies whole vectors, so slots after the run, but none from `end` on, may be overwritten: write those later.
    """
    first, slot = nonnegative(low), nonnegative(slot)
    while first < high and slot + RUN <= end:
        copy_lanes(source.x, first, target.x, slot)
        copy_lanes(source.y, first, target.y, slot)
        copy_lanes(source.vx, first, target.vx, slot)
        copy_lanes(source.vy, first, target.vy, slot)
        copy_lanes(source.id, first, target.id, slot)
        copy_lanes(source.cell, first, target.cell, slot)
        _copy_radii(source.radius, first, target.radius, slot)
        first += RUN
        slot += RUN
    while first < high:
        copy_disc(source, first, target, slot)
        first += 1
        slot += 1


@inlined
def _copy_radii(source, first, target, slot):
    """Copy the radii too, if each disc has its own."""
    if source is not None:
        copy_lanes(source, first, target, slot)


@inlined
def swap_discs(discs, i, j):
    """Exchange two discs of one cell."""
    discs.x[i], discs.x[j] = discs.x[j], discs.x[i]
    discs.y[i], discs.y[j] = discs.y[j], discs.y[i]
    discs.vx[i], discs.vx[j] = discs.vx[j], discs.vx[i]
    discs.vy[i], discs.vy[j] = discs.vy[j], discs.vy[i]
    discs.id[i], discs.id[j] = discs.id[j], discs.id[i]
    swap_entries(discs.radius, i, j)


# --- The phases of a frame: which one a worker is in, how long each has taken, and the barrier between two


@linked
def add_time(times, mine, phase, since):
    """Add the time since `since` to a phase of the current frame. Returns the time now."""
    moment = now(mine.clock)
    times[mine.frame, phase] += moment - since
    return moment


@linked
def set_phase(mine, phase):
    """Record which phase this worker is in, for the message if it dies."""
    mine.phase = phase


@linked
def wait_for_all(control, mine, times, since):
    """Barrier that records its waiting time. Returns the time now, and the abort word."""
    if control.workers > 1:
        set_phase(mine, WAIT)
        barrier(control, mine)
        return add_time(times, mine, WAIT, since)
    return since


# --- Which worker has which cells, and the discs that move from one worker's columns to another's

FEW = 8
"""One disc in so many of a worker's slice may change its cell and be listed; where more do, the order is made anew."""


@inlined
def cells_of(team, worker, control):
    """First cell of a worker's columns and one past the last; the last member also has what lies beyond the grid."""
    stride = control.rows + 2
    if worker == control.members - 1:
        return team[worker].first_column * stride, control.cells
    return team[worker].first_column * stride, team[worker].last_column * stride


@inlined
def section_of(mine):
    """First place in the lists of `Changes` that belongs to a worker, and the number of its places."""
    return mine.low // FEW, mine.high // FEW - mine.low // FEW


@inlined
def send_if_outside(i, discs, outbox, sent, team, first_cell, last_cell, worker, control):
    """List disc i for the worker in whose cells it now lies, if that is another."""
    mine = team[worker]
    cell = discs.cell[i]
    if not first_cell <= cell < last_cell:
        outbox[mine.low + mine.outbox] = i
        mine.outbox += 1
        for other in range(control.members):
            first, last = cells_of(team, other, control)
            sent[other] += first <= cell < last


@linked
def list_emigrants(discs, changes, sent, team, worker, control):
    """List the discs that moved into another worker's columns; sent[w] says how many of them go to worker w.

    The list lies in the slice's own section of `outbox`.
    """
    mine = team[worker]
    first_cell, last_cell = cells_of(team, worker, control)
    sent[:] = 0
    mine.outbox = 0
    if mine.listed == 1:
        first, _ = section_of(mine)
        for k in range(first, first + mine.leavers):
            i = nonnegative(changes.slot[k])
            send_if_outside(i, discs, changes.outbox, sent, team, first_cell, last_cell, worker, control)
    else:
        for i in range(mine.low, mine.high):
            send_if_outside(nonnegative(i), discs, changes.outbox, sent, team, first_cell, last_cell, worker, control)
    mine.kept = mine.high - mine.low - mine.outbox


@inlined
def immigrants_of(sent, worker, control):
    """How many discs of other workers have moved into the columns of this one."""
    number = 0
    for other in range(control.members):
        number += sent[other, worker]
    return number


@linked
def first_slot_of(team, sent, worker, control):
    """First slot of a worker's discs after the sort: how many discs the workers before it will hold."""
    slot = 0
    for before in range(worker):
        slot += team[before].kept + immigrants_of(sent, before, control)
    return slot


# --- The incremental sort: if few discs have changed cells, it repairs the previous order
#
# Most discs stay in their cells from one step to the next, and those are already in order. The runs between discs that
# leave a cell and discs that arrive in one are copied to the other buffer by whole vectors, and the start of each cell
# is shifted by the number of arrivals minus departures before it.

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


# --- The sort of a step: discs in the order (column, row, id), for any number of workers
#
# Cells are numbered column by column. Each column has an empty ghost cell below its first and above its last row, and
# an empty ghost column follows the last one, so that no neighbour needs a test for the edge of the box. start[cell] is
# the first disc of a cell and start[cell + 1] one past its last.
#
# The order is a function of the discs alone, so it does not matter how it is obtained: each worker repairs the
# previous one if few of its discs have changed cells, else sorts all.

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


# --- Discs in the order of their numbers, for what reads a state


@compiled
def put_in_order(x, y, number, out):
    """Components of discs as rows (x, y) in the order of their numbers: number int32, shape (N,); out shape (N, 2)."""
    for i in range(number.size):
        at = nonnegative(np.intp(number[i]))
        out[at, 0], out[at, 1] = x[i], y[i]
