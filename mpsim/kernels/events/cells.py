"""The box of the exact solver, its cells, the order of discs in memory, and its store."""

import math
from collections import namedtuple

import numpy as np

from mpsim.kernels.compiling import inlined, linked
from mpsim.kernels.events.calendar import reschedule, steps_for
from mpsim.kernels.events.features.edges import is_absent
from mpsim.kernels.events.features.hooks import swap_columns
from mpsim.kernels.events.features.properties import radius_of, through_border
from mpsim.kernels.events.flight import INFINITY
from mpsim.kernels.events.records import (
    BOTTOM,
    CLOCK,
    COUNTER,
    DISC,
    ENTRY,
    EVENT,
    MOST_NEAR,
    TALLY,
    TURN,
    counts,
    here_along,
    number_of_cell,
    place_along,
)
from mpsim.kernels.machine import nonnegative

# --- The box, and its boundaries: walls, or a periodic border along an axis
#
# Here is where a centre can be, what lies beyond a border, whether a border is a wall, and what happens to a disc that
# leaves through it. The impact on a wall is in impacts.py. An image is shifted along an axis, in position only:
# impacts.py passes on `box.periodic_x` and `box.periodic_y` by name. A boundary whose images differ in more than
# position must change that file too.

COARSE = 2.0**-20
"""Unit of a sum, in parts of a typical summand."""

Box = namedtuple(
    "Box",
    "width height periodic_x periodic_y columns rows radius impulse_unit virial_unit",
    defaults=(COARSE, COARSE),
)
"""width, height [length]; periodic_x, periodic_y: bool; columns, rows of cells; radius of every disc, if the scene does
not give one for each [length]; units of sums of impulses [mass length/time] and virials [mass length^2/time]."""


@inlined
def along(axis, box):
    """The box along an axis: (length, cells, whether it is periodic)."""
    if axis == 0:
        return box.width, box.columns, box.periodic_x
    return box.height, box.rows, box.periodic_y


@inlined
def range_in_cell(cell, cells, length, periodic, radius):
    """Along one axis, where the centre of a disc in a cell can be: (low, high), borders of the cell or walls."""
    cell_length = length / cells
    low = cell * cell_length
    high = (cell + 1) * cell_length
    if not periodic:
        low = max(low, radius)
        high = min(high, length - radius)
    return low, high


@inlined
def neighbour(cell, cells, length, periodic):
    """A cell that may lie beyond the box, along one axis: (the cell found there or -1, shift of its image)."""
    if cell < 0:
        return (cell + cells, -length) if periodic else (-1, 0.0)
    if cell >= cells:
        return (cell - cells, length) if periodic else (-1, 0.0)
    return cell, 0.0


@inlined
def is_wall(side, cell, box):
    """Whether the border of a cell at `side` is a wall."""
    axis = side >> 1
    _, cells, periodic = along(axis, box)
    return not periodic and cell[axis] == (cells - 1 if side & 1 else 0)


@inlined
def cell_beyond(i, axis, direction, store, box, features):
    """The cell that disc i enters upward (direction = 1) or downward (-1) along an axis.

    Through a periodic border, its centre enters on the opposite side.
    """
    length, cells, _ = along(axis, box)
    cell = store.event[i].cell[axis] + direction
    if cell < 0 or cell >= cells:
        cell -= direction * cells
        store.disc[i].position[axis] -= direction * length
        through_border(features.image, i, axis, direction)
    return cell


def brought_back(flown, radius, axis, box):
    """Positions [length] of shape (N,) along an axis inside the box, and by how many periods: (positions, periods)."""
    length, _, periodic = along(axis, box)
    if not periodic:  # only rounding can have put a centre beyond a limit
        return np.minimum(np.maximum(flown, radius), length - radius), 0
    inside = np.mod(flown, length)
    inside[inside == length] = 0.0
    # If a position is not finite, or has no digit in the box, no period is counted.
    periods = np.rint((flown - inside) / length)
    return inside, np.where(np.abs(periods) < 2.0**53, periods, 0.0).astype(np.int64)


# --- The cells of the exact solver: how many there are, the lists of their discs, and the search for overlaps


