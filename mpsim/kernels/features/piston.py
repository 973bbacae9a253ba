"""A wall of the box that moves at constant speed until it stops."""

from mpsim.kernels import geometry as motion
from mpsim.kernels.compiling import inlined
from mpsim.kernels.records import real

FIELDS = {"moving_wall": "piston"}
"""moving_wall: the record `moving_wall_in` of the precision of the run."""


@inlined
def time_since_it_began(moving_wall, steps, control):
    """At the end of so many steps since the origin [time]. At the end of a frame it has the bits of `Solver.time`."""
    return moving_wall.origin + steps / control.substeps * moving_wall.dt - moving_wall.began


@inlined
def prepare_next_step(moving_wall, parameters, control):
    """Put the wall where it will be at the end of the next step: the motion of that step meets it there.

    Its place follows from the time, in float64 whatever the precision of the run.
    """
    if moving_wall is not None:
        now = time_since_it_began(moving_wall, control.steps, control)
        later = time_since_it_began(moving_wall, control.steps + 1, control)
        moving_wall.limit = motion.place(moving_wall, now) + moving_wall.margin
        moving_wall.velocity = motion.velocity(moving_wall, 0.5 * (now + later))
        parameters.limit[moving_wall.edge] = motion.place(moving_wall, later) + moving_wall.margin


@inlined
def wall_speed(moving_wall, edge, parameters):
    """Speed of the wall at an edge (LEFT, ...)."""
    if moving_wall is None:
        return real(parameters, 0)
    return moving_wall.velocity if moving_wall.edge == edge else real(parameters, 0)


@inlined
def wall_place(moving_wall, edge, parameters):
    """Position of the limit of an edge while contacts are resolved: `limit` already has a piston's next one."""
    if moving_wall is None:
        return parameters.limit[edge]
    return moving_wall.limit if moving_wall.edge == edge else parameters.limit[edge]
