"""Compares standard errors of runs with the scatter of runs from other starts.

For each kind of run: the scatter of a measure over independent starts, divided by the root mean square of the errors
that the runs themselves claim. 1: right; 2: half of what it should be. What a run calls "not settled" claims no error:
it is left out, and its share is shown; with a heat bath, the ratio of these runs, too.

python scripts/run_calibration.py                          about two minutes on two cores: 100 starts of each kind
python scripts/run_calibration.py --docs docs/accuracy.md  the same, and renew its results on the page
python scripts/run_calibration.py --full                   400 starts, and runs ten times as long
"""

import sys
import time
import warnings
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, Literal, NamedTuple

import harness
import numpy as np
from harness import exit_code, fill_page, made_by, parser_of, say

import mpsim
from mpsim.core.machine import usable_cores
from mpsim.features.edges import EDGES
from mpsim.features.energy import memory_of_baths
from mpsim.measure import Measure, reference
from mpsim.scene.settings import MethodName

COUNT = 64
PACKINGS = (0.02, 0.3, 0.6)
BOUNDARIES: dict[str, Literal["walls", "periodic"]] = {"closed": "walls", "periodic": "periodic"}
LENGTHS = {"short": 200.0, "long": 2000.0}
"""Collisions of each disc."""

BEFORE = 50.0
"""Collisions of each disc before a run counts."""

METHODS: dict[MethodName, tuple[str, ...]] = {"event": ("short", "long"), "grid": ("short",)}
STEPS = {0.02: 0.2, 0.3: 0.05, 0.6: 0.02}
"""Of `grid` by packing, where a diameter, kT and the mass are 1."""

FRAMES = 2000
"""Of `event`."""

RIGHT = 0.8, 1.25
"""Between these an error counts as right."""

AGAIN = 4
"""Where one does not, so many times as many starts decide: of 100 ratios, each known to 7 %, some lie outside by
chance."""

NAMES = (
    "pressure",
    "pressure_virial",
    "pressure_xx",
    "pressure_yy",
    "pressure_xy",
    "collision_rate",
    "overlap",
    "speed_kurtosis",
)


class Cell(NamedTuple):
    """One kind of run. collisions: of each disc."""

    method: MethodName
    packing: float
    boundary: str
    collisions: float


