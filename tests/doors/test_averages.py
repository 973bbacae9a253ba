"""Averages with errors, and stationary parts: by hand, and of series whose truth is known."""

import math
from itertools import accumulate

import numpy as np
import pytest
from support.scenes import gas, simulate

from mpsim import InputError
from mpsim.measure import (
    Measure,
    Series,
    block_average,
    block_errors,
    equilibration,
    independent_average,
    kinetic_energy,
    ratio_average,
    reference,
)

pytestmark = pytest.mark.plain

FEWEST_BLOCKS = 16


@pytest.mark.parametrize(
    ("measure", "text"),
    [
        (Measure(2.23991, 0.00163, 9), "2.2399(16)"),
        (Measure(2.0, 0.0996, 9), "2.00(10)"),
        (Measure(1.2345e-9, 2.1e-11, 9), "1.234(21)e-09"),
        (Measure(0.0, 1e-12, 9), "0.0(1.0)e-12"),
        (Measure(math.nan, math.nan, 9), "nan(?)"),
        (Measure(2.24, 0.16, 9, settled=False), "2.24(>16)"),
        (Measure(0.0, 1.8e-4, 9, settled=False, upper=True), "0(<0.00018)"),
        (Measure(0.0, math.nan, 9, settled=False), "0(?)"),
    ],
)
def test_a_measure_prints_its_error_in_units_of_the_last_digit(measure, text):
    """A lower bound as >, an upper one as <."""
    assert repr(measure) == f"{measure}" == text
    assert float(measure) == pytest.approx(measure.value, nan_ok=True)
    assert f"{measure:.3f}" == f"{measure.value:.3f}"


def test_independent_averages_and_deviations_by_hand():
    found = independent_average([1.0, 2.0, 3.0, 4.0])
    assert (found.value, found.error, found.samples) == (2.5, pytest.approx(math.sqrt(5 / 3 / 4), rel=1e-15), 4)
    assert [Measure(2.0, 0.5, 9).deviation(1.0), Measure(2.0, 0.0, 9).deviation(3.0)] == [2.0, -math.inf]


def noise(n, correlation, seed):
    """AR(1): x_k = a x_(k-1) + e_k, a = exp(-1/correlation), and the error of its mean."""
    a = math.exp(-1 / correlation) if correlation else 0.0
    first, *steps = np.random.default_rng(seed).normal(size=n).tolist()
    series = accumulate(steps, lambda last, step: a * last + step, initial=first / math.sqrt(1 - a * a))
    return np.fromiter(series, float, n), math.sqrt((1 + a) / (1 - a) / (n * (1 - a * a)))


@pytest.mark.parametrize("correlation", [0, 3, 20])
def test_the_error_of_correlated_noise_is_that_of_its_correlation(correlation):
    found = [(block_average(series), true) for series, true in (noise(2**14, correlation, s) for s in range(10))]
    ratios = [measure.error / true for measure, true in found]
    assert np.mean(ratios) == pytest.approx(1, abs=0.08)
    assert all(0.6 < ratio < 1.4 for ratio in ratios), ratios
    assert all(measure.settled for measure, _ in found)
    deviations = [measure.deviation(0.0) for measure, _ in found]
    assert max(map(abs, deviations)) < 3.5, deviations


def test_no_error_comes_from_fewer_than_sixteen_blocks():
    rng = np.random.default_rng(0)
    assert math.isnan(block_average(rng.normal(size=FEWEST_BLOCKS - 1)).error)
    assert len(block_errors(rng.normal(size=FEWEST_BLOCKS))) == 1
    assert len(block_errors(rng.normal(size=100))) == 3  # 100, 50 and 25 blocks; 12 would be too few
    assert block_average([1.0, 2.0]).value == 1.5
    by_hand = math.sqrt(64 / 63) / 8, math.sqrt(32 / 31) / math.sqrt(32), 0.0
    assert block_errors(np.tile([0.0, 0.0, 2.0, 2.0], 16)) == pytest.approx(by_hand, rel=1e-14)


