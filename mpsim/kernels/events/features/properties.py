"""Radii, which may grow, masses, counts of periods: one for each disc; and gravity."""

import math

from mpsim.kernels.compiling import inlined, value_or
from mpsim.kernels.events import flight

# --- Counts of periods: how often each disc has left through a periodic border, so that its path can be unwrapped


@inlined
def through_border(image, i, axis, direction):
    """Disc i has left through a periodic border, upward (direction = 1) or downward (-1) along the axis."""
    if image is not None:
        image[i, axis] += direction


# --- Gravity: one acceleration for all discs, so that their relative motion stays uniform


@inlined
def component(gravity, axis):
    """One component of the acceleration [length/time^2]."""
    if gravity is None:
        return 0.0
    return gravity[axis]


# --- Radii and masses: one for each disc, or one for all


@inlined
def radius_of(i, box, features):
    """Radius of disc i [length]."""
    return value_or(features.radius, i, box.radius)


@inlined
def mass_of(i, features):
    """Mass of disc i [mass], 1 if all have the same."""
    return value_or(features.mass, i, 1.0)


# --- Expansion: radii that grow in proportion to time (Lubachevsky and Stillinger, J. Stat. Phys. 60, 561, 1990)
#
# At a time t since the start, each radius is (1 + expansion t) times its first value. Surfaces then move, and an impact
# reverses the normal velocity relative to them, so that discs leave faster than they arrived: by twice the speed at
# which the radii grow. This heats the discs. The caller removes the heat, and stops before a disc outgrows its cell.

LEAST = 2.0**-10
"""Speed at which surfaces part at least, as a fraction of that of their growth, so that none stay in touch."""


@inlined
def expanded(expansion, length, now, store):
    """A radius, or a sum of them, at a time of the store [length]."""
    if expansion is None:
        return length
    return length * (1.0 + expansion * (store.clock.origin + now))


@inlined
def radius_at(i, now, store, box, features):
    """Radius of disc i at a time of the store [length]."""
    return expanded(features.expansion, radius_of(i, box, features), now, store)


@inlined
def time_to_touch(expansion, rx, ry, ux, uy, contact, now, store):
    """Time until two discs touch [time], infinity if they never do; contact: sum of the radii at the start.

    The first root of (u^2 - s^2) t^2 + 2 (r.u - c s) t + r^2 - c^2 = 0, where the contact distance is c now and grows
    at the speed s, in the form that does not cancel. Discs that overlap by rounding touch now, unless they separate.
    """
    if expansion is None:
        return flight.time_to_impact(rx, ry, ux, uy, contact)
    speed = expansion * contact
    reach = expanded(expansion, contact, now, store)
    a = ux * ux + uy * uy - speed * speed
    b = rx * ux + ry * uy - reach * speed
    gap = rx * rx + ry * ry - reach * reach
    discriminant = b * b - a * gap
    if rx * rx + ry * ry == 0.0:  # a disc does not meet itself
        return flight.INFINITY
    if gap <= 0.0 and (b < 0.0 or discriminant < 0.0):
        return 0.0
    if b < 0.0:
        return gap / (math.sqrt(discriminant) - b) if discriminant >= 0.0 else flight.INFINITY
    return (b + math.sqrt(discriminant)) / -a if a < 0.0 else flight.INFINITY


@inlined
def time_to_border(expansion, low, high, low_is_wall, high_is_wall, radius, disc, axis, gravity):
    """Time until the centre of a disc between two limits reaches one: (time, 0 low or 1 high). radius: at the start.

    A wall's limit moves closer as the disc grows.
    """
    if expansion is None:
        return flight.time_to_leave(low, high, disc.position[axis], disc.velocity[axis], gravity, axis)
    down = _time_to_meet(disc.position[axis] - low, expansion * radius * low_is_wall - disc.velocity[axis])
    up = _time_to_meet(high - disc.position[axis], expansion * radius * high_is_wall + disc.velocity[axis])
    return (up, 1) if up < down else (down, 0)


@inlined
def _time_to_meet(ahead, speed):
    """Time until a limit at such a distance is reached at such a speed."""
    return max(ahead, 0.0) / speed if speed > 0.0 else flight.INFINITY


@inlined
def approach_of_surfaces(expansion, b, rx, ry, contact):
    """r.u of two touching discs, relative to their moving surfaces; contact: sum of the radii at the start."""
    if expansion is None:
        return b
    growth = expansion * contact * math.sqrt(rx * rx + ry * ry)
    return min(b - growth, -LEAST * growth)


@inlined
def speed_off_approaching(expansion, speed, leaving, radius):
    """Speed inward of a disc that has hit a wall at such a speed outward; leaving: its value without growth."""
    if expansion is None:
        return leaving
    growth = expansion * radius
    return max(speed + growth, LEAST * growth) + growth
