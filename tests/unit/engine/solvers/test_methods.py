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


def test_what_a_method_can_do_is_known_from_settings_and_auto_is_as_its_methods():
    found = {name: methods.capabilities_of(mpsim.Settings(method=name)) for name in (*methods.METHODS, "auto")}
    assert [name for name, each in found.items() if not each.has_steps] == ["event"]
    assert [name for name, each in found.items() if each.is_exact] == ["event"]
    chosen = {methods.choose(count, mpsim.Settings(workers=2)).method for count in (1, 180, 10**5)}
    assert chosen == set(methods.AUTO)


def test_auto_is_exact_only_if_all_that_it_may_choose_are(monkeypatch):
    monkeypatch.setattr(methods, "AUTO", ("event", "grid"))
    assert not methods.capabilities_of(mpsim.Settings()).is_exact
    monkeypatch.setattr(methods, "AUTO", ("event",))
    assert methods.capabilities_of(mpsim.Settings()).is_exact


def test_a_checkpoint_goes_on_by_a_method_with_the_same_bits_only():
    for method in ("grid", "parallel", "mpi"):
        assert methods.same_bits("grid", method) == method
    assert methods.same_bits("event", "event") == "event"
    for saved, method in (("grid", "naive"), ("event", "grid"), ("auto", "parallel")):
        with pytest.raises(mpsim.InputError, match=f"{saved}.*which have the same bits; got '{method}'"):
            methods.same_bits(saved, method)
    with pytest.raises(mpsim.InputError, match=r"got 'grid'\. 'auto' may choose 'naive', which has other bits\. L"):
        methods.same_bits("auto", "grid")
