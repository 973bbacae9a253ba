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
import platform
import subprocess
import sys
import time
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import benchmark
import benchmark_figures as figures
import feature_cost
import numpy as np
import psutil
from rich import box
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

import mpsim
from mpsim.core.machine import usable_cores
from mpsim.scene.settings import LAWS, PRECISIONS

PARTS = ("fixed", "growth", "repeat", "scaling")
SIZES = (100, 300, 1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000)
QUICK_SIZES = (100, 1_000, 10_000)

BUSY = 1.25
"""Time of a loop, median over least, from which on other work takes so much of the machine that no ratio is printed."""

console = Console()


def slowed() -> float:
    """How much other work slows this process down: a loop of a millisecond, timed for 0.3 s, median over least."""
    times, end = [], time.perf_counter() + 0.3
    while time.perf_counter() < end:
        started = time.perf_counter()
        sum(range(50_000))
        times.append(time.perf_counter() - started)
    return float(np.median(times) / np.min(times))


def is_busy(machine_now: dict[str, Any]) -> bool:
    """Whether other work disturbs the times, by the load before, or by what it does to a loop before and after."""
    return machine_now["load_before"] > machine_now["usable_cores"] / 2 or max(machine_now["slowed"]) > BUSY


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
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
    columns = (TextColumn("{task.description:28}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    results: dict[str, Any] = {"frames": frames, "quick": options.quick}
    with Progress(*columns, console=console) as progress:
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


def machine() -> dict[str, Any]:
    """What the figures were measured on, and with."""
    commit = subprocess.run(
        ["git", "describe", "--always", "--dirty"],
        cwd=Path(__file__).parent,
        capture_output=True,
        text=True,
        check=False,
    )
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "commit": commit.stdout.strip() or "unknown",
        "processor": _processor(),
        "usable_cores": usable_cores(),
        "memory_bytes": psutil.virtual_memory().total,
        "system": platform.platform(),
        "python": platform.python_version(),
        "versions": {"mpsim": mpsim.__version__} | {name: version(name) for name in ("numpy", "numba", "llvmlite")},
        "load_before": psutil.getloadavg()[0],
        "slowed": [slowed()],
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def comparison_table(
    title: str, timings: dict[str, benchmark.Timing], report_ms: dict[str, float], busy: bool = False
) -> Table:
    """Times beside the report's; ratios only if the machine was not busy."""
    caption = "times of a frame in microseconds; the first frame is in the means, compilation and warm-up are not"
    table = Table(title=title, caption=caption, title_justify="left", caption_justify="left", box=box.SIMPLE_HEAD)
    for column in ("method", "workers", "median", "mean", "report's mean", "report / mpsim", "mean / grid's"):
        table.add_column(column, justify="left" if column == "method" else "right")
    for method, timing in timings.items():
        report = report_ms[method] * 1e3
        mean = timing.mean * 1e6
        to_grid = timing.mean / timings["grid"].mean
        ratios = ["-", "-"] if busy else [f"{report / mean:.4g}", f"{to_grid:.4g}"]
        cells = (timing.median * 1e6, mean, report)
        table.add_row(method, str(timing.workers), *(f"{cell:.4g}" for cell in cells), *ratios)
    return table


def scaling_table(timings: list[benchmark.Timing], busy: bool = False) -> Table:
    caption = "median nanoseconds per disc and frame, packing 0.4, warm; bytes: of the shared block, per disc"
    table = Table(title="Scaling", caption=caption, title_justify="left", caption_justify="left", box=box.SIMPLE_HEAD)
    methods = (*benchmark.METHODS, "auto")
    for column in ("discs", *methods, "grid/parallel", "auto/best", "bytes"):
        table.add_column(column, justify="right")
    for discs in sorted({timing.discs for timing in timings}):
        of = {timing.method: timing for timing in timings if timing.discs == discs}
        costs = [f"{of[m].nanoseconds_per_disc:.3g}" if m in of else "-" for m in methods]
        best = min(of[m].median for m in benchmark.METHODS if m in of)
        table.add_row(
            f"{discs:,}",
            *costs,
            "-" if busy else f"{of['grid'].median / of['parallel'].median:.2f}",
            "-" if busy else f"{of['auto'].median / best:.2f}",
            f"{of['parallel'].bytes_per_disc:.0f}",
        )
    return table


def show(results: dict[str, Any], settings: mpsim.Settings, out: Path, busy: bool) -> None:
    """Tables on the terminal, pictures in the folder."""
    frames = results["frames"]
    if "fixed" in results:
        fixed: benchmark.Fixed = results["fixed"]
        title = f"Fixed: 100 discs, {frames} frames"
        console.print(comparison_table(title, fixed.timings, benchmark.REPORT_FIXED_MS, busy))
        for what, distance in fixed.distances.items():
            console.print(f"  distance {what}: {distance / (2 * fixed.scene.radius):.3g} diameters")
        figures.fixed(fixed.timings, benchmark.REPORT_FIXED_MS, out / "fixed.png")
        figures.final_states(fixed, frames, out / "final_states.png")
        chosen = dataclasses.replace(settings, method="grid")
        mpsim.animate(fixed.scene, chosen, out / "animation.gif", frames // 6, every=5, pixels=320, progress=False)
    if "growth" in results:
        growth = results["growth"]
        title = f"Growth: one disc more after every frame, from 1 disc to {len(growth['grid'].frame_seconds):,}"
        console.print(comparison_table(title, growth, benchmark.REPORT_GROWTH_MS, busy))
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
        console.print(scaling_table(timings, busy))
        if not busy:
            console.print(
                f"  parallel is faster than grid from {crossover:,} discs on" if crossover else "  no crossover"
            )
        figures.scaling(timings, crossover, out / "scaling.png")


def save(results: dict[str, Any], settings: mpsim.Settings, machine_now: dict[str, Any], out: Path) -> None:
    """Every figure as JSON, and the curves as CSV."""
    record: dict[str, Any] = {"machine": machine_now, "settings": vars(settings), "seconds": results["seconds"]}
    for part in ("fixed", "growth"):
        if part in results:
            timings = results[part].timings if part == "fixed" else results[part]
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
        names = list(record["scaling"][0])
        _write_csv(out / "scaling.csv", names, ([row[name] for name in names] for row in record["scaling"]))
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
    rows = ["| experiment | method | report | mpsim | times faster |", "|---|---|---:|---:|---:|"]
    reports = {"fixed": benchmark.REPORT_FIXED_MS, "growth": benchmark.REPORT_GROWTH_MS}
    words = {"fixed": "100 discs, 500 frames", "growth": "1 to 1,000 discs, one more after every frame"}
    for part, report_ms in reports.items():
        timings = results[part].timings if part == "fixed" else results[part]
        for method, timing in timings.items():
            report = report_ms[method] * 1e3
            name = f"parallel, {timing.workers} workers (report: threads)" if method == "parallel" else method
            ratio = f"{report / (timing.mean * 1e6):,.0f}"
            rows.append(f"| {words[part]} | {name} | {report:,.0f} µs | {timing.mean * 1e6:.1f} µs | {ratio} |")
    large = {t.method: t for t in results["scaling"] if t.discs == 100_000}
    for method in ("grid", "parallel"):
        cost = f"{large[method].nanoseconds_per_disc:.1f} ns a disc"
        name = f"parallel, {large[method].workers} workers" if method == "parallel" else method
        rows.append(f"| 100,000 discs, packing 0.4, steps of 0.01 diameters | {name} | - | {cost} | - |")
    versions = machine_now["versions"]
    rows.append("")
    rows.append(
        "Mean frame times (100,000 discs: median), without compilation, "
        f"on {machine_now['usable_cores']} cores of {machine_now['processor']}, Python {machine_now['python']}, "
        f"numpy {versions['numpy']}, numba {versions['numba']}, "
        f"{machine_now['date'][:10]}, commit {machine_now['commit']}."
    )
    return "\n".join(rows) + "\n"


def _write_csv(path: Path, header: list[str], rows: Any) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows(rows)


def make_folder(path: Path) -> None:
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise mpsim.errors.OutputError(
            f"--out must be a folder that can be made and written to; got {str(path)!r} ({error.strerror}). "
            "Choose another place."
        ) from None


def features(options: argparse.Namespace, settings: mpsim.Settings, machine_now: dict[str, Any]) -> str:
    """Markdown: cost of each feature, and of the bare scene beside an older version."""
    with contextlib.ExitStack() as stack:
        # First, as a mistyped revision is an error before the long work.
        before = stack.enter_context(feature_cost.checkout_of(options.before)) if options.before else None
        status = stack.enter_context(console.status("compiling"))
        found = feature_cost.feature_costs(settings, status.update)
        bare = found[0].nanoseconds
        lines = [
            "| scene | ns per disc and frame | over bare | bytes per disc | arrays of its own |",
            "|---|---|---|---|---|",
        ]
        for each in found:
            arrays = ", ".join(each.arrays) or "none"
            cells = (
                each.name,
                f"{each.nanoseconds:.2f}",
                f"{each.nanoseconds / bare:.2f}",
                f"{each.bytes_per_disc:.0f}",
            )
            lines.append(f"| {' | '.join(cells)} | {arrays} |")
        lines += ["", f"10,000 discs, packing 0.40, `grid`, {settings.precision}, {settings.contact}."]
        if before:
            ratios, equal = feature_cost.bare_beside(before, settings, 10, status.update)
            low, median, high = np.percentile(ratios, [25, 50, 75])
            lines += [
                "",
                f"The bare scene here over the same at {options.before}: {median:.3f} ({low:.3f} to {high:.3f}, "
                f"{len(ratios)} turns), digests {'equal' if equal else 'DIFFERENT'}.",
            ]
    lines += ["", f"{machine_now['date'][:10]}, commit {machine_now['commit']}, {machine_now['processor']}."]
    return "\n".join(lines) + "\n"


def main() -> int:
    options = arguments()
    started = time.perf_counter()
    try:
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
            settings = dataclasses.replace(settings, contact="impact", method="grid")
            text = features(options, settings, machine_now)
            (options.out / "features.md").write_text(text)
            console.print(text, highlight=False, markup=False, soft_wrap=True)
            return 0
        expected = "10 s" if options.quick else "a minute"
        console.print(
            f"At most {expected} on two idle cores; where kernels must be compiled first, half a minute more."
        )
        results = run(options, settings)
        machine_now["slowed"].append(slowed())
    except (mpsim.MpsimError, OSError) as error:
        console.print(f"run_bench: {error}", style="red", highlight=False, soft_wrap=True)
        return 2 if isinstance(error, mpsim.InputError | OSError) else 1
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
    sys.exit(main())