@pytest.mark.parametrize("kind", [bool, int])
def test_a_count_of_nothing_is_not_known_to_be_nothing(kind):
    found = block_average(np.zeros(1000, kind))
    assert (found.value, found.settled, found.upper) == (0, False, True)
    assert found.error == pytest.approx(1.841 / 1000, rel=0.02), "Garwood's limit, -ln(0.1587) events"
    assert block_average(np.zeros(1000), event=0.5).error == pytest.approx(found.error / 2)
    assert block_errors(np.zeros(1000)).max() == 0, "the control: the scatter says nothing"


def test_from_sixteen_events_on_their_scatter_counts():
    found = [block_average(np.random.default_rng(seed).random(4000) < 0.01) for seed in range(60)]
    settled = np.array([measure.error for measure in found if measure.settled])
    assert len(settled) > 50
    assert np.sqrt((settled**2).mean()) == pytest.approx(math.sqrt(0.01 * 0.99 / 4000), rel=0.06)


def alternating(n, time, beneath, seed):
    """Changes of a smooth quantity that forgets itself after some `time`, with noise beneath; the mean over n."""
    rng = np.random.default_rng(seed)
    kernel = np.exp(-0.5 * (np.arange(-4 * time, 4 * time + 1) / time) ** 2)
    bounded = np.convolve(rng.normal(size=n + 8 * time + 1), kernel / np.sqrt((kernel**2).sum()), "valid")
    return np.diff(bounded) + beneath * rng.normal(size=n), math.sqrt(2 / n**2 + beneath**2 / n)


def test_the_error_of_what_alternates_is_that_of_what_is_left_over():
    """As impulses on walls: n samples cancel but for what is under way at both ends, and for the noise beneath."""
    found = [(block_average(series), true) for series, true in (alternating(4000, 10, 0.1, s) for s in range(40))]
    ratios = np.array([measure.error / true for measure, true in found if measure.settled])
    assert len(ratios) > 30
    assert np.sqrt((ratios**2).mean()) == pytest.approx(1, abs=0.25)
    series, true = alternating(4000, 10, 0.1, 0)
    assert block_errors(series).max() > 2 * true, "the control: blocks that are too short"


def test_what_is_known_to_alternate_more_slowly_has_an_upper_bound():
    series, true = alternating(400, 15, 0.0, 1)
    found = block_average(series, alternation=15)
    assert not found.settled
    assert found.upper
    assert found.error > true
    assert not block_average(series, alternation=400 / 31).upper, "the control"


def test_what_rises_too_steeply_from_frequency_zero_has_an_upper_bound():
    """Amplitudes exp(r k^2 / 2) of the frequencies k/16, up to a limit."""

    def rising(strength, seed):
        k, rng = np.arange(501), np.random.default_rng(seed)
        amplitudes = np.exp(np.minimum(strength * (k / 16) ** 2, 60) / 2) * (k > 0)
        return block_average(np.fft.irfft(amplitudes * (rng.normal(size=501) + 1j * rng.normal(size=501)), 1000))

    steep, flat = ([rising(strength, seed) for seed in range(20)] for strength in (12, 0))
    assert all(each.upper and not each.settled for each in steep)
    assert np.mean([each.settled for each in flat]) > 0.9


def test_a_series_that_drifts_or_is_shorter_than_its_correlation_is_not_settled():
    drifting = np.linspace(0, 1, 2000) + np.random.default_rng(1).normal(0, 0.1, 2000)
    for series in (drifting, noise(2048, 500, 3)[0]):
        found = block_average(series)
        assert (found.settled, found.upper, found.error) == (False, False, block_errors(series).max())


def test_the_error_of_a_ratio_is_the_scatter_of_others():
    found = []
    for seed in range(100):
        rng = np.random.default_rng(seed)
        events = rng.poisson(2.0, 500)
        found.append(ratio_average(rng.gamma(events, 3.0), events))
    scatter = np.std([measure.value for measure in found], ddof=1)
    assert np.sqrt(np.mean([measure.error**2 for measure in found])) == pytest.approx(scatter, rel=0.2)
    assert np.mean([measure.value for measure in found]) == pytest.approx(3, abs=0.03)
    assert all(measure.samples > 900 and measure.settled for measure in found)


