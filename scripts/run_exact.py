"""Collisions per second of the exact solver on one and several workers, and how often its tiles disagree.

python scripts/run_exact.py                                    some ten minutes on two cores; into docs/exact.md
python scripts/run_exact.py --discs 10000 --workers 1 2 4      other sizes, more workers

Packing 0.4, no walls that move. `undivided`: one worker, no tiles. Each kind takes its turn, in one process.
"""

import sys
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from unittest import mock

import numpy as np
from harness import DOCS, by_turns, exit_code, parser_of, publish, table, with_quartiles
from numpy.typing import NDArray

import mpsim
from mpsim.engine.solvers import event_block
from mpsim.engine.solvers.event_tiles import Tiling

TURNS, SECONDS = 5, 1.0
"""Of each kind, and of a turn, about [s]."""


class Runner:
    """A simulation that continues, turn by turn."""

    def __init__(self, scene: mpsim.Scene, workers: int):
        """workers: 0 for one without tiles."""
        settings = mpsim.Settings(dt=0.25, method="event", workers=max(workers, 1))
        tiling_of = event_block.tiling_of if workers else lambda *_: Tiling(1, 1)
        with mock.patch.object(event_block, "tiling_of", tiling_of):
            self.sim = mpsim.Simulation(scene, settings)
        self.sim.run(frames=4)
        began = time.perf_counter()
        self.sim.run(frames=4)
        self.frames = max(int(SECONDS * 2 / (time.perf_counter() - began)), 1)

    def windows(self) -> NDArray[np.int64]:
        """Windows so far, and how many of them were repeated."""
        plan = self.sim._open_solver().block.arrays.get("plan")  # pyright: ignore[reportPrivateUsage, reportAttributeAccessIssue]
        return np.zeros(2, np.int64) if plan is None else np.array([plan.windows, plan.again])

    def turn(self) -> tuple[float, NDArray[np.int64]]:
        """Run for about SECONDS: millions of collisions per second, and windows."""
        before, began = self.windows(), time.perf_counter()
        collisions = self.sim.run(frames=self.frames).collisions
        return collisions / (time.perf_counter() - began) / 1e6, self.windows() - before


def rates(sizes: Sequence[int], workers: Sequence[int]) -> str:
    """Collisions per second."""
    rows = []
    for discs in sizes:
        scene = mpsim.Scene.lattice(count=discs, packing=0.4, radius=0.5, temperature=1.0, seed=1)
        kinds = {"undivided": 0} | {f"{each} worker{'s' * (each > 1)}": each for each in workers}
        runners = {name: Runner(scene, kind) for name, kind in kinds.items()}
        found = by_turns({name: runner.turn for name, runner in runners.items()}, TURNS)
        for runner in runners.values():
            runner.sim.close()
        alone = np.array([rate for rate, _ in found["undivided"]])
        for name, turns in found.items():
            millions = np.array([rate for rate, _ in turns])
            windows, again = np.sum([counts for _, counts in turns], axis=0)
            ratio = np.median(millions / alone)
            rows.append((f"{discs:,}", name, with_quartiles(millions), f"{ratio:.2f}", windows, again))
    return table(("discs", "", "million collisions per second", "relative to undivided", "windows", "repeated"), rows)


def main() -> None:
    """Measure, and write the table into its page."""
    parser = parser_of(__doc__)
    parser.add_argument("--discs", type=int, nargs="+", default=[1_000, 10_000, 100_000, 1_000_000])
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--page", type=Path, default=DOCS / "exact.md")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    publish(options.page, rates(options.discs, options.workers))


if __name__ == "__main__":
    sys.exit(exit_code(main))
