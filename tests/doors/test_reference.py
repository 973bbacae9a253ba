"""Closed forms of equilibrium and motion: published tables, and each against an independent evaluation."""

import math

import numpy as np
import pytest

from mpsim import InputError
from mpsim.measure import reference
from mpsim.measure import reference_motion as motion

TABLE = [
    (0.01, 1.02032, 1.01586, 0.04585),
    (0.10, 1.23614, 1.18072, 0.53292),
    (0.30, 2.06326, 1.77210, 2.39952),
    (0.50, 4.10624, 3.10624, 7.01004),
]

HALF_A_DIGIT = 0.5e-5 * (1 + 1e-9)


@pytest.mark.parametrize(("packing", "z", "g", "rate"), TABLE)
def test_the_table_of_the_equation_of_state(packing, z, g, rate):
    assert abs(reference.compressibility(packing) - z) < HALF_A_DIGIT
    assert abs(reference.contact_value(packing) - g) < HALF_A_DIGIT
    assert abs(reference.enskog_rate(packing) - rate) < HALF_A_DIGIT


def test_the_third_virial_coefficient_by_numerical_integration():
    """B_3 / B_2^2 from the area that two discs of radius sigma at distance r < sigma have in common."""
    nodes, weights = np.polynomial.legendre.leggauss(60)
    r, dr = (nodes + 1) / 2, weights / 2
    common = 2 * np.arccos(r / 2) - r / 2 * np.sqrt(4 - r**2)
    third = float((dr * 2 * np.pi * r * common).sum()) / 3
    assert third / (np.pi / 2) ** 2 == pytest.approx(reference.VIRIAL[1], rel=1e-12)
    assert round(reference.VIRIAL[1], 6) == 0.782004
    assert round(reference.VIRIAL[2], 8) == 0.53223181


def test_the_equation_of_state_has_the_series_it_was_made_from():
    """(Z - 1) / x of small x = 2 packing, extrapolated, against the third and fourth coefficients."""
    x = np.array([0.002, 0.004, 0.006, 0.008])
    y = (np.array([reference.compressibility(each / 2) for each in x]) - 1) / x
    fourth, third, second = np.polyfit(x, y, 3)[1:]
    assert (second, third) == (pytest.approx(1, abs=1e-9), pytest.approx(reference.VIRIAL[1], abs=1e-5))
    assert fourth == pytest.approx(reference.VIRIAL[2], abs=1e-2)
    assert np.diff([reference.compressibility(each) for each in np.linspace(0, 0.62, 200)]).min() > 0, "no pole"


def test_few_dilute_discs_have_one_partner_less_each():
    """Z = 1 + 2 eta (N - 1)/N to first order in the packing."""
    assert (reference.contact_value(0.0), reference.enskog_rate(0.0), reference.finite_size(0.0, 50)) == (1, 0, 0)
    assert reference.contact_value(1e-12) == pytest.approx(1 + 2 * 0.7820044379e-12, rel=1e-15)
    assert reference.finite_size(1e-4, 50) == pytest.approx(-2e-4 / 50, rel=1e-3)
    assert reference.finite_size(0.3, 500) == pytest.approx(2 * reference.finite_size(0.3, 1000), rel=1e-12)
    assert reference.finite_size(0.62, 1000) < reference.finite_size(0.6, 1000) < -0.002


def test_the_rate_of_a_gas_scales_with_radius_and_temperature_and_agrees_with_its_pressure():
    assert reference.enskog_rate(0.3, radius=2.0, temperature=9.0) == pytest.approx(2.39952 * 3 / 4, rel=1e-5)
    rate = reference.enskog_rate(0.6, radius=0.2, temperature=3.0)
    found = reference.compressibility_from_rate(rate, radius=0.2, temperature=3.0)
    assert found == pytest.approx(reference.compressibility(0.6), rel=1e-13)


