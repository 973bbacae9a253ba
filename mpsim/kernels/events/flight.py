"""Free flight of discs: where one is, when it leaves its cell or meets a wall, when it meets another."""

import math

from mpsim.kernels.compiling import inlined
from mpsim.kernels.events.cells import value_of, wrapped
from mpsim.kernels.events.state import BORDER, BOTTOM, COLUMN, LEFT, ROW, SIDE, SINCE, VX, VY, X, Y

INFINITY = math.inf


# --- one disc ---


@inlined
def state_at(disc, i, now, gravity):
    """Position [length] and velocity [length/time] of disc i at time `now`: (x, y, vx, vy)."""
    flight = now - disc[i, SINCE]
    vx = disc[i, VX]
    vy = disc[i, VY]
    if gravity is None:
        return disc[i, X] + vx * flight, disc[i, Y] + vy * flight, vx, vy
    gain_x = gravity[0] * flight
    gain_y = gravity[1] * flight
    x = disc[i, X] + flight * (vx + 0.5 * gain_x)
    y = disc[i, Y] + flight * (vy + 0.5 * gain_y)
    return x, y, vx + gain_x, vy + gain_y


@inlined
def advance_to(disc, i, now, gravity):
    """Bring the stored state of disc i to time `now`."""
    x, y, vx, vy = state_at(disc, i, now, gravity)
    disc[i, X] = x
    disc[i, Y] = y
    disc[i, VX] = vx
    disc[i, VY] = vy
    disc[i, SINCE] = now


@inlined
def component(gravity, axis):
    """One component of the acceleration [length/time^2]."""
    if gravity is None:
        return 0.0
    return gravity[axis]


@inlined
def add_to(record, key, amount):
    """Add to an entry of an optional record."""
    if record is not None:
        record[key] += amount


@inlined
def is_finite(disc, i):
    """Whether the stored state of disc i holds neither a NaN nor an infinity."""
    total = disc[i, X] + disc[i, Y] + disc[i, VX] + disc[i, VY] + disc[i, SINCE]
    return total - total == 0.0


# --- leaving the cell, meeting a wall ---


@inlined
def time_to_limit(distance, speed, acceleration):
    """Time until a limit `distance` ahead is met [time], `speed` and `acceleration` positive away from it.

    The root of distance + speed t + acceleration t^2/2 = 0 in the form that does not cancel. A rounding-level negative
    distance counts as zero: a disc on the limit that moves against it meets it now.
    """
    ahead = max(distance, 0.0)
    discriminant = speed * speed - 2.0 * acceleration * ahead
    if speed < 0.0:
        return 2.0 * ahead / (math.sqrt(discriminant) - speed) if discriminant >= 0.0 else INFINITY
    return (speed + math.sqrt(discriminant)) / -acceleration if acceleration < 0.0 else INFINITY


@inlined
def time_to_leave(place, speed, acceleration, cell, cells, length, periodic, radius, gravity):
    """Time until a centre leaves its cell, or meets a wall, along one axis: (time, 0 low or 1 high)."""
    side = length / cells
    low = cell * side
    high = (cell + 1) * side
    if not periodic:
        low = max(low, radius)
        high = min(high, length - radius)
    if gravity is None:
        # Only one of the two limits lies ahead.
        ahead = high - place if speed > 0.0 else place - low
        return (max(ahead, 0.0) / abs(speed) if speed != 0.0 else INFINITY), (1 if speed > 0.0 else 0)
    down = time_to_limit(place - low, speed, acceleration)
    up = time_to_limit(high - place, -speed, -acceleration)
    return (up, 1) if up < down else (down, 0)


@inlined
def predict_border(i, store, box, gravity):
    """Store when disc i, whose stored state is current, leaves its cell or meets a wall, and on which side."""
    disc = store.disc
    event = store.event
    radius = value_of(store.radius, box.radius, i)
    tx, high_x = time_to_leave(
        disc[i, X],
        disc[i, VX],
        component(gravity, 0),
        event[i, COLUMN],
        box.columns,
        box.width,
        box.periodic_x,
        radius,
        gravity,
    )
    ty, high_y = time_to_leave(
        disc[i, Y],
        disc[i, VY],
        component(gravity, 1),
        event[i, ROW],
        box.rows,
        box.height,
        box.periodic_y,
        radius,
        gravity,
    )
    if tx <= ty:
        disc[i, BORDER] = disc[i, SINCE] + tx
        event[i, SIDE] = LEFT + high_x
    else:
        disc[i, BORDER] = disc[i, SINCE] + ty
        event[i, SIDE] = BOTTOM + high_y


# --- pairs ---


@inlined
def time_to_impact(rx, ry, ux, uy, contact):
    """Time until two discs touch [time], infinity if they never do.

    r, u: relative position and velocity; contact: sum of the radii. From |r + u t| = contact, with b = r.u and
    D = b^2 - u^2 (r^2 - contact^2): t = (r^2 - contact^2)/(-b + sqrt D). The other form of the root cancels for
    slow and grazing approaches. Only an approaching pair collides; one that already overlaps collides now.
    """
    b = rx * ux + ry * uy
    gap = rx * rx + ry * ry - contact * contact
    discriminant = b * b - (ux * ux + uy * uy) * gap
    if (b < 0.0) & (discriminant >= 0.0):
        return max(gap, 0.0) / (math.sqrt(discriminant) - b)
    return INFINITY


@inlined
def earliest_partner(i, now, first_column, last_column, first_row, last_row, store, box, gravity):
    """The earliest impact of disc i with the discs of a block of cells: (time from now, partner or -1).

    Two images of one cell, in a periodic box two cells wide, are visited as two cells.
    """
    disc = store.disc
    x, y, vx, vy = state_at(disc, i, now, gravity)
    radius = value_of(store.radius, box.radius, i)
    best = INFINITY
    partner = -1
    for row_ahead in range(first_row, last_row + 1):
        row, shift_y = wrapped(row_ahead, box.rows, box.height, box.periodic_y)
        if row < 0:
            continue
        for column_ahead in range(first_column, last_column + 1):
            column, shift_x = wrapped(column_ahead, box.columns, box.width, box.periodic_x)
            if column < 0:
                continue
            j = store.cell_head[row * box.columns + column]
            while j >= 0:
                xj, yj, vxj, vyj = state_at(disc, j, now, gravity)
                contact = radius + value_of(store.radius, box.radius, j)
                t = time_to_impact((xj - x) + shift_x, (yj - y) + shift_y, vxj - vx, vyj - vy, contact)
                if t <= best and (t < best or j < partner):
                    best = t
                    partner = j
                j = store.cell_next[j]
    return best, partner
