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
from mpsim.core import files
from mpsim.core.files import CSV, JSON
from mpsim.core.text import json_text
from mpsim.measure.registry import ERRORS, OBSERVABLES
from mpsim.output.tables import UNITS
from mpsim.scene import scenefile
from mpsim.scene.scene import settings_for
from mpsim.scene.settings import Settings
from mpsim.studies import tradeoff as tradeoffs
from mpsim.studies import tune as tuning
from mpsim.studies.preliminary import KINDS

_WORDS = {"1/time": "per unit of time", "diam.": "in diameters"}

until_option = click.option(
    "--until",
    type=terminal.POSITIVE,
    help="Length of a run; default: the scene's duration, or chosen by mpsim.",
)


def replicas_option(most: int) -> Callable[..., Any]:
    """The option --replicas of a command that takes at most so many."""
    return click.option(
        "--replicas", type=terminal.Whole(2, most), default=16, show_default=True, help="Runs per candidate."
    )


starts_option = click.option(
    "--starts",
    type=click.Choice(KINDS),
    help="kind: new random starts of the same kind; same: this start, discs displaced by a thousandth of a diameter.",
)
contact_time_option = click.option(
    "--contact-time",
    type=terminal.POSITIVE,
    help="Contact time of the reference, if discs come to rest; it is then a model and not exact.",
)


def _budget_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """One option for each measure that can have a budget."""
    for name in reversed(ERRORS):
        unit = _WORDS.get(UNITS.get(name, ""), "relative: 0.01 or 1%")
        text = f"Largest error of {name.replace('_', ' ')}, {unit}."
        kind = terminal.Share(below=1.0 if OBSERVABLES[name].error == "relative" else math.inf)
        command = click.option(f"--{name.replace('_', '-')}", name, type=kind, help=text)(command)
    return command


TUNE_EXAMPLES = """\b
Examples:
  mpsim tune gas --pressure 1% --overlap 0.05
  mpsim tune my_scene.toml --collision-rate 2% --until 50 --json > tuned.json
"""


@click.command(epilog=TUNE_EXAMPLES, short_help="Find the cheapest settings inside error budgets.")
@click.argument("scene", shell_complete=terminal.complete_scene)
@_budget_options
@until_option
@replicas_option(tuning.MOST_REPLICAS)
@starts_option
@contact_time_option
@click.option("--seconds", type=terminal.POSITIVE, default=150.0, show_default=True, help="Approximate time limit [s].")
@terminal.json_option
@terminal.quiet_option
def tune(
    scene: str,
    until: float | None,
    replicas: int,
    starts: str | None,
    contact_time: float | None,
    seconds: float,
    as_json: bool,
    quiet: bool,
    **budgets: float | None,
) -> None:
    """Find the cheapest settings whose errors on SCENE stay inside every budget.

    Give at least one budget. Errors without a budget are not limited.
    """
    asked = {name: budget for name, budget in budgets.items() if budget is not None}
    if not asked:
        options = ", ".join(f"--{name.replace('_', '-')}" for name in ERRORS)
        raise click.UsageError(f"Give at least one budget: {options}.")
    chosen = scenefile.load(scene).scene
    with terminal.progress(quiet) as progress:
        how: dict[str, Any] = {"replicas": replicas, "starts": starts, "seconds": seconds, "progress": progress}
        how["contact_time"] = contact_time
        tuned = tuning.tune(chosen, asked, until=until, **how)
    if as_json:
        click.echo(json_text(_record(tuned)))
        return
    click.echo(str(tuned))
    click.echo(f"to run it: {_run_command(scene, settings_for(chosen, None), tuned.settings)}")
    click.echo(f"in Python: {settings_text(tuned.settings)}")


def _run_command(scene: str, recommended: Settings, settings: Settings) -> str:
    """The command that runs a scene with settings; without options it runs with those that the scene recommends."""
    usual = vars(recommended)
    changed = {name: value for name, value in vars(settings).items() if value != usual[name] and value is not None}
    return shlex.join(
        ["mpsim", "run", scene, *(f"--{name.replace('_', '-')}={value}" for name, value in changed.items())]
    )


def _record(tuned: tuning.Tuned) -> dict[str, Any]:
    """The answer as plain values."""
    tried = [{**trial.row.record(), "verdict": trial.verdict, "inside": trial.inside} for trial in tuned.tried]
    return {**dataclasses.asdict(tuned), "verified": tuned.verified, "exact": tuned.exact, "tried": tried}


TRADEOFF_EXAMPLES = """\b
Examples:
  mpsim tradeoff gas
  mpsim tradeoff gas --measure pressure --measure overlap --until 100 --csv
  mpsim tradeoff hopper --contact-time 0.003
  mpsim tradeoff dense --out dense.json --keep dense.part      (if interrupted, it continues from dense.part)
"""


@click.command(epilog=TRADEOFF_EXAMPLES, short_help="Measure cost and error of settings.")
@click.argument("scene", shell_complete=terminal.complete_scene)
@click.option(
    "--measure", "measures", type=click.Choice(ERRORS), multiple=True, help="An error to measure; default: all."
)
@until_option
@replicas_option(tradeoffs.MOST_REPLICAS)
@starts_option
@contact_time_option
@click.option(
    "--seconds",
    type=terminal.POSITIVE,
    default=150.0,
    show_default=True,
    help="Approximate time limit of the reference [s].",
)
@click.option("--csv", "as_csv", is_flag=True, help="Print CSV.")
@terminal.json_option
@click.option(
    "--out",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write to a file: CSV if it ends in .csv, JSON in .json.",
)
@click.option(
    "--keep", type=click.Path(dir_okay=False, path_type=Path), help="Save finished runs here; continue from it."
)
@click.option("--force", is_flag=True, help="Replace the file of --out.")
@terminal.quiet_option
def tradeoff(
    scene: str,
    measures: tuple[str, ...],
    until: float | None,
    replicas: int,
    starts: str | None,
    contact_time: float | None,
    seconds: float,
    as_csv: bool,
    as_json: bool,
    out: Path | None,
    keep: Path | None,
    force: bool,
    quiet: bool,
) -> None:
    """Measure the cost of settings on SCENE, and their errors against the exact solver."""
    if as_csv and as_json:
        raise click.UsageError("Choose one of --csv and --json.")
    if out is not None:
        if out.suffix.lower() not in (CSV, JSON):
            raise click.UsageError(f"--out must end in .csv or .json; got {str(out)!r}. Use {out.stem}.csv.")
        terminal.existing_refused(out, force)
        with files.writable("--out", out):
            files.check_target(out)  # before the long work, not after
    chosen = scenefile.load(scene).scene
    with terminal.progress(quiet) as progress:
        how: dict[str, Any] = {"replicas": replicas, "starts": starts, "seconds": seconds, "path": keep}
        how |= {"contact_time": contact_time, "progress": progress}
        table = tradeoffs.tradeoff(chosen, None, until, measures or None, **how)
    if out is None:
        click.echo(table.to_json() if as_json else table.to_csv() if as_csv else str(table), nl=False)
        return
    {CSV: table.to_csv, JSON: table.to_json}[out.suffix.lower()](out)
    number = len(table.rows)
    click.echo(f"{number} candidate{'s' * (number != 1)} written to {out}", err=True)
