"""Crowds with features: what is kept, the way back, and stepped runs that come to the exact one; with controls."""

import numpy as np
import pytest
from support.scenes import after, simulate, state_after

from mpsim import FixedDisc, Piston, Polyline, Scene, State
from mpsim.measure import observables

pytestmark = pytest.mark.plain

PEGS = [FixedDisc((x + 0.13, y), 0.5) for x in (2, 5, 8) for y in (2, 5)]
BENT = Polyline([(0.5, 7.6), (4.0, 8.0), (7.0, 7.5), (7.0, 6.8)], 0.2)
PULL = (0.3, -1.0)
OPEN = {"absorbing": ("bottom", "left"), "obstacles": FixedDisc((4.5, 2.5), 0.5), "radius": 0.3}


def crowd(**features):
    return Scene.random(**{"count": 14, "width": 10, "height": 9, "radius": 0.4, "seed": 3, **features})


def energy(state, scene):
    gravity = np.zeros(2) if scene.gravity is None else scene.gravity
    return (
        0.5 * scene.masses @ (state.velocity**2).sum(axis=1) - (scene.masses[:, None] * state.position * gravity).sum()
    )


def start_of(scene):
    return State(scene.position, scene.velocity)


KEEPING = {
    "obstacles": {"obstacles": [*PEGS, BENT]},
    "obstacles and gravity": {"obstacles": [*PEGS, BENT], "gravity": PULL},
    "obstacles and borders": {"obstacles": [*PEGS, BENT], "gravity": (0, -1.0), "boundary": ("periodic", "walls")},
    "mixture": {"radius": np.repeat([0.5, 0.3], 7), "mass": np.repeat([1.0, 0.1], 7), "boundary": "periodic"},
    "closed box": {},
}


@pytest.mark.parametrize("name", KEEPING)
def test_exact_runs_keep_the_energy_and_go_back_when_they_are_turned_round(name):
    """No disc is ever in another or in an obstacle. The control: losses of a millionth."""
    scene = crowd(**KEEPING[name])
    with simulate(scene, method="event", dt=1.0) as sim:
        for _ in range(3):
            sim.run(frames=1)
            assert observables.overlap(sim.state, scene).largest < 1e-12
            assert scene._deepest(sim.state.position, scene.radii - 1e-12) is None
        there = sim.state
    before = energy(start_of(scene), scene)
    assert abs(energy(there, scene) / before - 1) < 1e-12
    with simulate(scene.starting_from(State(there.position, -there.velocity)), method="event", dt=3.0) as back:
        assert back.run(frames=1).collisions > 3
        error = observables.trajectory_error(back.state, start_of(scene), scene)
    assert error.largest < 1e-8
    lossy = crowd(**KEEPING[name], restitution=1 - 1e-6, wall_restitution=1 - 1e-6)
    assert energy(state_after(lossy, 1, method="event", dt=3.0), lossy) < before - 1e-6 * abs(before)


@pytest.mark.parametrize(
    ("settings", "features", "kept"),
    [
        ({"method": "naive"}, {}, True),
        ({"method": "grid", "contact": "impact"}, {}, True),
        ({"method": "event", "dt": 1.0}, {}, True),
        ({"method": "naive"}, {"boundary": "walls"}, False),
        ({"method": "grid", "law": "reflect"}, {}, False),
        ({"method": "grid", "precision": "float32"}, {}, True),
    ],
    ids=str,
)
def test_momentum_and_energy_stay_in_a_periodic_box(settings, features, kept):
    """Walls take momentum, and the law `reflect` does not keep it: the controls."""
    scene = Scene.random(count=12, packing=0.4, radius=0.5, seed=3, mass=np.arange(12) % 3 + 1.0,
                         **{"boundary": "periodic", **features})  # fmt: skip
    with simulate(scene, **{"dt": 0.05, **settings}) as sim:
        assert sim.run(until=4.0).collisions > 20
        state = sim.state
    rounding = 1e-4 if "precision" in settings else 1e-12
    drift = np.abs(scene.masses @ (state.velocity.astype(float) - scene.velocity)).max()
    assert drift < rounding if kept else drift > 0.5
    assert energy(state, scene) == pytest.approx(energy(start_of(scene), scene), rel=rounding)


