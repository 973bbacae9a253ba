"""From runs to errors: are the stated standard errors those with which results really scatter?"""

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from support.scenes import gas

import mpsim
from mpsim import Settings
from mpsim.measure.registry import LONG
from mpsim.studies.cost import CHUNKS, RESTARTS, measure
from mpsim.studies.deviations import Deviation, deviations, short_deviations
from mpsim.studies.ensemble import Ensemble
from mpsim.studies.replicas import long_run, quietly

PAIRED = ["pressure", "collision_rate", "speed_distribution"]
"""Measures whose noise is that of many collisions. The energy drift of the exact solver is a handful of roundings,
far from normal, and has no part in this."""


def runs(**series):
    """What runs give, from arrays whose axis 0 is the runs."""
    length, pieces = np.shape(next(iter(series.values())))[:2]
    centre = ((np.arange(pieces) + 0.5) / pieces).tolist()
    return [
        {name: np.asarray(values[index]).tolist() for name, values in series.items()} | {"centre": centre}
        for index in range(length)
    ]


def test_a_relative_difference_and_its_error_by_hand():
    """Pairs 1, 2, 3 of ours and 4, 4, 4 of theirs, and 8 alone: x - 3 y / 4 has variance 1 of 3, y variance 4.

    2 / 5 - 1 = -3/5. Error: sqrt(var(x - (2/5)(3/4) y) / 3 + (2/5)^2 4 / 16) / 5, theirs scaled by the ratio 2/5.
    """
    ours, theirs = runs(pressure=[[1], [2], [3]]), runs(pressure=[[4], [4], [4], [8]])
    found = deviations(ours, theirs, ["pressure"])["pressure"]
    assert found.value == pytest.approx(-3 / 5)
    parts = 1 / 3, 0.4**2 * 4 / 16
    assert found.error == pytest.approx(math.sqrt(sum(parts)) / 5)
    assert found.freedom == pytest.approx(sum(parts) ** 2 / (parts[0] ** 2 / 2 + parts[1] ** 2 / 3))  # Welch


def test_what_a_start_gives_to_both_runs_of_a_pair_cancels():
    """Starts that differ by a hundred times the noise: the error is that of the noise. Without pairs it is theirs."""
    rng = np.random.default_rng(1)
    start, noise = 10 + rng.normal(size=(16, 1)), 0.01 * rng.normal(size=(2, 16, 8))
    found = deviations(runs(pressure=start + noise[0]), runs(pressure=start + noise[1]), ["pressure"])["pressure"]
    assert found.error < 0.002
    shuffled = deviations(runs(pressure=start[::-1] + noise[0]), runs(pressure=start + noise[1]), ["pressure"])
    assert shuffled["pressure"].error > 5 * found.error, "the control"


def test_pieces_of_one_run_are_no_independent_samples():
    """Pieces that are all alike, as in a slow gas, or cancel, as sound does: the error is that of the runs."""
    slow = runs(energy_drift=[[1.0] * 16, [2.0] * 16, [3.0] * 16])
    sound = runs(energy_drift=[[9.0, -7.0] * 8, [-7.0, 9.0] * 8, [9.0, -7.0] * 8])
    nothing = runs(energy_drift=[[0.0] * 16] * 4)
    assert deviations(slow, nothing, ["energy_drift"])["energy_drift"].error == pytest.approx(1 / math.sqrt(3))
    assert (
        "so that their spread gives no standard error"
        in deviations(sound, nothing, ["energy_drift"])["energy_drift"].reason
    )


def test_mean_overlaps_count_pairs_and_not_pieces():
    """Ten pairs at 0.1 and two at 0.4 are 0.15; pieces in which nothing was met say nothing."""
    found = runs(overlap=[[0.1, 0.0], [0.0, 0.4]], met=[[10, 0], [0, 2]])
    assert deviations(found, found, ["overlap"])["overlap"].value == pytest.approx(0.15)
    never = runs(overlap=[[0.0], [0.0]], met=[[0], [0]])
    assert "no overlaps occurred in any run" in deviations(never, never, ["overlap"])["overlap"].reason


