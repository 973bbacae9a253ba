"""The exact solver as users have it, with radii, masses and periodic axes; numbers as in docs/accuracy.md."""

import math

import numpy as np
import pytest

import mpsim
from mpsim.core.state import State
from mpsim.measure import observables, reference

pytestmark = pytest.mark.slow

DENSE_72 = reference.DENSE_72.value


def exactly(scene, dt=1.0):
    return mpsim.Simulation(scene, mpsim.Settings(method="event", dt=dt))


def test_a2_impact_of_two_sizes_and_masses_through_a_border(figures):
    masses, radii = np.array([2.0, 5.0]), np.array([0.5, 0.3])
    velocity = np.array([[-1.5, 0.1], [0.5, -0.2]])
    position = np.array([[1.0, 5.0], [8.0, 5.4]])
    scene = mpsim.Scene(width=10, height=10, position=position, velocity=velocity, radius=radii, mass=masses,
                        boundary="periodic")  # fmt: skip
    with exactly(scene, dt=2.0) as sim:
        report = sim.run(frames=1, measures=["momentum_drift", "pressure"])
        state = sim.state
    assert report.collisions == 1
    r, u = position[1] - position[0] - [10, 0], velocity[1] - velocity[0]
    b, contact = r @ u, radii.sum()
    time = (r @ r - contact**2) / (-b + math.sqrt(b**2 - u @ u * (r @ r - contact**2)))
    n = (r + time * u) / contact
    impulse = 2 * masses.prod() / masses.sum() * (u @ n)
    after = velocity + impulse * np.outer(1 / masses * [1, -1], n)
    error = np.abs(state.velocity - after).max()
    assert error < 1e-14
    places = np.mod(position + velocity * time + after * (2 - time), 10)
    assert np.abs(state.position - places).max() < 1e-13
    # The tally is the sum of r.dp over twice the largest radius: the pressure must give it back.
    virial = -impulse * contact
    energy = observables.kinetic_energy(state, scene)
    flow = observables.momentum(state, scene)
    energy -= flow @ flow / (2 * masses.sum())
    assert report.measures["pressure"].value == pytest.approx((energy + virial / (2 * 2)) / 100, rel=1e-13)
    # Negative control: equal masses would part differently.
    equal = velocity + (u @ n) * np.outer([1, -1], n)
    assert np.abs(state.velocity - equal).max() > 0.1
    figures.note(
        "A2", "exact", "velocities after impact, two sizes and masses", "0", f"{error:.0e}", "equal masses: 0.1"
    )


@pytest.mark.long
@pytest.mark.parametrize(("k", "pairs"), [(0, 2), (1, 16), (2, 157), (3, 1571)])
def test_a6_counts_the_digits_of_pi_with_two_sizes(k, pairs):
    """Half of the 3, 31, 314, 3141 collisions, rounded up, are those of the pair; the others hit the wall."""
    scene = mpsim.Scene(width=300, height=1, position=[[3, 0.5], [8, 0.5]], velocity=[[0, 0], [-1, 0]],
                        radius=[0.4, 0.5], mass=[1, 100.0**k])  # fmt: skip
    with exactly(scene, dt=100.0) as sim:
        assert sim.run(frames=1).collisions == pairs


def test_b3_two_discs_on_a_torus_collide_at_sinais_rate(figures):
    starts, frames, relative = 24, 5000, 2 * math.sqrt(2)
    rates = []
    for seed in range(starts):
        rng = np.random.default_rng(seed)
        angle = rng.uniform(0, 2 * math.pi)
        v = math.sqrt(2) * np.array([math.cos(angle), math.sin(angle)])
        scene = mpsim.Scene.random(count=2, radius=0.2, width=1, height=1, boundary="periodic", seed=seed)
        scene = scene.starting_from(State(scene.position, np.array([v, -v])))
        with exactly(scene) as sim:
            rates.append(sim.run(frames=frames).collisions / frames)
    expected = reference.sinai_rate(1, 1, 0.2, relative)
    mean, error = np.mean(rates), np.std(rates, ddof=1) / math.sqrt(starts)
    assert error / expected < 3e-3
    assert abs(mean - expected) < 3.5 * error
    # Negative control: a radius that is wrong by one per cent shows.
    assert abs(mean - reference.sinai_rate(1, 1, 0.202, relative)) > 3.5 * error
    figures.note("B3", "exact", "pair rate on a torus", f"{expected:.4f}", f"{mean:.4f}({error * 1e4:.0f})", "R + 1 %")


