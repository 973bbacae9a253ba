"""Measures and observers in scenes with rough walls: what a wall takes from a disc, along its normal and across."""

import numpy as np
import pytest
from support.scenes import simulate

import mpsim

pytestmark = pytest.mark.plain


def oblique(**features):
    """One disc that hits the left wall obliquely."""
    return mpsim.Scene(width=10, height=10, radius=0.5, position=[[1, 5]], velocity=[[-1, 1]], **features)


@pytest.mark.parametrize(
    ("study", "asked"),
    [(mpsim.tradeoff, {"measures": ["momentum_drift"]}), (mpsim.tune, {"max_error": {"momentum_drift": 1e-3}})],
)
def test_studies_refuse_momentum_drift_where_rough_walls_take_momentum(study, asked):
    with pytest.raises(mpsim.InputError, match="only without rough walls, whose tangential impulses are not counted"):
        study(oblique(wall_friction=0.5), **asked)


def test_momentum_drift_remains_where_only_discs_are_rough():
    scene = mpsim.Scene.random(count=12, packing=0.3, radius=0.5, seed=1, wall_friction=0.5, boundary="periodic")
    with simulate(scene, method="event") as sim:
        assert sim.run(until=2.0, measures=["momentum_drift"]).measures["momentum_drift"].value < 1e-8


WALLS = {"rough": {"wall_friction": 0.7}, "thermal": {"thermal_walls": mpsim.ThermalWalls(left=2.0)}}


def rough(walls):
    """Rough discs of two masses that meet each other, such walls, and an obstacle."""
    return mpsim.Scene.random(
        count=16, width=6, height=6, radius=0.5, seed=2, mass=np.where(np.arange(16) % 2, 1.0, 3.0), friction=0.4,
        restitution=0.9, obstacles=mpsim.FixedDisc((3, 3), 0.4), **WALLS[walls],
    )  # fmt: skip


@pytest.mark.filterwarnings("ignore::mpsim.errors.GuardWarning")
@pytest.mark.parametrize(
    ("method", "contact", "walls"),
    [
        ("event", "impact", "rough"),
        ("grid", "impact", "rough"),
        ("naive", "push", "rough"),
        ("event", "impact", "thermal"),
        ("grid", "impact", "thermal"),
    ],
)
def test_both_impulses_of_all_collisions_are_the_change_of_each_momentum(method, contact, walls):
    scene, seen = rough(walls), mpsim.Collisions()
    sensors = [mpsim.Sensor(wall="bottom"), mpsim.Sensor(wall="left"), mpsim.Sensor(obstacle=0)]
    with simulate(scene, method=method, contact=contact, dt=0.02) as sim:
        sim.run(frames=60, observe=[seen, *sensors])
        gained = scene.masses[:, None] * (sim.state.velocity - scene.velocity)
    table = seen.table
    given = {name: np.zeros((scene.count, 2)) for name in ("impulse", "tangential_impulse")}
    for name, total in given.items():
        np.add.at(total, table["i"], table[name])
        discs = table[table["kind"] == 0]
        np.subtract.at(total, discs["j"], discs[name])
    assert gained == pytest.approx(given["impulse"] + given["tangential_impulse"], abs=1e-9)
    assert np.abs(gained - given["impulse"]).max() > 0.1, "the control: without friction it does not add up"
    across = (table["impulse"] * table["tangential_impulse"]).sum(axis=1)
    assert np.abs(across).max() < 1e-9, "they are at right angles"
    chosen = (table["kind"] == 1) & (table["j"] == 2), (table["kind"] == 1) & (table["j"] == 0), table["kind"] == 2
    for sensor, rows in zip(sensors, chosen, strict=True):
        for name in given:
            assert getattr(sensor, name).sum() == pytest.approx(np.hypot(*table[name][rows].T).sum())
            assert (getattr(sensor, name).sum() > 0) == (name == "impulse" or walls == "rough" or sensor is sensors[1])


def test_smooth_discs_have_no_tangential_impulse():
    seen = mpsim.Collisions()
    with simulate(oblique(), method="event") as sim:
        sim.run(until=1.0, observe=seen)
    assert (len(seen.table), seen.table["impulse"].tolist()) == (1, [[2.0, 0.0]])
    assert np.signbit(seen.table["tangential_impulse"]).tolist() == [[False, False]]
    assert not seen.table["tangential_impulse"].any()
