"""Features of a scene against closed forms: masses, periodic borders, obstacles under gravity. Each has a control."""

import math
from dataclasses import replace

import numpy as np
import pytest
from support.scenes import gas, simulate

from mpsim import FixedDisc, Polyline, Scene
from mpsim.measure import independent_average

pytestmark = pytest.mark.slow

ROUNDING = 1e-12
G = 1.0


def miss_of_unequal_discs(contact, restitution, dt=0.01):
    """Largest miss of velocities and energy lost, of a disc of mass 1 and one of mass 4, at three angles, 8 phases."""
    worst, mass = np.zeros(2), np.array([1.0, 4.0])
    for offset in (0.1, 0.4, 0.7):
        for phase in range(8):
            position = np.array([[3 + phase * dt / 8, 5.0], [6.0, 5.0 + offset]])
            velocity = np.array([[1.5, 0.0], [0.0, 0.0]])
            features = dict(width=20, height=20, radius=0.5, mass=mass, restitution=restitution)
            scene = Scene(position=position, velocity=velocity, **features)
            r, u = position[1] - position[0], velocity[1] - velocity[0]
            b, c = r @ u, r @ r - 1
            normal = r + u * c / (-b + math.sqrt(b * b - u @ u * c))
            reduced = mass[0] * mass[1] / mass.sum()
            impulse = -(1 + restitution) * reduced * (u @ normal)
            after = velocity + impulse * np.outer([-1 / mass[0], 1 / mass[1]], normal)
            with simulate(scene, method="naive", dt=dt, contact=contact) as sim:
                sim.run(until=2.5)
                found = sim.state.velocity
            lost = (mass[:, None] * (velocity**2 - found**2)).sum() / 2
            energy = abs(lost - (1 - restitution**2) / 2 * reduced * (u @ normal) ** 2)
            worst = np.maximum(worst, [np.abs(found - after).max(), energy])
            assert np.abs(mass @ (found - velocity)).max() < ROUNDING, "momentum is kept by any contact"
    return worst


@pytest.mark.parametrize("restitution", [1.0, 0.6])
def test_a2_discs_of_unequal_masses_part_as_the_closed_form_says(restitution, figures):
    velocity, energy = miss_of_unequal_discs("impact", restitution)
    assert max(velocity, energy) < ROUNDING
    control, _ = miss_of_unequal_discs("push", restitution)
    assert control > 1e-3, "a normal found up to a frame late must show"
    quantity = f"masses 1 and 4, e = {restitution}: velocities, largest miss"
    figures.note("A2", "impact", quantity, 0, f"{velocity:.0e}", f"push: {control:.1e}")


def light_over_heavy(contact, law, starts=4):
    """Mean kinetic energy of 50 discs of mass 1 over that of 50 discs of mass 10, from equal temperatures of speeds."""
    ratios = []
    for seed in range(starts):
        base = gas(100, 0.3, seed=seed)
        mass = np.where(np.arange(100) < 50, 1.0, 10.0)
        features = dict(width=base.width, height=base.height, radius=0.5, mass=mass)
        scene = Scene(position=base.position, velocity=base.velocity, **features)
        with simulate(scene, method="naive", dt=0.02, contact=contact, law=law) as sim:
            sim.run(until=50)
            energies = np.zeros(2)
            for _ in range(200):
                sim.run(frames=50)
                each = mass * (sim.state.velocity**2).sum(axis=1)
                energies += each[:50].mean(), each[50:].mean()
        ratios.append(energies[0] / energies[1])
    return independent_average(ratios)


def test_b5_light_and_heavy_discs_come_to_the_same_mean_energy(figures):
    found = light_over_heavy("impact", "elastic")
    assert abs(found.value - 1) < 3 * found.error + 0.01
    assert found.error < 0.03
    control = light_over_heavy("impact", "reflect", starts=2)
    assert control.value < 0.2, "discs that keep their speeds keep the energies of the start"
    figures.note("B5", "impact", "energy of mass 1 over mass 10, 50 each", 1, found, f"reflect: {control}")


