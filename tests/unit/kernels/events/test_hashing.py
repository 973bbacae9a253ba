"""Hashes of numbers tell what differs, and in which order it came."""

import functools
import itertools

import numpy as np
import pytest
from support.internals import machine_code

from mpsim.kernels.events import hashing

mixed, mixed_real = map(machine_code, (hashing.mixed, hashing.mixed_real))


def digest(values, mix=mixed, start=0):
    kind = np.int64 if mix is mixed else np.float64
    return int(functools.reduce(mix, map(kind, values), np.int64(start)))


def test_a_swapped_pair_gives_another_hash():
    values = [3, -1, 4, 1, -5, 9, 2**62]
    for i, j in itertools.combinations(range(len(values)), 2):
        swapped = list(values)
        swapped[i], swapped[j] = swapped[j], swapped[i]
        assert digest(swapped) != digest(values)
    assert digest(values) == digest(list(values))


def test_every_bit_of_every_number_counts():
    values = np.random.default_rng(1).integers(-(2**62), 2**62, 4)
    found = {digest(values)}
    for place, bit in itertools.product(range(4), range(64)):
        changed = values.copy()
        changed[place] ^= np.int64(np.uint64(1 << bit).astype(np.int64))
        found.add(digest(changed))
    assert len(found) == 1 + 4 * 64


def test_sums_of_hashes_tell_two_discs_that_have_changed_roles():
    """What goes into a sum is of one disc as a whole: what two have, but the other way round, is another sum."""
    one, two = digest([7, 1000]), digest([8, 2000])
    other, another = digest([7, 2000]), digest([8, 1000])
    assert (one + two) % 2**64 != (other + another) % 2**64


def test_small_changes_do_not_cancel_in_a_sum():
    """Of many discs with numbers of few bits, all changed alike."""
    count = 500
    signs = [sum(digest([i, np.float64(sign).view(np.int64)]) for i in range(count)) % 2**64 for sign in (1.0, -1.0)]
    mixes = {
        sum(digest([i, np.float64((-1.0) ** (i % period == 0)).view(np.int64)]) for i in range(count)) % 2**64
        for period in range(1, 60)
    }
    assert len(mixes | set(signs)) == 60


@pytest.mark.parametrize("value", [0.0, 1.0, -1.0, 1e300, 5e-324, 0.1])
def test_reals_that_differ_in_their_last_bit_give_other_hashes(value):
    beside = [np.nextafter(value, np.inf), np.nextafter(value, -np.inf)]
    assert digest([value], mixed_real) not in {digest([each], mixed_real) for each in beside}
