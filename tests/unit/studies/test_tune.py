"""The chooser: the cheapest settings inside budgets, found where errors are known, verified, and refused by name."""

import dataclasses
import math
import time
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.scenes import gas

import mpsim
from mpsim import Settings, tune
from mpsim.studies import cost, ensemble
from mpsim.studies import tune as chooser
from mpsim.studies.cost import Cost
from mpsim.studies.default_candidates import families
from mpsim.studies.deviations import Deviation
from mpsim.studies.ensemble import CandidateFailed

SCENE = gas(20, 0.3)
EVENT, (IMPACT, TWICE, PUSH) = Settings(method="event"), families()
LAWS = {("impact", 1): (10.0, 2.0, 1.0), ("impact", 2): (5.0, 2.0, 2.0), ("push", 1): (1.0, 1.0, 0.9)}
"""(contact, passes) -> a, p, c: an error of a dt^p, and a cost of c / dt."""


class Fake:
    """A campaign whose errors and costs are laws, so that the best step is known; runs of verification are worse."""

    laws = LAWS
    noise, verified, exact_cost, event = 1e-9, 1.0, 1000.0, True
    fails: frozenset[str] = frozenset()
    seconds, unmeasurable, warning, number, reason = 0.0, "", "", None, ""
    now = 0.0
    announced = ""
    firsts: list[int] = []  # noqa: RUF012

    def __init__(self, scene, until, measures, *, replicas, seconds, **_):
        reference = EVENT if self.event else Settings(dt=1e-4)
        self.preliminary = SimpleNamespace(
            thermal_velocity=1.0, reference=reference, reference_name="a law", exact=self.event,
            contact_time=None,
            is_reference=lambda settings: self.event and settings.method == "event",
        )  # fmt: skip
        self.starts = SimpleNamespace(name="starts of a law", number=self.number)
        self.plan = SimpleNamespace(until=10.0)
        self.replicas, self.measures, self.assessed, self.timed = replicas, measures, [], []

    def seconds_for(self, settings, replicas, verify=False):
        return self.seconds * replicas

    def framed(self, settings):
        return settings

    def announce(self, text):
        assert not self.assessed, "before anything is run"
        Fake.announced = text

    def demand_measurable(self, budgets):
        if self.unmeasurable:
            raise mpsim.errors.NotMeasurableError(self.unmeasurable)

    def warning_of(self, settings):
        return self.warning

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        pass

    def assess(self, candidates, replicas=None, first=0):
        Fake.now += self.seconds * (replicas or self.replicas) * len(candidates)
        self.assessed += [(each, first) for each in candidates]
        Fake.firsts.append(first)

    def time(self, candidates):
        self.timed += list(candidates)

    def errors(self, settings, replicas=None, first=0):
        assert (settings, first) in self.assessed, "errors are asked of runs that were made"
        if settings.contact in self.fails or (settings.method == "event" and not self.event):
            raise CandidateFailed(f"{settings.contact} failed")
        noise = self.noise / math.sqrt((replicas or self.replicas) / 16)
        if settings.method == "event":
            return dict.fromkeys(self.measures, Deviation(0.0, 0.0))
        if self.reason:
            return dict.fromkeys(self.measures, Deviation.unknown(self.reason))
        factor, order, _ = self.laws[settings.contact, settings.passes]
        error = factor * settings.dt**order * (self.verified if first else 1.0)
        return dict.fromkeys(self.measures, Deviation(error, noise))

    def cost(self, settings):
        assert settings in self.timed
        price = (
            self.exact_cost
            if settings.method == "event"
            else self.laws[settings.contact, settings.passes][2] / settings.dt
        )
        return Cost(price, price, price, 100, "grid", 1)


def faked(max_error, **laws):
    """`tune` on a fake campaign with these laws."""
    candidates = laws.pop("candidates", None)
    clock = SimpleNamespace(monotonic=lambda: Fake.now)
    Fake.now, Fake.firsts = 0.0, []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(chooser, "Ensemble", type("Faked", (Fake,), laws))
        patch.setattr(chooser, "time", clock)
        return tune(SCENE, max_error, candidates=candidates)


def best_of(budget, laws, exact_cost=1000.0):
    """The cheapest cost inside the budget, by the law itself."""
    prices = [price / min((budget / factor) ** (1 / order), 0.5) for factor, order, price in laws.values()]
    return min([*prices, exact_cost])


