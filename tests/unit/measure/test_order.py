"""Structure factor and bond-orientational order: lattices and random points in closed form, slow twins, and freud."""

import builtins
import math

import freud
import numpy as np
import pytest
from support.scenes import gas, simulate

import mpsim
from mpsim.measure import (
    hexatic_correlation,
    hexatic_order,
    reference,
    structure_factor,
    to_freud,
)

ROW = math.sqrt(0.75)


def scene_at(places, width, height, boundary="periodic"):
    return mpsim.Scene(
        width=width, height=height, position=places, velocity=np.zeros_like(places), radius=0.01, boundary=boundary
    )


def state_of(scene):
    return mpsim.State(scene.position, scene.velocity)


def random_points(count, seed, boundary="periodic"):
    return scene_at(0.02 + np.random.default_rng(seed).random((count, 2)) * [9.96, 7.96], 10, 8, boundary)


def triangular(columns=12, rows=14):
    column, row = np.divmod(np.arange(columns * rows), rows)
    places = np.stack([column + 0.5 * (row % 2) + 0.1, (row + 0.1) * ROW], axis=1)
    return scene_at(np.mod(places, [columns, rows * ROW]), columns, rows * ROW)


def test_the_structure_factor_is_that_of_its_slow_twin():
    scene = random_points(40, 1)
    found = structure_factor(state_of(scene), scene, bins=7, k_max=6.0)
    sums, numbers = np.zeros(7), np.zeros(7, int)
    for n in range(-20, 21):
        for m in range(-20, 21):
            k = 2 * math.pi * np.array([n / 10, m / 8])
            size = math.hypot(*k)
            if 0 < size <= 6.0 and (n > 0 or (n == 0 and m > 0)):
                shell = min(math.ceil(size / (6 / 7)) - 1, 6)
                sums[shell] += abs(np.exp(1j * scene.position @ k).sum()) ** 2 / 40
                numbers[shell] += 1
    assert found.vectors.tolist() == numbers.tolist()
    assert found.value == pytest.approx(sums / numbers, rel=1e-9)


def test_points_at_random_have_no_structure_and_the_errors_say_so():
    scene = random_points(200, 2)
    found = structure_factor([state_of(random_points(200, seed)) for seed in range(20)], scene, bins=12, k_max=10.0)
    deviations = (found.value - 1) / found.error
    assert (np.abs(deviations) < 3).all()
    assert 0.5 < deviations.std() < 1.6


def test_at_long_waves_the_structure_factor_is_the_compressibility():
    """S(0) = 1 / d(packing Z)/d packing, 0.28 at packing 0.3; of points without extension 1."""
    states, packing, h = [], 0.3, 1e-4
    scene = gas(400, packing, seed=1, boundary="periodic")
    with simulate(scene, dt=0.1, method="grid", contact="impact") as sim:
        for _ in range(60):
            sim.run(frames=20)
            states.append(sim.state)
    found = structure_factor(states[5:], scene, bins=1, k_max=0.7)
    upper, lower = ((packing + d) * reference.compressibility(packing + d) for d in (h, -h))
    expected = 2 * h / (upper - lower)
    assert found.value[0] == pytest.approx(expected, rel=0.15)
    assert abs(found.value[0] - 1) > 5 * found.error[0]


def test_a_triangular_lattice_is_in_order_and_turned_bonds_turn_psi():
    found = hexatic_order(state_of(triangular()), triangular())
    assert found.psi == pytest.approx(np.ones(168))
    assert (found.local, found.whole) == pytest.approx((1.0, 1.0))
    start = triangular()
    turned = scene_at(start.position[:, ::-1].copy(), start.height, start.width)
    assert hexatic_order(state_of(turned), turned).psi == pytest.approx(-np.ones(168))


def by_hand(scene, n):
    """psi_6 of one disc, from all images of all discs."""
    found = []
    for m in range(scene.count):
        for shift in np.ndindex(3, 3):
            r = scene.position[m] + (np.array(shift) - 1) * [scene.width, scene.height] - scene.position[n]
            if r.any():
                found.append((math.hypot(*r), math.atan2(r[1], r[0])))
    return np.mean([np.exp(6j * angle) for _, angle in sorted(found)[:6]])


def test_six_nearest_neighbours_are_those_of_the_slow_twin_and_of_freud():
    scene = random_points(60, 4)
    found = hexatic_order(state_of(scene), scene)
    assert found.psi == pytest.approx([by_hand(scene, n) for n in range(60)], abs=1e-9)
    theirs = freud.order.Hexatic(k=6)
    theirs.compute(to_freud(state_of(scene), scene))
    assert found.psi == pytest.approx(theirs.particle_order, abs=1e-3)
    assert found.whole < 0.5


