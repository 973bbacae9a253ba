"""`mpsim tune` and `mpsim tradeoff`: speed against accuracy of settings."""

import dataclasses
import math
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from mpsim.cli import terminal
from mpsim.cli.misc import settings_text
from mpsim.core.text import json_text
from mpsim.measure.registry import ERRORS, OBSERVABLES
from mpsim.output.tables import UNITS
from mpsim.scene import scenefile
from mpsim.scene.scene import settings_for
from mpsim.studies import tradeoff as tradeoffs
from mpsim.studies import tune as tuning
from mpsim.studies.preliminary import KINDS

_WORDS = {"1/time": "per unit of time", "diam.": "in diameters"}


def _study_options(most: int, of: str = "") -> Callable[..., Any]:
    """Options that both commands hand on. most: replicas at most; of: what the time limit is of, in words."""
    return terminal.together(
        terminal.option(
            "--until", terminal.POSITIVE, "Length of a run; default: the scene's duration, or chosen by mpsim."
        ),
        terminal.option("--replicas", click.IntRange(2, most), "Runs per candidate.", 16),
        terminal.option(
            "--starts",
            click.Choice(KINDS),
            "kind: new random starts of the same kind; "
            "same: this start, discs displaced by a thousandth of a diameter.",
        ),
        terminal.option(
            "--contact-time",
            terminal.POSITIVE,
            "Contact time of the reference, if discs come to rest; it is then a model and not exact.",
        ),
        terminal.option("--seconds", terminal.POSITIVE, f"Approximate time limit{of} [s].", 150.0),
    )


def _budget_option(name: str) -> Callable[..., Any]:
    text = f"Largest error of {name.replace('_', ' ')}, {_WORDS.get(UNITS.get(name, ''), 'relative: 0.01 or 1%')}."
    kind = terminal.Share(below=1.0 if OBSERVABLES[name].error == "relative" else math.inf)
    return terminal.option(f"--{name.replace('_', '-')} {name}", kind, text)


TUNE_EXAMPLES = """\b
Examples:
  mpsim tune gas --pressure 1% --overlap 0.05
  mpsim tune my_scene.toml --collision-rate 2% --until 50 --json > tuned.json
"""


@click.command(epilog=TUNE_EXAMPLES, short_help="Find the cheapest settings inside error budgets.")
@click.argument("scene", shell_complete=terminal.complete_scene)
@terminal.together(*map(_budget_option, ERRORS))
@_study_options(tuning.MOST_REPLICAS)
@terminal.json_option
@terminal.quiet_option
def tune(scene: str, as_json: bool, quiet: bool, **how: Any) -> None:
    """Find the cheapest settings whose errors on SCENE stay inside every budget.

    Give at least one budget. Errors without a budget are not limited.
    """
    budgets = {name: how.pop(name) for name in ERRORS}
    asked = {name: budget for name, budget in budgets.items() if budget is not None}
    if not asked:
        names = ", ".join(f"--{name.replace('_', '-')}" for name in ERRORS)
        raise click.UsageError(f"Give at least one budget: {names}.")
    chosen = scenefile.load(scene).scene
    tuned = tuning.tune(chosen, asked, progress=not quiet, **how)
    if as_json:
        tried = [{**row.record(), "verdict": row.verdict, "inside": row.inside} for row in tuned.tried]
        more = {"verified": tuned.verified, "exact": tuned.exact, "tried": tried}
        click.echo(json_text({**dataclasses.asdict(tuned), **more}))
        return
    click.echo(str(tuned))
    usual = vars(settings_for(chosen, None))  # with which `mpsim run` runs it without options
    changed = {name: value for name, value in vars(tuned.settings).items() if value not in (usual[name], None)}
    options = [f"--{name.replace('_', '-')}={value}" for name, value in changed.items()]
    click.echo(f"to run it: {shlex.join(['mpsim', 'run', scene, *options])}")
    click.echo(f"in Python: {settings_text(tuned.settings)}")


TRADEOFF_EXAMPLES = """\b
Examples:
  mpsim tradeoff gas
  mpsim tradeoff gas --measure pressure --measure overlap --until 100 --csv > gas.csv
  mpsim tradeoff hopper --contact-time 0.003
  mpsim tradeoff dense --keep dense.part      (if interrupted, it continues from dense.part)
"""


@click.command(epilog=TRADEOFF_EXAMPLES, short_help="Measure cost and error of settings.")
@click.argument("scene", shell_complete=terminal.complete_scene)
@terminal.option("--measure measures", click.Choice(ERRORS), "An error to measure; default: all.", multiple=True)
@_study_options(tradeoffs.MOST_REPLICAS, " of the reference")
@click.option("--csv", "as_csv", is_flag=True, help="Print CSV.")
@terminal.json_option
@terminal.option("--keep", terminal.FILE, "Save finished runs here; continue from it.")
@terminal.quiet_option
def tradeoff(
    scene: str,
    measures: tuple[str, ...],
    as_csv: bool,
    as_json: bool,
    keep: Path | None,
    quiet: bool,
    **options: Any,
) -> None:
    """Measure the cost of settings on SCENE, and their errors against the exact solver."""
    if as_csv and as_json:
        raise click.UsageError("Choose one of --csv and --json.")
    chosen = scenefile.load(scene).scene
    table = tradeoffs.tradeoff(chosen, measures=measures or None, path=keep, progress=not quiet, **options)
    click.echo((table.to_json() if as_json else table.to_csv() if as_csv else str(table)).rstrip("\n"))
