"""Measures and observers in scenes with rough walls: what a wall takes from a disc, along its normal and across."""

import json

import pytest
from support.scenes import simulate

import mpsim


def oblique(**features):
    """One disc that hits the left wall obliquely."""
    return mpsim.Scene(width=10, height=10, radius=0.5, position=[[1, 5]], velocity=[[-1, 1]], **features)


@pytest.mark.parametrize("method", ["event", "naive", "grid"])
def test_momentum_drift_is_refused_where_rough_walls_take_momentum(method, compiled_when_run):
    refused = pytest.raises(mpsim.InputError, match="only without rough walls, whose tangential impulses are not count")
    with simulate(oblique(wall_friction=0.5), method=method) as sim, refused:
        sim.run(until=1.0, measures=["momentum_drift"])
    for study in (mpsim.tradeoff, mpsim.tune):
        budget = ["momentum_drift"] if study is mpsim.tradeoff else {"momentum_drift": 1e-3}
        with pytest.raises(mpsim.InputError, match="rough walls"):
            study(oblique(wall_friction=0.5), **{"measures" if study is mpsim.tradeoff else "max_error": budget})


@pytest.mark.slow
@pytest.mark.parametrize("rough", [{"friction": 0.5}, {"wall_friction": 0.5, "boundary": "periodic"}])
def test_momentum_drift_remains_where_only_discs_are_rough(rough):
    scene = mpsim.Scene.random(count=12, packing=0.3, radius=0.5, seed=1, **rough)
    with simulate(scene, method="event") as sim:
        assert sim.run(until=2.0, measures=["momentum_drift"]).measures["momentum_drift"].value < 1e-8


@pytest.mark.slow
def test_a_reference_whose_own_drift_is_not_zero_is_not_called_zero(tmp_path):
    """The saved runs of the reference are given a drift: the table then says it, instead of 0."""
    scene = mpsim.Scene.random(count=8, packing=0.2, radius=0.5, seed=1)
    study = {"until": 2.0, "measures": ["momentum_drift"], "replicas": 2, "path": tmp_path / "table.json"}
    exact = [mpsim.Settings(method="event")]
    error = mpsim.tradeoff(scene, exact, **study).rows[0].errors["momentum_drift"]
    assert repr(error) == "0 (the reference itself)", "rounding is not a drift"
    saved = json.loads(study["path"].read_text())
    for number, run in enumerate(value for key, value in saved["results"].items() if key.startswith("long")):
        run["momentum_drift"] = [4.6e-4 + 1e-6 * number] * len(run["momentum_drift"])
    study["path"].write_text(json.dumps(saved))
    error = mpsim.tradeoff(scene, exact, **study).rows[0].errors["momentum_drift"]
    assert error.value == pytest.approx(4.6e-4, rel=0.02)
    assert "reference itself" not in repr(error)
