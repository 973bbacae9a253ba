"""Common code of stepped solvers: time, steps of a frame, the grid, discs, snapshots."""

from abc import abstractmethod
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from mpsim.core import columns
from mpsim.core.columns import ChunkedArray, kept_sizes
from mpsim.core.state import Box, State
from mpsim.engine.feature_arrays import columns_of, typical_momentum
from mpsim.engine.report import frames_until
from mpsim.engine.solvers import base
from mpsim.engine.solvers.base import (
    Capabilities,
    Choice,
    NewDiscs,
    Shapes,
    Solver,
    SolverState,
    Terms,
    check_periods,
    demand,
    shapes_in_each,
)
from mpsim.engine.solvers.speeds import SpeedLimit, Speeds, speeds_of
from mpsim.engine.workers.shared import Grid, SharedBlock, grid_for
from mpsim.engine.workers.worker import buffers_of
from mpsim.features.properties import has_radii
from mpsim.kernels import records
from mpsim.kernels.features.edges import wrap_places
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings

# --- Writes discs into the block of a stepped solver, and reads them in the order of their numbers


def live_discs(block: SharedBlock) -> records.Discs:
    """The buffer that holds the state."""
    return buffers_of(block)[int(block.arrays["control"]["live"])]


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


def _slots_of(discs: records.Discs, numbers: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Where the discs of these numbers lie."""
    slots = np.flatnonzero(np.isin(discs.id[:count], numbers))
    order = np.argsort(discs.id[slots])
    return slots[order][np.argsort(np.argsort(numbers))]


def discs_of(
    block: SharedBlock, numbers: NDArray[np.int64], radii: NDArray[np.float64], masses: NDArray[np.float64]
) -> NewDiscs:
    """Copies of some discs, with all that they have.

    Args:
        block: in which they are.
        numbers: of the discs, shape (K,), each once.
        radii, masses: of all discs, shape (N,) [length], [mass].
    """
    discs, arrays = live_discs(block), block.arrays
    slots = _slots_of(discs, numbers, len(radii))
    position, velocity = np.stack([discs.x[slots], discs.y[slots]], 1), np.stack([discs.vx[slots], discs.vy[slots]], 1)
    found = {each.name: arrays[each.name][..., numbers].T.copy() for each in columns.COLUMNS if each.name in arrays}
    return NewDiscs(position, velocity, radii[numbers], {**found, columns.MASS.name: masses[numbers]})


def write_discs_of(block: SharedBlock, new: NewDiscs, numbers: NDArray[np.int64], count: int) -> None:
    """Write discs in place of those of these numbers, of the same radii; count: of all discs."""
    arrays, discs = block.arrays, live_discs(block)
    slots = _slots_of(discs, numbers, count)
    discs.x[slots], discs.y[slots] = new.position.T
    discs.vx[slots], discs.vy[slots] = new.velocity.T
    arrays["control"].in_order = 0
    for column in columns.COLUMNS:
        if column.name in arrays:
            arrays[column.name][..., numbers] = new.of(column).T


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
    return State._taken_over(position, velocity, ~absorbed, box, found)


def first_not_finite(block: SharedBlock) -> tuple[int, tuple[float, float], tuple[float, float]]:
    """The disc that a worker has found not finite, of the least id, with its position and velocity.

    After an odd number of steps the state lies in the other buffer, so both are looked at.
    """
    slots = block.arrays["team"]["bad_slot"]
    candidates = [disc_at(discs, slot) for discs in buffers_of(block) for slot in slots[slots >= 0]]
    disc, values = min(each for each in candidates if not np.isfinite(each[1]).all())
    return disc, values[:2], values[2:]


def disc_at(discs: records.Discs, slot: int) -> tuple[int, tuple[float, float, float, float]]:
    """Number of a disc, and its place and velocity (x, y, vx, vy)."""
    values = float(discs.x[slot]), float(discs.y[slot]), float(discs.vx[slot]), float(discs.vy[slot])
    return int(discs.id[slot]), values


# --- Snapshots of stepped solvers: how they are taken, and checks of their content

SLACK = 1e-6
"""Fraction of the box by which rounding may have put a centre beyond its limit."""


class AsTheyLay(ChunkedArray):
    """Pairs of numbers of each disc, copied as they lay in memory, and put in order when somebody reads them.

    Args:
        x, y: shape (N,).
        numbers: of the discs, shape (N,).
    """

    def __init__(self, x: NDArray[np.floating], y: NDArray[np.floating], numbers: NDArray[np.int32]):
        super().__init__(x.dtype, (len(x), 2), lambda first, last: self._in_order[first:last])
        self.x: NDArray[np.floating] = x
        self.y: NDArray[np.floating] = y
        self.numbers: NDArray[np.int32] = numbers
        self.nbytes: int = x.nbytes + y.nbytes

    @cached_property
    def _in_order(self) -> NDArray[np.floating]:
        return _pairs_by_id(self.x, self.y, self.numbers)


def taken(block: SharedBlock, radii: NDArray[np.float64], masses: NDArray[np.float64]) -> SolverState:
    """A snapshot of the discs of a block.

    Args:
        block: with as many discs in it.
        radii, masses: of the discs, shape (N,), read-only [length], [mass].
    """
    arrays, count, discs = block.arrays, len(radii), live_discs(block)
    x, y, vx, vy = rows = np.empty((4, count), discs.x.dtype)
    for row, column in zip(rows, (discs.x, discs.y, discs.vx, discs.vy), strict=True):
        row[:] = column[:count]
    numbers = discs.id[:count].copy()
    position, velocity = AsTheyLay(x, y, numbers), AsTheyLay(vx, vy, numbers)
    found: SolverState = {"position": position, "velocity": velocity, "radii": radii, "masses": masses}
    for column in columns.COLUMNS:
        if column.kept and column.name in arrays:
            found[column.name] = column.take(arrays[column.name], count)
    control = arrays["control"]
    found["progress"] = np.array([control.done, control.steps])
    return found


def put_as_they_lay(block: SharedBlock, snapshot: SolverState) -> bool:
    """Write places and speeds back in the order in which they lay; False where a snapshot does not have that."""
    position, velocity = snapshot["position"], snapshot["velocity"]
    if not isinstance(position, AsTheyLay) or not isinstance(velocity, AsTheyLay):
        return False
    arrays, discs, count = block.arrays, live_discs(block), len(position)
    discs.x[:count], discs.y[:count] = position.x, position.y
    discs.vx[:count], discs.vy[:count] = velocity.x, velocity.y
    discs.id[:count] = position.numbers
    if discs.radius is not None:
        discs.radius[:count] = snapshot["radii"][position.numbers]
    if columns.MASS.name in arrays:
        columns.MASS.put(arrays[columns.MASS.name], snapshot["masses"])
    arrays["control"].in_order = 0
    return True


def shapes(scene: Scene, real: np.dtype[Any], count: int) -> Shapes:
    """dtype and shape of every array of a snapshot in that precision."""
    found: Shapes = {"position": (real, (count, 2)), "velocity": (real, (count, 2))}
    for column in columns_of(scene):
        if column.kept:
            found[column.name] = column.dtype(real), column.rows(count)
    return found | shapes_in_each(count)


def check(scene: Scene, arrays: SolverState) -> None:
    """Raise ValueError unless the discs of a snapshot can be in the scene."""
    demand(np.isfinite(arrays["velocity"]).all(), "velocity must be finite")
    _check_places(scene, arrays["position"])
    for column in columns.COLUMNS:
        if column.name in arrays and (column.in_state or column.given):
            demand(np.isfinite(arrays[column.name]).all(), f"{column.name} must be finite")
    if "exits" in arrays:
        gone, *places = arrays["exits"].T
        demand(((gone == 0) | (gone == 1)).all(), "a disc has left or it has not")
        _check_places(scene, np.stack(places, axis=1))
    if "image" in arrays:
        check_periods(scene, arrays["image"])


def _check_places(scene: Scene, position: NDArray[np.floating]) -> None:
    """Centres between walls are in the box; through a periodic border a contact may have moved them."""
    for axis, length in enumerate((scene.width, scene.height)):
        places = position[:, axis]
        demand(np.isfinite(places).all(), "position must be finite")
        inside = (places >= -SLACK * length) & (places <= (1 + SLACK) * length)
        demand(scene.periodic[axis] or inside.all(), "position must be in the box")


# --- Common code of stepped solvers: time, division of frames into steps, the grid, snapshots


def _tally_scale(scene: Scene, settings: Settings) -> float:
    """A power of two that makes a typical momentum some 2^32: fine steps, and 2^31 discs' worth of room above."""
    typical = typical_momentum(scene, settings.dt)
    # Where the exponent of the run's floats would end, sums are coarser or the room above is less.
    most = np.finfo(settings.precision).maxexp - 28
    return 2.0 ** float(np.clip(32 - np.frexp(typical)[1], -most, most))


class SteppedSolver(Solver):
    """Runs frames that are made of equal steps."""

    capabilities: ClassVar[Capabilities] = Capabilities(has_steps=True)
    count: int

    def __init__(self, scene: Scene, settings: Settings, choice: Choice):
        super().__init__(scene, settings, choice)
        self.substeps: int = settings.substeps
        self._speed_limit = SpeedLimit()
        self._tally_scale = _tally_scale(scene, settings)
        self._box_at_rest = None if scene._moving_wall else scene.box

    def _assume(self, terms: Terms) -> None:
        if terms != self.terms:
            super()._assume(terms)
            self._tally_scale = _tally_scale(terms.scene, terms.settings)
            self._box_at_rest = None if terms.scene._moving_wall else terms.scene.box

    @abstractmethod
    def _configure(self) -> None:
        """Write the records `parameters` and `control`, which follow from what is simulated now."""

    @property
    @abstractmethod
    def _control(self) -> Any:
        """The record `control`."""

    @property
    @abstractmethod
    def _parameters(self) -> Any:
        """The record `parameters`."""

    @property
    def most_momentum(self) -> float:
        return base.MOST_COUNTED / float(self._parameters.tally_scale)

    # --- counts

    def _totals(self, tally: NDArray[Any]) -> NDArray[Any]:
        """What all workers counted, in the scene's units: COUNTS, shape (frames,). tally: as of `slices.totals`."""
        return base.totals(tally, float(self._parameters.tally_scale), 2 * self._scene.largest_radius)

    # --- time

    @property
    def time(self) -> float:
        return self.time_of(self.frame)

    @property
    def _frames(self) -> int:
        """Frames done since the origin."""
        return self.frame - self.origin.frame

    def reached(self, time: float) -> bool:
        frames, dt, time = self._frames, self._settings.dt, time - self.origin.time
        return time < (frames + 1) * dt and frames_until(time, dt) <= frames

    def _frames_to(self, stop: float, most: int) -> int:
        """Frames until one reaches the time `stop`, at least one, and at most so many."""
        frames, dt, stop = self._frames, self._settings.dt, stop - self.origin.time
        return min(most, max(frames_until(stop, dt) - frames, 1)) if stop < (frames + most) * dt else most

    @property
    def _box(self) -> Box:
        """The box after the steps done: inside a frame too, where one is run pass by pass."""
        if self._box_at_rest is not None:
            return self._box_at_rest
        return self._scene._box_at(self.origin.time + float(self._control.steps) / self.substeps * self._settings.dt)

    # --- steps

    def set_speed_limit(self, limit: SpeedLimit) -> None:
        if limit != self._speed_limit:
            self._speed_limit = limit
            self._configure()

    def divide(self, substeps: int) -> None:
        """Divide the frames that follow into so many steps.

        The count of steps becomes what it would be if all frames had had as many: so the time follows from it as
        before, and a snapshot tells the number of sub-steps.
        """
        if substeps != self.substeps:
            self.substeps = substeps
            self._control.steps = self._frames * substeps
            self._configure()

    def _speeds(self, velocity: NDArray[Any], absorbed: NDArray[np.bool_], new: NewDiscs | None) -> Speeds:
        """How fast discs of such velocities are, those that are about to be added included."""
        scene, radii, present = self._scene, self._radii, ~absorbed
        if new is not None:
            velocity, radii = np.concatenate([velocity, new.velocity]), kept_sizes(radii, new.radius)
            present = np.append(present, np.ones(len(new.position), bool))
        return speeds_of(velocity, radii, scene, self.time, present if scene._loses_discs else None)

    # --- the grid

    def _grid_of(self, count: int, giant: float | None = None) -> Grid:
        """The grid for so many discs; giant: radius above which discs are kept out of it."""
        scene = self._scene
        largest = scene.largest_radius if giant is None else giant
        outside = scene._loses_discs or has_radii(scene)
        return grid_for(
            count, scene.width, scene.height, 2 * largest, self._settings.precision, scene.boundary, outside
        )

    # --- snapshots

    def _begin_from(self, snapshot: SolverState) -> tuple[int, int]:
        """Take over what a snapshot says of all discs. Returns the frames and the steps that were done."""
        self._radii, self._masses = kept_sizes(snapshot["radii"]), kept_sizes(snapshot["masses"])
        self.count = len(self._radii)
        frames, steps = snapshot["progress"].tolist()
        self.substeps = steps // frames if frames else self._settings.substeps
        return frames, steps

    @staticmethod
    def snapshot_shapes(scene: Scene, settings: Settings, count: int) -> Shapes:
        return shapes(scene, np.dtype(settings.precision), count)

    @staticmethod
    def check_snapshot(scene: Scene, settings: Settings, snapshot: SolverState) -> None:
        check(scene, snapshot)
