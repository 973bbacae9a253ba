"""Accelerated motion under contact `impact`: one step along exact parabolas, with bounces off walls that may move."""

from mpsim.kernels.compiling import compiled, inlined
from mpsim.kernels.features.acceleration import acceleration_of
from mpsim.kernels.features.hooks import between_disc_and_walls, wall_speed
from mpsim.kernels.features.images import count_flight, wrapped
from mpsim.kernels.frame.wall_free import BLOCK, wall_free_motion
from mpsim.kernels.frame.walls import bounce_between, count_impulses
from mpsim.kernels.layout import ALONG_X, ALONG_Y
from mpsim.kernels.optional import value_or
from mpsim.kernels.records import real


@inlined
def along_parabola(p, v, acceleration, edges, margin, wrap, moving_wall, parameters):
    """One step along the axis with these edges: place, velocity, change by each wall, how long ago."""
    zero, two = real(parameters, 0), real(parameters, 2)
    dt = parameters.dt
    v += acceleration * dt
    p = wrapped(p, wrap) + (v - acceleration * dt / two) * dt
    if wrap is not None:
        return wrapped(p, wrap), v, zero, zero, zero
    low, high = parameters.limit[edges[0]] + margin, parameters.limit[edges[1]] - margin
    if p - p != zero:  # not finite: found out by the caller
        return p, v, zero, zero, zero
    speeds = wall_speed(moving_wall, edges[0], zero), wall_speed(moving_wall, edges[1], zero)
    place, turned, time = bounce_between(p, v, acceleration, low, high, *speeds, parameters)
    return place, turned, turned - v if p < low else zero, v - turned if p > high else zero, time


@inlined
def move_block_alike(discs, low, high, gravity, acceleration, parameters):
    """`wall_free_motion` where all discs are accelerated alike. Returns whether it did."""
    if acceleration is not None:
        return False
    if gravity is None:
        return False
    two, dt = real(parameters, 2), parameters.dt
    kick_x, kick_y = gravity[0] * dt, gravity[1] * dt
    return wall_free_motion(discs, low, high, kick_x, kick_y, kick_x / two, kick_y / two, parameters)


@compiled
def accelerated_motion(discs, low, high, features, parameters, control, tally, frame):
    """Advance a slice of accelerated discs. Returns True if a position or velocity is not finite."""
    bad = False
    for first in range(low, high, BLOCK):
        last = min(first + BLOCK, high)
        if not move_block_alike(discs, first, last, features.gravity, features.acceleration, parameters):
            for i in range(first, last):
                bad |= move_one(discs, i, features, parameters, control, tally, frame)
    return bad


@inlined
def move_one(discs, i, features, parameters, control, tally, frame):
    """Advance one accelerated disc. Returns True if it is not finite."""
    zero = discs.x.dtype.type(0)
    disc = discs.id[i]
    margin = value_or(discs.radius, i, zero)
    ax = acceleration_of(features.gravity, features.acceleration, 0, disc, zero)
    ay = acceleration_of(features.gravity, features.acceleration, 1, disc, zero)
    x, vx, left, right, time_x = along_parabola(
        discs.x[i], discs.vx[i], ax, ALONG_X, margin, features.wrap_x, features.moving_wall, parameters
    )
    y, vy, bottom, top, time_y = along_parabola(
        discs.y[i], discs.vy[i], ay, ALONG_Y, margin, features.wrap_y, features.moving_wall, parameters
    )
    two, dt = discs.x.dtype.type(2), parameters.dt
    count_flight(discs, i, x, y, (vx - ax * dt / two) * dt, (vy - ay * dt / two) * dt, features)
    discs.x[i], discs.y[i], discs.vx[i], discs.vy[i] = x, y, vx, vy
    count_impulses(left, right, bottom, top, disc, features, parameters, tally, frame)
    between_disc_and_walls(
        features.wall_friction,
        discs,
        i,
        left - right,
        bottom - top,
        time_x,
        time_y,
        True,
        features,
        parameters,
        control,
    )
    return not ((x - x == zero) & (y - y == zero) & (vx - vx == zero) & (vy - vy == zero))
