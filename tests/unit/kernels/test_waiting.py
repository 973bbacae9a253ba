"""Words and barriers between real threads."""

import threading
import time

import numpy as np
import pytest
from numba import njit
from support.arrays import control_of, team_of
from support.threads import together

from mpsim.kernels import layout, machine
from mpsim.kernels.waiting import add_to_word, await_command, barrier, store_word


@njit(nogil=True)
def send_many(words, data, times):
    """Message passing: first the data, then the word that announces it; the reader takes turns."""
    for number in range(1, times + 1):
        data[0] = number
        machine.atomic_store(words, 0, number)
        while machine.atomic_load(words, 8) != number:
            machine.yield_core()


@njit(nogil=True)
def receive_many(words, data, times):
    """Count the messages whose data were not there when they were announced."""
    wrong = 0
    for number in range(1, times + 1):
        while machine.atomic_load(words, 0) != number:
            machine.yield_core()
        wrong += data[0] != number
        machine.atomic_store(words, 8, number)
    return wrong


def test_what_was_written_before_a_word_is_there_when_the_word_is_seen():
    words, data, times = np.zeros(16, np.int64), np.zeros(1, np.int64), 20_000
    assert together(lambda: send_many(words, data, times), lambda: receive_many(words, data, times))[1] == 0


@njit(nogil=True)
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


@pytest.mark.parametrize("workers", [1, 2, 3, 5])
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
    assert 0.04 < time.monotonic() - start < 5


def test_waiting_for_a_command_ends_by_command_message_or_time():
    control, mine = control_of(0, workers=2), team_of(2)[1]
    second = 1_000_000_000
    start = time.monotonic()
    assert not await_command(control, mine, second // 50)
    assert 0.02 <= time.monotonic() - start < 5
    for word in (layout.COMMAND, layout.MAIL):
        control.signals[:] = 0
        threading.Timer(0.02, add_to_word, (control.signals, word, 1)).start()
        assert await_command(control, mine, 20 * second)
        assert control.signals[word] == 1
