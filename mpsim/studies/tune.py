"""Search for the cheapest settings whose errors stay inside given budgets, with verification by independent runs."""

# pyright: reportUnnecessaryIsInstance=false
# Arguments are checked when the program runs as well, for callers without a type checker.

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mpsim.core import checks
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.errors import BudgetError, NotMeasurableError
from mpsim.measure.registry import ERRORS, OBSERVABLES
from mpsim.scene.scene import Scene, settings_for
from mpsim.scene.settings import Settings
from mpsim.studies.deviations import Deviation
from mpsim.studies.ensemble import PIECES, REFERENCE, CandidateFailed, Cost, Ensemble, demand_available, ensemble
from mpsim.studies.preliminary import StartsGiven
from mpsim.studies.tradeoff import Row, checked_candidates, families, label, row_of, step

# --- The result of a search for settings: each candidate with its verdict, and the answer


@dataclass(frozen=True, repr=False)
class Tuned:
    """The answer of `tune`.

    Attributes:
        settings: the cheapest settings found whose errors are within all budgets.
        cost: their cost.
        errors: their errors, from runs that were not used in the search.
        budgets: as given.
        reference: of the errors, in words.
        tried: every candidate of the search with its verdict, cheapest first.
        until: length of the runs [time].
        warning: the warning that mpsim raises when these settings are used on the scene; "" where others are inside
            all budgets without one.
        contact_time: that was given for the reference, which makes it a model, not exact [time]; None if none was
            given.
    """

    settings: Settings
    cost: Cost
    errors: dict[str, Deviation]
    budgets: dict[str, float]
    reference: str
    tried: tuple[Row, ...]
    until: float
    warning: str = ""
    contact_time: float | None = None

    @property
    def exact(self) -> bool:
        """Whether these settings are the exact solver, so that their errors are 0 by definition."""
        return self.contact_time is None and not self.verified

    @property
    def verified(self) -> bool:
        """Whether the errors were within the budgets in new, independent runs; those of the reference are not run."""
        return not all(error.exact for error in self.errors.values())

    def __repr__(self) -> str:
        lines = [f"{label(self.settings)}: {self.cost.median:.3g} ns per disc and unit of time ({self.cost.method})"]
        for name, budget in self.budgets.items():
            error = self.errors[name]
            of_reference = "exact" if self.contact_time is None else "which is a model, not exact"
            claim = of_reference if error.exact else "verified with new runs"
            lines.append(f"  {name}: {error!r}, budget {budget:g} ({claim})")
        refused = [each for each in self.tried if (each.warning or not each.inside) and each.settings != self.settings]
        cheaper = [each for each in refused if _cost(each) < self.cost.median]
        lines += ["cheaper, but not chosen:"] if cheaper else ["nothing cheaper was found"]
        lines += [f"  {each.label}, {_cost(each):.3g} ns: {each.verdict}" for each in cheaper]
        lines += [f"  {each.label} failed: {each.failure}" for each in self.tried if each.cost is None]
        lines.append(f"errors against {self.reference}; runs of {self.until:.3g}")
        if self.warning:
            lines.append(f"with these settings mpsim warns: {self.warning} The errors above include it.")
        return "\n".join(lines)


FIRST = 0.1  # first step to try for each family, in units of diameter / speed

LONGEST, SHORTEST = 0.5, 0.0005
"""Range of the search, likewise: with longer steps discs may pass through each other; for shorter ones `event` is
cheaper."""

CLOSE = 1.15  # ratio of two steps, one inside the budgets and one not, at which the search ends
MOST_STEPS = 8  # largest number of steps to try for one family
MOST_REPLICAS = 64  # largest number of replicas, if noise leaves it undecided whether a budget is met
FEWEST_REPLICAS = 6  # smallest number, if runs are long: the standard error of fewer is too uncertain

SEARCH, LEAST_SEARCH = 0.6, 0.25
"""Fraction of the available time for trials, the rest being for verification and timing; and the smallest fraction, if
the reference has taken longer than forecast."""