def test_72_dense_discs_on_a_torus_have_the_published_pressure(figures):
    """beta P (2R)^2: the pressure of the box at rest lacks the kT / area of a moving centre of mass."""
    found = []
    for seed in range(4):
        scene = mpsim.Scene.random(count=72, packing=0.65, radius=0.5, boundary="periodic", seed=seed)
        area = scene.width * scene.height
        with exactly(scene) as sim:
            sim.run(frames=30)
            before = sim.state
            measures = sim.run(frames=400, measures=["pressure", "momentum_drift", "energy_drift"]).measures
            after = sim.state
        kt = observables.temperature(after, scene, remove_drift=True)
        found.append(measures["pressure"].value / kt + 1 / area)
        assert np.abs(observables.momentum(after, scene) - observables.momentum(before, scene)).max() < 1e-12
        assert abs(measures["energy_drift"].value) < 1e-14
        assert observables.overlap(after, scene).largest < 1e-12
    mean, error = np.mean(found), np.std(found, ddof=1) / 2
    assert error / DENSE_72 < 2e-3
    assert abs(mean - DENSE_72) < 4 * error
    # Negative control: kT = E/N, as between walls, shows.
    assert abs(mean * 72 / 71 - DENSE_72) > 8 * error
    figures.note(
        "N = 72", "exact", "beta P (2R)^2, packing 0.65", DENSE_72, f"{mean:.3f}({error * 1e3:.0f})", "E/N: +1.4 %"
    )


def mixture(boundary, seed=1):
    radius, mass = np.repeat([0.5, 0.3], 60), np.repeat([1.0, 0.1], 60)
    scene = mpsim.Scene.random(count=120, radius=radius, mass=mass, packing=0.4, boundary=boundary, seed=seed)
    # All energy is with the heavy ones at first.
    velocity = scene.velocity * np.repeat([math.sqrt(2), 0.0], 60)[:, None]
    velocity -= (mass @ velocity) / mass.sum()
    return scene.starting_from(State(scene.position, velocity))


@pytest.mark.parametrize("boundary", ["walls", "periodic", ("periodic", "walls")])
def test_a_mixture_comes_to_one_temperature(boundary, figures):
    scene = mixture(boundary)
    ratio = []
    with exactly(scene) as sim:
        sim.run(frames=50)
        for _ in range(150):
            report = sim.run(frames=1, measures=["momentum_drift", "energy_drift"])
            squares = scene.masses * (sim.state.velocity**2).sum(axis=1)
            ratio.append(squares[:60].mean() / squares[60:].mean())
            assert report.measures["momentum_drift"].value < 1e-13
            assert abs(report.measures["energy_drift"].value) < 1e-13
        assert observables.overlap(sim.state, scene).largest < 1e-12
    start = scene.masses * (scene.velocity**2).sum(axis=1)
    assert start[:60].mean() / start[60:].mean() > 50
    assert np.mean(ratio) == pytest.approx(1, abs=0.06)
    figures.note(
        "equipartition", "exact", f"kT heavy / kT light, {boundary}", 1, f"{np.mean(ratio):.3f}", "start: > 50"
    )


def test_a_mixture_goes_back_when_it_is_turned_round():
    scene = mixture("periodic")
    with exactly(scene) as there:
        there.run(until=1.0)
        state = there.state
    with exactly(scene.starting_from(State(state.position, -state.velocity))) as back:
        assert back.run(until=1.0).collisions > 200
        error = observables.trajectory_error(back.state, State(scene.position, scene.velocity), scene)
    assert error.largest < 1e-7


def test_discs_are_added_to_a_mixture_and_nothing_of_a_refused_one_stays():
    scene = mixture("periodic")
    heavy = np.flatnonzero(scene.radii == 0.5)
    with exactly(scene, dt=0.5) as sim:
        sim.run(frames=2)
        place = sim.state.position[heavy[0]]
        digest = sim.digest()
        with pytest.raises(mpsim.InputError, match="overlap"):
            sim.add(place, [0, 0], radius=0.1, mass=3.0)
        assert (sim.count, sim.digest(), len(sim.radii)) == (120, digest, 120)
        free = free_place(sim.state.position, sim.radii, scene, 0.1)
        momentum = (scene.masses @ sim.state.velocity, 3.0 * np.array([1.0, -2.0]))
        sim.add(free, [1.0, -2.0], radius=0.1, mass=3.0)
        assert sim.radii[-1] == 0.1
        sim.run(frames=10)
        masses = np.append(scene.masses, 3.0)
        assert np.abs(masses @ sim.state.velocity - sum(momentum)).max() < 1e-12


def free_place(position, radii, scene, radius):
    """The point of a fine lattice that is farthest from all discs."""
    grid = np.stack(np.meshgrid(*[np.linspace(0, scene.width, 80, endpoint=False)] * 2), -1).reshape(-1, 2)
    r = grid[:, None] - position[None]
    r -= scene.width * np.round(r / scene.width)
    gap = (np.hypot(r[..., 0], r[..., 1]) - radii).min(axis=1)
    assert gap.max() > radius
    return grid[gap.argmax()]
