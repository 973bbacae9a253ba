"""Warnings of simulations: given on the caller's line, or caught in one thread and given in another."""

import threading
import warnings
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext

import pytest
from support.scenes import gas

import mpsim
from mpsim.engine import notices
from mpsim.studies.replicas import quietly


def test_the_innermost_catcher_of_a_kind_gets_it():
    with (
        notices.caught(mpsim.FastWarning, mpsim.errors.GuardWarning) as outer,
        notices.caught(mpsim.FastWarning) as inner,
    ):
        notices.warn("fast", mpsim.FastWarning)
        notices.warn("guard", mpsim.errors.GuardWarning)
    assert (outer, inner) == (["guard"], ["fast"])


def test_other_kinds_are_given_and_so_are_all_afterwards():
    with notices.caught(mpsim.FastWarning) as texts, pytest.warns(mpsim.OverlapWarning, match="overlap"):
        notices.warn("overlap", mpsim.OverlapWarning)
    with pytest.warns(mpsim.FastWarning, match="again"):
        notices.warn("again", mpsim.FastWarning)
    assert texts == []


def test_a_thread_that_suppresses_leaves_the_others_their_warnings():
    both = threading.Barrier(2)

    def too_fast(context):
        with context:
            both.wait(20)
            mpsim.Simulation(gas(20, 0.2), mpsim.Settings(dt=5.0, workers=1)).close()
            both.wait(20)

    with warnings.catch_warnings(record=True) as given, ThreadPoolExecutor(2) as threads:
        warnings.simplefilter("always")
        list(threads.map(too_fast, [quietly(), nullcontext()]))
    assert [each.category for each in given] == [mpsim.FastWarning]