def measured(cell: Cell, seed: int) -> dict[str, Measure]:
    """The measures of one run from one random start."""
    boundary = BOUNDARIES[cell.boundary]
    scene = mpsim.Scene.random(count=COUNT, packing=cell.packing, radius=0.5, seed=seed, boundary=boundary)
    rate = reference.enskog_rate(cell.packing)
    dt = STEPS[cell.packing] if cell.method == "grid" else cell.collisions / rate / FRAMES
    names = [name for name in NAMES if name != "pressure_xy" or cell.boundary == "periodic"]
    if cell.method == "event":
        names = [name for name in names if name != "overlap"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", mpsim.FastWarning)
        with mpsim.Simulation(scene, mpsim.Settings(method=cell.method, dt=dt)) as sim:
            sim.run(until=BEFORE / rate)
            return dict(sim.run(until=(BEFORE + cell.collisions) / rate, measures=names).measures)


def ratio(found: Sequence[Measure]) -> tuple[float, float]:
    """Scatter over claimed error of the runs that are settled, NaN for fewer than 10, and the share of the others."""
    settled = [measure for measure in found if measure.settled]
    share = 1 - len(settled) / len(found)
    if len(settled) < 10:
        return float("nan"), share
    scatter = np.std([measure.value for measure in settled], ddof=1)
    return float(scatter / np.sqrt(np.mean([measure.error**2 for measure in settled]))), share


def text_of(found: Sequence[Measure]) -> tuple[str, bool | None]:
    """A cell of the table, and whether it is right; None where nothing is claimed."""
    value, share = ratio(found)
    text = ("none" if np.isnan(value) else f"{value:.2f}") + (f" ({100 * share:.0f} %)" if share else "")
    return text, None if np.isnan(value) else RIGHT[0] <= value <= RIGHT[1]


def row(cell: Cell, seeds: int, pool: ProcessPoolExecutor) -> list[tuple[str, bool | None]]:
    """Cells of the table for one kind of run; None for what it does not have."""
    runs = list(pool.map(partial(measured, cell), range(seeds), chunksize=5))
    texts = {name: text_of([run[name] for run in runs]) for name in runs[0]}
    wrong = [name for name, (_, good) in texts.items() if good is False]
    if wrong:
        runs += pool.map(partial(measured, cell), range(seeds, AGAIN * seeds), chunksize=5)
        decided = {name: text_of([run[name] for run in runs]) for name in wrong}
        texts |= {name: (f"{text}*", good) for name, (text, good) in decided.items()}
    return [texts.get(name, ("", None)) for name in NAMES]


def table(seeds: int, lengths: dict[str, float], pool: ProcessPoolExecutor) -> tuple[str, str]:
    """The table with its explanation, and a sentence that counts the ratios that are right."""
    rows, right = [], []
    for method, of_method in METHODS.items():
        chosen = [name for name in lengths if name in of_method or name == "longest"]
        for packing, boundary, length in product(PACKINGS, BOUNDARIES, chosen):
            started = time.perf_counter()
            texts = row(Cell(method, packing, boundary, lengths[length]), seeds, pool)
            right += [good for _, good in texts if good is not None]
            rows.append((method, packing, boundary, length, *(text for text, _ in texts)))
            say(f"{' | '.join(map(str, rows[-1]))}: {time.perf_counter() - started:.1f} s")
    heads = ("method", "packing", "box", "run", *(name.replace("_", " ") for name in NAMES))
    noise = 100 / np.sqrt(2 * (seeds - 1))
    text = (
        f"{harness.table(heads, rows)}\n\n"
        f"Short runs have {lengths['short']:g} collisions per disc, long runs {lengths['long']:g}. In brackets: the "
        f"fraction of runs that are not settled and were left out; none: nearly all were left out; *: from "
        f"{AGAIN * seeds} starts, because {seeds} gave a ratio beyond the bounds."
    )
    return text, (
        f"{COUNT} discs, {seeds} starts of each kind, so each ratio is known to {noise:.0f} %: {sum(right)} of "
        f"{len(right)} ratios lie between {RIGHT[0]} and {RIGHT[1]}."
    )


BATHS: dict[str, dict[str, Any]] = {
    **{f"thermostat, rate {rate:g}": {"thermostat": mpsim.Thermostat(1.0, rate)} for rate in (0.01, 0.1, 1.0)},
    "thermostat, rate 0.1, periodic": {"boundary": "periodic", "thermostat": mpsim.Thermostat(1.0, 0.1)},
    **{
        f"thermal walls, {', '.join(edges)}": {"thermal_walls": mpsim.ThermalWalls(**dict.fromkeys(edges, 1.0))}
        for edges in (EDGES[:1], EDGES[:2], EDGES[:3], EDGES)
    },
}
"""Heat baths at kT 1, by name."""

MEMORIES = 8, 60
"""Lengths of runs with a bath, in memories of it."""

IN_BATHS = ("pressure", "pressure_xx", "contact_rate", "kinetic_energy", "velocity at lag 0", "displacement")


def in_bath(features: dict[str, Any], memories: float, seed: int) -> dict[str, Measure]:
    """The measures of one run of a quarter of the discs in a bath, which begins after three memories of it."""
    scene = mpsim.Scene.random(count=COUNT // 4, packing=0.2, radius=0.5, seed=seed, **features).redrawn(seed)
    memory, names = memory_of_baths(scene, 1.0), list(IN_BATHS[:-2])
    if all(scene.periodic):
        names.remove("pressure")
    frames = FRAMES // 2
    frame = memories * memory / frames
    gathered = mpsim.Correlations(every=max(round(0.4 / frame), 1), start=3 * memory, points=8, longest=30)
    with mpsim.Simulation(scene, mpsim.Settings(method="event", dt=frame)) as sim:
        sim.run(until=3 * memory)
        found = dict(sim.run(frames=frames, measures=names, observe=gathered).measures)
    return found | {"velocity at lag 0": gathered.velocity[0], "displacement": gathered.msd[3]}


def of_both(found: Sequence[Measure]) -> tuple[str, bool | None]:
    """As `text_of`, followed by the ratio of the runs that are not settled."""
    text, good = text_of(found)
    others = [replace(measure, settled=True) for measure in found if not measure.settled]
    value, _ = ratio(others) if others else (float("nan"), 0.0)
    return text if np.isnan(value) else f"{text}: {value:.2f}", good


def table_of_baths(seeds: int, pool: ProcessPoolExecutor) -> tuple[str, str]:
    """The table with its explanation, and a sentence that counts the ratios that are right."""
    rows, right = [], []
    for (name, features), memories in product(BATHS.items(), MEMORIES):
        runs = list(pool.map(partial(in_bath, features, memories), range(seeds), chunksize=5))
        texts = {each: of_both([run[each] for run in runs]) for each in runs[0]}
        right += [good for _, good in texts.values() if good is not None]
        rows.append((name, memories, *(texts.get(each, ("",))[0] for each in IN_BATHS)))
        say(" | ".join(map(str, rows[-1])))
    heads = ("bath", "memories", *(name.replace("_", " ") for name in IN_BATHS))
    return f"{harness.table(heads, rows)}\n\nAfter the colon: the ratio of the runs that are not settled.", (
        f"{COUNT // 4} discs at packing 0.2, {seeds} starts of each kind: of the settled ones {sum(right)} of "
        f"{len(right)} ratios lie between {RIGHT[0]} and {RIGHT[1]}."
    )


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--full", action="store_true")
    parser.add_argument("--seeds", type=int)
    parser.add_argument("--baths", action="store_true", help="those with heat baths alone")
    parser.add_argument("--docs", type=Path, help="page whose results are renewed")
    options = parser.parse_args()
    seeds = options.seeds or (400 if options.full else 100)
    lengths = LENGTHS | ({"longest": 20_000.0} if options.full else {})
    with ProcessPoolExecutor(usable_cores()) as pool:
        found = {} if options.baths else {"table": table(seeds, lengths, pool)}
        found["baths"] = table_of_baths(seeds, pool)
    for text, counted in found.values():
        say(f"{text}\n\n{counted}")
    if options.docs is not None:
        fill_page(options.docs, {name: f"{counted}\n\n{made_by()}" for name, (_, counted) in found.items()})


if __name__ == "__main__":
    sys.exit(exit_code(main))
