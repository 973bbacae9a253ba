"""Predictions: the next impact of a disc with another, and when it leaves its cell or meets a wall.

A prediction reads only the stored states of other discs, only in `earliest_partner`, and changes only its own disc.
"""

import numpy as np

from mpsim.kernels.compiling import inlined
from mpsim.kernels.events.boundary import along, neighbour, range_in_cell
from mpsim.kernels.events.calendar import reschedule
from mpsim.kernels.events.cells import block_to_search, cell_of, gather, is_inside
from mpsim.kernels.events.features import expansion
from mpsim.kernels.events.features.hooks import before_border, is_absent, radius_at, radius_of
from mpsim.kernels.events.flight import INFINITY, approach_of, state_at, time_of, will_touch
from mpsim.kernels.events.records import BOTTOM, LEFT, MOST_NEAR, here_along, number_of_cell, place_along
from mpsim.kernels.machine import nonnegative


@inlined
def border_along(axis, i, store, box, features):
    """When the centre of disc i leaves its cell along an axis, or meets a wall: (time from now, 0 low or 1 high)."""
    disc = store.disc[i]
    length, cells, periodic = along(axis, box)
    cell, radius = store.event[i].cell[axis], radius_of(i, box, features)
    limit = radius_at(i, disc.last_update, store, box, features)
    low, high = range_in_cell(cell, cells, length, periodic, limit)
    low_is_wall, high_is_wall = not periodic and cell == 0, not periodic and cell == cells - 1
    return expansion.time_to_leave(
        features.expansion, low, high, low_is_wall, high_is_wall, radius, disc, axis, features.gravity
    )


@inlined
def predict_border(i, store, box, features):
    """Store when disc i, whose stored state is current, leaves its cell or hits a wall or an obstacle, and `side`."""
    disc = store.disc[i]
    tx, high_x = border_along(0, i, store, box, features)
    ty, high_y = border_along(1, i, store, box, features)
    if tx <= ty:
        disc.crossing_time = disc.last_update + tx
        store.event[i].side = LEFT + high_x
    else:
        disc.crossing_time = disc.last_update + ty
        store.event[i].side = BOTTOM + high_y
    before_border(i, store, box, features)


@inlined
def earliest_one_by_one(i, now, first_column, last_column, first_row, last_row, store, box, features):
    """As `earliest_partner`, for any position of the cells and any number of discs in them.

    Two images of one cell, in a periodic box two cells wide, are visited as two cells.
    """
    disc, event = store.disc, store.event
    x, y, vx, vy = state_at(disc[i], now, features.gravity)
    radius = radius_of(i, box, features)
    best = INFINITY
    partner = np.int64(-1)
    for column_ahead in range(first_column, last_column + 1):
        column, shift_x = neighbour(column_ahead, box.columns, box.width, box.periodic_x)
        column_place = place_along(0, column, store.region, box) if column >= 0 else -1
        if column_place < 0:
            continue
        for row_ahead in range(first_row, last_row + 1):
            row, shift_y = neighbour(row_ahead, box.rows, box.height, box.periodic_y)
            cell = number_of_cell(column_place, row, store.region, box) if row >= 0 else -1
            if cell < 0:
                continue
            j = np.int64(store.cell_head[cell])
            while j >= 0:
                xj, yj, vxj, vyj = state_at(disc[j], now, features.gravity)
                contact = radius + radius_of(j, box, features)
                rx, ry = (xj - x) + shift_x, (yj - y) + shift_y
                t = expansion.time_to_impact(features.expansion, rx, ry, vxj - vx, vyj - vy, contact, now, store)
                if t < best or (t == best and partner >= 0 and event[j].number < event[partner].number):
                    best = t
                    partner = j
                j = np.int64(store.cell_next[j])
    return best, partner


@inlined
def keep_approaching(i, now, found, store, box, features):
    """Keep those of so many discs in `store.near` that will touch disc i, and how they approach it. Returns how many.

    Half of all discs do, in an unpredictable order, so no branch tests it.
    """
    disc, near, approach = store.disc, store.near, store.approach
    x, y, vx, vy = state_at(disc[i], now, features.gravity)
    radius = radius_of(i, box, features)
    kept = 0
    for k in range(found):
        j = nonnegative(np.int64(near[k]))
        xj, yj, vxj, vyj = state_at(disc[j], now, features.gravity)
        b, gap, discriminant = approach_of(xj - x, yj - y, vxj - vx, vyj - vy, radius + radius_of(j, box, features))
        at = nonnegative(kept)
        near[at] = j
        approach[at, 0], approach[at, 1], approach[at, 2] = b, gap, discriminant
        kept += will_touch(b, discriminant)
    return kept


@inlined
def earliest_of(kept, store):
    """The earliest of so many impacts that `keep_approaching` has kept: (time from now, partner or -1)."""
    event, near, approach = store.event, store.near, store.approach
    best = INFINITY
    partner = np.int64(-1)
    for k in range(kept):
        j = nonnegative(np.int64(near[k]))
        t = time_of(approach[k, 0], approach[k, 1], approach[k, 2])
        if t == best and partner >= 0 and event[j].number < event[partner].number:
            partner = j
        partner = j if t < best else partner
        best = t if t < best else best
    return best, partner


@inlined
def earliest_partner(i, now, first_column, last_column, first_row, last_row, store, box, features):
    """The earliest impact of disc i with the discs of a block of cells: (time from now, partner or -1)."""
    if is_inside(i, store, box) and not expansion.expands(features.expansion):
        cell = store.event[i].cell
        in_column = here_along(1, store.region, box)
        first = cell_of(i, store, box) + (first_column - cell[0]) * in_column + (first_row - cell[1])
        found = gather(first, last_column - first_column + 1, last_row - first_row + 1, store, box)
        if found < MOST_NEAR:
            return earliest_of(keep_approaching(i, now, found, store, box, features), store)
    return earliest_one_by_one(i, now, first_column, last_column, first_row, last_row, store, box, features)


@inlined
def predict(i, now, side, deflected, store, box, features):
    """Predict the next event of disc i and enter it in the calendar.

    side: the border it has just crossed or -1; deflected: whether its stored state is new as of `now`.
    """
    disc, event = store.disc[i], store.event
    if is_absent(i, features):
        disc.collision_time, disc.crossing_time = INFINITY, INFINITY
        reschedule(i, store)
        return
    first_column, last_column, first_row, last_row = block_to_search(i, side, event)
    wait, partner = earliest_partner(i, now, first_column, last_column, first_row, last_row, store, box, features)
    if side < 0 or now + wait < disc.collision_time:
        disc.collision_time = now + wait
        event[i].partner = partner
        if partner >= 0:
            event[i].partner_collision_count = event[partner].collision_count
    if deflected:
        predict_border(i, store, box, features)
    reschedule(i, store)
