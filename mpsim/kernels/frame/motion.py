"""Motion of a slice of discs over one step: acceleration, flight, walls, and the check of speeds."""

import math

import numpy as np

from mpsim.kernels.compiling import any_present, inlined, linked, slice_of, value_or
from mpsim.kernels.features.baths import heat, redraw_at_walls
from mpsim.kernels.features.bodies import wall_motion, wall_place
from mpsim.kernels.features.collisions import add_work, log_walls, on_walls
from mpsim.kernels.features.edges import (
    Walls,
    absorb,
    count_flight,
    is_absent,
    is_between,
    lets_out,
    no_contact,
    put_back_absorbed,
    reach_boundary,
    wrapped,
)
from mpsim.kernels.features.hooks import after_move, special_borders
from mpsim.kernels.features.properties import accelerate, accelerations_of
from mpsim.kernels.machine import atomic_store
from mpsim.kernels.records import ALONG_X, ALONG_Y, BAD, BOTTOM, FASTEST_SCALE, IMPACT, LEFT, RIGHT, TOP, real

# --- Walls of the box: where they are, what they do to discs, and discs that an impact has moved beyond them


@inlined
def with_motions(low, high, edges, features, parameters):
    """Walls at such places, with the motions of those at these edges."""
    low_speed, low_acceleration = wall_motion(features.moving_wall, edges[0], parameters)
    high_speed, high_acceleration = wall_motion(features.moving_wall, edges[1], parameters)
    return Walls(low, high, low_speed, high_speed, low_acceleration, high_acceleration)


@inlined
def walls_of_step(edges, margin, features, parameters):
    """The walls at these edges at the end of a step, as a flight meets them."""
    limit = parameters.limit
    low, high = limit[edges[0]] + margin, limit[edges[1]] - margin
    return with_motions(low, high, edges, features, parameters)


@inlined
def walls_at_contacts(edges, margin, features, parameters):
    """The same while contacts are resolved, when the limits are already those of the next step."""
    low = wall_place(features.moving_wall, edges[0], parameters) + margin
    high = wall_place(features.moving_wall, edges[1], parameters) - margin
    return with_motions(low, high, edges, features, parameters)


@inlined
def count_impulses(x, y, disc, features, parameters, control, tally, frame):
    """Add the impulses on the walls that a disc has hit along x and along y."""
    if control.tallied and not is_absent(features.exits, disc):
        scale = np.float64(parameters.tally_scale) * value_or(features.mass, disc, real(parameters, 1))
        changes = (LEFT, x.low_change), (RIGHT, x.high_change), (BOTTOM, y.low_change), (TOP, y.high_change)
        for edge, change in changes:
            if change != 0:
                tally[frame].wall[edge] += np.int64(change * scale)


@inlined
def count_work(moving_wall, x, y, sliding, disc, features, parameters):
    """Add the work of the walls that a disc has hit along x and along y, if any wall moves; sliding: of `on_walls`."""
    if moving_wall is not None:
        for edge, met, change, along in (
            (LEFT, x, x.low_change, sliding[0]), (RIGHT, x, -x.high_change, sliding[0]),
            (BOTTOM, y, y.low_change, sliding[1]), (TOP, y, -y.high_change, sliding[1]),
        ):  # fmt: skip
            if change != 0 and not is_absent(features.exits, disc):
                speed, acceleration = wall_motion(features.moving_wall, edge, parameters)
                power = change * (speed - acceleration * met.time) + along * moving_wall.wall[edge].running
                add_work(features.work, edge, disc, power, features.mass)


@inlined
def commit_wall_contact(discs, i, x, y, in_flight, features, parameters, control, tally, frame):
    """Write back disc i after its motion along x and along y, tally its impulses on walls, and apply features there.

    x, y: of `WallContact`. in_flight: None while contacts are resolved.
    """
    discs.x[i], discs.y[i], discs.vx[i], discs.vy[i] = x.position, y.position, x.velocity, y.velocity
    x, y = redraw_at_walls(features.thermal_walls, discs, i, x, y, in_flight, features, parameters, control)
    count_impulses(x, y, discs.id[i], features, parameters, control, tally, frame)
    sliding = on_walls(discs, i, x, y, in_flight, features, parameters, control)
    count_work(features.moving_wall, x, y, sliding, discs.id[i], features, parameters)


