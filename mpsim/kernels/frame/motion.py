"""Motion of a slice of discs over one step: acceleration, drift, walls, and the check that the state is finite."""

import math

import numpy as np

from mpsim.kernels.compiling import compiled, inlined
from mpsim.kernels.features.acceleration import accelerate
from mpsim.kernels.features.hooks import (
    after_flight,
    after_move,
    before_move,
    between_disc_and_walls,
    is_absent,
    special_borders,
    wall_speed,
)
from mpsim.kernels.features.images import count_flight, wrapped
from mpsim.kernels.frame.parabolas import accelerated_motion
from mpsim.kernels.frame.speed_limit import end_where_fast
from mpsim.kernels.frame.wall_free import BLOCK, wall_free_motion
from mpsim.kernels.frame.walls import reach_wall
from mpsim.kernels.layout import ALONG_X, ALONG_Y, BAD, BOTTOM, IMPACT, LEFT, RIGHT, TOP
from mpsim.kernels.machine import atomic_store
from mpsim.kernels.optional import any_present, value_or
from mpsim.kernels.records import real


@inlined
def drift_between_walls(discs, low, high, parameters):
    """p += v dt and the wall rule; returns True if a position or velocity is not finite.

    A disc beyond a wall and moving outward has that velocity component turned round. Its centre is clamped to
    [R, W - R] x [R, H - R] under contact `push`; under `impact` it is where the bounce, at the instant when it reached
    the wall, has brought it by now: as far inside as it would be outside. Without branches, so it becomes vector code.
    """
    x, y, vx, vy = discs.x[low:high], discs.y[low:high], discs.vx[low:high], discs.vy[low:high]
    zero = x.dtype.type(0)  # an integer 0 would turn float32 arithmetic into float64
    infinity = x.dtype.type(math.inf)
    dt = parameters.dt
    x_low, x_high = parameters.limit[LEFT], parameters.limit[RIGHT]
    y_low, y_high = parameters.limit[BOTTOM], parameters.limit[TOP]
    bounce, restitution = parameters.wall_bounce, parameters.wall_restitution
    bad = False
    for i in range(high - low):
        ux = vx[i]
        uy = vy[i]
        px = x[i] + ux * dt
        py = y[i] + uy * dt
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
def along_axis(p, v, edges, margin, wrap, moving_wall, parameters):
    """One step along the axis with these edges: through a periodic border, or up to the walls and back.

    Place and velocity after it, and the time since a wall has turned the disc round [time].
    """
    zero = real(parameters, 0)
    p = wrapped(p, wrap) + v * parameters.dt
    if wrap is not None:
        return wrapped(p, wrap), v, zero
    low, high = parameters.limit[edges[0]] + margin, parameters.limit[edges[1]] - margin
    speeds = wall_speed(moving_wall, edges[0], zero), wall_speed(moving_wall, edges[1], zero)
    if p - p != zero:  # not finite: found out by the caller
        return p, v, zero
    return reach_wall(p, v, low, high, *speeds, parameters.wall_bounce, parameters.wall_restitution)


@compiled
def general_drift(discs, low, high, features, parameters, control):
    """`drift` with radii, periodic axes, rough walls or one that moves; True if a place or speed is not finite."""
    zero = discs.x.dtype.type(0)
    bad = False
    for first in range(low, high, BLOCK):
        last = min(first + BLOCK, high)
        if wall_free_motion(discs, first, last, None, None, None, None, parameters):
            continue
        for i in range(first, last):
            margin = value_or(discs.radius, i, zero)
            x, vx, time_x = along_axis(
                discs.x[i], discs.vx[i], ALONG_X, margin, features.wrap_x, features.moving_wall, parameters
            )
            y, vy, time_y = along_axis(
                discs.y[i], discs.vy[i], ALONG_Y, margin, features.wrap_y, features.moving_wall, parameters
            )
            count_flight(discs, i, x, y, vx * parameters.dt, vy * parameters.dt, features)
            change_x, change_y = vx - discs.vx[i], vy - discs.vy[i]
            discs.x[i], discs.y[i], discs.vx[i], discs.vy[i] = x, y, vx, vy
            between_disc_and_walls(
                features.wall_friction,
                discs,
                i,
                change_x,
                change_y,
                time_x,
                time_y,
                True,
                features,
                parameters,
                control,
            )
            bad |= not ((x - x == zero) & (y - y == zero) & (vx - vx == zero) & (vy - vy == zero))
    return bad


@inlined
def drift(discs, low, high, special, features, parameters, control):
    """p += v dt, walls and borders; returns True if a position or velocity is not finite.

    special: None where all discs have one radius and all borders are smooth walls at rest.
    """
    if special is None:
        return drift_between_walls(discs, low, high, parameters)
    return general_drift(discs, low, high, features, parameters, control)


@compiled
def tally_walls(discs, low, high, features, parameters, tally, frame):
    """Add up the impulses on the walls when this slice drifts: m (1 + e) |v| of each disc that they turn round."""
    dt, scale = parameters.dt, np.float64(parameters.tally_scale)
    zero, one = discs.x.dtype.type(0), discs.x.dtype.type(1)
    walls_x, walls_y = features.wrap_x is None, features.wrap_y is None
    for i in range(low, high):
        if is_absent(features.exits, discs.id[i]):
            continue
        margin = value_or(discs.radius, i, zero)
        gain = (1 + parameters.wall_restitution) * value_or(features.mass, discs.id[i], one)
        ux, uy = discs.vx[i], discs.vy[i]
        px = discs.x[i] + ux * dt
        py = discs.y[i] + uy * dt
        for (low_edge, high_edge), p, u, walls in ((ALONG_X, px, ux, walls_x), (ALONG_Y, py, uy, walls_y)):
            slow = u - wall_speed(features.moving_wall, low_edge, zero)
            fast = u - wall_speed(features.moving_wall, high_edge, zero)
            if walls and p < parameters.limit[low_edge] + margin and slow < 0:
                tally[frame].wall[low_edge] -= np.int64(gain * slow * scale)
            if walls and p > parameters.limit[high_edge] - margin and fast > 0:
                tally[frame].wall[high_edge] += np.int64(gain * fast * scale)


@compiled
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
def flight(discs, low, high, accelerated, features, parameters, control, tally, frame):
    """Acceleration, flight and walls for a slice; returns True if a disc is not finite.

    accelerated: None where no disc is.
    """
    if accelerated is not None:  # noqa: SIM102 - a test of its own, which the compiler drops
        if control.contact == IMPACT:
            return accelerated_motion(discs, low, high, features, parameters, control, tally, frame)
    accelerate(discs, low, high, features.gravity, features.acceleration, parameters)
    if tally is not None:
        tally_walls(discs, low, high, features, parameters, tally, frame)
    special = any_present(discs.radius, special_borders(features))
    return drift(discs, low, high, special, features, parameters, control)


@compiled
def move(discs, low, high, features, parameters, control, mine, tally):
    """Advance a slice. False: a disc is not finite, and nothing may be binned by its position."""
    end_where_fast(discs, low, high, parameters, control, mine)
    before_move(discs, low, high, features, parameters, control)
    accelerated = any_present(features.gravity, features.acceleration)
    bad = flight(discs, low, high, accelerated, features, parameters, control, tally, mine.frame)
    after_flight(discs, low, high, features)
    if bad:
        mine.bad_slot = worst_slot(discs, low, high)
        atomic_store(control.signals, BAD, 1)
        return False
    after_move(discs, low, high, features, parameters, control)
    return True
