"""Costs and errors of settings on six scenes: tables and pictures under results/tradeoff/.

python scripts/run_tradeoff.py                    all scenes, some two minutes on two cores
python scripts/run_tradeoff.py --answers          and what follows from them, with tuned settings: two minutes more
python scripts/run_tradeoff.py dense --fresh      one scene, anew
python scripts/run_tradeoff.py --retime           keep the errors, measure costs anew (the machine was busy)
python scripts/run_tradeoff.py --full             longer runs and more of them: a quarter of an hour

An interrupted call continues where it stopped. Scenes: 200 discs in a square box at packing 0.1, 0.4 and 0.7, kT = 1;
with gravity such that m g L is 4, 10 and 30 kT (L: side of the box), settled before the start.
"""

import argparse
import json
import math
import multiprocessing
import signal
import sys
import time
from concurrent.futures import Executor, ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

from harness import console, exit_code, fill_page, made_by, make_folder, parser_of, progress_bar, say
from rich.progress import Progress
from tradeoff_answers import push_against_tuned, where_exact_is_cheaper
from tradeoff_figures import markdown_table, save

import mpsim
from mpsim.core.machine import usable_cores

COUNT = 200
SEED = 1


class Place(NamedTuple):
    """A scene by packing fraction, weight m g L [kT] (0: no gravity), and length of a run [time]."""

    packing: float
    weight: float
    until: float


SCENES = {
    "dilute": Place(0.1, 0, 160),
    "dilute-gravity": Place(0.1, 4, 160),
    "medium": Place(0.4, 0, 40),
    "medium-gravity": Place(0.4, 10, 40),
    "dense": Place(0.7, 0, 15),
    "dense-gravity": Place(0.7, 30, 15),
}

REPLICAS, FULL_REPLICAS = 16, 32

SHOWN = {
    "frontier-medium-pressure.png": "medium/frontier_pressure.png",
    "overview-dense.png": "dense/overview.png",
    **{f"{name}.md": f"{name}/table.md" for name, place in SCENES.items() if not place.weight},
}
"""Pictures and tables that docs/accuracy.md shows or links to."""

LONGER = 4
"""So many times longer is a run with --full."""

LEAVE_CTRL_C = (signal.SIGINT, signal.SIG_IGN)
"""Processes that compute leave Ctrl-C to the one that started them."""


def arguments() -> argparse.Namespace:
    parser = parser_of(__doc__)
    parser.add_argument("scenes", nargs="*", metavar="scene", help=f"{', '.join(SCENES)} (default: all)")
    parser.add_argument("--full", action="store_true", help="longer runs and more of them")
    parser.add_argument("--fresh", action="store_true", help="forget what earlier calls have kept")
    parser.add_argument("--retime", action="store_true", help="measure costs anew and keep the lower; keep errors")
    parser.add_argument("--answers", action="store_true", help="also answer what the docs ask, with tuned settings")
    parser.add_argument("--out", type=Path, default=Path("results/tradeoff"), help="default: results/tradeoff")
    parser.add_argument("--docs", type=Path, help="page whose tables and pictures are renewed: docs/accuracy.md")
    options = parser.parse_args()
    unknown = [name for name in options.scenes if name not in SCENES]
    if unknown:
        parser.error(f"scene must be one of {', '.join(SCENES)}; got {unknown[0]!r}.")
    return options


def scene_of(place: Place) -> mpsim.Scene:
    """The scene, at kT = 1, settled under its gravity."""
    gas: Any = {"count": COUNT, "packing": place.packing, "radius": 0.5, "seed": SEED}
    scene = mpsim.Scene.random(**gas)
    if not place.weight:
        return scene
    scene = mpsim.Scene.random(**gas, gravity=(0.0, -place.weight / scene.height))
    for _ in range(20):  # falling heats: cool to kT = 1 again and again
        with mpsim.Simulation(scene, mpsim.Settings(method="event", dt=5.0)) as sim:
            sim.run(frames=1)
            state = sim.state
        velocity = state.velocity / math.sqrt(float((state.velocity**2).mean()))
        scene = scene.starting_from(mpsim.State(state.position, velocity))
    return scene


def description(scene: mpsim.Scene, place: Place) -> str:
    """What gravity does to the scene, in words."""
    if not place.weight:
        return ""
    low, samples = 0.0, 100
    with mpsim.Simulation(scene, mpsim.Settings(method="event", dt=1.0)) as sim:
        for _ in range(samples):
            sim.run(frames=1)
            low += float((sim.state.position[:, 1] < scene.height / 2).mean()) / samples
    return (
        f"Gravity: m g L = {place.weight:g} kT, L being the side of the box; {low:.0%} of the discs in its lower half."
    )


