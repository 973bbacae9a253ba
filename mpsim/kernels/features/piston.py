"""Walls of the box that move: pistons. Where one is, and how fast, follows from the time alone, in float64."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike

from mpsim.kernels.compiling import inlined, linked
from mpsim.kernels.features.bodies import MOTION, OSCILLATION, pose_at, velocity_at
from mpsim.kernels.records import IMPACT, real, record_of


def moving_wall_in(precision: DTypeLike) -> np.dtype[Any]:
    """The record of a wall: in float64, but for what the motion of discs reads, of the precision of the run."""
    return record_of(
        [
            *MOTION,
            ("moves", np.int64),  # 0: it is at rest where the box ends
            ("home", np.float64),  # coordinate without displacement [length]
            ("end", np.float64),  # where it stops [length]
            ("low", np.float64),  # least and largest coordinate that it ever has [length]
            ("high", np.float64),
            ("margin", np.float64),  # from the wall to the limit of centres, along its axis [length]
            ("limit", precision),  # of centres while contacts are resolved; `parameters` has that of the next step
            # In the next step; under contact `impact` at its end, where the acceleration is not 0.
            ("velocity", precision),
            ("acceleration", precision),
        ]
    )


class MovingWalls(NamedTuple):
    """The walls of the box: of `moving_wall_in`, by edge, shape (4,); `knots` as of `Bodies`."""

    wall: Any
    knots: Any


FIELDS = {"moving_wall": MovingWalls}


@linked
def place(wall, knots, time):
    """Coordinate of a wall at a time of the run [length]."""
    if time - wall.start >= wall.stop:
        return wall.end
    pose = pose_at(wall, knots, time)
    return min(max(wall.home + (pose.x + pose.y), wall.low), wall.high)  # one of them is 0


@linked
def velocity(wall, knots, time):
    """Velocity of a wall along its axis [length/time]."""
    vx, vy = velocity_at(wall, knots, time, 0.0, 0.0)
    return vx + vy


@inlined
def acceleration(wall, knots, time):
    """Acceleration of a wall along its axis, jumps apart [length/time^2]."""
    if wall.kind != OSCILLATION or time < wall.start:
        return 0.0
    pose, rate = pose_at(wall, knots, time), 2.0 * math.pi * wall.rate
    return -rate * rate * (pose.x + pose.y)


@linked
def move_walls(moving_wall, parameters, control):
    """Put the walls where they will be at the end of the next step: the motion of that step meets them there.

    `limit` then is where they are now. At the end of a frame, the time has the bits of `Solver.time`.
    """
    for edge in range(4):
        wall = moving_wall.wall[edge]
        if wall.moves == 0:
            wall.limit = parameters.limit[edge]
            continue
        now = wall.origin + control.steps / control.substeps * wall.dt
        later = wall.origin + (control.steps + 1) / control.substeps * wall.dt
        wall.limit = place(wall, moving_wall.knots, now) + wall.margin
        parameters.limit[edge] = place(wall, moving_wall.knots, later) + wall.margin
        bent = acceleration(wall, moving_wall.knots, later) if control.contact == IMPACT else 0.0
        wall.acceleration = bent
        wall.velocity = velocity(wall, moving_wall.knots, later if bent != 0.0 else 0.5 * (now + later))


@inlined
def prepare_next_step(moving_wall, parameters, control):
    """`move_walls`, if one moves."""
    if moving_wall is not None:
        move_walls(moving_wall, parameters, control)


@inlined
def wall_motion(moving_wall, edge, parameters):
    """Speed and acceleration of the wall at an edge (LEFT, ...)."""
    if moving_wall is None:
        return real(parameters, 0), real(parameters, 0)
    return moving_wall.wall[edge].velocity, moving_wall.wall[edge].acceleration


@inlined
def wall_place(moving_wall, edge, parameters):
    """Position of the limit of an edge while contacts are resolved: `limit` of parameters already has the next one."""
    if moving_wall is None:
        return parameters.limit[edge]
    return moving_wall.wall[edge].limit