# The search


@pytest.mark.parametrize("budget", [0.3, 0.1, 0.03, 0.01, 0.003, 0.001])
def test_the_cheapest_step_inside_the_budget_is_found(budget):
    found = faked({"overlap": budget})
    assert found.errors["overlap"].value <= budget
    assert best_of(budget, LAWS) <= found.cost.median <= 1.25 * best_of(budget, LAWS)


orders = st.floats(0.8, 3.5)
three = st.tuples(*[st.tuples(st.floats(-1, 2), orders, st.floats(0.3, 3))] * 3)


@given(st.floats(-4, -0.5), three)
def test_whatever_the_law_nothing_outside_is_returned_and_nothing_much_cheaper_is_inside(log_budget, drawn):
    budget = 10**log_budget
    laws = {key: (10**factor, order, price) for key, (factor, order, price) in zip(LAWS, drawn, strict=True)}
    found = faked({"overlap": budget}, laws=laws)
    assert found.settings.method == "event" or found.errors["overlap"].bound <= budget
    least = best_of(budget, laws)
    assert least * (1 - 1e-9) <= found.cost.median <= 1.3 * least


def test_every_budget_is_met_and_the_tightest_decides():
    found = faked({"overlap": 0.1, "pressure": 0.001})
    assert found.budgets == {"overlap": 0.1, "pressure": 0.001}
    assert all(each.bound <= found.budgets[name] for name, each in found.errors.items())
    assert found.cost.median == faked({"pressure": 0.001}).cost.median > faked({"overlap": 0.1}).cost.median


def test_the_exact_solver_is_the_answer_where_it_is_cheapest():
    found = faked({"overlap": 0.01}, exact_cost=0.5)
    assert (found.settings, found.cost.median) == (EVENT, 0.5)
    assert found.tighter == 1
    assert "\nhalving all error budgets would cost no more\n" in str(found)
    assert faked({"overlap": 0.01}).settings.method != "event", "the control"


def test_errors_count_with_their_noise():
    """At an error of half the budget and a standard error of a third, nothing is inside: 0.5 + 2/3 > 1."""
    quiet = faked({"overlap": 0.01}, candidates=[PUSH], noise=1e-9)
    noisy = faked({"overlap": 0.01}, candidates=[PUSH], noise=0.003)
    assert 0.01 / 1.2 < quiet.settings.dt <= 0.01
    assert noisy.settings.dt < 0.9 * quiet.settings.dt
    assert noisy.errors["overlap"].bound <= 0.01
    with pytest.raises(mpsim.errors.BudgetError):
        faked({"overlap": 0.01}, candidates=[PUSH], noise=0.02)


# The answer


def test_each_cheaper_candidate_is_named_with_why_it_failed():
    found = faked({"overlap": 0.01})
    cheaper = [each for each in found.tried if each.row.cost.median < found.cost.median]
    assert cheaper
    assert not any(each.inside for each in cheaper)
    text = str(found)
    assert text.splitlines()[0].startswith("auto impact dt=0.0")
    for each in cheaper:
        assert "outside 0.01, two standard errors included" in each.verdict
        assert f"{each.row.label}, {each.row.cost.median:.3g} ns: {each.verdict}" in text
    assert "budget 0.01 (verified with new runs)" in text
    assert text.endswith("errors against a law; averages over starts of a law, runs of 10")
    assert (found.verified, found.exact) == (True, False)


def test_the_exact_solver_is_called_exact_and_not_verified():
    found = faked({"overlap": 0.01}, exact_cost=0.5)
    assert (found.verified, found.exact) == (False, True)
    assert "overlap: 0 (the reference itself), budget 0.01 (exact)" in str(found)
    assert "verified" not in str(found)


def test_what_mpsim_will_warn_of_is_said():
    assert "mpsim warns: too fast." in str(faked({"overlap": 0.01}, warning="too fast."))
    assert "warns" not in str(faked({"overlap": 0.01})), "the control"


def test_what_the_reference_cannot_measure_is_refused_before_anything_is_tried():
    with pytest.raises(mpsim.errors.NotMeasurableError, match="nothing happens"):
        faked({"overlap": 0.01}, unmeasurable="nothing happens")


