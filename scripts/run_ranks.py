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
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from harness import DOCS, by_turns, exit_code, fill_page, made_by, parser_of, quartiles, say, table, with_quartiles
from numpy.typing import NDArray

import mpsim
from mpsim.engine.solvers.ranks.messages import MpiRanks
from mpsim.kernels import records
from mpsim.output.drawing import STYLE, new_figure, save_figure

PAGE = DOCS / "scaling.md"
PICTURE = "ranks.png"
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

OF_A_STEP = 4
"""Numbers that ranks agree about in a step; before a command they have no discs to tell."""

FRAMES = 30_000_000
"""Frames of a run, times discs."""

MOST = 18
"""Numbers of ranks in the picture, each twice the one before."""

LATENCY, BANDWIDTH = 1.5e-6, 12.5e9
"""Of a network, assumed [s], [bytes/s]."""

SENT = (
    "border messages",
    "border bytes",
    "migration messages",
    "migration bytes",
    "reductions",
    "border microseconds",
)
"""What is counted of one rank in a frame, on average: messages of columns at borders, and of discs that go to another
rank; reductions over all ranks (Allreduce) of steps, as each command has one more; and the median time from the first
border message sent to the last one received."""

Times = dict[str, list[tuple[float, list[float]]]]
"""By the kind of run, turn by turn: seconds of a frame, and the numbers of SENT."""


# --- one kind of run, in processes of its own


class Counter:
    """Counts what `MpiRanks` sends."""

    def __init__(self) -> None:
        self.counts = np.zeros(5)
        self.border_seconds: list[float] = []
        self._right = {name: getattr(MpiRanks, name) for name in ("exchange", "deal", "agree")}
        self._dealing = False

    def __enter__(self) -> "Counter":
        for name, right in self._right.items():
            setattr(MpiRanks, name, self._counting(name, right))
        return self

    def __exit__(self, *exception: object) -> None:
        for name, right in self._right.items():
            setattr(MpiRanks, name, right)

    def _counting(self, name: str, right: Callable[..., Any]) -> Callable[..., Any]:
        def count(ranks: MpiRanks, *arguments: Any) -> Any:
            is_of_border = name == "exchange" and not self._dealing
            if name == "agree":
                self.counts[4] += len(arguments) == OF_A_STEP
            elif name == "exchange":
                first = 2 * self._dealing
                self.counts[first] += len(arguments[0])
                self.counts[first + 1] += sum(part.nbytes for _, _, part in arguments[0])
            self._dealing, began = name == "deal", time.perf_counter()
            try:
                return right(ranks, *arguments)
            finally:
                self._dealing = False
                if is_of_border:
                    self.border_seconds.append(time.perf_counter() - began)

        return count


def frame_seconds(discs: int, settings: dict[str, Any]) -> tuple[float, list[float]]:
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
    border = float(np.median(counter.border_seconds or [0.0]))
    return float(np.median(times)), [*(counter.counts / (RUNS * frames)).tolist(), border * 1e6]


def in_processes(discs: int, kind: str) -> tuple[float, list[float]]:
    """`frame_seconds` of a kind of run, in processes of its own."""
    number, settings = KINDS[kind]
    begin = [str(MPIEXEC), "-n", str(number)] if "mpi" in settings.values() else []
    command = [*begin, sys.executable, __file__, "--one", json.dumps([discs, settings])]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=600)
    return json.loads(done.stdout.splitlines()[-1])


def tell_one(task: str) -> None:
    """Print what `frame_seconds` finds, on the first rank."""
    warnings.simplefilter("ignore")
    discs, settings = json.loads(task)
    found = frame_seconds(discs, settings)
    if "mpi" not in settings.values() or MpiRanks().rank == 0:
        print(json.dumps(found))


# --- what formulas say


def message_seconds(length: float) -> float:
    """Of a message of so many bytes [s]."""
    return LATENCY + length / BANDWIDTH


def column_of(discs: float) -> float:
    """Discs of a column of the grid."""
    return math.sqrt(4 * discs * PACKING / math.pi)


def leaving(discs: float) -> float:
    """Bytes of the discs that cross a border in a step: v dt / (d sqrt(2 pi)) of a column."""
    return RECORD * column_of(discs) * STEP / math.sqrt(2 * math.pi)


def expected(discs: int) -> list[float]:
    """The numbers of SENT for one border."""
    border = RECORD * column_of(discs)
    return [1, border, 1, leaving(discs), 1, message_seconds(border) * 1e6]


class Model(NamedTuple):
    """Time of a frame on ranks, not measured: nothing overlaps, and all ranks have as many discs.

    Attributes:
        disc: of one disc on one process [s].
        step: of what a step takes besides its discs: the calls of kernels [s].
        exchange: what a step takes besides, where there are other ranks: to pack, send and unpack, without the network
            [s].
    """

    disc: float
    step: float
    exchange: float = 0.0

    def rest(self, discs: float, ranks: int) -> float:
        """Of all that a single process would not have [s]: two borders, which both sides resolve, and reductions."""
        if ranks == 1:
            return self.step
        column = column_of(discs)
        border, migration = message_seconds(RECORD * column), message_seconds(leaving(discs))
        agreement = 2 * math.ceil(math.log2(ranks)) * LATENCY
        return self.step + self.exchange + 2 * (border + self.disc * column) + migration + agreement

    def efficiency(self, discs: float, ranks: int) -> float:
        """Time of the work alone over that of all."""
        work = self.disc * discs / ranks
        return work / (work + self.rest(discs, ranks))

    def most_ranks(self, discs: float) -> int:
        """Ranks up to which half of the time is work, as far as there are columns for them: powers of two."""
        return max(each for each in powers(discs) if each == 1 or self.efficiency(discs, each) >= 0.5)


