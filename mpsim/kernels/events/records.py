"""The records of the exact solver, regions of cells, sums, and hashes of them."""

import math
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from mpsim.kernels.compiling import inlined
from mpsim.kernels.records import record_of

# --- The region of a store: the cells that are in it, those that are the tile's own, and the bands along its borders
#
# Cells are numbered column by column, from the first column and row of the region on. The region of a store that holds
# the whole box is None, and the compiler drops the code that uses it.

BAND = 3
"""Cells on either side of a border between two tiles in which both must find the same. A disc looks at the cells
around its own, so what is left of the band never looks at what is right of it."""

OUTER_LOW, INNER_LOW, MIDDLE, INNER_HIGH, OUTER_HIGH, ELSEWHERE = 0, 1, 2, 3, 4, -1


@inlined
def place_along(axis, cell, region, box):
    """Column or row of a cell, counted from the first one here; -1 if it is not here."""
    if region is None:
        return cell
    place = cell - region.first[axis]
    if place < 0:
        place += box.columns if axis == 0 else box.rows
    return place if place < region.here[axis] else -1


@inlined
def number_of_cell(column_place, row, region, box):
    """Number of the cell of a row in the column at such a place; -1 if it is not here."""
    if region is None:
        return column_place * box.rows + row
    row_place = place_along(1, row, region, box)
    return column_place * region.here[1] + row_place if column_place >= 0 and row_place >= 0 else -1


@inlined
def here_along(axis, region, box):
    """Columns or rows of cells that are here."""
    if region is None:
        return box.columns if axis == 0 else box.rows
    return region.here[axis]


@inlined
def counts(region):
    """1 if the current event counts here; 0 if it belongs to another tile."""
    if region is None:
        return 1
    return region.counts


@inlined
def begin_event(cell, region, box):
    """Before an event in a cell: it counts if the cell is the tile's own."""
    if region is not None:
        region.counts = is_own(cell, region, box)


@inlined
def band_along(axis, cell, region, box):
    """Where a cell lies along an axis: in the tile, in a band along a border of it, or ELSEWHERE. Only for tiles."""
    if region.differs[axis] == 0:
        return MIDDLE
    place = place_along(axis, cell, region, box)
    if place < 0:
        return ELSEWHERE
    place -= region.own_first[axis]
    own = region.own[axis]
    if place < -BAND or place >= own + BAND:
        return ELSEWHERE
    # OUTER_LOW, INNER_LOW, ... In plain Python the sum of NumPy's truths is their `or`.
    return int(place >= 0) + int(place >= BAND) + int(place >= own - BAND) + int(place >= own)


@inlined
def is_own(cell, region, box):
    """Whether a cell is the tile's own. Only for tiles."""
    for axis in range(2):
        place = place_along(axis, cell[axis], region, box) - region.own_first[axis]
        if place < 0 or place >= region.own[axis]:
            return False
    return True


# --- A hash of a sequence of numbers, with which two tiles compare their results

FACTOR = np.int64(0x2545F4914F6CDD1D)
MANTISSA = 2.0**53


@inlined
def mixed(digest, value):
    """A hash with one more whole number added."""
    digest = (digest ^ value) * FACTOR
    return digest ^ (digest >> 29)


@inlined
def mixed_real(digest, value):
    """The same, with a real number."""
    fraction, exponent = math.frexp(value)
    return mixed(mixed(digest, np.int64(fraction * MANTISSA)), np.int64(exponent))


# --- Predicted partners: by place in memory if they are in the store, else by number


@inlined
def elsewhere(number):
    """The code for the number of a partner that is not in the store; also its inverse."""
    return -2 - number


@inlined
def number_of_partner(partner, event):
    """The number of a predicted partner, here or elsewhere; -1 if there is none."""
    if partner >= 0:
        return np.int64(event[partner].number)
    return np.int64(partner) if partner == -1 else elsewhere(np.int64(partner))


# --- The records of the exact solver, field by field, and the outcomes of a call

# Outcomes.
REACHED, PAUSED, NOT_FINITE, STALLED, BACKWARDS, STOPPED, ABORTED, FULL = range(8)

