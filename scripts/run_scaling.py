"""Frame times by number of workers: measured on this machine, and a model beyond its cores.

python scripts/run_scaling.py                                     some minutes, 4 GiB; into docs/performance.md
python scripts/run_scaling.py --discs 100000 --workers 8 --page results/scaling.md

float32, packing 0.4, v dt = 0.02 diameters. Strong scaling has a fixed number of discs, weak scaling 100,000 a worker.
Frames of one number of discs are timed in turns, so that other load falls on each number of workers. See `Model` for
what the model takes from the measurement, and what it leaves out.
"""

import math
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import numba
import numpy as np
from harness import DOCS, by_turns, exit_code, fill_page, made_by, parser_of, say, table
from numpy.typing import NDArray

import mpsim
from mpsim.core.machine import usable_cores
from mpsim.engine.solvers.grid import shares_of

PAGE = DOCS / "performance.md"

EACH = 100_000
"""Discs of each worker in weak scaling."""

TURNS, TURN = 11, 1e7
"""Turns, and discs times frames in each, for each worker: a turn begins with sleeping workers, which the system wakes
on any core and moves apart within milliseconds."""

FEW = 64
"""Discs of a scene whose frame on two workers is hardly more than its barriers."""

LARGEST_OF = {1: 0.0, 2: 0.564, 4: 1.029, 8: 1.424, 16: 1.766, 32: 2.070, 64: 2.344}
"""Mean of the largest of so many normal numbers, in standard deviations (Harter, Biometrika 48, 151, 1961, table 1)."""

HEADS = ("discs", "workers", "ns a disc and frame", "efficiency", "waiting", "model: efficiency")
Row = tuple[str, ...]

LINE = 64
"""Bytes of a cache line."""

TOUCHED = 5 * 4
"""Bytes of a disc that the even or odd pass at a border reads or writes: place, velocity, number, in float32."""


class Timing(NamedTuple):
    """Frames of a scene on so many workers.

    Attributes:
        discs, workers: of the run.
        seconds: of a frame, the median of the turns' medians.
        wait: of it, spent at barriers, on average over the workers [s].
        column: which column of the grid each disc is in, shape (discs,).
    """

    discs: int
    workers: int
    seconds: float
    wait: float
    column: NDArray[np.int64]


class Model(NamedTuple):
    """The time of a frame on more workers than there are cores to measure it.

    Work as on one process, of the worker with the most discs, as columns are dealt whole; what its contacts take
    beyond the mean, which is the largest of as many normal numbers; barriers, whose counter goes from core to core,
    so that they take twice as long for twice as many workers; and the cache lines of the columns beside its borders,
    which go to a neighbour and come back. Memory that cores share is left out, as are cores that differ.

    Attributes:
        work: of a disc on one process [s].
        spread: standard deviation of a worker's time per square root of its discs [s].
        barriers: of a frame on two workers [s].
        line: a cache line that another core has changed, beyond one of one's own [s].
        lines: of a column of the grid.
    """

    work: float
    spread: float
    barriers: float
    line: float
    lines: float

    @classmethod
    def of(cls, one: Timing, two: Timing, barriers: float, line: float) -> "Model":
        """The model from the same discs on one worker and on two."""
        work, mean = one.seconds / one.discs, two.discs / 2
        for_the_largest = work * mean * (largest_share(two.column, 2) - 1)
        waited = max(two.wait - barriers - for_the_largest, 0.0)
        lines = one.discs / (one.column.max() + 1) * TOUCHED / LINE
        return cls(work, waited / LARGEST_OF[2] / math.sqrt(mean), barriers, line, lines)

    def seconds(self, discs: int, workers: int, share: float) -> float:
        """Time of a frame [s]; share: discs of the worker with the most, as a fraction of the mean."""
        mean = discs / workers
        barriers = self.barriers * workers / 2 if workers > 1 else 0.0
        work = self.work * mean * share + LARGEST_OF[workers] * self.spread * math.sqrt(mean)
        # From its neighbours a worker takes a column at its right border, and its own at the left: with two workers
        # each has one border, with more than two most have both.
        return work + barriers + self.lines * min(workers - 1, 2) * self.line