def powers(discs: float) -> list[int]:
    """Numbers of ranks, 1, 2, 4, ..., up to that of columns."""
    columns = math.sqrt(discs * math.pi / (4 * PACKING))
    return [2**each for each in range(40) if 2**each <= columns]


# --- tables and the picture


def model_table(model: Model) -> str:
    """Strong scaling for three numbers of discs, weak for ten million a rank."""
    rows = []
    for discs in (1e7, 1e9, 1e11):
        told = (f"{model.efficiency(discs, ranks):.2f}" for ranks in (16, 256, 4096))
        rows.append((f"{discs:.0e}", *told, f"{model.most_ranks(discs):,}"))
    weak = (f"{model.efficiency(1e7 * ranks, ranks):.2f}" for ranks in (16, 256, 4096))
    return table(
        ("discs", "16 ranks", "256", "4,096", "ranks at 50 % efficiency"), [*rows, ("1e+07 per rank", *weak, "")]
    )


def draw(model: Model, points: dict[int, Times], path: Path) -> None:
    """Efficiency against ranks: lines, the model; marks with quartiles, what was measured, by number of discs."""
    with matplotlib.rc_context(fname=STYLE):
        figure = new_figure(8, 4.8)
        axes = figure.add_subplot()
        for number, discs in enumerate([*points, 1e7, 1e9, 1e11]):
            ranks, colour = powers(discs)[:MOST], f"C{number}"
            line = [model.efficiency(discs, each) for each in ranks]
            axes.plot(ranks, line, color=colour, label=f"{discs:,.0f} discs")
            found = points.get(int(discs), {})
            for at, kind in ((1, "1 rank"), (2, "2 ranks")) if found else ():
                low, middle, high = quartiles(seconds_of(found, "grid") / (at * seconds_of(found, kind)))
                axes.errorbar(at, middle, [[middle - low], [high - middle]], color=colour, marker="o", zorder=3)
        weak = [2**each for each in range(MOST)]
        line = [model.efficiency(1e7 * each, each) for each in weak]
        axes.plot(weak, line, color="black", linestyle="--", label="10,000,000 discs per rank")
        axes.set(xscale="log", xlabel="ranks", ylabel="parallel efficiency", ylim=(0, 1.05))
        axes.set_title("Efficiency of ranks: measured (dots) and model (lines)")
        figure.legend(loc="outside right center")
        save_figure(figure, path)


def seconds_of(found: Times, kind: str) -> NDArray[np.float64]:
    """Times of a frame, turn by turn."""
    return np.array([seconds for seconds, _ in found[kind]])


def report(sizes: list[int], picture: Path) -> str:
    """All tables, in Markdown, and the picture."""
    times: list[tuple[str, ...]] = []
    model, points = Model(0.0, math.inf, math.inf), {}
    for discs in sizes:
        found = points[discs] = by_turns({kind: partial(in_processes, discs, kind) for kind in KINDS}, TURNS)
        alone = seconds_of(found, "grid")
        for kind in KINDS:
            seconds = seconds_of(found, kind)
            costs, ratio = with_quartiles(seconds / discs * 1e9), np.median(alone / seconds)
            times.append((f"{discs:,}", kind, costs, f"{ratio:.2f}"))
        grid, rank, two = (float(np.median(seconds_of(found, kind))) for kind in ("grid", "1 rank", "2 ranks"))
        model = Model(grid / discs, min(model.step, max(rank - grid, 0.0)), model.exchange)
        rest = model._replace(exchange=0.0).rest(discs, 2)
        model = model._replace(exchange=min(model.exchange, max(two - grid / 2 - rest, 0.0)))
    draw(model, points, picture)
    last, (_, sent) = sizes[-1], points[sizes[-1]]["2 ranks"][0]
    numbers = zip(SENT, expected(last), sent, strict=True)
    said = (
        f"Model: {model.disc * 1e9:.1f} ns per disc; {model.step * 1e6:.0f} µs per step for calls (one rank "
        f"minus grid); {model.exchange * 1e6:.0f} µs per exchange for calls (two ranks minus everything else); "
        f"{LATENCY * 1e6:g} µs per message and {BANDWIDTH / 1e9:g} GB/s (assumed). Efficiency:"
    )
    blocks = [
        table(("discs", "", "ns per disc and frame", "speed relative to grid"), times),
        table(
            ("discs", "per frame and rank", "formula", "measured"),
            ((f"{last:,}", name, f"{formula:.4g}", f"{counted:.4g}") for name, formula, counted in numbers),
        ),
        said,
        model_table(model),
        f"![efficiency against ranks](pictures/{PICTURE})",
        made_by(),
    ]
    return "\n\n".join(blocks)


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
    pictures = options.page.parent / "pictures"
    pictures.mkdir(parents=True, exist_ok=True)
    text = report(options.discs, pictures / PICTURE)
    say(text)
    fill_page(options.page, {"table": text})


if __name__ == "__main__":
    sys.exit(exit_code(main))