def table_of(
    name: str, scene: mpsim.Scene, options: argparse.Namespace, pool: Executor, progress: Progress
) -> mpsim.Tradeoff:
    """The table of one scene; what is finished is kept beside it."""
    place, folder = SCENES[name], options.out / name
    kept = folder / ("runs-full.jsonl" if options.full else "runs.jsonl")
    if options.fresh:
        kept.unlink(missing_ok=True)
    costs = costs_taken(kept) if options.retime and kept.exists() else {}
    task = progress.add_task(name, total=1)

    def tick(done: int, of: int, what: str) -> None:
        progress.update(task, completed=done, total=of, description=f"{name}: {what}")

    longer, replicas = (LONGER, FULL_REPLICAS) if options.full else (1, REPLICAS)
    how: dict[str, Any] = {"until": place.until * longer, "replicas": replicas, "path": kept}
    table = mpsim.tradeoff(scene, **how, executor=pool, progress=tick)
    if costs:
        keep_lower(kept, costs)
        table = mpsim.tradeoff(scene, **how)
    return table


def costs_taken(path: Path) -> dict[str, Any]:
    """Take the costs out of a file of finished runs, and return them."""
    head, *lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join([head, *(line for line in lines if not is_cost(json.loads(line)))]))
    return costs_in(lines)


def keep_lower(path: Path, costs: dict[str, Any]) -> None:
    """Put back the costs that were lower than the new ones: what else runs on a machine only ever adds."""
    new = costs_in(path.read_text().splitlines()[1:])
    with path.open("a") as file:  # the later line counts
        for key, cost in costs.items():
            if cost.get("median", math.inf) < new.get(key, {}).get("median", 0):
                file.write(json.dumps({"key": key, "result": cost}) + "\n")


def costs_in(lines: list[str]) -> dict[str, Any]:
    return {each["key"]: each["result"] for each in map(json.loads, lines) if is_cost(each)}


def is_cost(line: dict[str, Any]) -> bool:
    return line["key"].startswith("cost ")


def write(table: mpsim.Tradeoff, words: str, made: str, folder: Path) -> None:
    """The table in three forms."""
    table.to_csv(folder / "table.csv")
    table.to_json(folder / "table.json")
    text = [markdown_table(table), words, made]
    (folder / "table.md").write_text("\n\n".join(part for part in text if part) + "\n")


def run(options: argparse.Namespace) -> None:
    """All that was asked for."""
    made = made_by()
    found: dict[str, mpsim.Tradeoff] = {}
    # Processes, whose short runs do not wait for each other's Python as threads would; idle while costs are taken.
    pool = ProcessPoolExecutor(usable_cores(), multiprocessing.get_context("forkserver"), signal.signal, LEAVE_CTRL_C)
    with pool, progress_bar() as progress:
        for name in options.scenes or SCENES:
            folder = options.out / name
            make_folder(folder)
            scene = scene_of(SCENES[name])
            words = description(scene, SCENES[name])
            found[name] = table_of(name, scene, options, pool, progress)
            write(found[name], words, made, folder)
            say(f"{name}. {words}")
            say(str(found[name]))
        progress.add_task("pictures", total=None)
        list(pool.map(save, found.values(), [options.out / name for name in found]))
        if not (options.answers or options.docs or options.full):
            return
        progress.add_task("answers", total=None)
        answers = {
            "push": push_against_tuned(options.out / "answers.json", options.full, options.fresh or options.retime),
            "exact": where_exact_is_cheaper(found),
        }
    text = "\n\n".join(answers.values())
    (options.out / "answers.md").write_text(f"{text}\n\n{made}\n")
    say(text)
    if options.docs:
        shown = {name: options.out / source for name, source in SHOWN.items() if (options.out / source).exists()}
        fill_page(options.docs, answers | {"made": made}, shown)


def main() -> int:
    options = arguments()
    started = time.perf_counter()
    make_folder(options.out)
    try:
        run(options)
    except KeyboardInterrupt:
        console.print("Interrupted; the same call, without --fresh, continues from what is finished.")
        return 130
    console.print(f"{time.perf_counter() - started:.1f} s; all is in {options.out}/")
    return 0


if __name__ == "__main__":
    sys.exit(exit_code(main))
