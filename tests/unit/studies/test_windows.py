"""Windows along the duration of a scene, and the stationary part of it."""

import math

import numpy as np
import pytest

from mpsim.studies.deviations import deviations
from mpsim.studies.windows import alike, spans_of, steady_from

RUNS, PIECES = 16, 16
TIME = (np.arange(PIECES) + 0.5) / PIECES


def noisy(seed, mean, size=0.05, runs=RUNS):
    return mean + size * np.random.default_rng(seed).normal(size=(runs, PIECES))


def as_runs(values, late=0.0):
    return [{"pressure": each.tolist(), "centre": (TIME + late / PIECES).tolist()} for each in values]


# What is stationary


def test_noise_is_stationary_nineteen_times_in_twenty():
    found = [steady_from(noisy(seed, 1.0)) for seed in range(200)]
    assert sum(first == 0 for first in found) > 180
    assert None not in found


@pytest.mark.parametrize(
    "mean",
    [1 + TIME, 1 / (1 + 2 * TIME) ** 2, np.where(TIME < 0.6, 0.0, 1.0), 1 + np.sin(7 * TIME)],
    ids=["rises", "cools", "begins late", "swings"],
)
def test_what_changes_all_along_is_not(mean):
    assert steady_from(noisy(1, mean)) is None


def test_what_settles_is_stationary_from_then_on():
    assert steady_from(noisy(1, 1 + 3 * np.exp(-10 * TIME))) in range(3, 9)


def test_an_end_at_which_nothing_is_left_is_no_stationary_state():
    gone = np.where(TIME < 0.3, 1.0, 0.0)
    assert steady_from(noisy(1, 1.0) * gone) is None
    spans = spans_of(noisy(1, 1.0) * gone)
    assert not spans.stationary
    assert spans.ends[1] < 0.5, "windows are those in which there is something"


def test_before_runs_of_one_start_are_independent_nothing_is_called_stationary():
    assert steady_from(noisy(1, 1.0), least=5) == 5


def test_runs_that_differ_by_rounding_are_alike():
    same = np.tile(1 + TIME, (4, 1))
    assert alike(same)
    assert alike(same * (1 + 1e-13 * np.arange(4)[:, None]))
    assert not alike(same * (1 + 1e-6 * np.arange(4)[:, None])), "the control"


# Errors in windows

LEVELS = 3
NOISE = 0.001
SIGN = np.array([1.0, 1.0, -1.0, -1.0] * 2)
"""Of the noise of 8 runs: none is left in the mean over even ones, nor in that over odd ones."""


WINDOW = np.arange(PIECES) // 2
"""Of each piece: two are a window."""


def speeds(fractions):
    """Runs in which at each level, and in each piece, so many discs are slower: shape (8, pieces)."""
    series = np.repeat(np.asarray(fractions)[:, :, None], LEVELS, axis=2).tolist()
    return [{"speed_distribution": each, "centre": TIME.tolist()} for each in series]


def depths(deep):
    """Eight runs that meet ten pairs in each piece, so deep on average."""
    series = deep + NOISE * SIGN[:, None]
    return [{"overlap": each, "met": [10] * PIECES, "centre": TIME.tolist()} for each in series.tolist()]


def test_speeds_that_are_wrong_to_both_sides_are_wrong_in_a_window():
    """In a gas that cools 0.1 too many slow discs in the first window, 0.1 too few in the last: the mean error is 0."""
    cooling = np.tile(0.3 + 0.4 * TIME, (8, 1))
    wrong = 0.1 * ((WINDOW == 0) * 1.0 - (WINDOW == 7))
    ours = speeds(cooling + wrong + NOISE * SIGN[:, None])
    found = deviations(ours, speeds(cooling), ["speed_distribution"])["speed_distribution"]
    error = math.sqrt(1 + 2 / math.pi) * NOISE / math.sqrt(7)
    assert (found.value, found.error) == (pytest.approx(0, abs=1e-12), pytest.approx(error))
    assert (found.largest.value, found.largest.error) == (pytest.approx(0.1), pytest.approx(error))
    assert found.largest.span in ((0.0, 0.125), (0.875, 1.0))
    assert found.bound < 0.002
    assert not found.inside(0.09), "the mean is inside, a window is seen to be outside"
    assert found.inside(0.1)
    right = speeds(cooling + NOISE * SIGN[:, None])
    fine = deviations(right, speeds(cooling), ["speed_distribution"])["speed_distribution"]
    assert fine.largest.value == pytest.approx(0, abs=1e-12)
    assert fine.inside(0.002), "the control"


def test_speeds_of_a_stationary_gas_are_one_window():
    still = noisy(1, np.full(PIECES, 0.5), NOISE, runs=8)
    found = deviations(speeds(noisy(2, still, NOISE, runs=8)), speeds(still), ["speed_distribution"])
    assert found["speed_distribution"].largest is None


def test_overlaps_that_are_deep_in_one_window_are_seen_there():
    found = deviations(depths(0.08 * (WINDOW == 7)), depths(np.zeros(PIECES)), ["overlap"])["overlap"]
    assert (found.value, found.error) == (pytest.approx(0.01), pytest.approx(NOISE / math.sqrt(7)))
    assert found.largest.value == pytest.approx(0.08)
    assert found.largest.span == (0.875, 1.0)
    assert not found.inside(0.05), "the mean is inside, a window is seen to be outside"
    assert found.inside(0.081)
    even = deviations(depths(np.full(PIECES, 0.01)), depths(np.zeros(PIECES)), ["overlap"])["overlap"]
    assert (even.value, even.largest) == (pytest.approx(0.01), None)
    assert even.inside(0.05), "the control: as deep on average, and all along"