@pytest.mark.parametrize("degrees", [1, 2, 142, 9_999, 10_001])
def test_shell_factor_by_quadrature(degrees):
    """Mean |cos| over a sphere: density sin^(K-2), against sqrt(2/pi) for a normal component of unit variance."""
    mean = 1.0
    if degrees > 1:
        nodes, weights = np.polynomial.legendre.leggauss(200)
        angle = np.pi / 2 - (nodes + 1) / 2 * min(np.pi / 2, 12 / math.sqrt(degrees))
        weights = weights * np.sin(angle) ** (degrees - 2)
        mean = float((weights * np.cos(angle)).sum() / weights.sum())
    expected = math.sqrt(2 / math.pi) / (math.sqrt(degrees) * mean)
    assert reference.shell_factor(degrees) == pytest.approx(expected, rel=1e-9)
    if degrees > 100:
        assert reference.shell_factor(degrees) == pytest.approx(1 - 1 / (4 * degrees), abs=0.05 / degrees**2)


def test_closed_box_of_a_hundred_discs():
    side = math.sqrt(100 * math.pi / 4 / 0.3)
    found = reference.closed_box(100, side, 0.5)
    assert round(found.compressibility, 4) == 2.2438
    assert found.compressibility == pytest.approx(2.2399, rel=0.004)
    n, eta = found.bulk_density, found.bulk_density * math.pi / 4
    assert n * side**2 - 2 * side * n * (1 - eta) / (1 + eta) == pytest.approx(100, rel=1e-12)
    assert reference.compressibility(0.3) < 0.94 * found.compressibility  # negative control: the bulk value is far off


def test_two_discs_published_figures_and_virial():
    found = reference.two_discs(1, 1, 0.2, energy=2)
    assert abs(found.force_x - 5.641119) < 5e-7
    assert abs(found.wall_rate - 9.576661) < 5e-7
    assert abs(found.pair_rate - 4.155474) < 5e-7
    for value, measured, error in [(found.force_x, 5.64029, 63e-5), (found.wall_rate, 9.57503, 87e-5)]:
        assert abs(value - measured) < 3 * error
    assert abs(found.pair_rate - 4.1545) < 3 * 0.0012
    # (L - sigma)(F_x + F_y) = 2 N kT + sum of sigma |dp| / time; the mean |dp| from kT/<|u|> of the same sphere
    speed = 4 / (3 * math.pi) * 2
    push = math.sqrt(2) * 1.0 / speed  # mean of u_n^2 / mean of |u_n|, u_n = sqrt(2) x one component
    assert 0.6 * 2 * found.force_x == pytest.approx(4 + 0.4 * found.pair_rate * push, rel=1e-12)


def test_published_values():
    assert (reference.DENSE_72.value, reference.DENSE_72.error) == (6.90107, 7e-5)
    assert str(reference.DENSE_72) == "6.90107(7)"
    assert "157, 234111 (2022)" in reference.DENSE_72.source
    assert (reference.COEXISTENCE.value, str(reference.COEXISTENCE)) == (9.185, "9.185")


# --- motions, against direct simulation of the simplest kind


def follow_line(x, v, time, length, radius):
    """The gas on a line, collision by collision: positions, velocities, impulse on both walls. Discs in order."""
    x, v, clock, impulse = x.copy(), v.copy(), 0.0, 0.0
    while True:
        gaps = np.diff(x, prepend=-radius, append=length + radius) - 2 * radius
        closing = -np.diff(v, prepend=0.0, append=0.0)
        waits = np.where(closing > 0, np.maximum(gaps, 0) / np.where(closing > 0, closing, 1), np.inf)
        k = int(waits.argmin())
        if clock + waits[k] >= time:
            return x + v * (time - clock), v, impulse
        x, clock = x + v * waits[k], clock + waits[k]
        if k in (0, len(x)):
            end = 0 if k == 0 else -1
            impulse += 2 * abs(v[end])
            v[end] = -v[end]
        else:
            v[k - 1], v[k] = v[k], v[k - 1]


def line(count, seed, length=12.0, radius=0.25):
    rng = np.random.default_rng(seed)
    x = np.sort(rng.random(count)) * (length - 2 * radius * count) + 2 * radius * (np.arange(count) + 0.5)
    return x, rng.normal(size=count), length, radius