def plan_cells(width, height, largest_diameter, count):
    """(columns, rows) of cells for a box [length].

    A cell is at least one diameter wide, and in a dilute scene wide enough for about one disc in two cells. A
    periodic axis must be two diameters long, or a pair could touch on both sides at once; the scene ensures that.
    """
    roomy = math.sqrt(width * height / (2.0 * max(count, 1)))
    # Slightly wider than a diameter: rounding must not let discs two cells apart touch.
    cell_length = max(largest_diameter * (1.0 + 1e-9), roomy)
    most = max(2 * count, 4)
    return min(max(int(width / cell_length), 1), most), min(max(int(height / cell_length), 1), most)


@inlined
def cell_of(i, store, box):
    """Number of the cell that disc i is in; -1 if it is not in this store."""
    cell = store.event[i].cell
    return number_of_cell(place_along(0, cell[0], store.region, box), cell[1], store.region, box)


@inlined
def particle_of(i, store):
    """The particle of the scene that disc i is."""
    return store.order[store.event[i].number]


@inlined
def leave_list(i, cell, store):
    """Remove disc i from the list of its cell, if the cell is in this store."""
    if cell < 0:
        return
    j = store.cell_head[cell]
    if j == i:
        store.cell_head[cell] = store.cell_next[i]
        return
    while store.cell_next[j] != i:
        j = store.cell_next[j]
    store.cell_next[j] = store.cell_next[i]


@inlined
def enter_list(i, cell, store):
    """Add disc i to the list of a cell, if the cell is in this store."""
    if cell < 0:
        return
    store.cell_next[i] = store.cell_head[cell]
    store.cell_head[cell] = i


@inlined
def cross(i, side, store, box, features):
    """Cell crossing: disc i, whose stored state is current, enters the cell beyond that border."""
    axis = side >> 1
    direction = 1 if side & 1 else -1
    leave_list(i, cell_of(i, store, box), store)
    store.event[i].cell[axis] = cell_beyond(i, axis, direction, store, box, features)
    enter_list(i, cell_of(i, store, box), store)
    store.counter.crossings += counts(store.region)


@inlined
def leave_store(i, store):
    """Disc i has left the region of a store: no disc meets it any more, and it has no further event."""
    store.disc[i].collision_time = store.disc[i].crossing_time = INFINITY
    store.event[i].collision_count += 1
    reschedule(i, store)


@inlined
def block_to_search(i, side, event):
    """The cells to search for disc i: (first column, last column, first row, last row).

    The nine cells around it; right after it has crossed to `side` (-1: it has not) only the three ahead are new.
    """
    column = event[i].cell[0]
    row = event[i].cell[1]
    if side < 0:
        return column - 1, column + 1, row - 1, row + 1
    direction = 1 if side & 1 else -1
    if side < BOTTOM:
        return column + direction, column + direction, row - 1, row + 1
    return column - 1, column + 1, row + direction, row + direction


@inlined
def is_inside(i, store, box):
    """Whether disc i's cell has cells on all sides that are in this store, none of them through a border."""
    cell, region = store.event[i].cell, store.region
    column, row = place_along(0, cell[0], region, box), place_along(1, cell[1], region, box)
    in_store = (column >= 1) & (column < here_along(0, region, box) - 1) & (row >= 1)
    in_store &= row < here_along(1, region, box) - 1
    in_box = (cell[0] >= 1) & (cell[0] < box.columns - 1) & (cell[1] >= 1) & (cell[1] < box.rows - 1)
    return in_store & in_box


@inlined
def gather(first, columns, rows, store, box):
    """Write the discs of a block of cells, from number `first` on, into `store.near`. Returns how many, or MOST_NEAR.

    Whether a cell is empty is unpredictable, so no branch tests it.
    """
    near, found, cell = store.near, 0, first
    for _ in range(columns):
        for row in range(rows):
            i = store.cell_head[nonnegative(cell + row)]
            near[nonnegative(found)] = i
            found += i >= 0
        cell += here_along(1, store.region, box)
    read = 0
    while read < found < MOST_NEAR:
        i = store.cell_next[nonnegative(np.int64(near[nonnegative(read)]))]
        near[nonnegative(found)] = i
        found += i >= 0
        read += 1
    return found


@linked
def link_cells(store, box, features):
    """Enter every disc of a newly placed scene in the list of its cell."""
    store.cell_head[:] = -1
    store.cell_next[:] = -1
    for i in range(store.disc.shape[0]):
        if not is_absent(features.exits, i):
            enter_list(i, cell_of(i, store, box), store)