def largest_share(column: NDArray[np.int64], workers: int) -> float:
    """Discs of the worker with the most over the mean, where whole columns are dealt as the solver deals them."""
    first_of_column = np.concatenate([[0], np.cumsum(np.bincount(column))])
    columns = shares_of(first_of_column[:-1], np.arange(workers + 1) * len(column) // workers)
    return float(np.diff(first_of_column[columns]).max() * workers / len(column))


def time_frames(discs: int, workers: Sequence[int]) -> list[Timing]:
    """Frames of as many discs on each number of workers, in turns; one worker is `grid`."""
    scene = mpsim.Scene.random(count=discs, packing=0.4, radius=0.5, temperature=1.0, seed=1)
    with ExitStack() as stack:
        sims: dict[int, mpsim.Simulation] = {}
        runs: dict[str, Callable[[], tuple[float, float]]] = {}
        for number in workers:
            method, several = ("grid", None) if number == 1 else ("parallel", number)
            settings = mpsim.Settings(dt=0.02, precision="float32", method=method, workers=several)
            sims[number] = stack.enter_context(mpsim.Simulation(scene, settings))
            runs[str(number)] = partial(_turn, sims[number], max(int(TURN * number / discs), 3))
        by_turns(runs, 1)
        medians = [np.median(times, axis=0) for times in by_turns(runs, TURNS).values()]
        column = sims[workers[0]].columns().of_disc
    times = zip(workers, medians, strict=True)
    return [Timing(discs, number, float(seconds), float(wait), column) for number, (seconds, wait) in times]


def _turn(sim: mpsim.Simulation, frames: int) -> tuple[float, float]:
    """Time of a frame, and of waiting in it, on average over the workers [s]: medians."""
    report = sim.run(frames=frames)
    return float(np.median(report.frame_seconds)), float(np.median(report.phase_seconds["wait"].mean(axis=1)))


def barriers_of_a_frame() -> float:
    """What the barriers of a frame take on two workers [s]."""
    one, two = time_frames(FEW, (1, 2))
    return max(two.seconds - one.seconds / 2, 0.0)


@numba.njit(nogil=True)
def touch(numbers: NDArray[np.float32], stride: int) -> None:
    """Change one number of each cache line."""
    for index in range(0, numbers.size, stride):
        numbers[index] += 1


def seconds_of_a_line(one: int, other: int) -> float:
    """What it takes to change a cache line after another core has, beyond changing it again [s].

    Two threads, on the cores of these numbers, change the same 64 kB in turns, in order, as a pass goes through a
    column.
    """
    stride = LINE // 4
    numbers = np.zeros(1000 * stride, np.float32)

    def change() -> tuple[float, float]:
        times = [perf_counter()]
        for _ in range(2):
            touch(numbers, stride)
            times.append(perf_counter())
        return times[1] - times[0], times[2] - times[1]

    touch(numbers, stride)  # compiles it
    with ExitStack() as stack:
        threads = [
            stack.enter_context(ThreadPoolExecutor(1, initializer=os.sched_setaffinity, initargs=(0, {core})))
            for core in (one, other)
        ]
        found = [thread.submit(change).result() for _ in range(200) for thread in threads]
    first, again = np.median(found[len(found) // 2 :], axis=0)
    return max(float(first - again), 0.0) / 1000


def strong(sizes: Sequence[int], most: int, barriers: float, line: float) -> list[Row]:
    """Rows of the table for fixed numbers of discs."""
    rows: list[Row] = []
    for discs in sizes:
        timings = time_frames(discs, powers(min(most, usable_cores())))
        model = Model.of(timings[0], timings[1], barriers, line) if len(timings) > 1 else None
        measured = {timing.workers: timing for timing in timings}
        for workers in powers(most):
            share = largest_share(timings[0].column, workers)
            predicted = None if model is None else model.seconds(discs, workers, share)
            rows.append(row(discs, workers, timings[0].seconds, measured.get(workers), predicted))
    return rows


def weak(most: int) -> list[Row]:
    """Rows of the table for as many discs a worker, as far as there are cores."""
    timings = [time_frames(EACH * workers, (workers,))[0] for workers in powers(min(most, usable_cores()))]
    one = timings[0].seconds
    return [row(timing.discs, timing.workers, one * timing.workers, timing, None) for timing in timings]


def row(discs: int, workers: int, one: float, timing: Timing | None, predicted: float | None) -> Row:
    """A row of the table. one: the time of a frame of as many discs on one process, or so many times fewer's [s]."""

    def efficiency(seconds: float | None) -> str:
        return "" if seconds is None else f"{one / seconds / workers:.2f}"

    measured = ("", "", "")
    if timing is not None:
        waited = 100 * timing.wait / timing.seconds
        measured = f"{timing.seconds / discs * 1e9:.2f}", efficiency(timing.seconds), f"{waited:.0f} %"
    return f"{discs:,}", str(workers), *measured, efficiency(predicted)


def powers(most: int) -> list[int]:
    """1, 2, 4, ... up to `most`."""
    return [2**power for power in range(most.bit_length())]


def main() -> None:
    """Measure, and write the tables into the page."""
    parser = parser_of(__doc__)
    parser.add_argument("--discs", type=int, nargs="+", default=[100_000, 1_000_000, 10_000_000])
    parser.add_argument("--workers", type=int, default=16, choices=list(LARGEST_OF), help="most of them; default: 16")
    parser.add_argument("--page", type=Path, default=PAGE, help=f"default: {PAGE.name} of the docs")
    options = parser.parse_args()
    if min(options.discs) < options.workers:
        parser.error(f"argument --discs: must be at least {options.workers}, a disc for each worker")
    for kind in (mpsim.FastWarning, mpsim.errors.ResolutionWarning):  # of float32, which this is about
        warnings.simplefilter("ignore", kind)
    barriers = line = 0.0
    if usable_cores() > 1:
        barriers, line = barriers_of_a_frame(), seconds_of_a_line(*sorted(os.sched_getaffinity(0))[:2])
    strongly, weakly = strong(options.discs, options.workers, barriers, line), weak(options.workers)
    text = (
        f"Strong scaling:\n\n{table(HEADS, strongly)}\n\nWeak scaling:\n\n{table(HEADS, weakly)}\n\n"
        f"Barriers of a frame on two workers: {barriers * 1e6:.2f} µs; a line of another core's cache: "
        f"{line * 1e9:.0f} ns. {made_by()}"
    )
    say(text)
    fill_page(options.page, {"table": text})


if __name__ == "__main__":
    sys.exit(exit_code(main))
