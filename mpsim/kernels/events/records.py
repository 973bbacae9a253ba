"""The records of the exact solver: what each holds, field by field, and what the outcomes of a call are."""

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from mpsim.kernels.records import Record

# Outcomes.
REACHED, PAUSED, NOT_FINITE, STALLED, BACKWARDS, OUTSIDE, STOPPED = range(7)

# Borders of a cell, and walls of the box: side >> 1 is the axis, side & 1 whether it is the high one.
LEFT, RIGHT, BOTTOM, TOP = range(4)
# Whatever else a disc meets alone: a wall that moves, and capsules from here on.
MOVING_WALL, FIRST_CAPSULE = 4, 5


def _record(number: DTypeLike, *fields: str | tuple[str, int]) -> np.dtype[Any]:
    """The dtype of a record of numbers of one kind; of a field (name, n) there are n."""
    each = [(field, number) if isinstance(field, str) else (field[0], number, (field[1],)) for field in fields]
    whole: Any = np.dtype(each, align=True)
    return np.dtype((Record, whole))


DISC = _record(
    np.float64,
    ("position", 2),  # and
    ("velocity", 2),  # at the time
    "last_update",  # of the disc's own last event
    "collision_time",  # of the impact with another disc that is predicted
    "crossing_time",  # at which it leaves its cell or meets what is no disc
    "last_contact",  # time of it
)
"""A disc: all that its flight and its events follow from, in one cache line."""

EVENT = _record(
    np.int32,
    "partner",  # of the predicted impact, or -1
    "partner_collision_count",  # its `collision_count` when that was predicted: the same while it was not deflected
    "collision_count",  # impacts of this disc so far, on discs and walls
    "side",  # of its cell by which it leaves next: LEFT, ...; or what it meets before: MOVING_WALL, FIRST_CAPSULE + k
    ("cell", 2),  # column and row
    ("spare", 2),
)
"""What a disc's next events are, and where it is."""

ENTRY = _record(
    np.int32,
    "after",  # neighbours in the list of a step
    "before",
    "place",  # a step, or -2 - (position in the heap), or -1
    "spare",
)
"""A disc in the calendar."""

CLOCK = _record(
    np.float64,
    "now",  # the present, counted from
    "origin",  # the start of the lap, which is a time since the start
    "step",  # length of a step of the calendar
    "lap",  # length of the lap
)
"""Times [time]."""

COUNTER = _record(
    np.int64,
    "pairs",  # impacts of two discs
    "walls",  # impacts on walls and obstacles
    "guarded",  # losses of energy that the guard has suppressed
    "events",  # of any kind
    "crossings",  # of borders of cells
    "stale_predictions",  # impacts that were predicted anew, as the partner had been deflected
    "cursor",  # the step of the calendar that is in the heap
    "waiting",  # discs in the heap
    "lap_events",  # events in this lap
    "stall",  # events since time last passed
)

TALLY = _record(
    np.float64,
    ("wall", 4),  # impulse on each wall [mass length/time]
    "virial",  # sum of r.dp over impacts of two discs [mass length^2/time]
    "virial_xx",  # of x dp_x
    "virial_xy",  # of x dp_y
)
"""What impacts add up to."""

TOTALS = _record(np.float64, ("wall", 4), "virial", "virial_xx", "virial_xy", "collisions")
"""The same, and impacts of two discs: what is counted of each frame."""

PROGRESS = _record(
    np.int64,
    "frame",  # frames finished since the start
    "spent",  # time spent so far on the one in hand [ns]
)
"""What a caller that plays frames keeps beside the store."""


def numbers(values: Any) -> NDArray[Any]:
    """A view of records as plain numbers: of one, shape (n,); of an array, a row for each. Other arrays as they are."""
    array: NDArray[Any] = np.asarray(values)
    if array.dtype.names is None:
        return array
    number = array.dtype[0].base
    return array.reshape(-1).view(number).reshape(*array.shape, array.dtype.itemsize // number.itemsize)


def of_numbers(kind: np.dtype[Any], values: NDArray[Any]) -> Any:
    """Records of a kind from plain numbers, as `numbers` gives them."""
    return np.ascontiguousarray(values).view(kind)[..., 0][()]
