"""The multiple-tau scheme against a slow twin, and its errors against what they say of themselves."""

import numpy as np
import pytest

from mpsim.measure.motion import SQUARES, VELOCITIES, WAVES, correlator
from mpsim.measure.multiple_tau import MOST_PARTS, BlockSums, MultipleTau, lags_of, levels_for, trapezoid


def series(samples, discs=3, seed=1):
    """Positions and velocities of discs that walk at random, shape (samples, 2, discs, 2)."""
    rng = np.random.default_rng(seed)
    velocity = rng.normal(size=(samples, discs, 2)) + np.sin(np.arange(samples) / 9)[:, None, None]
    return np.stack([np.cumsum(velocity, axis=0), velocity], axis=1)


def by_hand(whole, level, k, wave_number):
    """What level l knows of lag k 2^l, from the whole series: squares, products of velocities, waves; and origins."""
    size = 2**level
    blocks = len(whole) // size
    places = whole[size - 1 :: size, 0][:blocks]  # each last one of size samples
    velocities = np.array([whole[size * b : size * (b + 1), 1].mean(axis=0) for b in range(blocks)])
    found = []
    for b in range(blocks - k):
        moved = places[b + k] - places[b]
        squares = (moved**2).sum(axis=1).mean()
        products = (velocities[b + k] * velocities[b]).sum(axis=1).mean()
        found.append([squares, products, np.cos(wave_number * moved).mean()])
    return np.mean(found, axis=0), len(found)


