"""One frame pass by pass: its end is the solver's own to the last bit, and each pass is what it says."""

import itertools

import numpy as np
import pytest
from support.scenes import ZOO, gas, simulate, zoo

import mpsim
from mpsim.engine.simulation import next_frame_in_passes

SCENE = gas(300, 0.4)


def passes_and_end(scene, frames=7, **settings):
    """The passes of a frame, the state before it, and after the solver's own frame with its count of contacts."""
    with simulate(scene, **settings) as sim:
        sim.run(frames=frames)
        before, found = sim.state, next_frame_in_passes(sim)
        assert sim.state.digest() == before.digest(), "looking has changed the simulation"
        report = sim.run(frames=1)
        return found, before, sim.state, report.collisions


@pytest.mark.slow
@pytest.mark.parametrize(
    "settings",
    [
        {"method": "grid"},
        {"method": "grid", "passes": 2, "substeps": 3},
        {"method": "grid", "contact": "impact"},
        {"method": "parallel", "workers": 2},
    ],
    ids=str,
)
def test_the_last_pass_has_the_bits_of_the_frame(settings):
    found, before, after, contacts = passes_and_end(SCENE, dt=0.05, **settings)
    steps, passes = settings.get("substeps", 1), settings.get("passes", 1)
    assert [each.name for each in found] == ["even", "odd"] * (steps * passes)
    assert found[-1].state.digest() == after.digest()
    assert sum(each.contacts for each in found) == contacts > 5
    assert min(found[0].contacts, found[1].contacts) > 0
    assert found[0].state.digest() not in (before.digest(), after.digest())


def test_an_even_pass_alone_is_not_the_frame():
    """The control: without the odd pass the bits are others, so that the test above can fail."""
    found, _, after, _ = passes_and_end(SCENE, dt=0.05, method="grid")
    assert found[0].state.digest() != after.digest()


def test_brackets_are_disjoint_and_a_pass_changes_nothing_else():
    found, *_ = passes_and_end(SCENE, dt=0.05, method="parallel", workers=2)
    even, odd = found
    width = SCENE.width / even.columns
    for each in found:
        columns = np.concatenate([each.brackets, each.brackets + 1])
        assert len(np.unique(columns)) == len(columns)
        assert set(each.owners.tolist()) == {0, 1}
        assert (np.diff(each.owners) >= 0).all()
    assert set(even.brackets % 2) == {0}
    assert set(odd.brackets % 2) == {1}
    changed = np.flatnonzero((even.state.velocity != odd.state.velocity).any(axis=1))
    assert 2 <= len(changed) <= 2 * odd.contacts
    column = (even.state.position[changed, 0] / width).astype(int)
    pairs = itertools.product(changed, changed)
    near = {i for i, j in pairs if i != j and np.hypot(*(even.state.position[i] - even.state.position[j])) < 1}
    assert near == set(changed.tolist()), "a disc that met nobody was changed"
    assert ((column >= 1) & (column < even.columns)).all()


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::mpsim.FastWarning")
@pytest.mark.parametrize("name", [name for name in ZOO if "giants" not in ZOO[name] and "emitters" not in ZOO[name]])
def test_with_features_too(name):
    found, _, after, contacts = passes_and_end(zoo(ZOO[name]), method="grid", passes=2, substeps=2)
    assert found[-1].state.digest() == after.digest()
    assert sum(each.contacts for each in found) == contacts


@pytest.mark.parametrize(
    ("scene", "settings", "what"),
    [
        (SCENE, {"method": "event"}, "'event', which has no columns"),
        (SCENE, {"method": "naive"}, "'naive', which has no columns"),
    ],
    ids=["event", "naive"],
)
def test_what_has_no_passes_is_refused(scene, settings, what):
    with (
        mpsim.Simulation(scene, mpsim.Settings(**settings)) as sim,
        pytest.raises(mpsim.InputError, match=f"one pass at a time needs .*{what}"),
    ):
        next_frame_in_passes(sim)