@inlined
def bounce_along(p, v, acceleration, edges, margin, wrap, features, parameters, control):
    """The `WallContact`, along the axis with these edges, of a disc that an impact has moved to p.

    At an absorbing edge, the disc is put on the edge and continues: the next step absorbs it.
    """
    zero, walls = real(parameters, 0), walls_at_contacts(edges, margin, features, parameters)
    if (p < walls.low) & lets_out(features.exits, control, edges[0]):
        return no_contact(walls.low, v, zero)
    if (p > walls.high) & lets_out(features.exits, control, edges[1]):
        return no_contact(walls.high, v, zero)
    accelerated = any_present(features.gravity, features.acceleration)
    return reach_boundary(p, v, acceleration, accelerated, walls, wrap, parameters)


@linked
def bounce(discs, i, features, parameters, control, tally, frame):
    """Bounce disc i off the walls beyond which an impact has moved it, and count the impulse on them."""
    margin = value_or(discs.radius, i, real(parameters, 0))
    ax, ay = accelerations_of(discs, i, features)
    x = bounce_along(discs.x[i], discs.vx[i], ax, ALONG_X, margin, features.wrap_x, features, parameters, control)
    y = bounce_along(discs.y[i], discs.vy[i], ay, ALONG_Y, margin, features.wrap_y, features, parameters, control)
    commit_wall_contact(discs, i, x, y, None, features, parameters, control, tally, frame)


@inlined
def keep_inside(discs, i, features, parameters, control, tally, frame):
    """`bounce`, if an impact has moved disc i beyond a wall: rare, so the bounce is not inlined."""
    margin = value_or(discs.radius, i, real(parameters, 0))
    walls_x = walls_at_contacts(ALONG_X, margin, features, parameters)
    walls_y = walls_at_contacts(ALONG_Y, margin, features, parameters)
    free_x = is_between(discs.x[i], walls_x, features.wrap_x)
    free_y = is_between(discs.y[i], walls_y, features.wrap_y)
    if not (free_x & free_y):
        bounce(discs, i, features, parameters, control, tally, frame)


# --- Flight over one step, straight or along exact parabolas: by blocks that meet no boundary, else disc by disc
#
# An accelerated disc ends a step with v + a dt, and its mean velocity in it is that minus a dt / 2.

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
    if accelerated is not None:  # noqa: SIM102 - see compiling.py
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


# --- Which discs are too fast for the next step: detected as they move; the fastest one is reported
#
# The test whether any disc of a slice is beyond the limit has no branch and no order, so that it becomes vector code.
# Only if one is are the discs examined one by one.

MOST = 2.0**40
"""Largest speed that is reported, in units of the limit: more does not fit the word."""


@linked
def any_fast(discs, low, high, parameters):
    """Whether a disc of a slice is beyond the limit. A value that is not finite is not."""
    vx, vy, radius = discs.vx[low:high], discs.vy[low:high], slice_of(discs.radius, low, high)
    limit, one = parameters.fast, real(parameters, 1)
    fast = False
    for i in range(high - low):
        own = value_or(radius, i, one)
        fast |= vx[i] * vx[i] + vy[i] * vy[i] > limit * (own * own)
    return fast


