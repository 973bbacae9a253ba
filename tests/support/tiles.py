"""The exact solver on tiles that a test chooses, and what its windows came to."""

import contextlib
import math
from collections.abc import Iterator
from typing import Any
from unittest import mock

import numpy as np

import mpsim
from mpsim.engine.solvers import event_block, event_tiles
from mpsim.engine.solvers.event_tiles import Tiling, arguments_of
from mpsim.kernels.compiling import compiled
from mpsim.kernels.events import records, windows
from support.internals import solver_of
from support.scenes import simulate


def everything(count: int) -> dict[str, Any]:
    """Arguments of a scene with most of what the exact solver can do; tests share it, as it is compiled once."""
    index = np.arange(count)
    return {
        "radius": np.where(index % 3 == 0, 0.5, 0.375),
        "mass": np.where(index % 3 == 0, 2.0, 0.5),
        "gravity": (0.25, -1.0),
        "boundary": ("periodic", "walls"),
        "restitution": 0.9,
        "wall_restitution": 0.95,
        "friction": 0.5,
        "wall_friction": 0.25,
        "tangential_restitution": 0.5,
        "obstacles": [mpsim.FixedDisc((5.0, 5.0), 0.8)],
    }


@contextlib.contextmanager
def always_tiled(columns: int, rows: int = 1, halo: int = event_tiles.HALO) -> Iterator[None]:
    """Divide every box into so many tiles, with such a halo, however many discs and workers there are.

    The halo is thinner where a periodic axis has no room for it.
    """
    tiling = Tiling(columns, rows)

    def tiling_of(count: int, cells: tuple[int, int], periodic: tuple[bool, bool], workers: int) -> Tiling:
        room = [
            (length - math.ceil(length / number)) // 2
            for length, number, around in zip(cells, tiling, periodic, strict=True)
            if around and number > 1
        ]
        event_tiles.HALO = min([halo, *room])
        return tiling

    with mock.patch.object(event_block, "tiling_of", tiling_of), mock.patch.object(event_tiles, "HALO", halo):
        yield


def on_tiles(scene: mpsim.Scene, tiling: tuple[int, int], workers: int = 1, **settings: Any) -> mpsim.Simulation:
    """A simulation by the exact solver whose box is divided so; (1, 1): as a whole."""
    halo = settings.pop("halo", event_tiles.HALO)
    with always_tiled(*tiling, halo=halo):
        return simulate(scene, method="event", workers=workers, **settings)


def windows_of(sim: mpsim.Simulation) -> dict[str, int]:
    """Windows played so far, those of them played again in shorter ones and by one worker, and windows in a lap."""
    plan = solver_of(sim)._block.arrays["plan"]
    return {name: int(plan[name]) for name in ("windows", "again", "as_one", "parts")}


def tallies(sim: mpsim.Simulation, frames: int) -> Any:
    """Run so many frames, and return what was counted of each: impulses on walls, virials, collisions."""
    solver, found = solver_of(sim), []
    while frames:  # a command may finish fewer
        found.append(solver.advance(frames, solver.choice.workers[0], count_enabled=True).counters)
        frames -= len(found[-1])
    return np.concatenate(found)


def first_free_place(state: mpsim.State, radius: float = 0.5) -> list[float]:
    """A place for one more disc, beside the others."""
    low, high = np.array(state.box[0::2]) + radius, np.array(state.box[1::2]) - radius
    for place in np.random.default_rng(1).uniform(low, high, (100_000, 2)):
        if np.hypot(*(state.position - place).T).min() > 2 * radius + 0.01:
            return place.tolist()
    raise AssertionError("there is no room")


def begin_with_long_windows(sim: mpsim.Simulation) -> None:
    """Make the next window as long as a lap of the calendar, far longer than discs collide once in."""
    solver_of(sim)._block.arrays["plan"].parts = 1


def has_lost_discs(sim: mpsim.Simulation) -> bool:
    """Whether two tiles have taken one disc, or none has taken one, so that there is no state."""
    numbers = solver_of(sim)._block.arrays["event"]["number"]
    return len(np.unique(numbers)) < len(numbers)


def assert_played_on_tiles(sim: mpsim.Simulation) -> None:
    """Fail unless most windows were taken over from tiles: else one worker alone has found the bits."""
    found = windows_of(sim)
    assert found["windows"] > 2 * (found["again"] + found["as_one"]), found


# --- windows by hand ----------------------------------------------------------------------------------------------


NEVER = np.iinfo(np.int64).max
"""A deadline [ns] that does not come."""


@compiled
def play_all(whole, box, features, shared, own):
    """Play each tile of a planned window."""
    windows.play_tiles(whole, features, box, shared, own, 0, NEVER)


@compiled
def end_all(whole, features, shared, progress, seen, times, totals):
    """Take a window over, whatever tiles have found."""
    windows.take_discs(whole, features, shared, 0)
    windows.take_over(whole, shared, progress, seen, times, totals)


def play_without_comparing(sim: mpsim.Simulation, frames: int, parts: int) -> None:
    """Play frames in windows that are taken over unseen, as one process would do it without sums along borders.

    parts: windows in a lap.
    """
    solver = solver_of(sim)
    whole, features, box, shared, own = arguments_of(solver._block.arrays, solver._system.features, solver._system.box)
    windows.order_by_tiles(whole, box, features, shared.tiles, shared.plan)
    shared.times.reached = solver._present
    times, totals = np.zeros((2, frames), np.int64), np.zeros(0, records.TOTALS)
    shared.plan.done, shared.plan.parts = 0, parts
    kept = solver._progress, solver._seen
    while shared.plan.done < frames:
        left = frames - shared.plan.done
        windows.plan_window(shared.plan, shared.times, whole.clock, solver._progress.frame, left, math.inf)
        shared.plan.stops, shared.plan.next[0] = 0, 0
        play_all(whole, box, features, shared, own)
        end_all(whole, features, shared, *kept, times, totals)
    windows.link(whole, box, features, own.places)
