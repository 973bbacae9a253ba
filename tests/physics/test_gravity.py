"""Discs under gravity: bounces, weight on the floor, rest, and heaps; each against a closed form, with its control."""

import math

import numpy as np
import pytest
from support.scenes import simulate

import mpsim
from mpsim import Scene, State
from mpsim.measure import independent_average, kinetic_energy, potential_energy

pytestmark = pytest.mark.plain

G = 1.0
HOW = {
    "impact": {"method": "naive", "contact": "impact", "dt": 0.05},
    "grid": {"method": "grid", "contact": "impact", "dt": 0.05},
    "event": {"method": "event", "dt": 5.0},
    "push": {"method": "naive", "contact": "push", "dt": 0.05},
}


def energy_above_floor(state, scene):
    """Kinetic and potential energy, heights counted from the lowest place of a centre."""
    return kinetic_energy(state, scene) + potential_energy(state, scene) - G * scene.radius * scene.count


# --- bounces


def bouncing(how, until=40.0, count=3, **features):
    """Discs that bounce side by side from different heights: energies over those at the start, and what push keeps.

    Under push, symplectic Euler keeps v^2/2 + g y - g v dt/2, the turn takes g |v| dt from it, and being put at the
    wall gives back half of that on average: |v| loses g dt/2 per bounce, the energy the part g^2 dt t / v_0^2.
    """
    rng = np.random.default_rng(1)
    height, speed = 5 + rng.random(count), rng.random(count) - 0.5
    landing = np.sqrt(speed**2 + 2 * G * height)
    scene = Scene(
        width=2 * count, height=10, radius=0.5, gravity=(0, -G), **features,
        position=np.stack([2.0 * np.arange(count) + 1, 0.5 + height], axis=1),
        velocity=np.stack([np.zeros(count), speed], axis=1),
    )  # fmt: skip
    with simulate(scene, **HOW[how]) as sim:
        sim.run(until=until)
        state, end = sim.state, sim.time
    kept = ((state.velocity**2).sum(axis=1) / 2 + G * (state.position[:, 1] - 0.5)) / (landing**2 / 2)
    return kept, np.maximum(1 - G**2 * HOW[how]["dt"] * end / landing**2 / 2, 0)


@pytest.mark.parametrize("how", ["impact", "event"])
def test_bounces_keep_their_energy_to_rounding(how):
    kept, _ = bouncing(how)
    assert np.abs(kept - 1).max() < 1e-12


def test_push_and_walls_with_losses_do_not():
    kept, expected = bouncing("push")
    assert kept.mean() == pytest.approx(expected.mean(), abs=0.04)
    assert kept.mean() < 0.93
    lossy, _ = bouncing("event", wall_restitution=1 - 1e-9)
    assert lossy.max() < 1 - 1e-8


def test_a_ball_that_loses_half_of_its_speed_ends_its_bounces_in_time_and_does_not_hang():
    """From then on it hovers: half a bounce of at most the contact time, and neither sinks nor rises."""
    height, g, guard = 2.0, 1.5, 1e-3
    end, wrong = (math.sqrt(2 * height / g) * (1 + e) / (1 - e) for e in (0.5, 0.51))
    scene, met = Scene(width=10, height=10, position=[[5.0, 0.5 + height]], velocity=[[0.0, 0.0]], radius=0.5,
                       gravity=(0, -g), wall_restitution=0.5), mpsim.Collisions()  # fmt: skip
    with simulate(scene, method="event", dt=end + 0.05, contact_time=guard) as sim:
        with pytest.warns(mpsim.errors.GuardWarning):
            report = sim.run(frames=1, observe=met)
        resting = sim.state.position[0, 1] - 0.5
    times = met.table["time"]
    last = times[len(times) - report.guarded]
    assert abs(last - end) < 3 * guard
    assert abs(last - wrong) > 50 * guard, "a restitution of 0.51 must fail"
    assert 0.0 <= resting <= g * guard**2 / 8 * 1.01
    assert 0.05 / guard * 0.9 < report.guarded < 0.05 / guard / 0.5 * 1.1


