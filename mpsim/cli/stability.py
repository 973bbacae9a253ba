"""`mpsim stability`: runs the trials of the stability map on this machine."""

from pathlib import Path

import click

from mpsim.cli import terminal
from mpsim.core import atomic

EXAMPLES = """\b
Examples:
  mpsim stability --only step --only places
  mpsim stability --out stability/            (also heat maps; some minutes)
"""


@click.command(epilog=EXAMPLES, short_help="Test every method on extreme scenes.")
@click.option(
    "--only", "axes", multiple=True, metavar="AXIS", help="What to vary, such as step or box; default: everything."
)
@click.option("--full", is_flag=True, help="Include the long trials: millions of discs, a million frames.")
@click.option("--json", "as_json", is_flag=True, help="Print every outcome as JSON.")
@click.option("--out", type=click.Path(file_okay=False, path_type=Path), help="Folder for JSON and heat maps.")
@terminal.quiet_option
def stability(axes: tuple[str, ...], full: bool, as_json: bool, out: Path | None, quiet: bool) -> None:
    """Try every method, contact, law and precision on extreme scenes, and report the outcomes.

    Each trial is correct, degraded (an error is large, with a warning) or refused. Any other outcome is a bug,
    and the exit code is 1.
    """
    from mpsim.studies import stability as trials  # noqa: PLC0415 - not needed by any other command

    chosen = trials.trials(axes or None, full)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
    with terminal.progress(quiet) as progress:
        outcomes = trials.run_trials(chosen, progress=progress)
    if out is not None:
        from mpsim.output import stability_map  # noqa: PLC0415 - matplotlib

        atomic.write_text(out / "stability.json", trials.to_json(outcomes))
        stability_map.save(outcomes, out)
    click.echo(trials.to_json(outcomes) if as_json else trials.counts_table(outcomes))
    found = trials.counts(outcomes)
    if any(found[kind] for kind in trials.FORBIDDEN):
        raise click.exceptions.Exit(1)
