"""Which worker has which cells, and the discs that move from one worker's columns to another's."""

from mpsim.kernels.compiling import inlined, linked
from mpsim.kernels.machine import nonnegative

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