def test_a_ratio_over_few_events_is_not_settled_and_over_none_is_unknown():
    few = np.zeros(400)
    few[[7, 100, 320]] = 1
    assert not ratio_average(2 * few + np.arange(400) * few, few).settled
    nothing = ratio_average(np.zeros(400), np.zeros(400))
    assert (nothing.value, nothing.samples, nothing.settled) == (0, 0, False)
    assert math.isnan(nothing.error)


def test_what_cannot_change_has_no_error_and_what_only_has_not_an_unknown_one():
    found = block_average(np.full(1000, 0.1), constant=True)
    assert (found.value, found.error, found.samples, found.settled) == (0.1, 0.0, 1000, True)
    rounded = block_average(0.1 + 1e-16 * np.arange(1000).clip(max=500), constant=True)
    assert rounded.settled
    assert 0 < rounded.error < 1e-12
    for value, rounding in ((0.1, 0.0), (0.1, 1e-16), (0.0, 0.0)):
        found = block_average(value + rounding * np.arange(1000).clip(max=500))
        assert (found.value, found.settled) == (pytest.approx(value), False)
        assert math.isnan(found.error)


@pytest.mark.parametrize("place", [1, 500, 999])
def test_what_has_hardly_changed_has_a_lower_bound(place):
    """One change, or two, of a state say little of how much it varies; white noise says it."""
    series = np.ones(1000)
    series[place] = 2
    found = block_average(series)
    assert (found.settled, found.upper) == (False, False)
    assert found.error == block_errors(series).max()
    series[::50] = 2
    assert block_average(series).settled, "the control"


def test_changes_within_rounding_are_none():
    ones = np.random.default_rng(3).integers(0, 2, 1000)
    assert not block_average(1e12 - ones).settled
    assert block_average(1e12 - 2 * ones).settled, "the control"


def settled(slow, memories, seeds=40):
    """Part of the measures of 2000 samples of white noise, on a component of so many correlation times."""
    found = []
    for seed in range(seeds):
        series, _ = noise(2000, 2000 / memories, seed)
        white = np.random.default_rng(1000 + seed).normal(size=2000)
        found.append(block_average(slow * series / math.sqrt(1000 / memories) + white).settled)
    return np.mean(found)


def test_a_slow_component_under_noise_shows():
    """It has 0.09 of the variance, and most of the error of the mean; without it, series settle."""
    assert settled(0.3, 20) < 0.5
    assert settled(0.3, 5) < 0.25
    assert settled(0.0, 5) > 0.85, "the control"
    assert settled(0.3, 200) > 0.85, "the control: fast enough"


# --- stationary parts


