"""What happens in the bands along a tile's borders, summed up so that two tiles can see whether they found the same.

Each event in a band adds a hash of all that it leaves of the disc: state, counts and predictions. A sum does not depend
on the order of events; sums that are equal stand for equal histories but for one case in 2^64.
"""

import math
from collections import namedtuple

import numpy as np

from mpsim.kernels.compiling import inlined
from mpsim.kernels.events.records import BANDS
from mpsim.kernels.events.region import ELSEWHERE, MIDDLE, band_along

Watch = namedtuple("Watch", "bits seen")
"""bits: the records of the discs as whole numbers, shape (N, 8); seen: sums by band, shape (25,)."""

FACTOR = np.int64(0x2545F4914F6CDD1D)
MANTISSA = 2.0**53


@inlined
def mixed(digest, value):
    """A digest with one more number in it."""
    digest = (digest ^ value) * FACTOR
    return digest ^ (digest >> 29)


@inlined
def with_real(digest, value):
    """The same with a real number."""
    fraction, exponent = math.frexp(value)
    return mixed(mixed(digest, np.int64(fraction * MANTISSA)), np.int64(exponent))


@inlined
def with_spin(digest, spin, i):
    """With the spin, where discs have one."""
    if spin is not None:
        return with_real(digest, spin[i])
    return digest


@inlined
def with_image(digest, image, i):
    """With the counts of periods, where there are some."""
    if image is not None:
        return mixed(mixed(digest, image[i, 0]), image[i, 1])
    return digest


@inlined
def digest_of(i, bits, store, features):
    """A hash of all that can change of disc i, wherever it lies in memory."""
    event = store.event[i]
    digest = np.int64(event.number)
    for k in range(bits.shape[1]):
        digest = mixed(digest, bits[i, k])
    partner = np.int64(event.partner)
    if partner >= 0:
        partner = np.int64(store.event[partner].number)
    digest = mixed(digest, partner)
    digest = mixed(digest, np.int64(event.partner_collision_count))
    digest = mixed(digest, np.int64(event.collision_count))
    digest = mixed(digest, np.int64(event.side))
    digest = mixed(digest, np.int64(event.cell[0]))
    digest = mixed(digest, np.int64(event.cell[1]))
    return with_image(with_spin(digest, features.spin, i), features.image, i)


@inlined
def watch_disc(watch, i, store, box, features):
    """An event has left disc i as it is now."""
    if watch is not None:
        cell = store.event[i].cell
        column, row = band_along(0, cell[0], store.region, box), band_along(1, cell[1], store.region, box)
        if column != ELSEWHERE and row != ELSEWHERE and (column != MIDDLE or row != MIDDLE):
            watch.seen[column * BANDS + row] += digest_of(i, watch.bits, store, features)
