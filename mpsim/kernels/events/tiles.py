"""Tiles: rectangles of cells that are simulated separately, each with a halo of the cells around it.

A tile is loaded from the store of the whole box into one of its own, with all discs of the `halo` cells around it, and
played up to the end of a window. The error from what is missing beyond the halo spreads inward by a few diameters. So
the events are compared along each border of two tiles (watch.py): if both found the same in the band there, each is
right in its own cells, and its own discs are the new state of the box. If not, the window is played again (windows.py).

Between windows a tile's discs lie together in the store, column by column, and partners are named by number.
"""

from mpsim.kernels.collision_log import begin_span, overflows
from mpsim.kernels.compiling import inlined, linked
from mpsim.kernels.events.boundary import along
from mpsim.kernels.events.calendar import begin_turn_until, due, earliest
from mpsim.kernels.events.cells import enter_absent, link_cells
from mpsim.kernels.events.features.hooks import copy_columns
from mpsim.kernels.events.flight import INFINITY
from mpsim.kernels.events.records import (
    BANDS,
    FULL,
    INNER_HIGH,
    INNER_LOW,
    NOT_FINITE,
    REACHED,
    STALLED,
    add_tally,
    clear_tally,
    elsewhere,
    number_of_partner,
    place_along,
)
from mpsim.kernels.events.solver import process_event, stalled

MOST_AT_ONCE = 10_000
"""Events without time passing, beside some for each disc, after which a tile is given up. One worker for all goes on
from there, and alone says whether they end; while they do not, tiles are tried again and again."""


@linked
def set_region(region, tile, plan, box):
    """Write the region of a tile with its halo."""
    region.counts = 1
    for axis in range(2):
        _, cells, periodic = along(axis, box)
        region.own[axis] = tile.own[axis]
        region.differs[axis] = plan.tiles[axis] > 1
        if plan.tiles[axis] == 1:
            region.first[axis], region.here[axis], region.own_first[axis] = 0, cells, 0
        else:
            low, high = tile.own_first[axis] - plan.halo, tile.own_first[axis] + tile.own[axis] + plan.halo
            if not periodic:
                low, high = max(low, 0), min(high, cells)
            region.own_first[axis] = tile.own_first[axis] - low
            region.here[axis] = high - low
            region.first[axis] = low + cells if low < 0 else low


@inlined
def copy_disc(source, target):
    """Copy a record of DISC."""
    for axis in range(2):
        target.position[axis] = source.position[axis]
        target.velocity[axis] = source.velocity[axis]
    target.last_update = source.last_update
    target.collision_time = source.collision_time
    target.crossing_time = source.crossing_time
    target.last_contact = source.last_contact


@inlined
def copy_event(source, target):
    """Copy a record of EVENT."""
    target.partner = source.partner
    target.partner_collision_count = source.partner_collision_count
    target.collision_count = source.collision_count
    target.side = source.side
    target.number = source.number
    for axis in range(2):
        target.cell[axis] = source.cell[axis]


@inlined
def tile_beyond(axis, tile, ahead, plan, box):
    """The tile that many places further along an axis, or -1."""
    tiles, other = plan.tiles[axis], tile + ahead
    _, _, periodic = along(axis, box)
    if 0 <= other < tiles:
        return other
    return other % tiles if periodic and tiles > 1 else -1


@inlined
def neighbour_tile(axis, tile, ahead, plan, box):
    """The same, but only once if one tile lies on both sides."""
    _, _, periodic = along(axis, box)
    if periodic and plan.tiles[axis] == 2 and ahead < 0:
        return -1
    return tile_beyond(axis, tile, ahead, plan, box)


@inlined
def load_from(tile, count, whole, features, own, own_features, box):
    """Append to a store the discs of a tile that lie in its region. Returns the number of discs then."""
    for i in range(tile.first, tile.first + tile.count):
        cell = whole.event[i].cell
        if place_along(0, cell[0], own.region, box) >= 0 and place_along(1, cell[1], own.region, box) >= 0:
            copy_disc(whole.disc[i], own.disc[count])
            copy_event(whole.event[i], own.event[count])
            copy_columns(features, i, own_features, count)
            count += 1
    return count


@linked
def load(number, tiles, plan, whole, features, own, own_features, box):
    """Load a tile with its halo. Returns the number of discs."""
    set_region(own.region, tiles[number], plan, box)
    column, row = number // plan.tiles[1], number % plan.tiles[1]
    count = 0
    for columns_ahead in range(-1, 2):
        other_column = neighbour_tile(0, column, columns_ahead, plan, box)
        for rows_ahead in range(-1, 2):
            other_row = neighbour_tile(1, row, rows_ahead, plan, box)
            if other_column >= 0 and other_row >= 0:
                other = tiles[other_column * plan.tiles[1] + other_row]
                count = load_from(other, count, whole, features, own, own_features, box)
    return count


