"""Times of the exact solver on one and several workers, and how often its tiles disagree.

python scripts/run_exact.py                                          all of them, some ten minutes on two cores
python scripts/run_exact.py table --discs 10000 --workers 1 2 4      other sizes, more workers

table    collisions per second, in docs/exact.md. Packing 0.4, no walls that move. `undivided`: one worker, no tiles.
         Each kind takes its turn, in one process.
halos    events simulated twice, and how often tiles disagree, by width of the halo and length of a window
cradle   windows repeated because an impact crosses all tiles at once: the scene and the table of the tutorial's page
"""

import contextlib
import re
import sys
import time
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from exact_windows import Tiles, divided, windows_of
from harness import DOCS, by_turns, exit_code, fill_page, made_by, parser_of, say, table, with_quartiles
from numpy.typing import NDArray

import mpsim

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

    def turn(self) -> tuple[float, NDArray[np.int64]]:
        """Run for about SECONDS: millions of collisions per second, and `windows_of` these."""
        before, began = windows_of(self.sim), time.perf_counter()
        collisions = self.sim.run(frames=self.frames).collisions
        return collisions / (time.perf_counter() - began) / 1e6, windows_of(self.sim) - before


def gas(discs: int) -> mpsim.Scene:
    """The scene that all is measured on."""
    return mpsim.Scene.lattice(count=discs, packing=0.4, radius=0.5, temperature=1.0, seed=1)


def rates(sizes: Sequence[int], workers: list[int]) -> str:
    """Collisions per second."""
    rows = []
    for discs in sizes:
        scene = gas(discs)
        kinds = {"undivided": (1, False)} | {f"{each} worker{'s' * (each > 1)}": (each, True) for each in workers}
        runners = {name: Runner(scene, *kind) for name, kind in kinds.items()}
        found = by_turns({name: runner.turn for name, runner in runners.items()}, TURNS)
        for runner in runners.values():
            runner.sim.close()
        alone = np.array([rate for rate, _ in found["undivided"]])
        for name, turns in found.items():
            millions = np.array([rate for rate, _ in turns])
            windows, again, _ = np.sum([counts for _, counts in turns], axis=0)
            ratio = np.median(millions / alone)
            rows.append((f"{discs:,}", name, with_quartiles(millions), f"{ratio:.2f}", windows, again))
    heads = ("discs", "", "million collisions per second", "relative to undivided", "windows", "repeated")
    return table(heads, rows)


# --- counts -------------------------------------------------------------------------------------------------------


def halo_rows(discs: int) -> list[list[str]]:
    """What halos do twice, and of how many windows tiles did not agree: a row for each length."""
    number = max(IN_WINDOWS // discs, 2)
    differed = np.zeros((len(LENGTHS), len(HALOS)), int)
    with mpsim.Simulation(gas(discs), mpsim.Settings(dt=0.25, method="event", workers=2)) as sim:
        sim.run(until=20.0)
        found = sim.run(frames=20)
        once = found.frames * 0.25 * discs / found.collisions  # the time in which collisions are as many as discs
        tiles = Tiles(sim)
        own = tiles.play(once, HALOS[0])[1]
        twice = [tiles.all_events(once, halo) / own - 1 for halo in HALOS]
        for _ in range(number):
            sim.run(frames=4)
            for place, length in enumerate(LENGTHS):
                differed[place] += [not tiles.play(length * once, halo)[0] for halo in HALOS]
        tiled = f"{discs:,} discs, {len(tiles.edges)} tiles, {number} windows"
    rows = [[tiled, "events simulated twice", *(f"{each:.1%}" for each in twice)]]
    for length, counts in zip(LENGTHS, differed, strict=True):
        rows.append(["", f"{length:g}", *(f"{count / number:.1%}" if count else "0" for count in counts)])
    return rows


def halos(sizes: Sequence[int]) -> str:
    """Shares of windows in which tiles differ, by width of the halo."""
    heads = ("", "collisions / discs", *(f"halo {halo}" for halo in HALOS))
    return table(heads, [row for discs in sizes for row in halo_rows(discs)])


def cradle_of(page: Path) -> mpsim.Scene:
    """The scene that a page of the tutorial makes in a block of its own."""
    block = re.search(r"```python\n((?:(?!```).)*?^cradle = .*?)```", page.read_text(), re.DOTALL | re.MULTILINE)
    if block is None:
        raise ValueError(f"{page.name} must have a block of Python that makes `cradle`")
    names: dict[str, mpsim.Scene] = {}
    exec(block[1], names)
    return names["cradle"]


def cradle(scene: mpsim.Scene) -> str:
    """Windows of a scene in which a blow crosses all tiles at once."""
    rows = []
    for tiling in TILINGS:
        with divided(*tiling):
            sim = mpsim.Simulation(scene, mpsim.Settings(dt=0.05, method="event", workers=1))
        with sim:
            sim.run(frames=40)
            rows.append((f"{tiling[0]} x {tiling[1]}", *windows_of(sim), sim.digest()[:8]))
    return table(("tiles", "windows", "repeated in halves", "simulated by one worker", "digest"), rows)


def main() -> None:
    """Measure, and write the tables into their pages."""
    parser = parser_of(__doc__)
    parser.add_argument("tables", nargs="*", metavar="TABLE", help=f"{', '.join(PAGES)}; default: all")
    parser.add_argument("--discs", type=int, nargs="+", help="default: 1,000 to 1,000,000; of halos 100,000")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--page", type=Path, help="default: where the docs have the table")
    options = parser.parse_args()
    if unknown := set(options.tables) - PAGES.keys():
        parser.error(f"no table is called {', '.join(sorted(unknown))}; there are {', '.join(PAGES)}")
    warnings.simplefilter("ignore")
    make = {
        "table": lambda: rates(options.discs or (1_000, 10_000, 100_000, 1_000_000), options.workers),
        "halos": lambda: halos(options.discs or (100_000,)),
        "cradle": lambda: cradle(cradle_of(PAGES["cradle"])),
    }
    for name in options.tables or PAGES:
        text = f"{make[name]()}\n\n{made_by()}"
        say(text)
        fill_page(options.page or PAGES[name], {name: text})


if __name__ == "__main__":
    sys.exit(exit_code(main))
