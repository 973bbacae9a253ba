"""Frame times on MPI ranks, compared with workers; size of messages; a model of larger machines.

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
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from numpy.typing import NDArray
from pages import begin_page, fill_blocks, made_by
from rich.console import Console
from run_bench import machine

import mpsim
from mpsim.engine.solvers.ranks.messages import MpiRanks
from mpsim.kernels import records
from mpsim.output.drawing import STYLE, new_figure, save_figure

PAGE = Path(__file__).parents[1] / "docs" / "scaling.md"
PICTURE = "ranks.png"
MPIEXEC = Path(sys.executable).with_name("mpiexec")

PACKING, STEP, RECORD = 0.4, 0.02, records.message_in("float32", False, False, False).itemsize

KINDS = {
    "grid": (1, {"method": "grid"}),
    "2 workers": (1, {"method": "parallel", "workers": 2}),
    "1 rank": (1, {"method": "mpi"}),
    "2 ranks": (2, {"method": "mpi"}),
    "1 rank, 2 workers": (1, {"method": "mpi", "workers": 2}),
}
"""Ranks, and settings."""

TURNS, RUNS = 5, 5
"""Of each kind, and runs in a turn, of which the median counts."""

OF_A_STEP = 4
"""Numbers that ranks agree about in a step; before a command they have no discs to tell."""

FRAMES = 30_000_000
"""Frames of a run, times discs."""


class Sent(NamedTuple):
    """What one rank sends in a frame, on average.

    Attributes:
        border_messages, border_bytes: of columns at borders.
        migration_messages, migration_bytes: of discs that go to another rank.
        reductions: over all ranks (Allreduce), of steps. Each command has one more.
        border_microseconds: from the first border message sent to the last one received; the median.
    """

    border_messages: float
    border_bytes: float
    migration_messages: float
    migration_bytes: float
    reductions: float
    border_microseconds: float


class Network(NamedTuple):
    """What a message takes: `latency` [s], and its bytes over `bandwidth` [bytes/s]."""

    latency: float = 1.5e-6
    bandwidth: float = 12.5e9

    def seconds(self, length: float) -> float:
        """Of a message of so many bytes [s]."""
        return self.latency + length / self.bandwidth


class Counter:
    """Counts what `MpiRanks` sends."""

    def __init__(self) -> None:
        self.counts = np.zeros(5)
        self._border_seconds: list[float] = []
        self._right = {name: getattr(MpiRanks, name) for name in ("exchange", "deal", "agree")}
        self._dealing = False

    def __enter__(self) -> "Counter":
        for name in self._right:
            setattr(MpiRanks, name, self._counting(name))
        return self

    def __exit__(self, *exception: object) -> None:
        for name, right in self._right.items():
            setattr(MpiRanks, name, right)

    def mean(self, frames: int) -> Sent:
        """Of so many frames."""
        middle = float(np.median(self._border_seconds)) if self._border_seconds else 0.0
        messages, bytes_sent, discs, disc_bytes, reductions = self.counts / frames
        return Sent(messages, bytes_sent, discs, disc_bytes, reductions, middle * 1e6)

    def _counting(self, name: str) -> Any:
        right = self._right[name]

        def count(ranks: MpiRanks, *arguments: Any) -> Any:
            if name == "agree":
                self.counts[4] += len(arguments) == OF_A_STEP
            elif name == "exchange":
                first = 2 * self._dealing
                self.counts[first] += len(arguments[0])
                self.counts[first + 1] += sum(part.nbytes for _, _, part in arguments[0])
            is_of_border = name == "exchange" and not self._dealing
            self._dealing, began = name == "deal", time.perf_counter()
            try:
                return right(ranks, *arguments)
            finally:
                self._dealing = False
                if is_of_border:
                    self._border_seconds.append(time.perf_counter() - began)

        return count


def expected(discs: int) -> Sent:
    """What the formulas say of one border: a column has sqrt(4 N packing / pi) discs, and v dt / (d sqrt(2 pi)) go."""
    column = math.sqrt(4 * discs * PACKING / math.pi)
    leaving = RECORD * column * STEP / math.sqrt(2 * math.pi)
    return Sent(1, RECORD * column, 1, leaving, 1, Network().seconds(RECORD * column) * 1e6)


def frame_seconds(discs: int, settings: dict[str, Any]) -> tuple[float, Sent]:
    """Median time of a frame in this process, or on these ranks, and what this one sends."""
    scene = mpsim.Scene.random(count=discs, packing=PACKING, radius=0.5, temperature=1.0, seed=1)
    with mpsim.Simulation(scene, mpsim.Settings(dt=STEP, precision="float32", **settings)) as sim:
        sim.run(frames=30)
        times: list[float] = []
        frames = FRAMES // discs
        with Counter() as counter:
            for _ in range(RUNS):
                began = time.perf_counter()
                sim.run(frames=frames)
                times.append((time.perf_counter() - began) / frames)
    return float(np.median(times)), counter.mean(RUNS * frames)


def in_processes(discs: int, kind: str) -> tuple[float, Sent]:
    """`frame_seconds` of a kind of run, in processes of its own."""
    number, settings = KINDS[kind]
    begin = [str(MPIEXEC), "-n", str(number)] if "mpi" in settings.values() else []
    command = [*begin, sys.executable, __file__, "--one", json.dumps([discs, settings])]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=600)
    seconds, sent = json.loads(done.stdout.splitlines()[-1])
    return seconds, Sent(*sent)


def tell_one(task: str) -> None:
    """Print what `frame_seconds` finds, on the first rank."""
    warnings.simplefilter("ignore")
    discs, settings = json.loads(task)
    found = frame_seconds(discs, settings)
    if "mpi" not in settings.values() or MpiRanks().rank == 0:
        print(json.dumps(found))


class Model(NamedTuple):
    """Time of a frame on ranks, not measured: nothing overlaps, and all ranks have as many discs.

    Attributes:
        disc: of one disc on one process [s].
        step: of what a step takes besides its discs: the calls of kernels [s].
        network: between any two ranks.
        exchange: what a step takes besides, where there are other ranks: to pack, send and unpack, without the network
            [s].
    """

    disc: float
    step: float
    network: Network
    exchange: float = 0.0

    def work(self, discs: float, ranks: int) -> float:
        """Of the discs of a rank [s]."""
        return self.disc * discs / ranks

    def rest(self, discs: float, ranks: int) -> float:
        """Of all that a single process would not have [s]: two borders, which both sides resolve, and reductions."""
        if ranks == 1:
            return self.step
        column = math.sqrt(4 * discs * PACKING / math.pi)
        border = self.network.seconds(RECORD * column)
        migration = self.network.seconds(RECORD * column * STEP / math.sqrt(2 * math.pi))
        agreement = 2 * math.ceil(math.log2(ranks)) * self.network.latency
        return self.step + self.exchange + 2 * (border + self.disc * column) + migration + agreement

    def efficiency(self, discs: float, ranks: int) -> float:
        """Time of the work alone over that of all."""
        return self.work(discs, ranks) / (self.work(discs, ranks) + self.rest(discs, ranks))

    def most_ranks(self, discs: float) -> int:
        """Ranks up to which half of the time is work, as far as there are columns for them: powers of two."""
        columns, ranks = math.sqrt(discs * math.pi / (4 * PACKING)), 1
        while 2 * ranks <= columns and self.efficiency(discs, 2 * ranks) >= 0.5:
            ranks *= 2
        return ranks


def measured(discs: int) -> dict[str, list[tuple[float, Sent]]]:
    """All kinds of runs, in turns."""
    found: dict[str, list[tuple[float, Sent]]] = {kind: [] for kind in KINDS}
    for _ in range(TURNS):
        for kind, each in found.items():
            each.append(in_processes(discs, kind))
    return found


def times_table(discs: int, found: dict[str, list[tuple[float, Sent]]]) -> list[str]:
    """A row for each kind of run."""
    alone = {name: np.array([seconds for seconds, _ in found[name]]) for name in found}
    lines = []
    for kind, times in alone.items():
        quartiles = np.percentile(times / discs * 1e9, [50, 25, 75])
        lines.append(
            f"| {discs:,} | {kind} | {quartiles[0]:.2f} ({quartiles[1]:.2f} to {quartiles[2]:.2f}) | "
            f"{np.median(alone['grid'] / times):.2f} |"
        )
    return lines


def sent_table(discs: int, sent: Sent) -> list[str]:
    """What is counted beside what the formulas say; two ranks have one border."""
    rows = zip(Sent._fields, expected(discs), sent, strict=True)
    return [f"| {discs:,} | {name.replace('_', ' ')} | {formula:.4g} | {found:.4g} |" for name, formula, found in rows]


def model_table(model: Model) -> list[str]:
    """Strong scaling for three numbers of discs, weak for ten million a rank."""
    lines = []
    for discs in (1e7, 1e9, 1e11):
        most = model.most_ranks(discs)
        told = [f"{model.efficiency(discs, ranks):.2f}" for ranks in (16, 256, 4096)]
        lines.append(f"| {discs:.0e} | {' | '.join(told)} | {most:,} |")
    weak = [f"{model.efficiency(1e7 * ranks, ranks):.2f}" for ranks in (16, 256, 4096)]
    return [*lines, f"| 1e+07 per rank | {' | '.join(weak)} | |"]


def efficiencies(found: dict[str, list[tuple[float, Sent]]]) -> dict[int, NDArray[np.float64]]:
    """Quartiles of the measured efficiency, middle first, by number of ranks: time of grid over that of all ranks."""
    alone = np.array([seconds for seconds, _ in found["grid"]])
    kinds = {1: "1 rank", 2: "2 ranks"}
    return {
        ranks: np.percentile(
            [one / (ranks * time) for one, (time, _) in zip(alone, found[kind], strict=True)], [50, 25, 75]
        )
        for ranks, kind in kinds.items()
    }


def draw(model: Model, points: dict[int, dict[int, NDArray[np.float64]]], path: Path) -> None:
    """Efficiency against ranks: lines, the model; marks with quartiles, what was measured, by number of discs."""
    with matplotlib.rc_context(fname=STYLE):
        figure = new_figure(8, 4.8)
        axes = figure.add_subplot()
        for number, discs in enumerate([*points, 1e7, 1e9, 1e11]):
            colour = f"C{number}"
            columns = math.sqrt(discs * math.pi / (4 * PACKING))
            ranks = [2**each for each in range(18) if 2**each <= columns]
            axes.plot(
                ranks, [model.efficiency(discs, each) for each in ranks], color=colour, label=f"{discs:,.0f} discs"
            )
            for at, (middle, low, high) in points.get(int(discs), {}).items():
                axes.errorbar(at, middle, [[middle - low], [high - middle]], color=colour, marker="o", zorder=3)
        weak = [2**each for each in range(18)]
        label = "10,000,000 discs per rank"
        axes.plot(
            weak, [model.efficiency(1e7 * each, each) for each in weak], color="black", linestyle="--", label=label
        )
        axes.set(xscale="log", xlabel="ranks", ylabel="parallel efficiency", ylim=(0, 1.05))
        axes.set_title("Efficiency of ranks: measured (dots) and model (lines)")
        figure.legend(loc="outside right center")
        save_figure(figure, path)


COUNTS = ("| discs | per frame and rank | formula | measured |", "|---|---|---|---|")


def report(sizes: list[int], picture: Path) -> str:
    """All tables, in Markdown, and the picture."""
    times = [
        "| discs | | ns per disc and frame | speed relative to grid |",
        "|---|---|---|---|",
    ]
    counts: list[str] = []
    disc, step, exchange, points = 0.0, math.inf, math.inf, {}
    for discs in sizes:
        found = measured(discs)
        times += times_table(discs, found)
        counts = sent_table(discs, found["2 ranks"][0][1])
        points[discs] = efficiencies(found)
        grid, rank = (float(np.median([seconds for seconds, _ in found[kind]])) for kind in ("grid", "1 rank"))
        disc, step = grid / discs, min(step, max(rank - grid, 0.0))
        two = float(np.median([seconds for seconds, _ in found["2 ranks"]]))
        alone = Model(disc, step, Network())
        exchange = min(exchange, max(two - alone.work(discs, 2) - alone.rest(discs, 2), 0.0))
    model = Model(disc, step, Network(), exchange)
    draw(model, points, picture)
    said = (
        f"Model: {model.disc * 1e9:.1f} ns per disc; {model.step * 1e6:.0f} µs per step for calls (one rank "
        f"minus grid); {model.exchange * 1e6:.0f} µs per exchange for calls (two ranks minus everything else); "
        f"{model.network.latency * 1e6:g} µs per message and {model.network.bandwidth / 1e9:g} GB/s (assumed). "
        "Efficiency:"
    )
    rows = ["| discs | 16 ranks | 256 | 4,096 | ranks at 50 % efficiency |", "|---|---|---|---|---|"]
    shown = f"![efficiency against ranks](pictures/{PICTURE})"
    blocks = ["\n".join(lines) for lines in (times, [*COUNTS, *counts], [*rows, *model_table(model)])]
    return "\n\n".join([*blocks[:2], said, blocks[2], shown, made_by(machine())])


def main() -> int:
    """Measure, and write the tables into the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--discs", type=int, nargs="+", default=[30_000, 300_000])
    parser.add_argument("--page", type=Path, default=PAGE, help=f"default: {PAGE.name} of the docs")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        tell_one(options.one)
        return 0
    pictures = options.page.parent / "pictures"
    pictures.mkdir(parents=True, exist_ok=True)
    text = report(options.discs, pictures / PICTURE)
    Console(soft_wrap=True, highlight=False).print(text, markup=False)
    begin_page(options.page, "run_ranks", "table")
    fill_blocks(options.page, "run_ranks", {"table": text})
    return 0


if __name__ == "__main__":
    sys.exit(main())