SHORTER = 0.7  # the next step, at most, after one of which mpsim warns
AIM = 0.9  # fraction of the budget that the next step aims at
LEAST_RATIO = 4.0  # smallest step of candidates, in steps of a stepped reference
VERIFICATIONS = 4  # settings that may fail their verification before the search gives up


def tune(
    scene: Scene,
    max_error: Mapping[str, float],
    until: float | None = None,
    candidates: Iterable[Settings] | None = None,
    *,
    starts: StartsGiven = None,
    executor: Executor | None = None,
    replicas: int = 16,
    seconds: float = 150.0,
    contact_time: float | None = None,
    path: str | Path | None = None,
    progress: bool | Callable[[int, int, str], None] | None = None,
) -> Tuned:
    """The cheapest settings whose errors on a scene stay inside every budget.

    For each family of settings the longest step inside the budgets is searched, guided by the order of the errors found
    so far; the cheapest family wins, and is verified by new runs from new starts. Two standard errors are added to each
    error. Settings of which mpsim warns are chosen only if no others are inside. `tradeoff` describes which runs each
    error comes from. On a scene that changes with time, no single window
    may be significantly outside a budget.

    Args:
        scene: the scene.
        max_error: measure -> largest |error|, > 0, in the unit of the measure (see `tradeoff`): {"pressure": 0.01} is
            one per cent, {"overlap": 0.05} a twentieth of a diameter. Relative errors must be less than 1.
        until: length of one run [time]; None: the scene's duration; without one, if the scene is stationary, long
            enough to determine the pressure to about a thousandth.
        candidates: families to choose from, whose dt is searched; None: impact with one and two passes, push, the
            exact solver, and the settings that the scene recommends.
        starts, executor, replicas, contact_time, path, progress: as for `tradeoff`; replicas are doubled if noise
            leaves an answer undecided, and reduced if runs are long.
        seconds: approximate time that the search may take [s]; if runs are long, a longer search reaches smaller
            errors.

    Raises:
        BudgetError: if no candidate meets all budgets, with the smallest error reached.
        NotMeasurableError: if the scene shows no such error, because nothing happens or all runs are equal.
        InputError: naming the argument and its rule.

    >>> scene = Scene.random(count=30, packing=0.2, radius=0.5, seed=1)
    >>> found = tune(scene, {"overlap": 0.05}, until=10.0, replicas=2)
    >>> found.errors["overlap"].value < 0.05
    True
    """
    budgets = _budgets(max_error)
    demand_available(budgets, scene)
    choices = _families(contact_time, scene) if candidates is None else checked_candidates(candidates)
    how: dict[str, Any] = {"executor": executor, "starts": starts, "contact_time": contact_time, "seconds": seconds}
    how |= {"most": MOST_REPLICAS, "replicas": replicas, "path": path, "progress": progress}
    with ensemble(scene, until, tuple(budgets), **how) as run:
        search = Search(run, scene, budgets, seconds)
        search.run_reference()
        for family in choices:
            search.longest_step(family)
        return search.answer()