def test_a8_momentum_and_energy_stay_in_a_periodic_box(figures):
    base = gas(100, 0.4, seed=3)
    features = dict(width=base.width, height=base.height, radius=0.5, position=base.position, velocity=base.velocity)
    drifts = []
    for boundary, law in (("periodic", "elastic"), ("walls", "elastic"), ("periodic", "reflect")):
        scene = Scene(**features, boundary=boundary)
        with simulate(scene, method="naive", dt=0.02, contact="impact", law=law) as sim:
            contacts = sim.run(frames=20_000).collisions
            drifts.append(np.abs(sim.state.velocity.sum(axis=0) - scene.velocity.sum(axis=0)).max())
            energy = (sim.state.velocity**2).sum() / (scene.velocity**2).sum() - 1
            assert abs(energy) < 1e-11
    assert contacts > 10_000
    assert drifts[0] < 1e-10, f"momentum drifts by {drifts[0]} in a periodic box"
    assert min(drifts[1:]) > 1, "walls take momentum, and reflect does not keep it"
    lost = f"walls: {drifts[1]:.1f}, reflect: {drifts[2]:.1f}"
    figures.note("A8", "impact", "periodic box: momentum gained, 20,000 frames", 0, f"{drifts[0]:.0e}", lost)


def sinai_bias(contact, dt, starts=24, until=1500.0):
    """Rate of collisions of two discs in a periodic box at total momentum 0, less the exact one, as a part of it."""
    rates = []
    for seed in range(starts):
        rng = np.random.default_rng(seed)
        apart = np.zeros(2)
        while np.hypot(*apart) < 0.4:
            position = rng.random((2, 2))
            apart = position[0] - position[1]
            apart -= np.round(apart)
        angle = rng.random() * 2 * math.pi
        velocity = np.array([[1.0], [-1.0]]) * [math.cos(angle), math.sin(angle)]
        scene = Scene(width=1, height=1, position=position, velocity=velocity, radius=0.2, boundary="periodic")
        with simulate(scene, method="naive", dt=dt, contact=contact) as sim:
            rates.append(sim.run(until=until).collisions / until)
    exact = 2 * 0.4 * 2 / (1 - math.pi * 0.4**2)
    mean = independent_average(rates)
    return replace(mean, value=mean.value / exact - 1, error=mean.error / exact)


def test_b3_two_discs_in_a_periodic_box_meet_at_their_rate(figures):
    """dt = 0.06 is 0.3 of a diameter per frame at their relative speed of 2."""
    found, control = sinai_bias("impact", 0.06), sinai_bias("push", 0.06)
    assert abs(found.value) < 3 * found.error + 0.002
    assert found.error < 0.005
    assert control.value < -0.1, f"push must meet too seldom; got {control}"
    finer = sinai_bias("push", 0.03)
    assert 1.5 < control.value / finer.value < 4, f"and less so at half the step: {control}, {finer}"
    figures.note("B3", "impact", "two discs, periodic: pair rate, dt = 0.06, bias", 0, found, f"push: {control}")


OBSTACLES = {
    "floor": Polyline([(0, 1), (8, 1)]),
    "slope": Polyline([(-0.0, 0.8), (8, 1.2)], 0.2),
    "pegs": [FixedDisc((k + 0.5, 1), 0.5) for k in range(8)],
}


def energy_on(obstacles, contact, dt, restitution=1.0):
    """Energy of a bouncing disc over that at the start, less 1, after some 350 bounces."""
    features = dict(width=8, height=40, radius=0.5, gravity=(0, -G), obstacles=obstacles, wall_restitution=restitution)
    scene = Scene(position=[[4.1, 6.5]], velocity=[[0.3, 0]], **features)
    with simulate(scene, method="naive", dt=dt, contact=contact) as sim:
        sim.run(until=2000)
        state = sim.state
    energy = (state.velocity**2).sum() / 2 + G * (state.position[0, 1] - 0.5)
    return energy / (0.3**2 / 2 + 6 * G) - 1


