"""Laws of an impact: restitution, friction, thermal walls; and the thermostat."""

import math
from typing import NamedTuple

from mpsim.kernels.compiling import inlined, linked
from mpsim.kernels.events.features.edges import is_absent
from mpsim.kernels.events.features.properties import component, mass_of, radius_of
from mpsim.kernels.events.flight import advance_to
from mpsim.kernels.events.records import counts
from mpsim.kernels.features.collisions import BATH, add_heat
from mpsim.kernels.random_numbers import normal_pair, pair, wall_velocity

# --- Friction: the law of Walton and Braun (J. Rheol. 30, 949, 1986) at an impact
#
# Written independently: it shares nothing with that of the stepped solvers. Uniform discs have the moment of inertia m
# a^2 / 2, so that a tangential impulse J changes the slip of the surfaces by 3 J / m_eff.


class ImpactFriction(NamedTuple):
    """Of two discs, or of a disc and a wall: largest ratio of tangential to normal impulse, and restitution."""

    coefficient: float
    tangential_restitution: float


@inlined
def tangential_impulse(law, slip, mass, normal_impulse):
    """Impulse against the slip [mass length/time]; mass: the effective one."""
    sticking = (1.0 + law.tangential_restitution) * mass * abs(slip) / 3.0
    return -math.copysign(min(sticking, law.coefficient * normal_impulse), slip)


@inlined
def between_discs(friction, i, j, rx, ry, normal_impulse, store, box, features):
    """Friction of discs i and j, r = r_i - r_j apart. Returns the impulse on i along r rotated to the left."""
    if friction is not None:
        one, other, spin = store.disc[i], store.disc[j], features.spin
        distance = math.sqrt(rx * rx + ry * ry)
        tx, ty = -ry / distance, rx / distance
        mass_i, mass_j = mass_of(i, features), mass_of(j, features)
        radius_i, radius_j = radius_of(i, box, features), radius_of(j, box, features)
        slip = (one.velocity[0] - other.velocity[0]) * tx + (one.velocity[1] - other.velocity[1]) * ty
        slip -= radius_i * spin[i] + radius_j * spin[j]
        impulse = tangential_impulse(friction, slip, mass_i * mass_j / (mass_i + mass_j), normal_impulse)
        one.velocity[0] += impulse / mass_i * tx
        one.velocity[1] += impulse / mass_i * ty
        other.velocity[0] -= impulse / mass_j * tx
        other.velocity[1] -= impulse / mass_j * ty
        spin[i] -= 2.0 * impulse / (mass_i * radius_i)
        spin[j] -= 2.0 * impulse / (mass_j * radius_j)
        return impulse
    return 0.0


@inlined
def on_surface(wall_friction, i, nx, ny, normal_change, running, store, box, features):
    """Friction of disc i on a surface that changed its velocity by so much along n, the unit vector from there.

    running: speed of the surface along (-ny, nx). Returns the change of its velocity along (-ny, nx).
    """
    if wall_friction is not None:
        velocity, spin, radius = store.disc[i].velocity, features.spin, radius_of(i, box, features)
        slip = velocity[1] * nx - velocity[0] * ny - radius * spin[i] - running
        impulse = tangential_impulse(wall_friction, slip, 1.0, normal_change)
        velocity[0] -= impulse * ny
        velocity[1] += impulse * nx
        spin[i] -= 2.0 * impulse / radius
        return impulse
    return 0.0


@inlined
def on_wall(wall_friction, i, axis, inward, normal_change, running, store, box, features):
    """Friction of disc i on a wall at right angles to an axis, which has changed its velocity inward by so much.

    running: velocity of the wall along itself. Returns the change of the disc's velocity along it.
    """
    if wall_friction is not None:
        velocity, spin, radius = store.disc[i].velocity, features.spin, radius_of(i, box, features)
        along = 1 - axis
        sign = inward if axis == 0 else -inward  # of the tangent, the inward normal rotated to the left
        slip = sign * (velocity[along] - running) - radius * spin[i]
        impulse = tangential_impulse(wall_friction, slip, 1.0, max(normal_change, 0.0))
        velocity[along] += sign * impulse
        spin[i] -= 2.0 * impulse / radius
        return sign * impulse
    return 0.0


