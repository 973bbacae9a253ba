"""What a scene may lack, looked up in one line. For each of these None means "as if it were not there".

Numba compiles a function anew for a None argument and drops what is tested against it, so each accessor is the value
itself, a constant, or nothing at all.
"""

import numpy as np

from mpsim.kernels.compiling import inlined
from mpsim.kernels.layout import ABSORBING, DIAMETER, DT, PISTON_NOW, PISTON_WALL, X_LOW


@inlined
def own_or(values, i, shared):
    """A disc's own radius or mass, or what stands for it where all discs have the same."""
    if values is None:
        return shared
    return values[i]


@inlined
def share(mass, disc, other, one):
    """2 m' / (m + m'): the part that `disc` takes of what a pair divides, 1 for equal masses (m' is the other's).

    In float64: rounded to float32, the same two parts would miss the energy by as much at each collision of a pair.
    """
    if mass is None:
        return one
    return 2.0 * np.float64(mass[other]) / (np.float64(mass[disc]) + np.float64(mass[other]))


@inlined
def touching_distance(radius, i, j, parameters):
    """Distance at which the discs in slots i and j touch."""
    if radius is None:
        return parameters[DIAMETER]
    return radius[i] + radius[j]


@inlined
def seen_from(coordinate, image):
    """A coordinate as seen by discs on the other side of a periodic border, `image` being the length to go back."""
    if image is None:
        return coordinate
    return coordinate - image


@inlined
def confined(coordinate, low, high, margin, wrap):
    """A coordinate kept between walls; along a periodic axis it is left alone until the next step begins."""
    if wrap is None:
        return min(max(coordinate, low + margin), high - margin)
    return coordinate


@inlined
def wrapped(coordinate, wrap):
    """A coordinate brought into [0, length) along a periodic axis. Doing it twice changes nothing."""
    if wrap is None:
        return coordinate
    coordinate -= wrap[0] * np.floor(coordinate / wrap[0])
    # Just below 0 the sum rounds to the length itself, and a flight of many lengths leaves rounding of either sign.
    if (coordinate < 0) | (coordinate >= wrap[0]):
        return wrap[0] - wrap[0]
    return coordinate


@inlined
def pull_on(gravity, acceleration, axis, disc, zero):
    """Acceleration of a disc along an axis, whatever the scene has of it."""
    pull = zero
    if gravity is not None:
        pull += gravity[axis]
    if acceleration is not None:
        pull += acceleration[axis, disc]
    return pull


@inlined
def has_any(gravity, acceleration):
    """Whether discs are accelerated in this scene: a constant to the compiler."""
    if gravity is None:
        return acceleration is not None
    return True


@inlined
def wall_speed(piston, limit, zero):
    """Speed of the wall that sets a limit (X_LOW, ...); only a piston has one."""
    if piston is None:
        return zero
    return piston[PISTON_NOW] if int(piston[PISTON_WALL]) == limit else zero


@inlined
def wall_place(piston, limit, parameters):
    """Where the wall of a limit is when contacts are resolved: a piston's limit is that of the next step already."""
    if piston is None:
        return parameters[limit]
    return parameters[limit] - wall_speed(piston, limit, parameters.dtype.type(0)) * parameters[DT]


@inlined
def absorbs(exits, control, limit):
    """Whether the edge of a limit absorbs discs."""
    if exits is None:
        return False
    return (control[ABSORBING] >> (limit - X_LOW)) & 1 != 0
