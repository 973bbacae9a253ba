"""`mpsim clean`: removes shared memory left by killed programs."""

import dataclasses

import click

from mpsim.core.plain import json_text
from mpsim.engine.workers import shared


@click.command(
    short_help="Remove shared memory of programs that were killed.",
    epilog="\b\nExamples:\n  mpsim clean --dry-run\n  mpsim clean",
)
@click.option("--dry-run", is_flag=True, help="Only list what would be removed.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON: name, size and process of each.")
def clean(dry_run: bool, as_json: bool) -> None:
    """Remove shared memory of mpsim whose owner is dead, and nothing else.

    It is left behind only if a simulation and its helper processes are all killed at the same moment.
    """
    blocks = shared.stale_blocks() if dry_run else shared.remove_stale_blocks()
    if as_json:
        click.echo(json_text([dataclasses.asdict(block) for block in blocks]))
        return
    for block in blocks:
        click.echo(f"{block.name}  {block.nbytes:,} bytes, of process {block.pid}")
    total = sum(block.nbytes for block in blocks)
    verb = "would be removed" if dry_run else "removed"
    click.echo(f"{len(blocks)} blocks {verb}, {total:,} bytes")
