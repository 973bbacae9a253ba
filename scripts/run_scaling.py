"""Frame times by number of workers, measured on this machine.

python scripts/run_scaling.py                                     some minutes, 4 GiB; into docs/performance.md
python scripts/run_scaling.py --discs 100000 --workers 8 --page results/scaling.md

float32, packing 0.4, v dt = 0.02 diameters. Strong scaling has a fixed number of discs, weak scaling 100,000 a worker.
Frames of one number of discs are timed in turns, so that other load falls on each number of workers.
"""

import sys
import warnings
from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import numpy as np
from harness import DOCS, by_turns, exit_code, parser_of, publish, table

import mpsim
from mpsim.core.machine import usable_cores

PAGE = DOCS / "performance.md"

EACH = 100_000
"""Discs of each worker in weak scaling."""

TURNS, TURN = 11, 1e7
"""Turns, and discs times frames in each, for each worker: a turn begins with sleeping workers, which the system wakes
on any core and moves apart within milliseconds."""

HEADS = ("discs", "workers", "ns a disc and frame", "efficiency", "waiting")


def time_frames(discs: int, workers: Sequence[int]) -> dict[int, tuple[float, float]]:
    """Medians of the time of a frame and of waiting in it by number of workers, in turns [s]; one worker is `grid`."""
    scene = mpsim.Scene.random(count=discs, packing=0.4, radius=0.5, temperature=1.0, seed=1)
    with ExitStack() as stack:
        runs = {}
        for number in workers:
            method, several = ("grid", None) if number == 1 else ("parallel", number)
            settings = mpsim.Settings(dt=0.02, precision="float32", method=method, workers=several)
            sim = stack.enter_context(mpsim.Simulation(scene, settings))
            runs[str(number)] = partial(_turn, sim, max(int(TURN * number / discs), 3))
        by_turns(runs, 1)
        found = by_turns(runs, TURNS)
    medians = (np.median(times, axis=0).tolist() for times in found.values())
    return dict(zip(workers, medians, strict=True))


def _turn(sim: mpsim.Simulation, frames: int) -> tuple[float, float]:
    """Time of a frame, and of waiting in it, on average over the workers [s]: medians."""
    report = sim.run(frames=frames)
    return float(np.median(report.frame_seconds)), float(np.median(report.phase_seconds["wait"].mean(axis=1)))


def row(discs: int, workers: int, one: float, seconds: float, wait: float) -> tuple[str, ...]:
    """A row of the table; one: time of all discs on one process [s]."""
    efficiency, waited = one / seconds / workers, 100 * wait / seconds
    return f"{discs:,}", str(workers), f"{seconds / discs * 1e9:.2f}", f"{efficiency:.2f}", f"{waited:.0f} %"


def main() -> None:
    """Measure, and write the tables into the page."""
    parser = parser_of(__doc__)
    parser.add_argument("--discs", type=int, nargs="+", default=[100_000, 1_000_000, 10_000_000])
    parser.add_argument("--workers", type=int, default=usable_cores(), help="most of them; default: usable cores")
    parser.add_argument("--page", type=Path, default=PAGE, help=f"default: {PAGE.name} of the docs")
    options = parser.parse_args()
    if min(options.discs) < options.workers:
        parser.error(f"argument --discs: must be at least {options.workers}, a disc for each worker")
    for kind in (mpsim.FastWarning, mpsim.errors.ResolutionWarning):  # of float32, which this is about
        warnings.simplefilter("ignore", kind)
    workers = [2**power for power in range(options.workers.bit_length())]
    strong, weak = [], []
    for discs in options.discs:
        times = time_frames(discs, workers)
        strong += [row(discs, number, times[1][0], *times[number]) for number in workers]
    one = 0.0
    for number in workers:
        seconds, wait = time_frames(EACH * number, [number])[number]
        one = one or seconds
        weak.append(row(EACH * number, number, one * number, seconds, wait))
    publish(options.page, f"Strong scaling:\n\n{table(HEADS, strong)}\n\nWeak scaling:\n\n{table(HEADS, weak)}")


if __name__ == "__main__":
    sys.exit(exit_code(main))
