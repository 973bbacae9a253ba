"""The shared arrays: records with named fields, and named constants for their numbers."""

import functools
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike

from mpsim.kernels.compiling import inlined

# --- The record of a disc, and named constants for the numbers in the shared arrays
#
# Kernels, coordinator and workers all read these names, so that no number has a meaning in one file only.

PADDING = 16
"""Elements beyond the last disc that every disc array has, so that a vector load past the end stays inside it."""


class Discs(NamedTuple):
    """One buffer of discs, structure of arrays, each of shape (capacity + PADDING,).

    x, y: centre [length]; vx, vy: velocity [length/time]; id: number of the disc in the scene;
    cell: index of the grid cell, column-major; radius: [length], or None if all discs have the same.
    Only the first `count` elements are discs.
    """

    x: Any
    y: Any
    vx: Any
    vy: Any
    id: Any
    cell: Any
    radius: Any


class Changes(NamedTuple):
    """Discs that change cells in a step, int32; each worker has sections of its own.

    slot, old_cell, new_cell, id: of the discs of the slice that have changed cells, by slot; after them, of those that
    come from other workers, without old cells. next_arrival, first_arrival: linked lists of the entries that arrive in
    own cells, one list for every few cells, in the order (cell, id); -1 ends a list.
    outbox: slots of discs that have left a worker's columns.
    """

    slot: Any
    old_cell: Any
    new_cell: Any
    id: Any
    next_arrival: Any
    first_arrival: Any
    outbox: Any


WHOLE = ("id", "cell")
"""Columns of `Discs` that are int32; the others are of the precision of the run."""

OPTIONAL = ("radius",)
"""Columns of `Discs` that only some scenes have."""

# Edges of the box, in the order of `features.edges.EDGES`, and those that lie along an axis.
LEFT, RIGHT, BOTTOM, TOP = range(4)
ALONG_X = (LEFT, RIGHT)
ALONG_Y = (BOTTOM, TOP)

# Indices of `control.signals`, int64 words that processes wait on: a cache line (8 words) each.
COMMAND = 0  # number of the last command; changes when workers are to run frames
ARRIVED = 8  # arrivals at barriers since the pool started
ABORT = 16  # 0, or what has happened to a process: every worker must then leave the frame loop, wherever it is
MAIL = 24  # number of messages that wait in the workers' pipes to be read
BAD = 32  # 1: a disc is not finite. Set while moving, read after the barrier that follows: every worker leaves there
ANNOUNCED = 40  # number of the command that is about to be given: no worker may go to sleep before it
SIGNALS = 48

# The index of a worker's own `signals`.
PARKED = 0  # number of the nap in which it sleeps until its pipe is written to; negative: it is to wake on any core

# Outcomes of a command; all but BAD_STATE are values of ABORT.
RUNNING = 0
BAD_STATE = 1  # a disc's position or velocity is not finite
WORKER_LOST = 2
STALLED = 3  # a barrier was not complete after PATIENCE nanoseconds

# What `run_grid` returns besides these: to a worker only, when there is nothing to run.
NO_FRAME = -1  # in place of the number of a frame
IDLE = -1  # no command for a while
MAILED = -2  # a message waits in the pipe

# Phases of one frame, in the order of the last axis of `times`.
MOVE = 0
SORT = 1
EVEN = 2
ODD = 3
WAIT = 4
PHASES = ("move", "sort", "even columns", "odd columns", "wait")

DEPTH_SCALE = 2.0**32
"""Depths are counted in fractions of a diameter, whatever the impulses of a scene are."""

FASTEST_SCALE = 2.0**20
"""Speeds are reported in units of the limit, so many to one."""

STEPS_OF_OVERLAP = 4.0
"""Steps that explain an overlap: in gases below the bounds of speed the deepest was 3.5 of them (docs/stability.md)."""

PRESSED, PINCHED = 2**60, 2**61
"""Reported in place of a speed, which is always less: discs are deep in each other where something moves that may press
them; surfaces are about to press a disc through each other."""


REFLECT, ELASTIC = range(2)
LAWS = {"reflect": REFLECT, "elastic": ELASTIC}
"""Laws by which a contact changes the velocities of two discs, by the word for each in `Settings`: the number in
`control.law`. What each does is written in `frame/laws.py`. They keep kinetic energy; restitution and friction are
features of a scene."""

PUSH, IMPACT = range(2)
CONTACTS = {"push": PUSH, "impact": IMPACT}
"""When a contact acts, by the word in `Settings`: the number in `control.contact`. The exact solver needs none."""

