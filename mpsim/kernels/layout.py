"""What stands where in the shared arrays: the record of a disc, and the index of every parameter and control word.

Kernels, coordinator and workers all read these names, so that no number has a meaning in one file only.
"""

from typing import Any, NamedTuple

PADDING = 16
"""Elements beyond the last disc that every disc array has, so that a vector load past the end stays inside it."""


class Discs(NamedTuple):
    """One buffer of discs, structure of arrays, each of shape (capacity + PADDING,).

    x, y: centre [length]; vx, vy: velocity [length/time]; id: number of the disc in the scene;
    cell: index of the grid cell, column-major; radius: [length], or None where all discs have the same.
    Only the first `count` elements are discs.
    """

    x: Any
    y: Any
    vx: Any
    vy: Any
    id: Any
    cell: Any
    radius: Any


# Indices of `parameters`, an array of the precision of the run.
DT = 0  # [time] of one step (a frame has `SUBSTEPS` of them)
DIAMETER = 1  # [length]
X_LOW = 2  # least and largest centre: the walls, one radius inwards where all discs have the same [length]
X_HIGH = 3
Y_LOW = 4
Y_HIGH = 5
CELLS_PER_X = 6  # columns per length along x [1/length]
CELLS_PER_Y = 7  # rows per length along y [1/length]
WALL_BOUNCE = 8  # fraction of a disc's distance beyond a wall that it is put inside it: 0 puts it at the wall
TALLY_SCALE = 9  # a power of two: tallies are whole multiples of 1 / TALLY_SCALE [mass length/time]
EXCHANGE = (
    10  # (1 + e) / 2 with e the restitution of two discs: the fraction of the normal velocities that is exchanged
)
WALL_RESTITUTION = 11
FAST = 12  # square of the speed (of the speed per radius, where discs have their own) from which on a frame is the last
PARAMETERS = 13

# Indices of `control`, an int64 array. Words that processes wait on have a cache line (8 words) each.
COMMAND = 0  # number of the last command; changes when workers are to run frames
ARRIVED = 8  # arrivals at barriers since the pool started
ABORT = 16  # 0, or what has happened to a process, so that everybody must leave the frame loop wherever he is
MAIL = 24  # number of messages that wait in the workers' pipes to be read
BAD = 48  # 1: a disc is not finite. Set while moving, read after the barrier that follows: everybody leaves there
ANNOUNCED = 56  # number of the command that is about to be given: nobody may go to sleep before it
COUNT = 32  # discs
COLUMNS = 33
ROWS = 34
LIVE = 35  # which of the two buffers holds the state: 0 or 1
FRAMES = 36  # frames to run in this command; lowered when their time is up, or a disc is too fast
SUBSTEPS = 37
LAW = 38
WORKERS = 39
DONE = 40  # frames finished since the start, in all commands
CONTACT = 42
PASSES = 43  # times that contacts are looked for in one step
CELLS = 44  # cells of the grid with all ghosts: one less than the length of `start`
ABSORBING = 45  # edges that absorb discs: the sum of 1 << (limit - X_LOW) over their limits
STEPS = 46  # steps done since the start
GUARDED = 41  # 1: odd/even passes; 0: the demonstration of what goes wrong without them
CONTROL = 64

# Outcomes of a command; all but BAD_STATE are values of ABORT.
RUNNING = 0
BAD_STATE = 1  # a disc's position or velocity is not finite
WORKER_LOST = 2
STALLED = 3  # a barrier was not complete after PATIENCE nanoseconds

# What `run_grid` returns besides these: to a worker only, when there is nothing to run.
IDLE = -1  # no command for a while
MAILED = -2  # a message waits in the pipe

# Indices of one worker's row of `team`, int64 (workers, TEAM): whole pairs of cache lines, written by that worker.
FRAME = 0  # frames finished in this command
PHASE = 1  # phase it is in, an index of PHASES
COLLISIONS = 2  # contacts resolved in this command
OUTBOX = 3  # discs that left this worker's columns in this frame
KEPT = 4  # discs that stayed in them
ARRIVALS = 5  # barriers this worker has passed
PARKED = 6  # 1: sleeps until its pipe is written to
BAD_SLOT = 7  # where in the live buffer a non-finite disc lies, or -1
CLOCK = 8  # two words of scratch space for the clock
LOW = 10  # first disc and one past the last disc of this worker's slice
HIGH = 11
FIRST_COLUMN = 12  # first column and one past the last column of this worker
LAST_COLUMN = 13
COMMANDS = 14  # commands this worker has begun
MAILS = 15  # messages it has read
FASTEST = 16  # 0, or how fast the fastest disc beyond FAST was in this command, times FASTEST_SCALE / the limit
FASTEST_DISC = 17  # its id
TEAM = 32

# Phases of one frame, in the order of the last axis of `times`.
MOVE = 0
SORT = 1
EVEN = 2
ODD = 3
WAIT = 4
PHASES = ("move", "sort", "even columns", "odd columns", "wait")

# What is counted in each frame when measures ask for it, indices of the last axis of `tally`, int64.
# Sums are kept in fixed point: whole numbers add up to the same total in any order, so on any number of workers.
LEFT = 0  # impulse on each wall, times TALLY_SCALE
RIGHT = 1
BOTTOM = 2
TOP = 3
VIRIAL = 4  # impulse between discs, times TALLY_SCALE
COLLISION = 5  # pairs whose velocities changed
DEPTH = 6  # overlap of the pairs met, times DEPTH_SCALE / diameter
DEEPEST = 7  # the largest of them, likewise
MET = 8  # pairs met
VIRIAL_XX = 9  # the impulse between discs times n_x n_x and n_x n_y, n the unit vector along it, like VIRIAL
VIRIAL_XY = 10
TALLIES = 11
IMPULSES = (LEFT, RIGHT, BOTTOM, TOP, VIRIAL, VIRIAL_XX, VIRIAL_XY)
WALLS = slice(LEFT, TOP + 1)

DEPTH_SCALE = 2.0**32
"""Depths are counted in fractions of a diameter, whatever the impulses of a scene are."""

FASTEST_SCALE = 2.0**20
"""Speeds are reported in units of the limit, so many to one."""

# Collision laws.
REFLECT = 0
ELASTIC = 1

# Contacts.
PUSH = 0
IMPACT = 1

SLICE = 100_000_000
"""Nanoseconds after which a command ends with the frame it is in, however many frames it was given: a machine that has
become slow, or more workers than cores, must not keep Ctrl-C and progress waiting."""

PATIENCE = 120_000_000_000
"""Nanoseconds after which a barrier counts as stalled: far above any pause of a living worker (a suspended laptop's
clock stands still, a debugger's does not), so that a slow machine is never called broken."""
