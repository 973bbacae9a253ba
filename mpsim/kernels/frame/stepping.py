"""The stepped solver: one frame, and many frames in one call.

A frame of the grid has four phases. W workers own contiguous ranges of columns, chosen so that each holds about the
same number of discs; the discs of a worker's columns are one contiguous slice of the arrays.

    move   own slice: v += a dt, p += v dt, walls, cell; count the cells of own columns, list the discs that left
    ------------------------------------------------------------------------------------------------- barrier
    sort   own columns: counting sort of the discs into the other buffer, in the order (column, row, id)
    ------------------------------------------------------------------------------------------------- barrier
    even   own even columns: contacts of column c with itself and with column c + 1
    ------------------------------------------------------------------------------------------------- barrier
    odd    own odd columns, likewise
    ------------------------------------------------------------------------------------------------- barrier

Why the passes need no lock, and why workers cannot change the result:

    column      0     1     2     3     4     5          a disc looks at          +---+---+
    even pass  [0 --> 1]   [2 --> 3]   [4 --> 5]         the later discs of its   | 2 | 5 |
    odd pass         [1 --> 2]   [3 --> 4]   [5 -->      own cell (1), and at     +---+---+
                                                         the cells 2 to 5:        | 1 | 4 |
    in one pass the brackets are disjoint, so every                               +---+---+
    order of the columns, on any worker, is the same                                  | 3 |
                                                                                      +---+

Inside a column the order is that of the sorted discs, a function of positions and ids alone. So a frame depends on
nothing but the state in particle order: not on the workers, nor on the memory order left by earlier frames.
"""

from mpsim.kernels.compiling import compiled, inlined
from mpsim.kernels.features.hooks import after_binning, before_step
from mpsim.kernels.frame.contacts import resolve_all_pairs, resolve_columns
from mpsim.kernels.frame.giants import resolve_giants
from mpsim.kernels.frame.motion import move
from mpsim.kernels.frame.sorting import bin_discs, count_cells, sort
from mpsim.kernels.layout import (
    ABORT,
    BAD,
    BAD_STATE,
    CLOCK,
    COLLISIONS,
    COLUMNS,
    COMMAND,
    COMMANDS,
    COUNT,
    DONE,
    EVEN,
    FIRST_COLUMN,
    FRAME,
    FRAMES,
    GUARDED,
    HIGH,
    IDLE,
    LAST_COLUMN,
    LIVE,
    LOW,
    MAILED,
    MOVE,
    ODD,
    PASSES,
    PHASE,
    RUNNING,
    SLICE,
    SORT,
    STEPS,
    SUBSTEPS,
    WAIT,
    WORKERS,
)
from mpsim.kernels.machine import atomic_add, atomic_load, now
from mpsim.kernels.waiting import await_command, barrier


@compiled
def record(times, mine, phase, since):
    """Add the time since `since` to a phase of the current frame; returns the time now."""
    moment = now(mine[CLOCK : CLOCK + 2])
    times[mine[FRAME], phase] += moment - since
    return moment


@compiled
def enter(mine, phase):
    """Note which phase this worker is in, for the report of a death."""
    mine[PHASE] = phase


@compiled
def meet(control, mine, times, since):
    """Barrier, its waiting time recorded. Returns the time now; the abort word says whether to continue."""
    if control[WORKERS] > 1:
        enter(mine, WAIT)
        barrier(control, mine)
        return record(times, mine, WAIT, since)
    return since


@inlined
def meet_giants(giants, discs, start, features, parameters, control, mine, tally, times, worker, moment):
    """Contacts of the discs that are too large for the grid, by worker 0 while the others wait. Returns the time."""
    if giants is not None:
        if worker == 0:
            mine[COLLISIONS] += resolve_giants(discs, start, features, parameters, control, tally, mine[FRAME])
            moment = record(times, mine, ODD, moment)
        moment = meet(control, mine, times, moment)
    return moment


@compiled
def step(front, back, start, outbox, features, parameters, control, team, sent, tally, times, worker):
    """One step of one worker from buffer `front` to buffer `back`. Returns RUNNING, or why to leave the loop."""
    mine = team[worker]
    moment = now(mine[CLOCK : CLOCK + 2])
    enter(mine, MOVE)
    if move(front, mine[LOW], mine[HIGH], features, parameters, control, mine, tally):
        bin_discs(front, mine[LOW], mine[HIGH], parameters, control)
        after_binning(front, mine[LOW], mine[HIGH], features, control)
        count_cells(front, start, outbox, sent[worker], team, worker, control)
    moment = record(times, mine, MOVE, moment)
    moment = meet(control, mine, times, moment)
    if control[BAD] != 0:
        return BAD_STATE
    if control[ABORT] != RUNNING:
        return control[ABORT]
    enter(mine, SORT)
    if worker == 0:
        control[STEPS] += 1
        before_step(features, parameters, control)
    slot, end = sort(front, back, start, outbox, team, sent, worker, control)
    moment = record(times, mine, SORT, moment)
    moment = meet(control, mine, times, moment)
    mine[LOW], mine[HIGH] = slot, end
    if control[GUARDED] == 0:
        # Neighbouring columns at the same time on different workers: the race of the report, on purpose.
        mine[COLLISIONS] += resolve_columns(
            back, start, worker, control[COLUMNS], control[WORKERS], features, control, parameters, tally, mine[FRAME]
        )
        moment = record(times, mine, EVEN, moment)
        meet(control, mine, times, moment)
        return control[ABORT]
    for turn in range(2 * control[PASSES]):
        parity = turn % 2
        enter(mine, EVEN + parity)
        first = mine[FIRST_COLUMN] + (mine[FIRST_COLUMN] + parity) % 2
        mine[COLLISIONS] += resolve_columns(
            back, start, first, mine[LAST_COLUMN], 2, features, control, parameters, tally, mine[FRAME]
        )
        moment = record(times, mine, EVEN + parity, moment)
        moment = meet(control, mine, times, moment)
        if parity == 1:
            moment = meet_giants(
                features.giants, back, start, features, parameters, control, mine, tally, times, worker, moment
            )
    return control[ABORT]


