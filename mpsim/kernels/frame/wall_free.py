"""Blocks of discs that meet neither wall nor border in a step: most of them, and vector code."""

from mpsim.kernels.compiling import inlined
from mpsim.kernels.layout import BOTTOM, LEFT, RIGHT, TOP
from mpsim.kernels.optional import slice_of, value_or
from mpsim.kernels.records import real

BLOCK = 64
"""Discs that are looked at together."""


@inlined
def kicked(v, kick):
    """A velocity after the acceleration of a step, if the scene has any."""
    if kick is None:
        return v
    return v + kick


@inlined
def mean_velocity(v, half_kick):
    """The mean velocity of a step that ends with v."""
    if half_kick is None:
        return v
    return v - half_kick


@inlined
def wall_free_motion(discs, low, high, kick_x, kick_y, half_x, half_y, parameters):
    """Advance a block of discs in free flight, unless one starts or ends beyond a limit. Returns whether it did.

    kick: change of each velocity component in the step, half: half of it; None without acceleration. What is not finite
    compares as beyond, so it is found by whoever looks at the discs one by one.
    """
    zero, dt = real(parameters, 0), parameters.dt
    x, y, vx, vy = discs.x[low:high], discs.y[low:high], discs.vx[low:high], discs.vy[low:high]
    radius = slice_of(discs.radius, low, high)
    x_low, x_high = parameters.limit[LEFT], parameters.limit[RIGHT]
    y_low, y_high = parameters.limit[BOTTOM], parameters.limit[TOP]
    free = True
    for i in range(high - low):
        margin = value_or(radius, i, zero)
        px = x[i] + mean_velocity(kicked(vx[i], kick_x), half_x) * dt
        py = y[i] + mean_velocity(kicked(vy[i], kick_y), half_y) * dt
        inside_x = (px >= x_low + margin) & (px < x_high - margin) & (x[i] >= x_low) & (x[i] < x_high)
        inside_y = (py >= y_low + margin) & (py < y_high - margin) & (y[i] >= y_low) & (y[i] < y_high)
        free &= inside_x & inside_y
    if free:
        for i in range(high - low):
            vx[i] = kicked(vx[i], kick_x)
            vy[i] = kicked(vy[i], kick_y)
            x[i] += mean_velocity(vx[i], half_x) * dt
            y[i] += mean_velocity(vy[i], half_y) * dt
    return free
