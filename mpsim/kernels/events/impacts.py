"""Impacts: new velocities of two discs that collide, and of a disc at a wall."""

import math

from mpsim.kernels.compiling import inlined
from mpsim.kernels.events.boundary import along
from mpsim.kernels.events.cells import cell_of, leave_list
from mpsim.kernels.events.features.hooks import (
    approach,
    between_discs,
    leave,
    lets_out,
    mass_of,
    on_surface,
    on_wall,
    radius_at,
    restitution_between,
    speed_off_surface,
    speed_off_wall,
    surface,
    thermal_speed_off_wall,
)
from mpsim.kernels.events.flight import advance_to
from mpsim.kernels.events.records import VIRIAL, VIRIAL_XX, VIRIAL_XY, add, counts
from mpsim.kernels.geometry import nearest_image

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
    b = approach(i, j, b, rx, ry, box, features)
    if b < 0.0:
        e = restitution_between(max(one.last_contact, other.last_contact), now, features, store)
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
    if lets_out(side, features):
        disc.position[axis] = length - radius if high else radius
        leave(i, store, features)
        leave_list(i, cell_of(i, store, box), store)
        store.cell_next[i] = -1
        store.event[i].collision_count += 1
        store.counter.walls += counts(store.region)
        return
    speed = -inward * disc.velocity[axis]
    leaving = speed_off_wall(i, speed, axis, inward, disc.last_contact, now, store, box, features)
    leaving, sliding = thermal_speed_off_wall(i, side, leaving, store, features)
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
    met, nx, ny, depth, speed, edge = surface(i, side, now, store, box, features)
    if not met:
        return False
    disc = store.disc[i]
    disc.position[0] += depth * nx
    disc.position[1] += depth * ny
    inward = disc.velocity[0] * nx + disc.velocity[1] * ny - speed
    leaving = speed_off_surface(max(-inward, 0.0), nx, ny, disc.last_contact, now, features, store)
    leaving = max(leaving, PARTING * (abs(disc.velocity[0]) + abs(disc.velocity[1])))
    change = max(leaving - inward, 0.0)  # in a grazing impact, rounding may have reversed it already
    disc.velocity[0] += change * nx
    disc.velocity[1] += change * ny
    on_surface(i, nx, ny, change, store, box, features)
    disc.last_contact = now
    store.event[i].collision_count += 1
    store.counter.walls += counts(store.region)
    if edge >= 0:
        add(store.tally, edge, counts(store.region) * mass_of(i, features) * change, box.impulse_unit)
    return True
