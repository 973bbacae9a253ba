"""Compares standard errors of runs with the scatter of runs from other starts.

For each kind of run: the scatter of a measure over independent starts, divided by the root mean square of the errors
that the runs themselves claim. 1: right; 2: half of what it should be. What a run calls "not settled" claims no error:
it is left out, and its share is shown.

python scripts/run_calibration.py                          about two minutes on two cores: 100 starts of each kind
python scripts/run_calibration.py --docs docs/accuracy.md  the same, and renew the table of the page
python scripts/run_calibration.py --full                   400 starts, and runs ten times as long
"""

import argparse
import sys
import time
import warnings
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from pages import fill_page, made_by
from rich.console import Console
from run_bench import machine

import mpsim
from mpsim.core.cores import usable_cores
from mpsim.measure import Measure, reference
from mpsim.scene.settings import MethodName

COUNT = 64
PACKINGS = (0.02, 0.3, 0.6)
BOUNDARIES: dict[str, Literal["walls", "periodic"]] = {"closed": "walls", "periodic": "periodic"}
LENGTHS = {"short": 200.0, "long": 2000.0}
"""Collisions of each disc."""

BEFORE = 50.0
"""Collisions of each disc before a run counts."""

METHODS: dict[MethodName, tuple[str, ...]] = {"event": ("short", "long"), "grid": ("short",)}
STEPS = {0.02: 0.2, 0.3: 0.05, 0.6: 0.02}
"""Of `grid` by packing, where a diameter, kT and the mass are 1."""

FRAMES = 2000
"""Of `event`."""

RIGHT = 0.8, 1.25
"""Between these an error counts as right."""

AGAIN = 4
"""Where one does not, so many times as many starts decide: of 100 ratios, each known to 7 %, some lie outside by
chance."""

NAMES = (
    "pressure",
    "pressure_virial",
    "pressure_xx",
    "pressure_yy",
    "pressure_xy",
    "collision_rate",
    "overlap",
    "speed_kurtosis",
)

console = Console()


class Cell(NamedTuple):
    """One kind of run. collisions: of each disc."""

    method: MethodName
    packing: float
    boundary: str
    collisions: float


def measured(cell: Cell, seed: int) -> dict[str, Measure]:
    """The measures of one run from one random start."""
    scene = mpsim.Scene.random(
        count=COUNT, packing=cell.packing, radius=0.5, seed=seed, boundary=BOUNDARIES[cell.boundary]
    )
    rate = reference.enskog_rate(cell.packing)
    dt = STEPS[cell.packing] if cell.method == "grid" else cell.collisions / rate / FRAMES
    names = [name for name in NAMES if name != "pressure_xy" or cell.boundary == "periodic"]
    if cell.method == "event":
        names = [name for name in names if name != "overlap"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", mpsim.FastWarning)
        with mpsim.Simulation(scene, mpsim.Settings(method=cell.method, dt=dt)) as sim:
            sim.run(until=BEFORE / rate)
            return dict(sim.run(until=(BEFORE + cell.collisions) / rate, measures=names).measures)


def ratio(found: Sequence[Measure]) -> tuple[float, float]:
    """Scatter over claimed error of the runs that are settled, NaN for fewer than 10, and the share of the others."""
    settled = [measure for measure in found if measure.settled]
    share = 1 - len(settled) / len(found)
    if len(settled) < 10:
        return float("nan"), share
    scatter = np.std([measure.value for measure in settled], ddof=1)
    return float(scatter / np.sqrt(np.mean([measure.error**2 for measure in settled]))), share


def text_of(found: Sequence[Measure]) -> tuple[str, bool | None]:
    """A cell of the table, and whether it is right; None where nothing is claimed."""
    value, share = ratio(found)
    unsettled = f" ({100 * share:.0f} %)" if share else ""
    if np.isnan(value):
        return f"none{unsettled}", None
    return f"{value:.2f}{unsettled}", RIGHT[0] <= value <= RIGHT[1]


def row(cell: Cell, seeds: int, pool: ProcessPoolExecutor) -> list[tuple[str, bool | None]]:
    """Cells of the table for one kind of run; None for what it does not have."""
    runs = list(pool.map(partial(measured, cell), range(seeds), chunksize=5))
    texts = {name: text_of([run[name] for run in runs]) for name in runs[0]}
    wrong = [name for name, (_, good) in texts.items() if good is False]
    if wrong:
        runs += pool.map(partial(measured, cell), range(seeds, AGAIN * seeds), chunksize=5)
        decided = {name: text_of([run[name] for run in runs]) for name in runs[0]}
        texts |= {name: (f"{decided[name][0]}*", decided[name][1]) for name in wrong}
    return [texts.get(name, ("", None)) for name in NAMES]


def table(seeds: int, lengths: dict[str, float], pool: ProcessPoolExecutor) -> list[str]:
    """Markdown rows, and a line that counts those that are right."""
    lines = [
        f"| method | packing | box | run | {' | '.join(name.replace('_', ' ') for name in NAMES)} |",
        f"|{'---|' * (4 + len(NAMES))}",
    ]
    right = []
    for method, of_method in METHODS.items():
        for packing in PACKINGS:
            for boundary in BOUNDARIES:
                for length in [name for name in lengths if name in of_method or name == "longest"]:
                    started = time.perf_counter()
                    cell = Cell(method, packing, boundary, lengths[length])
                    texts = row(cell, seeds, pool)
                    right += [good for _, good in texts if good is not None]
                    line = f"| {method} | {packing} | {boundary} | {length} | {' | '.join(text for text, _ in texts)} |"
                    lines.append(line)
                    console.print(f"{line} {time.perf_counter() - started:.1f} s", highlight=False, markup=False)
    noise = 100 / np.sqrt(2 * (seeds - 1))
    lines += [
        "",
        f"{COUNT} discs, {seeds} starts of each kind, so each ratio is known to {noise:.0f} %. Short runs have "
        f"{lengths['short']:g} collisions per disc, long runs {lengths['long']:g}. In brackets: the fraction of runs "
        f"that are not settled and were left out; none: nearly all were left out; *: from {AGAIN * seeds} starts, "
        f"because {seeds} gave a ratio beyond the bounds. {sum(right)} of {len(right)} lie between {RIGHT[0]} and "
        f"{RIGHT[1]}.",
    ]
    return lines


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--full", action="store_true")
    parser.add_argument("--seeds", type=int)
    parser.add_argument("--docs", type=Path, help="page whose table is renewed")
    options = parser.parse_args()
    seeds = options.seeds or (400 if options.full else 100)
    lengths = LENGTHS | ({"longest": 20_000.0} if options.full else {})
    with ProcessPoolExecutor(usable_cores()) as pool:
        lines = table(seeds, lengths, pool)
    console.print(lines[-1], highlight=False)
    if options.docs is not None:
        lines += ["", made_by(machine())]
        fill_page(options.docs, "run_calibration", {"table": "\n".join(lines)}, {})
    return 0


if __name__ == "__main__":
    sys.exit(main())