def test_walls_have_no_images():
    """Negative control of the neighbours across borders, also against freud."""
    scene = random_points(60, 4, boundary="walls")
    found = hexatic_order(state_of(scene), scene).psi
    theirs = freud.order.Hexatic(k=6)
    theirs.compute(to_freud(state_of(scene), scene))
    assert found == pytest.approx(theirs.particle_order, abs=1e-3)
    periodic = hexatic_order(state_of(random_points(60, 4)), random_points(60, 4)).psi
    assert np.abs(found - periodic).max() > 0.1
    box, _ = to_freud(state_of(scene), scene)
    assert tuple(box.periodic) == (False, False, False)


def test_absorbed_discs_are_no_neighbours():
    scene = random_points(60, 4)
    present = np.arange(60) % 3 > 0
    state = mpsim.State(scene.position, scene.velocity, present=present)
    fewer = scene_at(scene.position[present], 10, 8)
    found = hexatic_order(state, scene)
    assert found.psi.tolist() == hexatic_order(state_of(fewer), fewer).psi.tolist()
    assert found.disc.tolist() == np.flatnonzero(present).tolist()
    assert to_freud(state, scene)[1].shape == (40, 3)


def test_order_correlates_in_a_crystal_at_any_distance_and_in_a_gas_at_none():
    crystal, points = triangular(), random_points(400, 5)
    found = hexatic_correlation(state_of(crystal), crystal, bins=5, r_max=5.0)
    assert found.value[found.pairs > 0] == pytest.approx(np.ones((found.pairs > 0).sum()))
    assert found.r.tolist() == [0.5, 1.5, 2.5, 3.5, 4.5]
    gaseous = hexatic_correlation([state_of(points)] * 2, points, bins=4, r_max=4.0)
    assert np.abs(gaseous.value[2:]).max() < 0.05
    half, place = np.array([5.0, 4.0]), points.position
    distances = [np.hypot(*(np.mod(place[n + 1 :] - place[n] + half, 2 * half) - half).T) for n in range(400)]
    assert gaseous.pairs.sum() == 2 * (np.concatenate(distances) < 4.0).sum()


def test_bad_input_is_refused():
    scene, walls, few = random_points(20, 1), random_points(20, 1, "walls"), random_points(6, 1)
    state = state_of(scene)
    for ask, words in (
        (lambda: structure_factor(state, walls, 50, 5.0), "periodic in both axes"),
        (lambda: structure_factor([], scene, 50, 5.0), "states must be at least one State; got none"),
        (lambda: hexatic_correlation([], scene, 8, 1.0), "states must be at least one State; got none"),
        (lambda: structure_factor(scene, scene, 50, 5.0), "states must be a State or a list of them; got Scene"),
        (lambda: structure_factor([state, 3], scene, 50, 5.0), "states[1] must be a State; got int"),
        (lambda: structure_factor(state, state, 50, 5.0), "scene must be a Scene; got State"),
        (lambda: hexatic_order(scene, scene), "state must be a State; got Scene. Use sim.state"),
        (lambda: hexatic_order(state, state), "scene must be a Scene; got State"),
        (lambda: hexatic_correlation(scene, scene, 5, 4.0), "states must be a State or a list of them; got Scene"),
        (lambda: to_freud(scene, scene), "state must be a State; got Scene"),
        (lambda: structure_factor(state, scene, 50, 0.0), "k_max must be a finite number > 0"),
        (lambda: structure_factor(state, scene, 50, 1e5), "k_max must be small enough for at most 2,000,000"),
        (lambda: structure_factor(state, scene, 0, 5.0), "bins must be a whole number"),
        (lambda: hexatic_order(state_of(few), few), "hexatic_order needs at least 7 discs; got 6"),
        (lambda: hexatic_correlation(state, scene, 5, 4.1), "r_max must be at most half of a periodic axis, 4"),
        (lambda: hexatic_correlation(state, scene, 0, 4.0), "bins must be a whole number"),
        (lambda: hexatic_correlation(state, scene, 5, math.nan), "r_max must be a finite number > 0"),
        (lambda: hexatic_order(mpsim.State(scene.position * np.nan, scene.velocity), scene), "must be finite"),
        (lambda: to_freud(mpsim.State(scene.position * np.nan, scene.velocity), scene), "must be finite"),
    ):
        with pytest.raises(mpsim.InputError) as caught:
            ask()
        assert words in str(caught.value)
    thin = scene_at(np.stack([np.arange(20) + 0.5, np.full(20, 0.5)], axis=1), 20, 1)
    with pytest.raises(mpsim.InputError, match=r"6 neighbours of each disc within half of each periodic axis, 0\.5"):
        hexatic_order(state_of(thin), thin)


def test_without_freud_the_error_says_how_to_get_it(monkeypatch):
    real = builtins.__import__

    def without(name, *rest):
        if name == "freud":
            raise ImportError("no module")
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(mpsim.errors.NotMeasurableError, match="pip install freud-analysis"):
        to_freud(state_of(random_points(20, 1)), random_points(20, 1))
