"""Contacts: which discs overlap, and what a contact does to them."""

import math

from mpsim.kernels.compiling import compiled, inlined
from mpsim.kernels.layout import (
    COUNT,
    DIAMETER,
    ELASTIC,
    LAW,
    ROWS,
    X_HIGH,
    X_LOW,
    Y_HIGH,
    Y_LOW,
)
from mpsim.kernels.machine import LANES, lowest_bit, natural, overlap_lanes


@inlined
def resolve_contact(discs, i, j, parameters, law):
    """Contact `push` of two discs that overlap: each moves half the overlap away, then the velocities change.

    n is the unit vector from i to j. `elastic`: equal masses exchange their normal components if they approach,
    momentum and energy kept. `reflect` (the report's): each velocity is mirrored about the contact line, whether
    they approach or not. Centres at one point take n = (1, 0), so that the result is defined and never NaN.
    """
    x, y, vx, vy = discs.x, discs.y, discs.vx, discs.vy
    zero, one, two = x.dtype.type(0), x.dtype.type(1), x.dtype.type(2)
    nx = x[j] - x[i]
    ny = y[j] - y[i]
    distance = math.sqrt(nx * nx + ny * ny)
    if distance > zero:
        nx /= distance
        ny /= distance
    else:
        nx = one
        ny = zero
    shift = (parameters[DIAMETER] - distance) / two
    x[i] = clamp(x[i] - nx * shift, parameters[X_LOW], parameters[X_HIGH])
    y[i] = clamp(y[i] - ny * shift, parameters[Y_LOW], parameters[Y_HIGH])
    x[j] = clamp(x[j] + nx * shift, parameters[X_LOW], parameters[X_HIGH])
    y[j] = clamp(y[j] + ny * shift, parameters[Y_LOW], parameters[Y_HIGH])
    along_i = vx[i] * nx + vy[i] * ny
    along_j = vx[j] * nx + vy[j] * ny
    if law == ELASTIC:
        change_i = min(along_j - along_i, zero)
        change_j = -change_i
    else:
        change_i = -two * along_i
        change_j = -two * along_j
    vx[i] += change_i * nx
    vy[i] += change_i * ny
    vx[j] += change_j * nx
    vy[j] += change_j * ny


@inlined
def clamp(value, low, high):
    """The centre stays in the box: a push may not carry a disc through a wall."""
    return min(max(value, low), high)


@inlined
def resolve_range(discs, i, first, last, parameters, law):
    """Resolve disc i with each of the discs [first, last) that overlaps it when its turn comes. Returns how many.

    The same as testing one by one: after a contact has moved disc i, the lanes that follow are tested again.
    """
    x, y = discs.x, discs.y
    diameter_squared = parameters[DIAMETER] * parameters[DIAMETER]
    contacts = 0
    block = first
    while block < last:
        lanes = (1 << min(last - block, LANES)) - 1
        mask = overlap_lanes(x, y, block, x[i], y[i], diameter_squared) & lanes
        while mask != 0:
            lane = lowest_bit(mask)
            resolve_contact(discs, i, block + lane, parameters, law)
            contacts += 1
            lanes &= ~((2 << lane) - 1)
            mask = overlap_lanes(x, y, block, x[i], y[i], diameter_squared) & lanes
        block += LANES
    return contacts


@compiled
def resolve_column(discs, start, column, stride, parameters, law):
    """Contacts of one column with itself and with the next one. Returns how many.

    Both candidate ranges of a disc (own cell and the one above; three cells of the next column) are contiguous and
    nearly always shorter than a vector, so a disc costs two vector tests and one branch that is seldom taken.
    """
    x, y, cells = discs.x, discs.y, discs.cell
    diameter_squared = parameters[DIAMETER] * parameters[DIAMETER]
    contacts = 0
    for slot in range(start[column * stride], start[(column + 1) * stride]):
        i = natural(slot)
        cell = natural(cells[i])
        own_end = start[cell + 2]
        next_first = natural(start[natural(cell + stride - 1)])
        next_end = start[natural(cell + stride + 2)]
        own = own_end - i - 1
        others = next_end - next_first
        own_mask = overlap_lanes(x, y, i + 1, x[i], y[i], diameter_squared)
        next_mask = overlap_lanes(x, y, next_first, x[i], y[i], diameter_squared)
        own_mask &= (1 << min(own, LANES)) - 1
        next_mask &= (1 << min(others, LANES)) - 1
        if (own_mask | next_mask) != 0 or own > LANES or others > LANES:
            contacts += resolve_range(discs, i, i + 1, own_end, parameters, law)
            contacts += resolve_range(discs, i, next_first, next_end, parameters, law)
    return contacts


@compiled
def resolve_columns(discs, start, first, last, step, control, parameters):
    """Columns first, first + step, ... below last."""
    contacts = 0
    for column in range(first, last, step):
        contacts += resolve_column(discs, start, column, control[ROWS] + 2, parameters, control[LAW])
    return contacts


@compiled
def resolve_all_pairs(discs, control, parameters):
    """All pairs i < j in index order. Returns the number of contacts."""
    contacts = 0
    for i in range(control[COUNT]):
        contacts += resolve_range(discs, i, i + 1, control[COUNT], parameters, control[LAW])
    return contacts
