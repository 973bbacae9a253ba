"""The one way into mpsim's internals, for tests of mechanisms and faults that no user can cause.

No view of the shared block outlives a call in here: the block could not be closed while one lives.
"""

from typing import Any

import numpy as np

import mpsim
from mpsim.kernels import records


def _arrays(sim: mpsim.Simulation) -> dict[str, Any]:
    return sim._solver.block.arrays


def solver_of(sim: mpsim.Simulation) -> Any:
    """The solver of a simulation."""
    return sim._solver


def block_name(sim: mpsim.Simulation) -> str:
    """Name of the shared block, a file in /dev/shm."""
    return sim._solver.block.name


def _live(sim: mpsim.Simulation, field: str) -> Any:
    buffer = "ab"[int(_arrays(sim)["control"].live)]
    return _arrays(sim)[f"{buffer}.{field}"][: sim.count]


def write(sim: mpsim.Simulation, particle: int, **values: float) -> None:
    """Write x, y, vx or vy of one disc into the live buffer, as a stray pointer would."""
    slot = int(np.flatnonzero(_live(sim, "id") == particle)[0])
    for field, value in values.items():
        _live(sim, field)[slot] = value


def scramble(sim: mpsim.Simulation, seed: int) -> None:
    """Permute the discs of the live buffer: another memory order of the same state."""
    order = np.random.default_rng(seed).permutation(sim.count)
    buffer = "ab"[int(_arrays(sim)["control"].live)]
    for field in records.Discs._fields:
        if f"{buffer}.{field}" in _arrays(sim):  # there are radii only where discs differ
            view = _live(sim, field)
            view[:] = view[order]
    _arrays(sim)["control"].in_order = 0


def peek(sim: mpsim.Simulation, worker: int) -> tuple[str, int]:
    """Phase and frame (frames finished since the start) that a worker is in at this moment."""
    mine, control = _arrays(sim)["team"][worker], _arrays(sim)["control"]
    return records.PHASES[int(mine.phase)], int(control.done + mine.frame)
