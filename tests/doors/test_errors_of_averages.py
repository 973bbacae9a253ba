"""Errors in the table of a trade-off study, from runs that are made up: their sizes, and how certain they are.

Most cases say for each run, by the number of its start, what it has found in each of its pieces.
"""

import math
import time

import numpy as np
import pytest
from support.campaign import PIECES, SCENE, TIME, Costs, MadeUp

import mpsim

pytestmark = pytest.mark.compiled

LEVELS = 13
WINDOW = np.arange(PIECES) // 2  # of each piece: two are a window

SIGN = np.array([1.0, 1.0, -1.0, -1.0] * 16)
"""Of the noise of runs: of eight none is left in the mean over even ones, nor in that over odd ones."""


@pytest.fixture(scope="module")
def errors_of(tmp_path_factory):
    """A function of the reference's runs and each candidate's, by number, that returns the errors of each candidate."""
    costs, folder = Costs(tmp_path_factory.mktemp("costs")), tmp_path_factory.mktemp("kept")

    def study(measure, theirs, *ours, replicas=8):
        candidates = [mpsim.Settings(dt=(1 + k) / 1000) for k in range(len(ours))]

        def law(settings, number):
            run = theirs if settings.method == "event" else ours[round(settings.dt * 1000) - 1]
            found = run(number)
            return found if isinstance(found, dict) else {measure: found if np.ndim(found) else np.full(PIECES, found)}

        path = costs.write(folder / "kept.json", candidates, lambda settings: 1 / settings.dt)
        how = {"executor": MadeUp(law), "path": path, "replicas": replicas, **costs.how}
        return [row.errors[measure] for row in mpsim.tradeoff(SCENE, candidates, measures=measure, **how).rows]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(time, "thread_time", time.perf_counter)  # which is quick to read on any machine
        yield study


def random(*seed):
    return np.random.default_rng(seed)


def noisy(seed, mean=1.0, size=0.05):
    """Runs with noise in each piece about a mean that may change along them."""
    return lambda number: mean + size * random(seed, number).normal(size=PIECES)


# --- sizes and standard errors by hand


def test_a_relative_difference_and_its_error_by_hand(errors_of):
    """Runs of the same start are pairs: three of ours, six of theirs, of which three are alone.

    Of X - r Y, with r = X/Y: the variance of x - r y/2 over pairs by 3, and that of the others, r^2 (3/36) var(y).
    """
    x, y = np.array([1.0, 2.0, 3.0]), np.array([4.0, 4.0, 4.0, 8.0, 4.0, 4.0])
    (found,) = errors_of("pressure", lambda n: y[n], lambda n: x[n], replicas=3)
    r = x.mean() / y.mean()
    parts = (x - r * y[:3] / 2).var(ddof=1) / 3, r**2 * 3 / 36 * y.var(ddof=1)
    assert found.value == pytest.approx(r - 1)
    assert found.error == pytest.approx(math.sqrt(sum(parts)) / y.mean())
    assert found.freedom == pytest.approx(sum(parts) ** 2 / (parts[0] ** 2 / 2 + parts[1] ** 2 / 5))  # Welch
    assert (found.span, found.largest) == ((0.0, 1.0), None)


def test_what_a_start_gives_to_both_runs_of_a_pair_cancels(errors_of):
    """Starts that differ by a hundred times the noise: the error is that of the noise. Without pairs it is theirs."""
    start = 10 + random(1).normal(size=40)
    paired, shuffled = errors_of(
        "pressure",
        lambda n: start[n] + 0.01 * random(2, n).normal(size=PIECES),
        lambda n: start[n] + 0.01 * random(3, n).normal(size=PIECES),
        lambda n: start[39 - n] + 0.01 * random(3, n).normal(size=PIECES),
    )
    assert paired.error < shuffled.error / 2
    assert shuffled.error > 0.02, "the control"


def test_pieces_of_one_run_are_no_independent_samples(errors_of):
    """Pieces that are alike, as in a slow gas, or cancel, as sound does: the error is that of the runs."""
    slow, sound = errors_of(
        "energy_drift",
        lambda n: 0.0,
        lambda n: n + 1.0,
        lambda n: np.array([9.0, -7.0] * 8) if n % 2 else np.array([-7.0, 9.0] * 8),
        replicas=3,
    )
    assert (slow.value, slow.error) == (pytest.approx(2), pytest.approx(1 / math.sqrt(3)))
    assert "so that their spread gives no standard error" in sound.reason


def test_overlaps_are_means_over_pairs_and_not_over_pieces(errors_of):
    """Ten pairs at 0.1 and two at 0.4 are 0.15; pieces in which nothing was met say nothing."""
    found, early, never = errors_of(
        "overlap",
        lambda n: 0.0,
        lambda n: {"overlap": (1 + 1e-3 * SIGN[n]) * np.array([0.1, 0.4] * 8), "met": [10, 2] * 8},
        lambda n: {"overlap": 0.3 + 1e-3 * SIGN[n] - 0.3 * (TIME > 0.5), "met": 5 * (TIME < 0.5)},
        lambda n: {"overlap": np.zeros(PIECES), "met": np.zeros(PIECES, int)},
    )
    assert (found.value, early.value) == (pytest.approx(0.15), pytest.approx(0.3))
    assert "no overlap occurred in any run" in never.reason


