"""Checks with new runs that settings from `mpsim.tune` are within their budgets, on named and generated scenes.

python scripts/run_promise.py                 all scenes: about two hours on two cores
python scripts/run_promise.py medium hopper   some scenes
python scripts/run_promise.py --fresh         forget what earlier calls have kept
python scripts/run_promise.py --docs docs/accuracy.md    and renew the results on that page

Each verified answer is held against an ensemble of its own: starts that had no part in search or verification. It
should be inside its budget plus two standard errors of that check. The smallest budget comes first, by itself: that
call is timed. The others then share its runs of the reference, and the three checks share theirs. Results are kept
under results/promise/, scene by scene; an interrupted call continues where it stopped.
"""

import json
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import harness
from harness import exit_code, fill_page, made_by, make_folder, parser_of, say
from promise_scenes import BY_COLLISIONS, CASES

import mpsim
from mpsim.core.text import with_error
from mpsim.scene import scenefile
from mpsim.studies.ensemble import FILE, Ensemble
from mpsim.studies.preliminary import StartsGiven
from mpsim.studies.replicas import available
from mpsim.studies.runner import RunFile
from mpsim.studies.tune import FEWEST_REPLICAS

BUDGETS = {"pressure": (0.1, 0.03, 0.01), "collision_rate": (0.1, 0.03, 0.01), "overlap": (0.1, 0.05, 0.02)}
FIRST = 100_000
"""Number of the first start of a check: none of a search or a verification is so large."""

SECONDS = {"named": 150.0, "generated": 30.0}
"""For one answer, about [s]: the default of `tune`, and less for the many generated ones."""

CHECKING = {"named": 0.15, "generated": 0.4}
"""Fraction of that time that a check may take."""

LEAST, MOST = 8, 64
"""Runs of a check at least and at most."""


class Asked(NamedTuple):
    """A scene, its starts, the measure of which errors are asked, and seconds for an answer and for its check."""

    scene: mpsim.Scene
    starts: StartsGiven
    measure: str
    seconds: float
    checking: float


def cases() -> dict[str, Asked]:
    """What is asked, by name."""
    named, generated = ((SECONDS[kind], CHECKING[kind] * SECONDS[kind]) for kind in ("named", "generated"))
    found: dict[str, Asked] = {}
    for name in scenefile.names():
        scene = mpsim.Scene.load(name)
        found[name] = Asked(scene, None, next(each for each in BUDGETS if each in available(scene)), *named)
    for name, make in CASES.items():
        found[name] = Asked(make(0), make, "collision_rate" if name in BY_COLLISIONS else "pressure", *generated)
    return found


def answers(asked: Asked, kept: Path) -> list[dict[str, Any]]:
    """The answers to all budgets, largest first, and what fresh ensembles say of those that were verified."""
    budgets = BUDGETS[asked.measure]
    rows = {budget: answer(asked, budget, kept) for budget in sorted(budgets)}
    verified = {budget: found for budget, (_, found) in rows.items() if found is not None and found.verified}
    if verified:
        until = next(iter(verified.values())).until
        how: dict[str, Any] = {"starts": asked.starts, "seconds": asked.seconds, "replicas": FEWEST_REPLICAS}
        with RunFile(kept, *FILE) as file, Ensemble(asked.scene, until, (asked.measure,), **how, file=file) as run:
            run.assess([])
            for budget, found in verified.items():
                rows[budget][0].update(check(run, found.settings, asked, budget))
    return [rows[budget][0] for budget in budgets]


def answer(asked: Asked, budget: float, kept: Path) -> tuple[dict[str, Any], mpsim.Tuned | None]:
    """One answer of `tune`."""
    started = time.monotonic()
    row: dict[str, Any] = {"measure": asked.measure, "budget": budget}
    limits = {asked.measure: budget}
    try:
        found = mpsim.tune(asked.scene, limits, starts=asked.starts, seconds=asked.seconds, path=kept)
    except mpsim.MpsimError as error:
        return row | {"verdict": type(error).__name__, "words": str(error), "seconds": time.monotonic() - started}, None
    row |= {"seconds": time.monotonic() - started, "words": str(found)}
    row |= {"settings": next(each.row.label for each in found.tried if each.row.settings == found.settings)}
    row |= {"verdict": "verified" if found.verified else "exact" if found.exact else "unverified"}
    error = found.errors[asked.measure]
    return row | {"error": error.value, "standard_error": error.error, "spread": error.error > 0}, found


