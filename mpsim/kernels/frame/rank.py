"""The step of one rank: the phases of `stepping.py` as calls, between which the ranks exchange discs.

A rank has a range of the columns of the grid. `start` has only these, and one more before them if the first is odd, so
that a column has the same parity as in the grid. The first member of the team is the rank itself;
the second stands for all other ranks: the discs that come from them are its slice, in the slots after those of the
rank.

The bracket of two columns that meet at the border of two ranks is resolved by both, in a grid of these two, with
the same bits, so nothing has to be sent back. The rank of its left column counts it.
"""

from mpsim.kernels.compiling import compiled, inlined, linked
from mpsim.kernels.features.edges import is_absent
from mpsim.kernels.features.hooks import prepare_next_step
from mpsim.kernels.frame.contacts import resolve_columns
from mpsim.kernels.frame.sorting import (
    add_time,
    begin_sort,
    cells_of,
    copy_disc,
    list_emigrants,
    move_and_bin,
    set_phase,
)
from mpsim.kernels.frame.stepping import resolve_inside
from mpsim.kernels.machine import now
from mpsim.kernels.records import EVEN, MOVE, NO_FRAME, ODD, SORT


@inlined
def pack_columns(radius, spin, image, i, disc, message, k):
    """Write to entry k of a message what only some scenes have of a disc, in slot i: radius, spin, image flags."""
    if radius is not None:
        message[k].radius = radius[i]
    if spin is not None:
        message[k].spin = spin[disc]
    if image is not None:
        message[k].image_x, message[k].image_y = image[0, disc], image[1, disc]


@inlined
def unpack_columns(message, k, radius, spin, image, i, disc):
    """Read what `pack_columns` writes."""
    if radius is not None:
        radius[i] = message[k].radius
    if spin is not None:
        spin[disc] = message[k].spin
    if image is not None:
        image[0, disc], image[1, disc] = message[k].image_x, message[k].image_y


@inlined
def first_cell_of_grid(control):
    """Number of the grid's first cell in the rank's own numbering."""
    return -control.columns_before * (control.rows + 2)


@inlined
def pack_disc(discs, i, first_cell, features, message, k):
    """Write disc i to entry k of a message, its cell counted from `first_cell`."""
    message[k].x, message[k].y = discs.x[i], discs.y[i]
    message[k].vx, message[k].vy = discs.vx[i], discs.vy[i]
    message[k].id = discs.id[i]
    message[k].cell = discs.cell[i] - first_cell
    pack_columns(discs.radius, features.spin, features.image, i, discs.id[i], message, k)


@inlined
def unpack_disc(message, k, first_cell, features, discs, i):
    """Read disc i from entry k of a message."""
    discs.x[i], discs.y[i] = message[k].x, message[k].y
    discs.vx[i], discs.vy[i] = message[k].vx, message[k].vy
    discs.id[i] = message[k].id
    discs.cell[i] = message[k].cell + first_cell
    unpack_columns(message, k, discs.radius, features.spin, features.image, i, message[k].id)


@linked
def do_move(front, back, changes, features, parameters, control, team, sent, tally, times):
    """The phase `move`."""
    mine = team[0]
    moment = now(mine.clock)
    set_phase(mine, MOVE)
    if move_and_bin(front, back, changes, features, parameters, control, mine, tally):
        list_emigrants(front, changes, sent[0], team, 0, control)
    add_time(times, mine, MOVE, moment)


@linked
def do_sort(front, back, start, changes, features, parameters, control, team, sent, tally, times):
    """The phase `sort`, and the part of both passes within columns in the cache."""
    mine = team[0]
    moment = now(mine.clock)
    set_phase(mine, SORT)
    control.steps += 1
    control.in_order = 1
    prepare_next_step(features, parameters, control)
    slot, end, merging = begin_sort(front, back, start, changes, team, sent, 0, control)
    moment = add_time(times, mine, SORT, moment)
    mine.even, mine.odd, moment = resolve_inside(
        front, back, start, changes, slot, end, merging, features, parameters, control, team, tally, times, 0, moment
    )
    start[mine.last_column * (control.rows + 2) + 1 :] = end  # the column after the last is empty
    control.live ^= 1
    mine.low, mine.high = slot, end


@linked
def do_even(discs, start, features, parameters, control, mine, tally, times):
    """The rest of the even pass."""
    rest = features, parameters, control, mine, tally, times
    resolve_columns(EVEN, mine.even, mine.stop, 2, discs, start, *rest, now(mine.clock))


@linked
def do_odd(discs, start, features, parameters, control, mine, tally, times):
    """The rest of the odd pass."""
    rest = features, parameters, control, mine, tally, times
    first = mine.first_column
    moment = resolve_columns(ODD, first, min(first + first % 2, mine.stop), 2, discs, start, *rest, now(mine.clock))
    resolve_columns(ODD, mine.odd, mine.stop, 2, discs, start, *rest, moment)
    mine.even = first + first % 2  # of the next pass
    mine.odd = mine.even + 1


