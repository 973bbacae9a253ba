"""The record of a disc, and named constants for the numbers in the shared arrays.

Kernels, coordinator and workers all read these names, so that no number has a meaning in one file only.
"""

from typing import Any, NamedTuple

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
PARKED = 0  # 1: sleeps until its pipe is written to

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


class ContactLaw(NamedTuple):
    """A law by which a contact changes the velocities of two discs: how contacts are resolved, not what a scene has.

    It keeps kinetic energy; restitution and friction are features of a scene.

    Attributes:
        number: in `control.law`.
        exchanges_energy: whether discs give each other energy, so that collisions bring their speeds to equilibrium.
        not_exact: what the exact solver cannot do, in words; "": its impacts follow the law.
    """

    number: int
    exchanges_energy: bool
    not_exact: str


REFLECT, ELASTIC = range(2)
LAWS = {
    "reflect": ContactLaw(
        REFLECT,
        exchanges_energy=False,
        not_exact="law='reflect', which acts on discs that separate",
    ),
    "elastic": ContactLaw(ELASTIC, exchanges_energy=True, not_exact=""),
}
"""By the word for it in `Settings`; what each does is written in `frame/laws.py`."""

PUSH, IMPACT = range(2)
CONTACTS = {"push": PUSH, "impact": IMPACT}
"""When a contact acts, by the word in `Settings`: the number in `control.contact`. The exact solver needs none."""

SLICE = 100_000_000
"""Nanoseconds after which a command ends with the frame it is in, however many frames it was given: a machine that has
become slow, or more workers than cores, must not keep Ctrl-C and progress waiting."""

PATIENCE = 120_000_000_000
"""Nanoseconds after which a barrier counts as stalled: far above any pause of a living worker (a suspended laptop's
clock stands still, a debugger's does not), so that a slow machine is never called broken."""