@linked
def begin_tile(store, whole, features, places, box, start, end):
    """Prepare a store whose discs have been loaded, partners by number, to be played for a time.

    start, end: of that time, from the start of the lap; events due at its end are not part of it.
    places: of each number the place in this store, if the disc is here; else anything.
    """
    event, count = store.event, store.disc.shape[0]
    for i in range(count):
        places[event[i].number] = i
    for i in range(count):
        partner = event[i].partner
        if partner >= 0:
            place = places[partner]
            if place < count and event[place].number == partner:
                event[i].partner = place
            else:  # beyond the halo: deflected, or at the edge, where nothing is reliable; see docs/exact.md
                event[i].partner = elsewhere(partner)
    clock = store.clock
    clock.now, clock.origin, clock.lap = whole.clock.now, whole.clock.origin, whole.clock.lap
    clock.step = (end - start) / store.step_head.size
    if not clock.step > 0.0:  # an instant
        clock.step = 1.0
    store.turn.latest = whole.clock.now
    store.counter.stall = 0
    link_cells(store, box, features)
    begin_turn_until(start, end, store)


@inlined
def play_until(until, store, box, features, watch):
    """Process events up to a time from the start of the lap: REACHED, or the error."""
    while True:
        i = earliest(store)
        if i < 0:
            return REACHED
        t = due(store.disc, i)
        if t > until:
            return REACHED
        if stalled(t, MOST_AT_ONCE, store):
            return STALLED
        store.clock.now = t
        if process_event(i, t, store, box, features, watch) >= 0:
            return NOT_FINITE
        if store.region.counts:
            store.turn.latest = t


@inlined
def take_counts(totals, store):
    """Add the counts of a store to the totals of a frame, and reset them."""
    add_tally(totals, store.tally)
    clear_tally(store.tally)
    totals.collisions += store.counter.pairs
    store.counter.pairs = 0


@linked
def play_tile(store, box, features, watch, plan, times, counted):
    """Play the window of a plan: REACHED, or the error; FULL: the log of collisions was too small.

    counted: TOTALS of each frame that ends in the window, and of the rest of the window.
    """
    origin = store.clock.origin
    for frame in range(plan.frames + 1):
        until = (plan.first_frame + frame + 1) * times.dt - origin
        if frame == plan.frames:
            until = INFINITY if plan.ends_lap else times.until - origin
        begin_span(features.log, plan.first_frame + frame)
        status = play_until(until, store, box, features, watch)
        if status != REACHED:
            return status
        take_counts(counted[frame], store)
    return FULL if overflows(features.log) else REACHED


@linked
def put_down(tile, store, features, target, target_event, target_features, box):
    """Put the discs in a tile's own cells aside, column by column, partners by number."""
    enter_absent(store, box, features)
    region, event = store.region, store.event
    found = 0
    for column in range(region.own_first[0], region.own_first[0] + region.own[0]):
        for row in range(region.own_first[1], region.own_first[1] + region.own[1]):
            i = store.cell_head[column * region.here[1] + row]
            while i >= 0:
                if found < tile.capacity:
                    place = tile.room + found
                    copy_disc(store.disc[i], target[place])
                    copy_event(event[i], target_event[place])
                    copy_columns(features, i, target_features, place)
                    target_event[place].partner = number_of_partner(event[i].partner, event)
                found += 1
                i = store.cell_next[i]
    tile.found = found


@inlined
def bands_agree(one, other, columns_ahead, rows_ahead):
    """Whether a tile and the one that many places further found the same in their common bands."""
    # One's inner high band is the other's outer low one, and its outer high band the other's inner low one.
    for column in range(BANDS):
        other_column = column - INNER_HIGH * columns_ahead
        for row in range(BANDS):
            other_row = row - INNER_HIGH * rows_ahead
            if 0 <= other_column < BANDS and 0 <= other_row < BANDS:
                if columns_ahead == 0 and not INNER_LOW <= column <= INNER_HIGH:
                    continue
                if rows_ahead == 0 and not INNER_LOW <= row <= INNER_HIGH:
                    continue
                if one.seen[column * BANDS + row] != other.seen[other_column * BANDS + other_row]:
                    return False
    return True