# --- Restitution: impacts that lose energy, and the guard that ends inelastic collapse (the TC model)
#
# An impact loses no energy if one of its discs had its last contact less than the contact time ago (Luding and
# McNamara, Granular Matter 1, 113, 1998). `counter.guarded` counts how often.


@inlined
def effective_restitution(restitution, last_contact, now, contact_time, store):
    """The restitution of one impact, 1 if the guard acts."""
    if restitution is None:
        return 1.0
    if now - last_contact < contact_time and restitution < 1.0:
        store.counter.guarded += counts(store.region)
        return 1.0
    return restitution


@inlined
def speed_off(speed, nx, ny, last_contact, now, features, store):
    """Speed at which a disc leaves a fixed surface after it hit it at such a speed, along the unit vector n from it.

    It is never so small that gravity brings the disc back in less than `contact_time`. A disc at rest makes small
    bounces of that duration, at most g contact_time^2/8 high, and the guard counts them. Without this it would hit the
    surface infinitely often in a finite time.
    """
    e = effective_restitution(features.wall_restitution, last_contact, now, features.contact_time, store)
    if features.gravity is None:
        return e * speed
    pull = nx * component(features.gravity, 0) + ny * component(features.gravity, 1)
    return fast_enough(e * speed, pull, features.contact_time, store)


@inlined
def fast_enough(speed, pull, contact_time, store):
    """A speed, but at least that of a bounce of duration `contact_time` under an acceleration `pull` outward."""
    least = -0.5 * pull * contact_time
    if speed < least:
        store.counter.guarded += counts(store.region)
        return least
    return speed


# --- A thermostat: at the end of a frame, random discs get new velocities, the same as those of the stepped solvers


@linked
def is_heated(thermostat, i, particle, frame, features):
    """Whether disc i, a particle of the scene, gets a new velocity after so many frames."""
    probability, _, seed, first_frame = thermostat
    chance, _ = pair(seed, particle, first_frame + frame, 0)
    return chance < probability and not is_absent(features.exits, i)


@linked
def heat(thermostat, i, particle, now, frame, store, features):
    """Give disc i a new velocity at the time `now`, after so many frames, if it is due."""
    if is_heated(thermostat, i, particle, frame, features):
        _, temperature, seed, first_frame = thermostat
        disc = store.disc[i]
        advance_to(disc, now, features.gravity)
        speed = math.sqrt(temperature / mass_of(i, features))
        x, y = normal_pair(seed, particle, first_frame + frame, 1)
        add_heat(features.work, BATH, i, disc.velocity, (speed * x, speed * y), features.mass)
        disc.velocity[0], disc.velocity[1] = speed * x, speed * y
        store.event[i].collision_count += 1


# --- Thermal walls: a disc leaves one with a velocity drawn from those that cross it in equilibrium
#
# As in `kernels/features/baths.py`, with the numbers of discs in the store, which are the same in tiles.


@linked
def speed_off_thermal_wall(thermal_walls, i, side, leaving, store, features):
    """Draw the velocity of disc i after its impact on `side`. Returns its speed inward, its change along the wall.

    leaving: speed inward off a wall that is not thermal.
    """
    if thermal_walls is None:
        return leaving, 0.0
    temperatures, seed = thermal_walls
    velocity, position, axis = store.disc[i].velocity, store.disc[i].position, side >> 1
    if temperatures[side] <= 0.0:
        return leaving, 0.0
    speed = math.sqrt(temperatures[side] / mass_of(i, features))
    normal, across = wall_velocity(seed, store.event[i].number, position[1 - axis], velocity[axis], velocity[1 - axis])
    sliding = speed * across - velocity[1 - axis]
    if counts(store.region) != 0:
        add_heat(features.work, side, i, velocity, (speed * normal, speed * across), features.mass)
    velocity[1 - axis] = speed * across
    return speed * normal, sliding
