"""Closed forms of equilibrium: published tables, and each against an independent evaluation."""

import math

import numpy as np
import pytest

from mpsim import InputError
from mpsim.measure import reference


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
    from_rate = 1 + reference.enskog_rate(0.6, radius=0.2, temperature=3.0) * 0.1 * math.sqrt(math.pi / 3)
    assert from_rate == pytest.approx(reference.compressibility(0.6), rel=1e-13)


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
    assert found.compressibility == pytest.approx(2.2399, rel=0.004)
    n, eta = found.bulk_density, found.bulk_density * math.pi / 4
    assert n * side**2 - 2 * side * n * (1 - eta) / (1 + eta) == pytest.approx(100, rel=1e-12)
    assert reference.compressibility(0.3) < 0.94 * found.compressibility  # negative control: the bulk value is far off


def test_two_discs_published_figures_and_virial():
    found = reference.two_discs(1, 1, 0.2, energy=2)
    for value, measured, error in [(found.force_x, 5.64029, 63e-5), (found.wall_rate, 9.57503, 87e-5)]:
        assert abs(value - measured) < 3 * error
    assert abs(found.pair_rate - 4.1545) < 3 * 0.0012
    # (L - sigma)(F_x + F_y) = 2 N kT + sum of sigma |dp| / time; the mean |dp| from kT/<|u|> of the same sphere
    speed = 4 / (3 * math.pi) * 2
    push = math.sqrt(2) * 1.0 / speed  # mean of u_n^2 / mean of |u_n|, u_n = sqrt(2) x one component
    assert 0.6 * 2 * found.force_x == pytest.approx(4 + 0.4 * found.pair_rate * push, rel=1e-12)


# --- refusals


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: reference.compressibility(0.63), r"packing must be at most 0\.62 .* got 0\.63"),
        (lambda: reference.finite_size(0.3, 1), "count must be"),
        (lambda: reference.closed_box(100, 5.0, 0.5), "closed_box holds at most"),
        (lambda: reference.two_discs(1, 1, 0.26, 1.0), "at least 2 diameters, 1.04; got 1 and 1"),
        (lambda: reference.speed_kurtosis(1, at_rest=True), "count must be a whole number from 2"),
    ],
)  # fmt: skip
def test_wrong_input_is_refused_by_name(call, words):
    with pytest.raises(InputError, match=words):
        call()