# Borders of a cell, and walls of the box: side >> 1 is the axis, side & 1 whether it is the high one.
LEFT, RIGHT, BOTTOM, TOP = range(4)
# Other things that a disc meets: capsules from this number on, and from that on those of obstacles that move.
FIRST_CAPSULE, FIRST_BODY = 5, 1 << 30
# Nothing, at an instant from which a disc is looked at again; and moving walls: this number and their edge.
LOOK = FIRST_BODY - 1
MOVING_WALL = LOOK - 4


def _record(number: DTypeLike, *fields: str | tuple[str, int]) -> np.dtype[Any]:
    """The dtype of a record of numbers of one kind; a field (name, n) holds n of them."""
    return record_of([(each, number) if isinstance(each, str) else (each[0], number, (each[1],)) for each in fields])


DISC = _record(
    np.float64,
    ("position", 2),  # and
    ("velocity", 2),  # at the time
    "last_update",  # of the disc's own last event
    "collision_time",  # of the impact with another disc that is predicted
    "crossing_time",  # at which it leaves its cell or meets something other than a disc
    "last_contact",  # time of it
)
"""A disc: all that its flight and its events follow from, in one cache line."""

EVENT = _record(
    np.int32,
    "partner",  # of the predicted impact, or -1
    "partner_collision_count",  # its `collision_count` at the prediction: unchanged until it is deflected
    "collision_count",  # impacts of this disc so far, on discs and walls
    "side",  # border where it leaves its cell: LEFT, ...; or what it hits before: FIRST_CAPSULE + k, ...
    ("cell", 2),  # column and row
    "number",  # of the disc, wherever it lies in memory; orders equal times
    "spare",
)
"""What a disc's next events are, and where it is. A partner is named by its place in memory."""

ENTRY = _record(
    np.int32,
    "after",  # neighbours in the list of a step
    "before",
    "place",  # a step, or -2 - (position in the heap), or -1
    "spare",
)
"""A disc in the calendar."""

MOST_NEAR = 64
"""Discs around another that are looked at together; where there are more of them, one after the other."""

CLOCK = _record(
    np.float64,
    "now",  # the present, counted from
    "origin",  # the start of the lap, which is a time since the start
    "step",  # length of a step of the calendar
    "lap",  # length of the lap
)
"""Times [time]."""

TURN = _record(np.float64, "start", "end", "latest")
"""The turn of the calendar's ring, and the latest event of a tile that counts, from the start of the lap [time]."""

COUNTER = _record(
    np.int64,
    "pairs",  # impacts of two discs
    "walls",  # impacts on walls and obstacles
    "guarded",  # losses of energy that the guard has suppressed
    "events",  # of any kind
    "crossings",  # of borders of cells
    "stale_predictions",  # impacts predicted anew, as the partner had been deflected
    "cursor",  # the step of the calendar that is in the heap
    "waiting",  # discs in the heap
    "lap_events",  # events in this lap
    "stall",  # events since time last passed
)

# Entries of a tally: impulse on each wall [mass length/time], by side; sum of r.dp over impacts of two discs
# [mass length^2/time], of x dp_x, and of x dp_y.
VIRIAL, VIRIAL_XX, VIRIAL_XY, ENTRIES = range(4, 8)

FINE = 33
"""Bits of the fine part of a sum: its unit is that of the coarse part over 2^FINE."""

TALLY = _record(np.int64, ("coarse", ENTRIES), ("fine", ENTRIES))
"""What impacts add up to, in fixed point: whole numbers add up to the same total in any order."""

TOTALS = _record(np.int64, ("coarse", ENTRIES), ("fine", ENTRIES), "collisions")
"""The same, and impacts of two discs: what is counted of each frame."""

REGION = _record(
    np.int64,
    "counts",  # 1: the current event counts here; 0: it belongs to another tile
    ("first", 2),  # first column and row of those that are here
    ("here", 2),  # columns and rows that are here, from that one on, through periodic borders
    ("own_first", 2),  # of these, the first that are the tile's own,
    ("own", 2),  # and how many are
    ("differs", 2),  # 1: there are others along this axis
)
"""The part of the box that lies in a store: all of it, or a tile and what lies around."""

