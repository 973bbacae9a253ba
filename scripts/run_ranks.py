"""Frame times on MPI ranks, compared with workers.

python scripts/run_ranks.py                       some two minutes on two cores; needs mpi4py and an MPI library
python scripts/run_ranks.py --discs 30000 --page results/ranks.md

Packing 0.4, v dt = 0.02 diameters, float32, without measures. Each kind of run takes its turn, in processes of its own.
"""

import argparse
import json
import subprocess
import sys
import time
import warnings
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from harness import DOCS, by_turns, exit_code, parser_of, publish, table, with_quartiles

import mpsim
from mpsim.engine.solvers.ranks.messages import MpiRanks

PAGE = DOCS / "scaling.md"
MPIEXEC = Path(sys.executable).with_name("mpiexec")

KINDS = {
    "grid": (1, {"method": "grid"}),
    "2 workers": (1, {"method": "parallel", "workers": 2}),
    "1 rank": (1, {"method": "mpi"}),
    "2 ranks": (2, {"method": "mpi"}),
}
"""Ranks, and settings."""

TURNS, RUNS = 5, 5
"""Of each kind, and runs in a turn, of which the median counts."""

FRAMES = 30_000_000
"""Frames of a run, times discs."""


def frame_seconds(discs: int, settings: dict[str, Any]) -> float:
    """Median time of a frame in this process, or on these ranks."""
    scene = mpsim.Scene.random(count=discs, packing=0.4, radius=0.5, temperature=1.0, seed=1)
    with mpsim.Simulation(scene, mpsim.Settings(dt=0.02, precision="float32", **settings)) as sim:
        sim.run(frames=30)
        times, frames = [], FRAMES // discs
        for _ in range(RUNS):
            began = time.perf_counter()
            sim.run(frames=frames)
            times.append((time.perf_counter() - began) / frames)
    return float(np.median(times))


def in_processes(discs: int, kind: str) -> float:
    """`frame_seconds` of a kind of run, in processes of its own."""
    number, settings = KINDS[kind]
    begin = [str(MPIEXEC), "-n", str(number)] if settings["method"] == "mpi" else []
    command = [*begin, sys.executable, __file__, "--one", json.dumps([discs, settings])]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=600)
    return json.loads(done.stdout.splitlines()[-1])


def tell_one(task: str) -> None:
    """Print the result of `frame_seconds`, on the first rank."""
    warnings.simplefilter("ignore")
    discs, settings = json.loads(task)
    seconds = frame_seconds(discs, settings)
    if settings["method"] != "mpi" or MpiRanks().rank == 0:
        print(json.dumps(seconds))


def report(sizes: list[int]) -> str:
    """The table, in Markdown."""
    rows: list[tuple[str, ...]] = []
    for discs in sizes:
        times = by_turns({kind: partial(in_processes, discs, kind) for kind in KINDS}, TURNS)
        grid = np.array(times["grid"])
        for kind, seconds in times.items():
            costs, ratio = np.array(seconds) / discs * 1e9, np.median(grid / seconds)
            rows.append((f"{discs:,}", kind, with_quartiles(costs), f"{ratio:.2f}"))
    return table(("discs", "", "ns per disc and frame", "speed relative to grid"), rows)


def main() -> None:
    """Measure, and write the table into the page."""
    parser = parser_of(__doc__)
    parser.add_argument("--discs", type=int, nargs="+", default=[30_000, 300_000])
    parser.add_argument("--page", type=Path, default=PAGE, help=f"default: {PAGE.name} of the docs")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        tell_one(options.one)
        return
    publish(options.page, report(options.discs))


if __name__ == "__main__":
    sys.exit(exit_code(main))
