"""The cheapest settings inside budgets: found where errors and costs are known, verified by new runs, or refused."""

import dataclasses
import time
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.campaign import PIECES, SCENE, Costs, MadeUp

import mpsim
from mpsim import Settings, tune

pytestmark = pytest.mark.compiled

EVENT = Settings(method="event")
IMPACT, TWICE, PUSH = FAMILIES = [
    Settings(on_fast="substep", **each) for each in ({}, {"passes": 2}, {"contact": "push"})
]
LAWS = {IMPACT: (10.0, 2.0, 1.0), TWICE: (5.0, 2.0, 2.0), PUSH: (1.0, 1.0, 0.9)}
"""Family -> a, p, c: an error of a dt^p diameters, and a cost of c / dt."""

STEPS = sorted({float(f"{step:.2g}") for step in np.geomspace(0.0004, 0.6, 4000)})
CANDIDATES = [EVENT, *(dataclasses.replace(family, dt=step) for family in FAMILIES for step in STEPS)]
FIRST_TO_VERIFY = 128  # number of starts from which on they belong to verifications, and in each of them


def family_of(chosen):
    return next(each for each in FAMILIES if (each.contact, each.passes) == (chosen.contact, chosen.passes))


@pytest.fixture(scope="module")
def costs(tmp_path_factory):
    return Costs(tmp_path_factory.mktemp("costs"))


@pytest.fixture(scope="module")
def ask(costs, tmp_path_factory):
    """`tune` where errors and costs are those of laws; returns the answer, and puts the runs it asked for in `runs`."""

    folder = tmp_path_factory.mktemp("kept")

    def asked(max_error, candidates=(EVENT, *FAMILIES), laws=LAWS, exact=1000.0, noise=1e-9, verified=1.0, law=None,
              **how):  # fmt: skip
        def price(each):
            return exact if each.method == "event" else (LAWS | laws)[family_of(each)][2] / each.dt

        def found(each, number):
            if each.method == "event":
                return {"overlap": np.zeros(PIECES), "pressure": np.full(PIECES, 1 + 1e-6 * (number % 2))}
            factor, order, _ = laws[family_of(each)]
            error = factor * each.dt**order * (verified if number >= FIRST_TO_VERIFY else 1.0)
            error += (error * 1e-7 + 4 * noise) * (-1) ** number
            return {"overlap": np.full(PIECES, error), "pressure": np.full(PIECES, 1 + error)}

        tables = how.pop("costs", costs)
        known = [each for each in CANDIDATES if each == EVENT or family_of(each) in candidates]
        path = tables.write(folder / "kept.json", known, price)
        made = MadeUp(law or found)
        asked.runs = made.asked
        return tune(SCENE, max_error, candidates=candidates, executor=made, path=path, **tables.how | how)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(time, "thread_time", time.perf_counter)  # which is quick to read on any machine
        yield asked


@pytest.fixture(scope="module")
def usual(ask):
    """The answer for overlaps of a hundredth of a diameter."""
    return ask({"overlap": 0.01})


def best_of(budget, laws, exact=1000.0):
    """The least cost inside the budget, by the law itself."""
    prices = [price / min((budget / factor) ** (1 / order), 0.5) for factor, order, price in laws.values()]
    return min([*prices, exact])


# --- the search


ANY_LAWS = st.tuples(*[st.tuples(st.floats(-1, 2), st.floats(0.8, 3.5), st.floats(0.3, 3))] * 3)


def test_whatever_the_laws_nothing_outside_is_given_and_nothing_much_cheaper_is_inside(ask, request):
    @settings(max_examples=120 if request.config.getoption("--long") else 3)
    @given(st.floats(-4, -0.5), ANY_LAWS)
    def check(log_budget, drawn):
        budget = 10**log_budget
        laws = {key: (10**factor, order, price) for key, (factor, order, price) in zip(FAMILIES, drawn, strict=True)}
        found = ask({"overlap": budget}, laws=laws)
        assert found.settings.method == "event" or found.errors["overlap"].bound <= budget
        least = best_of(budget, laws)
        assert least * (1 - 1e-6) <= found.cost.median <= 1.3 * least

    check()


