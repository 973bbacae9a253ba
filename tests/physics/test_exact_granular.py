"""Losses and gravity of the exact solver against closed forms, each with something wrong that must fail."""

import numpy as np
import pytest
from support.exact import Run
from support.scenes import gas, simulate

from mpsim import Scene, measure
from mpsim.kernels.events import records
from mpsim.measure import independent_average, reference, reference_motion

COUNT, PACKING = 50, 0.1
"""Small and dilute: vortices and clusters, which Haff's law leaves out, need room to grow."""


def temperature(sim):
    """Mean square of one velocity component; 1 at the start."""
    return (sim.state.velocity**2).mean()


def cooled_by_collisions(restitution, starts, law_of=None):
    """Temperature after 16 collisions per disc, over that of Haff's law for the restitution `law_of`."""
    ratios = []
    for seed in range(starts):
        with simulate(gas(COUNT, PACKING, seed=seed, restitution=restitution), method="event", dt=2.0) as sim:
            collisions = 0.0
            while collisions < 16:
                collisions += 2 * sim.run(frames=1).collisions / COUNT
            ratios.append(temperature(sim) / reference_motion.haff_by_collisions(collisions, law_of or restitution))
    return independent_average(ratios)


@pytest.mark.slow
@pytest.mark.parametrize("restitution", [0.9, 0.95])
@pytest.mark.parametrize("starts", [100, pytest.param(1000, marks=pytest.mark.long)])
def test_e1_a_granular_gas_cools_by_haffs_law_per_collision(restitution, starts, figures):
    """Within 2 %, the law's own error for e >= 0.9: it takes velocities as Maxwellian and as uncorrelated."""
    found = cooled_by_collisions(restitution, starts)
    assert found.error < 0.012, f"too few starts: {found}"
    assert abs(found.value - 1) < 0.02 + 2 * found.error, f"T over Haff's law {found}"
    wrong = round(restitution + 0.01, 2)
    control = cooled_by_collisions(wrong, starts // 4, law_of=restitution)
    assert control.value - 1 > 0.05 + 3 * control.error, f"a gas of e = {wrong} must fail the law; got {control}"
    quantity = f"T over Haff's law, e = {restitution}, {starts} starts, 16 collisions"
    figures.note("E1", "exact", quantity, "1 within 2 %", found, f"gas of e = {wrong}: {control}")


def rate_at_rest(starts):
    """Collisions per disc and time of the elastic gas in equilibrium at T = 1, in the same box."""
    rates = []
    for seed in range(starts):
        with simulate(gas(COUNT, PACKING, seed=seed), method="event", dt=20.0) as sim:
            sim.run(until=20)
            rates.append(sim.run(until=1020, measures=["collision_rate"]).measures["collision_rate"].value)
    return independent_average(rates)


def cooled_in_time(restitution, rate, starts, until=60.0):
    """Temperature at a time over that of Haff's law of e = 0.9 with a given rate of collisions at the start."""
    ratios = []
    for seed in range(starts):
        with simulate(gas(COUNT, PACKING, seed=seed, restitution=restitution), method="event", dt=until) as sim:
            sim.run(until=until)
            ratios.append(temperature(sim) / reference_motion.haff_in_time(until, 0.9, rate))
    return independent_average(ratios)


@pytest.mark.slow
@pytest.mark.parametrize("starts", [150, pytest.param(2000, marks=pytest.mark.long)])
def test_e2_a_granular_gas_cools_by_haffs_law_in_time(starts, figures):
    """Within 3 %. The rate is that of the same discs at rest: walls make it higher than Enskog's."""
    rate = rate_at_rest(16)
    found = cooled_in_time(0.9, rate.value, starts)
    assert found.error < 0.015, f"too few starts: {found}"
    assert abs(found.value - 1) < 0.03 + 2 * found.error, f"T over Haff's law in time {found}"
    slow = cooled_in_time(0.9, 0.9 * rate.value, starts)
    other = cooled_in_time(0.91, rate.value, starts // 2)
    assert slow.value - 1 < -0.05 - 3 * slow.error, f"a rate 10 % lower must fail; got {slow}"
    assert other.value - 1 > 0.05 + 3 * other.error, f"a gas of e = 0.91 must fail; got {other}"
    quantity = f"T over Haff's law in time, e = 0.9, {starts} starts, t = 60"
    figures.note("E2", "exact", quantity, "1 within 3 %", found, f"rate 0.9 times: {slow}; e = 0.91: {other}")


@pytest.mark.slow
def test_e4_inelastic_collapse_ends_with_the_guard(figures):
    start = [[10.0, 0.5], [11.5, 0.5], [13.2, 0.5]], [[1.0, 0.0], [0.0, 0.0], [-1.0, 0.0]]
    run = Run(*start, 40.0, 1.0, restitution=0.05, contact_time=1e-6)
    assert run.advance(3.0) == (records.REACHED, -1)
    assert run.count("guarded") > 0
    assert run.count("pairs") < 1000
    # Above 7 - 4 sqrt 3 there is no collapse and the guard has nothing to do.
    mild = Run(*start, 40.0, 1.0, restitution=0.2, contact_time=1e-6)
    mild.advance(3.0)
    assert mild.count("guarded") == 0
    assert mild.count("pairs") >= 2
    quantity = "collapse of three discs, e = 0.05: losses suppressed"
    figures.note("E4", "exact", quantity, "> 0, and it ends", run.count("guarded"), "e = 0.2, no collapse: 0")


def potential_energy(radius, starts, until):
    """Mean of m g y of 8 discs under gravity, over E/(2N)."""
    ratios = []
    for seed in range(starts):
        rng = np.random.default_rng(seed)
        position = np.stack([np.linspace(0.1, 0.9, 8), radius + 0.25 * rng.permutation(8)], axis=1)
        scene = Scene(
            width=1, height=60, position=position, velocity=rng.normal(size=(8, 2)), radius=radius, gravity=(0, -1)
        )
        lowest = 8 * radius
        with simulate(scene, method="event", dt=1.0) as sim:
            energy = measure.kinetic_energy(sim.state, scene) + sim.state.position[:, 1].sum() - lowest
            sim.run(until=100)
            kinetic = []
            while sim.time < until:
                kinetic.append(sim.run(frames=200, measures=["kinetic_energy"]).measures["kinetic_energy"].value)
            now = measure.kinetic_energy(sim.state, scene) + sim.state.position[:, 1].sum() - lowest
            assert now == pytest.approx(energy, rel=1e-11)
        ratios.append((energy - np.mean(kinetic)) / 8 / reference.potential_energy_per_disc(energy, 8))
    return independent_average(ratios)


@pytest.mark.long
def test_f2_half_of_the_energy_of_small_discs_under_gravity_is_potential(figures):
    """Radius 0.01 is nearly ideal: the area of the discs, which grows with its square, lifts them by some 0.2 %."""
    found = potential_energy(0.01, 16, 4100)
    assert found.error < 0.004
    assert abs(found.value - 1) < 0.005 + 2 * found.error, f"<mgy> over E/(2N) {found}"
    assert abs(found.deviation(2 / 3)) > 20, "one share of three, as of springs, must fail"
    large = potential_energy(0.1, 4, 2100)
    assert large.value > 1.04 + 3 * large.error, f"discs of radius 0.1 are not ideal and must fail; got {large}"
    figures.note("F2", "exact", "<m g y> over E/(2N)", "1 within 0.5 %", found, f"E/(3N): 0.667; radius 0.1: {large}")
