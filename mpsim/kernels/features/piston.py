"""A wall of the box that moves at constant speed until it stops."""

from mpsim.kernels.compiling import inlined
from mpsim.kernels.layout import DT, STEPS

FIELDS = {"moving_wall": "piston"}
"""moving_wall: shape (SIZE,), of the precision of the run, its elements as follows."""

WALL = 0  # which limit it moves: X_LOW, X_HIGH, Y_LOW or Y_HIGH
START = 1  # that limit at time 0 [length]
SPEED = 2  # [length/time]
STOP = 3  # the limit at which it rests [length]
NOW = 4  # its speed in this step: 0 once it rests [length/time]
SIZE = 5


@inlined
def before_step(moving_wall, parameters, control):
    """Put the wall where it will be at the end of the next step, which the motion of that step will meet.

    Its place follows from the number of steps done, not from its last place: no rounding adds up, and a resumed run
    agrees.
    """
    if moving_wall is not None:
        displacement = moving_wall[SPEED] * parameters[DT]
        place = moving_wall[START] + displacement * (control[STEPS] + 1)
        arrived = place < moving_wall[STOP] if moving_wall[SPEED] < 0 else place > moving_wall[STOP]
        parameters[int(moving_wall[WALL])] = moving_wall[STOP] if arrived else place
        moving_wall[NOW] = moving_wall[SPEED] * 0 if arrived else moving_wall[SPEED]


@inlined
def wall_speed(moving_wall, limit, zero):
    """Speed of the wall that sets a limit (X_LOW, ...)."""
    if moving_wall is None:
        return zero
    return moving_wall[NOW] if int(moving_wall[WALL]) == limit else zero


@inlined
def wall_place(moving_wall, limit, parameters):
    """Where the wall of a limit is when contacts are resolved: a piston's limit is that of the next step already."""
    if moving_wall is None:
        return parameters[limit]
    return parameters[limit] - wall_speed(moving_wall, limit, parameters.dtype.type(0)) * parameters[DT]
