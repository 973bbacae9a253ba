"""Equilibrium values: every published table entry, and each closed form against an independent evaluation."""

import math

import numpy as np
import pytest

from mpsim.errors import InputError
from mpsim.measure import reference

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


def test_the_approximant_has_the_series_it_was_made_from():
    """Taylor coefficients of Z from its values on a circle in the complex plane."""
    above, below = reference._pade()
    x = 0.3 * np.exp(2j * np.pi * np.arange(64) / 64)
    z = 1 + x * np.polyval(above[::-1], x) / np.polyval(below[::-1], x)
    taylor = (np.fft.fft(z) / 64).real[:10] / 0.3 ** np.arange(10)
    assert taylor == pytest.approx([1.0, *reference.VIRIAL], rel=1e-8)
    poles = np.roots(below[::-1]) / 2
    assert not ((np.abs(poles.imag) < 1e-9) & (poles.real > 0) & (poles.real < 0.9)).any()


def test_a_dilute_gas_loses_no_digits():
    assert reference.contact_value(0.0) == 1.0
    assert reference.contact_value(1e-12) == pytest.approx(1 + 2 * 0.7820044379e-12, rel=1e-15)
    assert reference.enskog_rate(0.0) == 0.0


def test_few_dilute_discs_have_one_partner_less_each():
    """Z = 1 + 2 eta (N - 1)/N to first order in the packing."""
    assert reference.finite_size(0.0, 50) == 0
    assert reference.finite_size(1e-4, 50) == pytest.approx(-2e-4 / 50, rel=1e-3)
    assert reference.finite_size(0.3, 500) == pytest.approx(2 * reference.finite_size(0.3, 1000), rel=1e-12)
    assert reference.finite_size(0.62, 1000) < reference.finite_size(0.6, 1000) < -0.002


def test_henderson_is_as_near_as_stated():
    assert reference.henderson(0.3) / reference.compressibility(0.3) - 1 == pytest.approx(0.0003, abs=0.0001)
    assert reference.henderson(0.5) / reference.compressibility(0.5) - 1 == pytest.approx(0.005, abs=0.001)


def test_the_rate_of_a_gas_scales_with_radius_and_temperature():
    assert reference.enskog_rate(0.3, radius=2.0, temperature=9.0) == pytest.approx(2.39952 * 3 / 4, rel=1e-5)


@pytest.mark.parametrize("packing", [0.01, 0.3, 0.6])
def test_rate_and_pressure_agree(packing):
    rate = reference.enskog_rate(packing, radius=0.2, temperature=3.0)
    found = reference.compressibility_from_rate(rate, radius=0.2, temperature=3.0)
    assert found == pytest.approx(reference.compressibility(packing), rel=1e-13)


@pytest.mark.parametrize("degrees", [1, 2, 4, 142, 9_999, 10_001])
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


def test_a_large_closed_box_is_bulk():
    found = reference.closed_box(10**8, math.sqrt(10**8 * math.pi / 4 / 0.3), 0.5)
    assert found.compressibility == pytest.approx(reference.compressibility(0.3), rel=1e-3)


def test_a_dilute_closed_box_is_an_ideal_gas_of_the_free_area():
    """One disc is an ideal gas in (L - 2 R)^2: P L = kT / (L - 2 R), here to second order in R/L."""
    assert reference.closed_box(1, 100.0, 0.1).compressibility == pytest.approx(100 / 99.8, rel=5e-5)


def area_of_places(a, b, sigma):
    """Omega by quadrature: 4 (a - x)(b - y) over displacements x, y >= 0 of the two centres, outside the disc."""
    nodes, weights = np.polynomial.legendre.leggauss(80)
    angle = (nodes + 1) * np.pi / 4
    r = (nodes + 1) / 2 * sigma
    x, y = np.outer(r, np.cos(angle)), np.outer(r, np.sin(angle))
    excluded = (4 * (a - x) * (b - y) * r[:, None] * np.outer(weights * sigma / 2, weights * np.pi / 4)).sum()
    return a * a * b * b - excluded


@pytest.mark.parametrize(("width", "height", "radius", "energy"), [(1, 1, 0.2, 2.0), (3, 1.7, 0.3, 0.7)])
def test_two_discs_by_quadrature(width, height, radius, energy):
    found = reference.two_discs(width, height, radius, energy)
    s, step = 2 * radius, 1e-4
    a, b = width - s, height - s
    log = lambda a, b, s: math.log(area_of_places(a, b, s))  # noqa: E731
    by_a = (log(a + step, b, s) - log(a - step, b, s)) / (2 * step)
    by_b = (log(a, b + step, s) - log(a, b - step, s)) / (2 * step)
    by_s = (log(a, b, s + step) - log(a, b, s - step)) / (2 * step)
    u = np.abs(np.random.default_rng(1).normal(size=(200_000, 4)))
    speed = float((u[:, 0] / np.sqrt((u**2).sum(axis=1))).mean()) * math.sqrt(2 * energy)
    assert found.phase_area == pytest.approx(area_of_places(a, b, s), rel=1e-12)
    assert found.force_x == pytest.approx(energy / 2 * by_a, rel=1e-6)
    assert found.force_y == pytest.approx(energy / 2 * by_b, rel=1e-6)
    assert found.wall_rate == pytest.approx((by_a + by_b) * speed, rel=0.006)
    assert found.pair_rate == pytest.approx(-by_s * speed / math.sqrt(2), rel=0.006)


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