def test_a_search_ends_with_its_time_and_still_verifies():
    """Each run is said to take eight seconds: there is time for six runs of one candidate, and for no others."""
    found = faked({"overlap": 0.5}, seconds=8.0, candidates=[PUSH])
    assert found.verified
    assert len(found.tried) < len(faked({"overlap": 0.5}, candidates=[PUSH]).tried), "the control"


def test_a_candidate_that_cannot_run_is_named_too():
    text = str(faked({"overlap": 0.01}, fails=frozenset({"push"})))
    assert "auto push dt=0.1 failed: push failed" in text


@pytest.mark.parametrize(("order", "factor"), [(1.0, 2.0), (2.0, math.sqrt(2))])
def test_half_of_the_budget_costs_what_the_order_says(order, factor):
    found = faked({"overlap": 0.01}, candidates=[IMPACT], laws={("impact", 1): (3.0, order, 1.0)})
    assert found.tighter == pytest.approx(factor, rel=0.02)
    half = faked({"overlap": 0.005}, candidates=[IMPACT], laws={("impact", 1): (3.0, order, 1.0)})
    assert half.cost.median / found.cost.median == pytest.approx(found.tighter, rel=0.25)
    assert f"halving all error budgets would cost about {found.tighter:.2g} times as much" in str(found)


def test_half_of_the_budget_never_costs_more_than_the_exact_solver():
    laws = {("impact", 1): (3.0, 1.0, 1.0)}
    price = faked({"overlap": 0.01}, candidates=[IMPACT, EVENT], laws=laws).cost.median
    found = faked({"overlap": 0.01}, candidates=[IMPACT, EVENT], laws=laws, exact_cost=1.3 * price)
    assert found.tighter == pytest.approx(1.3, rel=0.2)


def test_an_answer_that_fails_its_verification_is_not_given():
    found = faked({"overlap": 0.01}, verified=1.2)
    assert found.errors["overlap"].value <= 0.01
    failed = [each for each in found.tried if "when verified" in each.verdict]
    assert failed
    assert not any(each.inside for each in failed)
    assert faked({"overlap": 0.01}).cost.median < found.cost.median


def test_where_all_fail_their_verification_the_exact_solver_is_left_or_the_refusal_shows_what_was_verified():
    found = faked({"overlap": 0.01}, verified=1e9)
    assert found.settings == EVENT
    with pytest.raises(
        mpsim.errors.BudgetError, match=r"no candidate stays inside overlap 0\.01\. .* reaches overlap 0\.0102"
    ):
        faked({"overlap": 0.01}, verified=1e9, candidates=[IMPACT])


@given(st.floats(-3, -1), st.floats(1.0, 1e3))
def test_each_verification_has_starts_of_its_own(log_budget, verified):
    """As before: the second used those of the first, which had chosen its step."""
    faked({"overlap": 10**log_budget}, verified=verified)
    attempts = [first for first in Fake.firsts if first]
    assert attempts == [128 * (1 + attempt) for attempt in range(len(attempts))], "128 runs of the reference from each"


def test_a_list_of_starts_is_shared_between_search_and_verification():
    found = faked({"overlap": 0.01}, number=30)
    assert found.verified
    assert [first for first in Fake.firsts if first] == [15], "its second half, once"
    with pytest.raises(
        mpsim.InputError, match=r"starts must hold at least 24 Scenes, .* got 23\. Give more, or a func"
    ):
        faked({"overlap": 0.01}, number=23)


def test_how_long_it_will_take_is_said_before_anything_is_run():
    faked({"overlap": 0.01}, seconds=0.1)
    assert Fake.announced.startswith("about ")
    assert Fake.announced.endswith("16 runs of each candidate, to 10")
    assert 0.5 < float(Fake.announced.split()[1]) / Fake.now < 2, "and it is about right"


class Slow(ThreadPoolExecutor):
    """Whose runs take some time, whatever was forecast."""

    seconds = 0.0

    def submit(self, function, /, *arguments, **keywords):
        def late():
            time.sleep(self.seconds)
            return function(*arguments, **keywords)

        return super().submit(late)


