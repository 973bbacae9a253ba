"""The log of collisions, if a run asks for it: rows that kernels write.

Each worker has a log of its own. Without a request the log is None, and code that would write to it compiles to
nothing. A row that does not fit is still counted, which shows that a log was too small.
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
        ("tangential_impulse", np.float64, (2,)),  # across it, on disc i [mass length/time]
        ("place", np.float64, (2,)),  # where they touch [length]
        ("i", np.int32),  # a disc
        ("j", np.int32),  # what it met: another disc, an edge of the box, or a capsule
        ("kind", np.int64),  # DISC, WALL or OBSTACLE
    ],
    align=True,
)
COLLISION = np.dtype((Record, _fields))
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
    if log is not None:  # noqa: SIM102 - see optional.py
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


@inlined
def agree(log):
    """Keep the rows written so far: `take_back` does not remove them."""
    if log is not None:
        log.state[AGREED] = log.state[COUNT]


@inlined
def take_back(log):
    """Forget what was written since `agree`."""
    if log is not None:
        log.state[COUNT] = log.state[AGREED]
