"""Predictions: the next impact of a disc with another one, and when it leaves its cell or meets a wall.

Of other discs a prediction reads the stored states alone, and only in `earliest_partner`; it changes none but its own.
"""

from mpsim.kernels.compiling import inlined
from mpsim.kernels.events.boundary import along, neighbour, range_in_cell
from mpsim.kernels.events.calendar import reschedule
from mpsim.kernels.events.cells import block_to_search
from mpsim.kernels.events.features.hooks import before_border, is_absent, radius_of
from mpsim.kernels.events.flight import INFINITY, state_at, time_to_impact, time_to_leave
from mpsim.kernels.events.records import BOTTOM, LEFT
from mpsim.kernels.events.region import number_of_cell, place_along


@inlined
def border_along(axis, i, store, box, features):
    """When the centre of disc i leaves its cell along an axis, or meets a wall: (time from now, 0 low or 1 high)."""
    disc = store.disc[i]
    length, cells, periodic = along(axis, box)
    radius = radius_of(i, box, features)
    low, high = range_in_cell(store.event[i].cell[axis], cells, length, periodic, radius)
    return time_to_leave(low, high, disc.position[axis], disc.velocity[axis], features.gravity, axis)


@inlined
def predict_border(i, store, box, features):
    """Store when disc i, whose stored state is current, leaves its cell or meets what is no disc, and `side`."""
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
def earliest_partner(i, now, first_column, last_column, first_row, last_row, store, box, features):
    """The earliest impact of disc i with the discs of a block of cells: (time from now, partner or -1).

    Two images of one cell, in a periodic box two cells wide, are visited as two cells.
    """
    disc, event = store.disc, store.event
    x, y, vx, vy = state_at(disc[i], now, features.gravity)
    radius = radius_of(i, box, features)
    best = INFINITY
    partner = -1
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
            j = store.cell_head[cell]
            while j >= 0:
                xj, yj, vxj, vyj = state_at(disc[j], now, features.gravity)
                contact = radius + radius_of(j, box, features)
                t = time_to_impact((xj - x) + shift_x, (yj - y) + shift_y, vxj - vx, vyj - vy, contact)
                if t < best or (t == best and partner >= 0 and event[j].number < event[partner].number):
                    best = t
                    partner = j
                j = store.cell_next[j]
    return best, partner


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
