"""Discs of several sizes and masses, with and without borders: what is kept, and one temperature for all."""

import math

import numpy as np
import pytest
from support.scenes import simulate

import mpsim
from mpsim import Scene, State
from mpsim.measure import observables

pytestmark = pytest.mark.plain


def mixture(boundary, seed=1, half=5):
    """Heavy and large discs, which have all energy at first, and as many light ones."""
    radius, mass = np.repeat([0.5, 0.3], half), np.repeat([1.0, 0.1], half)
    scene = Scene.random(count=2 * half, radius=radius, mass=mass, packing=0.4, boundary=boundary, seed=seed)
    velocity = scene.velocity * np.repeat([math.sqrt(2), 0.0], half)[:, None]
    return scene.starting_from(State(scene.position, velocity - mass @ velocity / mass.sum()))


@pytest.mark.parametrize(
    ("boundary", "settings", "equal"),
    [
        ("periodic", {"method": "event", "dt": 0.5}, True),
        ("walls", {"method": "naive", "contact": "impact", "dt": 0.04}, True),
        ("walls", {"method": "naive", "contact": "impact", "dt": 0.04, "law": "reflect"}, False),
    ],
    ids=str,
)
@pytest.mark.filterwarnings("ignore::mpsim.FastWarning")
def test_a_mixture_comes_to_one_temperature_but_under_reflect(boundary, settings, equal, figures):
    """Energy of the heavy ones over that of the light ones: 1, or (M - m) / (M - m') where momentum is kept.

    Discs that keep their speeds keep the ratio of the start: the control.
    """
    scene, half, ratio = mixture(boundary), 5, []
    with simulate(scene, **settings) as sim:
        sim.run(until=5.0)
        for _ in range(60):
            report = sim.run(until=sim.time + 0.5, measures=["energy_drift"])
            squares = scene.masses * (sim.state.velocity**2).sum(axis=1)
            ratio.append([squares[:half].mean(), squares[half:].mean()])
            assert abs(report.measures["energy_drift"].value) < 1e-12
        if settings["method"] == "event":
            assert observables.overlap(sim.state, scene).largest < 1e-12
    heavy, light = np.mean(ratio, axis=0)
    found = heavy / light if light else math.inf
    expected = 1 if boundary == "walls" else (5.5 - 1.0) / (5.5 - 0.1)
    assert found == pytest.approx(expected, rel=0.3) if equal else found > 50
    start = scene.masses * (scene.velocity**2).sum(axis=1)
    assert start[:half].mean() > 10 * start[half:].mean()
    figures.note(
        "B5", settings["method"], f"kT heavy / kT light, {boundary}", expected, f"{found:.2f}", "reflect: > 50"
    )


def test_a_mixture_goes_back_when_it_is_turned_round():
    scene = mixture("periodic")
    with simulate(scene, method="event", dt=2.0) as there:
        assert there.run(frames=1).collisions > 8
        state = there.state
    with simulate(scene.starting_from(State(state.position, -state.velocity)), method="event", dt=2.0) as back:
        back.run(frames=1)
        error = observables.trajectory_error(back.state, State(scene.position, scene.velocity), scene)
    assert error.largest < 1e-8


@pytest.mark.parametrize(
    ("boundary", "settings", "kept"),
    [
        ("periodic", {"method": "naive"}, True),
        ("periodic", {"method": "grid", "contact": "impact"}, True),
        ("periodic", {"method": "event", "dt": 1.0}, True),
        ("walls", {"method": "naive"}, False),
        ("periodic", {"method": "naive", "law": "reflect"}, False),
    ],
    ids=str,
)
def test_momentum_and_energy_stay_in_a_periodic_box(boundary, settings, kept, figures):
    """Walls take momentum, and the law `reflect` does not keep it: the controls."""
    scene = Scene.random(count=12, packing=0.4, radius=0.5, seed=3, boundary=boundary, mass=np.arange(12) % 3 + 1.0)
    with simulate(scene, **{"dt": 0.05, **settings}) as sim:
        assert sim.run(until=6.0, measures=[]).collisions > 30
        state = sim.state
    drift = np.abs(
        observables.momentum(state, scene) - observables.momentum(State(scene.position, scene.velocity), scene)
    )
    assert drift.max() < 1e-12 if kept else drift.max() > 0.5
    squares = scene.masses @ (state.velocity**2).sum(axis=1)
    assert squares == pytest.approx(scene.masses @ (scene.velocity**2).sum(axis=1), rel=1e-12)
    figures.note("A8", settings["method"], f"{boundary}: momentum gained", 0, f"{drift.max():.0e}", "walls, reflect")


def test_a_disc_added_to_a_mixture_brings_its_momentum_and_a_refused_one_nothing():
    scene = mixture("periodic")
    with simulate(scene, method="event", dt=0.5) as sim:
        sim.run(frames=2)
        digest = sim.digest()
        with pytest.raises(mpsim.InputError, match="overlap"):
            sim.add(sim.state.position[0], [0, 0], radius=0.1, mass=3.0)
        assert (sim.count, sim.digest(), len(sim.radii)) == (10, digest, 10)
        grid = np.stack(np.meshgrid(*[np.linspace(0, scene.width, 80, endpoint=False)] * 2), -1).reshape(-1, 2)
        r = grid[:, None] - sim.state.position[None]
        r -= scene.width * np.round(r / scene.width)
        free = grid[(np.hypot(r[..., 0], r[..., 1]) - sim.radii).min(axis=1).argmax()]
        momentum = scene.masses @ sim.state.velocity + 3.0 * np.array([1.0, -2.0])
        sim.add(free, [1.0, -2.0], radius=0.1, mass=3.0)
        assert sim.radii[-1] == 0.1
        sim.run(frames=6)
        assert np.abs(np.append(scene.masses, 3.0) @ sim.state.velocity - momentum).max() < 1e-12