SLICE = 100_000_000
"""Nanoseconds after which a command ends with the frame it is in, however many frames it was given: a machine that has
become slow, or more workers than cores, must not keep Ctrl-C and progress waiting."""

PATIENCE = 120_000_000_000
"""Nanoseconds after which a barrier counts as stalled: far above any pause of a living worker (a suspended laptop's
clock stands still, a debugger's does not), so that a slow machine is never called broken."""


# --- The records of the shared block, with named fields, each declared once
#
# A field is an attribute of its record, `control.columns`, in compiled code as in Python; for an array of records, the
# field of all of them is `team["low"]`. Coordinator, workers and kernels all read these declarations.

LINE_PAIR = 128
"""Bytes that the prefetcher takes at a time: records that different workers write are whole multiples of it."""

Field = tuple[str, DTypeLike] | tuple[str, DTypeLike, tuple[int, ...]]
"""Name, dtype and, where it is an array, shape."""


class Record(np.void):
    """One record, whose fields are attributes in Python too: `record_of` makes properties of their names.

    Not `np.record`, which finds a field by catching an exception: an interrupt in between would keep the block alive.
    """

    __slots__ = ()

    def __setattr__(self, name: str, value: Any) -> None:
        self[name] = value


def row_of(record: Any) -> Any:
    """A record of a block as an array of one, shape (1,), which Numba unpacks in a fortieth of the time."""
    return record.base.reshape(1)


