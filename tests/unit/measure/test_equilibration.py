"""The marginal standard error rule against a slow twin, and on series whose stationary part is known."""

import numpy as np
import pytest

import mpsim
from mpsim.measure import block_average, equilibration
from mpsim.measure.equilibration import marginal_errors


def by_hand(values):
    """The rule as it is written."""
    number = len(values)
    found = []
    for d in range(number // 2 + 1):
        rest = values[d:]
        found.append(sum((each - np.mean(rest)) ** 2 for each in rest) / len(rest) ** 2)
    return found


@pytest.mark.parametrize("number", [2, 3, 10, 57])
def test_the_rule_is_that_of_its_slow_twin(number):
    values = 1e6 + np.random.default_rng(number).normal(size=number)
    assert marginal_errors(values) == pytest.approx(by_hand(values), rel=1e-7)


def relaxing(seed, size=20.0, time=60.0, number=3000):
    """Correlated noise about 5, which begins `size` above."""
    rng = np.random.default_rng(seed)
    noise = np.zeros(number)
    for k in range(1, number):
        noise[k] = 0.8 * noise[k - 1] + 0.6 * rng.normal()
    return 5 + noise + size * np.exp(-np.arange(number) / time)


def test_the_mean_without_the_transient_covers_the_truth_and_that_with_it_does_not():
    found = [equilibration(relaxing(seed)) for seed in range(60)]
    found = [each for each in found if each.found]
    assert len(found) > 50
    assert all(each.measure.settled for each in found)
    assert all(100 < each.start < 1200 for each in found), [each.start for each in found]
    z = np.array([each.measure.deviation(5.0) for each in found])
    assert (np.abs(z) < 2).mean() > 0.85
    assert np.abs(z.mean()) < 0.6
    whole = np.array([block_average(relaxing(seed)).value for seed in range(60)])
    assert (whole - 5).mean() > 0.3  # 20 * 60 / 3000
    assert np.mean([each.measure.value - 5 for each in found]) < 0.03


def test_a_stationary_series_keeps_nearly_all_of_itself():
    starts = np.array([equilibration(relaxing(seed, size=0.0)).start for seed in range(40)])
    assert np.median(starts) < 300
    assert equilibration(np.full(100, 3.5)).start == 0


def test_a_series_that_keeps_rising_is_not_found_to_be_stationary():
    found = equilibration(np.arange(1000.0))
    assert not found.found
    assert not found.measure.settled
    assert found.start == 500
    assert not equilibration(relaxing(1, time=5000.0)).found


@pytest.mark.parametrize(
    ("series", "batch", "words"),
    [
        (np.zeros(49), 5, "at least 10 batches of 5 samples to find its stationary part; got 49 samples"),
        ([], 5, "got 0 samples"),
        ([1.0, np.nan] * 50, 5, "series must be finite"),
        (np.zeros((10, 10)), 5, "series must have shape (n,)"),
        ("abc", 5, "series must be numbers"),
        (np.zeros(100), 0, "batch must be a whole number from 1"),
        (np.zeros(100), 2.5, "batch must be a whole number"),
    ],
)
def test_bad_input_is_refused(series, batch, words):
    with pytest.raises(mpsim.InputError) as caught:
        equilibration(series, batch=batch)
    assert words in str(caught.value)
