"""What has no public door: words and barriers between workers, compiling in turns.

That a barrier lets nobody through, and that an addition is not lost, would show in a public run only by luck.
"""

import numpy as np
import pytest
from numba import njit
from support.arrays import control_of, team_of
from support.threads import together

from mpsim.kernels import machine, records
from mpsim.kernels.compiling import Turns, compiled
from mpsim.kernels.waiting import barrier

pytestmark = pytest.mark.compiled

# --- words


def all_operations(words):
    machine.atomic_store(words, 0, 1)
    return machine.atomic_add(words, 0, 1) + machine.atomic_load(words, 0)


def test_atomics_become_the_atomic_instruction():
    """The mechanism itself: that unsynchronised threads go wrong could only be shown by luck."""
    kernel = njit(all_operations)
    assert kernel(np.zeros(1, np.int64)) == 3
    code = next(iter(kernel.inspect_llvm().values()))
    assert all(instruction in code for instruction in ("atomicrmw add", "load atomic", "store atomic"))


# --- waiting


@compiled
def meet_often(control, team, worker, places, rounds):
    """Count the barriers after which somebody had not yet come to them."""
    early = 0
    mine = team[worker]
    for number in range(1, rounds + 1):
        places[worker, 0] = number
        barrier(control, mine)
        for other in range(team.shape[0]):
            early += places[other, 0] < number
        barrier(control, mine)
    return early


@pytest.mark.parametrize("workers", [2, 5])
def test_nobody_passes_a_barrier_before_all_have_come(workers):
    control, team = control_of(0, workers=workers), team_of(workers)
    places = np.zeros((workers, 8), np.int64)
    members = [lambda worker=worker: meet_often(control, team, worker, places, 200) for worker in range(workers)]
    assert together(*members) == [0] * workers
    assert control.signals[records.ARRIVED] == 400 * workers


# --- compiling in turns


def test_nobody_waits_for_ever_for_one_that_keeps_its_turn_and_a_folder_may_be_missing(tmp_path, monkeypatch):
    monkeypatch.setattr("mpsim.kernels.compiling.LONGEST", 0.1)
    first, second = Turns(tmp_path, "kernel"), Turns(tmp_path, "kernel")
    first.load_or_take("float64", lambda: None)
    assert second.load_or_take("float64", lambda: "not asked for") is None
    first.give_back()
    assert Turns(tmp_path / "is not there", "kernel").load_or_take("float64", lambda: "not asked for") is None
