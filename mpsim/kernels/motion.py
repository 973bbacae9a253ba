"""Motion of a slice of discs over one step: acceleration, drift, walls, and the check that the state is finite."""

import math

import numpy as np

from mpsim.kernels.compiling import compiled
from mpsim.kernels.layout import (
    BAD,
    BAD_SLOT,
    DT,
    FRAME,
    TALLY_SCALE,
    WALL_BOUNCE,
    WALL_RESTITUTION,
    WALL_X,
    WALL_Y,
    X_HIGH,
    X_LOW,
    Y_HIGH,
    Y_LOW,
)
from mpsim.kernels.machine import atomic_store


@compiled
def accelerate(discs, low, high, gravity, acceleration, parameters):
    """v += a dt, for what the scene has: one acceleration for all, one per disc, or both. None compiles to nothing."""
    if gravity is not None:
        vx, vy = discs.vx[low:high], discs.vy[low:high]
        kick_x, kick_y = gravity[0] * parameters[DT], gravity[1] * parameters[DT]
        for i in range(high - low):
            vx[i] += kick_x
            vy[i] += kick_y
    if acceleration is not None:
        for i in range(low, high):
            discs.vx[i] += acceleration[0, discs.id[i]] * parameters[DT]
            discs.vy[i] += acceleration[1, discs.id[i]] * parameters[DT]


@compiled
def drift(discs, low, high, parameters):
    """p += v dt and the wall rule; returns True if a position or velocity is not finite.

    A disc beyond a wall and moving outward has that velocity component turned round. Its centre is clamped to
    [R, W - R] x [R, H - R] under contact `push`; under `impact` it is where the bounce, at the instant when it reached
    the wall, has brought it by now: as far inside as it would be outside. Without branches, so it becomes vector code.
    """
    x, y, vx, vy = discs.x[low:high], discs.y[low:high], discs.vx[low:high], discs.vy[low:high]
    zero = x.dtype.type(0)  # an integer 0 would turn float32 arithmetic into float64
    infinity = x.dtype.type(math.inf)
    dt = parameters[DT]
    x_low, x_high, y_low, y_high = parameters[X_LOW], parameters[X_HIGH], parameters[Y_LOW], parameters[Y_HIGH]
    bounce, restitution = parameters[WALL_BOUNCE], parameters[WALL_RESTITUTION]
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


@compiled
def tally_walls(discs, low, high, parameters, tally, frame):
    """Add up the impulses on the walls when this slice drifts: (1 + e) |v| of each disc that they turn round."""
    dt, scale = parameters[DT], np.float64(parameters[TALLY_SCALE])
    gain = 1 + parameters[WALL_RESTITUTION]
    for i in range(low, high):
        ux, uy = discs.vx[i], discs.vy[i]
        px = discs.x[i] + ux * dt
        py = discs.y[i] + uy * dt
        if ((px < parameters[X_LOW]) & (ux < 0)) | ((px > parameters[X_HIGH]) & (ux > 0)):
            tally[frame, WALL_X] += np.int64(gain * abs(ux) * scale)
        if ((py < parameters[Y_LOW]) & (uy < 0)) | ((py > parameters[Y_HIGH]) & (uy > 0)):
            tally[frame, WALL_Y] += np.int64(gain * abs(uy) * scale)


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


@compiled
def move(discs, low, high, gravity, acceleration, parameters, control, mine, tally):
    """Advance a slice. False: a disc is not finite, and nothing may be binned by its position."""
    accelerate(discs, low, high, gravity, acceleration, parameters)
    if tally is not None:
        tally_walls(discs, low, high, parameters, tally, mine[FRAME])
    if drift(discs, low, high, parameters):
        mine[BAD_SLOT] = worst_slot(discs, low, high)
        atomic_store(control, BAD, 1)
        return False
    return True