@pytest.mark.slow
@pytest.mark.parametrize(("seconds", "budget", "replicas"), [(0.0, 1000.0, 16), (0.4, 5.0, chooser.FEWEST_REPLICAS)])
def test_where_runs_side_by_side_take_longer_than_forecast_there_are_fewer(seconds, budget, replicas, monkeypatch):
    monkeypatch.setattr(ensemble, "RELIABLE_SECONDS", 0.0)
    monkeypatch.setattr(ensemble, "usable_cores", lambda: 2)
    with Slow(2) as executor:
        executor.seconds = seconds
        how = {"replicas": 16, "seconds": budget, "executor": executor}
        with ensemble.Ensemble(gas(30, 0.2), 10.0, ("pressure",), **how) as run:
            search = chooser.Search(run, gas(30, 0.2), {"pressure": 0.1}, budget)
            search.run_reference()
            assert run.replicas == replicas
            assert (run.seconds_for(run.preliminary.reference, 16) > 0.3 * budget) == (seconds > 0)


def test_a_measure_that_means_nothing_in_any_run_is_not_a_budget_out_of_reach():
    reason = "no overlaps occurred in any run. Ask for longer runs (until=...)"
    with pytest.raises(
        mpsim.errors.NotMeasurableError, match=r"overlap is not measurable here: no overlaps occurred.*longer runs"
    ):
        faked({"overlap": 0.01}, reason=reason, candidates=[IMPACT, PUSH])
    assert len(Fake.firsts) < 6, "and no search goes on for it"


# Refusals


def test_a_budget_out_of_reach_is_refused_with_the_least_that_is_not():
    with pytest.raises(mpsim.errors.BudgetError) as refusal:
        faked({"overlap": 1e-9}, candidates=[IMPACT, PUSH])
    text = str(refusal.value)
    assert "no candidate stays inside overlap 1e-09" in text
    assert "auto impact dt=0.0005, reaches overlap 2.5e-06" in text  # 10 x 0.0005^2, and noise
    assert "Allow these errors; where the noise is what is left, run longer" in text


def test_where_nothing_can_run_the_reasons_are_named():
    with pytest.raises(
        mpsim.errors.BudgetError, match=r"no candidate could run this scene.*auto push dt=0.1: push failed"
    ):
        faked({"overlap": 0.1}, candidates=[PUSH], fails=frozenset({"push"}))


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"max_error": {"presure": 0.01}}, "max_error must be one of .*Did you mean 'pressure'"),
        ({"max_error": {}}, "max_error must hold at least one budget"),
        ({"max_error": 0.01}, "max_error must hold at least one budget.*got 0.01"),
        ({"max_error": {"pressure": 0}}, r"max_error\['pressure'\] must be a finite number > 0"),
        ({"max_error": {"pressure": -0.1}}, r"max_error\['pressure'\] must be a finite number > 0"),
        ({"max_error": {"pressure": float("nan")}}, r"max_error\['pressure'\] must be a finite number > 0"),
        ({"max_error": {"pressure": 2}}, r"max_error\['pressure'\] must be less than 1, .*got 2. 2 % is 0.02\."),
        (
            {"max_error": {"pressure": "1 %"}},
            r"max_error\['pressure'\] must be a number > 0 \(0.01 is 1 %\); got '1 %'",
        ),
        ({"candidates": []}, "candidates must hold at least one"),
        ({"candidates": ["grid"]}, "candidates must hold at least one mpsim.Settings; got"),
        ({"candidates": 5}, "candidates must be a list of mpsim.Settings; got 5"),
        ({"replicas": 1}, "replicas must be a whole number from 2"),
        ({"until": -1}, "until must be a finite number > 0"),
        ({"seconds": 0}, "seconds must be a finite number > 0"),
        ({"starts": "kinds"}, "starts must be 'kind', 'same', a function or a list of Scenes; got 'kinds'"),
        ({"path": "/nowhere/at/all.json"}, "path must be a file in a folder that can be written to"),
        ({"executor": 2}, "executor must be a concurrent.futures.Executor"),
        ({"scene": "gas"}, "scene must be an mpsim.Scene"),
    ],
)
def test_bad_input_is_refused_by_name(arguments, text):
    with pytest.raises(mpsim.InputError, match=text):
        tune(**({"scene": SCENE, "max_error": {"pressure": 0.01}} | arguments))


# For real


