"""Tables that answer questions of docs/accuracy.md, from results of run_tradeoff.py and runs of its own."""

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from tradeoff_figures import short_label

import mpsim
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.measure import kinetic_energy
from mpsim.output.tables import UNITS, error_text
from mpsim.studies import replicas
from mpsim.studies.deviations import Deviation
from mpsim.studies.tradeoff import Row, label

BUDGETS: dict[str, dict[str, float]] = {
    "a game": {"overlap": 0.1, "missed_collisions": 0.2},
    "a lesson": {"pressure": 0.02},
    "a measurement": {"pressure": 0.005, "collision_rate": 0.005},
}
TUNED_SCENES = ("medium", "dense")

TURNS = 7
"""Times that settings are timed, in turns; the least counts, as what else runs on a machine only ever adds."""

FAMILIES = ((mpsim.Settings(), 2), (mpsim.Settings(passes=2), 2), (mpsim.Settings(contact="push"), 1))
"""Stepped settings that are held against the exact solver, and orders that are believed beyond what was measured."""

LARGE = 100_000
LARGE_DT = 0.05

Tick = Callable[[str], None]


@dataclass(frozen=True)
class Effort:
    """How long to look."""

    full: bool

    @property
    def replicas(self) -> int:
        """For `mpsim.tune`."""
        return 16 if self.full else 8


class SavedAnswers:
    """Answers that took runs of their own, in a file."""

    def __init__(self, path: Path, fresh: bool):
        self._path = path
        self._found: dict[str, Any] = {} if fresh or not path.exists() else json.loads(path.read_text())

    def get(self, key: str, effort: Effort, make: Callable[[], Any]) -> Any:
        """What is kept under a key, or else what `make` gives."""
        key = f"{key}, {'full' if effort.full else 'short'}"
        if key not in self._found:
            self._found[key] = make()
            self._path.write_text(json.dumps(self._found, indent=1) + "\n")
        return self._found[key]


def answers(
    tables: Mapping[str, mpsim.Tradeoff],
    scenes: Mapping[str, mpsim.Scene],
    saved: SavedAnswers,
    effort: Effort,
    tick: Tick,
) -> dict[str, str]:
    """All answers by name, each with a heading of its own."""
    tick("push against the tuned setting")
    found = {"push": push_against_tuned(saved.get("push against tuned", effort, lambda: measure_push(effort)))}
    found["exact"] = where_exact_is_cheaper(tables)
    tick(f"float32 at {LARGE:,} discs")
    found["float32"] = float32(tables, saved.get("float32", effort, lambda: measure_float32(effort)))
    found["reflect"] = reflect(tables)
    lines = []
    for name in TUNED_SCENES:
        for who, budgets in BUDGETS.items():
            if name in scenes:
                tick(f"tuning {name} for {who}")
                key = f"tuned {name} {budgets}"
                each = saved.get(key, effort, lambda s=scenes[name], b=budgets: tuned(s, b, effort))
                lines.append((f"{who}, {name}", each))
    if lines:
        found["tuned"] = tuned_table(lines)
    return found


def tuned(scene: mpsim.Scene, budgets: dict[str, float], effort: Effort, *families: mpsim.Settings) -> dict[str, Any]:
    """What `mpsim.tune` answers, as plain values."""
    try:
        found = mpsim.tune(scene, budgets, candidates=families or None, replicas=effort.replicas)
    except mpsim.errors.BudgetError as error:
        return {"budgets": budgets, "refused": str(error)}
    errors = {name: error_text(name, each) for name, each in found.errors.items()}
    return {
        "budgets": budgets,
        "settings": label(found.settings),
        "dt": found.settings.dt,
        "cost": found.cost.median,
        "errors": errors,
        "tighter": found.tighter,
        "tried": len(found.tried),
    }


def measure_push(effort: Effort) -> dict[str, Any]:
    """The cheapest push and the cheapest of all within 1 % of the pressure, at packing 0.3; costs side by side."""
    scene = mpsim.Scene.random(count=100, packing=0.3, radius=0.5, seed=1)
    families = {"push": mpsim.Settings(contact="push"), "impact": mpsim.Settings(), "x2": mpsim.Settings(passes=2)}
    found, settings = {}, {}
    for name, each in families.items():
        found[name] = tuned(scene, {"pressure": 0.01}, effort, each)
        settings[name] = replace(each, dt=found[name].get("dt", each.dt))
    settings["event"] = mpsim.Settings(method="event")
    costs = [
        {name: replicas.measure(scene, each, 200.0)["low"] for name, each in settings.items()} for _ in range(TURNS)
    ]
    return {"found": found, "costs": {name: min(each[name] for each in costs) for name in settings}}


