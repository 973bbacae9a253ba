"""Contacts: which discs overlap, found in the grid or among all pairs, in an order independent of the workers.

shift_x, shift_y: along a periodic axis, the length by which disc i is shifted back if its partner lies beyond the
border; otherwise None, which costs nothing.
"""

import numpy as np

from mpsim.kernels.compiling import inlined, linked, value_or
from mpsim.kernels.features.edges import images, is_absent, is_near_border, period_of, seen_from
from mpsim.kernels.frame.laws import resolve_contact
from mpsim.kernels.frame.sorting import add_time, set_phase
from mpsim.kernels.machine import LANES, lowest_bit, nonnegative, overlap_lanes


@inlined
def overlapping(discs, i, block, shift_x, shift_y, reach):
    """The mask of the discs from slot `block` on that overlap disc i."""
    x, y = seen_from(discs.x[i], shift_x), seen_from(discs.y[i], shift_y)
    return overlap_lanes(discs.x, discs.y, discs.radius, block, x, y, reach)


@inlined
def resolve_range(discs, i, first, last, shift_x, shift_y, features, parameters, control, tally, frame):
    """Resolve disc i with each of the discs [first, last) that overlaps it at its turn. Returns how many.

    The same as testing one by one: after a contact has moved disc i, the lanes that follow are tested again.
    """
    reach = value_or(discs.radius, i, parameters.diameter * parameters.diameter)
    contacts = 0
    block, last = np.int64(first), np.int64(last)
    while block < last:
        lanes = (1 << min(last - block, LANES)) - 1
        mask = overlapping(discs, i, block, shift_x, shift_y, reach) & lanes
        while mask != 0:
            lane = lowest_bit(mask)
            if not is_absent(features.exits, discs.id[block + lane]):
                resolve_contact(discs, i, block + lane, shift_x, shift_y, features, parameters, control, tally, frame)
                contacts += 1
            lanes &= ~((2 << lane) - 1)
            mask = overlapping(discs, i, block, shift_x, shift_y, reach) & lanes
        block += LANES
    return contacts


@linked
def resolve_far(discs, i, first, last, shift_x, shift_y, features, parameters, control, tally, frame):
    """`resolve_range` as a call, not inlined: for the few discs at borders, copies would only cost compilation time."""
    return resolve_range(discs, i, first, last, shift_x, shift_y, features, parameters, control, tally, frame)


@inlined
def next_to_resolve(discs, slot, last, own_ends, next_firsts, next_ends, diameter_squared):
    """The first disc of [slot, last) that may overlap one of its candidates; `last` if there is none.

    A separate loop, so that the compiler keeps everything in registers: two vector tests and one branch per disc.
    """
    for k in range(np.uint64(slot), np.uint64(last)):  # unsigned: no index can count from the end
        i = np.int64(k)
        cell = nonnegative(discs.cell[k])
        own, next_first = own_ends[cell] - i - 1, np.int64(next_firsts[cell])
        others = next_ends[cell] - next_first
        x, y, reach = discs.x[k], discs.y[k], value_or(discs.radius, k, diameter_squared)
        own_mask = overlap_lanes(discs.x, discs.y, discs.radius, i + 1, x, y, reach)
        next_mask = overlap_lanes(discs.x, discs.y, discs.radius, next_first, x, y, reach)
        if (own | others) >= LANES:
            return i
        if (own_mask & ((1 << own) - 1)) | (next_mask & ((1 << others) - 1)) != 0:
            return i
    return last


@inlined
def resolve_column(discs, start, column, features, parameters, control, tally, frame):
    """Contacts of one column with itself and with the next one. Returns how many.

    The candidates of a disc are two ranges, nearly always shorter than a vector: those after it in its own cell and the
    one above, and those in three cells of the next column.
    """
    stride = control.rows + 2
    own_ends, next_firsts, next_ends = start[2:], start[stride - 1 :], start[stride + 2 :]
    diameter_squared = parameters.diameter * parameters.diameter
    contacts = 0
    # From the first row: the ghost cell below it is empty, and the worker of the previous column writes its start.
    slot, last = np.int64(start[column * stride + 1]), np.int64(start[(column + 1) * stride])
    while True:
        slot = next_to_resolve(discs, slot, last, own_ends, next_firsts, next_ends, diameter_squared)
        if slot >= last:
            return contacts
        i = nonnegative(slot)
        cell = nonnegative(discs.cell[i])
        own, others = (i + 1, np.int64(own_ends[cell])), (np.int64(next_firsts[cell]), np.int64(next_ends[cell]))
        for first, end in (own, others):
            contacts += resolve_range(discs, i, first, end, None, None, features, parameters, control, tally, frame)
        slot += 1


@inlined
def resolve_top_and_bottom(
    wrap_y, discs, start, column, next_column, shift_x, features, parameters, control, tally, frame
):
    """Contacts of a column's first and last row, through the border of a periodic y. Returns how many.

    The last row is tested against the first one of its own column and of the next, the first row against the last one
    of the next: with the cells inside the box, each pair once.
    """
    contacts = 0
    if wrap_y is not None:
        stride, rest = control.rows + 2, (features, parameters, control, tally, frame)
        first, last = column * stride + 1, column * stride + control.rows
        next_first, next_last = next_column * stride + 1, next_column * stride + control.rows
        up, down = images(wrap_y)
        for slot in range(start[last], start[last + 1]):
            i = nonnegative(slot)
            contacts += resolve_far(discs, i, start[first], start[first + 1], None, up, *rest)
            contacts += resolve_far(discs, i, start[next_first], start[next_first + 1], shift_x, up, *rest)
        for slot in range(start[first], start[first + 1]):
            i = nonnegative(slot)
            contacts += resolve_far(discs, i, start[next_last], start[next_last + 1], shift_x, down, *rest)
    return contacts


