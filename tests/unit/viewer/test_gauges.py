"""Gauges are the numbers of mpsim.measure; what means nothing has none."""

import math

import numpy as np
import pytest
from support.scenes import gas

import mpsim
from mpsim import measure
from mpsim.kernels.layout import PHASES
from mpsim.viewer.gauges import Gauges, Meter


def test_numbers_are_those_of_the_library():
    scene = gas(200, 0.3)
    with mpsim.Simulation(scene, mpsim.Settings(method="grid")) as sim:
        gauges = Gauges(scene, sim.state)
        sim.run(frames=20)
        found, state = gauges.of(sim.state), sim.state
    assert found["discs"] == 200
    assert found["temperature"] == measure.temperature(state, scene)
    assert found["energy"] == measure.kinetic_energy(state, scene)
    start = mpsim.State(scene.position, scene.velocity)
    before, after = measure.kinetic_energy(start, scene), measure.kinetic_energy(state, scene)
    assert found["energy_drift"] == (after - before) / max(before, after)
    expected = measure.speed_distribution(state, len(found["speeds"]["density"]))
    for name, field in {"edges": "edges", "density": "value", "maxwell": "maxwell"}.items():
        assert (found["speeds"][name] == getattr(expected, field)).all()
    assert found["energy_note"] is None
    assert found["speeds"]["note"] is None


def test_energy_that_is_gained_is_a_drift():
    """Negative control: the gauge is not always about 0."""
    scene = gas(50, 0.2)
    gauges = Gauges(scene, mpsim.State(scene.position, scene.velocity))
    faster = mpsim.State(scene.position, scene.velocity * math.sqrt(1.25))
    assert gauges.of(faster)["energy_drift"] == pytest.approx(0.2)


PLACE = {"width": 6, "height": 6, "radius": 0.5, "position": [[1, 1], [4, 4]], "velocity": [[0, 0], [0, 1]]}


@pytest.mark.parametrize(
    ("features", "note"),
    [
        ({}, None),
        ({"gravity": (0, -1)}, None),
        ({"restitution": 0.9}, "contacts take energy"),
        ({"piston": mpsim.Piston("right", -0.1, 5.5)}, "a wall moves"),
        ({"absorbing": "right"}, "discs leave"),
        ({"emitters": [mpsim.Emitter(position=(3, 1), velocity=(0, 1), interval=9)]}, "discs enter"),
        ({"gravity": (0, -1), "boundary": "periodic"}, "discs fall through a periodic edge"),
    ],
)
def test_it_says_why_energy_is_not_constant(features, note):
    scene = mpsim.Scene(**PLACE, **features)
    assert (
        Gauges(scene, mpsim.State(scene.position, scene.velocity)).of(mpsim.State(scene.position, scene.velocity))[
            "energy_note"
        ]
        == note
    )


def test_without_discs_or_motion_there_are_no_numbers():
    scene = mpsim.Scene(width=4, height=4, position=np.zeros((0, 2)), velocity=np.zeros((0, 2)), radius=0.5)
    state = mpsim.State(scene.position, scene.velocity)
    found = Gauges(scene, state).of(state)
    assert found["discs"] == 0
    assert math.isnan(found["temperature"])
    assert math.isnan(found["energy_drift"])
    assert found["speeds"] is None


def test_maxwell_is_not_promised_where_it_cannot_be_expected():
    few = gas(10, 0.2)
    state = mpsim.State(few.position, few.velocity)
    assert Gauges(few, state).of(state)["speeds"]["note"] == "no Maxwell curve: fewer than 20 discs"
    mixed = gas(50, 0.2, mass=tuple(np.linspace(1, 2, 50)))
    state = mpsim.State(mixed.position, mixed.velocity)
    found = Gauges(mixed, state).of(state)["speeds"]
    assert (found["maxwell"], found["note"]) == (None, "no Maxwell curve: the discs differ in mass")


def test_rates_are_those_since_the_last_reading():
    meter, seconds = Meter(100.0), np.full(10, 2e-6)
    report = mpsim.Report(seconds, dict.fromkeys(PHASES, np.zeros((10, 1))), 40, "grid", 1, (0,), 0, {}, 0)
    meter.note(report)
    meter.note(report)
    rates = meter.read(count=50, now=102.0)
    assert (rates.frames_per_second, rates.collisions_per_second) == (10.0, 40.0)
    assert rates.nanoseconds == pytest.approx(2e-6 * 1e9 / 50)
    assert math.isnan(meter.read(count=50, now=103.0).frames_per_second), "nothing has run since"


def test_parts_of_a_workers_time_add_up_to_one():
    meter = Meter(0.0)
    with mpsim.Simulation(gas(200, 0.3), mpsim.Settings(method="grid")) as sim:
        report = sim.run(frames=20)
        meter.note(report)
        meter.note(sim.run(frames=5))
    found = meter.workers()
    assert found["workers"].shape == (1, len(found["phases"]))
    assert found["workers"].sum(axis=1) == pytest.approx(1.0)
    assert found["waiting"] == pytest.approx(report.waiting, abs=0.3)
    assert meter.read(200, 1.0).frames_per_second == 25
    assert meter.workers()["workers"] is None, "since the last reading"


GRAINS = ("channel", "cooling", "hopper", "rough-hopper", "rough-sediment", "sediment")


@pytest.mark.parametrize("name", ["dense", "gas", "piston", *GRAINS])
def test_no_heap_of_grains_has_maxwells_curve(name):
    scene = mpsim.Scene.load(name)
    moving = mpsim.State(scene.position, np.random.default_rng(1).normal(size=scene.position.shape))
    assert (Gauges(scene, moving).of(moving)["speeds"]["maxwell"] is None) is (name in GRAINS)
