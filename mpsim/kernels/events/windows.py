"""Windows of time: tiles of cells are simulated separately, and either all results are taken or none."""

from collections import namedtuple
from typing import Any

import numpy as np

from mpsim.kernels.compiling import compiled, inlined, linked
from mpsim.kernels.events.calendar import begin_turn, due, earliest, fit_lap, shift_times, steps_for
from mpsim.kernels.events.cells import Store, along, enter_absent, link_cells, put_at_targets
from mpsim.kernels.events.features.hooks import copy_columns
from mpsim.kernels.events.flight import INFINITY
from mpsim.kernels.events.records import (
    ABORTED,
    BANDS,
    FULL,
    INNER_HIGH,
    INNER_LOW,
    NOT_FINITE,
    PAUSED,
    REACHED,
    STALLED,
    STOPPED,
    add_tally,
    clear_tally,
    elsewhere,
    number_of_partner,
    place_along,
)
from mpsim.kernels.events.solver import STOP_ROUNDING, Watch, play_frames, process_event, stalled, write_totals
from mpsim.kernels.features.collisions import agree, begin_span, overflows, take_back
from mpsim.kernels.machine import atomic_add, now
from mpsim.kernels.records import ABORT, RUNNING
from mpsim.kernels.waiting import barrier, next_command

# --- Tiles: rectangles of cells that are simulated separately, each with a halo of the cells around it
#
# A tile is loaded from the store of the whole box into one of its own, with all discs of the `halo` cells around it,
# and played up to the end of a window. The error from what is missing beyond the halo spreads inward by a few
# diameters. So the events are compared along each border of two tiles: if both found the same in the band
# there, each is right in its own cells, and its own discs are the new state of the box. If not, the window is played
# again (windows.py).
#
# Between windows a tile's discs lie together in the store, column by column, and partners are named by number.

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
    begin_turn(start, end, store)


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
def add_counts(totals, store):
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
        add_counts(counted[frame], store)
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


# --- Windows of time: workers simulate them tile by tile, and either all results are accepted or none
#
#     plan      worker 0: how far the window goes, at most to the end of the calendar's lap
#     ------------------------------------------------------------------------------------------------- barrier
#     play      each tile by the first free worker: load, play, put down in another memory
#     ------------------------------------------------------------------------------------------------- barrier
#     agree     have all tiles found the same along their borders?
#     take over yes: the discs back into the store, tile by tile; no: worker 0 plays the window in the store alone
#     ------------------------------------------------------------------------------------------------- barrier
#
# The store of the whole box is not touched until all agree. So the result does not depend, to the last bit, on which
# worker plays which tile, on the number of tiles, or on the length of a window. A command whose time is up may leave a
# window between two tiles: the next one plays the rest, or plans anew, as the store is still as it was before the
# window.

MOST_FRAMES = 256
"""Frames that end in a window at most."""

FEWEST_EVENTS, EVENTS_OF_A_DISC = 10_000, 2
"""Events that one worker plays for all before tiles are tried again, and how many more for each disc."""

AGREED, DIFFERENT, LEFT = range(20, 23)
"""Outcomes of a window: all tiles have found the same, they have not, the time of the command was over before."""

MOST_PARTS = 64
TRIAL = 64
"""Windows of which all tiles agree before longer ones are tried than those of which they did not."""

MOST_COLLISIONS, FEWEST_COLLISIONS = 1.05, 0.5
"""Impacts of two discs in a window, per disc, beyond which the next ones are half or twice as long."""

SLACK, FEWEST_ROOM = 4, 256
"""Room for the discs of a tile at the end of a window: a fourth more than there are, and so many."""

Shared: Any = namedtuple("Shared", "disc event features tiles plan times counted counts latest busy control team")
"""disc, event, features: where discs wait until all agree; tiles: TILE; plan, times: PLAN, PLAN_TIMES; counted: TOTALS
by worker and frame; counts: COUNTER by worker; latest: of each worker the time of its last event [time]; busy: what it
has worked for since a frame ended [ns]; control, team: of the workers."""

Own: Any = namedtuple("Own", "store features bits places")
"""What a worker has for itself: a store for a tile, its features, its discs as whole numbers, and `places`, of each
number the place of the disc in that store."""


