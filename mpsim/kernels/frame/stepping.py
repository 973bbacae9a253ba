"""The stepped solvers: one frame, and many frames in one call.

A step of the grid has four phases, and a fifth where there are giants. W workers own contiguous ranges of columns,
chosen so that all take about equally long; the discs of a worker's columns are one contiguous slice of the arrays.

    move   own slice: v += a dt, p += v dt, walls, cell; list the discs that changed cells, and that left own columns
    ------------------------------------------------------------------------------------------------- barrier
    sort   own columns: the discs into the other buffer, in the order (column, row, id);
           contacts of own columns among themselves, even and odd, column c with itself and with column c + 1
           (before these, a barrier where a wall moves, as worker 0 moves it)
    ------------------------------------------------------------------------------------------------- barrier
    even   own last column, if it is even: with a neighbour's first
    ------------------------------------------------------------------------------------------------- barrier
    odd    own odd columns that had to wait for a neighbour's even one
    ------------------------------------------------------------------------------------------------- barrier
    giants discs that are too large for the grid, if there are any: worker 0 alone
    ------------------------------------------------------------------------------------------------- barrier

With `passes` above 1, the last three are repeated that many times. A frame has `substeps` steps.

Why the passes need no lock, and why workers cannot change the result:

    column      0     1     2     3     4     5          a disc looks at          +---+---+
    even pass  [0 --> 1]   [2 --> 3]   [4 --> 5]         the later discs of its   | 2 | 5 |
    odd pass         [1 --> 2]   [3 --> 4]   [5 -->      own cell (1), and at     +---+---+
                                                         the cells 2 to 5:        | 1 | 4 |
    in one pass the brackets are disjoint, so every                               +---+---+
    order of the columns, on any worker, is the same                                  | 3 |
                                                                                      +---+

Inside a column, the order is that of the sorted discs, a function of positions and ids alone. So a frame depends only
on the state in particle order: neither on the workers, nor on the memory order left by earlier frames.
"""

from mpsim.kernels.compiling import compiled, inlined, linked
from mpsim.kernels.features.collisions import next_span
from mpsim.kernels.features.hooks import prepare_next_step
from mpsim.kernels.frame.contacts import resolve_all_pairs, resolve_columns, resolve_giants
from mpsim.kernels.frame.motion import move
from mpsim.kernels.frame.sorting import (
    add_time,
    begin_sort,
    first_cursor,
    list_emigrants,
    merge_up_to,
    move_and_bin,
    set_phase,
    wait_for_all,
)
from mpsim.kernels.machine import now
from mpsim.kernels.records import ABORT, BAD, BAD_STATE, EVEN, MOVE, ODD, RUNNING, SLICE, SORT
from mpsim.kernels.waiting import barrier, next_command

# --- The even and the odd pass over the columns of a worker
#
# An odd column c only requires that columns c - 1 and c + 1 have had the even pass; it need not wait for all others.
# So a worker takes a few of its columns at a time through the end of the sort and both passes, while their discs are
# in the cache. Only the columns next to those of a neighbour remain: an even last one, and the odd ones beside a
# column that a neighbour's even pass changes. They have their passes after barriers (`stepping.py`).

AT_ONCE = 4096
"""Discs of the columns that are taken through sort and passes together: some 200 kB of both buffers in float32."""


