"""Times of the exact solver on one and several workers, and how often its tiles disagree.

python scripts/run_exact.py                                          all of them, some ten minutes on two cores
python scripts/run_exact.py table --discs 10000 --workers 1 2 4      other sizes, more workers

table    collisions per second, in docs/exact.md. Packing 0.4, no walls that move. `undivided`: one worker, no tiles.
         Each kind takes its turn, in one process.
halos    events simulated twice, and how often tiles disagree, by width of the halo and length of a window
cradle   windows repeated because an impact crosses all tiles at once: the scene and the table of the tutorial's page
"""

import argparse
import contextlib
import re
import sys
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from exact_windows import Tiles, divided, windows_of
from pages import begin_page, fill_blocks, made_by
from rich.console import Console
from run_bench import machine

import mpsim

DOCS = Path(__file__).parents[1] / "docs"
PAGES = {
    "table": DOCS / "exact.md",
    "halos": DOCS / "exact.md",
    "cradle": DOCS / "tutorial" / "6-order-that-does-not-matter.md",
}

TURNS, SECONDS = 5, 1.0
"""Of each kind, and of a turn, about [s]."""

HALOS = (6, 8, 10, 12, 14)
"""Cells."""

LENGTHS = (0.25, 0.5, 1.0, 2.0)
"""Of windows, in collisions divided by discs."""

IN_WINDOWS = 4_000_000
"""Discs in all windows of one length."""

TILINGS = ((1, 1), (1, 2), (1, 3), (2, 2))
"""Columns and rows of tiles on which the cradle is played."""


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
        with contextlib.nullcontext() if tiled else divided(1):
            self.sim = mpsim.Simulation(scene, settings)
        self.sim.run(frames=4)
        began = time.perf_counter()
        self.sim.run(frames=4)
        self.frames = max(int(SECONDS * 2 / (time.perf_counter() - began)), 1)

    def turn(self) -> Rate:
        """Run for about SECONDS."""
        before, began = windows_of(self.sim), time.perf_counter()
        collisions = self.sim.run(frames=self.frames).collisions
        found = windows_of(self.sim) - before
        return Rate(collisions / (time.perf_counter() - began), *found.tolist())


def gas(discs: int) -> mpsim.Scene:
    """The scene that all is measured on."""
    return mpsim.Scene.lattice(count=discs, packing=0.4, radius=0.5, temperature=1.0, seed=1)


def rows(discs: int, workers: list[int]) -> list[str]:
    """A row of the table for each kind."""
    scene = gas(discs)
    kinds = {"undivided": (1, False)} | {f"{each} worker{'s' * (each > 1)}": (each, True) for each in workers}
    runners = {name: Runner(scene, *kind) for name, kind in kinds.items()}
    rates: dict[str, list[Rate]] = {name: [] for name in kinds}
    for _ in range(TURNS):
        for name, runner in runners.items():
            rates[name].append(runner.turn())
    for runner in runners.values():
        runner.sim.close()
    alone = np.array([rate.collisions for rate in rates["undivided"]])
    lines = []
    for name, each in rates.items():
        millions = np.array([rate.collisions for rate in each]) / 1e6
        low, middle, high = np.percentile(millions, [25, 50, 75])
        windows, again = (sum(values) for values in list(zip(*each, strict=True))[1:3])
        ratio = np.median(millions * 1e6 / alone)
        lines.append(
            f"| {discs:,} | {name} | {middle:.2f} ({low:.2f} to {high:.2f}) | {ratio:.2f} | {windows} | {again} |"
        )
    return lines


def table(discs: Sequence[int], workers: list[int]) -> list[str]:
    """Collisions per second."""
    lines = [
        "| discs | | million collisions per second | relative to undivided | windows | repeated |",
        "|---|---|---|---|---|---|",
    ]
    return lines + [line for each in discs for line in rows(each, workers)]


# --- counts -------------------------------------------------------------------------------------------------------


