"""Accelerations: gravity, the same for all discs, and individual ones."""

from mpsim.kernels.compiling import inlined

FIELDS = {"gravity": "gravity", "acceleration": "acceleration"}
"""gravity: (gx, gy), acceleration: shape (2, capacity), by id [length/time^2]."""


@inlined
def acceleration_of(gravity, acceleration, axis, disc, zero):
    """Acceleration of a disc along an axis, from whatever the scene has."""
    total = zero
    if gravity is not None:
        total += gravity[axis]
    if acceleration is not None:
        total += acceleration[axis, disc]
    return total


@inlined
def accelerations_of(discs, i, features):
    """Acceleration of the disc in slot i along x and along y, from whatever the scene has."""
    disc, zero = discs.id[i], discs.x.dtype.type(0)
    ax = acceleration_of(features.gravity, features.acceleration, 0, disc, zero)
    return ax, acceleration_of(features.gravity, features.acceleration, 1, disc, zero)


@inlined
def accelerate(discs, low, high, gravity, acceleration, parameters):
    """v += a dt, with one acceleration for all discs, one per disc, or both. None compiles to nothing."""
    if gravity is not None:
        vx, vy = discs.vx[low:high], discs.vy[low:high]
        kick_x, kick_y = gravity[0] * parameters.dt, gravity[1] * parameters.dt
        for i in range(high - low):
            vx[i] += kick_x
            vy[i] += kick_y
    if acceleration is not None:
        for i in range(low, high):
            discs.vx[i] += acceleration[0, discs.id[i]] * parameters.dt
            discs.vy[i] += acceleration[1, discs.id[i]] * parameters.dt
