"""Frame times on MPI ranks, compared with workers, and a model of larger machines.

python scripts/run_ranks.py                       some two minutes on two cores; needs mpi4py and an MPI library
python scripts/run_ranks.py --discs 30000 --page results/ranks.md

Packing 0.4, v dt = 0.02 diameters, float32, without measures. Each kind of run takes its turn, in processes of its own.
"""

import argparse
import json
import math
import subprocess
import sys
import time
import warnings
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from harness import DOCS, by_turns, exit_code, parser_of, publish, table, with_quartiles

import mpsim
from mpsim.engine.solvers.ranks.messages import MpiRanks
from mpsim.kernels import records

PAGE = DOCS / "scaling.md"
MPIEXEC = Path(sys.executable).with_name("mpiexec")

PACKING, STEP, RECORD = 0.4, 0.02, records.message_in("float32", False, False, False).itemsize

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

LATENCY, BANDWIDTH = 1.5e-6, 12.5e9
"""Of a network, assumed [s], [bytes/s]."""


def frame_seconds(discs: int, settings: dict[str, Any]) -> float:
    """Median time of a frame in this process, or on these ranks."""
    scene = mpsim.Scene.random(count=discs, packing=PACKING, radius=0.5, temperature=1.0, seed=1)
    with mpsim.Simulation(scene, mpsim.Settings(dt=STEP, precision="float32", **settings)) as sim:
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


class Model(NamedTuple):
    """Time of a frame on ranks, not measured: nothing overlaps, and all ranks have as many discs.

    Attributes:
        disc: time of one disc on one process [s].
        step: time of a step besides its discs: the calls of kernels [s].
        exchange: time to pack, send and unpack in a step if there are other ranks, without the network [s].
    """

    disc: float
    step: float
    exchange: float = 0.0

    def rest(self, discs: float, ranks: int) -> float:
        """Time that a single process would not need [s]: two borders, which both sides resolve, and reductions."""
        if ranks == 1:
            return self.step
        column = math.sqrt(4 * discs * PACKING / math.pi)  # discs in a column of the grid
        leaving = column * STEP / math.sqrt(2 * math.pi)  # discs that cross a border in a step
        messages = 2 * LATENCY + RECORD * (column + leaving) / BANDWIDTH
        agreement = 2 * math.ceil(math.log2(ranks)) * LATENCY
        return self.step + self.exchange + 2 * (messages + self.disc * column) + agreement

    def efficiency(self, discs: float, ranks: int) -> float:
        """Time of the work alone over that of all."""
        work = self.disc * discs / ranks
        return work / (work + self.rest(discs, ranks))

    def most_ranks(self, discs: float) -> int:
        """Largest power of two of ranks, at most one per column, that spend half of the time on work."""
        columns = math.sqrt(discs * math.pi / (4 * PACKING))
        ranks = [2**each for each in range(int(math.log2(columns)) + 1)]
        return max(each for each in ranks if each == 1 or self.efficiency(discs, each) >= 0.5)


def model_table(model: Model) -> str:
    """Strong scaling for three numbers of discs, weak for ten million a rank."""
    sizes, rows = (16, 256, 4096), []
    for discs in (1e7, 1e9, 1e11):
        efficiencies = (f"{model.efficiency(discs, ranks):.2f}" for ranks in sizes)
        rows.append((f"{discs:.0e}", *efficiencies, f"{model.most_ranks(discs):,}"))
    weak = (f"{model.efficiency(1e7 * ranks, ranks):.2f}" for ranks in sizes)
    heads = ("discs", "16 ranks", "256", "4,096", "ranks at 50 % efficiency")
    return table(heads, [*rows, ("1e+07 per rank", *weak, "")])


def report(sizes: list[int]) -> str:
    """Both tables, in Markdown."""
    rows: list[tuple[str, ...]] = []
    model = Model(0.0, math.inf, math.inf)
    for discs in sizes:
        times = by_turns({kind: partial(in_processes, discs, kind) for kind in KINDS}, TURNS)
        found = {kind: np.array(each) for kind, each in times.items()}
        for kind, seconds in found.items():
            ratio = np.median(found["grid"] / seconds)
            rows.append((f"{discs:,}", kind, with_quartiles(seconds / discs * 1e9), f"{ratio:.2f}"))
        grid, rank, two = (float(np.median(found[kind])) for kind in ("grid", "1 rank", "2 ranks"))
        model = Model(grid / discs, min(model.step, max(rank - grid, 0.0)), model.exchange)
        rest = model._replace(exchange=0.0).rest(discs, 2)
        model = model._replace(exchange=min(model.exchange, max(two - grid / 2 - rest, 0.0)))
    return "\n\n".join([
        table(("discs", "", "ns per disc and frame", "speed relative to grid"), rows),
        f"Model: {model.disc * 1e9:.1f} ns per disc; {model.step * 1e6:.0f} µs per step for calls (one rank "
        f"minus grid); {model.exchange * 1e6:.0f} µs per exchange for calls (two ranks minus everything else); "
        f"{LATENCY * 1e6:g} µs per message and {BANDWIDTH / 1e9:g} GB/s (assumed). Efficiency:",
        model_table(model),
    ])  # fmt: skip


def main() -> None:
    """Measure, and write the tables into the page."""
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