# --- plan ---------------------------------------------------------------------------------------------------------


@inlined
def end_of_part(plan, times, clock):
    """End of the part of the lap in which the present is, from the start of the lap, infinite for the last one."""
    length = clock.lap / plan.parts
    part = int((times.reached - clock.origin) / length) + 1
    while part < plan.parts and clock.origin + part * length <= times.reached:  # as it was rounded to be reached
        part += 1
    return part * length if part < plan.parts else INFINITY


@inlined
def plan_window(plan, times, clock, first_frame, frames, stop):
    """Plan the next window, with so many frames left. Returns whether the stop lies in it."""
    origin, dt = clock.origin, times.dt
    part_end = end_of_part(plan, times, clock)
    latest = min(part_end, clock.lap)
    plan.first_frame, plan.frames, plan.ends_lap, plan.whole_part = first_frame, 0, 0, 0
    while plan.frames < min(frames, MOST_FRAMES):
        end = (first_frame + plan.frames + 1) * dt
        if stop <= end * (1.0 + STOP_ROUNDING):
            if stop - origin < latest:
                times.until = stop
                return True
            break
        if end - origin >= latest:
            break
        times.until = end
        plan.frames += 1
    if plan.frames < min(frames, MOST_FRAMES):
        plan.ends_lap = part_end == INFINITY
        plan.whole_part = times.reached - origin <= latest - 0.9 * clock.lap / plan.parts
        times.until = origin + part_end
    return False


@inlined
def fit_parts(plan, collisions, count, agreed):
    """Make windows shorter if they are too long for the halo, and longer if discs hardly collide in them."""
    plan.peace = plan.peace + 1 if agreed else 0
    if not agreed:
        plan.fewest_parts = min(2 * plan.parts, MOST_PARTS)
    elif plan.peace % TRIAL == 0:
        plan.fewest_parts //= 2
    if (not agreed or collisions > MOST_COLLISIONS * count) and plan.parts < MOST_PARTS:
        plan.parts *= 2
    elif collisions < FEWEST_COLLISIONS * count and plan.parts > max(plan.fewest_parts, 1) and plan.whole_part:
        plan.parts //= 2


# --- play ---------------------------------------------------------------------------------------------------------


@linked
def play_one(number, whole, features, box, shared, own, worker):
    """Load, play and put down one tile."""
    tile = shared.tiles[number]
    tile.seen[:] = 0
    count = load(number, shared.tiles, shared.plan, whole, features, own.store, own.features, box)
    room, cells = own.store, own.store.region.here[0] * own.store.region.here[1]
    steps = steps_for(count)
    lists = room.cell_head[:cells], room.cell_next[:count], room.step_head[:steps], room.heap[:count]
    others = room.near, room.approach, room.order, room.clock, room.counter, room.tally, room.region, room.turn
    store = Store(room.disc[:count], room.event[:count], room.entry[:count], *lists, *others)
    origin = whole.clock.origin
    # An event due at the end of a lap belongs to the next lap; one due at the end of another window, to that window.
    end = whole.clock.lap if shared.plan.ends_lap else np.nextafter(shared.times.until - origin, INFINITY)
    begin_tile(store, whole, own.features, own.places, box, shared.times.reached - origin, end)
    watch = Watch(own.bits, tile.seen)
    tile.status = play_tile(store, box, own.features, watch, shared.plan, shared.times, shared.counted[worker])
    put_down(tile, store, own.features, shared.disc, shared.event, shared.features, box)
    shared.latest[worker] = max(shared.latest[worker], store.turn.latest)


@linked
def clear_counts(whole, shared, own, worker):
    """Reset the counts of one worker before its share of a window."""
    counter = own.store.counter
    counter.walls = counter.guarded = counter.events = counter.crossings = counter.stale_predictions = 0
    counter.pairs = 0  # and the sums: a tile that could not be played to its end has left its counts
    clear_tally(own.store.tally)
    for frame in range(shared.plan.frames + 1):
        clear_tally(shared.counted[worker, frame])
        shared.counted[worker, frame].collisions = 0
    shared.latest[worker] = whole.clock.now
    take_back(own.features.log, own.features.work)


