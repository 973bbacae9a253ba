"""A wall of the box that moves at constant speed until it stops."""

from mpsim.kernels.compiling import inlined
from mpsim.kernels.records import real

FIELDS = {"moving_wall": "piston"}
"""moving_wall: shape (SIZE,), of the precision of the run, its elements as follows."""

WALL = 0  # which edge it is: LEFT, RIGHT, BOTTOM or TOP
START = 1  # the limit of that edge at time 0 [length]
SPEED = 2  # [length/time]
STOP = 3  # the limit at which it rests [length]
NOW = 4  # its speed in this step: 0 once it rests [length/time]
SIZE = 5


@inlined
def prepare_next_step(moving_wall, parameters, control):
    """Put the wall where it will be at the end of the next step: the motion of that step meets it there.

    Its place follows from the number of steps done, not from its last place, so rounding does not accumulate and a
    resumed run agrees.
    """
    if moving_wall is not None:
        displacement = moving_wall[SPEED] * parameters.dt
        place = moving_wall[START] + displacement * (control.steps + 1)
        arrived = place < moving_wall[STOP] if moving_wall[SPEED] < 0 else place > moving_wall[STOP]
        parameters.limit[int(moving_wall[WALL])] = moving_wall[STOP] if arrived else place
        moving_wall[NOW] = moving_wall[SPEED] * 0 if arrived else moving_wall[SPEED]


@inlined
def wall_speed(moving_wall, edge, parameters):
    """Speed of the wall at an edge (LEFT, ...)."""
    if moving_wall is None:
        return real(parameters, 0)
    return moving_wall[NOW] if int(moving_wall[WALL]) == edge else real(parameters, 0)


@inlined
def wall_place(moving_wall, edge, parameters):
    """Position of the limit of an edge while contacts are resolved: `limit` already has a piston's next one."""
    if moving_wall is None:
        return parameters.limit[edge]
    return parameters.limit[edge] - wall_speed(moving_wall, edge, parameters) * parameters.dt
