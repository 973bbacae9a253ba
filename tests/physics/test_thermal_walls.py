"""Thermal walls against closed forms: a gas takes their temperature, and heat flows between two of them."""

import math

import numpy as np
import pytest
from support.distributions import distance, normal
from support.scenes import gas, simulate

from mpsim import Scene, ThermalWalls

pytestmark = [pytest.mark.slow, pytest.mark.timeout(400), pytest.mark.filterwarnings("ignore::mpsim.FastWarning")]


def temperatures(scene, method, begin, count, apart, **settings):
    """Of the motion along x and along y: (count, 2), from a time on, so far apart; and the velocities."""
    velocities = []
    with simulate(scene, method=method, **{"dt": 0.05, "contact": "impact"} | settings) as sim:
        for index in range(count):
            sim.run(until=begin + index * apart)
            velocities.append(sim.state.velocity.astype(float))
    found = np.array(velocities)
    return (found**2).mean(axis=1), found


def mean_and_error(series):
    """Of a stationary series, by blocks."""
    blocks = np.array([each.mean() for each in np.array_split(series, 20)])
    return blocks.mean(), blocks.std(ddof=1) / math.sqrt(20)


# --- walls at one temperature


@pytest.mark.parametrize(
    ("method", "settings"),
    [
        ("grid", {}),
        *(
            pytest.param(*each, marks=pytest.mark.long)
            for each in (("grid", {"contact": "push", "dt": 0.01}), ("naive", {"precision": "float32"}), ("event", {}))
        ),
    ],
)
def test_a_gas_comes_to_the_temperature_and_the_velocities_of_its_walls(method, settings):
    """It begins at another one. The controls: that one, and velocities of it."""
    walls = ThermalWalls(left=2.0, right=2.0, bottom=2.0, top=2.0, seed=3)
    series, found = temperatures(gas(150, 0.2, seed=1, thermal_walls=walls), method, 200.0, 100, 20.0, **settings)
    for along in series.T:
        mean, error = mean_and_error(along)
        assert error < 0.03
        assert abs(mean - 2.0) < 4 * error
        assert abs(mean - 1.0) > 20 * error
    scaled = (found[::10] / math.sqrt(2.0)).ravel()
    assert distance(scaled, normal) < 1.95, "exceeded once in a thousand times"
    assert distance(math.sqrt(2.0) * scaled, normal) > 1.95


@pytest.mark.parametrize("method", ["grid", pytest.param("event", marks=pytest.mark.long)])
def test_the_pressure_counts_what_thermal_walls_give(method):
    """P A = N kT for discs so small that they hardly meet. The control: the start is at half the temperature."""
    walls = ThermalWalls(left=2.0, right=2.0, bottom=2.0, top=2.0, seed=3)
    scene = Scene.random(count=200, width=10, height=10, radius=1e-3, seed=2, thermal_walls=walls)
    with simulate(scene, method=method, dt=0.05, contact="impact") as sim:
        sim.run(until=50.0)
        pressure = sim.run(until=650.0, measures=["pressure"]).measures["pressure"]
    assert pressure.error < 0.08
    assert abs(pressure.value - 200 * 2.0 / 100) < 4 * pressure.error + 0.002
    assert abs(pressure.value - 200 * 1.0 / 100) > 20 * pressure.error


# --- walls at two temperatures


@pytest.mark.parametrize("method", ["grid", pytest.param("event", marks=pytest.mark.long)])
def test_discs_that_never_meet_have_the_geometric_mean_of_two_walls(method):
    """Each wall sends as many discs per time as the other, n sqrt(T) of each stream are equal: T = sqrt(T1 T2).

    Along both axes, as the walls along x turn v_y round and no more. The controls: the
    arithmetic mean, and each wall alone.
    """
    cold, hot = 1.0, 9.0
    walls = ThermalWalls(left=cold, right=hot, seed=1)
    scene = Scene.random(count=300, width=5, height=5, radius=1e-5, seed=2, thermal_walls=walls)
    series, _ = temperatures(scene, method, 60.0, 100, 10.0)
    for along in series.T:
        mean, error = mean_and_error(along)
        assert error < 0.08
        assert abs(mean - math.sqrt(cold * hot)) < 4 * error
        for wrong in (cold, hot, (cold + hot) / 2):
            assert abs(mean - wrong) > 10 * error


# --- the control: a wall that draws the normal velocity from the distribution of a gas, not of those that cross a line


def between_walls(draw, flights=200_000):
    """Kinetic temperature along the normal between walls that send a disc back with speeds from `draw`."""
    speed = draw(flights)
    time = 1 / speed
    return float((speed**2 * time).sum() / time.sum())


def test_a_wall_without_the_weight_of_the_flux_has_another_temperature():
    """By the same criterion as above, of a disc between two walls: slow discs then stay in the box for too long."""
    rng = np.random.default_rng(1)
    right = between_walls(lambda count: np.sqrt(2.0) * rng.rayleigh(size=count))
    wrong = between_walls(lambda count: np.sqrt(2.0) * np.abs(rng.normal(size=count)))
    assert right == pytest.approx(2.0, abs=0.05)
    assert abs(wrong - 2.0) > 0.5