BANDS = 5
"""Parts of a tile, and of what lies around it, along an axis: see `band_along`."""

TILE = _record(
    np.int64,
    ("own_first", 2),  # first column and row,
    ("own", 2),  # and how many
    "first",  # where its discs lie,
    "count",  # and how many there are
    "room",  # where they are put at the end of a window,
    "capacity",  # and how many there is room for
    "found",  # discs that were put there
    "status",  # REACHED, or the error
    ("seen", BANDS * BANDS),  # sums over the events in each band
)
"""A tile: the discs of a rectangle of cells, and what was found of them in a window."""

PLAN = _record(
    np.int64,
    ("next", 1),  # the tile to be played next
    "deadline",  # of the command: time after which no worker begins a tile [ns]
    "running",  # 1: there is a window to play
    "paused",  # 1: the last command left it before all tiles were played
    "stops",  # 1: the command is to stop at its end
    "done",  # frames finished in this command,
    "played",  # and windows begun in it
    "status",  # outcome of the command: PAUSED, or why it ends
    "particle",  # where
    "frames",  # that end in it
    "first_frame",  # of them
    "ends_lap",  # 1: the window ends with the lap of the calendar
    ("tiles", 2),  # along each axis
    "halo",  # cells around a tile that are played with it
    "windows",  # played so far
    "again",  # of these, played again as shorter ones, as tiles did not agree
    "as_one",  # of these, played by one worker alone, as shorter ones did not help
    "parts",  # windows in a lap
    "fewest_parts",  # windows in a lap to be tried, as tiles did not agree with fewer
    "peace",  # windows since tiles last disagreed
    "whole_part",  # 1: this window has this length, and was not cut short
)
"""A window of time, as all workers are to play it."""

COMMAND = record_of([("frames", np.int64), ("patience", np.int64), ("stop", np.float64)])
"""Frames to play, time after which no tile is begun any more [ns], and the time at which to stop [time]."""

PLAN_TIMES = _record(np.float64, "dt", "until", "reached", "stop")
"""Length of a frame, end of the window where that is not the end of the lap, end of the one before, and stop of the
command by which it was planned [time]."""

PROGRESS = _record(
    np.int64,
    "frame",  # frames finished since the start
    "spent",  # time spent so far on the current frame [ns]
)
"""What a caller that plays frames keeps beside the store."""


def numbers(values: Any) -> NDArray[Any]:
    """A view of records as plain numbers: of one, shape (n,); of an array, one row each. Other arrays unchanged."""
    array: NDArray[Any] = np.asarray(values)
    if array.dtype.names is None:
        return array
    number = array.dtype[0].base
    return array.reshape(-1).view(number).reshape(*array.shape, array.dtype.itemsize // number.itemsize)


def of_numbers(kind: np.dtype[Any], values: NDArray[Any]) -> Any:
    """Records of a kind from plain numbers, as `numbers` gives them."""
    return np.ascontiguousarray(values).view(kind)[..., 0][()]


# --- Sums of real numbers in fixed point, which do not depend on the order of the terms
#
# A number is split into whole multiples of a unit and of 2^-33 of it. The sum is `coarse` units and 0 <= `fine` <
# 2^33, so equal sums have equal numbers.

CARRY = np.int64(1) << FINE
MASK = CARRY - 1


@inlined
def add(tally, entry, value, unit):
    """Add a number to an entry of a tally; unit: a power of two, in the unit of the number."""
    scaled = value / unit
    whole = math.floor(scaled)
    add_parts(tally, entry, np.int64(whole), np.int64((scaled - whole) * CARRY))


@inlined
def add_parts(tally, entry, coarse, fine):
    """Add so many coarse and fine units to an entry of a tally."""
    fine += tally.fine[entry]
    tally.coarse[entry] += coarse + (fine >> FINE)
    tally.fine[entry] = fine & MASK


@inlined
def add_tally(tally, other):
    """Add all entries of another tally."""
    for entry in range(ENTRIES):
        add_parts(tally, entry, other.coarse[entry], other.fine[entry])


@inlined
def clear_tally(tally):
    """Set all entries to zero."""
    for entry in range(ENTRIES):
        tally.coarse[entry] = tally.fine[entry] = 0
