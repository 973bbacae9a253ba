"""Correlations in time of whole simulations against closed forms, each with something wrong that must fail."""

import math
from functools import cache

import numpy as np
import pytest
from support.scenes import gas, scene_of, simulate, state_after

import mpsim
from mpsim.measure import mean_squared_displacement, reference

pytestmark = pytest.mark.plain

PACKING = 0.02
RATE = reference.enskog_rate(PACKING)  # collisions per disc and time of the dilute gas


def lanes():
    """Discs that move along lanes of a periodic box, each at its own speed, and never meet."""
    rows = np.arange(5)
    velocity = [[speed, 0.0] for speed in (3.7, -3.1, 2.3, -0.9, 0.1)]
    return scene_of(np.stack([1.0 + rows, 0.5 + rows], axis=1), velocity, 10, 8, radius=0.3, boundary="periodic")


def test_without_collisions_displacements_are_ballistic_across_any_number_of_periods():
    """The mean square is <v^2> t^2 at every lag, although discs cross the box up to three times between two looks."""
    start = lanes()
    correlations = mpsim.Correlations(every=1, wave_numbers=[0.3])
    with simulate(start, method="event", dt=7.0) as sim:
        before = sim.state
        sim.run(frames=60, observe=correlations)
    speeds = (start.velocity**2).sum(axis=1).mean()
    found = correlations.msd
    assert found.lag[-1] == 7.0 * 56
    assert found.value == pytest.approx(speeds * found.lag**2, rel=1e-9)
    waves = np.cos(0.3 * start.velocity[None] * found.lag[:, None, None]).mean(axis=(1, 2))
    assert correlations.scattering(0.3).value == pytest.approx(waves, abs=1e-8)
    assert correlations.velocity.value == pytest.approx(np.full(len(found), speeds), rel=1e-12)
    after = state_after(start, 1, method="event", dt=7.0)
    moved = after.position - before.position
    wrapped = moved - np.round(moved / [10, 8]) * [10, 8]
    assert mean_squared_displacement(before, after) == pytest.approx(speeds * 49)
    assert (wrapped**2).sum(axis=1).mean() < 0.1 * speeds * 49, "the control: nearest images lose the crossings"


@cache
def dilute():
    """Correlations of a dilute gas of 128 discs over 400 mean free times."""
    found = mpsim.Correlations(start=10 / RATE, wave_numbers=[0.02, 0.2])
    with simulate(gas(128, PACKING, seed=5, boundary="periodic"), method="event", dt=0.1 / RATE) as sim:
        sim.run(until=410 / RATE, observe=found)
    return found


@pytest.mark.slow
def test_velocities_of_a_dilute_gas_decay_as_enskog_says():
    """<v(t).v(0)> = 2 kT (1 - 1/N) exp(-rate t) at short times, as a collision takes (v12.n)^2/2 = 2 kT on average."""
    found = dilute()
    count, velocity = 128, found.velocity
    rate = RATE / (1 - 1 / (8 * (count - 1)))  # mean |u| of a component is larger at fixed energy
    assert velocity[0].value == pytest.approx(2.0, rel=1e-12)
    assert velocity[0].error < 1e-12
    for index in (1, 2, 3, 5):
        expected = 2 * math.exp(-rate * velocity.lag[index])
        measured = velocity[index]
        assert measured.settled
        assert measured.error < 0.008
        assert abs(measured.deviation(expected)) < 3, f"{measured}, expected {expected} at {velocity.lag[index]}"
    wrong = 2 * math.exp(-1.1 * rate * velocity.lag[2])
    assert abs(velocity[2].deviation(wrong)) > 5, f"a rate wrong by ten per cent, {wrong}, must fail; got {velocity[2]}"


@pytest.mark.slow
def test_both_routes_give_the_same_diffusion_constant_and_that_of_enskog():
    found = dilute()
    by_displacement, by_velocity = found.diffusion(), found.diffusion(route="velocity")
    assert by_displacement.settled
    assert by_velocity.settled
    assert abs(by_displacement.value - by_velocity.value) < 2 * max(by_displacement.error, by_velocity.error)
    expected = reference.enskog_diffusion(PACKING)
    for each in (by_displacement, by_velocity):
        assert each.error < 0.04 * expected
        assert abs(each.value / expected - 1) < 0.03 + 3 * each.error / expected  # first order, some per cent low
        assert abs(each.deviation(1.5 * expected)) > 6
    early = found.diffusion(0.0, 0.5 / RATE)
    assert early.value < 0.3 * by_displacement.value
    assert not early.settled, "velocities have not decayed yet"


@pytest.mark.slow
def test_scattering_is_gaussian_at_long_waves():
    """exp(-k^2 MSD / 4) to order k^4; at short waves the discs' straight flights show."""
    found = dilute()
    long, short, squares = found.scattering(0.02), found.scattering(0.2), found.msd.value
    reached = squares < 2000
    assert reached.sum() > 25
    assert long.value[reached] == pytest.approx(np.exp(-(0.02**2) * squares[reached] / 4), abs=2e-3)
    assert long.value[reached].min() < 0.9
    assert np.abs(short.value[reached] - np.exp(-(0.2**2) * squares[reached] / 4)).max() > 1e-3
    assert np.abs(short.value[-5:]).max() < 0.05
