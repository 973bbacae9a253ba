"""Accuracy of time steps, and speed of the exact solver: two tables under results/accuracy/.

bias.md: pressure of 100 discs in a closed box, push and impact against the exact solver. exact_speed.md: collisions
a second of the exact solver on one core, with the energy of the same runs.

python scripts/run_accuracy.py                about two minutes
python scripts/run_accuracy.py --quick        some twenty seconds, with larger errors
python scripts/run_accuracy.py --only speed   one of the two tables: bias or speed
"""

import argparse
import subprocess
import sys
import time
import warnings
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track

import mpsim
from mpsim.measure import Measure, fit_order, independent_average, kinetic_energy, reference
from mpsim.scene.settings import Contact

PACKINGS = (0.3, 0.5)
STEPS = (0.2, 0.1, 0.05, 0.02)
CANDIDATES: tuple[tuple[Contact, int], ...] = (("push", 1), ("impact", 1), ("impact", 2))
COUNT = 100
SPEED_COUNTS = (100, 10_000, 1_000_000)
SPEED_PACKING = 0.4

console = Console()


def compressibility(packing: float, seeds: int, until: float, settings: mpsim.Settings) -> tuple[Measure, float]:
    """P A / (N kT) from the walls, mean of independent starts, and the median frame time [µs]."""
    values, frame_times = [], []
    for seed in range(seeds):
        scene = mpsim.Scene.random(count=COUNT, packing=packing, radius=0.5, seed=seed)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", mpsim.FastWarning)  # what long steps do is what is measured
            with mpsim.Simulation(scene, settings) as sim:
                sim.run(until=100)
                report = sim.run(until=100 + until, measures=["pressure"])
        values.append(report.measures["pressure"].value * scene.width * scene.height / COUNT)
        frame_times.append(np.median(report.frame_seconds) * 1e6)
    return independent_average(values), float(np.median(frame_times))


def rows(packing: float, seeds: int, until: float) -> list[str]:
    """Markdown rows of one packing fraction."""
    exact, _ = compressibility(packing, seeds, until, mpsim.Settings(method="event", dt=1.0))
    lines = [f"| {packing} | event | exact | | {exact} | | |"]
    for contact, passes in CANDIDATES:
        found = []
        for h in STEPS:
            settings = mpsim.Settings(method="naive", dt=h, contact=contact, passes=passes)
            value, microseconds = compressibility(packing, seeds, until, settings)
            bias = Measure(
                100 * (value.value / exact.value - 1),
                100 * float(np.hypot(value.error, exact.error)) / exact.value,
                seeds,
            )
            found.append(bias)
            lines.append(f"| {packing} | {contact} | {passes} | {h} | {value} | {bias} % | {microseconds:.2f} µs |")
        try:
            order = str(fit_order(STEPS[:3], [b.value for b in found[:3]], [b.error for b in found[:3]]))
        except mpsim.InputError:  # the bias of the smallest step drowned in noise, and has the other sign
            order = "not resolved"
        lines.append(f"| {packing} | {contact} | {passes} | order, h >= 0.05 | | {order} | |")
    return lines


def exact_speed(count: int, collisions: float, repeats: int) -> str:
    """Markdown row: collisions a second through `Simulation.run`, best and median of repeats, and the energy's drift.

    One frame of about so many collisions, by the rate of the bulk, after as much time for a lattice to melt.
    """
    scene = mpsim.Scene.random(count=count, packing=SPEED_PACKING, radius=0.5, seed=1)
    frame = 2 * collisions / (count * reference.enskog_rate(SPEED_PACKING))
    with mpsim.Simulation(scene, mpsim.Settings(method="event", dt=frame)) as sim:
        sim.run(frames=1)
        before, done, rates = kinetic_energy(sim.state, scene), 0, []
        for _ in range(repeats):
            started = time.perf_counter()
            report = sim.run(frames=1)
            rates.append(report.collisions / (time.perf_counter() - started) / 1e6)
            done += report.collisions
        drift = abs(kinetic_energy(sim.state, scene) / before - 1)
    return f"| {count:,} | {max(rates):.2f} | {np.median(rates):.2f} | {done:,} | {drift:.0e} |"


def write_speed(out: Path, quick: bool) -> None:
    """Write the table of the exact solver's speed."""
    lines = ["| discs | million collisions/s, best | median | collisions | energy drift |", "|---|---|---|---|---|"]
    for count in track(SPEED_COUNTS, "exact solver", console=console):
        lines.append(exact_speed(count, 2e5 if quick else 1e6, 3 if quick else 7))
    lines += ["", f"Packing {SPEED_PACKING}, one core, all of `Simulation.run` counted; {stamp()}."]
    publish(out / "exact_speed.md", lines)


def stamp() -> str:
    """Date and commit."""
    commit = subprocess.run(["git", "describe", "--always"], capture_output=True, text=True, check=False).stdout.strip()
    return f"{datetime.now(UTC):%Y-%m-%d}, commit {commit}"


def publish(path: Path, lines: list[str]) -> None:
    """Write a table and show it."""
    path.write_text("\n".join(lines) + "\n")
    console.print("\n".join(lines), highlight=False, markup=False)


def write_bias(out: Path, quick: bool) -> None:
    """Write the table of pressures against the step."""
    seeds, until = (3, 500.0) if quick else (4, 4000.0)
    lines = ["| packing | contact | passes | h | P A / (N kT) | bias | frame |", "|---|---|---|---|---|---|---|"]
    for packing in track(PACKINGS, "packing fractions", console=console):
        lines += rows(packing, seeds, until)
    lines += ["", f"{seeds} starts, {until:g} units of time each; {stamp()}."]
    publish(out / "bias.md", lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--only", choices=("bias", "speed"))
    parser.add_argument("--out", type=Path, default=Path("results/accuracy"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for name, write in (("speed", write_speed), ("bias", write_bias)):
        if options.only in (None, name):
            write(options.out, options.quick)
    return 0


if __name__ == "__main__":
    sys.exit(main())
