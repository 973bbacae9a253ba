"""The log of collisions: rows that kernels write if a run records collisions.

Each worker has a log of its own. Where nobody asks there is none (None), and what would write to it compiles to
nothing. A row that does not fit is counted all the same, so a log that was too small is found out.
"""

from collections import namedtuple
from collections.abc import Mapping
from typing import Any

import numpy as np

from mpsim.kernels.compiling import inlined
from mpsim.kernels.records import Record

_fields: Any = np.dtype(
    [
        ("span", np.int64),  # exact solver: the frame, counted from the start; others: the step, from 1 in each command
        ("time", np.float64),  # exact solver: since the start; others: from then until the end of the step [time]
        ("impulse", np.float64, (2,)),  # along the normal, on disc i [mass length/time]
        ("place", np.float64, (2,)),  # where they touch [length]
        ("i", np.int32),  # a disc
        ("j", np.int32),  # what it has met: another disc, an edge of the box, or a capsule
        ("kind", np.int64),  # DISC, WALL or OBSTACLE
    ],
    align=True,
)
COLLISION = np.dtype((Record, _fields))
"""A row of the log, of one cache line."""

DISC, WALL, OBSTACLE = range(3)

COUNT = 0  # rows, those that did not fit included
AGREED = 1  # of them, rows that are not to be taken back
SPAN = 2  # the frame or step in hand
STATE_SIZE = 16  # so that no two workers write to one pair of cache lines

Log: Any = namedtuple("Log", "rows state")
"""rows: COLLISION, shape (room,); state: int64, shape (STATE_SIZE,)."""

ROWS, STATE = "collisions", "collision_counts"
"""Names of the arrays of all workers, shapes (workers, room) and (workers, STATE_SIZE)."""


def log_of(arrays: Mapping[str, Any], worker: int) -> Any:
    """The log of one worker, from arrays by name; None where there is none."""
    return Log(arrays[ROWS][worker], arrays[STATE][worker]) if ROWS in arrays else None


@inlined
def write(log, kind, i, j, time, impulse_x, impulse_y, place_x, place_y):
    """Write a collision; one without an impulse is none."""
    if log is not None:  # noqa: SIM102 - see optional.py
        if (impulse_x != 0.0) | (impulse_y != 0.0):
            k = log.state[COUNT]
            if k < log.rows.size:
                row = log.rows[k]
                row.span, row.time, row.kind, row.i, row.j = log.state[SPAN], time, kind, i, j
                row.impulse[0], row.impulse[1] = impulse_x, impulse_y
                row.place[0], row.place[1] = place_x, place_y
            log.state[COUNT] = k + 1


@inlined
def begin_span(log, span):
    """What is written from now on belongs to this frame or step."""
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
    """Whether a row has not fitted."""
    if log is None:
        return False
    return log.state[COUNT] > log.rows.size


@inlined
def agree(log):
    """What has been written stays."""
    if log is not None:
        log.state[AGREED] = log.state[COUNT]


@inlined
def take_back(log):
    """Forget what was written since `agree`."""
    if log is not None:
        log.state[COUNT] = log.state[AGREED]
