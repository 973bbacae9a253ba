"""Impacts: predicted, and carried out."""

import math

import numpy as np

from mpsim.kernels.compiling import any_present, inlined
from mpsim.kernels.events.calendar import reschedule
from mpsim.kernels.events.cells import (
    along,
    block_to_search,
    cell_of,
    gather,
    is_inside,
    leave_list,
    neighbour,
    range_in_cell,
)
from mpsim.kernels.events.features.bodies import is_look
from mpsim.kernels.events.features.edges import is_absent, leave, lets_out
from mpsim.kernels.events.features.hooks import (
    before_border,
    between_discs,
    on_surface,
    on_wall,
    speed_off_wall,
    surface,
)
from mpsim.kernels.events.features.laws import effective_restitution, speed_off, speed_off_thermal_wall
from mpsim.kernels.events.features.properties import (
    approach_of_surfaces,
    mass_of,
    radius_at,
    radius_of,
    time_to_border,
    time_to_touch,
)
from mpsim.kernels.events.flight import INFINITY, advance_to, approach_of, state_at, time_of, will_touch
from mpsim.kernels.events.records import (
    BOTTOM,
    LEFT,
    MOST_NEAR,
    VIRIAL,
    VIRIAL_XX,
    VIRIAL_XY,
    add,
    counts,
    here_along,
    number_of_cell,
    place_along,
)
from mpsim.kernels.geometry import nearest_image
from mpsim.kernels.machine import nonnegative

# --- Predictions: the next impact of a disc with another, and when it leaves its cell or meets a wall
#
# A prediction reads only the stored states of other discs, only in `earliest_partner`, and changes only its own disc.