def test_every_budget_is_met_and_the_tightest_decides(ask):
    found = ask({"overlap": 0.1, "pressure": 0.001})
    assert found.budgets == {"overlap": 0.1, "pressure": 0.001}
    assert all(each.bound <= found.budgets[name] for name, each in found.errors.items())
    assert best_of(0.001, LAWS) <= found.cost.median <= 1.25 * best_of(0.001, LAWS)


def test_the_exact_solver_is_the_answer_where_it_is_cheapest(ask):
    found = ask({"overlap": 0.01}, exact=0.5)
    assert (found.settings, found.cost.median) == (EVENT, 0.5)
    assert (found.verified, found.exact) == (False, True)
    assert "overlap: 0 (the reference itself), budget 0.01 (exact)" in str(found)
    assert "verified" not in str(found)


def test_errors_count_with_their_noise(ask):
    noisy = ask({"overlap": 0.01}, [PUSH], noise=0.003)
    assert noisy.settings.dt < 0.9 * 0.01 / 1.2, "it would be 0.01 at most, and not much less, without noise"
    assert noisy.errors["overlap"].bound <= 0.01
    with pytest.raises(mpsim.errors.BudgetError):
        ask({"overlap": 0.01}, [PUSH], noise=0.02)


@pytest.mark.parametrize(("noise", "replicas"), [(0.002, 64), (1e-9, 16)])
def test_replicas_are_doubled_where_noise_leaves_it_undecided(noise, replicas, ask):
    found = ask({"overlap": 0.01}, [PUSH], noise=noise)
    numbers = {number for chosen, number in ask.runs if chosen.method != "event" and number < FIRST_TO_VERIFY}
    assert numbers == set(range(replicas))
    assert (0.01 / 1.2 < found.settings.dt <= 0.01) == (noise < 1e-3), "and the answer is finer"


# --- the answer


def test_the_answer_says_what_was_tried_what_it_costs_and_against_what(usual):
    found = usual
    text = str(found)
    cheaper = [each for each in found.tried if each.cost.median < found.cost.median]
    assert cheaper
    assert text.splitlines()[0].startswith("auto impact dt=0.0")
    for each in cheaper:
        assert not each.inside
        assert "outside 0.01, two standard errors included" in each.verdict
        assert f"{each.label}, {each.cost.median:.3g} ns: {each.verdict}" in text
    assert "budget 0.01 (verified with new runs)" in text
    assert text.endswith("errors against the exact solver; runs of 10")
    assert (found.verified, found.exact, found.until) == (True, False, 10)
    assert "warns" not in text


def test_a_candidate_that_cannot_run_is_named(ask):
    def law(each, number):
        return {"failure": "push failed"} if each.contact == "push" else {"overlap": [each.dt * (1 + number * 1e-6)]}

    def of_16(each, number):
        return {name: values if name == "failure" else values * PIECES for name, values in law(each, number).items()}

    assert "auto push dt=0.1 failed: push failed" in str(ask({"overlap": 0.01}, [IMPACT, PUSH], law=of_16))
    with pytest.raises(mpsim.errors.BudgetError, match=r"no candidate could run.*auto push dt=0.1: push failed"):
        ask({"overlap": 0.1}, [PUSH], law=of_16)


# --- the verification


def test_an_answer_that_fails_its_verification_is_not_given(ask, usual):
    found = ask({"overlap": 0.01}, verified=1.2)
    assert found.errors["overlap"].value <= 0.01
    failed = [each for each in found.tried if "when verified" in each.verdict]
    assert failed
    assert not any(each.inside for each in failed)
    assert usual.cost.median < found.cost.median


