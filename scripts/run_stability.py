"""Runs the trials of the stability map: every method, contact, law and precision on extreme scenes.

python scripts/run_stability.py                    all axes, under three minutes on two cores once kernels are compiled
python scripts/run_stability.py --only step map    some of them
python scripts/run_stability.py --full             also millions of discs and a million frames: a quarter of an hour
python scripts/run_stability.py --docs docs/stability.md    and renew that page, its pictures and its outcomes.json.gz
python scripts/run_stability.py --draw docs/stability/outcomes.json.gz    only the pictures, of outcomes that were kept
python scripts/run_stability.py --cost             only the fraction of a run's time that checks of speeds take

Everything is written under results/stability/. Exit code 1 if anything forbidden was found.
"""

import argparse
import gzip
import statistics
import sys
import time
from pathlib import Path

import stability
import stability_map
from harness import console, exit_code, fill_page, machine, made_by, make_folder, parser_of, progress_bar, say
from stability import AXES

import mpsim
from mpsim.engine import step_limits
from mpsim.engine.solvers import speeds


def arguments() -> argparse.Namespace:
    parser = parser_of(__doc__)
    axes = [*AXES, stability.MAP]
    parser.add_argument("--only", nargs="+", choices=axes, metavar="AXIS", help=", ".join(axes))
    parser.add_argument("--full", action="store_true", help="also the long trials")
    parser.add_argument("--cost", action="store_true", help="measure the time of checks of speeds, nothing else")
    parser.add_argument("--draw", type=Path, metavar="FILE", help="draw these outcomes again, without any trial")
    parser.add_argument("--workers", type=int, default=2, help="processes that try at the same time (default: 2)")
    parser.add_argument("--out", type=Path, default=Path("results/stability"), help="default: results/stability")
    parser.add_argument("--docs", type=Path, help="page whose tables and pictures are renewed: docs/stability.md")
    return parser.parse_args()


def cost() -> None:
    """Median time of a frame and of a check of the speeds, and the fraction of a run that checks take."""
    for count in (100, 8192, 100_000):
        scene = mpsim.Scene.random(count=count, packing=0.4, radius=0.5, seed=1)
        with mpsim.Simulation(scene, mpsim.Settings(dt=0.01, method="grid")) as sim:
            frame = statistics.median(sim.run(frames=100).frame_seconds)
            looks = []
            for _ in range(30):
                started = time.perf_counter()
                speeds.speeds_of(sim.state.velocity, scene.radii, scene)
                looks.append(time.perf_counter() - started)
        look, every = statistics.median(looks), step_limits.StepLimits(scene, sim.settings).frames_ahead(0, count)
        say(f"{count:,} discs: a frame {frame:.3g} s, a look {look:.3g} s, {look / every / frame:.2%} of a run")


def draw(kept: Path, out: Path) -> None:
    """Draw the outcomes in a file, JSON or JSON in gzip."""
    make_folder(out)
    data = kept.read_bytes()
    text = gzip.decompress(data) if kept.suffix == ".gz" else data
    stability_map.save(stability.from_json(text.decode()), out)


def run(options: argparse.Namespace) -> int:
    """Run the trials, write everything; 1 if an outcome is forbidden."""
    make_folder(options.out)
    chosen = stability.trials(options.only, options.full)
    with progress_bar() as progress:
        task = progress.add_task("starting", total=len(chosen))
        outcomes = stability.run_trials(
            chosen, options.workers, lambda words: progress.update(task, advance=1, description=words)
        )
    machine_now = machine()
    kept = stability.to_json(outcomes, machine=machine_now)
    (options.out / "stability.json").write_text(kept)
    stability_map.save(outcomes, options.out)
    table, worst = stability.counts_table(outcomes), stability.findings_table(outcomes)
    made = made_by(machine_now)
    (options.out / "stability.md").write_text(f"{table}\n\n{worst}\n\n{made}\n")
    say(table)
    say(worst)
    if options.docs:
        pictures = {picture.name: picture for picture in options.out.glob("*.png")}
        fill_page(options.docs, {"counts": table, "findings": worst, "made": made}, pictures)
        (options.docs.with_suffix("") / "outcomes.json.gz").write_bytes(gzip.compress(kept.encode(), mtime=0))
    found = stability.counts(outcomes)
    return int(any(found[kind] for kind in stability.FORBIDDEN))


def main() -> int:
    options = arguments()
    started = time.perf_counter()
    if options.cost:
        cost()
        return 0
    if options.draw:
        draw(options.draw, options.out)
        return 0
    code = run(options)
    console.print(f"{time.perf_counter() - started:.1f} s; all is in {options.out}/")
    return code


if __name__ == "__main__":
    sys.exit(exit_code(main))
