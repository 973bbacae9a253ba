"""Thermostats and thermal walls against closed forms: temperatures, velocities, pressure; each with its control."""

import math

import numpy as np
import pytest
from support.scenes import simulate

from mpsim import Scene, ThermalWalls, Thermostat, measure

pytestmark = [pytest.mark.plain, pytest.mark.timeout(400), pytest.mark.filterwarnings("ignore::mpsim.FastWarning")]

UNLIKELY = 1.95  # of Kolmogorov's statistic: exceeded once in a thousand times


def distance(values):
    """Kolmogorov-Smirnov's, of values from the normal distribution, times the root of their number."""
    ordered = np.sort(values)
    steps = np.arange(len(ordered) + 1) / len(ordered)
    expected = np.array([0.5 * (1 + math.erf(value / math.sqrt(2))) for value in ordered])
    return math.sqrt(len(ordered)) * max((steps[1:] - expected).max(), (expected - steps[:-1]).max())


def bath_of(count, seed=1, radius=1e-4, **features):
    """Discs so small that they hardly meet, in a box of 10 x 10."""
    return Scene.random(count=count, width=10, height=10, radius=radius, seed=seed, **features)


# --- thermostats


@pytest.mark.parametrize(
    ("method", "settings", "temperature"),
    [("naive", {"dt": 1.0, "substeps": 2}, 0.25), pytest.param("event", {"dt": 0.5}, 3.0, marks=pytest.mark.long)],
)
def test_a_gas_relaxes_exponentially_to_the_temperature_of_the_bath(method, settings, temperature):
    """T(t) = T + (T0 - T) exp(-rate t), t without the first frame, as it acts between two frames.

    The controls: half the rate, and another bath.
    """
    times, rate, found = np.array([2.0, 4.0, 8.0]), 0.25, []
    for seed in range(10):
        scene = bath_of(30, seed, boundary="periodic", thermostat=Thermostat(temperature, rate, seed=seed))
        with simulate(scene, method=method, contact="impact", **settings) as sim:
            temperatures = []
            for time in times:
                sim.run(until=time)
                temperatures.append(measure.temperature(sim.state, scene))
        found.append(temperatures)
    mean, error = np.mean(found, axis=0), np.std(found, axis=0, ddof=1) / math.sqrt(10)
    law = lambda rate, bath: bath + (1 - bath) * np.exp(-rate * (times - settings["dt"]))  # noqa: E731
    assert (np.abs(mean - law(rate, temperature)) / error).max() < 4
    for wrong in (law(rate / 2, temperature), law(rate, 1.5 * temperature)):
        assert (np.abs(mean - wrong) / error).max() > 3


def test_velocities_become_those_of_maxwell_for_each_mass():
    """All begin with one speed. The controls: the start, and velocities as if all discs had the same mass."""
    mass, angles = np.where(np.arange(60) % 3, 1.0, 4.0), np.random.default_rng(2).uniform(0, 2 * np.pi, 60)
    scene = Scene(
        width=10, height=10, position=bath_of(60).position, radius=1e-4, mass=mass, boundary="periodic",
        velocity=np.stack([np.cos(angles), np.sin(angles)], axis=1), thermostat=Thermostat(2.0, 2.0, seed=1),
    )  # fmt: skip
    found = []
    with simulate(scene, method="naive", dt=1.0) as sim:
        for _ in range(12):
            sim.run(frames=3)
            found.append(sim.state.velocity.astype(float))
    scaled = np.array(found) * np.sqrt(mass / 2.0)[:, None]
    assert distance(scaled.ravel()) < UNLIKELY
    assert np.mean((scaled**2).sum(axis=2) ** 2) / np.mean((scaled**2).sum(axis=2)) ** 2 == pytest.approx(2, abs=0.2)
    assert distance(np.tile((scene.velocity * np.sqrt(mass / 2.0)[:, None]).ravel(), 12)) > UNLIKELY
    assert distance((np.array(found) * math.sqrt(mass.mean() / 2.0)).ravel()) > UNLIKELY


def test_momentum_of_the_whole_gas_has_the_energy_of_one_disc_and_presses_with_it():
    """In a bath it is not conserved: its kinetic energy is kT, of two degrees of freedom. At the start it is 0.

    So three discs press with three kT, where two would be right of a flow: the control.
    """
    scene, found = bath_of(3, boundary="periodic", thermostat=Thermostat(1.0, 20.0)), []
    with simulate(scene, method="naive", dt=0.2) as sim:
        assert np.abs(sim.state.velocity.sum(axis=0)).max() < 1e-10
        for _ in range(60):
            sim.run(frames=2)
            found.append(float((sim.state.velocity.sum(axis=0) ** 2).sum()) / (2 * 3))
        measures = sim.run(frames=500, measures=["pressure_xx", "pressure_yy"]).measures
    assert np.mean(found) == pytest.approx(1.0, abs=4 / math.sqrt(60))
    for each in measures.values():
        pressed, error = each.value * 100, each.error * 100
        assert abs(pressed - 3) < 4 * error < 1.8
        assert abs(pressed - 2) > 2 * error


# --- thermal walls


def mean_and_error(series):
    """Of a stationary series, by blocks."""
    blocks = np.array([each.mean() for each in np.array_split(series, 10)])
    return blocks.mean(), blocks.std(ddof=1) / math.sqrt(10)


@pytest.mark.long
@pytest.mark.parametrize("settings", [{"method": "naive", "dt": 1.0}, {"method": "event", "dt": 1.0}], ids=str)
def test_a_gas_comes_to_the_temperature_and_the_velocities_of_its_walls(settings):
    """It begins at another one. The controls: that one, and velocities of it."""
    walls = ThermalWalls(left=2.0, right=2.0, bottom=2.0, top=2.0, seed=3)
    velocities, scene = [], bath_of(20, thermal_walls=walls)
    with simulate(scene, **{"contact": "impact", **settings}) as sim:
        for index in range(20):
            sim.run(until=50.0 + 15 * index)
            velocities.append(sim.state.velocity.astype(float))
        pressure = sim.run(until=sim.time + 150, measures=["pressure"]).measures["pressure"]
    found = np.array(velocities)
    for along in (found**2).mean(axis=1).T:
        mean, error = mean_and_error(along)
        assert error < 0.3
        assert abs(mean - 2.0) < 4 * error
        assert abs(mean - 1.0) > 4 * error
    scaled = (found / math.sqrt(2.0)).ravel()
    assert distance(scaled) < UNLIKELY
    assert distance(math.sqrt(2.0) * scaled) > UNLIKELY
    assert abs(pressure.value - 20 * 2.0 / 100) < 4 * pressure.error + 0.02
    assert abs(pressure.value - 20 * 1.0 / 100) > 4 * pressure.error