@linked
def note_fastest(discs, low, high, parameters, mine):
    """Record the disc of a slice that is farthest beyond the limit; among equals, the one with the lowest number."""
    limit = np.float64(parameters.fast)
    for i in range(low, high):
        vx, vy, own = np.float64(discs.vx[i]), np.float64(discs.vy[i]), np.float64(value_or(discs.radius, i, 1.0))
        square = vx * vx + vy * vy
        if square > limit * own * own:
            ratio = MOST
            if square < MOST * MOST * limit * own * own:
                ratio = math.sqrt(square / (limit * own * own))
            scaled = np.int64(ratio * FASTEST_SCALE)
            if scaled > mine.fastest or (scaled == mine.fastest and discs.id[i] < mine.fastest_disc):
                mine.fastest, mine.fastest_disc = scaled, discs.id[i]


@inlined
def end_where_fast(discs, low, high, parameters, control, mine):
    """Make this frame the last of the command if a disc of the slice is too fast for the next step.

    Called by all workers before they move their slices. They all write the same number, and no worker compares with it
    before the barriers of this frame, or it sees that this frame is still to be run.
    """
    if parameters.fast < math.inf and any_fast(discs, low, high, parameters):
        note_fastest(discs, low, high, parameters, mine)
        control.frames = mine.frame + 1


# --- Motion of a slice of discs over one step: acceleration, drift, walls, and the check that the state is finite


@inlined
def drift(discs, low, high, parameters):
    """p += v dt. Returns whether all centres are then inside the limits; one that is not finite never is."""
    x, y, vx, vy = discs.x[low:high], discs.y[low:high], discs.vx[low:high], discs.vy[low:high]
    dt = parameters.dt
    x_low, x_high = parameters.limit[LEFT], parameters.limit[RIGHT]
    y_low, y_high = parameters.limit[BOTTOM], parameters.limit[TOP]
    inside = True
    for i in range(high - low):
        px = x[i] + vx[i] * dt
        py = y[i] + vy[i] * dt
        inside &= (px >= x_low) & (px <= x_high) & (py >= y_low) & (py <= y_high)
        x[i] = px
        y[i] = py
    return inside


@inlined
def bounce_off_walls(discs, low, high, parameters):
    """The wall rule, for discs that have drifted; returns True if a position or velocity is not finite.

    A disc beyond a wall and moving outward has that velocity component reversed. Its centre is clamped to
    [R, W - R] x [R, H - R] under contact `push`; under `impact` it is where the bounce, at the instant when it reached
    the wall, has brought it by now: as far inside as it would be outside. Without branches, so it becomes vector code.
    """
    x, y, vx, vy = discs.x[low:high], discs.y[low:high], discs.vx[low:high], discs.vy[low:high]
    zero = x.dtype.type(0)  # an integer 0 would turn float32 arithmetic into float64
    infinity = x.dtype.type(math.inf)
    x_low, x_high = parameters.limit[LEFT], parameters.limit[RIGHT]
    y_low, y_high = parameters.limit[BOTTOM], parameters.limit[TOP]
    bounce, restitution = parameters.wall_bounce, parameters.wall_restitution
    bad = False
    for i in range(high - low):
        ux = vx[i]
        uy = vy[i]
        px = x[i]
        py = y[i]
        vx[i] = -ux * restitution if ((px < x_low) & (ux < zero)) | ((px > x_high) & (ux > zero)) else ux
        vy[i] = -uy * restitution if ((py < y_low) & (uy < zero)) | ((py > y_high) & (uy > zero)) else uy
        px = x_low + bounce * (x_low - px) if (px < x_low) & (px > -infinity) else px
        px = x_high + bounce * (x_high - px) if (px > x_high) & (px < infinity) else px
        py = y_low + bounce * (y_low - py) if (py < y_low) & (py > -infinity) else py
        py = y_high + bounce * (y_high - py) if (py > y_high) & (py < infinity) else py
        # A bounce that leads beyond the opposite wall (a disc faster than a box per step) ends at the first one.
        px = x_low if (px < x_low) & (px > -infinity) else px
        py = y_low if (py < y_low) & (py > -infinity) else py
        px = x_high if (px > x_high) & (px < infinity) else px
        py = y_high if (py > y_high) & (py < infinity) else py
        x[i] = px
        y[i] = py
        # NaN and infinity pass the clamps and end outside; for a velocity, inf - inf = NaN equals nothing.
        inside = (px >= x_low) & (px <= x_high) & (py >= y_low) & (py <= y_high)
        bad |= not (inside & (ux - ux == zero) & (uy - uy == zero))
    return bad


