"""What a step costs in accuracy: pressure of 100 discs in a closed box, push and impact against the exact solver.

python scripts/run_accuracy.py            about two minutes; table under results/accuracy/
python scripts/run_accuracy.py --quick    some twenty seconds, with larger errors
"""

import argparse
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track

import mpsim
from mpsim.measure import Measure, fit_order, independent_average

PACKINGS = (0.3, 0.5)
STEPS = (0.2, 0.1, 0.05, 0.02)
CANDIDATES = (("push", 1), ("impact", 1), ("impact", 2))
COUNT = 100

console = Console()


def compressibility(packing: float, seeds: int, time: float, settings: mpsim.Settings) -> tuple[Measure, float]:
    """P A / (N kT) from the walls, mean of independent starts, and the median frame time [µs]."""
    values, frame_times = [], []
    for seed in range(seeds):
        scene = mpsim.Scene.random(count=COUNT, packing=packing, radius=0.5, seed=seed)
        with mpsim.Simulation(scene, settings) as sim:
            sim.run(until=100)
            report = sim.run(until=100 + time, measures=["pressure"])
        values.append(report.measures["pressure"].value * scene.width * scene.height / COUNT)
        frame_times.append(np.median(report.frame_seconds) * 1e6)
    return independent_average(values), float(np.median(frame_times))


def rows(packing: float, seeds: int, time: float) -> list[str]:
    """Markdown rows of one packing fraction."""
    exact, _ = compressibility(packing, seeds, time, mpsim.Settings(method="event", dt=1.0))
    lines = [f"| {packing} | event | exact | | {exact} | | |"]
    for contact, passes in CANDIDATES:
        found = []
        for h in STEPS:
            settings = mpsim.Settings(method="naive", dt=h, contact=contact, passes=passes)
            value, microseconds = compressibility(packing, seeds, time, settings)
            bias = Measure(
                100 * (value.value / exact.value - 1),
                100 * float(np.hypot(value.error, exact.error)) / exact.value,
                seeds,
            )
            found.append(bias)
            lines.append(f"| {packing} | {contact} | {passes} | {h} | {value} | {bias} % | {microseconds:.2f} µs |")
        order = fit_order(STEPS[:3], [b.value for b in found[:3]], [b.error for b in found[:3]])
        lines.append(f"| {packing} | {contact} | {passes} | order, h >= 0.05 | | {order} | |")
    return lines


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--out", type=Path, default=Path("results/accuracy"))
    options = parser.parse_args()
    seeds, time = (3, 500.0) if options.quick else (4, 4000.0)
    options.out.mkdir(parents=True, exist_ok=True)
    lines = ["| packing | contact | passes | h | P A / (N kT) | bias | frame |", "|---|---|---|---|---|---|---|"]
    for packing in track(PACKINGS, "packing fractions", console=console):
        lines += rows(packing, seeds, time)
    commit = subprocess.run(["git", "describe", "--always"], capture_output=True, text=True, check=False).stdout.strip()
    lines += ["", f"{seeds} starts, {time:g} units of time each; {datetime.now(UTC):%Y-%m-%d}, commit {commit}."]
    (options.out / "bias.md").write_text("\n".join(lines) + "\n")
    console.print("\n".join(lines), highlight=False, markup=False)
    return 0


if __name__ == "__main__":
    sys.exit(main())