def record_of(fields: list[Field], multiple: int = 1) -> np.dtype[Any]:
    """The dtype of a record whose size is a multiple of so many bytes."""
    packed: Any = np.dtype(fields, align=True)
    places = [packed.fields[name] for name in packed.names]
    padded: Any = {
        "names": packed.names,
        "formats": [place[0] for place in places],
        "offsets": [place[1] for place in places],
        "itemsize": -(-packed.itemsize // multiple) * multiple,
    }
    for name in packed.names:
        setattr(Record, name, property(itemgetter(name)))
    return np.dtype((Record, np.dtype(padded, align=True)))


@functools.cache  # each dtype that Numba sees stays for good
def parameters_in(precision: DTypeLike) -> np.dtype[Any]:
    """The record `parameters`: real numbers of the precision of the run."""
    real = np.dtype(precision)
    return record_of(
        [
            ("dt", real),  # [time] of one step (a frame has `substeps` of them)
            ("diameter", real),  # [length]
            ("limit", real, (4,)),  # by edge: least and largest centre, a radius inwards where all have one [length]
            ("cells_per_x", real),  # columns per length along x [1/length]
            ("cells_per_y", real),  # rows per length along y [1/length]
            ("wall_bounce", real),  # fraction of the distance beyond a wall that a disc is put inside: 0, at the wall
            ("tally_scale", real),  # a power of two: tallies are multiples of 1 / tally_scale [mass length/time]
            ("half_one_plus_e", real),  # (1 + e) / 2, e the restitution of two discs
            ("wall_restitution", real),
            ("fast", real),  # square of the speed (per radius, where discs have their own) that ends a command
        ]
    )


CONTROL = record_of(
    [
        ("signals", np.int64, (SIGNALS,)),  # the words that processes wait on, indexed by COMMAND, ARRIVED, ...
        ("count", np.int64),  # discs
        ("columns", np.int64),
        ("columns_before", np.int64),  # of the grid that are not in `start`: other ranks have them
        ("rows", np.int64),
        ("cells", np.int64),  # of the grid with all ghosts: one less than the length of `start`
        ("live", np.int64),  # which of the two buffers holds the state: 0 or 1
        ("in_order", np.int64),  # 1: the discs lie in the order of the grid, and `start` tells where; 0: in any order
        ("frames", np.int64),  # to run in this command; reduced when time is up, or a disc is too fast
        ("substeps", np.int64),
        ("law", np.int64),
        ("contact", np.int64),
        ("passes", np.int64),  # searches for contacts in one step
        ("race_free", np.int64),  # 1: odd/even passes; 0: to demonstrate what goes wrong without them
        ("tallied", np.int64),  # 1: what measures need is counted
        ("deep", np.int64),  # 1: discs were deep in each other in the last step (no snapshot tells); below 0: not asked
        ("absorbing", np.int64, (4,)),  # by edge: 1 where it absorbs discs
        ("workers", np.int64),
        ("members", np.int64),  # of the team: the workers, and with ranks one more that stands for all other ranks
        ("part", np.int64),  # the part of a step that a rank is to do: MOVE, SORT, EVEN or ODD
        ("ahead", np.int64),  # frame of the step that it starts after ODD, or NO_FRAME
        ("done", np.int64),  # frames finished since the start, in all commands
        ("steps", np.int64),  # done since the start
    ],
    LINE_PAIR,
)
"""The record `control`: what the coordinator commands, and how far the frames have come."""


THERMOSTAT = record_of(
    [
        ("probability", np.float64),  # probability that a disc gets a new velocity before a frame
        ("temperature", np.float64),  # kT [mass length^2/time^2]
        ("seed", np.int64),
        ("first_frame", np.int64),  # the step from which those of `control` are counted
    ]
)
"""A thermostat."""

THERMAL_WALLS = record_of(
    [
        ("temperature", np.float64, (4,)),  # by edge: kT, 0 where it is not thermal [mass length^2/time^2]
        ("seed", np.int64),
    ]
)
"""Thermal walls."""


def message_in(precision: DTypeLike, radii: bool, spins: bool, images: bool) -> np.dtype[Any]:
    """The record of a disc sent from one rank to another.

    radii, spins, images: whether discs have radii of their own, angular velocities, image flags.
    """
    real = np.dtype(precision)
    fields: list[Field] = [("x", real), ("y", real), ("vx", real), ("vy", real), ("id", np.int32), ("cell", np.int32)]
    fields += [("radius", real)] * radii + [("spin", real)] * spins
    return record_of(fields + [("image_x", np.int64), ("image_y", np.int64)] * images)


MEMBER = record_of(
    [
        ("signals", np.int64, (1,)),  # the word that the coordinator reads: PARKED
        ("frame", np.int64),  # frames finished in this command
        ("phase", np.int64),  # it is in, an index of PHASES
        ("collisions", np.int64),  # contacts resolved in this command
        ("leavers", np.int64),  # discs of the slice that left their cells in this step
        ("listed", np.int64),  # 1: all of them are in the list of `Changes`
        ("outbox", np.int64),  # discs that left this worker's columns in this frame
        ("kept", np.int64),  # discs that stayed in them
        ("arrivals", np.int64),  # barriers this worker has passed
        ("bad_slot", np.int64),  # where in the live buffer a non-finite disc lies, or -1
        ("clock", np.int64, (2,)),  # the time when it last read the clock: seconds, nanoseconds
        ("low", np.int64),  # first disc and one past the last disc of this worker's slice
        ("high", np.int64),
        ("first_column", np.int64),  # first column and one past the last column of this worker
        ("last_column", np.int64),
        ("commands", np.int64),  # this worker has begun
        ("mails", np.int64),  # messages it has read
        ("fastest", np.int64),  # 0, the speed of the fastest disc of a command times FASTEST_SCALE / limit, or PINCHED
        ("fastest_disc", np.int64),  # its id
        ("even", np.int64),  # columns where the passes continue, between two parts of a step on a rank
        ("odd", np.int64),
        ("stop", np.int64),  # one past the last column whose contacts are all on this rank
    ],
    LINE_PAIR,
)
"""The record of one worker in `team`: written by that worker."""


def _counts(number: DTypeLike) -> np.dtype[Any]:
    return record_of(
        [
            ("wall", number, (4,)),  # by edge: impulse on the wall
            ("virial", number),  # impulse between discs
            ("virial_xx", number),  # that impulse times n_x n_x and n_x n_y, where n is the unit vector along it
            ("virial_xy", number),
            ("collisions", number),  # pairs whose velocities changed
            ("met", number),  # pairs met
            ("depth", number),  # overlap of the pairs met
            ("deepest", number),  # the largest of them
        ]
    )


TALLY = _counts(np.int64)
"""What one worker counts in a frame when measures ask for it. Sums are kept in fixed point: whole numbers add up to the
same total in any order, so on any number of workers. Impulses are multiplied by the parameter `tally_scale`, depths by
DEPTH_SCALE / diameter."""

COUNTS = _counts(np.float64)
"""What all workers have counted in a frame, in the units of the scene."""

IMPULSES = ("wall", "virial", "virial_xx", "virial_xy")
DEPTHS = ("depth", "deepest")


@inlined
def real(parameters, value):
    """A number in the precision of the run: a whole number would turn float32 into float64."""
    return parameters.limit.dtype.type(value)