@pytest.mark.parametrize("speed", [0.0, 0.3])
def test_a_disc_at_rest_on_the_floor_stays_there(speed):
    scene = Scene(width=10, height=10, position=[[2.0, 0.5]], velocity=[[speed, 0.0]], radius=0.5, gravity=(0, -1))
    for settings in ({"method": "event", "dt": 1.0, "contact_time": 1e-2}, HOW["grid"]):
        with simulate(scene, **settings) as sim:
            if settings["method"] == "event":
                with pytest.warns(mpsim.errors.GuardWarning):
                    sim.run(until=3.0)
            else:
                sim.run(until=3.0)
            x, y = sim.state.position[0]
        assert abs(y - 0.5) < 2e-5
        assert abs(x - 2.0 - 3.0 * speed) < 1e-10


@pytest.mark.parametrize("restitution", [1.0, 0.0])
def test_a_grain_rests_on_a_thin_line_and_falls_where_it_ends(restitution):
    features = {"width": 8, "height": 8, "radius": 0.5, "gravity": (0, -G), "wall_restitution": restitution}
    for end, frames in ((8, 300), (3, 32)):
        line = mpsim.Polyline([(0, 2), (end, 2)])
        with simulate(
            Scene(position=[[4, 2.5]], velocity=[[0, 0]], obstacles=line, **features), **HOW["impact"]
        ) as sim:
            sim.run(frames=frames)
            (place,), (speed,) = sim.state.position, sim.state.velocity
        if end == 8:
            assert abs(place[1] - 2.5) < 1e-9
            assert np.abs(speed).max() < 1e-9
        else:
            assert place[1] < 1.5, "the control"


# --- what the walls carry


@pytest.mark.parametrize("how", ["impact", "push", "event", "reflect"])
def test_floor_less_ceiling_is_the_weight(how):
    """Exact at any step, as contacts keep momentum; those of `reflect`, the control, do not."""
    scene = Scene.random(count=9, packing=0.3, radius=0.5, seed=4, gravity=(0, -G), mass=np.arange(1.0, 10.0) % 3 + 1)
    sensors = {wall: mpsim.Sensor(wall=wall) for wall in ("left", "right", "bottom", "top")}
    settings = {**HOW["impact"], "law": "reflect"} if how == "reflect" else HOW[how]
    with simulate(scene, **settings) as sim:
        sim.run(until=4.0, observe=sensors.values())
        gained, until = scene.masses @ (sim.state.velocity - scene.velocity), sim.time
    pushed = {wall: sensor.impulse.sum() for wall, sensor in sensors.items()}
    weight = G * scene.masses.sum() * until
    missing = np.abs([pushed["left"] - pushed["right"] - gained[0],
                      pushed["bottom"] - pushed["top"] - weight - gained[1]]).max()  # fmt: skip
    assert missing < 1e-8 * weight if how != "reflect" else missing > 1e-3 * weight
    assert abs(pushed["bottom"] / weight - 1) > 1e-3, "the floor alone carries more than the weight"


def test_the_virial_of_walls_and_pairs_is_that_of_the_motion():
    """d/dt sum r.p = 2 K + r.F: from the box centre both walls of an axis push with the arm L/2 - R."""
    scene, met = Scene.random(count=20, packing=0.3, radius=0.5, seed=6), mpsim.Collisions()
    with simulate(scene, method="event", dt=5.0) as sim:
        sim.run(frames=1, observe=met)
        state = sim.state
    half, pushed = scene.width / 2, np.hypot(*met.table["impulse"].T)
    walls, pairs = pushed[met.table["kind"] == 1].sum(), pushed[met.table["kind"] == 0].sum()
    growth = ((state.position - half) * state.velocity).sum() - ((scene.position - half) * scene.velocity).sum()
    scale = 2 * kinetic_energy(state, scene) * 5.0
    error, control = (abs(scale - (half - 0.5) * part * walls + pairs - growth) / scale for part in (1.0, 0.999))
    assert error < 1e-12
    assert control > 1e-5, "leaving out one hit in a thousand must fail"


