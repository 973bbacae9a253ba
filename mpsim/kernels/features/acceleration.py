"""One step of accelerated discs under contact `impact`: exact parabolas, exact bounces off walls at rest.

The report's v += a dt, p += v dt, with a bounce where the frame ended, loses or gains energy at each bounce. Here a
disc that ends a step beyond a wall is taken back along its parabola to the instant at which it touched, turned round
there, and let go on. With depth d beyond the wall, speed s outward now and acceleration A outward:

    speed at the wall   c = sqrt(s^2 - 2 A d)             energy
    time since then     t = 2 d / (s + c)                 mean speed (s + c) / 2 over the way d
    now                 e c t - A t^2 / 2 inside, moving inward at e c - A t
"""

import numpy as np

from mpsim.kernels.compiling import compiled, inlined
from mpsim.kernels.features.absorption import is_gone
from mpsim.kernels.features.images import count_flight
from mpsim.kernels.layout import DT, TALLY_SCALE, WALL_RESTITUTION, X_LOW, Y_LOW
from mpsim.kernels.optional import own_or, pull_on, wall_speed, wrapped
from mpsim.kernels.wall_free import BLOCK, glide


@inlined
def bounce_back(depth, speed, pull, parameters):
    """(way inside, speed inward) of a disc `depth` beyond a wall; speed and pull are outward.

    A disc that moves inward, and was not carried out by its flight, is put at the wall and pays for that.
    """
    zero, two = parameters.dtype.type(0), parameters.dtype.type(2)  # whole numbers would make float64 of float32
    at_wall = np.sqrt(max(speed * speed - two * pull * depth, zero))
    if speed + at_wall <= zero:
        return zero, at_wall
    time = min(two * depth / (speed + at_wall), parameters[DT])
    inward = parameters[WALL_RESTITUTION] * at_wall
    way = (inward - pull * time / two) * time
    inward -= pull * time
    if way < zero:  # it does not leave the wall any more: it rests there
        return zero, max(inward, zero)
    return way, inward


@inlined
def bounce_between(p, v, pull, low, high, low_speed, high_speed, parameters):
    """Place and velocity of an accelerated disc that a flight has led to p, between walls that may move."""
    if p < low:
        way, inward = bounce_back(low - p, low_speed - v, -pull, parameters)
        return min(low + way, high), low_speed + inward
    if p > high:
        way, inward = bounce_back(p - high, v - high_speed, pull, parameters)
        return max(high - way, low), high_speed - inward
    return p, v


@inlined
def fall_along(p, v, pull, axis_low, margin, wrap, piston, parameters):
    """One step along x (X_LOW) or y (Y_LOW): place, velocity, and what the low and the high wall have changed it by."""
    zero, two = parameters.dtype.type(0), parameters.dtype.type(2)
    dt = parameters[DT]
    v += pull * dt
    p = wrapped(p, wrap) + (v - pull * dt / two) * dt
    if wrap is not None:
        return wrapped(p, wrap), v, zero, zero
    low, high = parameters[axis_low] + margin, parameters[axis_low + 1] - margin
    if p - p != zero:  # not finite: found out by the caller
        return p, v, zero, zero
    speeds = wall_speed(piston, axis_low, zero), wall_speed(piston, axis_low + 1, zero)
    place, turned = bounce_between(p, v, pull, low, high, *speeds, parameters)
    return place, turned, turned - v if p < low else zero, v - turned if p > high else zero


@inlined
def glide_down(discs, low, high, gravity, acceleration, parameters):
    """`glide` where all discs are accelerated alike. Returns whether it did."""
    if acceleration is not None:
        return False
    if gravity is None:
        return False
    two, dt = parameters.dtype.type(2), parameters[DT]
    kick_x, kick_y = gravity[0] * dt, gravity[1] * dt
    return glide(discs, low, high, kick_x, kick_y, kick_x / two, kick_y / two, parameters)


@compiled
def fall(discs, low, high, features, parameters, tally, frame):
    """Advance a slice of accelerated discs. Returns True if a position or velocity is not finite."""
    bad = False
    for first in range(low, high, BLOCK):
        last = min(first + BLOCK, high)
        if not glide_down(discs, first, last, features.gravity, features.acceleration, parameters):
            for i in range(first, last):
                bad |= fall_alone(discs, i, features, parameters, tally, frame)
    return bad


@inlined
def count_impulses(left, right, bottom, top, disc, features, parameters, tally, frame):
    """Add up the impulses on the walls that have changed the velocity of a disc by so much."""
    if tally is not None and not is_gone(features.exits, disc):
        scale = np.float64(parameters[TALLY_SCALE]) * own_or(features.mass, disc, parameters.dtype.type(1))
        for wall, change in enumerate((left, right, bottom, top)):
            tally[frame, wall] += np.int64(change * scale)


@inlined
def fall_alone(discs, i, features, parameters, tally, frame):
    """Advance one accelerated disc. Returns True if it is not finite."""
    zero = discs.x.dtype.type(0)
    disc = discs.id[i]
    margin = own_or(discs.radius, i, zero)
    pull_x = pull_on(features.gravity, features.acceleration, 0, disc, zero)
    pull_y = pull_on(features.gravity, features.acceleration, 1, disc, zero)
    x, vx, left, right = fall_along(
        discs.x[i], discs.vx[i], pull_x, X_LOW, margin, features.wrap_x, features.piston, parameters
    )
    y, vy, bottom, top = fall_along(
        discs.y[i], discs.vy[i], pull_y, Y_LOW, margin, features.wrap_y, features.piston, parameters
    )
    two, dt = discs.x.dtype.type(2), parameters[DT]
    count_flight(discs, i, x, y, (vx - pull_x * dt / two) * dt, (vy - pull_y * dt / two) * dt, features)
    discs.x[i], discs.y[i], discs.vx[i], discs.vy[i] = x, y, vx, vy
    count_impulses(left, right, bottom, top, disc, features, parameters, tally, frame)
    return not ((x - x == zero) & (y - y == zero) & (vx - vx == zero) & (vy - vy == zero))
