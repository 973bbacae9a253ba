"""Compares the exact solver with published numbers, with chi^2: the tables of docs/validation.md.

python scripts/run_validation.py                   some twenty minutes of one core
python scripts/run_validation.py --quick           half a minute, with errors ten times as large
python scripts/run_validation.py --only haff two   some groups of rows; the others stay as they were

Groups: dense (pressures of Li et al. 2022), state (equation of state), two (two discs in a box), haff (cooling), motion
(velocity autocorrelation and diffusion). Rows go to --out as soon as a group is done.
"""

import dataclasses
import json
import math
import sys
import time
from pathlib import Path

import harness
from harness import DOCS, exit_code, fill_page, made_by, parser_of, say
from validation_rows import GROUPS, Row
from validation_theory import chi2_probability

from mpsim.measure import Measure

FAR = 5.0
"""Standard errors by which a control must be off."""

QUICK = 0.01


def measured(names: list[str], share: float, out: Path) -> tuple[dict[str, list[Row]], float]:
    """Rows by group: those that are measured now, and those that the file has of the others; time for all [s]."""
    kept = json.loads(out.read_text()) if out.exists() else {}
    out.parent.mkdir(parents=True, exist_ok=True)
    for name in names:
        began = time.process_time()
        rows = list(GROUPS[name](share))
        kept[name] = {"rows": list(map(dataclasses.asdict, rows)), "seconds": time.process_time() - began}
        out.write_text(json.dumps(kept, indent=1))
        say(table(rows))
    groups = {name: [row_of(row) for row in kept[name]["rows"]] for name in GROUPS if name in kept}
    return groups, sum(kept[name]["seconds"] for name in groups)


def row_of(values: dict) -> Row:
    """From the file."""
    expected, found = Measure(**values["expected"]), Measure(**values["found"])
    return Row(**{**values, "expected": expected, "found": found})


def table(rows: list[Row]) -> str:
    """Markdown, a line for each."""
    cells = []
    for row in rows:
        expected = row.expected if row.expected.error else f"{row.expected.value:.6g}"
        cells.append((row.what, row.source, expected, row.found, f"{row.deviation:+.1f}"))
    return harness.table(("", "source", "expected", "found", "deviation"), cells, right=1)


def summary(rows: list[Row]) -> str:
    """chi^2 of the settled rows, and how near the nearest control is."""
    settled = [row for row in rows if row.found.settled and not row.control]
    chi2 = sum(row.deviation**2 for row in settled)
    left = sum(not row.control for row in rows) - len(settled)
    probability = chi2_probability(chi2, len(settled))
    words = (
        f"χ² = {chi2:.1f} for {len(settled)} rows; probability of a larger one: {probability:.2g}. "
        f"The largest deviation is {max(abs(row.deviation) for row in settled):.1f} standard errors."
    )
    if left:
        words += f" Left out because their errors are not settled: {left}."
    controls = [abs(row.deviation) for row in rows if row.control]
    if controls:
        far = sum(each > FAR for each in controls)
        words += f" Controls that deviate by more than {FAR:g}: {far} of {len(controls)}."
    return words


def main() -> None:
    """Measure, and write the tables into the page."""
    parser = parser_of(__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--only", nargs="+", choices=GROUPS, default=list(GROUPS), metavar="GROUP")
    parser.add_argument("--out", type=Path, default=Path("results/validation/rows.json"))
    parser.add_argument("--page", type=Path, help="default: docs/validation.md; of --quick none")
    options = parser.parse_args()
    groups, seconds = measured(options.only, QUICK if options.quick else 1.0, options.out)
    rows = [row for group in groups.values() for row in group]
    words = f"{summary(rows)}\n\n{made_by()} It took {math.ceil(seconds / 60)} minutes of one core."
    say(words)
    page = options.page or (None if options.quick else DOCS / "validation.md")
    if page is not None:
        blocks = {"controls": table([row for row in rows if row.control]), "summary": words}
        blocks |= {name: table([row for row in group if not row.control]) for name, group in groups.items()}
        fill_page(page, blocks)


if __name__ == "__main__":
    sys.exit(exit_code(main))
