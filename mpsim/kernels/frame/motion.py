"""Motion of a slice of discs over one step: acceleration, drift, walls, and the check that the state is finite."""

import math

from mpsim.kernels.compiling import inlined, linked
from mpsim.kernels.features.acceleration import accelerate
from mpsim.kernels.features.collisions import on_walls
from mpsim.kernels.features.hooks import after_flight, after_move, before_move, begin_step, special_borders
from mpsim.kernels.frame.flight import BLOCK, flight_of, fly
from mpsim.kernels.frame.speed_limit import end_where_fast
from mpsim.kernels.frame.walls import count_impulses
from mpsim.kernels.layout import BAD, BOTTOM, IMPACT, LEFT, RIGHT, TOP
from mpsim.kernels.machine import atomic_store
from mpsim.kernels.optional import any_present
from mpsim.kernels.records import real


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
def tally_walls(discs, low, high, features, parameters, control, tally, frame):
    """Count the impulses on the walls of a straight flight; done before it, as its vector code does not report them."""
    zero = real(parameters, 0)
    for i in range(low, high):
        x, y = flight_of(discs, i, zero, zero, None, features, parameters)
        count_impulses(x, y, discs.id[i], features, parameters, control, tally, frame)


@inlined
def log_walls(log, discs, low, high, features, parameters, control):
    """Log the contacts with walls of a straight flight; done before it, for the same reason."""
    if log is not None:
        zero = real(parameters, 0)
        for i in range(low, high):
            x, y = flight_of(discs, i, zero, zero, None, features, parameters)
            on_walls(log, discs, i, x, y, (zero, zero), features, parameters, control)


@inlined
def fly_straight(discs, low, high, special, features, parameters, control, tally, frame):
    """p += v dt, walls and borders; returns True if a position or velocity is not finite.

    special: None if all discs have one radius and all borders are smooth walls at rest.
    """
    if special is not None:
        return fly(discs, low, high, None, features, parameters, control, tally, frame)
    if control.tallied:
        tally_walls(discs, low, high, features, parameters, control, tally, frame)
    log_walls(features.log, discs, low, high, features, parameters, control)
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
    if accelerated is not None:  # noqa: SIM102 - see optional.py
        if control.contact == IMPACT:
            return fly(discs, low, high, True, features, parameters, control, tally, frame)
    accelerate(discs, low, high, features.gravity, features.acceleration, parameters)
    special = any_present(discs.radius, special_borders(features))
    return fly_straight(discs, low, high, special, features, parameters, control, tally, frame)


@linked
def move_block(discs, low, high, features, parameters, control, mine, tally):
    """Advance some discs of a slice. Returns whether all of them are finite."""
    begin_step(discs, low, high, features, control)
    end_where_fast(discs, low, high, parameters, control, mine)
    before_move(discs, low, high, features, parameters, control)
    accelerated = any_present(features.gravity, features.acceleration)
    bad = accelerate_and_fly(discs, low, high, accelerated, features, parameters, control, tally, mine.frame)
    after_flight(discs, low, high, features)
    if not bad:
        after_move(discs, low, high, features, parameters, control)
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
