"""Flight over one step, straight or along exact parabolas: by blocks that meet no boundary, else disc by disc.

An accelerated disc ends a step with v + a dt, and its mean velocity in it is that minus a dt / 2.
"""

from mpsim.kernels.compiling import inlined, linked
from mpsim.kernels.features.acceleration import accelerations_of
from mpsim.kernels.features.boundary import count_flight, no_contact, reach_boundary, wrapped
from mpsim.kernels.frame.walls import commit_wall_contact, walls_of_step
from mpsim.kernels.layout import ALONG_X, ALONG_Y, BOTTOM, LEFT, RIGHT, TOP
from mpsim.kernels.optional import slice_of, value_or
from mpsim.kernels.records import real

BLOCK = 64
"""Discs that are looked at together."""


@inlined
def kicked(accelerated, v, kick):
    """A velocity after the acceleration of a step has changed it by `kick`; accelerated: None if no disc is."""
    if accelerated is None:
        return v
    return v + kick


@inlined
def mean_velocity(accelerated, v, half_kick):
    """The mean velocity of a step that ends with v."""
    if accelerated is None:
        return v
    return v - half_kick


@inlined
def displacement(accelerated, v, acceleration, parameters):
    """The displacement in a step that ends with v [length]."""
    dt = parameters.dt
    return mean_velocity(accelerated, v, acceleration * dt / real(parameters, 2)) * dt


@inlined
def try_fly_freely(discs, low, high, accelerated, gravity, parameters):
    """Advance a block of discs, unless one starts or ends beyond a limit: vector code. Returns whether it did.

    A value that is not finite counts as beyond, so it is found when the discs are moved one by one.
    """
    zero, two, dt = real(parameters, 0), real(parameters, 2), parameters.dt
    x, y, vx, vy = discs.x[low:high], discs.y[low:high], discs.vx[low:high], discs.vy[low:high]
    radius = slice_of(discs.radius, low, high)
    x_low, x_high = parameters.limit[LEFT], parameters.limit[RIGHT]
    y_low, y_high = parameters.limit[BOTTOM], parameters.limit[TOP]
    kick_x, kick_y = value_or(gravity, 0, zero) * dt, value_or(gravity, 1, zero) * dt
    half_x, half_y = kick_x / two, kick_y / two
    free = True
    for i in range(high - low):
        margin = value_or(radius, i, zero)
        px = x[i] + mean_velocity(accelerated, kicked(accelerated, vx[i], kick_x), half_x) * dt
        py = y[i] + mean_velocity(accelerated, kicked(accelerated, vy[i], kick_y), half_y) * dt
        inside_x = (px >= x_low + margin) & (px < x_high - margin) & (x[i] >= x_low) & (x[i] < x_high)
        inside_y = (py >= y_low + margin) & (py < y_high - margin) & (y[i] >= y_low) & (y[i] < y_high)
        free &= inside_x & inside_y
    if free:
        for i in range(high - low):
            vx[i] = kicked(accelerated, vx[i], kick_x)
            vy[i] = kicked(accelerated, vy[i], kick_y)
            x[i] += mean_velocity(accelerated, vx[i], half_x) * dt
            y[i] += mean_velocity(accelerated, vy[i], half_y) * dt
    return free


@inlined
def try_fly_block(discs, low, high, accelerated, acceleration, gravity, parameters):
    """`try_fly_freely`, unless discs have individual accelerations. Returns whether it did."""
    if accelerated is not None:  # noqa: SIM102 - see optional.py
        if acceleration is not None:
            return False
    return try_fly_freely(discs, low, high, accelerated, gravity, parameters)


@inlined
def fly_along(p, v, acceleration, accelerated, edges, margin, wrap, features, parameters):
    """One step along the axis with these edges; returns a `WallContact`."""
    zero = real(parameters, 0)
    v = kicked(accelerated, v, acceleration * parameters.dt)
    p = wrapped(wrapped(p, wrap) + displacement(accelerated, v, acceleration, parameters), wrap)
    if p - p != zero:  # not finite: detected by the caller
        return no_contact(p, v, zero)
    walls = walls_of_step(edges, margin, features, parameters)
    return reach_boundary(p, v, acceleration, accelerated, walls, wrap, parameters)


@inlined
def flight_of(discs, i, ax, ay, accelerated, features, parameters):
    """Where one step leads disc i, along x and along y: two of `WallContact`. Changes nothing."""
    margin = value_or(discs.radius, i, real(parameters, 0))
    x = fly_along(discs.x[i], discs.vx[i], ax, accelerated, ALONG_X, margin, features.wrap_x, features, parameters)
    y = fly_along(discs.y[i], discs.vy[i], ay, accelerated, ALONG_Y, margin, features.wrap_y, features, parameters)
    return x, y


@inlined
def fly_one(discs, i, accelerated, features, parameters, control, tally, frame):
    """Advance disc i. Returns True if it is not finite."""
    zero = real(parameters, 0)
    ax, ay = accelerations_of(discs, i, features)
    along_x, along_y = flight_of(discs, i, ax, ay, accelerated, features, parameters)
    x, y, vx, vy = along_x.position, along_y.position, along_x.velocity, along_y.velocity
    flight_x = displacement(accelerated, vx, ax, parameters)
    flight_y = displacement(accelerated, vy, ay, parameters)
    count_flight(discs, i, x, y, flight_x, flight_y, features)
    commit_wall_contact(discs, i, along_x, along_y, True, features, parameters, control, tally, frame)
    return not ((x - x == zero) & (y - y == zero) & (vx - vx == zero) & (vy - vy == zero))


@linked
def fly(discs, low, high, accelerated, features, parameters, control, tally, frame):
    """Advance a slice, whatever its boundaries and radii are. Returns True if a position or velocity is not finite.

    accelerated: True for parabolas; None: discs fly straight, as under contact `push`.
    """
    bad = False
    for first in range(low, high, BLOCK):
        last = min(first + BLOCK, high)
        if not try_fly_block(discs, first, last, accelerated, features.acceleration, features.gravity, parameters):
            for i in range(first, last):
                bad |= fly_one(discs, i, accelerated, features, parameters, control, tally, frame)
    return bad
