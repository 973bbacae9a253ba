"""The exact solver on tiles that a test chooses, and what its windows came to."""

import contextlib
import math
from collections.abc import Iterator
from typing import Any
from unittest import mock

import numpy as np

import mpsim
from mpsim.engine.solvers import event_block, event_tiles
from mpsim.engine.solvers.event_tiles import Tiling
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

    constants = mock.patch.multiple(event_tiles, HALO=halo, BRIEF=0.0)
    with mock.patch.object(event_block, "tiling_of", tiling_of), constants:
        yield


def on_tiles(scene: mpsim.Scene, tiling: tuple[int, int], workers: int = 1, **settings: Any) -> mpsim.Simulation:
    """A simulation by the exact solver whose box is divided so; (1, 1): as a whole."""
    halo = settings.pop("halo", event_tiles.HALO)
    with always_tiled(*tiling, halo=halo):
        return simulate(scene, method="event", workers=workers, **settings)


def windows_of(sim: mpsim.Simulation) -> dict[str, int]:
    """Windows played so far, those of them played again in shorter ones and by one worker, and windows in a lap."""
    plan = solver_of(sim).block.arrays["plan"]
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


def assert_played_on_tiles(sim: mpsim.Simulation) -> None:
    """Fail unless most windows were taken over from tiles: else one worker alone has found the bits."""
    found = windows_of(sim)
    assert found["windows"] > 2 * (found["again"] + found["as_one"]), found
