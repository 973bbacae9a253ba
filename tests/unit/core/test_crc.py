"""The CRC-32 of a whole follows from those of its parts, however it is cut."""

import itertools
import zlib

import numpy as np
import pytest

from mpsim.core import crc


@pytest.mark.parametrize("seed", range(40))
def test_parts_of_any_lengths_give_what_zlib_gives_for_the_whole(seed):
    rng = np.random.default_rng(seed)
    whole = rng.bytes(int(rng.integers(1, 40_000)))
    cuts = [0, *sorted(rng.integers(0, len(whole) + 1, int(rng.integers(0, 30))).tolist()), len(whole)]
    parts = [whole[first:last] for first, last in itertools.pairwise(cuts)]
    assert b"".join(parts) == whole
    told = [(zlib.crc32(part), len(part)) for part in parts]
    assert crc.joined(told) == zlib.crc32(whole)
    if len(set(told)) > 1:  # the control: in another order they are another whole
        swapped = [*told[1:], told[0]]
        assert (crc.joined(swapped) == zlib.crc32(whole)) == (b"".join([*parts[1:], parts[0]]) == whole)


def test_nothing_and_parts_without_bytes():
    assert crc.joined([]) == zlib.crc32(b"") == 0
    assert crc.joined([(0, 0), (zlib.crc32(b"a"), 1), (0, 0)]) == zlib.crc32(b"a")


def test_parts_of_more_than_four_gigabytes():
    """2^33 zeros, from a million of them again and again, and by one long part."""
    some, length = zlib.crc32(bytes(2**20)), 2**20
    for _ in range(13):
        some, length = crc.joined([(some, length), (some, length)]), 2 * length
    one_by_one = crc.joined([(zlib.crc32(bytes(2**20)), 2**20)] * 2**13)
    assert (some, length) == (one_by_one, 2**33)
    ending = zlib.crc32(b"and an end")
    assert crc.joined([(some, length), (ending, 10)]) == crc.joined(
        [(zlib.crc32(bytes(2**20)), 2**20)] * 2**13 + [(ending, 10)]
    )