def halo_rows(discs: int) -> list[str]:
    """What halos do twice, and of how many windows tiles did not agree: a row for each length."""
    number = max(IN_WINDOWS // discs, 2)
    differed = np.zeros((len(LENGTHS), len(HALOS)), int)
    with mpsim.Simulation(gas(discs), mpsim.Settings(dt=0.25, method="event", workers=2)) as sim:
        sim.run(until=20.0)
        found = sim.run(frames=20)
        once = found.frames * 0.25 * discs / found.collisions  # the time in which collisions are as many as discs
        tiles = Tiles(sim)
        own = tiles.play(once, HALOS[0]).events
        twice = [tiles.all_events(once, halo) / own - 1 for halo in HALOS]
        for _ in range(number):
            sim.run(frames=4)
            for place, length in enumerate(LENGTHS):
                differed[place] += [not tiles.play(length * once, halo).agreed for halo in HALOS]
        tiled = f"{discs:,} discs, {len(tiles.edges)} tiles, {number} windows"
    lines = [f"| {tiled} | events simulated twice | {' | '.join(f'{each:.1%}' for each in twice)} |"]
    for length, counts in zip(LENGTHS, differed, strict=True):
        shares = " | ".join(f"{count / number:.1%}" if count else "0" for count in counts)
        lines.append(f"| | {length:g} | {shares} |")
    return lines


def halos(discs: Sequence[int]) -> list[str]:
    """Shares of windows in which tiles differ, by width of the halo."""
    return [
        f"| | collisions / discs | {' | '.join(f'halo {halo}' for halo in HALOS)} |",
        "|---" * (len(HALOS) + 2) + "|",
        *(line for each in discs for line in halo_rows(each)),
    ]


def cradle_of(page: Path) -> mpsim.Scene:
    """The scene that a page of the tutorial makes in a block of its own."""
    block = re.search(r"```python\n((?:(?!```).)*?^cradle = .*?)```", page.read_text(), re.DOTALL | re.MULTILINE)
    if block is None:
        raise ValueError(f"{page.name} must have a block of Python that makes `cradle`")
    names: dict[str, mpsim.Scene] = {}
    exec(block[1], names)
    return names["cradle"]


def cradle(scene: mpsim.Scene) -> list[str]:
    """Windows of a scene in which a blow crosses all tiles at once."""
    lines = ["| tiles | windows | repeated in halves | simulated by one worker | digest |", "|---|---|---|---|---|"]
    for tiling in TILINGS:
        with divided(*tiling):
            sim = mpsim.Simulation(scene, mpsim.Settings(dt=0.05, method="event", workers=1))
        with sim:
            sim.run(frames=40)
            lines.append(
                f"| {tiling[0]} x {tiling[1]} | {' | '.join(map(str, windows_of(sim)))} | {sim.digest()[:8]} |"
            )
    return lines


def main() -> int:
    """Measure, and write the tables into their pages."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tables", nargs="*", metavar="TABLE", help=f"{', '.join(PAGES)}; default: all")
    parser.add_argument("--discs", type=int, nargs="+", help="default: 1,000 to 1,000,000; of halos 100,000")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--page", type=Path, help="default: where the docs have the table")
    options = parser.parse_args()
    if unknown := set(options.tables) - PAGES.keys():
        parser.error(f"no table is called {', '.join(sorted(unknown))}; there are {', '.join(PAGES)}")
    warnings.simplefilter("ignore")
    make = {
        "table": lambda: table(options.discs or (1_000, 10_000, 100_000, 1_000_000), options.workers),
        "halos": lambda: halos(options.discs or (100_000,)),
        "cradle": lambda: cradle(cradle_of(PAGES["cradle"])),
    }
    for name in options.tables or PAGES:
        text = "\n".join([*make[name](), "", made_by(machine())])
        Console(soft_wrap=True, highlight=False).print(text, markup=False)
        page = options.page or PAGES[name]
        begin_page(page, "run_exact", name)
        fill_blocks(page, "run_exact", {name: text})
    return 0


if __name__ == "__main__":
    sys.exit(main())