@pytest.mark.parametrize("name", OBSTACLES)
def test_a11_bounces_on_obstacles_keep_their_energy(name, figures):
    drift = energy_on(OBSTACLES[name], "impact", 0.01)
    assert abs(drift) < 1e-10, f"{drift} of the energy"
    control = energy_on(OBSTACLES[name], "push", 0.01)
    assert control < -0.2, f"push must lose energy at each bounce; got {control}"
    figures.note("A11", "impact", f"350 bounces on {name}: energy gained", 0, f"{drift:.0e}", f"push: {control:.2f}")


@pytest.mark.parametrize("restitution", [1.0, 0.5, 0.0])
def test_a_grain_rests_on_a_thin_line_for_ever(restitution, figures):
    """100,000 frames, in which it would fall 500,000 diameters."""
    features = dict(width=8, height=8, radius=0.5, gravity=(0, -G), wall_restitution=restitution)
    start = dict(position=[[4, 2.5]], velocity=[[0, 0]])
    with simulate(Scene(**start, **features, obstacles=Polyline([(0, 2), (8, 2)])), method="naive", dt=0.01,
                  contact="impact") as sim:  # fmt: skip
        sim.run(frames=100_000)
        place, speed = sim.state.position[0, 1] - 2.5, np.abs(sim.state.velocity).max()
    assert abs(place) < 1e-9, f"it has sunk by {-place}"
    assert speed < 1e-9
    with simulate(Scene(**start, **features, obstacles=Polyline([(0, 2), (3, 2)])), method="naive", dt=0.01,
                  contact="impact") as sim:  # fmt: skip
        sim.run(frames=1000)
        assert sim.state.position[0, 1] < 1.5, "where the line ends it must fall"
    figures.note(
        "A11",
        "impact",
        f"grain on a line, e = {restitution}, 1e5 frames: sunk",
        0,
        f"{abs(place):.0e}",
        "no line: falls",
    )


def beyond_a_thin_wall(count, way, seed):
    """Most discs of radius 1/2 seen beyond a wall across the box, when each moves `way` in a frame."""
    rng = np.random.default_rng(seed)
    angle = rng.random(count) * 2 * math.pi
    velocity = 100 * way * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    position = Scene.random(count=count, width=9.5, height=10, radius=0.5, seed=seed).position
    walls = [Polyline([(10, 0), (10, 10)]), FixedDisc((5, 5), 0.05)]
    features = dict(width=20, height=10, radius=0.5, obstacles=walls, gravity=(0, 0))
    beyond = 0
    with simulate(Scene(position=position, velocity=velocity, **features), method="naive", dt=0.01,
                  contact="impact", law="reflect") as sim:  # fmt: skip
        for _ in range(100):
            sim.run(frames=20)
            beyond = max(beyond, int((sim.state.position[:, 0] > 10).sum()))
    return beyond


@pytest.mark.parametrize(("count", "part"), [(1, 0.98), (60, 0.3)])
def test_i4_no_disc_passes_a_thin_wall_at_less_than_its_radius_in_a_frame_or_a_third_of_it_in_a_crowd(
    count, part, figures
):
    """In a crowd contacts, which come after the obstacles, move a disc into a wall: at 0.45 R a few do pass."""
    starts = 1 + 30 // count
    found = sum(beyond_a_thin_wall(count, part / 2, seed) for seed in range(starts))
    assert found == 0, f"{found} discs are beyond the wall"
    control = sum(beyond_a_thin_wall(count, 4 * part, seed) for seed in range(starts))
    assert control > 0, "at eight times the speed they must pass, or the test cannot tell"
    quantity = f"{count} discs, v dt = {part} R: beyond a thin wall"
    figures.note("I4", "impact", quantity, 0, found, f"8 v: {control}")
