"""`auto` depends on the scene alone for bits and on the machine for speed."""

import pytest

import mpsim
from mpsim.engine.solvers import methods


@pytest.mark.parametrize("cores", [1, 2, 64])
def test_auto_chooses_bits_by_the_number_of_discs_alone(cores, monkeypatch):
    monkeypatch.setattr(methods, "usable_cores", lambda: cores)
    for count in (0, 1, 100, 1000, 10**6):
        choice = methods.choose(count, mpsim.Settings())
        assert (choice.method == "naive") == (count <= methods.NAIVE_UP_TO)
        assert max(choice.workers) <= cores


def test_auto_leaves_one_worker_as_a_choice():
    choice = methods.choose(10**5, mpsim.Settings(workers=3))
    assert (choice.method, sorted(choice.workers)) == ("parallel", [1, 3])


def test_parallel_uses_the_usable_cores_unless_told_otherwise(monkeypatch):
    monkeypatch.setattr(methods, "usable_cores", lambda: 5)
    assert methods.choose(10, mpsim.Settings(method="parallel")).workers == (5,)
    assert methods.choose(10, mpsim.Settings(method="parallel", workers=2)).workers == (2,)
    assert methods.choose(10, mpsim.Settings(method="grid", workers=2)).workers == (1,)


def test_a_daemonic_process_chooses_one_worker(monkeypatch):
    monkeypatch.setattr(methods, "may_start_processes", lambda: False)
    choice = methods.choose(10**5, mpsim.Settings(method="parallel", workers=4))
    assert choice.workers == (1,)
    assert "daemonic" in choice.remark