def test_where_all_fail_it_the_exact_solver_is_left_or_the_refusal_says_so(ask):
    assert ask({"overlap": 0.01}, verified=1e9).settings == EVENT
    verifying = sorted({number // FIRST_TO_VERIFY for _, number in ask.runs})
    assert verifying == list(range(len(verifying))), "starts of their own for each verification, 128 beside another"
    assert len(verifying) > 2
    with pytest.raises(mpsim.errors.BudgetError, match=r"no candidate stays inside overlap 0\.01\. .* reaches overlap"):
        ask({"overlap": 0.01}, [IMPACT], verified=1e9)


def test_it_ends_with_its_time(ask, monkeypatch):
    """Each run takes eight seconds: there is time for the first candidate, and for its verification."""
    clock = SimpleNamespace(now=0.0)

    def law(each, number):
        clock.now += 8.0
        return {"overlap": [0.0 if each.method == "event" else each.dt * (1 + 1e-6 * number)] * PIECES}

    monkeypatch.setattr(time, "monotonic", lambda: clock.now)
    found = ask({"overlap": 0.5}, [PUSH], law=law)
    assert found.verified
    assert len(found.tried) == 1
    monkeypatch.undo()
    assert len(ask({"overlap": 0.5}, [PUSH]).tried) > 1, "the control"


# --- refusals


def test_a_budget_out_of_reach_is_refused_with_the_least_that_is_not(ask):
    with pytest.raises(mpsim.errors.BudgetError) as refusal:
        ask({"overlap": 1e-9}, [IMPACT, PUSH])
    text = str(refusal.value)
    assert "no candidate stays inside overlap 1e-09" in text
    assert "auto impact dt=0.0005, reaches overlap 2.5e-06" in text  # 10 x 0.0005^2
    assert "Allow these errors; where the noise is what is left, run longer" in text


@pytest.mark.parametrize(
    ("measure", "values", "words"),
    [
        ("overlap", {"met": [0] * PIECES}, "overlap is not measurable here: no collisions occurred in any of 32 runs"),
        ("pressure", {"pressure": [0.0] * PIECES}, r"pressure is 0 in all 32 runs.*longer runs \(until=\.\.\.\)"),
        ("pressure", {"pressure": [2.0] * PIECES}, r"pressure is the same in all 32 runs.*other starts"),
    ],
)
def test_what_the_reference_cannot_measure_is_refused_before_anything_is_tried(measure, values, words, ask):
    def law(each, number):
        return {"overlap": [0.1] * PIECES} | values

    with pytest.raises(mpsim.errors.NotMeasurableError, match=words):
        ask({measure: 0.01}, law=law)
    assert {each.method for each, _ in ask.runs} == {"event"}


def test_a_measure_that_means_nothing_in_any_run_is_not_a_budget_out_of_reach(ask):
    def law(each, number):
        return {"overlap": [0.0] * PIECES, "met": [10 * (each.method == "event")] * PIECES}

    with pytest.raises(mpsim.errors.NotMeasurableError, match=r"overlap is not measurable here: no overlap occurred"):
        ask({"overlap": 0.01}, [IMPACT, PUSH], law=law)
    assert len({each for each, _ in ask.runs}) == 3, "no search goes on for it"


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"max_error": {"presure": 0.01}}, "max_error must be one of .*Did you mean 'pressure'"),
        ({"max_error": {"pressure": 0}}, r"max_error\['pressure'\] must be a finite number > 0"),
        ({"max_error": {"pressure": 2}}, r"max_error\['pressure'\] must be less than 1, .*got 2. 2 % is 0.02\."),
        ({"candidates": ["grid"]}, r"candidates\[0\] must be an mpsim.Settings; got str"),
    ],
)  # fmt: skip
def test_a_wrong_argument_is_refused_by_name(arguments, text):
    with pytest.raises(mpsim.InputError, match=text):
        tune(**({"scene": SCENE, "max_error": {"pressure": 0.01}} | arguments))
