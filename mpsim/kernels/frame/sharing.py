"""How workers share a frame: phases, cells, and discs that move between them."""

from mpsim.kernels.compiling import inlined, linked
from mpsim.kernels.machine import RUN, copy_lanes, nonnegative, now
from mpsim.kernels.records import WAIT
from mpsim.kernels.waiting import barrier

# --- Discs copied from one place to another: one by one, in runs, or exchanged


@inlined
def copy_disc(source, i, target, slot):
    """Copy disc i to a slot of the other buffer."""
    target.x[slot] = source.x[i]
    target.y[slot] = source.y[i]
    target.vx[slot] = source.vx[i]
    target.vy[slot] = source.vy[i]
    target.id[slot] = source.id[i]
    target.cell[slot] = source.cell[i]
    copy_radius(source.radius, i, target.radius, slot)


@inlined
def copy_radius(source, i, target, slot):
    """Copy the radius too, if each disc has its own."""
    if source is not None:
        target[slot] = source[i]


@inlined
def copy_run(source, low, high, target, slot, end):
    """Copy the discs [low, high) to the slots from `slot` on.

    Copies whole vectors, so slots after the run, but none from `end` on, may be overwritten: write those later.
    """
    first, slot = nonnegative(low), nonnegative(slot)
    while first < high and slot + RUN <= end:
        copy_lanes(source.x, first, target.x, slot)
        copy_lanes(source.y, first, target.y, slot)
        copy_lanes(source.vx, first, target.vx, slot)
        copy_lanes(source.vy, first, target.vy, slot)
        copy_lanes(source.id, first, target.id, slot)
        copy_lanes(source.cell, first, target.cell, slot)
        _copy_radii(source.radius, first, target.radius, slot)
        first += RUN
        slot += RUN
    while first < high:
        copy_disc(source, first, target, slot)
        first += 1
        slot += 1


@inlined
def _copy_radii(source, first, target, slot):
    """Copy the radii too, if each disc has its own."""
    if source is not None:
        copy_lanes(source, first, target, slot)


@inlined
def swap_discs(discs, i, j):
    """Exchange two discs of one cell."""
    discs.x[i], discs.x[j] = discs.x[j], discs.x[i]
    discs.y[i], discs.y[j] = discs.y[j], discs.y[i]
    discs.vx[i], discs.vx[j] = discs.vx[j], discs.vx[i]
    discs.vy[i], discs.vy[j] = discs.vy[j], discs.vy[i]
    discs.id[i], discs.id[j] = discs.id[j], discs.id[i]
    _swap_radii(discs.radius, i, j)


@inlined
def _swap_radii(radius, i, j):
    """Exchange the radii of two discs, if each has its own."""
    if radius is not None:
        radius[i], radius[j] = radius[j], radius[i]


# --- The phases of a frame: which one a worker is in, how long each has taken, and the barrier between two


@linked
def add_time(times, mine, phase, since):
    """Add the time since `since` to a phase of the current frame. Returns the time now."""
    moment = now(mine.clock)
    times[mine.frame, phase] += moment - since
    return moment


@linked
def set_phase(mine, phase):
    """Record which phase this worker is in, for the message if it dies."""
    mine.phase = phase


@linked
def wait_for_all(control, mine, times, since):
    """Barrier that records its waiting time. Returns the time now, and the abort word."""
    if control.workers > 1:
        set_phase(mine, WAIT)
        barrier(control, mine)
        return add_time(times, mine, WAIT, since)
    return since


# --- Which worker has which cells, and the discs that move from one worker's columns to another's

FEW = 8
"""One disc in so many of a worker's slice may change its cell and be listed; where more do, the order is made anew."""


@inlined
def cells_of(team, worker, control):
    """First cell of a worker's columns and one past the last; the last member also has what lies beyond the grid."""
    stride = control.rows + 2
    if worker == control.members - 1:
        return team[worker].first_column * stride, control.cells
    return team[worker].first_column * stride, team[worker].last_column * stride


@inlined
def section_of(mine):
    """First place in the lists of `Changes` that belongs to a worker, and the number of its places."""
    return mine.low // FEW, mine.high // FEW - mine.low // FEW


@inlined
def send_if_outside(i, discs, outbox, sent, team, first_cell, last_cell, worker, control):
    """List disc i for the worker in whose cells it now lies, if that is another."""
    mine = team[worker]
    cell = discs.cell[i]
    if not first_cell <= cell < last_cell:
        outbox[mine.low + mine.outbox] = i
        mine.outbox += 1
        for other in range(control.members):
            first, last = cells_of(team, other, control)
            sent[other] += first <= cell < last


@linked
def list_emigrants(discs, changes, sent, team, worker, control):
    """List the discs that moved into another worker's columns; sent[w] says how many of them go to worker w.

    The list lies in the slice's own section of `outbox`.
    """
    mine = team[worker]
    first_cell, last_cell = cells_of(team, worker, control)
    sent[:] = 0
    mine.outbox = 0
    if mine.listed == 1:
        first, _ = section_of(mine)
        for k in range(first, first + mine.leavers):
            i = nonnegative(changes.slot[k])
            send_if_outside(i, discs, changes.outbox, sent, team, first_cell, last_cell, worker, control)
    else:
        for i in range(mine.low, mine.high):
            send_if_outside(nonnegative(i), discs, changes.outbox, sent, team, first_cell, last_cell, worker, control)
    mine.kept = mine.high - mine.low - mine.outbox


@inlined
def immigrants_of(sent, worker, control):
    """How many discs of other workers have moved into the columns of this one."""
    number = 0
    for other in range(control.members):
        number += sent[other, worker]
    return number


@linked
def first_slot_of(team, sent, worker, control):
    """First slot of a worker's discs after the sort: how many discs the workers before it will hold."""
    slot = 0
    for before in range(worker):
        slot += team[before].kept + immigrants_of(sent, before, control)
    return slot
