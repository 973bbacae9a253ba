"""The arrays of the exact solver: what they hold, how large they are, how particles get in and out.

Plain numpy: nothing in this file is compiled. The caller owns every array (rows of `disc` should start on a multiple of
64 bytes, so that one disc is one cache line). Together they hold the whole state of a run: a copy is a checkpoint.
Discs are numbered inside by where they start in the box, so that neighbours lie close in memory; `order` maps
that number to the particle of the scene.
"""

import math
from collections import namedtuple

import numpy as np

# Outcomes.
REACHED, PAUSED, NOT_FINITE, STALLED, BACKWARDS, OUTSIDE, STOPPED = range(7)

# Columns of `disc` (float64): position and velocity at the time SINCE of the disc's own last event; the times of its
# next impact with a disc, of its next cell border or wall, and of its last contact.
X, Y, VX, VY, SINCE, IMPACT, BORDER, LAST = range(8)
# Columns of `event` (int32): the disc to be met, and how often that one had been deflected when the impact was
# predicted; how often this one has been; the side of the next border; the cell.
PARTNER, PARTNER_DEFLECTIONS, DEFLECTIONS, SIDE, COLUMN, ROW = range(6)
# Columns of `entry` (int32): neighbours in the list of a step; the place, a step or -2 - (position in the heap).
AFTER, BEFORE, PLACE = range(3)
# Entries of `clock` (float64): the present and the end of the lap, counted from BASE; the length of a step.
NOW, BASE, STEP, LAP = range(4)
# Entries of `counter` (int64). For the caller: the first six (impacts of pairs, hits of walls, losses suppressed by
# the guard, events of any kind, cell crossings, predictions renewed).
PAIRS, WALLS, GUARDS, EVENTS, CROSSINGS, RENEWALS, CURSOR, WAITING, LAP_EVENTS, STALL = range(10)
# Entries of `tally` (float64): impulse on each wall [mass length/time], sums of r.dp, x dp_x and x dp_y over impacts
# [mass length^2/time]. What is counted per frame has the pair impacts behind them.
LEFT, RIGHT, BOTTOM, TOP, VIRIAL, VIRIAL_XX, VIRIAL_XY = range(7)
TALLIES = 7
COUNTED = TALLIES + 1
# Entries of `progress` (int64), which a caller that plays frames keeps beside the store.
FRAME, SPENT = range(2)

# The box and its cells, plain numbers: width, height [length]; periodic_x, periodic_y bool; columns, rows of cells;
# radius [length] of every disc, if the scene does not give one for each.
Box = namedtuple("Box", "width height periodic_x periodic_y columns rows radius")

# What happens in flight and at an impact. gravity: (gx, gy) [length/time^2], restitution between discs and
# wall_restitution at walls: floats; each None when the scene lacks it, and then costs nothing. contact_time [time]
# is the guard; it must be > 0 with gravity or with any restitution below 1. friction of two discs and wall_friction:
# (coefficient, tangential restitution), or None likewise.
Law = namedtuple(
    "Law", "gravity restitution wall_restitution contact_time friction wall_friction", defaults=(None, None)
)

# The arrays of `layout`; the last five are None when the scene lacks the feature.
Store = namedtuple(
    "Store", "disc event entry cell_head cell_next step_head heap order clock counter radius mass tally winding spin"
)

OPTIONAL = ("radius", "mass", "tally", "winding", "spin")


def plan_cells(width, height, largest_diameter, count, periodic=(False, False)):
    """(columns, rows) of cells for a box [length], or None when a periodic axis is too short.

    A cell is at least one diameter wide, and in a dilute scene wide enough for about one disc in two cells. A
    periodic axis must hold two diameters, or a pair could touch on both sides at once.
    """
    if (periodic[0] and width < 2.0 * largest_diameter) or (periodic[1] and height < 2.0 * largest_diameter):
        return None
    roomy = math.sqrt(width * height / (2.0 * max(count, 1)))
    # A hair wider than a diameter: rounding must not let discs two cells apart touch.
    side = max(largest_diameter * (1.0 + 1e-9), roomy)
    most = max(2 * count, 4)
    return min(max(int(width / side), 1), most), min(max(int(height / side), 1), most)


