"""Settings are checked and immutable; `auto` depends on the scene alone for bits and on the machine for speed."""

import dataclasses

import pytest
from support.scenes import gas, simulate

import mpsim
from mpsim.engine.batch_size import Pacer
from mpsim.engine.solvers import methods


def test_settings_are_immutable_and_equal_by_value():
    settings = mpsim.Settings(dt=0.02)
    with pytest.raises(dataclasses.FrozenInstanceError):
        settings.dt = 1
    assert settings == mpsim.Settings(dt=0.02)
    assert hash(settings) == hash(mpsim.Settings(dt=0.02))


def test_the_defaults_are_the_documented_ones():
    settings = mpsim.Settings()
    assert (settings.method, settings.law, settings.contact, settings.precision) == (
        "auto",
        "elastic",
        "impact",
        "float64",
    )
    assert (settings.workers, settings.substeps, settings.unguarded) == (None, 1, False)


def test_the_public_names_are_the_documented_ones():
    for name in mpsim.__all__:
        assert getattr(mpsim, name).__doc__, f"{name} has no docstring"
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        mpsim.nothing  # noqa: B018


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


def pace(pacer, seconds, frames, limit=10**9):
    """Run a pacer against workers whose frame times are given; returns the slices (workers, frames)."""
    slices, done = [], 0
    while done < frames:
        workers, size = pacer.next_slice(min(frames - done, limit))
        assert 1 <= size <= frames - done
        slices.append((workers, size))
        pacer.note(workers, size, seconds[workers])
        done += size
    return slices


@pytest.mark.parametrize("fast", [1, 4])
def test_the_pacer_finds_the_faster_number_of_workers(fast):
    seconds = {1: 2e-5, 4: 2e-5} | {fast: 1e-5}
    pacer = Pacer((4, 1), 4096)
    slices = pace(pacer, seconds, 200_000)
    assert pacer.best == fast
    assert sum(size for workers, size in slices if workers == fast) > 0.9 * 200_000


def test_the_pacer_notices_when_the_other_number_of_workers_becomes_faster():
    pacer = Pacer((4, 1), 4096)
    pace(pacer, {4: 1e-5, 1: 2e-5}, 100_000)
    assert pacer.best == 4
    pace(pacer, {4: 5e-5, 1: 2e-5}, 400_000)
    assert pacer.best == 1


def test_slices_are_short_enough_for_the_outside_world():
    for seconds in (1e-6, 1e-3, 1.0):
        slices = pace(Pacer((1,), 4096), {1: seconds}, 3000)
        assert all(size == 1 or size * seconds <= 0.05 * (1 + 1e-9) for _, size in slices[1:])


def test_progress_is_reported_up_to_the_end():
    seen = []
    with simulate(gas(20, 0.2), method="grid") as sim:
        sim.run(frames=10_000, progress=lambda done, of: seen.append((done, of)))
    assert seen[-1] == (10_000, 10_000)
    assert [done for done, _ in seen] == sorted({done for done, _ in seen})
    assert {of for _, of in seen} == {10_000}