class Search:
    """The trials of one call of `tune`."""

    def __init__(self, run: Ensemble, scene: Scene, budgets: dict[str, float], seconds: float):
        self._run = run
        self._scene = scene
        self._budgets = budgets
        self._seconds = seconds
        self._end = time.monotonic() + SEARCH * seconds
        self._block = MOST_REPLICAS * (REFERENCE if run.preliminary.exact else 1)  # of starts, for each verification
        self._verifying = max(MOST_REPLICAS // 2, run.replicas)
        self._trials: dict[Settings, Row] = {}
        self._orders: dict[Settings, float] = {}  # of families, of dt = 1
        self._numbers: dict[Settings, int] = {}
        self._is_reference = run.preliminary.is_reference

    def run_reference(self) -> None:
        """Run the reference, and refuse what cannot be measured: NotMeasurableError."""
        run = self._run
        self._choose_replicas()
        run.assess([], run.replicas)
        try:
            run.demand_measurable(self._budgets)
        except CandidateFailed as failed:
            raise NotMeasurableError(f"nothing is measurable: {failed}. Ask for shorter runs (until=...).") from None
        self._choose_replicas()  # now that the true time of runs is known
        self._end = max(self._end, time.monotonic() + LEAST_SEARCH * self._seconds)

    def _choose_replicas(self) -> None:
        """Choose the number of runs per candidate that time allows, in the search and in a verification."""
        run = self._run
        one = run.seconds_for(run.preliminary.reference, 1, verify=True)
        affordable = int(SEARCH / 2 * self._seconds / one) if one else MOST_REPLICAS
        run.replicas = max(min(run.replicas, affordable), min(run.replicas, FEWEST_REPLICAS))
        self._verifying = max(min(self._verifying, affordable), run.replicas)

    def longest_step(self, family: Settings) -> None:
        """Search for the longest step of a family inside all budgets."""
        family, preliminary = self._run.framed(family), self._run.preliminary
        if capabilities_of(family).is_exact and not preliminary.exact and not self._is_reference(family):
            reason = f"not tried: errors are against {preliminary.reference_name}"
            self._trials[family] = Row(family, failure=reason, verdict=reason)
            return
        if not capabilities_of(family).has_steps:
            self._try(family)
            return
        dt, shortest, longest = (step(self._scene, preliminary.thermal_velocity, h) for h in (FIRST, SHORTEST, LONGEST))
        longest = min(longest, self._run.until / PIECES)
        dt, shortest = min(dt, longest), min(shortest, longest)
        if capabilities_of(preliminary.reference).has_steps:  # it resolves only errors far above its own
            shortest = max(shortest, LEAST_RATIO * preliminary.reference.dt)
        inside, outside, warned = 0.0, math.inf, math.inf
        found: list[tuple[float, float]] = []  # step, and largest ratio of error to budget
        for _ in range(MOST_STEPS):
            settings = replace(family, dt=dt)
            if not self._is_time_for(settings):
                break
            trial = self._try(settings)
            if not all(error.measurable for error in trial.errors.values()):
                break
            if trial.inside and not trial.warning:
                inside = max(inside, dt)
            else:
                outside = min(outside, dt)
                warned = min(warned, dt) if trial.warning else warned
                if self._is_too_costly(trial):
                    break
            ratio = _worst(trial, self._budgets)
            if math.isfinite(ratio) and ratio > 0:
                found.append((dt, ratio))
            if outside < inside * CLOSE or inside >= longest or outside <= shortest:
                break
            dt = _next(dt, found, inside, outside, (shortest, max(min(longest, SHORTER * warned), shortest)))
            if replace(family, dt=dt) in self._trials:
                break
        self._orders[replace(family, dt=1.0)] = _order(found)

    def answer(self) -> Tuned:
        """The cheapest trial inside all budgets that passes its verification."""
        for attempt in range(VERIFICATIONS + 1):
            best = self._best(attempt)
            if best is None:
                break
            if all(error.exact for error in best.errors.values()):
                return self._tuned(best, best.errors)
            errors = self._verified(best.settings, self._block * (1 + attempt))
            if not (broken := self._broken(errors)):
                return self._tuned(best, errors)
            self._reject(best, errors, broken)
        raise self._refusal()

    def _best(self, attempt: int) -> Row | None:
        """The cheapest trial inside all budgets; the exact solver if there is no time for one more verification."""
        inside = [trial for trial in self._trials.values() if trial.inside]
        best = min(inside, key=lambda trial: (bool(trial.warning), _cost(trial)), default=None)
        if best is None or not attempt or self._is_reference(best.settings):
            return best
        if attempt < VERIFICATIONS and self._is_time_for(best.settings, self._verifying, last=True):
            return best
        return next((trial for trial in inside if self._is_reference(trial.settings)), None)

    def _verified(self, settings: Settings, first: int) -> dict[str, Deviation]:
        """Errors of runs from new starts, numbered from `first` on."""
        self._choose_replicas()
        number = max(self._numbers[settings], self._verifying)
        self._run.assess([settings], number, first=first)
        return self._run.errors(settings, number, first=first)

    def _broken(self, errors: dict[str, Deviation]) -> list[str]:
        """Names of the errors outside their budgets."""
        return [name for name, budget in self._budgets.items() if not errors[name].inside(budget)]

    def _reject(self, best: Row, errors: dict[str, Deviation], broken: list[str]) -> None:
        """Record that settings have failed their verification, and try a shorter step if there is time."""
        settings = best.settings
        verdict = f"inside at first, but {broken[0]} {errors[broken[0]]!r} when verified"
        self._trials[settings] = replace(best, errors=errors, verdict=verdict, inside=False)
        if not self._is_time_for(settings, last=True):
            return
        ratio = max(errors[name].over(self._budgets[name]) for name in broken)
        order = self._orders.get(replace(settings, dt=1.0), 1.0)
        dt = float(f"{settings.dt / max((ratio / AIM) ** (1 / order), CLOSE):.2g}")
        for other, trial in list(self._trials.items()):
            if trial.inside and other == replace(settings, dt=other.dt) and other.dt > dt:
                verdict = "inside at first, but verification would probably fail, as it did for the next longer step"
                self._trials[other] = replace(trial, verdict=verdict, inside=False)
        if dt >= step(self._scene, self._run.preliminary.thermal_velocity, SHORTEST):
            self._try(replace(settings, dt=dt))

    def _try(self, settings: Settings) -> Row:
        """Errors and cost of a candidate; replicas are doubled while noise leaves the answer undecided."""
        if settings in self._trials:
            return self._trials[settings]
        number = self._run.replicas
        while True:
            self._run.assess([settings], number)
            try:
                errors = self._run.errors(settings, number)
            except CandidateFailed as failed:
                self._trials[settings] = Row(settings, failure=str(failed), verdict=str(failed))
                return self._trials[settings]
            if number * 2 > MOST_REPLICAS or self._is_reference(settings) or not self._is_undecided(errors):
                break
            if not self._is_time_for(settings, 2 * number):
                break
            number *= 2
        self._numbers[settings] = number
        self._run.time([settings])
        broken = self._broken(errors)
        verdict = "inside all budgets"
        if broken:
            name = broken[0]
            verdict = f"{name} {errors[name]!r}"
            if errors[name].measurable:
                verdict += f" is outside {self._budgets[name]:g}, two standard errors included"
        warning = "" if broken or not capabilities_of(settings).has_steps else self._run.warning_of(settings)
        verdict += f", but mpsim warns: {warning}" if warning else ""
        row = row_of(self._run, settings)
        self._trials[settings] = replace(row, errors=errors, verdict=verdict, inside=not broken, warning=warning)
        return self._trials[settings]

    def _is_time_for(self, settings: Settings, replicas: int = 0, last: bool = False) -> bool:
        """Whether there is time for the runs of another candidate, or, as the last one, for its verification."""
        needed = self._run.seconds_for(settings, replicas or self._run.replicas, verify=last or bool(replicas))
        return time.monotonic() + needed < self._end + (1 - SEARCH) * self._seconds * last

    def _is_undecided(self, errors: dict[str, Deviation]) -> bool:
        """Whether more replicas could bring all errors inside the budgets."""
        outside = self._broken(errors)
        possible = (abs(errors[name].value) - errors[name].noise < self._budgets[name] for name in outside)
        return bool(outside) and all(possible)

    def _is_too_costly(self, trial: Row) -> bool:
        """Whether a trial inside the budgets is cheaper than this one, which is outside."""
        inside = [_cost(each) for each in self._trials.values() if each.inside and not each.warning]
        return bool(inside) and _cost(trial) > min(inside)

    def _tuned(self, best: Row, errors: dict[str, Deviation]) -> Tuned:
        assert best.cost is not None
        run = self._run
        return Tuned(
            settings=best.settings,
            cost=best.cost,
            errors=errors,
            budgets=self._budgets,
            reference=run.preliminary.reference_name,
            tried=tuple(sorted(self._trials.values(), key=_cost)),
            until=run.until,
            warning=best.warning,
            contact_time=run.preliminary.contact_time,
        )

    def _refusal(self) -> BudgetError | NotMeasurableError:
        """Why no candidate meets the budgets, with the smallest error reached."""
        wanted = ", ".join(f"{name} {budget:g}" for name, budget in self._budgets.items())
        rows = [each for key, each in self._trials.items() if each.errors and not self._is_reference(key)]
        for name in self._budgets:
            reasons = [row.errors[name].reason for row in rows]
            if reasons and all(reasons):
                return NotMeasurableError(f"{name} is not measurable here: {reasons[0]}")
        rows = [row for row in rows if 1 < _worst(row, self._budgets) < math.inf]
        if not rows:
            found = "; ".join(f"{trial.label}: {trial.verdict}" for trial in self._trials.values())
            return BudgetError(f"no candidate could run this scene for max_error {wanted}: {found}. Choose others.")
        best = min(rows, key=lambda row: _worst(row, self._budgets))
        reached = ", ".join(f"{name} {best.errors[name].bound:.3g}" for name in self._budgets)
        event = "; or let candidates hold Settings(method='event')" if self._run.preliminary.exact else ""
        return BudgetError(
            f"max_error must be within reach: no candidate stays inside {wanted}. The best of {len(rows)} tried, "
            f"{best.label}, reaches {reached} (two standard errors included). Allow these errors; where the noise is "
            f"what is left, run longer (until=..., seconds=...){event}."
        )


def _budgets(max_error: Mapping[str, float]) -> dict[str, float]:
    if not isinstance(max_error, Mapping) or not max_error:
        rule = "hold at least one budget, as in {'pressure': 0.01}"
        raise checks.refusal("max_error", rule, f"{max_error!r}", f"Choose from {', '.join(ERRORS)}.")
    budgets: dict[str, float] = {}
    for name, given in max_error.items():
        is_relative = OBSERVABLES[checks.choice("max_error", name, ERRORS)].error == "relative"
        unit = "(0.01 is 1 %)" if is_relative else "(an error)"
        budgets[name] = budget = checks.positive(f"max_error[{name!r}]", given, unit)
        if budget >= 1 and is_relative:
            rule, instead = "be less than 1, which is 100 %", f"{budget:g} % is {budget / 100:g}."
            raise checks.refusal(f"max_error[{name!r}]", rule, f"{budget:g}", instead)
    return budgets


def _families(contact_time: float | None, scene: Scene) -> list[Settings]:
    """The exact solver, the usual families, and the settings that the scene recommends."""
    usual = families()
    own = replace(settings_for(scene, None), dt=usual[0].dt, workers=None)
    further = [] if capabilities_of(own).is_exact or own in usual else [own]
    return [Settings(method="event", contact_time=contact_time), *usual, *further]


def _cost(trial: Row) -> float:
    return trial.cost.median if trial.cost else math.inf


def _worst(row: Row, budgets: dict[str, float]) -> float:
    return max((row.errors[name].over(budget) for name, budget in budgets.items() if row.errors), default=math.inf)


def _order(found: list[tuple[float, float]]) -> float:
    """Order of the error in the step, from a linear fit of the logarithms; 1.5 before there are two points."""
    if len({dt for dt, _ in found}) < 2:
        return 1.5
    logarithms = np.log(np.array(found, dtype=np.float64))
    slope = float(np.polyfit(logarithms[:, 0], logarithms[:, 1], 1)[0])
    return min(max(slope, 0.7), 4.0)


def _next(
    dt: float, found: list[tuple[float, float]], inside: float, outside: float, limits: tuple[float, float]
) -> float:
    """The step at which the error is likely to meet its budget, between the known bounds."""
    last, ratio = found[-1] if found else (dt, 4.0)
    aim = last * float(np.clip((AIM / ratio) ** (1 / _order(found)), 0.2, 4.0))
    if inside and math.isfinite(outside) and not inside * 1.02 < aim < outside / 1.02:
        aim = math.sqrt(inside * outside)
    return float(f"{min(max(aim, limits[0]), limits[1]):.2g}")