def test_the_largest_overlap_is_the_largest_of_all_runs_and_its_error_their_scatter(errors_of):
    values = [0.2, 0.4, 0.3]
    (found,) = errors_of(
        "largest_overlap", lambda n: 0.0, lambda n: np.append(np.full(PIECES - 1, 0.1), values[n]), replicas=3
    )
    assert (found.value, found.error) == (pytest.approx(0.4), pytest.approx(0.1))


def test_missed_collisions_are_a_part_of_those_that_should_have_been(errors_of):
    def of(*numbers):
        each = iter(numbers * 8)
        return lambda number: {"collisions": next(each), "trajectory": 0.0}

    found, none = errors_of("missed_collisions", lambda n: {}, of([8, 10], [6, 10]), of([0, 0]))
    assert found.value == pytest.approx(0.3)
    assert found.error == pytest.approx(0.1 / math.sqrt(7))
    assert not none.measurable


@pytest.mark.parametrize(("replicas", "two", "three"), [(8, 2.43, 4.53), (16, 2.18, 3.59)])
def test_errors_of_few_runs_are_known_badly(replicas, two, three, errors_of):
    """Quantiles of Student's t at the probabilities of 2 and 3 normal standard errors, from its tables."""
    error = math.sqrt(1 / (replicas - 1))

    def about(ratio):
        return lambda n: ratio * error + (-1) ** n

    near, beyond = errors_of("energy_drift", lambda n: 0.0, about(0.98 * three), about(1.02 * three), replicas=replicas)
    assert near.error == pytest.approx(error)
    assert near.noise == pytest.approx(two * error, rel=0.01)
    assert (near.resolved, beyond.resolved) == (False, True)
    assert (near.bound, near.magnitude) == (pytest.approx(near.value + near.noise), pytest.approx(near.bound))
    assert beyond.magnitude == beyond.value
    assert repr(near).endswith(" (not resolved)")
    assert "resolved" not in repr(beyond)


def test_two_runs_say_so(errors_of):
    (found,) = errors_of("energy_drift", lambda n: 0.0, lambda n: 5 + 0.1 * (-1) ** n, replicas=2)
    assert repr(found) == "5.00(10) (not resolved: with so few runs, 831 standard errors are needed)"


# --- what is no number


@pytest.mark.parametrize(
    ("name", "theirs", "words"),
    [
        ("collision_rate", lambda n: 0.0, "is 0 in all 16 runs of the reference"),
        ("pressure", lambda n: 1.5 + 1e-12 * n, "is the same in all 16 runs of the reference"),  # but for rounding
        ("momentum_drift", lambda n: 0.0, "the error of momentum_drift is 0 in all runs"),
        ("energy_drift", lambda n: 0.0, "all runs are those of the reference, to the bit"),
    ],
)
def test_what_has_no_size_or_no_spread_is_no_number(name, theirs, words, errors_of):
    (found,) = errors_of(name, theirs, theirs if name.endswith("drift") else noisy(1, size=0.5))
    assert words in found.reason
    assert (found.measurable, found.inside(1e9)) == (False, False), "no budget is met by it"
    assert repr(found).startswith("not measurable: ")


def test_what_few_runs_have_is_no_unit_of_an_error(errors_of):
    """It was -0.0062(10), verified, of what one run in ten had."""
    rare = np.zeros((32, PIECES))
    rare[3, 5] = 1.0
    (found,) = errors_of("pressure", lambda n: rare[n], lambda n: 0.99 * rare[n], replicas=16)
    assert found.reason.startswith("pressure depends on few events in few of the 32 runs of the reference, 0.0020(20)")
    usual = rare + random(1).uniform(0.5, 1.5, (32, PIECES))
    (control,) = errors_of("pressure", lambda n: usual[n], lambda n: usual[n] * (0.98 + n / 900), replicas=16)
    assert control.measurable


# --- as many errors are beyond their noise as they say


def beyond(errors):
    """Parts of errors without any difference beyond their noise, and resolved."""
    return np.mean([[abs(each.value) > each.noise, each.resolved] for each in errors], axis=0)


def many(errors_of, measure, draw, studies=2, of_each=30):
    """Errors of candidates that are no worse than the reference: `draw` is called with a seed and a number."""
    found = []
    for study in range(studies):
        laws = [lambda n, seed=(study, k): draw(seed, n) for k in range(1 + of_each)]
        found += errors_of(measure, *laws)
    return found


def test_one_error_in_twenty_is_beyond_its_noise_and_hardly_one_is_resolved(errors_of):
    two, three = beyond(many(errors_of, "pressure", lambda seed, n: 5 + random(*seed, n).normal(size=PIECES)))
    assert 0.02 < two < 0.09
    assert three < 0.02


