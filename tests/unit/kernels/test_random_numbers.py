"""Random numbers by their purpose: the published generator, and what is made of its numbers."""

import math

import numpy as np
import pytest

from mpsim.kernels import random_numbers

KNOWN = {
    (0, (0, 0, 0, 0)): (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8),
    (2**64 - 1, (0xFFFFFFFF,) * 4): (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD),
    (0x299F31D0A4093822, (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344)): (
        0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1,
    ),
}  # fmt: skip
"""Of philox4x32-10, from the file kat_vectors of Random123: words by key and counter."""


@pytest.mark.parametrize("given", KNOWN, ids=["zeros", "ones", "pi"])
def test_the_generator_is_philox(given):
    seed, counter = given
    assert random_numbers.words(np.uint64(seed), *map(np.uint64, counter)) == KNOWN[given]


def test_each_argument_makes_another_number():
    numbers = {
        random_numbers.pair(seed, disc, frame, draw)
        for seed in (0, 1, 2**63 - 1) for disc in (0, 1) for frame in (0, 1, 2**32) for draw in (0, 1)
    }  # fmt: skip
    assert len(numbers) == 36


def test_uniform_numbers_begin_at_0_and_end_before_1():
    assert random_numbers.uniform(np.uint64(0), np.uint64(0)) == 0.0
    assert random_numbers.uniform(np.uint64(2**32 - 1), np.uint64(2**32 - 1)) == 1 - 2.0**-53


def test_the_logarithm_is_right_to_two_roundings():
    rng = np.random.default_rng(0)
    near_1, small = 1 - 1e-6 * rng.random(500), 10.0 ** -rng.uniform(0, 30, 500)
    for x in [*rng.random(500), *near_1, *small, 0.5, math.sqrt(0.5), 2.0**-53, 2.0**-106]:
        assert random_numbers.logarithm(float(x)) == pytest.approx(math.log(x), rel=5e-16)
    assert random_numbers.logarithm(1.0) == 0.0


def distance(values, distribution):
    """Kolmogorov-Smirnov: the largest difference of two cumulative distributions, times the root of the number."""
    ordered = np.sort(values)
    steps = np.arange(len(ordered) + 1) / len(ordered)
    expected = np.array([distribution(value) for value in ordered])
    return math.sqrt(len(ordered)) * max((steps[1:] - expected).max(), (expected - steps[:-1]).max())


def test_normal_pairs_are_normal_and_independent():
    """The bound of 1.95 is exceeded once in a thousand times. The control: a variance of 1.25."""
    pairs = np.array([random_numbers.normal_pair(3, disc, 8, 1) for disc in range(4000)])
    normal = lambda value: 0.5 * (1 + math.erf(value / math.sqrt(2)))  # noqa: E731
    for component in pairs.T:
        assert distance(component, normal) < 1.95
    assert abs(np.corrcoef(pairs.T)[0, 1]) < 4 / math.sqrt(4000)
    assert distance((pairs**2).sum(axis=1), lambda value: 1 - math.exp(-value / 2)) < 1.95
    assert distance(math.sqrt(1.25) * pairs.ravel(), normal) > 1.95


def test_discs_leave_a_wall_as_they_would_cross_a_line():
    """The control: the speed along the normal of a gas, which is not weighted with the flux."""
    came = np.random.default_rng(1).normal(size=(4000, 2))
    found = np.array([random_numbers.wall_velocity(3, 7, 2.5, *each) for each in came])
    rayleigh = lambda speed: 1 - math.exp(-speed * speed / 2)  # noqa: E731
    assert distance(found[:, 0], rayleigh) < 1.95
    assert distance(found[:, 1], lambda value: 0.5 * (1 + math.erf(value / math.sqrt(2)))) < 1.95
    assert distance(np.abs(came[:, 0]), rayleigh) > 1.95


def test_each_number_of_a_contact_makes_another_velocity():
    base = (3, 7, 2.5, -1.25, 0.5)
    others = [(4, 7, 2.5, -1.25, 0.5), (3, 8, 2.5, -1.25, 0.5), (3, 7, 2.75, -1.25, 0.5),
              (3, 7, 2.5, np.nextafter(-1.25, 0), 0.5), (3, 7, 2.5, -1.25, 0.75)]  # fmt: skip
    assert len({random_numbers.wall_velocity(*each) for each in (base, *others)}) == 6
    assert random_numbers.wall_velocity(*base) == random_numbers.wall_velocity(*base)
    random_numbers.wall_velocity(3, 7, 0.0, 0.0, 0.0)