@compiled
def run_part(a, b, start, changes, features, parameters, control, team, sent, tally, times):
    """The part of a step that `control` names; arguments as of `stepping.run_grid`.

    MOVE; SORT, with the even pass away from borders; EVEN, of a further pass; ODD, and the move of the next step if
    there is one. After SORT the state is in the other buffer. Contacts at borders come between.
    """
    parameters, control, mine = parameters[0], control[0], team[0]
    front, back = a, b
    if control.live == 1:
        front, back = b, a
    if control.part == SORT:
        do_sort(front, back, start, changes, features, parameters, control, team, sent, tally, times)
        do_even(back, start, features, parameters, control, mine, tally, times)
    elif control.part == EVEN:
        do_even(front, start, features, parameters, control, mine, tally, times)
    elif control.part == ODD:
        do_odd(front, start, features, parameters, control, mine, tally, times)
        if control.ahead != NO_FRAME:
            mine.frame = control.ahead
    if control.part == MOVE or (control.part == ODD and control.ahead != NO_FRAME):
        do_move(front, back, changes, features, parameters, control, team, sent, tally, times)


@compiled
def pack_emigrants(front, changes, features, control, team, message):
    """Write the discs that move to other ranks to a message, cells as in the grid. Returns their number.

    A disc that an edge has absorbed is not sent: `exits` says where it rests.
    """
    stride, mine = control.rows + 2, team[0]
    first_cell, last_cell = mine.first_column * stride, mine.last_column * stride
    count = 0
    for k in range(mine.low, mine.low + mine.outbox):
        i = changes.outbox[k]
        if not first_cell <= front.cell[i] < last_cell and not is_absent(features.exits, front.id[i]):
            pack_disc(front, i, first_cell_of_grid(control), features, message, count)
            count += 1
    return count


@compiled
def unpack_immigrants(message, arrived, front, changes, features, control, team, sent):
    """Append the discs of a message, cells as in the grid, to those of the rank, to be sorted with them."""
    courier, end = team[1], team[0].high
    courier.low, courier.high, courier.outbox = end, end + arrived, arrived
    sent[1, :] = 0
    first, last = cells_of(team, 0, control)
    for k in range(arrived):
        unpack_disc(message, k, first_cell_of_grid(control), features, front, end + k)
        changes.outbox[end + k] = end + k
        sent[1, 0] += first <= front.cell[end + k] < last


@compiled
def pack_own(discs, features, control, team, message):
    """Write all discs of the rank to a message, cells as in the grid."""
    for i in range(team[0].high):
        pack_disc(discs, i, first_cell_of_grid(control), features, message, i)


@compiled
def unpack_own(message, count, discs, features):
    """Replace all discs of the rank by those of a message, in any order."""
    for k in range(count):
        unpack_disc(message, k, 0, features, discs, k)


@compiled
def pack_column(discs, start, column, features, control, message):
    """Write the discs of a column to a message, cells counted from its first one."""
    stride = control.rows + 2
    first, last = start[column * stride], start[(column + 1) * stride]
    for i in range(first, last):
        pack_disc(discs, i, column * stride, features, message, i - first)


@inlined
def _starts_of(cells, count, first_cell, last_cell, start):
    """The starts of the cells (first_cell, last_cell] of sorted discs."""
    slot = 0
    for cell in range(first_cell, last_cell + 1):
        while slot < count and cells[slot] < cell:
            slot += 1
        start[cell] = slot


@compiled
def resolve_border(
    phase, discs, start, column, own_place, resolved, message, received, pair, pair_start, features, parameters,
    control, member, tally, times,
):  # fmt: skip
    """Resolve the bracket of an own column and a neighbour's, which is in the message, in the grid of these two.

    own_place: place of the own column there, 0 or 1. resolved: place of the column whose bracket it is: 0, or 1 through
    a periodic border. member, tally: count the contacts.
    """
    stride = control.rows + 2
    first, last = start[column * stride], start[(column + 1) * stride]
    own = last - first
    own_at, other_at = own_place * received, (1 - own_place) * own
    own_cell, other_cell = own_place * stride, (1 - own_place) * stride
    for i in range(own):
        copy_disc(discs, first + i, pair, own_at + i)
        pair.cell[own_at + i] += own_cell - column * stride
    for k in range(received):
        unpack_disc(message, k, other_cell, features, pair, other_at + k)
    _starts_of(pair.cell, own + received, 0, 3 * stride, pair_start)
    rest = features, parameters, control, member, tally, times
    resolve_columns(phase, resolved, resolved + 1, 1, pair, pair_start, *rest, now(member.clock))
    for i in range(own):
        discs.x[first + i], discs.y[first + i] = pair.x[own_at + i], pair.y[own_at + i]
        discs.vx[first + i], discs.vy[first + i] = pair.vx[own_at + i], pair.vy[own_at + i]
