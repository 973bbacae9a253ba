"""Machine operations against their plain Python twins, and atomic addition between real threads."""

import time

import numpy as np
import pytest
from numba import njit
from support.threads import together

from mpsim.kernels import machine
from mpsim.kernels.waiting import add_to_word, load_word, store_word

REALS = [np.float32, np.float64]


@njit
def compiled_overlap_lanes(x, y, radius, start, xi, yi, reach):
    return machine.overlap_lanes(x, y, radius, start, xi, yi, reach)


@njit
def compiled_changed_lanes(before, after, start):
    return machine.changed_lanes(before, after, start)


@njit
def compiled_copy_lanes(source, first, target, slot):
    machine.copy_lanes(source, first, target, slot)


@njit
def compiled_add_to_lanes(array, start, number, value):
    machine.add_to_lanes(array, start, number, value)


@njit
def compiled_lowest_bit(mask):
    return machine.lowest_bit(mask)


@njit
def compiled_natural(index):
    return machine.nonnegative(index)


@pytest.mark.parametrize("real", REALS)
def test_the_vector_overlap_test_is_its_twin(real):
    rng = np.random.default_rng(1)
    x, y = (rng.random((2, 200)) * 4).astype(real)
    x[50:60], y[70] = np.nan, np.inf
    masks = set()
    for start in range(200 - machine.LANES):
        for xi, yi in ((x[3], y[3]), (real(2), real(1)), (real(np.nan), real(1))):
            arguments = x, y, None, start, xi, yi, real(1)
            expected = machine.overlap_lanes(*arguments)
            assert compiled_overlap_lanes(*arguments) == expected, f"start {start}, ({xi}, {yi})"
            masks.add(expected)
    assert len(masks) > 50, "the masks hardly differ, which tests little"


@pytest.mark.parametrize("real", REALS)
def test_discs_exactly_one_diameter_apart_do_not_overlap(real):
    x, y = np.full(8, 3, real), np.full(8, 4, real)
    assert compiled_overlap_lanes(x, y, None, 0, real(0), real(0), real(25)) == 0
    assert compiled_overlap_lanes(x, y, None, 0, real(0), real(0), np.nextafter(real(25), real(26))) == 255


def test_the_mask_of_what_has_changed_is_its_twin():
    rng = np.random.default_rng(2)
    before = rng.integers(-(2**31), 2**31, 100, np.int32)
    after = np.where(rng.random(100) < 0.3, before + 1, before).astype(np.int32)
    masks = {start: machine.changed_lanes(before, after, start) for start in range(100 - machine.LANES)}
    assert masks == {start: compiled_changed_lanes(before, after, start) for start in masks}
    assert len(set(masks.values())) > 20


@pytest.mark.parametrize("kind", [*REALS, np.int32])
def test_copying_and_adding_by_vectors_are_their_twins(kind):
    source = np.arange(60).astype(kind)
    for first, slot in ((0, 0), (3, 17), (44, 1)):
        targets = np.full((2, 60), -1, kind)
        machine.copy_lanes(source, first, targets[0], slot)
        compiled_copy_lanes(source, first, targets[1], slot)
        assert targets[0].tolist() == targets[1].tolist()
        assert (targets[0] >= 0).sum() == machine.RUN
    for number in (*range(machine.RUN + 1), 2 * machine.RUN) if kind is np.int32 else ():
        sums = np.stack([source, source])
        machine.add_to_lanes(sums[0], 5, number, -7)
        compiled_add_to_lanes(sums[1], 5, number, -7)
        assert sums[0].tolist() == sums[1].tolist()
        assert (sums[0] != source).sum() == min(number, machine.RUN)


def test_the_lowest_bit_is_its_twin():
    for mask in [*range(1, 256), 1 << 40, (1 << 62) | (1 << 7)]:
        expected = next(bit for bit in range(64) if mask >> bit & 1)
        assert machine.lowest_bit(mask) == compiled_lowest_bit(mask) == expected
        assert machine.lowest_bit(np.int64(mask)) == expected, "under NUMBA_DISABLE_JIT=1 masks are NumPy integers"


def test_natural_changes_nothing():
    assert [compiled_natural(index) for index in (0, 1, 2**40)] == [0, 1, 2**40]
    assert machine.nonnegative(5) == 5


@njit(nogil=True)
def add_many(words, index, times):
    for _ in range(times):
        machine.atomic_add(words, index, 1)


def test_no_atomic_addition_is_lost():
    words = np.zeros(16, np.int64)
    add_many(words, 3, 1)
    together(*[lambda: add_many(words, 3, 500_000)] * 4)
    assert words[3] == 2_000_001
    assert words.sum() == words[3]


@pytest.mark.parametrize(
    ("operation", "instruction"),
    [
        (lambda words: machine.atomic_add(words, 0, 1), "atomicrmw add"),
        (lambda words: machine.atomic_load(words, 0), "load atomic"),
        (lambda words: machine.atomic_store(words, 0, 1), "store atomic"),
    ],
)
def test_atomics_become_the_atomic_instruction(operation, instruction):
    """The mechanism itself: that unsynchronised threads go wrong could only be shown by luck."""
    compiled = njit(operation)
    compiled(np.zeros(1, np.int64))
    assert instruction in next(iter(compiled.inspect_llvm().values()))


def test_callers_in_python_have_the_same_operations():
    words = np.zeros(4, np.int64)
    store_word(words, 2, 40)
    assert add_to_word(words, 2, 2) == 40
    assert load_word(words, 2) == 42
    assert machine.atomic_add(words, 1, 5) == 0
    machine.atomic_store(words, 0, 7)
    assert [machine.atomic_load(words, index) for index in range(4)] == [7, 5, 42, 0]


@njit
def compiled_now(scratch):
    return machine.now(scratch)


@njit
def compiled_sleep(scratch, nanoseconds):
    machine.sleep_briefly(scratch, nanoseconds)
    machine.yield_core()
    machine.pause()


def test_the_clock_is_the_monotonic_one():
    scratch = np.zeros(2, np.int64)
    compiled_now(scratch)
    before = time.monotonic_ns()
    now = compiled_now(scratch)
    assert before <= now <= time.monotonic_ns()
    assert before <= machine.now(scratch) <= time.monotonic_ns()


def test_a_short_sleep_takes_about_its_time():
    scratch = np.zeros(2, np.int64)
    compiled_sleep(scratch, 1)
    start = time.monotonic()
    compiled_sleep(scratch, 20_000_000)
    assert 0.02 <= time.monotonic() - start < 1
