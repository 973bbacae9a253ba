"""The search by a button: its progress, its answer, its refusal, and what becomes of one that is given up."""

import threading

import pytest
from support.scenes import gas

import mpsim
from mpsim.viewer import tuning as module
from mpsim.viewer.tuning import Tuning

PATIENCE = 20.0
SCENE = gas(50, 0.2)


class Found:
    """An answer of `mpsim.tune`."""

    settings = mpsim.Settings(dt=0.03)

    def __str__(self):
        return "grid impact dt=0.03"


@pytest.fixture
def searched(monkeypatch):
    """A Tuning with another search, the settings that it has found, and what it has told."""

    def begin(search):
        monkeypatch.setattr(module, "tune", search)
        told, found = [], []
        tuning = Tuning(lambda: told.append(tuning.told()), lambda number, settings: found.append(settings))
        tuning.start(SCENE, {"pressure": 0.02})
        return tuning, told, found

    return begin


def test_progress_then_the_answer(searched):
    def search(scene, budgets, seconds, progress):
        assert (scene, budgets) == (SCENE, {"pressure": 0.02})
        progress(3, 9, "push dt=0.1")
        return Found()

    tuning, told, found = searched(search)
    tuning._work.wait(PATIENCE)
    assert [(each["phase"], each["text"]) for each in told] == [
        ("searching", "push dt=0.1"),
        ("found", "grid impact dt=0.03"),
    ]
    assert (told[0]["done"], told[0]["of"]) == (3, 9)
    assert found == [mpsim.Settings(dt=0.03)]
    assert not tuning.running


def test_a_budget_out_of_reach_is_told(searched):
    def search(scene, budgets, seconds, progress):
        raise mpsim.errors.BudgetError("max_error must be within reach")

    tuning, told, found = searched(search)
    tuning._work.wait(PATIENCE)
    assert (told[-1]["phase"], told[-1]["text"]) == ("failed", "max_error must be within reach")
    assert not found


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
@pytest.mark.parametrize(("error", "text"), [(MemoryError(), "MemoryError"), (UserWarning("too fast"), "too fast")])
def test_a_search_that_ends_by_another_error_is_over_too(searched, error, text):
    def search(scene, budgets, seconds, progress):
        raise error

    tuning, told, found = searched(search)
    tuning._work.wait(PATIENCE)
    assert (told[-1]["phase"], told[-1]["text"], found) == ("failed", text, [])
    assert not tuning.running, "or the stages would wait for ever"


def test_a_search_that_is_given_up_says_nothing_more(searched):
    started, released = threading.Event(), threading.Event()

    def search(scene, budgets, seconds, progress):
        started.set()
        assert released.wait(PATIENCE)
        progress(1, 2, "too late")
        return Found()

    tuning, told, found = searched(search)
    assert started.wait(PATIENCE)
    assert tuning.running
    tuning._work._stop.set()
    released.set()
    tuning.stop()
    assert (told, found, tuning.told()["phase"]) == ([], [], "none")