def test_the_largest_overlap_is_the_largest_of_all_runs_and_its_error_their_scatter():
    found = runs(largest_overlap=[[0.1, 0.2], [0.4, 0.1], [0.3, 0.3]])
    largest = deviations(found, found, ["largest_overlap"])["largest_overlap"]
    assert (largest.value, largest.error) == (pytest.approx(0.4), pytest.approx(0.1))


@pytest.mark.parametrize(
    ("name", "reference", "words"),
    [
        ("collision_rate", [[0.0] * 16] * 8, "is 0 in all 8 runs of the reference"),
        ("pressure", [[1.0, 2.0] * 8] * 8, "is the same in all 8 runs of the reference"),
        ("pressure", [[1.0, 2.0 + 1e-12 * run] * 8 for run in range(8)], "is the same in all 8 runs"),  # rounding
        ("momentum_drift", [[0.0] * 16] * 8, "the error of momentum_drift is 0 in all runs"),
        ("energy_drift", [[0.0] * 16] * 8, "all runs are those of the reference"),
    ],
)
def test_what_has_no_size_or_no_spread_in_the_reference_is_no_number(name, reference, words):
    rng = np.random.default_rng(1)
    zero = name.endswith("drift")
    found = deviations(
        runs(**{name: reference if zero else 1 + rng.normal(size=(8, 16))}), runs(**{name: reference}), [name]
    )
    assert words in found[name].reason
    assert not found[name].measurable
    assert not found[name].inside(1e9), "no budget is met by it"
    assert repr(found[name]).startswith("not measurable: ")
    moving = 1 + 0.1 * rng.normal(size=(8, 16))
    assert deviations(runs(**{name: moving}), runs(**{name: moving[::-1]}), [name])[name].measurable, "the control"


def test_missed_collisions_are_a_part_of_those_that_should_have_been():
    found = short_deviations([{"collisions": [8, 10]}, {"collisions": [6, 10]}], ["missed_collisions"])
    assert found["missed_collisions"].value == pytest.approx(0.3)
    assert found["missed_collisions"].error == pytest.approx(0.1)
    none = short_deviations([{"collisions": [0, 0]}] * 2, ["missed_collisions"])["missed_collisions"]
    assert not none.measurable


def test_errors_of_few_runs_are_known_badly():
    """Quantiles of Student's t at the probabilities of 2 and 3 normal standard errors, from its tables."""
    for freedom, two, three in ((7, 2.43, 4.53), (15, 2.18, 3.59), (31, 2.08, 3.26)):
        assert Deviation(0, 1, freedom).noise == pytest.approx(two, rel=0.01)
        assert not Deviation(three * 0.98, 1, freedom).resolved
        assert Deviation(three * 1.02, 1, freedom).resolved
    assert Deviation(0, 1, 1).noise > 13.9, "two runs: t has one degree of freedom, and is too large if anything"
    assert not Deviation(3, 1).resolved
    assert Deviation(3.01, 1).resolved


def exceeding(draw, name, tables=400):
    """Part of tables without any difference that show one of twice, and thrice, its standard error."""
    beyond = [0, 0]
    for _ in range(tables):
        found = deviations(draw(8), draw(16), [name])[name]
        beyond[0] += abs(found.value) > found.noise
        beyond[1] += found.resolved
    return beyond[0] / tables, beyond[1] / tables


def test_of_tables_without_any_difference_one_in_twenty_exceeds_two_errors_and_hardly_one_three():
    rng = np.random.default_rng(1)
    assert 0.025 < exceeding(lambda count: runs(pressure=5 + rng.normal(size=(count, 16))), "pressure")[0] < 0.085
    assert exceeding(lambda count: runs(pressure=5 + rng.normal(size=(count, 16))), "pressure")[1] < 0.0125


@pytest.mark.parametrize("modes", [1, 13])
def test_the_largest_of_thirteen_differences_is_no_difference_by_being_the_largest(modes):
    """Levels that move together, or each for itself: the chosen one is measured by runs that did not choose it."""
    rng, shape = np.random.default_rng(2), np.random.default_rng(3).normal(size=(modes, 13))

    def draw(count):
        return runs(speed_distribution=rng.normal(size=(count, 4, modes)) @ shape)

    two, three = exceeding(draw, "speed_distribution")
    assert two < 0.085
    assert three < 0.0125

    def naively(count):
        ours, theirs = (np.array([each["speed_distribution"] for each in draw(n)]).mean(axis=1) for n in (8, 16))
        difference = ours.mean(axis=0) - theirs.mean(axis=0)
        errors = np.hypot(ours.std(axis=0, ddof=1) / math.sqrt(8), theirs.std(axis=0, ddof=1) / 4)
        worst = np.abs(difference).argmax()
        return abs(difference[worst]) > 2 * errors[worst]

    control = np.mean([naively(8) for _ in range(200)])
    assert control > 0.12 or modes == 1, "the control: the largest, with its own error, is seen too often"