@linked
def enter_absent(store, box, features):
    """Also enter the discs that have left, in the lists of the cells where they left, so that none is omitted.

    No event may be processed after this until `link_cells`.
    """
    for i in range(store.disc.shape[0]):
        if is_absent(features.exits, i):
            enter_list(i, cell_of(i, store, box), store)


@linked
def deepest_overlap(store, box, features):
    """The deepest overlap of a newly placed scene: (particle, particle, depth [length]); (-1, -1, 0.0) for none.

    Linear in the number of discs: in a scene too crowded for that, the search stops with the worst so far.
    """
    link_cells(store, box, features)
    disc = store.disc
    worst = 0.0
    pair = (-1, -1)
    tests = 0
    for i in range(disc.shape[0]):
        if is_absent(features.exits, i):
            continue
        ri = radius_of(i, box, features)
        first_column, last_column, first_row, last_row = block_to_search(i, -1, store.event)
        for column_ahead in range(first_column, last_column + 1):
            column, shift_x = neighbour(column_ahead, box.columns, box.width, box.periodic_x)
            for row_ahead in range(first_row, last_row + 1):
                row, shift_y = neighbour(row_ahead, box.rows, box.height, box.periodic_y)
                j = store.cell_head[column * box.rows + row] if row >= 0 and column >= 0 else -1
                while j >= 0:
                    rx = (disc[j].position[0] - disc[i].position[0]) + shift_x
                    ry = (disc[j].position[1] - disc[i].position[1]) + shift_y
                    depth = ri + radius_of(j, box, features) - math.sqrt(rx * rx + ry * ry)
                    if j != i and depth > worst:
                        worst = depth
                        pair = (particle_of(i, store), particle_of(j, store))
                    tests += 1
                    j = store.cell_next[j]
        if tests > 1_000_000 + 200 * disc.shape[0] and worst > 0.0:
            break
    return min(pair), max(pair), worst


# --- The order of discs in memory: that of their cells, so that neighbours share cache lines and pages
#
# No result depends on it: equal times are ordered by the number of the disc, which it keeps. The order degrades slowly
# as discs move; if all of them fit in the cache, it does not matter.

FEWEST = 16_384
"""Discs up to which a scene stays as it is: they fit the cache in any order."""

DISORDER = 0.2
"""Discs that lie before one of a cell to the left or below, in parts of all, from which on they are ordered anew."""


@inlined
def is_disordered(store, box):
    """Whether many discs lie far from their neighbours."""
    count = store.disc.shape[0]
    if count <= FEWEST:
        return False
    descents, last = 0, -1
    for i in range(count):
        cell = cell_of(i, store, box)
        descents += cell < last
        last = cell
    return descents > DISORDER * count


@inlined
def list_targets(store):
    """Write into the empty heap the place of each disc in the order of the cells, absent discs last."""
    store.heap[:] = -1
    place = 0
    for cell in range(store.cell_head.size):
        i = store.cell_head[cell]
        while i >= 0:
            store.heap[i] = place
            place += 1
            i = store.cell_next[i]
    for i in range(store.heap.size):
        if store.heap[i] < 0:
            store.heap[i] = place
            place += 1


@inlined
def swap_discs(one, other):
    """Swap two records of DISC."""
    for axis in range(2):
        one.position[axis], other.position[axis] = other.position[axis], one.position[axis]
        one.velocity[axis], other.velocity[axis] = other.velocity[axis], one.velocity[axis]
    one.last_update, other.last_update = other.last_update, one.last_update
    one.collision_time, other.collision_time = other.collision_time, one.collision_time
    one.crossing_time, other.crossing_time = other.crossing_time, one.crossing_time
    one.last_contact, other.last_contact = other.last_contact, one.last_contact


@inlined
def swap_events(one, other):
    """Swap two records of EVENT."""
    one.partner, other.partner = other.partner, one.partner
    one.partner_collision_count, other.partner_collision_count = (
        other.partner_collision_count,
        one.partner_collision_count,
    )
    one.collision_count, other.collision_count = other.collision_count, one.collision_count
    one.side, other.side = other.side, one.side
    one.number, other.number = other.number, one.number
    for axis in range(2):
        one.cell[axis], other.cell[axis] = other.cell[axis], one.cell[axis]


@inlined
def put_at_targets(store, features):
    """Put each disc at its place, which the heap holds. Cell lists and calendar must then be rebuilt."""
    target = store.heap
    for i in range(target.size):
        while target[i] != i:
            j = target[i]
            swap_discs(store.disc[i], store.disc[j])
            swap_events(store.event[i], store.event[j])
            swap_columns(features, i, j)
            target[i], target[j] = target[j], j