@inlined
def end_when_time_is_up(control, mine, started):
    """Make this frame the last of the command once it has run for SLICE. For worker 0, at the start of a frame.

    Everybody else compares with FRAMES after the barriers of this frame, or sees that this frame is still to be run.
    The time is that of the last look at the clock, so it costs nothing.
    """
    if mine[CLOCK] * 1_000_000_000 + mine[CLOCK + 1] - started > SLICE:
        control[FRAMES] = mine[FRAME] + 1


@compiled
def run_frames(front, back, start, outbox, features, parameters, control, team, sent, tally, times, worker):
    """All frames of one command, for one worker. Returns RUNNING if all frames were done."""
    mine = team[worker]
    mine[FRAME] = 0
    started = now(mine[CLOCK : CLOCK + 2])
    while mine[FRAME] < control[FRAMES]:
        if worker == 0:
            end_when_time_is_up(control, mine, started)
        for _ in range(control[SUBSTEPS]):
            outcome = step(front, back, start, outbox, features, parameters, control, team, sent, tally, times, worker)
            if outcome != RUNNING:
                return outcome
            front, back = back, front
        mine[FRAME] += 1
    if control[WORKERS] > 1:
        barrier(control, mine)  # nobody still writes its times when the coordinator continues
    if worker == 0:
        # In here rather than in Python, where Ctrl-C could come between the frames and the note of where they ended.
        control[LIVE] ^= (control[FRAMES] * control[SUBSTEPS]) & 1
        control[DONE] += control[FRAMES]
    mine[FRAME] = 0
    return control[ABORT]


@compiled
def run_grid(a, b, start, outbox, features, parameters, control, team, sent, tally, times, worker, linger):
    """Frames of `grid` (one worker) or `parallel`, for one worker.

    The coordinator, worker 0, gives the command and does its share of it; as that happens in here, nothing can come
    between the two. Any other worker runs commands as they come, until none has come for `linger` nanoseconds (IDLE)
    or a message waits (MAILED). control[LIVE] says which of the buffers a and b holds the state.
    times: int64 (frames, phases) and tally: int64 (frames, tallies) or None, of this worker, zero at first.
    Returns RUNNING, what ended the frames before their number was done, IDLE or MAILED.
    """
    mine = team[worker]
    while True:
        if worker == 0:
            if control[WORKERS] > 1:
                atomic_add(control, COMMAND, 1)
        else:
            if not await_command(control, mine, linger):
                return IDLE
            if atomic_load(control, COMMAND) == mine[COMMANDS]:
                return MAILED
            mine[COMMANDS] += 1
        front, back = a, b
        if control[LIVE] == 1:
            front, back = b, a
        outcome = run_frames(
            front, back, start, outbox, features, parameters, control, team, sent, tally, times, worker
        )
        if worker == 0 or outcome != RUNNING:
            return outcome


@compiled
def run_naive(discs, features, parameters, control, team, tally, times):
    """All frames of one command by testing all pairs i < j in index order. Returns RUNNING or BAD_STATE."""
    mine = team[0]
    count = control[COUNT]
    mine[FRAME] = 0
    started = now(mine[CLOCK : CLOCK + 2])
    while mine[FRAME] < control[FRAMES]:
        end_when_time_is_up(control, mine, started)
        for _ in range(control[SUBSTEPS]):
            moment = now(mine[CLOCK : CLOCK + 2])
            enter(mine, MOVE)
            if not move(discs, 0, count, features, parameters, control, mine, tally):
                return BAD_STATE
            moment = record(times, mine, MOVE, moment)
            control[STEPS] += 1
            before_step(features, parameters, control)
            enter(mine, EVEN)
            for _turn in range(control[PASSES]):
                mine[COLLISIONS] += resolve_all_pairs(discs, features, control, parameters, tally, mine[FRAME])
            record(times, mine, EVEN, moment)
        mine[FRAME] += 1
    control[DONE] += control[FRAMES]
    mine[FRAME] = 0
    return RUNNING