@linked
def play_tiles(whole, features, box, shared, own, worker):
    """One worker's share of a window: tiles, while there are any and there is time."""
    counter, counts, mine = own.store.counter, shared.counts[worker], shared.team[worker]
    if shared.plan.paused == 0:
        clear_counts(whole, shared, own, worker)
    number = atomic_add(shared.plan.next, 0, 1)
    while number < shared.tiles.size:
        play_one(number, whole, features, box, shared, own, worker)
        if now(mine.clock) > shared.plan.deadline:
            break
        number = atomic_add(shared.plan.next, 0, 1)
    counts.walls, counts.guarded, counts.events = counter.walls, counter.guarded, counter.events
    counts.crossings, counts.stale_predictions = counter.crossings, counter.stale_predictions


# --- agree --------------------------------------------------------------------------------------------------------


@linked
def all_agree(tiles, plan, box):
    """Whether all tiles have reached the end of the window, and found the same along their borders."""
    agreed = True
    for number in range(tiles.size):
        tile = tiles[number]
        agreed = agreed and tile.status == REACHED and tile.found <= tile.capacity
        column, row = number // plan.tiles[1], number % plan.tiles[1]
        for columns_ahead in range(2):
            for rows_ahead in range(-1 if columns_ahead == 1 else 1, 2):
                other_column = tile_beyond(0, column, columns_ahead, plan, box)
                other_row = tile_beyond(1, row, rows_ahead, plan, box)
                if other_column >= 0 and other_row >= 0:
                    other = tiles[other_column * plan.tiles[1] + other_row]
                    agreed = agreed and bands_agree(tile, other, columns_ahead, rows_ahead)
    return agreed


@linked
def log_is_full(tiles):
    """Whether the collisions of a tile did not fit in the log of its worker."""
    full = False
    for number in range(tiles.size):
        full |= tiles[number].status == FULL
    return full


# --- take over ----------------------------------------------------------------------------------------------------


@linked
def take_discs(whole, features, shared, worker):
    """Put this worker's share of the tiles back into the store."""
    first = 0
    for number in range(shared.tiles.size):
        tile = shared.tiles[number]
        if number % shared.control.workers == worker:
            for k in range(tile.found):
                copy_disc(shared.disc[tile.room + k], whole.disc[first + k])
                copy_event(shared.event[tile.room + k], whole.event[first + k])
                copy_columns(shared.features, tile.room + k, features, first + k)
                if shared.plan.ends_lap:
                    shift_times(whole.disc[first + k], whole.clock.lap)
        first += tile.found


@linked
def take_counts(whole, shared):
    """Add the counts of all workers, except those of frames."""
    counter = whole.counter
    for worker in range(shared.control.workers):
        counts = shared.counts[worker]
        counter.walls += counts.walls
        counter.guarded += counts.guarded
        counter.events += counts.events
        counter.lap_events += counts.events
        counter.crossings += counts.crossings
        counter.stale_predictions += counts.stale_predictions
        whole.clock.now = max(whole.clock.now, shared.latest[worker])
    if shared.plan.ends_lap:
        fit_lap(whole)


@linked
def take_frames(whole, shared, done, progress, seen, times, totals):
    """Add the counts of all workers in frames, and write those of frames that have ended."""
    for frame in range(shared.plan.frames + 1):
        for worker in range(shared.control.workers):
            add_tally(whole.tally, shared.counted[worker, frame])
            whole.counter.pairs += shared.counted[worker, frame].collisions
        if frame < shared.plan.frames:
            if done + frame < totals.shape[0]:
                write_totals(totals[done + frame], whole)
            write_totals(seen, whole)
            times[0, done + frame] = progress.spent // shared.plan.frames  # of a window, shared evenly
            for worker in range(shared.control.workers):
                times[1 + worker, done + frame] = shared.busy[worker] // shared.plan.frames
    if shared.plan.frames > 0:
        progress.spent = 0
        shared.busy[:] = 0
        progress.frame += shared.plan.frames


