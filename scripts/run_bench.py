"""The main job: the experiments of the term-project report with mpsim; tables and pictures under results/bench/.

python scripts/run_bench.py            everything, under a minute on two cores
python scripts/run_bench.py --quick    a few seconds
python scripts/run_bench.py --only fixed scaling --workers 4
python scripts/run_bench.py --features                   what each feature of a scene costs
python scripts/run_bench.py --features --before REVISION and the bare scene beside an older version
"""

import argparse
import contextlib
import csv
import dataclasses
import json
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import benchmark
import benchmark_figures as figures
import check_speed
import feature_cost
import harness
import numpy as np
from harness import console, exit_code, is_busy, machine, make_folder, parser_of, progress_bar, say, slowed
from rich import box
from rich.console import Console
from rich.table import Table

import mpsim
from mpsim.scene.settings import LAWS, PRECISIONS

PARTS = ("fixed", "growth", "repeat", "scaling")
SIZES = (100, 300, 1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000)
QUICK_SIZES = (100, 1_000, 10_000)

REPORTS = {"fixed": benchmark.REPORT_FIXED_MS, "growth": benchmark.REPORT_GROWTH_MS}
"""Parts that the report has, with its times."""

terminal = Console()
"""For tables, which end with the terminal's line."""


def arguments() -> argparse.Namespace:
    parser = parser_of(__doc__)
    parser.add_argument("--only", nargs="+", choices=PARTS, default=PARTS, metavar="PART", help=", ".join(PARTS))
    parser.add_argument("--law", choices=LAWS, default="elastic", help="collision law (default: elastic)")
    parser.add_argument("--precision", choices=PRECISIONS, default="float32", help="default: float32, the report's")
    parser.add_argument("--workers", type=int, default=None, help="workers of parallel (default: usable cores)")
    parser.add_argument("--quick", action="store_true", help="fewer frames and sizes: a few seconds")
    parser.add_argument("--features", action="store_true", help="the cost of each feature of a scene instead")
    parser.add_argument("--before", metavar="REVISION", help="with --features: a git revision to compare with")
    parser.add_argument("--out", type=Path, default=Path("results/bench"), help="default: results/bench")
    return parser.parse_args()


def run(options: argparse.Namespace, settings: mpsim.Settings) -> dict[str, Any]:
    """The results of each part that was asked for."""
    sizes = QUICK_SIZES if options.quick else SIZES
    frames, growth_frames = (100, 200) if options.quick else (500, 1000)
    steps = {"fixed": 3, "growth": 3, "repeat": 3, "scaling": len(sizes)}
    results: dict[str, Any] = {"frames": frames, "quick": options.quick}
    with progress_bar() as progress:
        task = progress.add_task("compiling", total=sum(steps[part] for part in options.only))

        def tick(word: str) -> None:
            progress.update(task, advance=1, description=word)

        jobs = {
            "fixed": lambda: benchmark.fixed(settings, frames, tick),
            "growth": lambda: benchmark.growth(settings, growth_frames, tick),
            "repeat": lambda: benchmark.repeat(settings, frames, tick),
            "scaling": lambda: benchmark.scaling(settings, sizes, 0.1 if options.quick else 0.4, tick),
        }
        for part in options.only:
            results[part] = jobs[part]()
    return results


def table(title: str, caption: str, heads: tuple[str, ...], rows: list[list[str]]) -> Table:
    """A table for the terminal, numbers at the right."""
    found = Table(title=title, caption=caption, title_justify="left", caption_justify="left", box=box.SIMPLE_HEAD)
    for head in heads:
        found.add_column(head, justify="left" if head == "method" else "right")
    for row in rows:
        found.add_row(*row)
    return found


def comparison_table(
    title: str, timings: dict[str, benchmark.Timing], report_ms: dict[str, float], busy: bool
) -> Table:
    """Times beside the report's; ratios only if the machine was not busy."""
    rows = []
    for method, timing in timings.items():
        median, mean, report = timing.median * 1e6, timing.mean * 1e6, report_ms[method] * 1e3
        ratios = ["-", "-"] if busy else [f"{report / mean:.4g}", f"{timing.mean / timings['grid'].mean:.4g}"]
        rows.append([method, str(timing.workers), *(f"{cell:.4g}" for cell in (median, mean, report)), *ratios])
    caption = "times of a frame in microseconds; the first frame is in the means, compilation and warm-up are not"
    heads = ("method", "workers", "median", "mean", "report's mean", "report / mpsim", "mean / grid's")
    return table(title, caption, heads, rows)


