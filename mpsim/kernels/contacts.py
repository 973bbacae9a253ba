"""Contacts: which discs overlap, and what a contact does to them."""

import math

import numpy as np

from mpsim.kernels.compiling import compiled, inlined
from mpsim.kernels.layout import (
    COLLISION,
    CONTACT,
    COUNT,
    DEEPEST,
    DEPTH,
    DIAMETER,
    DT,
    ELASTIC,
    EXCHANGE,
    IMPACT,
    LAW,
    MET,
    ROWS,
    TALLY_SCALE,
    VIRIAL,
    X_HIGH,
    X_LOW,
    Y_HIGH,
    Y_LOW,
)
from mpsim.kernels.machine import LANES, lowest_bit, natural, overlap_lanes


@inlined
def normal(discs, i, j):
    """Unit vector from disc i to disc j, and their distance. Centres at one point give (1, 0): defined, never NaN."""
    one = discs.x.dtype.type(1)
    nx = discs.x[j] - discs.x[i]
    ny = discs.y[j] - discs.y[i]
    distance = math.sqrt(nx * nx + ny * ny)
    if distance == 0:
        return one, distance, distance
    return nx / distance, ny / distance, distance


@inlined
def shift(discs, i, dx, dy, parameters):
    """Move disc i by (dx, dy), but not through a wall."""
    discs.x[i] = min(max(discs.x[i] + dx, parameters[X_LOW]), parameters[X_HIGH])
    discs.y[i] = min(max(discs.y[i] + dy, parameters[Y_LOW]), parameters[Y_HIGH])


@inlined
def apply_law(discs, i, j, nx, ny, parameters, law):
    """Change the velocities of two discs in contact along the unit vector n from i to j.

    `elastic`: discs that approach part with e times their normal velocity, momentum kept (e = 1: energy too).
    `reflect` (the report's): each velocity is mirrored about the contact line, whether they approach or not.
    Returns the impulse, mass 1 [length/time] (for `reflect`, which has two of them, their mean).
    """
    vx, vy = discs.vx, discs.vy
    zero, two = vx.dtype.type(0), vx.dtype.type(2)
    along_i = vx[i] * nx + vy[i] * ny
    along_j = vx[j] * nx + vy[j] * ny
    if law == ELASTIC:
        approach = along_j - along_i
        change_i = approach * parameters[EXCHANGE] if approach < zero else zero
        change_j = -change_i
    else:
        change_i = -two * along_i
        change_j = -two * along_j
    vx[i] += change_i * nx
    vy[i] += change_i * ny
    vx[j] += change_j * nx
    vy[j] += change_j * ny
    return (abs(change_i) + abs(change_j)) / two


@inlined
def push_contact(discs, i, j, parameters, law):
    """Contact `push`: each disc moves half the overlap away, then the law acts along the normal found here.

    Returns the impulse.
    """
    nx, ny, distance = normal(discs, i, j)
    half = (parameters[DIAMETER] - distance) / discs.x.dtype.type(2)
    shift(discs, i, -nx * half, -ny * half, parameters)
    shift(discs, j, nx * half, ny * half, parameters)
    return apply_law(discs, i, j, nx, ny, parameters, law)


@inlined
def time_since_impact(discs, i, j, parameters):
    """Time since two overlapping discs touched, in free flight; negative if they do not approach.

    |r - u t| = D with r, u the relative position and velocity, b = r.u < 0 and c = r.r - D^2 < 0:
    t = (b + sqrt(b^2 - u.u c)) / u.u, which loses its digits where the overlap is small; its conjugate does not:
    t = -c / (sqrt(b^2 - u.u c) - b).
    """
    diameter = parameters[DIAMETER]
    rx = discs.x[j] - discs.x[i]
    ry = discs.y[j] - discs.y[i]
    ux = discs.vx[j] - discs.vx[i]
    uy = discs.vy[j] - discs.vy[i]
    b = rx * ux + ry * uy
    if not b < 0:
        return -diameter  # any negative number: there was no impact
    c = rx * rx + ry * ry - diameter * diameter
    return -c / (math.sqrt(b * b - (ux * ux + uy * uy) * c) - b)


@inlined
def impact_contact(discs, i, j, parameters, law):
    """Contact `impact`: back to the instant of contact, the law along the normal found there, and on again.

    Discs that do not approach, or that overlapped before this step, are pushed apart instead. Returns the impulse.
    """
    time = time_since_impact(discs, i, j, parameters)
    if not (time >= 0) & (time <= parameters[DT]):
        return push_contact(discs, i, j, parameters, law)
    for disc in (i, j):
        discs.x[disc] -= discs.vx[disc] * time
        discs.y[disc] -= discs.vy[disc] * time
    nx, ny, _ = normal(discs, i, j)
    impulse = apply_law(discs, i, j, nx, ny, parameters, law)
    for disc in (i, j):
        shift(discs, disc, discs.vx[disc] * time, discs.vy[disc] * time, parameters)
    return impulse


@inlined
def resolve_contact(discs, i, j, parameters, control, tally, frame):
    """Resolve two overlapping discs by the contact and the law of the run."""
    if tally is not None:
        tally_depth(discs, i, j, parameters, tally, frame)
    if control[CONTACT] == IMPACT:
        impulse = impact_contact(discs, i, j, parameters, control[LAW])
    else:
        impulse = push_contact(discs, i, j, parameters, control[LAW])
    if tally is not None:
        tally[frame, VIRIAL] += np.int64(impulse * np.float64(parameters[TALLY_SCALE]))
        tally[frame, COLLISION] += impulse > 0


@compiled
def tally_depth(discs, i, j, parameters, tally, frame):
    """Count a pair that is met and how deep it overlaps, as a part of the diameter."""
    _, _, distance = normal(discs, i, j)
    part = np.float64(1 - distance / parameters[DIAMETER])
    depth = np.int64(part * parameters[TALLY_SCALE])
    tally[frame, MET] += 1
    tally[frame, DEPTH] += depth
    tally[frame, DEEPEST] = max(tally[frame, DEEPEST], depth)


@inlined
def resolve_range(discs, i, first, last, parameters, control, tally, frame):
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
            resolve_contact(discs, i, block + lane, parameters, control, tally, frame)
            contacts += 1
            lanes &= ~((2 << lane) - 1)
            mask = overlap_lanes(x, y, block, x[i], y[i], diameter_squared) & lanes
        block += LANES
    return contacts


@inlined
def resolve_column(discs, start, column, stride, parameters, control, tally, frame):
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
            for first, last in ((i + 1, np.int64(own_end)), (next_first, np.int64(next_end))):
                contacts += resolve_range(discs, i, first, last, parameters, control, tally, frame)
    return contacts


@compiled
def resolve_columns(discs, start, first, last, step, control, parameters, tally, frame):
    """Columns first, first + step, ... below last."""
    contacts = 0
    for column in range(first, last, step):
        contacts += resolve_column(discs, start, column, control[ROWS] + 2, parameters, control, tally, frame)
    return contacts


@compiled
def resolve_all_pairs(discs, control, parameters, tally, frame):
    """All pairs i < j in index order. Returns the number of contacts."""
    contacts = 0
    for i in range(control[COUNT]):
        contacts += resolve_range(discs, i, i + 1, control[COUNT], parameters, control, tally, frame)
    return contacts
