"""Slices of a run: how long, on how many workers, and progress between them."""

import pytest
from support.scenes import gas, simulate

from mpsim.engine.batch_size import BatchSizer


def pace(sizer, seconds, frames, limit=10**9):
    """Run a sizer against workers whose frame times are given; returns the slices (workers, frames)."""
    slices, done = [], 0
    while done < frames:
        workers, size = sizer.next_slice(min(frames - done, limit))
        assert 1 <= size <= frames - done
        slices.append((workers, size))
        sizer.note(workers, size, seconds[workers])
        done += size
    return slices


@pytest.mark.parametrize("fast", [1, 4])
def test_the_sizer_finds_the_faster_number_of_workers(fast):
    seconds = {1: 2e-5, 4: 2e-5} | {fast: 1e-5}
    sizer = BatchSizer((4, 1), 4096)
    slices = pace(sizer, seconds, 200_000)
    assert sizer.best == fast
    assert sum(size for workers, size in slices if workers == fast) > 0.9 * 200_000


@pytest.mark.parametrize(("slow", "trials"), [(2e-5, 3), (1.2e-5, 7)])
def test_a_number_of_workers_is_tried_the_longer_the_closer_it_comes(slow, trials):
    slices = pace(BatchSizer((4, 1), 4096), {4: 1e-5, 1: slow}, 50_000)
    assert sum(workers == 1 for workers, _ in slices) == trials


def test_the_sizer_notices_when_the_other_number_of_workers_becomes_faster():
    sizer = BatchSizer((4, 1), 4096)
    pace(sizer, {4: 1e-5, 1: 2e-5}, 100_000)
    assert sizer.best == 4
    pace(sizer, {4: 5e-5, 1: 2e-5}, 400_000)
    assert sizer.best == 1


def test_slices_are_short_enough_for_the_outside_world():
    for seconds in (1e-6, 1e-3, 1.0):
        slices = pace(BatchSizer((1,), 4096), {1: seconds}, 3000)
        assert all(size == 1 or size * seconds <= 0.05 * (1 + 1e-9) for _, size in slices[1:])


def test_progress_is_reported_up_to_the_end():
    seen = []
    with simulate(gas(20, 0.2), method="grid") as sim:
        sim.run(frames=10_000, progress=lambda done, of: seen.append((done, of)))
    assert seen[-1] == (10_000, 10_000)
    assert [done for done, _ in seen] == sorted({done for done, _ in seen})
    assert {of for _, of in seen} == {10_000}
