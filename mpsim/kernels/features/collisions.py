"""The log of collisions, if a run asks for it: what each contact records, in float64.

A contact is dated at the instant to which its law goes back, as `impact` does if it can, else at the end of the step.
Rows hold the time from then until the end of the step.
"""

import math

import numpy as np

from mpsim.kernels.collision_log import DISC, OBSTACLE, WALL, write
from mpsim.kernels.compiling import inlined, linked, value_or
from mpsim.kernels.features.absorption import is_absent
from mpsim.kernels.features.acceleration import accelerations_of
from mpsim.kernels.features.boundary import seen_from
from mpsim.kernels.records import BOTTOM, IMPACT, LEFT, RIGHT, TOP

FIELDS = {"log": None}
"""log: of `collision_log`, that of the worker whose call it is."""


@inlined
def touching_point(discs, i, j, shift_x, shift_y, since, parameters):
    """Where discs i and j touched so long ago, on straight paths (x, y): the middle of their overlap, if they did."""
    x, y = np.float64(discs.x[i]) - discs.vx[i] * since, np.float64(discs.y[i]) - discs.vy[i] * since
    rx = np.float64(discs.x[j]) - discs.vx[j] * since - seen_from(x, shift_x)
    ry = np.float64(discs.y[j]) - discs.vy[j] * since - seen_from(y, shift_y)
    half = np.float64(parameters.diameter) / 2.0
    distance = math.sqrt(rx * rx + ry * ry)
    if distance == 0.0:
        return x, y
    reach = (distance + value_or(discs.radius, i, half) - value_or(discs.radius, j, half)) / 2.0
    return x + rx / distance * reach, y + ry / distance * reach


@inlined
def between_discs(log, discs, i, j, touched, impulse, nx, ny, across):
    """Contact of discs i and j, with such an impulse along the unit vector n from i to j.

    touched: how long before the end of the step [time], and where (x, y) [length]. across: impulse on i along
    (-ny, nx).
    """
    if log is not None:
        since, x, y = touched
        along, slide = -np.float64(impulse), np.float64(across)
        write(log, DISC, discs.id[i], discs.id[j], since, along * nx, along * ny, -slide * ny, slide * nx, x, y)


@linked
def write_walls(log, discs, i, x, y, sliding, features, parameters, control):
    """`on_walls` for a disc that has hit a wall."""
    mass = np.float64(value_or(features.mass, discs.id[i], 1.0))
    ax, ay = accelerations_of(discs, i, features)
    along_x, along_y = np.float64(x.sliding + sliding[0]), np.float64(y.sliding + sliding[1])
    for edge, met, change in (
        (LEFT, x, x.low_change), (RIGHT, x, x.high_change), (BOTTOM, y, y.low_change), (TOP, y, y.high_change),
    ):  # fmt: skip
        if change > 0:
            since = np.float64(met.time if control.contact == IMPACT else met.time - met.time)
            inward = -mass * change if (edge == RIGHT) | (edge == TOP) else mass * change
            impulse_x, impulse_y = (inward, 0.0) if edge < BOTTOM else (0.0, inward)
            across_x, across_y = (0.0, mass * along_x) if edge < BOTTOM else (mass * along_y, 0.0)
            px = x.position - since * (x.velocity - 0.5 * ax * since)
            py = y.position - since * (y.velocity - 0.5 * ay * since)
            write(log, WALL, discs.id[i], edge, since, impulse_x, impulse_y, across_x, across_y, px, py)


@inlined
def on_walls(log, discs, i, x, y, sliding, features, parameters, control):
    """Contact of disc i with walls, as its motion along x and y has led it to them, two of `WallContact`.

    The coordinate normal to a wall is not that of the wall. sliding: changes of its velocity by friction, along the
    wall met along x, and along that met along y.
    """
    if log is not None:
        met = (x.low_change != x.high_change) | (y.low_change != y.high_change)
        if met and not is_absent(features.exits, discs.id[i]):
            write_walls(log, discs, i, x, y, sliding, features, parameters, control)


@inlined
def on_capsule(log, discs, i, k, nx, ny, change, sliding, time, features, parameters):
    """Contact of disc i with capsule k, so long ago, which has changed its velocity by so much along n from there.

    sliding: change of its velocity along (ny, -nx).
    """
    if log is not None:  # noqa: SIM102
        if change > 0:
            since = min(np.float64(time), np.float64(parameters.dt))
            ax, ay = accelerations_of(discs, i, features)
            radius = np.float64(value_or(discs.radius, i, parameters.diameter / 2))
            x = discs.x[i] - since * (discs.vx[i] - 0.5 * ax * since) - radius * nx
            y = discs.y[i] - since * (discs.vy[i] - 0.5 * ay * since) - radius * ny
            mass = np.float64(value_or(features.mass, discs.id[i], 1.0))
            impulse, across = mass * change, mass * sliding
            write(log, OBSTACLE, discs.id[i], k, since, impulse * nx, impulse * ny, across * ny, -across * nx, x, y)