@pytest.mark.parametrize("count", [1, 2, 7])
def test_the_gas_on_a_line_is_followed_exactly(count):
    x, v, length, radius = line(count, seed=count)
    for time in (0.0, 0.3, 5.0, 400.0):
        places, speeds, _ = follow_line(x, v, time, length, radius)
        found, velocity = motion.line_gas(x, v, time, length, radius)
        assert found == pytest.approx(places, abs=1e-9)
        assert velocity == pytest.approx(speeds, abs=1e-12)


def collisions_with_a_wall(heavy):
    """Collisions of a heavy disc that comes from the right, a light one (mass 1) at rest, and a wall at the left."""
    light_v, heavy_v, count = 0.0, -1.0, 0
    while True:
        if heavy_v < light_v:
            total = heavy * heavy_v + light_v
            light_v, heavy_v = 2 * total / (heavy + 1) - light_v, 2 * total / (heavy + 1) - heavy_v
        elif light_v < 0:
            light_v = -light_v
        else:
            return count
        count += 1


def test_galperin_counts():
    assert [motion.galperin_collisions(power) for power in range(4)] == [3, 31, 314, 3141]
    for power in range(5):
        assert motion.galperin_collisions(power) == collisions_with_a_wall(100.0**power)
        assert motion.galperin_collisions(power) == math.ceil(math.pi / math.atan(0.1**power) * (1 - 1e-14)) - 1
    assert motion.galperin_collisions(15) == math.floor(math.pi * 10**15)
    assert collisions_with_a_wall(101.0) == 31  # the count is a step function of the mass,
    assert collisions_with_a_wall(120.0) != 31  # negative control: but not constant


def test_first_slope_by_quadrature():
    """Mean growth of the sum of v^4 per collision of two discs of speed 1, over angles and impact parameters."""
    nodes, weights = np.polynomial.legendre.leggauss(40)
    half, w = (nodes + 1) * np.pi / 2, weights
    between = (w * np.sin(2 * half) ** 2 * np.sin(half)).sum() / (w * np.sin(half)).sum()
    impact = (weights / 2 * np.sin(2 * np.arcsin(nodes)) ** 2).sum()
    per_collision = 2 * between * impact
    assert per_collision / 2 / 2 == pytest.approx(motion.EQUAL_SPEEDS_SLOPE, rel=1e-12)


def test_largest_speed_of_many_draws():
    v = np.random.default_rng(5).normal(0, 1.5, (400, 2500, 2))
    largest = np.hypot(v[..., 0], v[..., 1]).max(axis=1)
    median = motion.largest_speed(2500, 1, 1.5**2)
    assert np.median(largest) == pytest.approx(median, rel=0.03)
    assert motion.largest_speed(1, 1) == 0.0


# --- refusals


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: reference.compressibility(0.63), r"packing must be at most 0\.62 .* got 0\.63"),
        (lambda: reference.finite_size(0.3, 1), "count must be"),
        (lambda: reference.closed_box(100, 5.0, 0.5), "closed_box holds at most"),
        (lambda: reference.two_discs(1, 1, 0.26, 1.0), "at least 2 diameters, 1.04; got 1 and 1"),
        (lambda: reference.speed_kurtosis(1, at_rest=True), "count must be a whole number from 2"),
        (lambda: motion.line_gas([], [], 1.0, 2.0, 0.5), "one disc or more"),
        (lambda: motion.line_gas([0.5, 1.2], [0, 0], 1.0, 3.0, 0.5), "least gap -0.3"),
        (lambda: motion.line_gas([0.4], [0], 1.0, 3.0, 0.5), "walls at 0 and 3"),
        (lambda: motion.line_gas_force(1.0, 3, 3.0, 0.5), "length must be more than"),
        (lambda: motion.galperin_collisions(36), "power must be a whole number from 0 to 35"),
        (lambda: motion.end_of_bouncing(1.0, 9.8, 1), "restitution must be below 1"),
        (lambda: motion.haff_by_collisions(1.0, 1.1), "restitution must be a number from 0 to 1"),
        (lambda: motion.excess_from_equal_speeds(1.5), "collisions must be at most 1"),
    ],
)  # fmt: skip
def test_wrong_input_is_refused_by_name(call, words):
    with pytest.raises(InputError, match=words):
        call()