STEPPED = {
    # features, their control, time, and the error that is allowed of `impact`, which is exact for one contact a step
    "obstacles": ({"obstacles": [*PEGS, BENT]}, {"obstacles": PEGS}, 0.75, 1e-9),
    "obstacles and gravity": ({"obstacles": [*PEGS, BENT], "gravity": PULL}, {"obstacles": PEGS}, 0.75, 1e-5),
    "piston": (
        {"piston": Piston("right", -0.5, 7.0), "gravity": PULL},
        {"piston": Piston("right", -0.6, 7.0)},
        1.5,
        1e-5,
    ),
    "absorbing": ({**OPEN, "gravity": PULL, "seed": 2}, {"gravity": (0.3, -1.1)}, 1.5, 1e-4),
}


@pytest.mark.parametrize("name", STEPPED)
def test_stepped_runs_come_to_the_exact_one_as_their_step_shrinks(name):
    """`push` with the step, before chaos has multiplied its errors; who has left is the same."""
    features, other, until, most = STEPPED[name]
    scene, ends = crowd(**features), {}
    for key, made, settings, steps in (
        ("exact", scene, {"method": "event"}, 1),
        ("impact", scene, {"contact": "impact"}, 120),
        ("push", scene, {}, 25),
        ("short push", scene, {}, 150),
        ("control", scene._replace(**other), {"method": "event"}, 1),
    ):
        ends[key] = state_after(made, steps, **{"method": "grid", "dt": until / steps, **settings})
    gone = ~ends["exact"].present
    assert gone.any() == (name == "absorbing")
    assert all((~ends[key].present == gone).all() for key in ("impact", "push", "short push"))
    errors = {key: observables.trajectory_error(end, ends["exact"], scene).rms for key, end in ends.items()}
    assert errors["impact"] < most
    assert errors["push"] / errors["short push"] > 2.5, errors
    assert errors["control"] > max(3 * errors["impact"], 1e-3)


def test_a_reversed_run_comes_home_with_impact_but_not_with_push():
    """But for discs that had two contacts in one frame; `push` is the control."""
    scene, parts = Scene.random(count=16, packing=0.3, radius=0.5, seed=8), {}
    for contact in ("impact", "push"):
        there = scene
        for _ in range(2):
            state = after(there, 0.5, contact=contact)
            there = scene.starting_from(State(state.position, -state.velocity))
        parts[contact] = (np.hypot(*(there.position - scene.position).T) < 1e-9).mean()
    assert parts["impact"] > 0.85
    assert parts["push"] < 0.5


def test_a_disc_added_to_a_mixture_brings_its_momentum():
    scene = crowd(**KEEPING["mixture"])
    with simulate(scene, method="event", dt=0.5) as sim:
        sim.run(frames=2)
        grid = np.stack(np.meshgrid(np.arange(0, 10, 0.2), np.arange(0, 9, 0.2)), -1).reshape(-1, 2)
        apart = grid[:, None] - sim.state.position
        apart -= [10, 9] * np.round(apart / [10, 9])
        free = grid[(np.hypot(*np.moveaxis(apart, -1, 0)) - sim.radii).min(axis=1).argmax()]
        momentum = scene.masses @ sim.state.velocity + 3.0 * np.array([1.0, -2.0])
        sim.add(free, [1.0, -2.0], radius=0.1, mass=3.0)
        assert sim.radii[-1] == 0.1
        sim.run(frames=6)
        assert np.abs(np.append(scene.masses, 3.0) @ sim.state.velocity - momentum).max() < 1e-12


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
def test_a_mixture_comes_to_one_temperature_but_under_reflect(boundary, settings, equal):
    """Energy of the heavy over that of the light discs: 1, or (M - m) / (M - m') where momentum is kept.

    Discs that keep their speeds, under `reflect`, keep the ratio of the start: the control.
    """
    radius, mass, ratio = np.repeat([0.5, 0.3], 5), np.repeat([1.0, 0.1], 5), []
    scene = Scene.random(count=10, radius=radius, mass=mass, packing=0.4, boundary=boundary, seed=1)
    velocity = scene.velocity * np.repeat([2**0.5, 0.0], 5)[:, None]
    scene = scene.starting_from(State(scene.position, velocity - mass @ velocity / mass.sum()))
    with simulate(scene, **settings) as sim:
        sim.run(until=5.0)
        for _ in range(30 if equal else 3):
            sim.run(until=sim.time + 0.5)
            squares = mass * (sim.state.velocity**2).sum(axis=1)
            ratio.append([squares[:5].mean(), squares[5:].mean()])
    heavy, light = np.mean(ratio, axis=0)
    expected = 1 if boundary == "walls" else (5.5 - 1.0) / (5.5 - 0.1)
    assert heavy / light == pytest.approx(expected, rel=0.3) if equal else heavy > 50 * light