def test_two_discs_by_monte_carlo():
    """Density of centres at the wall across x, from the places of two discs thrown at random."""
    rng = np.random.default_rng(8)
    places = rng.random((400_000, 2, 2)) * 0.6
    apart = np.hypot(*(places[:, 0] - places[:, 1]).T) > 0.4
    assert apart.mean() * 0.6**4 == pytest.approx(reference.two_discs(1, 1, 0.2, 2).phase_area, rel=0.01)


def test_sinai_rate_by_following_the_billiard():
    """A point among discs of radius sigma on a square lattice, from event to event: a disc, or the edge of a cell."""
    rng, sigma, half = np.random.default_rng(5), 0.5, 1.0
    point = rng.uniform(-half, half, (3000, 2))
    point = point[np.hypot(*point.T) > sigma]
    angle = rng.uniform(0, 2 * np.pi, len(point))
    heading = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    hits, time = 0, 0.0
    for _ in range(400):
        b = (point * heading).sum(axis=1)
        inside = b**2 - (point**2).sum(axis=1) + sigma**2
        to_disc = np.where((b < 0) & (inside > 0), -b - np.sqrt(np.maximum(inside, 0)), np.inf)
        to_edges = (half - point * np.sign(heading)) / np.abs(heading)
        wait = np.minimum(to_disc, to_edges.min(axis=1))
        point, time = point + heading * wait[:, None], time + wait.sum()
        struck = to_disc <= to_edges.min(axis=1)
        n = point[struck] / np.hypot(*point[struck].T)[:, None]
        heading[struck] -= 2 * (heading[struck] * n).sum(axis=1)[:, None] * n
        hits += struck.sum()
        leaving = np.arange(2) == np.where(struck, -1, to_edges.argmin(axis=1))[:, None]
        point[leaving] *= -1
    assert hits / time == pytest.approx(reference.sinai_rate(2, 2, 0.25, 1.0), rel=0.005)
    assert reference.sinai_rate(4, 2, 0.25, 3.0) == pytest.approx(3 / (8 - math.pi / 4), rel=1e-14)


@pytest.mark.parametrize(("count", "at_rest"), [(1, False), (2, False), (10, False), (2, True), (5, True)])
def test_speed_kurtosis_on_the_energy_shell(count, at_rest):
    v = np.random.default_rng(6).normal(size=(200_000, count, 2))
    v -= v.mean(axis=1, keepdims=True) if at_rest else 0
    squares = (v**2).sum(axis=2)
    squares /= squares.mean(axis=1, keepdims=True)
    found = (squares**2).mean(axis=1)
    expected = reference.speed_kurtosis(count, at_rest=at_rest)
    assert found.mean() == pytest.approx(expected, abs=4 * found.std() / math.sqrt(len(found)) + 1e-12)


def test_half_of_the_energy_under_gravity_is_potential():
    """Microcanonical places and velocities: shares of the energy are Gamma variables, 1/2 per v^2 and 1 per height."""
    rng = np.random.default_rng(7)
    kinetic, potential = rng.chisquare(2, (100_000, 4)) / 2, rng.exponential(size=(100_000, 4))
    share = potential / (kinetic.sum(axis=1) + potential.sum(axis=1))[:, None]
    assert share.mean() * 12 == pytest.approx(reference.potential_energy_per_disc(12.0, 4), rel=0.01)


def test_published_values():
    assert (reference.DENSE_72.value, reference.DENSE_72.error) == (6.90107, 7e-5)
    assert str(reference.DENSE_72) == "6.90107(7)"
    assert "157, 234111 (2022)" in reference.DENSE_72.source
    assert (reference.COEXISTENCE.value, str(reference.COEXISTENCE)) == (9.185, "9.185")


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: reference.compressibility(0.63), r"packing must be at most 0\.62 .* got 0\.63"),
        (lambda: reference.contact_value(-0.1), "packing must be a finite number >= 0"),
        (lambda: reference.finite_size(0.621, 9), r"packing must be at most 0\.62 .* got 0\.621"),
        (lambda: reference.finite_size(-0.0005, 9), r"packing must be .* got -0\.0005"),
        (lambda: reference.finite_size(0.3, 1), "count must be"),
        (lambda: reference.henderson(math.nan), "packing must be a finite number"),
        (lambda: reference.enskog_rate("0.4"), "packing must be a number >= 0 .*; got '0.4'"),
        (lambda: reference.compressibility(None), "packing must be a number >= 0 .*; got None"),
        (lambda: reference.enskog_rate(0.3, radius=0), "radius must be a finite number > 0"),
        (lambda: reference.compressibility_from_rate(1.0, 0.5, 0.0), "temperature must be a finite number > 0"),
        (lambda: reference.shell_factor(0), "degrees must be a whole number"),
        (lambda: reference.closed_box(100, 5.0, 0.5), "closed_box holds at most"),
        (lambda: reference.closed_box(1, 1.0, 0.5), "closed_box holds at most"),
        (lambda: reference.two_discs(1, 1, 0.26, 1.0), "at least 2 diameters, 1.04; got 1 and 1"),
        (lambda: reference.sinai_rate(1, 2, 0.3, 1.0), "at least 2 diameters"),
        (lambda: reference.speed_kurtosis(1, at_rest=True), "count must be a whole number from 2"),
        (lambda: reference.potential_energy_per_disc(-1.0, 2), "energy must be a finite number >= 0"),
    ],
)
def test_bad_input_is_refused_by_name(call, words):
    with pytest.raises(InputError, match=words):
        call()