def push_against_tuned(found: dict[str, Any]) -> str:
    costs = found["costs"]
    best = min(costs, key=costs.get)
    lines = [
        "## The same error for less",
        "",
        "Cheapest settings of each family that keep the pressure of 100 discs at packing 0.3 within 1 %, each verified",
        f"with new runs; costs are the lowest of {TURNS} alternating measurements.",
        "",
        "| family | dt | pressure, verified [%] | cost [ns per disc and unit of time] | push costs |",
        "|---|---|---|---|---|",
    ]
    words = {"push": "push", "impact": "impact", "x2": "impact, passes=2", "event": "event (exact)"}
    for name, value in costs.items():
        each = found["found"].get(name, {})
        errors = each.get("errors", {}).get("pressure", "0")
        ratio = f"{costs['push'] / value:.1f} x"
        lines.append(f"| {words[name]} | {each.get('dt', '')} | {errors} | {value:,.0f} | {ratio} |")
    lines += ["", f"Cheapest: {words[best]}; push costs {costs['push'] / costs[best]:.1f} times as much."]
    return "\n".join(lines)


def where_exact_is_cheaper(tables: Mapping[str, mpsim.Tradeoff]) -> str:
    """For each scene and measure the error that no stepped setting reaches at less than the cost of `event`."""
    measures = ("pressure", "collision_rate", "overlap", "trajectory", "missed_collisions")
    heads = [f"{name.replace('_', ' ')} [{UNITS.get(name, '%')}]" for name in measures]
    lines = [
        "## Where the exact solver is the cheaper one",
        "",
        "The error of the best stepped settings at the cost of `event`. For smaller errors `event` is cheaper.",
        '"About 0.08" is calculated for the step that costs as much as `event`, from the errors at other steps and the',
        'order with which they fall. "< 0.3" means at most 0.3: the errors are below the noise, so no order can be',
        "fitted, and the bound is that of a cheaper setting.",
        "",
        f"| scene | event [ns per disc and unit of time] | {' | '.join(heads)} |",
        f"|{'---|' * (len(heads) + 2)}",
    ]
    for name, table in tables.items():
        exact = next((row for row in table.rows if capabilities_of(row.settings).is_exact and row.cost), None)
        if exact is not None and exact.cost is not None:
            cells = [at_cost(table, measure, exact.cost.median) for measure in measures]
            lines.append(f"| {name} | {exact.cost.median:,.0f} | {' | '.join(cells)} |")
    return "\n".join(lines)


def at_cost(table: mpsim.Tradeoff, measure: str, limit: float) -> str:
    """The least error that stepped settings reach for a cost, with the settings."""
    found = []
    for contact, most in FAMILIES:
        rows = [row for row in table.rows if row.cost and replace(row.settings, dt=contact.dt) == contact]
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


def measure_float32(effort: Effort) -> dict[str, Any]:
    """Time of a frame, memory, and energy at 100,000 discs, both precisions in turns."""
    scene = mpsim.Scene.random(count=LARGE, packing=0.4, radius=0.5, seed=1)
    frames = 200 if effort.full else 40
    found: dict[str, Any] = {}
    for method in ("grid", "parallel"):
        simulations = {
            precision: mpsim.Simulation(scene, mpsim.Settings(dt=LARGE_DT, method=method, precision=precision))
            for precision in ("float64", "float32")
        }
        times: dict[str, list[float]] = {precision: [] for precision in simulations}
        for turn in range(TURNS + 1):
            for precision, sim in simulations.items():
                report = sim.run(frames=frames)
                if turn:  # the first warms up
                    times[precision].append(float(np.median(report.frame_seconds)) / LARGE * 1e9)
                found[f"memory {method} {precision}"] = report.block_bytes / LARGE
        for precision, sim in simulations.items():
            found[f"time {method} {precision}"] = min(times[precision])
            energy = kinetic_energy(sim.state, scene)
            found[f"drift {precision}"] = (energy / kinetic_energy_at_start(scene) - 1) / sim.time
            sim.close()
    return found


def kinetic_energy_at_start(scene: mpsim.Scene) -> float:
    return kinetic_energy(mpsim.State(scene.position, scene.velocity), scene)


