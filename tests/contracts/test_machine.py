"""What has no public door: words and barriers between workers, functions linked into kernels, compiling in turns.

That a barrier lets nobody through, and that an addition is not lost, would show in a public run only by luck.
"""

import threading
import time

import numpy as np
import pytest
from numba import njit
from numba.core.codegen import JITCodeLibrary
from support.arrays import control_of, team_of
from support.threads import together

from mpsim.kernels import compiling, layout, machine
from mpsim.kernels.compile_turns import Turns
from mpsim.kernels.compiling import compiled, inlined, linked
from mpsim.kernels.waiting import add_to_word, barrier, load_word, store_word

pytestmark = pytest.mark.compiled

# --- words


@compiled
def add_many(words, index, times):
    for _ in range(times):
        machine.atomic_add(words, index, 1)


def test_no_addition_is_lost():
    words = np.zeros(16, np.int64)
    together(*[lambda: add_many(words, 3, 500_000)] * 4)
    assert words[3] == words.sum() == 2_000_000
    store_word(words, 2, 40)
    assert (add_to_word(words, 2, 2), load_word(words, 2)) == (40, 42)


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
    kernel = njit(operation)
    kernel(np.zeros(1, np.int64))
    assert instruction in next(iter(kernel.inspect_llvm().values()))


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


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_nobody_passes_a_barrier_before_all_have_come(workers):
    control, team = control_of(0, workers=workers), team_of(workers)
    places = np.zeros((workers, 8), np.int64)
    members = [lambda worker=worker: meet_often(control, team, worker, places, 200) for worker in range(workers)]
    assert together(*members) == [0] * workers
    assert control.signals[layout.ARRIVED] == 400 * workers


def test_a_barrier_ends_when_the_abort_word_is_raised():
    control, team = control_of(0, workers=2), team_of(2)
    threading.Timer(0.05, store_word, (control.signals, layout.ABORT, layout.WORKER_LOST)).start()
    start = time.monotonic()
    assert barrier(control, team[0]) == layout.WORKER_LOST
    assert time.monotonic() - start > 0.04


# --- linking: functions that only kernels call are parts of those, and optimised nowhere else


@linked
def smaller(x, y):
    return min(x, y)


@inlined
def half_of_smaller(x, y):
    return smaller(x, y) / 2.0


@pytest.fixture
def kernel(monkeypatch):
    """A kernel that has yet to be compiled; what it calls in vain is needed by what it calls later."""
    monkeypatch.setattr(compiling, "_FOLDER", None)

    @compiled
    def kernel(x):
        never = 0
        if never:
            x = smaller(x, 1.0)
        return half_of_smaller(x, 5.0)

    return kernel


def test_a_kernel_alone_becomes_machine_code_with_all_that_it_reaches(kernel, monkeypatch):
    optimised, optimise = [], JITCodeLibrary._optimize_final_module
    monkeypatch.setattr(
        JITCodeLibrary, "_optimize_final_module", lambda self: (optimised.append(self.name), optimise(self))
    )
    assert (kernel(4.0), kernel(7.0), half_of_smaller(8.0, 6.0)) == (2.0, 2.5, 3.0)
    assert any(name.endswith("kernel") for name in optimised)
    assert not {"smaller", "half_of_smaller"} & set(optimised)


# --- compiling in turns


def test_what_another_has_compiled_meanwhile_is_loaded(tmp_path):
    first, second, cache, found = Turns(tmp_path, "kernel"), Turns(tmp_path, "kernel"), {}, []
    assert first.load_or_take("float64", lambda: None) is None
    waiting = threading.Thread(target=lambda: found.append(second.load_or_take("float64", lambda: cache.get("code"))))
    waiting.start()
    for name, signature in (("kernel", "float32"), ("another kernel", "float64")):  # which wait for nobody
        other = Turns(tmp_path, name)
        assert other.load_or_take(signature, lambda: None) is None
        other.give_back()
    time.sleep(0.1)
    assert waiting.is_alive()
    cache["code"] = "machine code"
    first.give_back()
    waiting.join(10)
    assert found == ["machine code"]
    assert first.load_or_take("float64", lambda: None) is None, "who loads it keeps no turn"
    first.give_back()


def test_nobody_waits_for_ever_for_one_that_keeps_its_turn_and_a_folder_may_be_missing(tmp_path, monkeypatch):
    monkeypatch.setattr("mpsim.kernels.compile_turns.LONGEST", 0.1)
    first, second = Turns(tmp_path, "kernel"), Turns(tmp_path, "kernel")
    first.load_or_take("float64", lambda: None)
    assert second.load_or_take("float64", lambda: "not asked for") is None
    first.give_back()
    assert Turns(tmp_path / "is not there", "kernel").load_or_take("float64", lambda: "not asked for") is None