@linked
def order_in_space(store, box, features):
    """Put the discs in the order of their cells. The calendar must then be refilled."""
    list_targets(store)
    event = store.event
    for i in range(store.heap.size):
        if event[i].partner >= 0:
            event[i].partner = store.heap[event[i].partner]
    put_at_targets(store, features)
    link_cells(store, box, features)


# --- The arrays of the exact solver: their sizes, and how particles are put in and read out
#
# Plain numpy: nothing in this file is compiled. The caller owns every array (`disc` should start on a multiple of 64
# bytes, so that one disc is one cache line). Together they hold the whole state of a run: a copy is a checkpoint.
# Discs are numbered inside by where they start in the box; `order` maps that number, `event.number`, to the particle
# of the scene. In memory they start in that order, and are reordered as they move.

Store = namedtuple(
    "Store", "disc event entry cell_head cell_next step_head heap near approach order clock counter tally region turn"
)
"""The arrays and records of `layout`; and the `region`, of a tile, None where the whole box is here."""

KEPT = ("disc", "event", "order", "clock", "counter", "tally")
"""Those that a copy of the state needs; the others follow from them, and from the box."""


def layout(count, cells):
    """The arrays for a run of so many discs: name -> (dtype, shape); shape () is a record. cells: (columns, rows)."""
    return {
        "disc": (DISC, (count,)),
        "event": (EVENT, (count,)),
        "entry": (ENTRY, (count,)),
        "cell_head": (np.int32, (cells[0] * cells[1],)),
        "cell_next": (np.int32, (count,)),
        "step_head": (np.int32, (steps_for(count),)),
        "heap": (np.int32, (count,)),
        "near": (np.int32, (MOST_NEAR + 1,)),
        "approach": (np.float64, (MOST_NEAR + 1, 3)),
        "order": (np.int32, (count,)),
        "clock": (CLOCK, ()),
        "counter": (COUNTER, ()),
        "tally": (TALLY, ()),
        "turn": (TURN, ()),
    }


def store_of(arrays):
    """The store of the whole box, from arrays and records by name."""
    return Store(**{name: arrays.get(name) for name in Store._fields})


def place(position, velocity, columns, time, store, box, features):
    """Put particles, which are in the box, into the store at `time`. `solver.SCHEDULE` must follow.

    position [length], velocity [length/time]: (N, 2). columns: of the arrays of `features`, by name, in the order of
    the particles.
    """
    column = np.clip((position[:, 0] * (box.columns / box.width)).astype(np.int64), 0, box.columns - 1)
    row = np.clip((position[:, 1] * (box.rows / box.height)).astype(np.int64), 0, box.rows - 1)
    order = np.argsort(row * box.columns + column, kind="stable")
    for name in layout(0, (1, 1)):
        np.asarray(getattr(store, name))[...] = 0
    store.order[:] = order
    store.disc["position"] = position[order]
    store.disc["velocity"] = velocity[order]
    store.disc["last_contact"] = -math.inf
    store.event["number"] = np.arange(len(order))
    store.event["cell"] = np.stack([column[order], row[order]], axis=1)
    for name, values in columns.items():
        getattr(features, name)[:] = values[order]
    store.clock.origin = time


def read_out(store, box, features, until, columns=()):
    """Position, velocity and these columns at time `until`, by name, in the order of the particles.

    `until` is the time that `solver.advance` has reached. The state is not touched.
    """
    place = np.empty_like(store.order)
    place[store.order[store.event["number"]]] = np.arange(len(place))
    disc = store.disc.take(place)
    flight = (until - store.clock.origin) - disc["last_update"]
    if features.exits is not None:
        flight[features.exits[place, 0] != 0] = 0.0
    radius = box.radius if features.radius is None else features.radius[place]
    found = {name: getattr(features, name)[place] for name in columns}
    found |= {"position": np.empty((len(disc), 2)), "velocity": np.empty((len(disc), 2))}
    for axis in range(2):
        speed = disc["velocity"][:, axis]
        gain = 0.0 if features.gravity is None else features.gravity[axis] * flight
        flown = disc["position"][:, axis] + flight * (speed + 0.5 * gain)
        found["position"][:, axis], periods = brought_back(flown, radius, axis, box)
        found["velocity"][:, axis] = speed + gain
        if "image" in found:
            found["image"][:, axis] += periods
    return found
