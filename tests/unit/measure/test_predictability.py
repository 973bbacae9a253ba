"""Growth of differences: a map whose exponent is known exactly, synthetic distances, and the refusal beyond it."""

import math

import numpy as np
import pytest

from mpsim.errors import InputError
from mpsim.measure.predictability import comparable_until, predictability, require_predictable


def cat_map_distances(steps, seed):
    """Distances of two orbits of Arnold's cat map, (x, y) -> (2x + y, x + y) mod 1, starting 1e-13 apart."""
    a = np.random.default_rng(seed).random(2)
    b = a + np.array([1e-13, 0])
    found = []
    for _ in range(steps):
        found.append(np.hypot(*((a - b + 0.5) % 1 - 0.5)))
        a, b = (np.array([2 * p[0] + p[1], p[0] + p[1]]) % 1 for p in (a, b))
    return np.array(found)


def test_the_exponent_of_the_cat_map():
    exact = math.log((3 + math.sqrt(5)) / 2)
    for seed in range(3):
        found = predictability(np.arange(60) * 0.5, cat_map_distances(60, seed), lowest=1e-12, highest=1e-2)
        assert found.rate.value == pytest.approx(2 * exact, rel=0.01)
        assert found.horizon == pytest.approx(20 / found.rate.value)
        assert found.comparable_until == pytest.approx(found.horizon / 2)


def test_negative_control_the_whole_series_with_its_plateau_grows_slower():
    distance = cat_map_distances(60, 0)
    exact = math.log((3 + math.sqrt(5)) / 2)
    assert predictability(np.arange(60.0), distance, highest=10.0).rate.value < 0.6 * exact


def test_noisy_growth_has_an_error_that_covers_it():
    rng = np.random.default_rng(1)
    deviations = []
    for _ in range(60):
        walk = np.cumsum(rng.normal(0.05, 0.2, 400))
        deviations.append(predictability(np.arange(400.0), 1e-9 * np.exp(walk), highest=1e30).rate.deviation(0.05))
    assert 0.7 < np.std(deviations) < 1.5
    assert abs(np.mean(deviations)) < 0.5


def test_growth_starts_after_a_meeting_and_ends_before_the_ceiling():
    distance = np.array([1e-9, 0.0, 1e-12, *(1e-12 * np.exp(np.arange(1, 30))), 1.0, 1e-12])
    found = predictability(np.arange(len(distance)), distance, highest=1e-2)
    assert found.rate.value == pytest.approx(1.0, rel=1e-12)


def test_a_comparison_up_to_half_of_twenty_lyapunov_times_is_allowed():
    assert comparable_until(2.9) == pytest.approx(10 / 2.9)
    require_predictable(10 / 2.9, rate=2.9)
    with pytest.raises(InputError, match=r"at most 3\.44828 .* got 3\.5.*compare averages"):
        require_predictable(3.5, rate=2.9)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: predictability([0, 1, 3], [1, 2, 3], highest=9), "equal steps"),
        (lambda: predictability([0, 1], [1, 2], highest=9), "at least 3 times"),
        (lambda: predictability([0, 1, 2], [1, -2, 3], highest=9), "distance must be >= 0"),
        (lambda: predictability([0, 1, 2], [1, 2, 3], lowest=9, highest=9), "highest above lowest"),
        (lambda: predictability([0, 1, 2], [1, 2, 3], highest=1.5), "at least 3 samples"),
        (lambda: predictability([0, 1, 2], [0, 0, 0], highest=1.5), "at least 3 samples"),
        (lambda: predictability([0, 1, 2], [1, 1, 1], highest=9), "distance must grow"),
        (lambda: predictability([0, 1, 2], [1, math.inf, 1], highest=9), "must be finite"),
        (lambda: comparable_until(0.0), "rate must be a finite number > 0"),
        (lambda: require_predictable(-1.0, 1.0), "time must be a finite number >= 0"),
    ],
)
def test_bad_input_is_refused_by_name(call, words):
    with pytest.raises(InputError, match=words):
        call()