@pytest.mark.slow
def test_a_real_answer_is_inside_its_budgets_and_was_verified_by_runs_that_did_not_choose_it(monkeypatch):
    runs = []
    long_run, short_runs = ensemble.long_run, ensemble.short_runs

    def long_watched(start, settings, plan, *stop):
        runs.append(("long", settings, start.digest()))
        return long_run(start, settings, plan, *stop)

    def short_watched(scene, settings, plan, start, *rest):
        runs.append(("short", settings, start.digest()))
        return short_runs(scene, settings, plan, start, *rest)

    monkeypatch.setattr(ensemble, "long_run", long_watched)
    monkeypatch.setattr(ensemble, "short_runs", short_watched)
    budgets = {"overlap": 0.05, "trajectory": 0.2}
    found = tune(SCENE, budgets, until=5, replicas=2, candidates=[PUSH])
    numbers = {SCENE.digest(): 0} | {SCENE.redrawn(number).digest(): number for number in range(1, 256)}
    runs = [(kind, settings, numbers[which] if kind == "long" else which) for kind, settings, which in runs]
    assert all(found.errors[name].value <= budget for name, budget in budgets.items())
    assert len(runs) == len(set(runs)), "no run is made twice"
    mine = [(kind, which) for kind, settings, which in runs if settings.dt == found.settings.dt]
    long, short = ({which for kind, which in mine if kind == wanted} for wanted in ("long", "short"))
    assert len(short) == 16, "eight starts to choose by and eight others to verify by"
    assert {number for number in long if number >= 128} == set(range(128, 160))
    assert {number for number in long if number < 128} >= {0, 1}
    reference = {which for kind, settings, which in runs if kind == "long" and settings.method == "event"}
    assert {number for number in reference if number >= 128} == set(range(128, 192)), "others beside the verification"
    with mpsim.Simulation(SCENE, dataclasses.replace(found.settings, workers=1)) as sim:
        depth = sim.run(until=50, measures=["overlap"]).measures["overlap"]
    assert depth.value / (2 * SCENE.radius) == pytest.approx(found.errors["overlap"].value, rel=0.1)


@pytest.mark.slow
def test_processes_give_the_answer_of_threads_and_its_errors_to_the_bit(processes, monkeypatch):
    """With costs that are those of the steps: measured ones would choose otherwise now and then."""
    timed, submitted, submit = [], [], processes.submit

    def measure(scene, settings, until, whole):
        timed.append(settings)
        price = 100.0 if settings.method == "event" else 1 / settings.dt
        return {"median": price, "low": price, "high": price, "memory": 100.0, "method": "grid", "workers": 1}

    monkeypatch.setattr(cost, "measure", measure)
    monkeypatch.setattr(processes, "submit", lambda *task: submitted.append(task) or submit(*task))
    answers = [
        tune(SCENE, {"overlap": 0.05, "trajectory": 0.2}, until=5, replicas=2, candidates=[PUSH], executor=executor)
        for executor in (processes, None)
    ]
    there, here = answers
    assert (there.settings, there.errors) == (here.settings, here.errors)
    assert timed[: len(timed) // 2] == timed[len(timed) // 2 :], "and it is found by the same way"
    assert len(submitted) > 2 * 16, "runs to choose by and to verify by, in those processes"


def test_a_real_budget_out_of_reach_is_refused():
    with pytest.raises(mpsim.errors.BudgetError, match=r"no candidate stays inside momentum_drift 1e-06\. The best of"):
        tune(
            SCENE,
            {"momentum_drift": 1e-6},
            until=2,
            replicas=2,
            candidates=[Settings(law="reflect", contact="push", method="grid")],
        )


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::mpsim.FastWarning")  # of the tail of the speeds, as the answer says
def test_the_choice_of_a_thousandth_of_pressure_is_confirmed_by_a_long_run():
    scene = gas(200, 0.3)
    found = tune(scene, {"pressure": 0.01, "collision_rate": 0.01})
    values = []
    for settings in (found.settings, EVENT):
        with mpsim.Simulation(scene, dataclasses.replace(settings, dt=min(settings.dt, 0.1))) as sim:
            values.append(sim.run(until=2000, measures=["collision_rate"]).measures["collision_rate"])
    assert (
        abs(values[0].value / values[1].value - 1)
        < 0.01 + 3 * np.hypot(*(each.error for each in values)) / values[1].value
    )
