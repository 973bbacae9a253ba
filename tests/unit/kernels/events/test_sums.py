"""Sums in fixed point against exact fractions."""

import math
from fractions import Fraction

import numpy as np
import pytest
from support.internals import machine_code

from mpsim.kernels.events import records, sums

add = machine_code(sums.add)
UNIT = 2.0**-20
QUANTUM = Fraction(UNIT) / 2**records.FINE


def summed(values, entry=0):
    """The tally of these numbers, added one by one."""
    tally = np.zeros((), records.TALLY)[()]
    for value in values:
        add(tally, entry, float(value), UNIT)
    return tally


def value_of(tally, entry=0):
    """The number that an entry stands for."""
    return Fraction(UNIT) * int(tally.coarse[entry]) + QUANTUM * int(tally.fine[entry])


VALUES = {
    "one": [1.0],
    "mixed": np.random.default_rng(1).normal(size=200),
    "negative": -np.random.default_rng(2).random(200),
    "huge": np.random.default_rng(3).normal(size=50) * 1e11,
    "small": np.random.default_rng(4).normal(size=200) * 1e-9,
    "below what can be told": [1e-30, -1e-30, -5e-324, 5e-324],
    "huge and small": [1e12, 1e-12, -1e12, -1e-12, 3.0],
    "carries": [UNIT * (1 - 2.0**-33)] * 5,
}


@pytest.mark.parametrize("name", VALUES)
def test_a_sum_is_exact_but_for_one_unit_of_the_fine_part_a_summand(name):
    values, tally = VALUES[name], summed(VALUES[name])
    assert abs(value_of(tally) - sum(map(Fraction, map(float, values)))) <= QUANTUM * len(values)
    assert 0 <= tally.fine[0] < 2**records.FINE
    parts = sum(value_of(summed([value])) for value in values)
    assert value_of(tally) == parts, "what is rounded is each summand, not the sum"


def test_multiples_of_the_fine_unit_are_added_without_any_error():
    rng = np.random.default_rng(5)
    values = rng.integers(-(2**52), 2**52, 500) * math.ldexp(UNIT, -records.FINE)
    assert value_of(summed(values)) == sum(map(Fraction, values))


@pytest.mark.parametrize("name", ["mixed", "huge", "huge and small", "carries"])
def test_the_order_of_what_is_added_changes_nothing(name):
    values, rng = np.array(VALUES[name]), np.random.default_rng(6)
    tally = summed(values)
    for _ in range(5):
        assert summed(rng.permutation(values)).tobytes() == tally.tobytes()


def test_the_order_would_change_a_sum_of_reals():
    """The control."""
    values = VALUES["mixed"]
    assert len({sum(np.random.default_rng(seed).permutation(values).tolist()) for seed in range(20)}) > 1


def test_a_fine_part_that_is_full_is_carried():
    tally = summed([UNIT / 2] * 3)
    assert (tally.coarse[0], tally.fine[0]) == (1, 2 ** (records.FINE - 1))
    assert (summed([-UNIT / 2]).coarse[0], summed([-UNIT / 2]).fine[0]) == (-1, 2 ** (records.FINE - 1))


def test_entries_are_separate():
    tally = summed([1.5], entry=records.VIRIAL_XY)
    assert value_of(tally, records.VIRIAL_XY) == Fraction(3, 2)
    assert np.count_nonzero(tally.coarse) == 1
