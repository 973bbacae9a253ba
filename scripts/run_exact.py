"""Collisions per second of the exact solver on one worker and on several, in turns: the table of docs/exact.md.

python scripts/run_exact.py                                    some five minutes on two cores
python scripts/run_exact.py --discs 10000 --workers 1 2 4      other sizes, more workers

Packing 0.4, no walls that move. `as one` is one worker without tiles. Each kind takes its turn, in one process.
"""

import argparse
import sys
import time
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pages import begin_page, fill_blocks, made_by
from rich.console import Console
from run_bench import machine

import mpsim
from mpsim.engine.solvers import events
from mpsim.engine.solvers.event_tiles import WHOLE, tiling_of

PAGE = Path(__file__).parents[1] / "docs" / "exact.md"

TURNS, SECONDS = 5, 1.0
"""Of each kind, and of a turn, about [s]."""


class Rate(NamedTuple):
    """Of one turn: collisions per second, windows, those of them played again, and by one worker for all."""

    collisions: float
    windows: int
    again: int
    as_one: int


class Runner:
    """A simulation that goes on, turn by turn."""

    def __init__(self, scene: mpsim.Scene, workers: int, tiled: bool):
        settings = mpsim.Settings(dt=0.25, method="event", workers=workers)
        events.tiling_of = tiling_of if tiled else lambda *_: WHOLE
        try:
            self.sim = mpsim.Simulation(scene, settings)
            self.sim.run(frames=4)
            began = time.perf_counter()
            self.sim.run(frames=4)
            self.frames = max(int(SECONDS * 2 / (time.perf_counter() - began)), 1)
        finally:
            events.tiling_of = tiling_of

    def turn(self) -> Rate:
        """Run for about SECONDS."""
        before, began = self._windows(), time.perf_counter()
        collisions = self.sim.run(frames=self.frames).collisions
        found = self._windows() - before
        return Rate(collisions / (time.perf_counter() - began), *found.tolist())

    def _windows(self) -> Any:
        windows = self.sim._coordinator.open_solver()._windows  # type: ignore[attr-defined]
        return np.zeros(3, int) if windows is None else np.array(windows.counts)


def rows(discs: int, workers: list[int]) -> list[str]:
    """A row of the table for each kind."""
    scene = mpsim.Scene.lattice(count=discs, packing=0.4, radius=0.5, temperature=1.0, seed=1)
    kinds = {"as one": (1, False)} | {f"{each} worker{'s' * (each > 1)}": (each, True) for each in workers}
    runners = {name: Runner(scene, *kind) for name, kind in kinds.items()}
    rates: dict[str, list[Rate]] = {name: [] for name in kinds}
    for _ in range(TURNS):
        for name, runner in runners.items():
            rates[name].append(runner.turn())
    for runner in runners.values():
        runner.sim.close()
    alone = np.array([rate.collisions for rate in rates["as one"]])
    lines = []
    for name, each in rates.items():
        millions = np.array([rate.collisions for rate in each]) / 1e6
        low, middle, high = np.percentile(millions, [25, 50, 75])
        windows, again, as_one = (sum(values) for values in list(zip(*each, strict=True))[1:])
        ratio = np.median(millions * 1e6 / alone)
        lines.append(
            f"| {discs:,} | {name} | {middle:.2f} ({low:.2f} to {high:.2f}) | {ratio:.2f} | {windows} | {again} | "
            f"{as_one} |"
        )
    return lines


def main() -> int:
    """Measure, and write the table into the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--discs", type=int, nargs="+", default=[1_000, 10_000, 100_000, 1_000_000])
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--page", type=Path, default=PAGE, help=f"default: {PAGE.name} of the docs")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    lines = [
        "| discs | | million collisions a second | of as one | windows | again | as one |",
        "|---|---|---|---|---|---|---|",
    ]
    for discs in options.discs:
        lines += rows(discs, options.workers)
    text = "\n".join([*lines, "", made_by(machine())])
    Console(soft_wrap=True, highlight=False).print(text, markup=False)
    begin_page(options.page, "run_exact", "table")
    fill_blocks(options.page, "run_exact", {"table": text})
    return 0


if __name__ == "__main__":
    sys.exit(main())