# --- energy of many discs


def drifts_of(scenes, until, **settings):
    """Change of the energy of each scene per unit of time, as a fraction of the kinetic energy."""
    drifts = []
    for scene in scenes:
        with simulate(scene, **settings) as sim:
            drifts.append(sim.run(until=until, measures=["energy_drift"]).measures["energy_drift"].value)
    return independent_average(drifts)


def pulled(seed):
    """Discs of which every other one is pulled up."""
    pull = np.zeros((16, 2))
    pull[:, 1] = np.where(np.arange(16) % 2, 1.0, -2.0)
    return Scene.random(count=16, packing=0.4, radius=0.5, seed=seed, acceleration=pull)


def pile(seed, count=16):
    """A dense pile whose weight over the side of its box is 30 kT."""
    box = {"count": count, "packing": 0.7, "radius": 0.5, "seed": seed}
    return Scene.random(**box, gravity=(0.0, -30 / Scene.random(**box).height))


@pytest.mark.parametrize(("kind", "gate"), [(pulled, 5e-4), (pile, 2e-4)])
def test_impact_keeps_the_energy_of_discs_that_are_pulled_or_piled_up_and_push_does_not(kind, gate):
    """Put on a wall without a bounce, and lifted for nothing, a pile gained a hundred times as much."""
    scenes = [kind(seed) for seed in range(2)]
    found, control = (drifts_of(scenes, 1.0, dt=0.02, method="naive", contact=each) for each in ("impact", "push"))
    assert abs(found.value) < gate
    assert abs(control.value) > 4 * gate, f"push must fail; got {control}"


@pytest.mark.long
def test_a_dense_pile_keeps_its_energy_over_a_long_time():
    for dt, gate in {0.02: 5e-5, 0.01: 1e-5}.items():
        scenes = [pile(seed, 100) for seed in range(16)]
        found = drifts_of(scenes, 60.0, dt=dt, method="naive", contact="impact")
        assert abs(found.value) + 2 * found.error < gate, f"a pile gains {found} per time at dt={dt}, allowed {gate}"
        control = drifts_of(scenes[:2], 60.0, dt=dt, method="naive", contact="push")
        assert abs(control.value) > 4 * gate, f"push must fail the gate {gate}; got {control} at dt={dt}"


@pytest.mark.long
def test_half_of_a_share_of_energy_is_potential():
    """Of discs so small that they hardly meet; a packing of 0.003 in the lower half raises them by as much."""
    shares = []
    for seed in range(24):
        low = Scene.random(count=20, width=8.0, height=3.0, radius=0.02, seed=seed)
        scene = Scene(width=8.0, height=60.0, radius=0.02, gravity=(0, -G), position=low.position,
                      velocity=low.velocity)  # fmt: skip
        energy, heights = energy_above_floor(State(scene.position, scene.velocity), scene), []
        with simulate(scene, method="event", dt=1.0) as sim:
            sim.run(until=100)
            while sim.time < 500:
                sim.run(until=sim.time + 4)
                heights.append(G * (sim.state.position[:, 1] - 0.02).mean())
            assert energy_above_floor(sim.state, scene) == pytest.approx(energy, rel=1e-5)
        shares.append(np.mean(heights) / (energy / 40))
    found = independent_average(shares)
    assert found.error < 0.01
    assert abs(found.value - 1) < 3 * found.error + 0.003, f"potential energy {found} of E/(2N)"
    assert abs(found.deviation(2 / 3)) > 20, "one share of three, as of springs, must fail"
