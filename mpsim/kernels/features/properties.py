"""What discs have one each: masses, radii (and giants), accelerations; and gravity."""

import numpy as np

from mpsim.kernels.compiling import inlined

# --- Discs of different radii, and giants: discs so large that the grid, whose cells fit the others, omits them


@inlined
def touching_distance(radius, i, j, parameters):
    """Distance at which the discs in slots i and j touch."""
    if radius is None:
        return parameters.diameter
    return radius[i] + radius[j]


@inlined
def after_binning(giants, discs, low, high, control):
    """Bin the giants of a slice in a cell of their own, beyond the grid."""
    if giants is not None:
        cell = (control.columns + 1) * (control.rows + 2)
        for i in range(low, high):
            if discs.radius[i] > giants[0]:
                discs.cell[i] = cell


# --- Accelerations: gravity, the same for all discs, and individual ones


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


# --- Discs of different masses


@inlined
def mass_fraction(mass, disc, other, one):
    """2 m' / (m + m'): the share of `disc` in a change divided between a pair, 1 for equal masses (m' is the other's).

    In float64: rounded to float32, the same two fractions would miss the energy by as much at each collision of a pair.
    """
    if mass is None:
        return one
    return 2.0 * np.float64(mass[other]) / (np.float64(mass[disc]) + np.float64(mass[other]))