def layout(count, cells, features=()):
    """The arrays a run needs: name -> (dtype, shape). The names are those of `Store`.

    count: discs. cells: (columns, rows). features: any of OPTIONAL, others are ignored.
    """
    steps = max(64, 1 << (2 * count - 1).bit_length())
    arrays = {
        "disc": (np.float64, (count, 8)),
        "event": (np.int32, (count, 8)),
        "entry": (np.int32, (count, 4)),
        "cell_head": (np.int32, (cells[0] * cells[1],)),
        "cell_next": (np.int32, (count,)),
        "step_head": (np.int32, (steps,)),
        "heap": (np.int32, (count,)),
        "order": (np.int32, (count,)),
        "clock": (np.float64, (4,)),
        "counter": (np.int64, (10,)),
        "radius": (np.float64, (count,)),
        "mass": (np.float64, (count,)),
        "tally": (np.float64, (TALLIES,)),
        "winding": (np.int64, (count, 2)),
        "spin": (np.float64, (count,)),
    }
    return {name: array for name, array in arrays.items() if name not in OPTIONAL or name in features}


def first_misplaced(position, velocity, radius, box):
    """The first particle that is not finite, faster than 1e100, or outside the box: (status, particle)."""
    good = np.isfinite(position).all(axis=1) & (np.abs(velocity) < 1e100).all(axis=1)
    if not good.all():
        return NOT_FINITE, int(np.argmin(good))
    for axis, (length, periodic) in enumerate(((box.width, box.periodic_x), (box.height, box.periodic_y))):
        low = 0.0 if periodic else radius
        slack = 1e-12 * length
        inside = (position[:, axis] >= low - slack) & (position[:, axis] <= length - low + slack)
        if not inside.all():
            return OUTSIDE, int(np.argmin(inside))
    return REACHED, -1


def place(position, velocity, radius, mass, time, store, box, spin=None):
    """Put particles into the store at `time`: (status, particle), REACHED or what is wrong with which particle.

    position [length], velocity [length/time]: (N, 2). radius [length], mass: (N,), or None as in the store; spin
    [1/time]: (N,), needed where the store has it.
    `events.schedule` must follow.
    """
    status, particle = first_misplaced(position, velocity, box.radius if radius is None else radius, box)
    if status != REACHED:
        return status, particle
    column = np.clip((position[:, 0] * (box.columns / box.width)).astype(np.int64), 0, box.columns - 1)
    row = np.clip((position[:, 1] * (box.rows / box.height)).astype(np.int64), 0, box.rows - 1)
    order = np.argsort(row * box.columns + column, kind="stable")
    for array in store:
        if array is not None:
            array[...] = 0
    store.order[:] = order
    store.disc[:, X : Y + 1] = position[order]
    store.disc[:, VX : VY + 1] = velocity[order]
    store.disc[:, LAST] = -math.inf
    store.event[:, COLUMN] = column[order]
    store.event[:, ROW] = row[order]
    if radius is not None:
        store.radius[:] = radius[order]
    if mass is not None:
        store.mass[:] = mass[order]
    if store.spin is not None and spin is not None:
        store.spin[:] = spin[order]
    store.clock[BASE] = time
    return REACHED, -1


def read_out(store, box, law, until, position, velocity, image=None):
    """Write positions, velocities and, where asked for, periods at time `until` into (N, 2) arrays.

    They are in the order of the particles. `until` is the time that `events.advance` has reached. The state is not
    touched.
    """
    disc = store.disc
    flight = (until - store.clock[BASE]) - disc[:, SINCE]
    radius = box.radius if store.radius is None else store.radius
    for axis, (length, periodic) in enumerate(((box.width, box.periodic_x), (box.height, box.periodic_y))):
        gain = 0.0 if law.gravity is None else law.gravity[axis] * flight
        flown = disc[:, X + axis] + flight * (disc[:, VX + axis] + 0.5 * gain)
        # Only rounding can have put a centre beyond a limit.
        place_now = np.mod(flown, length) if periodic else np.clip(flown, radius, length - radius)
        place_now[place_now == length] = 0.0 if periodic else length
        if image is not None and periodic:
            # Of a place that is not finite, or has no digit in the box, no period is counted.
            periods = np.rint((flown - place_now) / length)
            taken = np.where(np.abs(periods) < 2.0**53, periods, 0.0).astype(np.int64)
            image[store.order, axis] = store.winding[:, axis] + taken
        position[store.order, axis] = place_now
        velocity[store.order, axis] = disc[:, VX + axis] + gain
