"""`mpsim bench`, `mpsim warmup` and `mpsim completion`: benchmarks and setup on this machine."""

import time
from typing import Any

import click

from mpsim.cli import terminal
from mpsim.core.cores import usable_cores
from mpsim.core.plain import json_text
from mpsim.engine.simulation import Simulation
from mpsim.kernels.compiling import compiled_kernels
from mpsim.scene import scenefile
from mpsim.scene.settings import LAWS, PRECISIONS, Law, Precision, Settings
from mpsim.studies import benchmark

BENCH_EXAMPLES = """\b
Examples:
  mpsim bench                          a few seconds
  mpsim bench --count 3000 --workers 4 --json
All of it, with pictures: python scripts/run_bench.py in a checkout.
"""


@click.command(epilog=BENCH_EXAMPLES, short_help="Measure how fast mpsim is here.")
@click.option(
    "--count",
    type=terminal.Whole(1, 3000),
    default=100,
    show_default=True,
    help="Number of discs; limited, as one method tests all pairs.",
)
@click.option("--frames", type=terminal.Whole(1, 100_000), default=500, show_default=True)
@click.option(
    "--workers",
    type=terminal.Whole(1, terminal.MOST_WORKERS),
    help="Workers of the method parallel; default: one per core.",
)
@click.option("--law", type=terminal.Choice(LAWS), default="elastic", show_default=True)
@click.option(
    "--precision",
    type=terminal.Choice(PRECISIONS),
    default="float32",
    show_default=True,
    help="The report used float32.",
)
@terminal.json_option
@terminal.quiet_option
def bench(
    count: int, frames: int, workers: int | None, law: Law, precision: Precision, as_json: bool, quiet: bool
) -> None:
    """Repeat the first experiment of the term-project report: time each method on the same gas.

    The results are checked in the same run. Times do not include compilation.
    """
    settings = Settings(dt=benchmark.DT, law=law, contact="push", precision=precision, workers=workers)
    with terminal.progress(quiet) as progress:
        done = iter(range(1, len(benchmark.METHODS) + 1))
        tick = _silent if progress is None else lambda word: progress(next(done), len(benchmark.METHODS), word)
        timings = benchmark.fixed(settings, frames, tick, count).timings
    rows = [_row(timing, count) for timing in timings.values()]
    if as_json:
        click.echo(json_text({"discs": count, "frames": frames, "cores": usable_cores(), "methods": rows}))
        return
    click.echo(f"{count} discs, {frames} frames, packing {benchmark.PACKING}, {precision}, on {usable_cores()} cores:")
    for row in rows:
        ours = f"median {row['median_seconds'] * 1e6:8.1f} us a frame, mean {row['mean_seconds'] * 1e6:8.1f} us"
        report = f" (in the report: {row['report_seconds'] * 1e6:.0f} us)" if row["report_seconds"] else ""
        click.echo(f"  {row['method']:8} {row['workers']:2} worker{'s' * (row['workers'] > 1):1} {ours}{report}")
    click.echo(f"grid and parallel gave the same bits: {timings['grid'].digest}")


def _silent(word: str) -> None:
    pass


def _row(timing: benchmark.Timing, count: int) -> dict[str, Any]:
    report = benchmark.REPORT_FIXED_MS[timing.method] * 1e-3 if count == 100 else None
    return {
        "method": timing.method,
        "workers": timing.workers,
        "median_seconds": timing.median,
        "mean_seconds": timing.mean,
        "report_seconds": report,
        "digest": timing.digest,
    }


WARMUP_EXAMPLES = """\b
Examples:
  mpsim warmup                         for all scenes that come with mpsim: minutes, once
  mpsim warmup gas hopper
  mpsim warmup my_scene.toml --precision float32
"""


@click.command(epilog=WARMUP_EXAMPLES, short_help="Compile ahead of the first run.")
@click.argument("scenes", nargs=-1, shell_complete=terminal.complete_scene)
@terminal.settings_options
@terminal.json_option
@terminal.quiet_option
def warmup(scenes: tuple[str, ...], as_json: bool, quiet: bool, **options: Any) -> None:
    """Compile the loops that SCENES need, so that their first run starts at once. The result is kept.

    A kernel is compiled for each combination of features, so scenes with the same ones share theirs.
    """
    files = [scenefile.load(scene) for scene in scenes or scenefile.names()]
    found: list[dict[str, Any]] = []
    with terminal.progress(quiet) as progress:
        for number, file in enumerate(files):
            if progress is not None:
                progress(number, len(files), file.name)
            before, started = compiled_kernels(), time.perf_counter()
            with Simulation(file.scene, terminal.settings_of(file, options)) as sim:
                sim.run(frames=0)
            seconds, kernels = time.perf_counter() - started, compiled_kernels() - before
            found.append({"scene": file.name, "seconds": seconds, "kernels": kernels})
    if as_json:
        click.echo(json_text(found))
        return
    for row in found:
        click.echo(f"{row['scene']:12} {row['seconds']:6.1f} s, {row['kernels']} kernels compiled or loaded")


COMPLETION_EXAMPLES = """\b
Examples:
  mpsim completion bash >> ~/.bashrc
  mpsim completion zsh >> ~/.zshrc
  mpsim completion fish > ~/.config/fish/completions/mpsim.fish
"""


@click.command(epilog=COMPLETION_EXAMPLES, short_help="Print the completion script of a shell.")
@click.argument("shell", type=terminal.Choice(["bash", "zsh", "fish"]))
def completion(shell: str) -> None:
    """Print a script with which SHELL completes commands, options and scenes of mpsim."""
    from click.shell_completion import get_completion_class  # noqa: PLC0415 - only here

    kind = get_completion_class(shell)
    assert kind is not None  # click knows these three
    root = click.get_current_context().find_root().command
    click.echo(kind(root, {}, "mpsim", "_MPSIM_COMPLETE").source())
