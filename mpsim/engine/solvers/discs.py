"""Writes discs into the block of a stepped solver, and reads them in the order of their numbers."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.core import columns
from mpsim.core.state import Box, State
from mpsim.engine.solvers.base import NewDiscs
from mpsim.engine.workers.shared import SharedBlock
from mpsim.engine.workers.worker import buffers_of
from mpsim.kernels import layout
from mpsim.kernels.features.boundary import wrap_places


def live_discs(block: SharedBlock) -> layout.Discs:
    """The buffer that holds the state."""
    return buffers_of(block)[int(block.arrays["control"].live)]


def write_discs(block: SharedBlock, new: NewDiscs, first: int) -> None:
    """Write discs `first`, `first + 1`, ... behind those that are there."""
    arrays, discs = block.arrays, live_discs(block)
    last = first + len(new.position)
    discs.x[first:last], discs.y[first:last] = new.position.T
    discs.vx[first:last], discs.vy[first:last] = new.velocity.T
    discs.id[first:last] = np.arange(first, last)
    arrays["control"].in_order = 0
    if discs.radius is not None:
        discs.radius[first:last] = new.radius
    for column in columns.COLUMNS:
        if column.name in arrays:
            arrays[column.name][..., first:last] = new.of(column).T


def places_and_speeds(block: SharedBlock, count: int) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Positions and velocities as they lie in the block, in the order of the scene's discs."""
    discs = live_discs(block)
    order = discs.id[:count]
    return _pairs_by_id(discs.x[:count], discs.y[:count], order), _pairs_by_id(
        discs.vx[:count], discs.vy[:count], order
    )


def _pairs_by_id(x: NDArray[Any], y: NDArray[Any], ids: NDArray[np.int32]) -> NDArray[np.floating]:
    """Components as rows (x, y), that of disc ids[k] from place k.

    Each row is one write: of many discs, most lie where no cache has them.
    """
    row = np.dtype(f"c{2 * x.itemsize}")
    rows = np.empty((len(x), 2), x.dtype)
    rows[:, 0], rows[:, 1] = x, y
    found = np.empty_like(rows)
    found.view(row).reshape(-1)[ids] = rows.view(row).reshape(-1)
    return found


def absorbed_in(block: SharedBlock, count: int) -> NDArray[np.bool_]:
    """Which discs have left through an absorbing edge, shape (count,)."""
    exits = block.arrays.get("exits")
    return np.zeros(count, bool) if exits is None else exits[0, :count] != 0


def state_in(block: SharedBlock, box: Box, count: int) -> State:
    """Copies in the order of the scene's discs."""
    (position, velocity), arrays = places_and_speeds(block, count), block.arrays
    found = {each.name: arrays[each.name][..., :count].T.copy() for each in columns.in_state() if each.name in arrays}
    return state_of(box, arrays, position, velocity, found, absorbed_in(block, count))


def state_of(
    box: Box,
    arrays: dict[str, Any],
    position: NDArray[np.floating],
    velocity: NDArray[np.floating],
    found: dict[str, Any],
    absorbed: NDArray[np.bool_],
) -> State:
    """The state of discs whose values are in the order of the scene's; it takes over these arrays.

    Args:
        box: as it is now.
        arrays: of the block: what does not change with the number of discs.
        position, velocity: shape (N, 2).
        found: further columns of a state, a row for each disc.
        absorbed: which discs have left, shape (N,).
    """
    for axis, wrap in enumerate((arrays.get("wrap_x"), arrays.get("wrap_y"))):
        if wrap is not None:  # a contact may have moved a disc through the border; the next step brings it back
            images = found.get(columns.IMAGE.name)
            wrap_places(position[:, axis], None if images is None else images.T, axis, wrap)
    for column in columns.in_state():
        if column.name in found and not column.rests:
            found[column.name][absorbed] = 0
    return State(position, velocity, present=~absorbed, box=box, **found)


def first_not_finite(block: SharedBlock) -> tuple[int, tuple[float, float], tuple[float, float]]:
    """The disc that a worker has found not finite, of the least id, with its position and velocity.

    After an odd number of steps the state lies in the other buffer, so both are looked at.
    """
    slots = block.arrays["team"]["bad_slot"]
    candidates = [disc_at(discs, slot) for discs in buffers_of(block) for slot in slots[slots >= 0]]
    disc, values = min(each for each in candidates if not np.isfinite(each[1]).all())
    return disc, values[:2], values[2:]


def disc_at(discs: layout.Discs, slot: int) -> tuple[int, tuple[float, float, float, float]]:
    """Number of a disc, and its place and velocity (x, y, vx, vy)."""
    values = float(discs.x[slot]), float(discs.y[slot]), float(discs.vx[slot]), float(discs.vy[slot])
    return int(discs.id[slot]), values
