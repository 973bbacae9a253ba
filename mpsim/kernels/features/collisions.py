"""What contacts do besides: they record collisions, if a run asks for them, and the work of surfaces and baths."""

import math
from collections import namedtuple
from collections.abc import Mapping
from typing import Any

import numpy as np

from mpsim.kernels.compiling import inlined, linked, value_or
from mpsim.kernels.features import friction
from mpsim.kernels.features.edges import is_absent, seen_from
from mpsim.kernels.features.properties import accelerations_of
from mpsim.kernels.records import BOTTOM, IMPACT, LEFT, RIGHT, TOP, record_of

# --- The log of collisions, if a run asks for it: rows that kernels write
#
# Each worker has a log of its own. Without a request the log is None, and code that would write to it compiles to
# nothing. A row that does not fit is still counted, which shows that a log was too small.

COLLISION = record_of(
    [
        ("span", np.int64),  # exact solver: the frame, counted from the start; others: the step, from 1 in each command
        ("time", np.float64),  # exact solver: since the start; others: from then until the end of the step [time]
        ("impulse", np.float64, (2,)),  # along the normal, on disc i [mass length/time]
        ("tangential_impulse", np.float64, (2,)),  # across it, on disc i [mass length/time]
        ("place", np.float64, (2,)),  # where they touch [length]
        ("i", np.int32),  # a disc
        ("j", np.int32),  # what it met: another disc, an edge of the box, or an obstacle
        ("kind", np.int64),  # DISC, WALL or OBSTACLE
    ]
)
"""A row of the log."""

DISC, WALL, OBSTACLE = range(3)

COUNT = 0  # rows, including those that did not fit
AGREED = 1  # of these, rows that will not be taken back
SPAN = 2  # the current frame or step
STATE_SIZE = 16  # so that two workers never write to the same pair of cache lines

Log: Any = namedtuple("Log", "rows state")
"""rows: COLLISION, shape (room,); state: int64, shape (STATE_SIZE,)."""

ROWS, STATE = "collisions", "collision_counts"
"""Names of the arrays of all workers, shapes (workers, room) and (workers, STATE_SIZE)."""


def log_of(arrays: Mapping[str, Any], worker: int) -> Any:
    """The log of one worker, from arrays by name; None if there is none."""
    return Log(arrays[ROWS][worker], arrays[STATE][worker]) if ROWS in arrays else None


@inlined
def write(log, kind, i, j, time, impulse_x, impulse_y, across_x, across_y, place_x, place_y):
    """Write a collision; a contact without an impulse along the normal is not one."""
    if log is not None:  # noqa: SIM102 - see compiling.py
        if (impulse_x != 0.0) | (impulse_y != 0.0):
            k = log.state[COUNT]
            if k < log.rows.size:
                row = log.rows[k]
                row.span, row.time, row.kind, row.i, row.j = log.state[SPAN], time, kind, i, j
                row.impulse[0], row.impulse[1] = impulse_x, impulse_y
                row.tangential_impulse[0], row.tangential_impulse[1] = across_x + 0.0, across_y + 0.0  # not -0.0
                row.place[0], row.place[1] = place_x, place_y
            log.state[COUNT] = k + 1


@inlined
def begin_span(log, span):
    """Later rows belong to this frame or step."""
    if log is not None:
        log.state[SPAN] = span


@inlined
def next_span(log):
    """The next step begins."""
    if log is not None:
        log.state[SPAN] += 1


@inlined
def is_full(log):
    """Whether the next row would not fit."""
    if log is None:
        return False
    return log.state[COUNT] >= log.rows.size


@inlined
def overflows(log):
    """Whether a row did not fit."""
    if log is None:
        return False
    return log.state[COUNT] > log.rows.size


# --- Work of surfaces that move: the impulse on a disc times the velocity of the surface's material where they touch
#
# Sums in fixed point: a number is split into whole units and 2^-32 of one, so that sums are the same in any order.

BATH, FIRST_OBSTACLE = 4, 5
"""Owners of sums: the walls of the box by edge (LEFT, ...), the thermostat, and then the obstacles of the scene."""

NEW = 0  # in a sum, what may still be taken back; AGREED: what stays

PART_BITS = 32
PARTS = np.int64(1) << PART_BITS
MASK = PARTS - 1

Work: Any = namedtuple("Work", "sum unit")
"""sum: of one worker, int64, shape (2, 2, owners): NEW and AGREED, whole units and parts. unit: a power of two, shape
(1,) [mass length^2/time^2]."""

SUM, UNIT = "work_done", "work_unit"
"""Names of the arrays, with the sums of all workers, shape (workers, 2, 2, owners)."""