@linked
def deal_rooms(tiles):
    """Determine where the discs of each tile lie, and where they are to be put."""
    first, room = 0, 0
    for number in range(tiles.size):
        tile = tiles[number]
        tile.count = tile.found
        tile.first = first
        tile.capacity = tile.count + tile.count // SLACK + FEWEST_ROOM
        tile.room = room
        first += tile.count
        room += tile.capacity


# --- one worker for all -------------------------------------------------------------------------------------------


@compiled
def link(whole, box, features, places):
    """Prepare a store whose discs lie tile by tile to be played as a whole."""
    event = whole.event
    for i in range(event.shape[0]):
        places[event[i].number] = i
    for i in range(event.shape[0]):
        if event[i].partner >= 0:
            event[i].partner = places[event[i].partner]
    link_cells(whole, box, features)
    begin_turn(max(whole.clock.now, 0.0), whole.clock.lap, whole)  # a lap that has just begun may lie ahead


@compiled
def order_by_tiles(whole, box, features, tiles, plan):
    """Put the discs of a store that is played as a whole tile by tile, partners by number."""
    enter_absent(whole, box, features)
    target, event, place = whole.heap, whole.event, 0
    for number in range(tiles.size):
        tile, before = tiles[number], place
        for column in range(tile.own_first[0], tile.own_first[0] + tile.own[0]):
            for row in range(tile.own_first[1], tile.own_first[1] + tile.own[1]):
                i = whole.cell_head[column * box.rows + row]
                while i >= 0:
                    target[i] = place
                    place += 1
                    i = whole.cell_next[i]
        tile.found = place - before
    for i in range(target.size):
        if event[i].partner >= 0:
            event[i].partner = event[event[i].partner].number
    put_at_targets(whole, features)
    deal_rooms(tiles)
    plan.paused = 0


# --- a command ----------------------------------------------------------------------------------------------------


@inlined
def goes_on(plan, times, command):
    """Whether this command may play a window that was left: it must not reach further than the command."""
    ends_with_frame = times.until == (plan.first_frame + plan.frames) * times.dt
    within = plan.frames < command.frames or (plan.frames == command.frames and ends_with_frame)
    return within and times.stop == command.stop


@linked
def begin_window(whole, shared, command, progress):
    """Plan the next window, if there is one. By worker 0."""
    plan, mine = shared.plan, shared.team[0]
    if plan.done == command.frames:
        plan.status = REACHED
    in_time = plan.played == 0 or now(mine.clock) < plan.deadline
    plan.running = plan.status == PAUSED and in_time
    plan.paused = plan.running and plan.paused and goes_on(plan, shared.times, command)
    if plan.running:
        plan.played += 1
    if plan.running and not plan.paused:
        left, shared.times.stop = command.frames - plan.done, command.stop
        plan.stops = plan_window(plan, shared.times, whole.clock, progress.frame, left, command.stop)
        plan.next[0] = 0


@linked
def take_over(whole, shared, progress, seen, times, totals):
    """Count the events of a window whose tiles all agree, and whose discs are back in the store. By worker 0."""
    plan = shared.plan
    take_frames(whole, shared, plan.done, progress, seen, times, totals)
    shared.times.reached = shared.times.until
    take_counts(whole, shared)
    if plan.ends_lap:
        shared.times.reached = whole.clock.origin
    deal_rooms(shared.tiles)
    plan.done += plan.frames
    if plan.stops:
        plan.status = STOPPED


@linked
def play_again(whole, box, features, shared, own, command, progress, seen, times, totals):
    """If tiles do not agree: first shorter windows, finally one worker for all tiles. By worker 0."""
    plan = shared.plan
    if plan.parts < MOST_PARTS:
        plan.again += 1
        return
    plan.as_one += 1
    left, done = min(plan.frames + 1, command.frames - plan.done), plan.done
    link(whole, box, features, own.places)
    take_back(features.log, features.work)
    most = FEWEST_EVENTS + EVENTS_OF_A_DISC * whole.disc.shape[0]
    finished, status, particle = play_frames(
        whole, box, features, shared.times.dt, left, most, command.stop, progress, seen, times[0, done:],
        totals[done:], shared.team[0].clock,
    )  # fmt: skip
    agree(features.log, features.work)
    order_by_tiles(whole, box, features, shared.tiles, plan)
    plan.done += finished
    shared.times.reached = command.stop if status == STOPPED else progress.frame * shared.times.dt
    if status == PAUSED:
        shared.times.reached = whole.clock.origin + whole.clock.now
    if status != REACHED:
        plan.status, plan.particle = status, particle