def test_a_real_difference_of_distributions_has_its_size_and_is_resolved():
    rng = np.random.default_rng(4)
    bump = np.sin(np.linspace(0, 2 * np.pi, 13))  # as large above as below: halves may choose opposite lobes
    found = deviations(
        runs(speed_distribution=0.5 + 0.1 * bump + 0.01 * rng.normal(size=(8, 4, 13))),
        runs(speed_distribution=0.5 + 0.01 * rng.normal(size=(16, 4, 13))),
        ["speed_distribution"],
    )["speed_distribution"]
    assert found.value == pytest.approx(0.1, abs=3 * found.error)
    assert found.resolved


def coverage(scene, until, tables):
    """value / noise of each measure, of many tables of the exact solver against itself, at other starts."""
    run = Ensemble(scene, until, tuple(LONG), replicas=8)
    with quietly(), ThreadPoolExecutor(2) as threads:
        made = list(
            threads.map(
                lambda number: long_run(run.starts[number], run.preliminary.reference, run.plan),
                range(1, 24 * tables + 1),
            )
        )
    found = {name: [] for name in PAIRED}
    for start in range(0, len(made), 24):
        for name, each in deviations(made[start : start + 8], made[start + 8 : start + 24], PAIRED).items():
            found[name].append(2 * each.value / each.noise if each.noise else 0.0)
    return {name: np.array(values) for name, values in found.items()}


def assert_honest(found):
    """Scatter of value over stated error near 1, with room for the chance of so few tables."""
    for name, values in found.items():
        room = 3 / math.sqrt(2 * len(values))
        assert values.std() < 1 + room, f"{name} scatters by {values.std():.2f} of its stated errors"
        if name in ("pressure", "collision_rate"):
            assert values.std() > 1 - room, f"{name}: stated errors are too large, it scatters by {values.std():.2f}"


@pytest.mark.long
def test_results_scatter_by_their_stated_errors():
    """Pieces taken as samples gave 0.36 for the pressure, and 1.98 for the distribution of speeds."""
    assert_honest(coverage(gas(50, 0.3), 20, 24))


@pytest.mark.long
@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    ("scene", "until"),
    [
        (gas(100, 0.3), 30),
        (gas(100, 0.7), 20),
        (gas(100, 0.3, restitution=0.95), 20),
        (gas(100, 0.3, gravity=(0, -1)), 30),
        (gas(1000, 0.3), 15),
    ],
    ids=["gas", "dense", "cooling", "gravity", "many"],
)
def test_results_scatter_by_their_stated_errors_in_every_gas(scene, until):
    assert_honest(coverage(scene, until, 60))


def test_short_runs_are_timed_without_starting_workers_a_thousand_times(monkeypatch):
    """A run of five frames of some microseconds is over thousands of times before caches are warm."""
    started, make = [], mpsim.Simulation
    monkeypatch.setattr("mpsim.studies.cost.Simulation", lambda *given: started.append(1) or make(*given))
    found = measure(gas(4, 0.1), Settings(dt=0.2, method="naive"), 1.0)
    assert found["low"] <= found["median"] <= found["high"]
    assert len(started) <= RESTARTS + CHUNKS, "one start for each timed piece, and few more"


def test_what_is_not_resolved_says_how_many_standard_errors_few_runs_need():
    assert repr(Deviation(0.04, 0.01)) == "0.040(10)"
    assert repr(Deviation(0.004, 0.01)) == "0.004(10) (not resolved)"
    few = "not resolved: with so few runs, 831 standard errors are needed"
    assert repr(Deviation(0.00846, 0.00036, freedom=1)) == f"0.00846(36) ({few})"