@inlined
def resolve_border(wrap_x, discs, start, column, features, parameters, control, tally, frame):
    """Contacts of one column through the borders of periodic axes. Returns how many.

    The next column after the last is the first, shifted by one width. The number of columns is even, so in the odd
    pass, which resolves the last column, no other worker touches the first one.
    """
    rest = features, parameters, control, tally, frame
    if wrap_x is None:
        return resolve_top_and_bottom(features.wrap_y, discs, start, column, column + 1, None, *rest)
    if column + 1 < control.columns:
        return resolve_top_and_bottom(features.wrap_y, discs, start, column, column + 1, None, *rest)
    stride = control.rows + 2
    right, _ = images(wrap_x)
    contacts = 0
    for slot in range(start[column * stride], start[(column + 1) * stride]):
        i = nonnegative(slot)
        row = discs.cell[i] - column * stride
        contacts += resolve_far(discs, i, start[row - 1], start[row + 2], right, None, *rest)
    return contacts + resolve_top_and_bottom(features.wrap_y, discs, start, column, 0, right, *rest)


@linked
def resolve_columns(phase, first, last, step, discs, start, features, parameters, control, mine, tally, times, moment):
    """Resolve columns first, first + step, ... below last, counted and timed for a phase. Returns the time after it."""
    set_phase(mine, phase)
    for column in range(first, last, step):
        mine.collisions += resolve_column(discs, start, column, features, parameters, control, tally, mine.frame)
        mine.collisions += resolve_border(
            features.wrap_x, discs, start, column, features, parameters, control, tally, mine.frame
        )
    return add_time(times, mine, phase, moment)


@inlined
def resolve_images_y(wrap_y, discs, i, count, shift_x, features, parameters, control, tally, frame):
    """Contacts of disc i, shifted by `shift_x`, with later discs through the border of y. Returns how many."""
    contacts = 0
    if wrap_y is not None:
        for shift_y in images(wrap_y):
            if is_near_border(seen_from(discs.y[i], shift_y), wrap_y, parameters):
                contacts += resolve_far(
                    discs, i, i + 1, count, shift_x, shift_y, features, parameters, control, tally, frame
                )
    return contacts


@inlined
def resolve_images_x(wrap_x, discs, i, count, features, parameters, control, tally, frame):
    """Contacts of disc i with later discs through the border of a periodic x. Returns how many."""
    contacts, rest = 0, (features, parameters, control, tally, frame)
    if wrap_x is not None:
        for shift_x in images(wrap_x):
            if is_near_border(seen_from(discs.x[i], shift_x), wrap_x, parameters):
                contacts += resolve_far(discs, i, i + 1, count, shift_x, None, *rest)
                contacts += resolve_images_y(features.wrap_y, discs, i, count, shift_x, *rest)
    return contacts


@linked
def resolve_all_pairs(discs, features, parameters, control, tally, frame):
    """Resolve all pairs i < j in index order. Returns the number of contacts."""
    contacts, count, rest = 0, control.count, (features, parameters, control, tally, frame)
    for i in range(count):
        if not is_absent(features.exits, discs.id[i]):
            contacts += resolve_range(discs, i, i + 1, count, None, None, *rest)
            contacts += resolve_images_y(features.wrap_y, discs, i, count, None, *rest)
            contacts += resolve_images_x(features.wrap_x, discs, i, count, *rest)
    return contacts


# --- Giants: the few discs far larger than all others. They are not in the grid, whose cells fit the others
#
# Worker 0 alone, after the odd columns, tests each giant against the discs in all cells under it. Otherwise one disc
# of 20 radii among 10,000 would make each cell 400 times as large, with hundreds of neighbours for each disc.


@inlined
def cells_under(centre, reach, per_length, cells):
    """First and one past the last cell along an axis that discs of the grid may touch from `centre`."""
    first = int(max((centre - reach) * per_length, -1.0))
    last = int(max((centre + reach) * per_length, -1.0))
    return max(first, 0), min(last, cells - 1) + 1


@linked
def resolve_giants(discs, start, features, parameters, control, tally, frame):
    """Contacts of each giant with the discs of the grid under it, then with the giants after it. Returns how many."""
    columns, rows, rest = control.columns, control.rows, (features, parameters, control, tally, frame)
    stride = rows + 2
    zero = discs.x.dtype.type(0)
    width, height = period_of(features.wrap_x, zero), period_of(features.wrap_y, zero)
    first_x, first_y = -1 if width > 0 else 0, -1 if height > 0 else 0  # images: -1, 0 and 1 periods away, or 0 alone
    giants_end = start[(columns + 1) * stride + 1]
    contacts = 0
    for slot in range(start[(columns + 1) * stride], giants_end):
        i = nonnegative(slot)
        for shift_x in range(first_x, 1 - first_x):
            for shift_y in range(first_y, 1 - first_y):
                sx, sy = discs.x.dtype.type(shift_x * width), discs.x.dtype.type(shift_y * height)
                reach = discs.radius[i] + features.giants[0]
                left, right = cells_under(discs.x[i] - sx, reach, parameters.cells_per_x, columns)
                low, high = cells_under(discs.y[i] - sy, reach, parameters.cells_per_y, rows)
                for column in range(left, right):
                    if low < high:
                        cell = column * stride + 1
                        contacts += resolve_far(discs, i, start[cell + low], start[cell + high], sx, sy, *rest)
                contacts += resolve_far(discs, i, i + 1, giants_end, sx, sy, *rest)
    return contacts
