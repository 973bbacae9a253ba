"""A thermostat against closed forms: how a gas relaxes, its velocities, and where a driven granular gas settles."""

import math

import numpy as np
import pytest
from support.distributions import distance, normal
from support.scenes import simulate

from mpsim import Scene, ThermalWalls, Thermostat, measure
from mpsim.measure import reference

pytestmark = [pytest.mark.slow, pytest.mark.timeout(400)]

DISCS = 900
FINE = {"dt": 0.05, "contact": "impact"}


def heated_gas(seed, *, bath, temperature=1.0, packing=0.05, count=DISCS, **features):
    return Scene.random(
        count=count, packing=packing, radius=0.5, seed=seed, temperature=temperature, boundary="periodic",
        thermostat=bath, **features,
    )  # fmt: skip


# --- relaxation

TIMES = (1.0, 2.0, 4.0, 8.0)


def relaxed(method, seeds, bath, **settings):
    """Temperatures of gases that began at 1, at TIMES: (seeds, times)."""
    found = []
    for seed in seeds:
        scene = heated_gas(seed, bath=Thermostat(bath.temperature, bath.rate, seed=seed))
        with simulate(scene, method=method, **FINE | settings) as sim:
            temperatures = []
            for time in TIMES:
                sim.run(until=time)
                temperatures.append(measure.temperature(sim.state, scene))
        found.append(temperatures)
    return np.array(found)


def deviations(found, expected):
    """Of the means over seeds, in standard errors, which these tell."""
    error = found.std(axis=0, ddof=1) / math.sqrt(len(found))
    return (found.mean(axis=0) - expected) / error


@pytest.mark.parametrize(
    ("method", "temperature", "settings"),
    [
        ("grid", 3.0, {}),
        ("grid", 0.25, {"substeps": 2}),
        pytest.param("event", 3.0, {}, marks=pytest.mark.long),
        pytest.param("naive", 3.0, {"dt": 0.1}, marks=pytest.mark.long),
    ],
)
def test_a_gas_relaxes_exponentially_to_the_temperature_of_the_bath(method, temperature, settings):
    """T(t) = T + (T0 - T) exp(-rate t): collisions conserve the energy, and each new velocity has that of the bath.

    The controls: half the rate, and a bath of another temperature.
    """
    times, rate = np.array(TIMES), 0.25
    found = relaxed(method, range(10), Thermostat(temperature, rate), **settings)
    law = lambda rate, bath: bath + (1 - bath) * np.exp(-rate * times)  # noqa: E731
    assert np.abs(deviations(found, law(rate, temperature))).max() < 4
    assert np.abs(deviations(found, law(rate / 2, temperature))).max() > 8
    assert np.abs(deviations(found, law(rate, 1.25 * temperature))).max() > 6


# --- velocities


@pytest.mark.parametrize(
    ("method", "heavy"),
    [("grid", 1.0), *(pytest.param(method, 4.0, marks=pytest.mark.long) for method in ("naive", "event"))],
)
def test_velocities_become_those_of_maxwell_for_each_mass(method, heavy):
    """All begin with one speed. The bound of 1.95 is exceeded once in a thousand times.

    The controls: the start, and velocities as if all discs had the same mass.
    """
    mass = np.where(np.arange(150) % 3, 1.0, heavy)
    angles = np.random.default_rng(2).uniform(0, 2 * np.pi, 150)
    start = heated_gas(3, bath=None, count=150, mass=mass)
    scene = Scene(
        width=start.width, height=start.height, position=start.position, radius=0.5, mass=mass, boundary="periodic",
        velocity=np.stack([np.cos(angles), np.sin(angles)], axis=1), thermostat=Thermostat(2.0, 1.0, seed=1),
    )  # fmt: skip
    found = []
    with simulate(scene, method=method, **FINE) as sim:
        for _ in range(12):
            sim.run(until=sim.time + 5.0)
            found.append(sim.state.velocity.astype(float))
    scaled = np.array(found) * np.sqrt(mass / 2.0)[:, None]
    assert distance(scaled.ravel(), normal) < 1.95
    assert np.mean((scaled**2).sum(axis=2) ** 2) / np.mean((scaled**2).sum(axis=2)) ** 2 == pytest.approx(2, abs=0.15)
    assert distance((scene.velocity * np.sqrt(mass / 2.0)[:, None]).ravel(), normal) > 1.95
    if heavy > 1:
        assert distance((np.array(found) * math.sqrt(mass.mean() / 2.0)).ravel(), normal) > 1.95