def float32(tables: Mapping[str, mpsim.Tradeoff], found: dict[str, Any]) -> str:
    lines = [
        "## float32 against float64",
        "",
        f"{LARGE:,} discs, packing 0.4, impact, dt = {LARGE_DT}; the lowest of {TURNS} alternating measurements.",
        "",
        "| | float64 | float32 | float32 / float64 |",
        "|---|---|---|---|",
    ]
    for key, words in (
        ("time grid", "grid [ns per disc and frame]"),
        ("time parallel", "parallel [ns per disc and frame]"),
        ("memory grid", "memory, grid [bytes per disc]"),
        ("memory parallel", "memory, parallel [bytes per disc]"),
        ("drift", "drift of energy [1/time]"),
    ):
        double, single = found[f"{key} float64"], found[f"{key} float32"]
        ratio = "" if key == "drift" else f"{single / double:.2f}"
        lines.append(f"| {words} | {double:.3g} | {single:.3g} | {ratio} |")
    lines += ["", "Pressure of float32 minus that of float64, same scene and step, and drifts of energy:", ""]
    lines += ["| scene | settings | difference of pressure [%] | drift, float64 [1/time] | float32 [1/time] |"]
    lines += ["|---|---|---|---|---|"]
    for name, table in tables.items():
        for single, double in pairs(table, lambda row: row.settings.precision == "float32", precision="float64"):
            ours, theirs = single.errors["pressure"], double.errors["pressure"]
            error = math.hypot(ours.error, theirs.error)  # the reference's noise, common to both, is counted twice
            difference = error_text("pressure", Deviation(ours.value - theirs.value, error))
            drifts = [error_text("energy_drift", row.errors["energy_drift"]) for row in (double, single)]
            lines.append(f"| {name} | {short_label(double.settings)} | {difference} | {' | '.join(drifts)} |")
    return "\n".join(lines)


def pairs(table: mpsim.Tradeoff, chosen: Callable[[Row], bool], **changes: Any) -> list[tuple[Row, Row]]:
    """Rows that are chosen, each with the one whose settings differ by the changes alone."""
    by_settings = {row.settings: row for row in table.rows if row.cost is not None}
    rows = [row for row in by_settings.values() if chosen(row)]
    found = [(row, by_settings.get(replace(row.settings, **changes))) for row in rows]
    return [(row, other) for row, other in found if other is not None]


def reflect(tables: Mapping[str, mpsim.Tradeoff]) -> str:
    """The report's law beside the one that keeps momentum, at the same step."""
    measures = ("pressure", "collision_rate", "speed_distribution", "momentum_drift", "energy_drift")
    heads = [f"{name.replace('_', ' ')} [{UNITS.get(name, '%')}]" for name in measures]
    lines = [
        "## reflect against elastic",
        "",
        "Same contact (push) and step; cost in ns per disc and unit of time.",
        "",
        f"| scene | law | dt | cost | {' | '.join(heads)} |",
        f"|{'---|' * (len(heads) + 4)}",
    ]
    for name, table in tables.items():
        for pair in pairs(table, lambda row: row.settings.law == "reflect", law="elastic"):
            for row in pair:
                assert row.cost is not None
                cells = [error_text(measure, row.errors[measure]) for measure in measures]
                cost_now = f"{row.cost.median:,.0f}"
                lines.append(
                    f"| {name} | {row.settings.law} | {row.settings.dt:g} | {cost_now} | {' | '.join(cells)} |"
                )
    return "\n".join(lines)


def tuned_table(found: list[tuple[str, dict[str, Any]]]) -> str:
    lines = [
        "## Tuned settings",
        "",
        "Settings chosen by `mpsim.tune`; errors are from runs that were not used for the choice; cost in ns per disc",
        "and unit of time; last column: estimated cost of halving all budgets, relative to this cost.",
        "",
        "| purpose | largest errors | settings | cost | errors, verified | half |",
        "|---|---|---|---|---|---|",
    ]
    for who, each in found:
        budgets = ", ".join(with_unit(name, budget(name, value)) for name, value in each["budgets"].items())
        if "refused" in each:
            lines.append(f"| {who} | {budgets} | none: {each['refused']} | | | |")
            continue
        errors = ", ".join(with_unit(name, text) for name, text in each["errors"].items())
        half = f"{each['tighter']:.1f} x"
        lines.append(f"| {who} | {budgets} | {each['settings']} | {each['cost']:,.0f} | {errors} | {half} |")
    return "\n".join(lines)


def budget(name: str, value: float) -> str:
    return f"{value if name in UNITS else 100 * value:g}"


def with_unit(name: str, text: str) -> str:
    return f"{name.replace('_', ' ')} {text} {UNITS.get(name, '%')}"