def work_of(arrays: Mapping[str, Any], worker: int) -> Any:
    """The `Work` of one worker, from arrays by name; None if nothing moves or heats."""
    return Work(arrays[SUM][worker], arrays[UNIT]) if SUM in arrays else None


@inlined
def add_units(work, which, owner, whole, parts):
    """Add so many units and parts to a sum."""
    parts += work.sum[which, 1, owner]
    work.sum[which, 0, owner] += whole + (parts >> PART_BITS)
    work.sum[which, 1, owner] = parts & MASK


@inlined
def add_work(work, owner, disc, power, mass):
    """Add the work of a contact with a disc of this id; power: change of its velocity times that of the surface."""
    if work is not None:
        energy = np.float64(power) * np.float64(value_or(mass, disc, 1.0))
        if energy != 0.0:
            scaled = energy / work.unit[0]
            whole = math.floor(scaled)
            add_units(work, NEW, owner, np.int64(whole), np.int64((scaled - whole) * PARTS))


@inlined
def add_heat(work, owner, disc, before, after, mass):
    """Add the energy that a bath gives to a disc of this id, whose velocity it changes from (x, y) to another."""
    if work is not None:
        ended = np.float64(after[0]) * np.float64(after[0]) + np.float64(after[1]) * np.float64(after[1])
        began = np.float64(before[0]) * np.float64(before[0]) + np.float64(before[1]) * np.float64(before[1])
        add_work(work, owner, disc, (ended - began) / 2.0, mass)


# --- What tiles of the exact solver record may be taken back, if they do not agree


@inlined
def agree(log, work):
    """Keep the rows and the work so far: `take_back` does not remove them."""
    if log is not None:
        log.state[AGREED] = log.state[COUNT]
    if work is not None:
        for owner in range(work.sum.shape[2]):
            add_units(work, AGREED, owner, work.sum[NEW, 0, owner], work.sum[NEW, 1, owner])
            work.sum[NEW, 0, owner] = work.sum[NEW, 1, owner] = 0


@inlined
def take_back(log, work):
    """Forget what was recorded since `agree`."""
    if log is not None:
        log.state[COUNT] = log.state[AGREED]
    if work is not None:
        work.sum[NEW] = 0


# --- The log of collisions, if a run asks for it: what each contact records, in float64
#
# A contact is dated at the instant to which its law goes back, as `impact` does if it can, else at the end of the
# step. Rows hold the time from then until the end of the step.


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
def log_discs(log, discs, i, j, touched, impulse, nx, ny, across):
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
    """`log_walls` for a disc that has hit a wall."""
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
def log_walls(log, discs, i, x, y, sliding, features, parameters, control):
    """Contact of disc i with walls, as its motion along x and y has led it to them, two of `WallContact`.

    The coordinate normal to a wall is not that of the wall. sliding: changes of its velocity by friction, along the
    wall met along x, and along that met along y.
    """
    if log is not None:
        met = (x.low_change != x.high_change) | (y.low_change != y.high_change)
        if met and not is_absent(features.exits, discs.id[i]):
            write_walls(log, discs, i, x, y, sliding, features, parameters, control)


@inlined
def log_capsule(log, discs, i, owner, nx, ny, change, sliding, time, features, parameters):
    """Contact of disc i with an obstacle, so long ago, which has changed its velocity by so much along n from there.

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
            write(log, OBSTACLE, discs.id[i], owner, since, impulse * nx, impulse * ny, across * ny, -across * nx, x, y)


# --- The points of a contact with a surface: friction acts, and what has happened is recorded


@inlined
def on_walls(discs, i, x, y, in_flight, features, parameters, control):
    """Contact of a disc with the walls of the box that it has reached.

    x, y: its contacts along each axis, of `WallContact`. in_flight: None while contacts are resolved, when coordinates
    along periodic axes are left unchanged. Returns the changes of its velocity by friction, as `friction.on_walls`.
    """
    sliding = friction.on_walls(features.wall_friction, discs, i, x, y, in_flight, features, parameters, control)
    log_walls(features.log, discs, i, x, y, sliding, features, parameters, control)
    return sliding


@inlined
def on_capsule(discs, i, owner, nx, ny, normal_change, time, pushing, surface, features, parameters):
    """Contact of a disc with a capsule, along the unit vector n from there to the disc.

    owner: number of the obstacle. normal_change: of its velocity along n. time: since the contact [time].
    pushing, surface: speed of the capsule's surface along n, and along (-ny, nx) [length/time].
    """
    sliding = friction.on_surface(
        features.wall_friction, discs, i, nx, ny, normal_change, time, surface, features, parameters
    )
    power = normal_change * pushing - sliding * surface
    add_work(features.work, FIRST_OBSTACLE + owner, discs.id[i], power, features.mass)
    log_capsule(features.log, discs, i, owner, nx, ny, normal_change, sliding, time, features, parameters)