@linked
def resolve_inside(
    front, back, start, changes, slot, end, merging, features, parameters, control, team, tally, times, worker, moment
):
    """The part of both passes within own columns, and before it the merge, if the sort has left one to do.

    slot, end: the slice of the worker in `back`. Returns the columns where the passes continue, and the time.
    """
    mine = team[worker]
    first, last = mine.first_column, mine.last_column
    even = first + first % 2
    odd = even + 1
    cursor = first_cursor(team, worker, control, slot)
    width = max(2, AT_ONCE * (last - first) // max(end - slot, 1))
    rest = features, parameters, control, mine, tally, times
    # At least once, for a last worker without columns, which has the discs outside the grid.
    for column in range(first + width, max(last, first + 1) + width, width):
        stop = min(column, last)
        if merging:
            set_phase(mine, SORT)
            cursor = merge_up_to(stop, cursor, front, back, start, changes, team, worker, control, end)
            moment = add_time(times, mine, SORT, moment)
        if control.race_free == 1:
            moment = resolve_columns(EVEN, even, stop - 1, 2, back, start, *rest, moment)
            even += 2 * max(0, (stop - even) // 2)  # the first that is left
            moment = resolve_columns(ODD, odd, even - 1, 2, back, start, *rest, moment)
            odd += 2 * max(0, (even - odd) // 2)
    return even, odd, moment


@inlined
def contacts_of_giants(giants, discs, start, features, parameters, control, mine, tally, times, worker, moment):
    """Contacts of the discs that are too large for the grid, by worker 0 while the others wait. Returns the time."""
    if giants is not None:
        if worker == 0:
            mine.collisions += resolve_giants(discs, start, features, parameters, control, tally, mine.frame)
            moment = add_time(times, mine, ODD, moment)
        moment = wait_for_all(control, mine, times, moment)
    return moment


@inlined
def wait_for_walls(moving_wall, control, mine, times, moment):
    """If a wall moves, all wait until worker 0 has moved it: contacts read its place. Returns the time."""
    if moving_wall is None:
        return moment
    return wait_for_all(control, mine, times, moment)


@linked
def step(front, back, start, changes, features, parameters, control, team, sent, tally, times, worker):
    """One step of one worker, from buffer `front` to buffer `back`. Returns RUNNING, or why to leave the loop."""
    mine = team[worker]
    moment = now(mine.clock)
    set_phase(mine, MOVE)
    next_span(features.log)
    if move_and_bin(front, back, changes, features, parameters, control, mine, tally):
        list_emigrants(front, changes, sent[worker], team, worker, control)
    moment = add_time(times, mine, MOVE, moment)
    moment = wait_for_all(control, mine, times, moment)
    if control.signals[BAD] != 0:
        return BAD_STATE
    if control.signals[ABORT] != RUNNING:
        return control.signals[ABORT]
    set_phase(mine, SORT)
    if worker == 0:
        control.steps += 1
        control.in_order = 1  # for the next step: this one has read it while it moved
        prepare_next_step(features, parameters, control)
    slot, end, merging = begin_sort(front, back, start, changes, team, sent, worker, control)
    moment = add_time(times, mine, SORT, moment)
    moment = wait_for_walls(features.moving_wall, control, mine, times, moment)
    even, odd, moment = resolve_inside(
        front, back, start, changes, slot, end, merging, features, parameters, control, team, tally, times, worker,
        moment,
    )  # fmt: skip
    moment = wait_for_all(control, mine, times, moment)
    mine.low, mine.high = slot, end
    first, last = mine.first_column, mine.last_column
    rest = features, parameters, control, mine, tally, times
    if control.race_free == 0:
        # Neighbouring columns at the same time on different workers: the race of the report, intentionally.
        moment = resolve_columns(EVEN, worker, control.columns, control.workers, back, start, *rest, moment)
        wait_for_all(control, mine, times, moment)
        return control.signals[ABORT]
    for _ in range(control.passes):
        moment = resolve_columns(EVEN, even, last, 2, back, start, *rest, moment)
        moment = wait_for_all(control, mine, times, moment)
        # A first column that is odd meets an even one of a neighbour.
        moment = resolve_columns(ODD, first, min(first + first % 2, last), 2, back, start, *rest, moment)
        moment = resolve_columns(ODD, odd, last, 2, back, start, *rest, moment)
        moment = wait_for_all(control, mine, times, moment)
        moment = contacts_of_giants(
            features.giants, back, start, features, parameters, control, mine, tally, times, worker, moment
        )
        even = first + first % 2
        odd = even + 1
    return control.signals[ABORT]


@inlined
def end_when_time_is_up(control, mine, started):
    """Make this frame the last of the command once the command has run for SLICE. By worker 0, at the start of a frame.

    The other workers compare with `control.frames` after the barriers of this frame, or see that this frame is still to
    be run.
    It uses the time of the last clock reading, so it costs nothing.
    """
    seconds, nanoseconds = mine.clock[0], mine.clock[1]
    if seconds * 1_000_000_000 + nanoseconds - started > SLICE:
        control.frames = mine.frame + 1


@linked
def run_frames(front, back, start, changes, features, parameters, control, team, sent, tally, times, worker):
    """All frames of one command, for one worker. Returns RUNNING if all frames were done."""
    mine = team[worker]
    mine.frame = 0
    started = now(mine.clock)
    while mine.frame < control.frames:
        if worker == 0:
            end_when_time_is_up(control, mine, started)
        for _ in range(control.substeps):
            outcome = step(front, back, start, changes, features, parameters, control, team, sent, tally, times, worker)
            if outcome != RUNNING:
                return outcome
            front, back = back, front
        mine.frame += 1
    if control.workers > 1:
        barrier(control, mine)  # no worker still writes its times when the coordinator continues
    if worker == 0:
        # Here rather than in Python, where Ctrl-C could come between the frames and the record of where they ended.
        control.live ^= (control.frames * control.substeps) & 1
        control.done += control.frames
    mine.frame = 0
    return control.signals[ABORT]


@compiled
def run_grid(a, b, start, changes, features, parameters, control, team, sent, tally, times, worker, linger):
    """Frames of `grid` (one worker) or `parallel`, for one worker.

    The coordinator, worker 0, gives the command and does its share of it; as both happen in here, nothing can come
    between them. Any other worker runs commands as they come, until none has come for `linger` nanoseconds (IDLE)
    or a message waits (MAILED). control.live says which of the buffers a and b holds the state.
    times: int64 (frames, phases) and tally: TALLY (frames,), of this worker, zero at first. parameters, control: arrays
    of one record.
    Returns RUNNING, what ended the frames before their number was done, IDLE or MAILED.
    """
    parameters, control, mine = parameters[0], control[0], team[worker]
    while True:
        heard = next_command(control, mine, worker, linger)
        if heard != RUNNING:
            return heard
        front, back = a, b
        if control.live == 1:
            front, back = b, a
        outcome = run_frames(
            front, back, start, changes, features, parameters, control, team, sent, tally, times, worker
        )
        if worker == 0 or outcome != RUNNING:
            return outcome


@compiled
def run_naive(discs, features, parameters, control, team, tally, times):
    """All frames of one command by testing all pairs i < j in index order. Returns RUNNING or BAD_STATE."""
    parameters, control, mine = parameters[0], control[0], team[0]
    count = control.count
    mine.frame = 0
    started = now(mine.clock)
    while mine.frame < control.frames:
        end_when_time_is_up(control, mine, started)
        for _ in range(control.substeps):
            moment = now(mine.clock)
            set_phase(mine, MOVE)
            next_span(features.log)
            if not move(discs, 0, count, features, parameters, control, mine, tally):
                return BAD_STATE
            moment = add_time(times, mine, MOVE, moment)
            control.steps += 1
            prepare_next_step(features, parameters, control)
            set_phase(mine, EVEN)
            for _turn in range(control.passes):
                mine.collisions += resolve_all_pairs(discs, features, parameters, control, tally, mine.frame)
            add_time(times, mine, EVEN, moment)
        mine.frame += 1
    control.done += control.frames
    mine.frame = 0
    return RUNNING