def check(run: Ensemble, settings: mpsim.Settings, asked: Asked, budget: float) -> dict[str, Any]:
    """The error of settings over starts that had no part in choosing or verifying them."""
    one = run.seconds_for(settings, 1, verify=True)
    number = max(min(MOST, int(asked.checking / max(one, 1e-9))), LEAST)
    run.assess([settings], number, first=FIRST)
    error = run.errors(settings, number, first=FIRST)[asked.measure]
    inside = abs(error.value) <= budget + 2 * error.error
    return {"checked": error.value, "checked_error": error.error, "runs": number, "inside": bool(inside)}


def table(results: dict[str, dict[str, Any]]) -> tuple[str, str]:
    """All answers as a table in Markdown, and what they come to."""
    lines = [
        (name, found["rows"][0]["measure"].replace("_", " "), *map(cell, found["rows"]))
        for name, found in results.items()
    ]
    every = [row for rows in results.values() for row in rows["rows"]]
    verified = [row for row in every if row["verdict"] == "verified"]
    inside, spread = (sum(row[key] for row in verified) for key in ("inside", "spread"))
    exact = sum(row["verdict"] == "exact" for row in every)
    first = {name: rows["rows"][-1]["seconds"] for name, rows in results.items() if name in scenefile.names()}
    return harness.table(("scene", "error of", "10 %", "3 %", "1 %"), lines), (
        f"{len(every)} answers on {len(results)} scenes: {len(verified)} verified, {exact} exact, "
        f"{len(every) - len(verified) - exact} refused with a reason. Of the verified ones {inside} "
        f"({inside / max(len(verified), 1):.0%}) were inside their budget plus two standard errors when checked by "
        f"fresh ensembles; {len(verified) - spread} had no spread. By itself `tune` took for 1 % on named scenes [s]: "
        f"{', '.join(f'{name} {seconds:.0f}' for name, seconds in first.items())}."
    )


def cell(row: dict[str, Any]) -> str:
    """One answer in a few words."""
    if row["verdict"] == "verified":
        mark = "" if row["inside"] else " **outside**"
        return f"{row['settings']}: {with_error(100 * row['checked'], 100 * row['checked_error'])} %{mark}"
    if row["verdict"] == "exact":
        return "event (exact)"
    reasons = [short for words, short in REASONS.items() if words in row["words"]]
    return f"refused: {reasons[0] if reasons else row['words'].split(': ', 1)[-1][:60]}"


REASONS = {
    "is the same in all": "all runs are one run",
    "is 0 in all": "nothing happens",
    "few events in few": "too rare",
    "uncertain by": "reference too rough",
    "no candidate stays inside": "out of reach",
    "no candidate could run": "no candidate runs",
    "still changes": "no duration",
    "needs some": "too little time",
}


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("scenes", nargs="*", help="names; default: all")
    parser.add_argument("--fresh", action="store_true", help="forget what earlier calls have kept")
    parser.add_argument("--out", type=Path, default=Path("results/promise"))
    parser.add_argument("--docs", type=Path, help="page whose results are renewed")
    given = parser.parse_args()
    every = cases()
    unknown = sorted(set(given.scenes) - set(every))
    if unknown:
        parser.error(f"no such scene: {', '.join(unknown)}. Choose from {', '.join(every)}.")
    make_folder(given.out)
    results: dict[str, dict[str, Any]] = {}
    for name, asked in every.items():
        file = given.out / f"{name.replace(' ', '_').replace(',', '')}.json"
        if file.exists() and not given.fresh:
            results[name] = json.loads(file.read_text())
            continue
        if given.scenes and name not in given.scenes:
            continue
        kept = file.with_suffix(".kept")
        kept.unlink(missing_ok=True)
        rows = answers(asked, kept)
        results[name] = {"rows": rows, "digest": asked.scene.digest()}
        file.write_text(json.dumps(results[name], indent=1))
        kept.unlink(missing_ok=True)
        say("\n".join([name, *(f"  {cell(row)}  [{row['seconds']:.0f} s]" for row in rows)]))
    text, counted = table(results)
    say(f"{text}\n\n{counted}")
    if given.docs is not None:
        fill_page(given.docs, {"results": f"{counted}\n\n{made_by()}"})


if __name__ == "__main__":
    sys.exit(exit_code(main))