def scaling_table(timings: list[benchmark.Timing], busy: bool) -> Table:
    methods, rows = (*benchmark.METHODS, "auto"), []
    for discs in sorted({timing.discs for timing in timings}):
        of = {timing.method: timing for timing in timings if timing.discs == discs}
        costs = [f"{of[m].nanoseconds_per_disc:.3g}" if m in of else "-" for m in methods]
        best = min(of[m].median for m in benchmark.METHODS if m in of)
        ratios = of["grid"].median / of["parallel"].median, of["auto"].median / best
        texts = ("-" if busy else f"{ratio:.2f}" for ratio in ratios)
        rows.append([f"{discs:,}", *costs, *texts, f"{of['parallel'].bytes_per_disc:.0f}"])
    caption = "median nanoseconds per disc and frame, packing 0.4, warm; bytes: of the shared block, per disc"
    return table("Scaling", caption, ("discs", *methods, "grid/parallel", "auto/best", "bytes"), rows)


def timings_of(results: dict[str, Any], part: str) -> dict[str, benchmark.Timing]:
    """Timings of `fixed` or `growth`, by method."""
    return results[part].timings if part == "fixed" else results[part]


def show(results: dict[str, Any], settings: mpsim.Settings, out: Path, busy: bool) -> None:
    """Tables on the terminal, pictures in the folder."""
    frames = results["frames"]
    if "fixed" in results:
        fixed: benchmark.Fixed = results["fixed"]
        title = f"Fixed: 100 discs, {frames} frames"
        terminal.print(comparison_table(title, fixed.timings, benchmark.REPORT_FIXED_MS, busy))
        for what, distance in fixed.distances.items():
            console.print(f"  distance {what}: {distance / (2 * fixed.scene.radius):.3g} diameters")
        figures.fixed(fixed.timings, benchmark.REPORT_FIXED_MS, out / "fixed.png")
        figures.final_states(fixed, frames, out / "final_states.png")
        chosen = dataclasses.replace(settings, method="grid")
        mpsim.animate(fixed.scene, chosen, out / "animation.gif", frames // 6, every=5, pixels=320, progress=False)
    if "growth" in results:
        growth = results["growth"]
        title = f"Growth: one disc more after every frame, from 1 disc to {len(growth['grid'].frame_seconds):,}"
        terminal.print(comparison_table(title, growth, benchmark.REPORT_GROWTH_MS, busy))
        figures.growth(growth, benchmark.REPORT_GROWTH_MS, out / "growth.png")
    if "repeat" in results:
        repeat: benchmark.Repeat = results["repeat"]
        guarded, unguarded = ({s.digest() for s in states} for states in (repeat.guarded, repeat.unguarded))
        console.print(f"Repeat: {len(repeat.guarded)} runs with odd/even passes gave {len(guarded)} digest")
        console.print(f"  1, 2, 4 workers: {len(set(repeat.by_workers.values()))} digest, {repeat.by_workers[1]}")
        console.print(f"  {len(repeat.unguarded)} runs with the columns unguarded gave {len(unguarded)} digests")
        figures.repeat(repeat, frames, out / "repeat.png")
    if "scaling" in results:
        timings = results["scaling"]
        crossover = benchmark.crossover(timings)
        terminal.print(scaling_table(timings, busy))
        if not busy:
            words = f"parallel is faster than grid from {crossover:,} discs on" if crossover else "no crossover"
            console.print(f"  {words}")
        figures.scaling(timings, crossover, out / "scaling.png")


def save(results: dict[str, Any], settings: mpsim.Settings, machine_now: dict[str, Any], out: Path) -> None:
    """Every figure as JSON, and the curves as CSV."""
    record: dict[str, Any] = {"machine": machine_now, "settings": vars(settings), "seconds": results["seconds"]}
    for part in REPORTS.keys() & results.keys():
        timings = timings_of(results, part)
        record[part] = {method: _figures_of(timing) for method, timing in timings.items()}
        columns = [timing.frame_seconds for timing in timings.values()]
        rows = zip(range(1, len(columns[0]) + 1), *columns, strict=True)
        _write_csv(out / f"{part}.csv", ["frame", *(f"{method} [s]" for method in timings)], rows)
    if "fixed" in results:
        record["distances"] = results["fixed"].distances
    if "repeat" in results:
        repeat = results["repeat"]
        record["repeat"] = {
            "guarded": [state.digest() for state in repeat.guarded],
            "unguarded": [state.digest() for state in repeat.unguarded],
            "by_workers": repeat.by_workers,
        }
    if "scaling" in results:
        record["scaling"] = [_figures_of(timing) for timing in results["scaling"]]
        _write_csv(out / "scaling.csv", record["scaling"][0], (row.values() for row in record["scaling"]))
    if {"fixed", "growth", "scaling"} <= results.keys() and not results["quick"] and not is_busy(machine_now):
        (out / "summary.md").write_text(summary(results, machine_now))
    (out / "bench.json").write_text(json.dumps(record, indent=1, default=str) + "\n")


def _figures_of(timing: benchmark.Timing) -> dict[str, Any]:
    return {
        "method": timing.method,
        "workers": timing.workers,
        "discs": timing.discs,
        "frames": len(timing.frame_seconds),
        "median_seconds": timing.median,
        "mean_seconds": timing.mean,
        "least_seconds": float(np.min(timing.frame_seconds)),
        "ns_per_disc": timing.nanoseconds_per_disc,
        "bytes_per_disc": timing.bytes_per_disc,
        "digest": timing.digest,
    }


def summary(results: dict[str, Any], machine_now: dict[str, Any]) -> str:
    """The README's table, in Markdown: the report's two experiments and the cost at 100,000 discs."""
    rows = []
    words = {"fixed": "100 discs, 500 frames", "growth": "1 to 1,000 discs, one more after every frame"}
    for part, report_ms in REPORTS.items():
        for method, timing in timings_of(results, part).items():
            report, mean = report_ms[method] * 1e3, timing.mean * 1e6
            name = f"parallel, {timing.workers} workers (report: threads)" if method == "parallel" else method
            rows.append((words[part], name, f"{report:,.0f} µs", f"{mean:.1f} µs", f"{report / mean:,.0f}"))
    for timing in results["scaling"]:
        if timing.discs == 100_000 and timing.method in ("grid", "parallel"):
            name = f"parallel, {timing.workers} workers" if timing.method == "parallel" else timing.method
            scene, cost = "100,000 discs, packing 0.4, steps of 0.01 diameters", timing.nanoseconds_per_disc
            rows.append((scene, name, "-", f"{cost:.1f} ns a disc", "-"))
    heads, versions = ("experiment", "method", "report", "mpsim", "times faster"), machine_now["versions"]
    return (
        f"{harness.table(heads, rows, right=3)}\n\nMean frame times (100,000 discs: median), without compilation, "
        f"on {machine_now['usable_cores']} cores of {machine_now['processor']}, Python {machine_now['python']}, "
        f"numpy {versions['numpy']}, numba {versions['numba']}, "
        f"{machine_now['date'][:10]}, commit {machine_now['commit']}.\n"
    )


def _write_csv(path: Path, header: Iterable[str], rows: Iterable[Iterable[object]]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows(rows)


def features(options: argparse.Namespace, settings: mpsim.Settings, machine_now: dict[str, Any]) -> str:
    """Markdown: cost of each feature, and of the bare scene beside an older version."""
    with contextlib.ExitStack() as stack:
        # First, as a mistyped revision is an error before the long work.
        before = stack.enter_context(check_speed.checkout_of(options.before)) if options.before else None
        status = stack.enter_context(console.status("compiling"))
        parts = [feature_cost.feature_costs(settings, status.update)]
        parts.append(f"10,000 discs, packing 0.40, `grid`, {settings.precision}, {settings.contact}.")
        if before:
            status.update(f"the bare scene beside that of {options.before}")
            scenes = {"bare": {"method": "grid", "precision": settings.precision}}
            found = [check_speed.timed(scenes, before, turn)["bare"] for turn in range(10)]
            low, median, high = harness.quartiles([here / there for here, there, _ in found])
            parts.append(
                f"The bare scene here over the same at {options.before}: {median:.3f} ({low:.3f} to {high:.3f}, "
                f"{len(found)} turns), digests {'equal' if all(same for *_, same in found) else 'DIFFERENT'}."
            )
    parts.append(f"{machine_now['date'][:10]}, commit {machine_now['commit']}, {machine_now['processor']}.")
    return "\n\n".join(parts) + "\n"


def main() -> int:
    options = arguments()
    started = time.perf_counter()
    settings = mpsim.Settings(
        dt=benchmark.DT,
        law=options.law,
        contact="push",  # the report's
        precision=options.precision,
        workers=options.workers,
    )
    make_folder(options.out)
    machine_now = machine()
    if options.features:
        text = features(options, dataclasses.replace(settings, contact="impact", method="grid"), machine_now)
        (options.out / "features.md").write_text(text)
        say(text)
        return 0
    expected = "10 s" if options.quick else "a minute"
    console.print(f"At most {expected} on two idle cores; where kernels must be compiled first, half a minute more.")
    results = run(options, settings)
    machine_now["slowed"].append(slowed())
    results["seconds"] = time.perf_counter() - started
    same = "the report's" if settings.law == "reflect" else "the report has reflect"
    console.print(f"Collision law: {settings.law} ({same}); contact: {settings.contact}")
    busy = is_busy(machine_now)
    if busy:
        console.print(
            f"The machine was busy; no verdict. Load before: {machine_now['load_before']:.2g} on "
            f"{machine_now['usable_cores']} cores; a loop took {max(machine_now['slowed']):.2g} times its shortest "
            "time. Times below hold for now only, and their ratios are left out. Repeat when nothing else runs."
        )
    show(results, settings, options.out, busy)
    save(results, settings, machine_now, options.out)
    console.print(f"{time.perf_counter() - started:.1f} s; tables and pictures are in {options.out}/")
    return 0


if __name__ == "__main__":
    sys.exit(exit_code(main))
