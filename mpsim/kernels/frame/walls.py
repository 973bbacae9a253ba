"""Walls as discs meet them that a flight, or the impact of another disc, has led beyond."""

import numpy as np

from mpsim.kernels.bouncing import bounce_back
from mpsim.kernels.compiling import compiled, inlined
from mpsim.kernels.features.acceleration import acceleration_of
from mpsim.kernels.features.hooks import between_disc_and_walls, is_absent, lets_out, wall_place, wall_speed
from mpsim.kernels.layout import ALONG_X, ALONG_Y, BOTTOM, LEFT, RIGHT, TOP
from mpsim.kernels.optional import any_present, value_or
from mpsim.kernels.records import real


@inlined
def reach_wall(p, v, low, high, low_speed, high_speed, bounce, restitution):
    """The wall rule along one axis between walls that may move, for a step that has led to p.

    Place and velocity after it, and the time since the wall has turned the disc round [time].
    """
    time = low - low
    if p < low:
        if v < low_speed:
            time = (low - p) / (low_speed - v)
            v = low_speed - (v - low_speed) * restitution
        p = min(low + bounce * (low - p), high)
    elif p > high:
        if v > high_speed:
            time = (p - high) / (v - high_speed)
            v = high_speed - (v - high_speed) * restitution
        p = max(high + bounce * (high - p), low)
    return p, v, time


@inlined
def bounce_between(p, v, acceleration, low, high, low_speed, high_speed, parameters):
    """Of an accelerated disc that a flight has led to p, between walls that may move: as `reach_wall`."""
    if p < low:
        inside, inward, time = bounce_back(low - p, low_speed - v, -acceleration, parameters)
        return min(low + inside, high), low_speed + inward, time
    if p > high:
        inside, inward, time = bounce_back(p - high, v - high_speed, acceleration, parameters)
        return max(high - inside, low), high_speed - inward, time
    return p, v, low - low


@inlined
def bounce_axis(p, v, acceleration, accelerated, low, high, low_speed, high_speed, parameters):
    """Of a disc that a flight has led to p, as `reach_wall`; `accelerated` is None where no disc is."""
    if accelerated is None:
        bounce, restitution = parameters.wall_bounce, parameters.wall_restitution
        return reach_wall(p, v, low, high, low_speed, high_speed, bounce, restitution)
    return bounce_between(p, v, acceleration, low, high, low_speed, high_speed, parameters)


@inlined
def is_between(p, edges, margin, wrap, moving_wall, parameters):
    """Whether p is not beyond a wall of the axis with these edges. True for what is not a number."""
    if wrap is not None:
        return True
    low = wall_place(moving_wall, edges[0], parameters) + margin
    high = wall_place(moving_wall, edges[1], parameters) - margin
    return not ((p < low) | (p > high))


@inlined
def count_impulses(left, right, bottom, top, disc, features, parameters, tally, frame):
    """Add up the impulses on the walls that have changed the velocity of a disc by so much."""
    if tally is not None and not is_absent(features.exits, disc):
        scale = np.float64(parameters.tally_scale) * value_or(features.mass, disc, real(parameters, 1))
        for edge, change in ((LEFT, left), (RIGHT, right), (BOTTOM, bottom), (TOP, top)):
            tally[frame].wall[edge] += np.int64(change * scale)


@inlined
def bounce_along(p, v, acceleration, edges, margin, wrap, features, parameters, control):
    """Place and velocity along one axis, what the low and the high wall have changed it by, and how long ago.

    At an edge that absorbs, the disc is put on the edge and continues: the next step takes it out.
    """
    zero = real(parameters, 0)
    if wrap is not None:
        return p, v, zero, zero, zero
    low = wall_place(features.moving_wall, edges[0], parameters) + margin
    high = wall_place(features.moving_wall, edges[1], parameters) - margin
    if (p < low) & lets_out(features.exits, control, edges[0]):
        return low, v, zero, zero, zero
    if (p > high) & lets_out(features.exits, control, edges[1]):
        return high, v, zero, zero, zero
    speeds = wall_speed(features.moving_wall, edges[0], zero), wall_speed(features.moving_wall, edges[1], zero)
    place, turned, time = bounce_axis(
        p, v, acceleration, any_present(features.gravity, features.acceleration), low, high, *speeds, parameters
    )
    return place, turned, turned - v if p < low else zero, v - turned if p > high else zero, time


@compiled
def bounce(discs, i, features, parameters, control, tally, frame):
    """Bounce disc i off the walls that an impact has led it beyond, and count the impulse on them."""
    zero = discs.x.dtype.type(0)
    disc = discs.id[i]
    margin = value_or(discs.radius, i, zero)
    ax = acceleration_of(features.gravity, features.acceleration, 0, disc, zero)
    ay = acceleration_of(features.gravity, features.acceleration, 1, disc, zero)
    x, vx, left, right, time_x = bounce_along(
        discs.x[i], discs.vx[i], ax, ALONG_X, margin, features.wrap_x, features, parameters, control
    )
    y, vy, bottom, top, time_y = bounce_along(
        discs.y[i], discs.vy[i], ay, ALONG_Y, margin, features.wrap_y, features, parameters, control
    )
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
        None,
        features,
        parameters,
        control,
    )


@inlined
def keep_inside(discs, i, features, parameters, control, tally, frame):
    """`bounce`, if an impact has led disc i beyond a wall: seldom, so the bounce is a call."""
    margin = value_or(discs.radius, i, discs.x.dtype.type(0))
    free_x = is_between(discs.x[i], ALONG_X, margin, features.wrap_x, features.moving_wall, parameters)
    free_y = is_between(discs.y[i], ALONG_Y, margin, features.wrap_y, features.moving_wall, parameters)
    if not (free_x & free_y):
        bounce(discs, i, features, parameters, control, tally, frame)