# --- a driven granular gas


def settled(bath, restitution, packing=0.05):
    """Temperature at which the bath gives as much energy as collisions take.

    rate (T_bath - T) = (1 - e^2) / 2 omega(T) T, omega being Enskog's collision rate: by Gaussian velocities, as in
    Haff's law (van Noije and Ernst, Granular Matter 1, 57, 1998, in two dimensions).
    """
    low, high = 0.0, bath.temperature
    for _ in range(60):
        middle = (low + high) / 2
        loss = (1 - restitution**2) / 2 * reference.enskog_rate(packing, 0.5, middle) * middle
        low, high = (middle, high) if bath.rate * (bath.temperature - middle) > loss else (low, middle)
    return low


@pytest.mark.parametrize("method", ["grid", pytest.param("event", marks=pytest.mark.long)])
def test_a_driven_granular_gas_settles_where_heating_equals_cooling(method):
    """The controls: half the losses, twice the rate; and without losses the gas has the temperature of the bath."""
    bath, e = Thermostat(1.0, 0.08, seed=4), 0.8
    temperatures = {}
    for restitution in (e, 1.0):
        scene = heated_gas(1, bath=bath, count=2500, restitution=restitution)
        with simulate(scene, method=method, **FINE) as sim:
            sim.run(until=40.0)
            temperatures[restitution] = sim.run(until=240.0, measures=["temperature"]).measures["temperature"]
    found, elastic = temperatures[e], temperatures[1.0]
    assert found.error < 0.01
    assert abs(found.value - settled(bath, e)) < 3 * found.error + 0.01 * found.value, "1 %: not quite Gaussian"
    assert abs(elastic.value - 1.0) < 4 * elastic.error
    for wrong in (settled(bath, math.sqrt((1 + e * e) / 2)), settled(Thermostat(1.0, 0.16), e), 1.0):
        assert abs(found.value - wrong) > 6 * found.error + 0.01 * found.value


def test_momentum_of_the_whole_gas_has_the_energy_of_one_disc():
    """In a bath it is not conserved: its kinetic energy is kT, of two degrees of freedom. At the start it is 0."""
    scene, found = heated_gas(1, bath=Thermostat(1.0, 2.0), count=100), list[float]()
    with simulate(scene, method="grid", **FINE) as sim:
        for _ in range(201):
            found.append(float((sim.state.velocity.sum(axis=0) ** 2).sum()) / (2 * 100))
            sim.run(until=sim.time + 2.0)
    assert found[0] < 1e-20
    assert np.mean(found[1:]) == pytest.approx(1.0, abs=4 / math.sqrt(200))


# --- momentum of the whole gas: thermal, not a flow


@pytest.mark.parametrize(
    ("bath", "along"),
    [
        ({"boundary": "periodic", "thermostat": Thermostat(1.0, 20.0)}, ("pressure_xx", "pressure_yy")),
        pytest.param(
            {"boundary": ("walls", "periodic"), "thermal_walls": ThermalWalls(left=1.0, right=1.0)},
            ("pressure_yy",),
            marks=pytest.mark.long,
        ),
    ],
)
def test_three_discs_in_a_bath_press_with_three_kt(bath, along):
    """They hardly meet. As if their common motion were a flow, they would press with two."""
    scene = Scene.random(count=3, width=2, height=200, radius=0.01, seed=1, **bath)
    with simulate(scene, method="grid", **FINE | {"dt": 0.2}) as sim:
        sim.run(until=50.0)
        found = sim.run(until=8050.0, measures=["pressure_xx", "pressure_yy"]).measures
    free = (2 - 0.02 * (not scene.periodic[0])) * 200
    for name in along:
        area = free if name == "pressure_xx" else 400
        pressed, error = found[name].value * area, found[name].error * area
        assert abs(pressed - 3) < 4 * error < 0.6, (name, pressed, error)
        assert abs(pressed - 2) > 5 * error, "the control"
