"""Windows along the duration of a scene, and the stationary part of it."""

import numpy as np
import pytest

from mpsim.measure.deviations import deviations
from mpsim.measure.windows import alike, spans_of, steady_from

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


def test_a_stationary_part_is_one_window_and_says_from_when():
    settles = 1 + 3 * np.exp(-10 * TIME)
    found = deviations(as_runs(noisy(1, settles)), as_runs(noisy(2, settles)), ["pressure"])["pressure"]
    assert found.largest is None
    assert 0.15 < found.span[0] < 0.6
    assert found.span[1] == 1


def test_steps_so_long_that_there_are_fewer_pieces_are_compared_over_all_of_the_run():
    rng = np.random.default_rng(1)
    few = [{"pressure": (1.1 + 0.01 * rng.normal(size=3)).tolist(), "centre": [1 / 6, 0.5, 5 / 6]} for _ in range(8)]
    found = deviations(few, as_runs(noisy(2, 1.0)), ["pressure"])["pressure"]
    assert found.value == pytest.approx(0.1, abs=0.02)
