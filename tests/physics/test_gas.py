"""Statistics of a gas against kinetic theory, and the report's double visit of pairs."""

import math

import numpy as np
import pytest
from support.compare import overlapping_pairs
from support.scenes import simulate

import mpsim


def equal_speeds(count, packing, seed):
    """A gas whose discs all have speed sqrt(2): far from the Maxwell distribution, with the same energy."""
    scene = mpsim.Scene.random(count=count, packing=packing, radius=0.5, seed=seed)
    angle = np.random.default_rng(seed).random(count) * 2 * math.pi
    velocity = math.sqrt(2) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return mpsim.Scene(width=scene.width, height=scene.height, position=scene.position, velocity=velocity, radius=0.5)


def kurtosis(velocity):
    """<v^4> / <v^2>^2 of the speeds: 2 N / (N + 1) in equilibrium at fixed energy, 1 for equal speeds."""
    squares = (velocity.astype(float) ** 2).sum(axis=1)
    return (squares**2).mean() / squares.mean() ** 2


@pytest.mark.parametrize("law", ["elastic"])
def test_collisions_bring_the_speeds_to_the_maxwell_distribution(law):
    count = 4000
    with simulate(equal_speeds(count, 0.3, seed=1), dt=0.02, method="grid", law=law) as sim:
        assert kurtosis(sim.state.velocity) == pytest.approx(1, abs=1e-9)
        sim.run(frames=500)
        found = []
        for _ in range(10):
            found.append(kurtosis(sim.state.velocity))
            sim.run(frames=50)
    # One snapshot scatters by about 2 sqrt(2 / N) = 0.045; ten of them, hardly correlated, by a third of that.
    assert np.mean(found) == pytest.approx(2 * count / (count + 1), abs=0.07), f"kurtosis {found}"


def test_reflecting_contacts_never_change_a_speed():
    """Negative control: the report's law mirrors each velocity, so equal speeds stay equal for ever."""
    with simulate(equal_speeds(1000, 0.3, seed=1), dt=0.02, method="grid", law="reflect") as sim:
        assert sim.run(frames=500).collisions > 1000
        assert kurtosis(sim.state.velocity) == pytest.approx(1, abs=1e-9)


def mean_overlap(dt, snapshots, seed=2):
    """Mean depth of the overlaps that `push` meets, over snapshots of a gas of packing 0.2."""
    scene = mpsim.Scene.random(count=4000, packing=0.2, radius=0.5, seed=seed)
    depths = []
    with simulate(scene, dt=dt, method="grid") as sim:
        for _ in range(snapshots):
            sim.run(frames=5)
            state = sim.state
            distances = overlapping_pairs(state.position + state.velocity * dt, 1.0)[2]
            depths.append(1.0 - distances)
    return np.concatenate(depths)


def test_the_mean_overlap_that_push_meets_is_that_of_kinetic_theory():
    """Approach speeds of contacts follow v exp(-v^2 / 4 kT), mean sqrt(pi) sigma; a contact is half a frame old.

    So the mean overlap is sqrt(pi) / 2 sigma dt = 0.886 sigma dt, sigma being the spread of one velocity component.
    """
    dt = 0.005
    depths = mean_overlap(dt, snapshots=300)
    scatter = depths.std() / math.sqrt(len(depths)) / depths.mean()
    assert scatter < 0.015, f"{len(depths)} contacts are too few"
    assert depths.mean() == pytest.approx(math.sqrt(math.pi) / 2 * dt, rel=0.05)


def test_the_energy_is_spread_over_both_directions():
    scene = mpsim.Scene.random(count=4000, packing=0.3, radius=0.5, seed=3)
    velocity = scene.velocity * [math.sqrt(2), 0]
    scene = mpsim.Scene(width=scene.width, height=scene.height, position=scene.position, velocity=velocity, radius=0.5)
    with simulate(scene, dt=0.02, method="grid") as sim:
        sim.run(frames=1000)
        x, y = (sim.state.velocity**2).mean(axis=0)
    assert x / y == pytest.approx(1, abs=5 * math.sqrt(4 / scene.count)), f"mean squares {x}, {y}"


def visit(position, diameter):
    """One visit of pairs: the overlap in float32 is pushed apart along the line of centres. Returns the new centres."""
    n = position[:, 1] - position[:, 0]
    distance = np.sqrt((n * n).sum(axis=1))
    n /= distance[:, None]
    shift = n * ((diameter - distance) / np.float32(2))[:, None]
    return np.stack([position[:, 0] - shift, position[:, 1] + shift], axis=1)


def still_overlapping(real, pairs=200_000):
    """Fraction of random overlapping pairs, in a box 50 diameters wide, that still overlap after one visit."""
    rng = np.random.default_rng(4)
    first = 0.5 + rng.random((pairs, 2)) * 49
    angle, distance = rng.random(pairs) * 2 * math.pi, 1 - 0.02 * rng.random(pairs)
    second = first + np.stack([np.cos(angle), np.sin(angle)], axis=1) * distance[:, None]
    after = visit(np.stack([first, second], axis=1).astype(real), real(1))
    n = after[:, 1] - after[:, 0]
    return float(((n * n).sum(axis=1) < real(1)).mean())


def test_a_second_visit_would_undo_about_half_of_all_contacts_in_float32():
    """Why each pair is visited once: after the push rounding leaves an overlap in 48 % of pairs.

    A second visit, (b, a) after (a, b), sees it; having no test for approach, it mirrors both velocities back.
    """
    assert still_overlapping(np.float32) == pytest.approx(0.48, abs=0.02)


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_a_pair_is_visited_once_so_no_contact_undoes_itself(precision):
    """A thousand separate pairs under `reflect`: every one comes out of its frame with its velocities mirrored."""
    rng = np.random.default_rng(5)
    count = 1000
    place = np.stack(np.divmod(np.arange(count), 40), axis=1) * 3.0 + 2
    angle = rng.random(count) * 2 * math.pi
    n = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    position = np.concatenate([place, place + 0.99 * n])
    velocity = np.concatenate([n, -n]) * 1e-3
    scene = mpsim.Scene(width=125, height=125, position=position, velocity=velocity, radius=0.5)
    for method in ("naive", "grid"):
        with simulate(scene, dt=1e-3, method=method, law="reflect", precision=precision) as sim:
            assert sim.run(frames=1).collisions == count
            assert np.allclose(sim.state.velocity, -velocity, atol=1e-8)