@linked
def end_window(whole, box, features, shared, own, command, outcome, progress, seen, times, totals):
    """Accept a window, leave it to the next command, or have it played again. By worker 0."""
    before, plan = whole.counter.pairs, shared.plan
    plan.paused = outcome == LEFT
    if outcome == LEFT:
        plan.running = 0
        return
    agreed = outcome == AGREED
    if not agreed and plan.played > 1 and log_is_full(shared.tiles):  # emptying it may be enough
        plan.status = FULL
        return
    plan.windows += 1
    if agreed:
        take_over(whole, shared, progress, seen, times, totals)
    else:
        play_again(whole, box, features, shared, own, command, progress, seen, times, totals)
    fit_parts(plan, whole.counter.pairs - before, whole.disc.shape[0], agreed)


@inlined
def barrier_of(control, mine):
    """Wait until all workers have arrived; returns RUNNING, or why to leave."""
    return barrier(control, mine) if control.workers > 1 else control.signals[ABORT]


@linked
def work(whole, box, features, shared, own, worker):
    """One worker's share of a window. Returns AGREED, DIFFERENT, LEFT or ABORTED."""
    control, mine = shared.control, shared.team[worker]
    began = now(mine.clock)
    play_tiles(whole, features, box, shared, own, worker)
    shared.busy[worker] += now(mine.clock) - began
    if barrier_of(control, mine) != RUNNING:
        return ABORTED
    if shared.plan.next[0] < shared.tiles.size:
        return LEFT if barrier_of(control, mine) == RUNNING else ABORTED
    agreed = all_agree(shared.tiles, shared.plan, box)
    began = now(mine.clock)
    if agreed:
        take_discs(whole, features, shared, worker)
        agree(own.features.log, own.features.work)
    shared.busy[worker] += now(mine.clock) - began
    if barrier_of(control, mine) != RUNNING:
        return ABORTED
    return AGREED if agreed else DIFFERENT


@linked
def play_window(whole, box, features, shared, own, command, progress, seen, times, totals, worker):
    """One window, if there is one, as `work`; LEFT if there is none."""
    plan, control, mine = shared.plan, shared.control, shared.team[worker]
    began = now(mine.clock)
    if worker == 0:
        begin_window(whole, shared, command, progress)
    if barrier_of(control, mine) != RUNNING:
        return ABORTED
    if plan.running == 0:  # it may change once all have seen that
        return LEFT if barrier_of(control, mine) == RUNNING else ABORTED
    outcome = work(whole, box, features, shared, own, worker)
    if worker == 0 and outcome != ABORTED:
        progress.spent += now(mine.clock) - began
        end_window(whole, box, features, shared, own, command, outcome, progress, seen, times, totals)
    return outcome


@compiled
def run_windows(
    whole, features, box, shared, own, command, progress, seen, times, totals, worker, linger
):  # fmt: skip
    """Run frames, or as many as end within a time: (frames finished, status, particle), of worker 0.

    command: COMMAND. progress, seen, totals: as of `play_frames`. times: int64 [ns], shape (1 + workers, frames): of
    each frame, and the work of each worker for it. Other workers wait for a command; if there is none, they return
    the answer of `next_command` as their status.
    """
    mine, plan = shared.team[worker], shared.plan
    while True:
        heard = next_command(shared.control, mine, worker, linger)
        if heard != RUNNING:
            return 0, heard, -1
        if worker == 0:
            plan.deadline = now(mine.clock) + command.patience
            plan.done, plan.played, plan.status, plan.particle = 0, 0, PAUSED, -1
        outcome = AGREED
        while outcome != LEFT:
            outcome = play_window(whole, box, features, shared, own, command, progress, seen, times, totals, worker)
            if outcome == ABORTED:
                return 0, ABORTED, -1
        if worker == 0:
            return plan.done, plan.status, plan.particle
