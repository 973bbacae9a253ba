"""Tables that answer questions of docs/accuracy.md, from results of run_tradeoff.py and runs of its own."""

import json
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from harness import by_turns, table
from tradeoff_figures import short_label

import mpsim
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.output.tables import UNITS, error_text
from mpsim.studies import replicas
from mpsim.studies.tradeoff import Row

TURNS = 7
"""Times that settings are timed, in turns; the least counts, as what else runs on a machine only ever adds."""

FAMILIES = ((mpsim.Settings(), 2), (mpsim.Settings(passes=2), 2), (mpsim.Settings(contact="push"), 1))
"""Stepped settings that are held against the exact solver, and orders that are believed beyond what was measured."""

TUNED = {
    "push": ("push", mpsim.Settings(contact="push")),
    "impact": ("impact", mpsim.Settings()),
    "x2": ("impact, passes=2", mpsim.Settings(passes=2)),
}
"""Families of which the cheapest settings within an error are found: their words and settings."""


def push_against_tuned(kept: Path, full: bool, fresh: bool) -> str:
    """The cheapest settings of each family within 1 % of the pressure; what was measured is kept in a file."""
    known: dict[str, Any] = {} if fresh or not kept.exists() else json.loads(kept.read_text())
    key = "full" if full else "short"
    if key not in known:
        known[key] = _measured(16 if full else 8)
        kept.write_text(json.dumps(known, indent=1) + "\n")
    found, costs = known[key]["found"], known[key]["costs"]
    words = {name: text for name, (text, _) in TUNED.items()} | {"event": "event (exact)"}
    rows = []
    for name, cost in costs.items():
        dt, error = found.get(name, ("", "0"))
        rows.append((words[name], dt, error, f"{cost:,.0f}", f"{costs['push'] / cost:.1f} x"))
    heads = ("family", "dt", "pressure, verified [%]", "cost [ns per disc and unit of time]", "push costs")
    best = min(costs, key=costs.get)
    return (
        "Cheapest settings of each family that keep the pressure of 100 discs at packing 0.3 within 1 %, each "
        f"verified with new runs; costs are the lowest of {TURNS} alternating measurements.\n\n{table(heads, rows)}\n\n"
        f"Cheapest: {words[best]}; push costs {costs['push'] / costs[best]:.1f} times as much."
    )


def _measured(runs: int) -> dict[str, Any]:
    """The step and the verified error of each family, if one is within 1 %, and the costs side by side."""
    scene = mpsim.Scene.random(count=100, packing=0.3, radius=0.5, seed=1)
    found, settings = {}, {name: each for name, (_, each) in TUNED.items()}
    for name, each in settings.items():
        try:
            tuned = mpsim.tune(scene, {"pressure": 0.01}, candidates=[each], replicas=runs)
        except mpsim.errors.BudgetError as error:
            found[name] = "none", str(error)
            continue
        found[name] = tuned.settings.dt, error_text("pressure", tuned.errors["pressure"])
        settings[name] = replace(each, dt=tuned.settings.dt)
    settings["event"] = mpsim.Settings(method="event")
    timed = by_turns({name: partial(replicas.measure, scene, each, 200.0) for name, each in settings.items()}, TURNS)
    return {"found": found, "costs": {name: min(each["low"] for each in costs) for name, costs in timed.items()}}


def where_exact_is_cheaper(tables: Mapping[str, mpsim.Tradeoff]) -> str:
    """For each scene and measure the error that no stepped setting reaches at less than the cost of `event`."""
    measures = ("pressure", "collision_rate", "overlap", "trajectory", "missed_collisions")
    rows = []
    for name, each in tables.items():
        exact = next((row for row in each.rows if capabilities_of(row.settings).is_exact and row.cost), None)
        if exact is not None and exact.cost is not None:
            cells = [at_cost(each, measure, exact.cost.median) for measure in measures]
            rows.append((name, f"{exact.cost.median:,.0f}", *cells))
    heads = [f"{name.replace('_', ' ')} [{UNITS.get(name, '%')}]" for name in measures]
    return (
        "The error of the best stepped settings at the cost of `event`. For smaller errors `event` is cheaper. "
        '"About 0.08" is calculated for the step that costs as much as `event`, from the errors at other steps and '
        'the order with which they fall. "< 0.3" means at most 0.3: the errors are below the noise, so no order can '
        "be fitted, and the bound is that of a cheaper setting.\n\n"
    ) + table(("scene", "event [ns per disc and unit of time]", *heads), rows)


def at_cost(tradeoff: mpsim.Tradeoff, measure: str, limit: float) -> str:
    """The least error that stepped settings reach for a cost, with the settings."""
    found = []
    for contact, most in FAMILIES:
        rows = [row for row in tradeoff.rows if row.cost and replace(row.settings, dt=contact.dt) == contact]
        rows.sort(key=lambda row: row.settings.dt)
        dt = step_of_cost(rows, limit)
        seen = [row for row in rows if row.errors[measure].resolved][:3]
        if dt and len(seen) > 1 and dt <= seen[-1].settings.dt:
            steps, errors = np.log([(row.settings.dt, abs(row.errors[measure].value)) for row in seen]).T
            order = float(np.clip(np.polyfit(steps, errors, 1)[0], 0, most))
            near = int(np.abs(steps - np.log(dt)).argmin())
            error = float(np.exp(errors[near] + order * (np.log(dt) - steps[near])))
            text = f"about {error if measure in UNITS else 100 * error:.2g}"
            found.append((error, text, replace(contact, dt=dt)))
        cheaper = [row for row in rows if row.cost and row.cost.median < limit]
        found += [
            (row.errors[measure].magnitude, error_text(measure, row.errors[measure]), row.settings) for row in cheaper
        ]
    if not found:
        return "any"
    _, text, settings = min(found, key=lambda each: each[0])
    return f"{text} ({short_label(settings)})"


def step_of_cost(rows: list[Row], limit: float) -> float | None:
    """The step at which settings cost so much, from the two finest steps of a family: cost = a + b / dt."""
    points = [(1 / row.settings.dt, row.cost.median) for row in rows if row.cost]
    if len(points) < 2 or points[-1][1] > limit:
        return None
    (x_fine, fine), (x_next, near) = points[:2] if points[0][1] < limit else around(points, limit)
    if fine <= near:
        return None  # noise of the clock
    return float(f"{1 / (x_fine + (limit - fine) * (x_fine - x_next) / (fine - near)):.2g}")


def around(points: list[tuple[float, float]], limit: float) -> list[tuple[float, float]]:
    """The two neighbours between whose costs the limit lies, finest first."""
    return next(([one, two] for one, two in pairwise(points) if two[1] <= limit <= one[1]), points[:2])