@inlined
def drift_between_walls(discs, low, high, parameters):
    """p += v dt and the wall rule, for a slice; returns True if a position or velocity is not finite."""
    bad = False
    for first in range(low, high, BLOCK):
        last = min(first + BLOCK, high)
        if not drift(discs, first, last, parameters):
            bad |= bounce_off_walls(discs, first, last, parameters)
    return bad


@linked
def note_walls(discs, low, high, features, parameters, control, tally, frame):
    """Count and log a straight flight's contacts with walls: before it, as its vector code does not report them."""
    zero = real(parameters, 0)
    for i in range(low, high):
        x, y = flight_of(discs, i, zero, zero, None, features, parameters)
        count_impulses(x, y, discs.id[i], features, parameters, control, tally, frame)
        log_walls(features.log, discs, i, x, y, (zero, zero), features, parameters, control)


@inlined
def fly_straight(discs, low, high, special, features, parameters, control, tally, frame):
    """p += v dt, walls and borders; returns True if a position or velocity is not finite.

    special: None if all discs have one radius and all borders are smooth walls at rest.
    """
    if special is not None:
        return fly(discs, low, high, None, features, parameters, control, tally, frame)
    if control.tallied or features.log is not None:
        note_walls(discs, low, high, features, parameters, control, tally, frame)
    return drift_between_walls(discs, low, high, parameters)


@linked
def worst_slot(discs, low, high):
    """Slot of the non-finite disc with the lowest id in [low, high), or -1."""
    worst = -1
    for i in range(low, high):
        x, y, vx, vy = discs.x[i], discs.y[i], discs.vx[i], discs.vy[i]
        fine = (x - x == 0) & (y - y == 0) & (vx - vx == 0) & (vy - vy == 0)
        if not fine and (worst < 0 or discs.id[i] < discs.id[worst]):
            worst = i
    return worst


@inlined
def accelerate_and_fly(discs, low, high, accelerated, features, parameters, control, tally, frame):
    """Acceleration, flight and walls for a slice; returns True if a disc is not finite.

    accelerated: None if no disc is.
    """
    if accelerated is not None:  # noqa: SIM102 - see compiling.py
        if control.contact == IMPACT:
            return fly(discs, low, high, True, features, parameters, control, tally, frame)
    accelerate(discs, low, high, features.gravity, features.acceleration, parameters)
    special = any_present(discs.radius, special_borders(features))
    return fly_straight(discs, low, high, special, features, parameters, control, tally, frame)


@linked
def move_block(discs, low, high, features, parameters, control, mine, tally):
    """Advance some discs of a slice. Returns whether all of them are finite."""
    heat(features.thermostat, discs, low, high, features, control)
    end_where_fast(discs, low, high, parameters, control, mine)
    absorb(features.exits, discs, low, high, features, parameters, control)
    accelerated = any_present(features.gravity, features.acceleration)
    bad = accelerate_and_fly(discs, low, high, accelerated, features, parameters, control, tally, mine.frame)
    put_back_absorbed(features.exits, discs, low, high, features.spin)
    if not bad:
        after_move(discs, low, high, features, parameters, control, mine)
    return not bad


@linked
def note_not_finite(discs, low, high, control, mine):
    """Note which disc of a slice is not finite, and let all workers leave the frame."""
    mine.bad_slot = worst_slot(discs, low, high)
    atomic_store(control.signals, BAD, 1)


@linked
def move(discs, low, high, features, parameters, control, mine, tally):
    """Advance a slice. False: a disc is not finite, and nothing may be binned by its position."""
    finite = move_block(discs, low, high, features, parameters, control, mine, tally)
    if not finite:
        note_not_finite(discs, low, high, control, mine)
    return finite
