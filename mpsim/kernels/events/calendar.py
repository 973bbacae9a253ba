"""The event calendar: which disc has the next event, at a cost that does not grow with their number.

A ring of lists, one per small step of time, stands in front of a binary heap that sorts only the discs of the current
step (Paul, J. Comput. Phys. 221, 615, 2007; Smallenburg, arXiv 2201.01100, 2022). One turn of the ring is
a lap; a disc whose event lies beyond it is in no list until the next turn begins.

Events are ordered by (time, number of the disc), a total order: neither where the calendar keeps an event, nor when a
turn begins, can affect the result.

Time is counted from the start of the lap, so it does not lose resolution in a long run. A lap is a power of
two long, which makes its subtraction exact for every time that lies in its second half or after it.
"""

import numpy as np

from mpsim.kernels.compiling import inlined, linked

NOWHERE = -1


FEWEST_STEPS = 64


@inlined
def steps_for(count):
    """Steps of the ring for so many discs: a power of two, at least twice as many."""
    steps = FEWEST_STEPS
    while steps < 2 * count:
        steps *= 2
    return steps


@inlined
def due(disc, i):
    """The time of the next event of disc i [time]."""
    return min(disc[i].collision_time, disc[i].crossing_time)


@inlined
def sooner(store, i, j):
    """Whether disc i comes before disc j: by time, equal times by number."""
    ti = due(store.disc, i)
    tj = due(store.disc, j)
    return ti < tj or (ti == tj and store.event[i].number < store.event[j].number)


@inlined
def heap_rise(position, i, store):
    """Settle disc i in the heap at `position` or nearer the root."""
    heap = store.heap
    while position > 0:
        parent = (position - 1) >> 1
        other = heap[parent]
        if not sooner(store, i, other):
            break
        heap[position] = other
        store.entry[other].place = -2 - position
        position = parent
    heap[position] = i
    store.entry[i].place = -2 - position


@inlined
def heap_sink(position, i, store):
    """Settle disc i in the heap at `position` or further from the root."""
    heap = store.heap
    size = store.counter.waiting
    child = 2 * position + 1
    while child < size:
        if child + 1 < size and sooner(store, heap[child + 1], heap[child]):
            child += 1
        other = heap[child]
        if not sooner(store, other, i):
            break
        heap[position] = other
        store.entry[other].place = -2 - position
        position = child
        child = 2 * position + 1
    heap[position] = i
    store.entry[i].place = -2 - position


@inlined
def heap_push(i, store):
    """Add disc i to the heap."""
    size = store.counter.waiting
    store.counter.waiting = size + 1
    heap_rise(size, i, store)


@inlined
def heap_remove(position, store):
    """Remove the disc at `position` from the heap; the last one fills the gap."""
    size = store.counter.waiting - 1
    store.counter.waiting = size
    if position < size:
        filler = np.int64(store.heap[size])
        heap_sink(position, filler, store)
        heap_rise(-2 - np.int64(store.entry[filler].place), filler, store)


@inlined
def list_remove(i, step, store):
    """Remove disc i from the list of its step."""
    entry = store.entry
    after = entry[i].after
    before = entry[i].before
    if before >= 0:
        entry[before].after = after
    else:
        store.step_head[step] = after
    if after >= 0:
        entry[after].before = before


@inlined
def list_insert(i, step, store):
    """Put disc i at the front of the list of a step."""
    entry = store.entry
    after = store.step_head[step]
    entry[i].after = after
    entry[i].before = NOWHERE
    entry[i].place = step
    if after >= 0:
        entry[after].before = i
    store.step_head[step] = i


@inlined
def insert(i, store):
    """Enter disc i, which has no place yet: in the heap, in a list, or nowhere if its event lies beyond the lap."""
    t = due(store.disc, i)
    if not t < store.turn.end:
        return
    last = store.step_head.size - 1  # if rounding would put an event due at the end of the turn one step further
    step = min(np.int64((t - store.turn.start) / store.clock.step), last)
    if step <= store.counter.cursor:
        heap_push(i, store)
    else:
        list_insert(i, step, store)


@inlined
def reschedule(i, store):
    """Move disc i to where its new time belongs."""
    place = np.int64(store.entry[i].place)
    store.entry[i].place = NOWHERE
    if place >= 0:
        list_remove(i, place, store)
    elif place <= -2:
        heap_remove(-2 - place, store)
    insert(i, store)


@inlined
def earliest(store):
    """The disc whose event is next, or -1 when nothing is left in this turn."""
    counter = store.counter
    cursor = counter.cursor
    last = store.step_head.size - 1
    while counter.waiting == 0 and cursor < last:
        cursor += 1
        i = store.step_head[cursor]
        store.step_head[cursor] = NOWHERE
        while i >= 0:
            after = store.entry[i].after
            heap_push(i, store)
            i = after
    counter.cursor = cursor
    return np.int64(store.heap[0]) if counter.waiting > 0 else np.int64(NOWHERE)


@linked
def begin_turn(start, end, store):
    """Begin a turn of the ring between two times from the start of the lap, `end` excluded; enter every disc anew."""
    store.turn.start, store.turn.end = start, end
    store.step_head[:] = NOWHERE
    store.counter.cursor = -1
    store.counter.waiting = 0
    for i in range(store.disc.shape[0]):
        store.entry[i].place = NOWHERE
        insert(i, store)


@inlined
def shift_times(disc, lap):
    """Count the times of a disc from a later lap."""
    disc.last_update -= lap
    disc.collision_time -= lap
    disc.crossing_time -= lap
    disc.last_contact -= lap


@inlined
def fit_lap(store):
    """Count time from the end of this lap on, and fit the step to the rate of events.

    About one event per step is fastest. A step is doubled or halved, so it stays a power of two; in an idle scene it
    grows faster, so that a long wait takes few laps. The times of the discs must be shifted, and a turn begun.
    """
    clock = store.clock
    clock.origin += clock.lap
    clock.now -= clock.lap
    steps = store.step_head.size
    events = store.counter.lap_events
    if 5 * events < 2 * steps and clock.step < 1e200:
        clock.step *= 2.0 if events > 0 else 16.0
    elif 5 * events > 8 * steps and clock.step > 1e-200:
        clock.step *= 0.5
    clock.lap = clock.step * steps
    store.counter.lap_events = 0