@pytest.mark.parametrize("samples", [1, 7, 100, 1000])
def test_each_lag_is_the_mean_over_all_its_time_origins(samples):
    whole, points, levels, wave_number = series(samples), 8, 6, 0.7
    found = correlator(np.array([wave_number]), points, levels)
    for sample in whole:
        found.add(sample)
    lags = [(level, k) for level in range(levels) for k in range(points // 2 if level else 0, points)]
    assert found.lags.tolist() == [k * 2**level for level, k in lags]
    assert found.width.tolist() == [2**level for level, _ in lags]
    for index, (level, k) in enumerate(lags):
        origins = samples // 2**level - k
        assert found.blocks.origins()[index] == max(origins, 0)
        if origins > 0:
            expected, count = by_hand(whole, level, k, wave_number)
            assert count == origins
            means = [found.blocks.means(quantity)[index] for quantity in (SQUARES, VELOCITIES, WAVES)]
            assert means == pytest.approx(expected, rel=1e-12, abs=1e-12), f"level {level}, k = {k}"


def test_positions_that_were_averaged_too_would_be_noticed():
    """Negative control: averages over blocks of positions have smaller displacements than positions."""
    whole = series(1000)
    merged = MultipleTau(
        lambda now, then: np.square(now - then[:, :]).reshape(len(then), -1).sum(axis=1)[:, None] / 3,
        lambda first, second: (first + second) / 2,
        1,
        points=8,
        levels=6,
    )
    for sample in whole:
        merged.add(sample[0])
    index = int(np.flatnonzero(merged.lags == 4 * 16)[0])
    expected, _ = by_hand(whole, 4, 4, 0.7)
    assert merged.blocks.means(0)[index] < 0.95 * expected[0]


def test_samples_before_a_restart_meet_none_after_it():
    found = MultipleTau(lambda now, then: (now * then)[:, None], lambda a, b: (a + b) / 2, 1, points=4, levels=2)
    for sample in (1.0, 2.0, 3.0):
        found.add(np.float64(sample))
    found.restart()
    for sample in (10.0, 20.0):
        found.add(np.float64(sample))
    assert found.blocks.origins().tolist() == [5, 3, 1, 0, 0, 0]
    assert found.blocks.means(0)[:3].tolist() == [(1 + 4 + 9 + 100 + 400) / 5, (2 + 6 + 200) / 3, 3.0]


def test_parts_are_added_up_when_all_are_in_use_and_nothing_is_lost():
    rng = np.random.default_rng(2)
    blocks, values = BlockSums(3, 2), rng.normal(size=(5 * MOST_PARTS + 3, 3, 2))
    for number, each in enumerate(values):
        blocks.begin_sample()
        blocks.add(slice(0, 3), each)
        assert blocks.samples == number + 1
    assert (blocks.span, blocks.origins().tolist()) == (8, [len(values)] * 3)
    for quantity in range(2):
        assert blocks.means(quantity) == pytest.approx(values.mean(axis=0)[:, quantity], rel=1e-12)
    parts = [values[first : first + 8].sum(axis=0) for first in range(0, len(values), 8)]
    assert blocks.sums[: len(parts)] == pytest.approx(np.array(parts), rel=1e-12)
    assert not blocks.sums[len(parts) :].any()


def test_lags_that_no_product_has_reached_have_no_value():
    blocks = BlockSums(2, 1)
    blocks.begin_sample()
    blocks.add(slice(0, 1), np.ones((1, 1)))
    assert np.isnan(blocks.means(0)).tolist() == [False, True]
    assert repr(blocks.combined(0, np.array([1.0, 1.0]))) == "nan(?)"
    assert repr(blocks.combined(0, np.zeros(2))) == "nan(?)"


RUNS, SAMPLES, TIME = 300, 5000, 5.0


@pytest.fixture(scope="module")
def ensemble():
    """Correlators of 300 runs at once, each of two velocities that relax in 5 samples, and their displacements."""
    rng, decay = np.random.default_rng(3), np.exp(-1 / TIME)

    def product(now, then):
        squares = np.square(now[0] - then[:, 0]).mean(axis=-1)
        return np.concatenate([squares, (now[1] * then[:, 1]).mean(axis=-1)], axis=1)

    found = MultipleTau(product, lambda a, b: np.stack([b[0], (a[1] + b[1]) / 2]), 2 * RUNS, points=16, levels=7)
    place, velocity = np.zeros((RUNS, 2)), rng.normal(size=(RUNS, 2))
    for _ in range(SAMPLES):
        found.add(np.stack([place, velocity]))
        place = place + velocity
        velocity = decay * velocity + np.sqrt(1 - decay**2) * rng.normal(size=(RUNS, 2))
    return found


def exact_product(lag, width):
    """Mean product of averages over `width` velocities, at this lag."""
    i = np.arange(width)
    return np.exp(-np.abs(lag + i[:, None] - i) / TIME).mean()


def exact_square(lag):
    """Mean square of the sum of `lag` velocities."""
    i = np.arange(lag)
    return np.exp(-np.abs(i[:, None] - i) / TIME).sum()


def deviations(ensemble, weights, expected, quantities):
    """Deviations of settled means from the truth, in their own standard errors."""
    measures = [ensemble.blocks.combined(quantity, weights) for quantity in quantities]
    return np.array([each.deviation(expected) for each in measures if each.settled])


def at(ensemble, lag):
    return (ensemble.lags == lag).astype(float)


@pytest.mark.slow
@pytest.mark.parametrize("lag", [0, 1, 5, 15, 30, 64, 240, 960])
def test_stated_errors_of_velocities_cover_the_truth_as_often_as_they_say(ensemble, lag):
    index = int(np.flatnonzero(ensemble.lags == lag)[0])
    expected = exact_product(lag, int(ensemble.width[index]))
    found = deviations(ensemble, at(ensemble, lag), expected, range(RUNS, 2 * RUNS))
    assert_calibrated(found)


@pytest.mark.parametrize("lag", [1, 5, 15, 30, 64, 176])
def test_stated_errors_of_displacements_cover_the_truth_as_often_as_they_say(ensemble, lag):
    assert_calibrated(deviations(ensemble, at(ensemble, lag), exact_square(lag), range(RUNS)))


def test_stated_errors_of_a_slope_and_of_an_integral_cover_the_truth(ensemble):
    """Weighted sums, whose terms are correlated: errors of the terms alone could not give theirs."""
    slope = (at(ensemble, 64) - at(ensemble, 30)) / 34
    assert_calibrated(deviations(ensemble, slope, (exact_square(64) - exact_square(30)) / 34, range(RUNS)))
    integral = np.where(ensemble.lags <= 60, trapezoid(ensemble.lags), 0.0)
    exact = [exact_product(int(lag), int(width)) for lag, width in zip(ensemble.lags, ensemble.width, strict=True)]
    assert_calibrated(deviations(ensemble, integral, float((integral * exact).sum()), range(RUNS, 2 * RUNS)))


def assert_calibrated(found, number=RUNS):
    """Of 300 Gaussian deviations 68.3 +- 2.7 % lie within one error, 95.4 +- 1.2 % within two; 3.5 sigma are allowed.

    Errors that are known to 10 % themselves cost half a per cent of the latter.
    """
    assert len(found) > 0.95 * number, f"only {len(found)} of {number} runs know their error"
    within = [(np.abs(found) < bound).mean() for bound in (1, 2)]
    assert abs(within[0] - 0.683) < 0.095, within
    assert 0.908 < within[1] < 0.996, within
    assert 0.85 < found.std() < 1.15, found.std()


def test_at_lags_of_a_tenth_of_the_run_errors_of_displacements_are_too_small(ensemble):
    """Which is why `Motion` calls none settled beyond a 25th: see test_motion.py."""
    found = [ensemble.blocks.combined(run, at(ensemble, 480)).deviation(exact_square(480)) for run in range(RUNS)]
    assert np.std(found) > 1.3


def test_errors_that_took_time_origins_for_independent_would_be_noticed(ensemble):
    """Negative control: they are too small by a factor of two and more."""
    weights, quantities = at(ensemble, 15), range(RUNS, 2 * RUNS)
    index = int(np.flatnonzero(ensemble.lags == 15)[0])
    expected = exact_product(15, 1)
    means = np.array([ensemble.blocks.means(q)[index] for q in quantities])
    spread = means.std()
    naive = np.sqrt(1 / 2 / ensemble.blocks.origins()[index])  # products of two unit Gaussians, two of them a sample
    with pytest.raises(AssertionError):
        assert_calibrated((means - expected) / naive)
    assert naive < 0.5 * spread
    assert_calibrated(deviations(ensemble, weights, expected, quantities))


@pytest.mark.parametrize("points", [4, 16, 30])
def test_levels_reach_the_longest_lag_and_no_fewer_would(points):
    for longest in (1, points - 1, points, 1000, 12345):
        levels = levels_for(longest, points)
        assert lags_of(points, levels)[-1] >= longest
        assert levels == 1 or lags_of(points, levels - 1)[-1] < longest


def test_products_of_many_discs_do_not_depend_on_how_they_are_cut(monkeypatch):
    """Many discs are multiplied a few lags at a time; the bits stay."""
    whole, found = series(40, discs=50), []
    for chunk in (1, 300, 10**9):
        monkeypatch.setattr("mpsim.measure.motion.CHUNK", chunk)
        one = correlator(np.array([1.0]), 8, 4)
        for sample in whole:
            one.add(sample)
        found.append(one.blocks.sums.tobytes())
    assert len(set(found)) == 1