@pytest.mark.parametrize("number", [10, 57])
def test_the_stationary_part_begins_where_the_rule_says(number):
    """The least standard error of the mean of what is left, of at least half."""
    values = 1e6 + np.random.default_rng(number).normal(size=number)
    errors = [values[start:].var() / (number - start) for start in range(number // 2 + 1)]
    assert equilibration(values, batch=1).start == np.argmin(errors)


def relaxing(seed, size=20.0, time=60.0):
    """Correlated noise about 5, which begins `size` above."""
    return 5 + 0.6 * noise(3000, 4.48, seed)[0] + size * np.exp(-np.arange(3000) / time)


def test_the_mean_without_the_transient_covers_the_truth_and_that_with_it_does_not():
    found = [each for each in (equilibration(relaxing(seed)) for seed in range(40)) if each.found]
    assert len(found) > 32
    assert all(each.measure.settled for each in found)
    assert all(100 < each.start < 1200 for each in found), [each.start for each in found]
    z = np.array([each.measure.deviation(5.0) for each in found])
    assert (np.abs(z) < 2).mean() > 0.85
    assert np.abs(z.mean()) < 0.6
    whole = np.array([block_average(relaxing(seed)).value for seed in range(10)])
    assert (whole - 5).mean() > 0.3  # 20 * 60 / 3000
    assert np.mean([each.measure.value - 5 for each in found]) < 0.03
    starts = [equilibration(relaxing(seed, size=0.0)).start for seed in range(20)]
    assert np.median(starts) < 300, "a stationary series keeps nearly all of itself"


def test_a_series_that_keeps_rising_is_not_found_to_be_stationary():
    found = equilibration(np.arange(1000.0))
    assert (found.found, found.measure.settled, found.start) == (False, False, 500)
    assert not equilibration(relaxing(1, time=5000.0)).found


# --- series


def test_a_series_notes_each_frame_once_with_its_time():
    scene, other = gas(8, 0.2), Series(kinetic_energy)
    found = Series(lambda state, scene: state.position[3, 0], every=3)
    expected = []
    with simulate(scene, dt=0.05, method="naive") as sim, simulate(scene, dt=0.05, method="naive") as again:
        for frames in (4, 0, 5, 6):
            sim.run(frames=frames, observe=found)
        for frame in range(16):
            if frame % 3 == 0:
                expected.append((again.time, again.state.position[3, 0]))
            again.run(frames=1, observe=other)
        with pytest.raises(InputError, match="a Series belongs to one simulation"):
            sim.run(frames=1, observe=other)
        with pytest.raises(InputError, match="what function of a Series gives must be a number; got 'hot'"):
            sim.run(frames=1, observe=Series(lambda state, scene: "hot"))
    assert np.column_stack([found.time, found.value]).tolist() == np.array(expected).tolist()
    assert repr(found) == "<Series: 6 values>"


# --- closed forms of equilibrium: published tables, and each against an independent evaluation


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
    assert (reference.enskog_rate(0.0), reference.finite_size(0.0, 50)) == (0, 0)
    assert reference.enskog_rate(1e-12) == pytest.approx(
        8e-12 / math.sqrt(math.pi) * (1 + 2 * 0.7820044379e-12), rel=4e-16
    )
    assert reference.finite_size(1e-4, 50) == pytest.approx(-2e-4 / 50, rel=1e-3)
    assert reference.finite_size(0.3, 500) == pytest.approx(2 * reference.finite_size(0.3, 1000), rel=1e-12)
    assert reference.finite_size(0.62, 1000) < reference.finite_size(0.6, 1000) < -0.002


def test_the_rate_of_a_gas_scales_with_radius_and_temperature_and_agrees_with_its_pressure():
    assert reference.enskog_rate(0.3, radius=2.0, temperature=9.0) == pytest.approx(2.39952 * 3 / 4, rel=1e-5)
    from_rate = 1 + reference.enskog_rate(0.6, radius=0.2, temperature=3.0) * 0.1 * math.sqrt(math.pi / 3)
    assert from_rate == pytest.approx(reference.compressibility(0.6), rel=1e-13)


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
        (lambda: block_average([]), "series must hold at least 1 sample; got 0"),
        (lambda: block_average([1.0, math.nan]), r"series\[1\] is nan"),
        (lambda: equilibration(np.zeros(49)), "at least 10 batches of 5 samples .* part; got 49 samples"),
        (lambda: Series("temperature"), r"must be called as function\(state, scene\); got 'temp"),
        (lambda: reference.compressibility(0.63), r"packing must be at most 0\.62 .* got 0\.63"),
        (lambda: reference.finite_size(0.3, 1), "count must be"),
        (lambda: reference.two_discs(1, 1, 0.26, 1.0), "at least 2 diameters, 1.04; got 1 and 1"),
        (lambda: reference.speed_kurtosis(1, at_rest=True), "count must be a whole number from 2"),
    ],
)  # fmt: skip
def test_wrong_input_is_refused_by_name(call, words):
    with pytest.raises(InputError, match=words):
        call()
