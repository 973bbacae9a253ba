"""What `elastic` conserves, and that `reflect` does not."""

import numpy as np
import pytest
from support.scenes import simulate
from support.selection import long_but

import mpsim
from mpsim import Scene


def cloud(count=400, seed=1):
    """Discs in the middle of a box so large that none reaches a wall, moving about each other."""
    inner = Scene.random(count=count, packing=0.5, radius=0.5, seed=seed)
    drift = np.array([0.5, -0.25])
    return mpsim.Scene(
        width=inner.width + 200,
        height=inner.height + 200,
        position=inner.position + 100,
        velocity=inner.velocity + drift,
        radius=0.5,
    )


def run(scene, frames=500, **settings):
    """Start and end velocities, and the number of contacts."""
    with simulate(scene, dt=0.01, **settings) as sim:
        start = sim.state.velocity.astype(float)
        contacts = sim.run(frames=frames).collisions
        position = sim.state.position
        end = sim.state.velocity.astype(float)
    assert contacts > scene.count / 2, f"only {contacts} contacts, which tests little"
    return start, end, contacts, position


def drift_of_momentum(start, end):
    """Change of the total momentum relative to the sum of all speeds."""
    return np.abs(end.sum(axis=0) - start.sum(axis=0)).max() / np.hypot(*start.T).sum()


@pytest.mark.parametrize("method", ["naive", "grid", "parallel"])
def test_elastic_contacts_keep_momentum_and_energy_far_from_walls(method):
    scene = cloud()
    start, end, _, position = run(scene, method=method, workers=2)
    assert ((position > 1) & (position < scene.width - 1)).all(), "a disc came near a wall"
    assert drift_of_momentum(start, end) < 1e-14
    assert (end**2).sum() == pytest.approx((start**2).sum(), rel=1e-13)


def test_reflecting_contacts_do_not_keep_momentum():
    """Negative control: the report's law fails the test above by ten orders of magnitude. It does keep energy."""
    start, end, _, _ = run(cloud(), method="grid", law="reflect")
    assert drift_of_momentum(start, end) > 1e-4
    assert (end**2).sum() == pytest.approx((start**2).sum(), rel=1e-12)


@pytest.mark.parametrize(("precision", "rel"), [("float64", 1e-12), ("float32", 1e-4)])
@pytest.mark.parametrize("law", ["elastic", "reflect"])
def test_a_closed_box_keeps_its_energy(law, precision, rel):
    scene = Scene.random(count=1000, packing=0.6, radius=0.5, seed=2)
    start, end, contacts, _ = run(scene, 1000, method="grid", law=law, precision=precision)
    assert contacts > 20_000
    assert (end**2).sum() == pytest.approx((start**2).sum(), rel=rel)


ROUNDING = float(np.finfo("float32").eps)

LONG_LIVED = {
    # 1 + 1: of discs that just touch, every root and quotient would be that of 1, rounded the same way each time
    "unit diameter": {},
    # 2 / 3 and 4 / 3: what each takes of an impulse would be the same two rounded numbers at every contact
    "two masses": {"mass": [1.0] * 5 + [2.0] * 5, "radius": 0.4},
    "pegs": {"obstacles": [mpsim.FixedDisc((x, 3.0), 0.5) for x in (1.0, 3.0, 5.0)]},
    "slopes": {"obstacles": [mpsim.Polyline([(1.0, 1.0), (4.7, 4.1)], 0.1)]},
}


@pytest.mark.slow
@pytest.mark.parametrize("contact", ["impact", "push"])
@pytest.mark.parametrize("name", long_but(LONG_LIVED, *(each for each in LONG_LIVED if each != "pegs")))
def test_energy_in_float32_does_not_creep_by_one_rounding_per_contact(name, contact):
    """Roundings that are all of one sign add up with the contacts, independent ones only with their root."""
    features = {"radius": 0.5, "seed": 1, "width": 6.0, "height": 6.0} | LONG_LIVED[name]
    scene = Scene.random(count=10 if "mass" in features else 6, **features)
    with simulate(scene, dt=0.05, method="naive", precision="float32", contact=contact) as sim:
        before = energy_of(sim)
        contacts = sim.run(frames=1_500_000).collisions / scene.count
        change = energy_of(sim) / before - 1
    bound = 8 * ROUNDING * np.sqrt(contacts)
    assert contacts * ROUNDING / 4 > 3 * bound, (
        f"{contacts:.0f} contacts of each disc could not tell one from the other"
    )
    assert abs(change) < bound


def energy_of(sim):
    """Twice the kinetic energy, summed in float64."""
    return float(sim.masses @ (sim.state.velocity.astype(float) ** 2).sum(axis=1))


@pytest.mark.slow
def test_a_push_adds_energy_under_gravity():
    """Negative control for energy: with gravity a push lifts discs, so the energy of a heap is not kept."""
    scene = Scene.random(count=200, packing=0.5, radius=0.5, seed=3, gravity=(0, -5))
    with simulate(scene, dt=0.02, method="grid") as sim:
        energies = []
        for _ in range(2):
            state = sim.state
            energies.append((state.velocity**2).sum() / 2 + 5 * state.position[:, 1].sum())
            sim.run(frames=500)
    assert energies[1] != pytest.approx(energies[0], rel=1e-9)


def test_the_angular_momentum_of_a_pair_is_kept_by_the_contact_but_not_by_the_push():
    """An impulse acts along the line of centres, so that angular momentum changes by the push alone, which is O(dt)."""
    scene = mpsim.Scene(width=40, height=40, position=[[18, 20], [22, 20.5]], velocity=[[1, 0], [-1, 0]], radius=0.5)
    changes = []
    for dt in (1 / 64, 1 / 1024):
        with simulate(scene, dt=dt, method="grid") as sim:
            before = spin(sim.state)
            assert sim.run(until=3.0).collisions >= 1
            changes.append(abs(spin(sim.state) - before))
    assert changes[1] < max(changes[0], 1e-12)
    assert changes[1] < 0.01


def spin(state):
    """Angular momentum about the origin."""
    x, y = state.position.T
    vx, vy = state.velocity.T
    return float((x * vy - y * vx).sum())
