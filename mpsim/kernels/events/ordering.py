"""The order of discs in memory: that of their cells, so that neighbours share cache lines and pages.

No result depends on it: equal times are ordered by the number of the disc, which it keeps. The order degrades slowly
as discs move; if all of them fit in the cache, it does not matter.
"""

from mpsim.kernels.compiling import inlined, linked
from mpsim.kernels.events.cells import cell_of, link_cells
from mpsim.kernels.events.features.hooks import swap_columns

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