def test_no_window_and_level_is_seen_to_differ_by_being_the_largest_of_many():
    beyond, cooling = 0, (0.3 + 0.4 * TIME)[:, None]
    for seed in range(200):
        rng = np.random.default_rng(seed)
        ours, theirs = (cooling + 0.05 * rng.normal(size=(8, PIECES, LEVELS)) for _ in range(2))
        ours, theirs = ([{"speed_distribution": each, "centre": TIME} for each in runs] for runs in (ours, theirs))
        largest = deviations(ours, theirs, ["speed_distribution"])["speed_distribution"].largest
        beyond += abs(largest.value) > largest.noise
    assert beyond / 200 < 0.085


def test_speeds_are_compared_at_the_same_time():
    """Pieces that end half a piece late in a gas that cools: 0.0125 more discs are slow by then."""
    cooling, ends = 0.3 + 0.4 * TIME, np.arange(1, PIECES + 1) / PIECES
    late = ends + 0.5 / PIECES
    ours = speeds(np.interp(late, TIME, cooling, right=0.7) + NOISE * SIGN[:, None])
    theirs = speeds(np.tile(np.interp(ends, TIME, cooling, right=0.7), (8, 1)))
    assert deviations(ours, theirs, ["speed_distribution"])["speed_distribution"].value > 0.01, "the control"
    for each in ours:
        each["centre"] = ((np.append(0, late[:-1]) + late) / 2).tolist()
    assert abs(deviations(ours, theirs, ["speed_distribution"])["speed_distribution"].value) < 0.001


def test_the_error_of_a_changing_scene_is_the_mean_over_windows_and_the_largest_is_one_of_them():
    """Ten per cent too much in the last quarter of a scene that cools: a fortieth on average, a tenth at most."""
    mean = 1 / (1 + 5 * TIME) ** 2
    wrong = mean * np.where(TIME > 0.75, 1.1, 1.0)
    spread = 0.002 * mean
    ours, theirs = (noisy(seed, 1.0, 1.0) * spread + each for seed, each in ((1, wrong - spread), (2, mean - spread)))
    found = deviations(as_runs(ours), as_runs(theirs), ["pressure"])["pressure"]
    assert found.value == pytest.approx(0.025, abs=4 * found.error)
    assert found.error < 0.002
    assert found.largest.value == pytest.approx(0.1, abs=4 * found.largest.error)
    assert found.largest.span[0] >= 0.75
    assert not found.inside(0.04), "the mean is inside, a window is seen to be outside"
    assert found.inside(0.11)
    assert "largest in a window 0.10" in repr(found)


def test_without_a_difference_the_largest_window_is_not_seen_to_differ():
    mean = 1 / (1 + 5 * TIME) ** 2
    beyond = 0
    for seed in range(200):
        ours, theirs = (mean * noisy(2 * seed + side, 1.0) for side in (0, 1))
        largest = deviations(as_runs(ours), as_runs(theirs), ["pressure"])["pressure"].largest
        beyond += abs(largest.value) > largest.noise
    assert beyond / 200 < 0.085


def test_a_late_end_of_pieces_is_not_taken_for_an_error():
    """A run of long steps ends each piece up to a frame late: here a quarter of a piece, in which 3 % are lost."""
    mean, late = np.exp(-2 * TIME), 0.25
    ours, theirs = noisy(1, 1.0, 1e-4) * mean * np.exp(-2 * late / PIECES), noisy(2, 1.0, 1e-4) * mean
    found = deviations(as_runs(ours, late), as_runs(theirs), ["pressure"])["pressure"]
    assert abs(found.value) < 0.003
    assert deviations(as_runs(ours), as_runs(theirs), ["pressure"])["pressure"].value < -0.025, "the control"


def test_what_settles_is_compared_while_it_does_and_says_from_when_it_is_stationary():
    """As before: the settling did not count, and how much of it did not was a matter of noise."""
    settles = 1 + 3 * np.exp(-10 * TIME)
    wrong = settles * np.where(TIME < 0.25, 0.5, 1.0)
    found = deviations(as_runs(noisy(1, wrong)), as_runs(noisy(2, settles)), ["pressure"])["pressure"]
    assert found.value == pytest.approx(-0.125, abs=0.02)
    assert found.largest is not None
    assert found.largest.value == pytest.approx(-0.5, abs=0.1)
    assert found.span == (0.0, 1.0)
    assert found.steady is not None
    assert 0.15 < found.steady < 0.6


def test_what_few_runs_have_is_no_unit_of_an_error():
    """As before: -0.0062(10), verified, of what one run in ten had."""
    rare = np.zeros((16, PIECES))
    rare[3, 5] = 1.0
    reason = deviations(as_runs(0.99 * rare), as_runs(rare), ["pressure"])["pressure"].reason
    assert reason.startswith("pressure depends on few events in few of the 16 runs of the reference, 0.0039(39)")
    usual = rare + np.random.default_rng(1).uniform(0.5, 1.5, (16, PIECES))
    ours = usual * np.linspace(0.98, 1.0, 16)[:, None]
    assert deviations(as_runs(ours), as_runs(usual), ["pressure"])["pressure"].measurable, "the control"


def test_steps_so_long_that_there_are_fewer_pieces_are_compared_over_all_of_the_run():
    rng = np.random.default_rng(1)
    few = [{"pressure": (1.1 + 0.01 * rng.normal(size=3)).tolist(), "centre": [1 / 6, 0.5, 5 / 6]} for _ in range(8)]
    found = deviations(few, as_runs(noisy(2, 1.0)), ["pressure"])["pressure"]
    assert found.value == pytest.approx(0.1, abs=0.02)
