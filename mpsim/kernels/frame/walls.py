"""Walls as discs meet them that a flight, or the impact of another disc, has led beyond."""

from mpsim.kernels.compiling import compiled, inlined
from mpsim.kernels.features.acceleration import bounce_between, count_impulses
from mpsim.kernels.layout import WALL_BOUNCE, WALL_RESTITUTION, X_LOW, Y_LOW
from mpsim.kernels.optional import absorbs, has_any, own_or, pull_on, wall_place, wall_speed


@inlined
def reach_wall(p, v, low, high, low_speed, high_speed, bounce, restitution):
    """The wall rule along one axis between walls that may move: place and velocity after the step that led to p."""
    if p < low:
        if v < low_speed:
            v = low_speed - (v - low_speed) * restitution
        p = min(low + bounce * (low - p), high)
    elif p > high:
        if v > high_speed:
            v = high_speed - (v - high_speed) * restitution
        p = max(high + bounce * (high - p), low)
    return p, v


@inlined
def is_between(p, axis_low, margin, wrap, piston, parameters):
    """Whether p is not beyond a wall along x (axis_low is X_LOW) or y (Y_LOW). True for what is not a number."""
    if wrap is not None:
        return True
    low = wall_place(piston, axis_low, parameters) + margin
    high = wall_place(piston, axis_low + 1, parameters) - margin
    return not ((p < low) | (p > high))


@inlined
def bounce_along(p, v, pull, axis_low, margin, wrap, features, parameters, control):
    """Place and velocity along one axis, and what the low and the high wall have changed it by.

    At an edge that absorbs, the disc is put on the edge and goes on: the next step takes it out.
    """
    zero = parameters.dtype.type(0)
    if wrap is not None:
        return p, v, zero, zero
    low = wall_place(features.piston, axis_low, parameters) + margin
    high = wall_place(features.piston, axis_low + 1, parameters) - margin
    if (p < low) & absorbs(features.exits, control, axis_low):
        return low, v, zero, zero
    if (p > high) & absorbs(features.exits, control, axis_low + 1):
        return high, v, zero, zero
    speeds = wall_speed(features.piston, axis_low, zero), wall_speed(features.piston, axis_low + 1, zero)
    if has_any(features.gravity, features.acceleration):
        place, turned = bounce_between(p, v, pull, low, high, *speeds, parameters)
    else:
        place, turned = reach_wall(p, v, low, high, *speeds, parameters[WALL_BOUNCE], parameters[WALL_RESTITUTION])
    return place, turned, turned - v if p < low else zero, v - turned if p > high else zero


@compiled
def bounce(discs, i, features, parameters, control, tally, frame):
    """Bounce disc i off the walls that an impact has led it beyond, and count the impulse on them."""
    zero = discs.x.dtype.type(0)
    disc = discs.id[i]
    margin = own_or(discs.radius, i, zero)
    pull_x = pull_on(features.gravity, features.acceleration, 0, disc, zero)
    pull_y = pull_on(features.gravity, features.acceleration, 1, disc, zero)
    x, vx, left, right = bounce_along(
        discs.x[i], discs.vx[i], pull_x, X_LOW, margin, features.wrap_x, features, parameters, control
    )
    y, vy, bottom, top = bounce_along(
        discs.y[i], discs.vy[i], pull_y, Y_LOW, margin, features.wrap_y, features, parameters, control
    )
    discs.x[i], discs.y[i], discs.vx[i], discs.vy[i] = x, y, vx, vy
    count_impulses(left, right, bottom, top, disc, features, parameters, tally, frame)


@inlined
def keep_inside(discs, i, features, parameters, control, tally, frame):
    """`bounce`, if an impact has led disc i beyond a wall: seldom, so the bounce is a call."""
    margin = own_or(discs.radius, i, discs.x.dtype.type(0))
    free_x = is_between(discs.x[i], X_LOW, margin, features.wrap_x, features.piston, parameters)
    free_y = is_between(discs.y[i], Y_LOW, margin, features.wrap_y, features.piston, parameters)
    if not (free_x & free_y):
        bounce(discs, i, features, parameters, control, tally, frame)