def test_the_largest_of_thirteen_differences_is_no_difference_by_being_the_largest(errors_of):
    """The chosen one is measured by runs that did not choose it."""
    shape = random(3).normal(size=(LEVELS, LEVELS))

    def draw(seed, n):
        return random(*seed, n).normal(size=(PIECES, LEVELS)) @ shape

    two, three = beyond(many(errors_of, "speed_distribution", draw, of_each=20))
    assert two < 0.11
    assert three < 0.03

    def naive(table):  # the largest, with its own error, is seen too often
        ours, theirs = (np.array([draw((99 + side, table), n).mean(axis=0) for n in range(8)]) for side in (0, 1))
        difference = (ours - theirs).mean(axis=0)
        return np.abs(difference / (ours - theirs).std(axis=0, ddof=1) * math.sqrt(8)).max() > 2.43

    assert np.mean([naive(table) for table in range(40)]) > 0.15, "the control"


# --- scenes that change with time


def test_noise_is_stationary_nineteen_times_in_twenty(errors_of):
    found = errors_of("overlap", lambda n: 0.0, *(noisy(seed) for seed in range(20)), replicas=16)
    assert sum(each.largest is None for each in found) >= 18


SETTLES, BEGINS = 1 + 3 * np.exp(-10 * TIME), 1 + 0.11 * (TIME < 1 / PIECES)
LATE, ENDS = np.where(TIME < 0.6, 0.0, 1.0), np.where(TIME < 0.3, 1.0, 0.0)


@pytest.mark.parametrize(
    "mean",
    [1 + TIME, LATE, 1 + np.sin(7 * TIME), SETTLES, BEGINS, ENDS],
    ids=["rises", "begins late", "swings", "settles", "begins otherwise", "ends"],
)
def test_what_changes_is_compared_in_windows(mean, errors_of):
    size = 0.1 * (mean if mean is ENDS else 1)  # after its end there is no noise either
    (found,) = errors_of("pressure", noisy(1, mean, size), noisy(2, mean, size), replicas=16)
    if mean is SETTLES:
        assert 0.15 < found.steady < 0.6
    else:
        assert found.steady == (1 / PIECES if mean is BEGINS else None)
    if mean is ENDS:
        assert found.span[1] < 0.5, "windows in which there is something"
    else:
        assert found.largest is not None


def test_a_wrong_end_counts_as_the_mean_over_windows_and_the_largest_is_one_of_them(errors_of):
    """Ten per cent too much in the last quarter of a scene that cools: a fortieth on average, a tenth at most."""
    mean = 1 / (1 + 5 * TIME) ** 2
    wrong = mean * np.where(TIME > 0.75, 1.1, 1.0)
    (found,) = errors_of(
        "pressure", lambda n: mean * noisy(1, size=0.002)(n), lambda n: wrong * noisy(2, size=0.002)(n), replicas=16
    )
    assert found.value == pytest.approx(0.025, abs=4 * found.error)
    assert found.error < 0.002
    assert found.largest.value == pytest.approx(0.1, abs=4 * found.largest.error)
    assert found.largest.span[0] >= 0.75
    assert not found.inside(0.04), "the mean is inside, a window is seen to be outside"
    assert found.inside(0.11)
    assert "largest in a window 0.1" in repr(found)


def slower(fractions):
    """At each level, and in each piece, so many discs are slower."""
    return np.repeat(np.asarray(fractions)[:, None], LEVELS, axis=1)


def test_speeds_that_are_wrong_to_both_sides_are_wrong_in_a_window(errors_of):
    """In a gas that cools 0.1 too many slow discs in the first window, 0.1 too few in the last: the mean error is 0."""
    cooling = 0.3 + 0.4 * TIME
    wrong = cooling + 0.1 * ((WINDOW == 0) * 1.0 - (WINDOW == 7))
    found, fine = errors_of(
        "speed_distribution",
        lambda n: slower(cooling),
        lambda n: slower(wrong + 0.001 * SIGN[n]),
        lambda n: slower(cooling + 0.001 * SIGN[n]),
    )
    error = math.sqrt(1 + 2 / math.pi) * 0.001 / math.sqrt(7)
    assert (found.value, found.error) == (pytest.approx(0, abs=1e-12), pytest.approx(error))
    assert (found.largest.value, found.largest.error) == (pytest.approx(0.1), pytest.approx(error))
    assert found.largest.span in ((0.0, 0.125), (0.875, 1.0))
    assert (found.inside(0.09), found.inside(0.1)) == (False, True)
    assert fine.largest.value == pytest.approx(0, abs=1e-12)
    assert fine.inside(0.002), "the control"


def test_pieces_that_end_late_are_compared_at_the_same_time(errors_of):
    """A run of long steps ends each piece up to a frame late: here a quarter of a piece, in which 3 % are lost."""
    mean, late = np.exp(-2 * TIME), 0.25

    def lost(n):
        return mean * noisy(1, size=1e-4)(n) * np.exp(-2 * late / PIECES)

    told, untold = errors_of(
        "pressure",
        lambda n: mean * noisy(2, size=1e-4)(n),
        lambda n: {"pressure": lost(n), "centre": TIME + late / PIECES},
        lost,
        replicas=16,
    )
    assert abs(told.value) < 0.003
    assert untold.value < -0.025, "the control"