@inlined
def border_along(axis, i, store, box, features):
    """When the centre of disc i leaves its cell along an axis, or meets a wall: (time from now, 0 low or 1 high)."""
    disc = store.disc[i]
    length, cells, periodic = along(axis, box)
    cell, radius = store.event[i].cell[axis], radius_of(i, box, features)
    limit = radius_at(i, disc.last_update, store, box, features)
    low, high = range_in_cell(cell, cells, length, periodic, limit)
    low_is_wall, high_is_wall = not periodic and cell == 0, not periodic and cell == cells - 1
    return time_to_border(
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
                t = time_to_touch(features.expansion, rx, ry, vxj - vx, vyj - vy, contact, now, store)
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
    if is_inside(i, store, box) and features.expansion is None:
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
    if is_absent(features.exits, i):
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


# --- Impacts: new velocities of two discs that collide, and of a disc at a wall

PARTING = 2.0**-48
"""Speed at which discs part, or leave a surface, where rounding alone would leave them approaching, as a fraction of
their own: far above the rounding of their velocities, far below anything else."""


@inlined
def separate(one, other, rx, ry, mass_i, mass_j):
    """Ensure that two discs that have just collided do not approach: they would collide again at once, endlessly.

    Where nothing of the normal velocity is left (a restitution of 0), rounding decides its sign, and an impact may be
    too small to change velocities at all. r: from the second disc to the first.
    """
    ux = one.velocity[0] - other.velocity[0]
    uy = one.velocity[1] - other.velocity[1]
    if rx * ux + ry * uy < 0.0:
        speed = abs(one.velocity[0]) + abs(one.velocity[1]) + abs(other.velocity[0]) + abs(other.velocity[1])
        push = PARTING * speed / (math.sqrt(rx * rx + ry * ry) * (mass_i + mass_j))
        one.velocity[0] += push * mass_j * rx
        one.velocity[1] += push * mass_j * ry
        other.velocity[0] -= push * mass_i * rx
        other.velocity[1] -= push * mass_i * ry


@inlined
def collide(i, j, now, store, box, features):
    """Impact of discs i and j at time `now`: momentum is kept, the normal velocity is reversed, times e.

    dp = -(1+e) m1 m2/(m1+m2) (u.n) n with n = r/|r|, written with r itself and r^2, so that energy is kept at
    rounding level however far rounding has left |r| from the contact distance.
    """
    one, other = store.disc[i], store.disc[j]
    advance_to(one, now, features.gravity)
    advance_to(other, now, features.gravity)
    rx = nearest_image(one.position[0] - other.position[0], box.width, box.periodic_x)
    ry = nearest_image(one.position[1] - other.position[1], box.height, box.periodic_y)
    b = rx * (one.velocity[0] - other.velocity[0]) + ry * (one.velocity[1] - other.velocity[1])
    contact = radius_of(i, box, features) + radius_of(j, box, features)
    b = approach_of_surfaces(features.expansion, b, rx, ry, contact)
    if b < 0.0:
        last_contact = max(one.last_contact, other.last_contact)
        e = effective_restitution(features.restitution, last_contact, now, features.contact_time, store)
        mass_i = mass_of(i, features)
        mass_j = mass_of(j, features)
        push = -(1.0 + e) * b / ((rx * rx + ry * ry) * (mass_i + mass_j))
        one.velocity[0] += push * mass_j * rx
        one.velocity[1] += push * mass_j * ry
        other.velocity[0] -= push * mass_i * rx
        other.velocity[1] -= push * mass_i * ry
        impulse = push * mass_i * mass_j * math.sqrt(rx * rx + ry * ry)
        between_discs(i, j, rx, ry, impulse, store, box, features)
        separate(one, other, rx, ry, mass_i, mass_j)
        one.last_contact = now
        other.last_contact = now
        store.counter.pairs += counts(store.region)
        virial = counts(store.region) * (-(1.0 + e) * b * mass_i * mass_j / (mass_i + mass_j))
        add(store.tally, VIRIAL, virial, box.virial_unit)
        add(store.tally, VIRIAL_XX, virial * rx * rx / (rx * rx + ry * ry), box.virial_unit)
        add(store.tally, VIRIAL_XY, virial * rx * ry / (rx * rx + ry * ry), box.virial_unit)
    store.event[i].collision_count += 1
    store.event[j].collision_count += 1


@inlined
def hit_wall(i, now, side, store, box, features):
    """Disc i, whose stored state is current, hits a wall: its centre is put exactly on the limit."""
    disc = store.disc[i]
    radius = radius_at(i, now, store, box, features)
    axis = side >> 1
    high = side & 1
    length, _, _ = along(axis, box)
    inward = -1.0 if high else 1.0
    if lets_out(features.absorbing, side):
        disc.position[axis] = length - radius if high else radius
        leave(features.exits, disc, i)
        leave_list(i, cell_of(i, store, box), store)
        store.cell_next[i] = -1
        store.event[i].collision_count += 1
        store.counter.walls += counts(store.region)
        return
    speed = -inward * disc.velocity[axis]
    leaving = speed_off_wall(i, speed, axis, inward, disc.last_contact, now, store, box, features)
    leaving, sliding = speed_off_thermal_wall(features.thermal_walls, i, side, leaving, store, features)
    disc.position[axis] = length - radius if high else radius
    disc.velocity[axis] = inward * leaving
    on_wall(i, axis, inward, speed + leaving, sliding, store, box, features)
    disc.last_contact = now
    store.event[i].collision_count += 1
    store.counter.walls += counts(store.region)
    add(store.tally, side, counts(store.region) * mass_of(i, features) * (speed + leaving), box.impulse_unit)


@inlined
def hit_surface(i, now, side, store, box, features):
    """Impact of disc i, whose stored state is current, on something other than a disc or a fixed wall; False: none."""
    if is_look(any_present(features.bodies, features.moving_wall), side):
        return True
    met, nx, ny, depth, speed, running, edge = surface(i, side, now, store, box, features)
    if not met:
        return False
    disc = store.disc[i]
    disc.position[0] += depth * nx
    disc.position[1] += depth * ny
    inward = disc.velocity[0] * nx + disc.velocity[1] * ny - speed
    leaving = speed_off(max(-inward, 0.0), nx, ny, disc.last_contact, now, features, store)
    leaving = max(leaving, PARTING * (abs(disc.velocity[0]) + abs(disc.velocity[1])))
    change = max(leaving - inward, 0.0)  # in a grazing impact, rounding may have reversed it already
    disc.velocity[0] += change * nx
    disc.velocity[1] += change * ny
    on_surface(i, nx, ny, change, speed, running, store, box, features)
    disc.last_contact = now
    store.event[i].collision_count += 1
    store.counter.walls += counts(store.region)
    if edge >= 0:
        add(store.tally, edge, counts(store.region) * mass_of(i, features) * change, box.impulse_unit)
    return True
