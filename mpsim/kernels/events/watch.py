"""Hash sums of the events in bands along the borders of a tile, with which neighbouring tiles are compared.

Each event in a band adds a hash of the disc after it: state, counts and predictions. A sum does not depend on the order
of events; equal sums mean equal histories, except in one case in 2^64.
"""

from collections import namedtuple

import numpy as np

from mpsim.kernels.compiling import inlined
from mpsim.kernels.events.features.hooks import with_columns
from mpsim.kernels.events.hashing import mixed
from mpsim.kernels.events.partners import number_of_partner
from mpsim.kernels.events.records import BANDS
from mpsim.kernels.events.region import ELSEWHERE, MIDDLE, band_along

Watch = namedtuple("Watch", "bits seen")
"""bits: the records of the discs as whole numbers, shape (N, 8); seen: sums by band, shape (25,)."""


@inlined
def digest_of(i, bits, store, features):
    """A hash of everything that can change in disc i, wherever it lies in memory."""
    event = store.event[i]
    digest = np.int64(event.number)
    for k in range(bits.shape[1]):
        digest = mixed(digest, bits[i, k])
    digest = mixed(digest, number_of_partner(event.partner, store.event))
    digest = mixed(digest, np.int64(event.partner_collision_count))
    digest = mixed(digest, np.int64(event.collision_count))
    digest = mixed(digest, np.int64(event.side))
    digest = mixed(digest, np.int64(event.cell[0]))
    digest = mixed(digest, np.int64(event.cell[1]))
    return with_columns(digest, features, i)


@inlined
def watch_disc(watch, i, store, box, features):
    """Add disc i, as an event has just left it, to the sums of its bands."""
    if watch is not None:
        cell = store.event[i].cell
        column, row = band_along(0, cell[0], store.region, box), band_along(1, cell[1], store.region, box)
        if column != ELSEWHERE and row != ELSEWHERE and (column != MIDDLE or row != MIDDLE):
            watch.seen[column * BANDS + row] += digest_of(i, watch.bits, store, features)
