"""Common code of stepped solvers: time, steps of a frame, parameters of kernels, the grid, checks of snapshots."""

import math
from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.core import columns
from mpsim.core.columns import kept_sizes
from mpsim.core.state import Box, State
from mpsim.engine.feature_arrays import typical_momentum, wall_limits
from mpsim.engine.solvers.base import (
    MOST_COUNTED,
    Choice,
    Solver,
    SolverState,
    Steps,
    Terms,
    check_periods,
    check_shapes,
    demand,
    state_of,
)
from mpsim.engine.solvers.speeds import Fastest, SpeedLimit, Speeds
from mpsim.engine.workers.shared import MOST_FRAMES, Specs
from mpsim.features.edges import EDGES
from mpsim.features.properties import has_radii
from mpsim.kernels import records
from mpsim.kernels.features.edges import wrap_places
from mpsim.kernels.features.hooks import prepare_first_step
from mpsim.kernels.frame.sorting import BUCKET, FEW
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings

# --- The grid, and the arrays of the shared block of a stepped solver

WORDS = records.LINE_PAIR // 8  # int64 words that one worker's row of an array is a multiple of

CELLS_PER_DISC = 2
"""In a dilute scene cells grow beyond one diameter, so that there are about this many per disc."""


@dataclass(frozen=True)
class Grid:
    """Cells of the broad phase. A function of box, diameter, precision and number of discs only: never of history."""

    columns: int
    rows: int
    outside: bool = False

    @property
    def table_size(self) -> int:
        """Length of the table of cell starts, with a ghost cell below and above each column and a ghost column.

        outside: and a column for discs that are not in the grid, giants and those that have left.
        """
        return (self.columns + 1 + self.outside) * (self.rows + 2) + 1


def grid_for(scene: Scene, count: int, largest: float, precision: str) -> Grid:
    """The grid of a scene for so many discs, of which those above a radius, `largest`, are not in it [length].

    Its cells are of one diameter, larger where there are fewer discs than cells / CELLS_PER_DISC.

    A cell is wider than a diameter by the rounding of a coordinate times the number of cells, so that discs two cells
    apart can never overlap. Along an axis that wraps there are two or more, and along x an even number: the last column
    is odd, and meets the first in the odd pass, in which no other column touches either.
    """
    width, height, (wraps_x, wraps_y) = scene.width, scene.height, scene.periodic
    rounding = 8 * float(np.finfo(precision).eps) * max(width, height)
    side = max(2 * largest + rounding, math.sqrt(width * height / (CELLS_PER_DISC * max(count, 1))))
    fewest_columns, fewest_rows = 1 + wraps_x, 1 + wraps_y
    columns, rows = max(int(width / side), fewest_columns), max(int(height / side), fewest_rows)
    # In a box so thin that it has one row (or column), as many cells along it as elsewhere: their number must not grow
    # with the aspect of the box.
    most = CELLS_PER_DISC * max(count, 1)
    columns, rows = min(columns, max(most // rows, fewest_columns)), min(rows, max(most // columns, fewest_rows))
    return Grid(columns - columns % 2 if wraps_x else columns, rows, scene._loses_discs or has_radii(scene))


def block_arrays(capacity: int, grid: Grid, workers: int, precision: str, features: Specs) -> Specs:
    """Every array and record of the shared block, by name. `features` holds what only some scenes need."""
    real, length = np.dtype(precision), capacity + records.PADDING
    arrays: Specs = {}
    for buffer in ("a", "b"):
        for column in records.Discs._fields:
            if column not in records.OPTIONAL:  # those are features
                arrays[f"{buffer}.{column}"] = (np.int32 if column in records.WHOLE else real), (length,)
    arrays["start"] = np.int32, (grid.table_size,)
    for name in records.Changes._fields:
        arrays[name] = np.int32, (capacity // FEW + 1,)
    arrays["first_arrival"] = np.int32, (grid.table_size // BUCKET + workers + 1,)
    arrays["outbox"] = np.int32, (length,)
    arrays["parameters"] = records.parameters_in(precision), ()
    arrays["control"] = records.CONTROL, ()
    arrays["team"] = records.MEMBER, (workers,)
    arrays["sent"] = np.int64, (workers, -(-workers // WORDS) * WORDS)
    arrays["times"] = np.int64, (workers, MOST_FRAMES, len(records.PHASES))
    arrays["tally"] = records.TALLY, (workers, MOST_FRAMES)
    return arrays | features


# --- Checks of snapshots

SLACK = 1e-6  # fraction of the box by which rounding may have put a centre beyond its limit


def disc_at(discs: records.Discs, slot: int) -> tuple[int, tuple[float, float, float, float]]:
    """Number of a disc, and its place and velocity (x, y, vx, vy)."""
    values = float(discs.x[slot]), float(discs.y[slot]), float(discs.vx[slot]), float(discs.vy[slot])
    return int(discs.id[slot]), values


def _tally_scale(scene: Scene, settings: Settings) -> float:
    """A power of two that makes a typical momentum some 2^32: fine steps, and 2^31 discs' worth of room above."""
    typical = typical_momentum(scene, settings.dt)
    # Where the exponent of the run's floats would end, sums are coarser or the room above is less.
    most = np.finfo(settings.precision).maxexp - 28
    return 2.0 ** float(np.clip(32 - np.frexp(typical)[1], -most, most))


class SteppedSolver(Solver, Steps):
    """Runs frames that are made of equal steps."""

    def __init__(self, scene: Scene, settings: Settings, choice: Choice):
        super().__init__(scene, settings, choice)
        self.substeps: int = settings.substeps
        self._speed_limit = SpeedLimit()
        self._tally_scale = _tally_scale(scene, settings)
        self._box_at_rest = None if scene._moving_walls else scene.box

    def _set_terms(self, terms: Terms) -> None:
        if terms != self.terms:
            super()._set_terms(terms)
            self._tally_scale = _tally_scale(terms.scene, terms.settings)
            self._box_at_rest = None if terms.scene._moving_walls else terms.scene.box

    @property
    @abstractmethod
    def _arrays(self) -> dict[str, Any]:
        """Arrays and records of the block, by name."""

    @abstractmethod
    def _configure(self) -> None:
        """Write the records `parameters` and `control` for the present scene, settings and discs."""

    def _write_parameters(self, grid: Grid, giant: float | None = None) -> None:
        """Write both records for a grid. giant: radius above which discs are kept out of it [length]."""
        arrays, scene, settings = self._arrays, self._scene, self._settings
        dt = settings.dt / self.substeps
        smallest = float(self.radii.min(initial=scene.largest_radius))
        common = None if has_radii(scene) else scene.largest_radius
        parameters = arrays["parameters"]
        parameters.dt = dt
        parameters.diameter = 2 * scene.largest_radius
        parameters.limit[:] = wall_limits(scene)
        parameters.cells_per_x = grid.columns / scene.width
        parameters.cells_per_y = grid.rows / scene.height
        parameters.half_one_plus_e = (1 + scene.restitution) / 2
        parameters.wall_restitution = scene.wall_restitution
        parameters.wall_bounce = scene.wall_restitution if settings.contact == "impact" else 0.0
        parameters.tally_scale = self._tally_scale
        parameters.fast = self._speed_limit.square(dt, common, smallest, settings.precision)
        for feature in scene._features:
            feature.begin(scene, arrays, settings.dt, self._origin)
        if "giants" in arrays:
            arrays["giants"][0] = np.inf if giant is None else giant
        control = arrays["control"]
        control.count = len(self.radii)
        control.columns = grid.columns
        control.rows = grid.rows
        control.cells = grid.table_size - 1
        control.substeps = self.substeps
        control.law = records.LAWS[settings.law]
        control.contact = records.CONTACTS[settings.contact]
        control.passes = settings.passes
        control.deep = 0 if self._speed_limit.deep else -1
        control.race_free = int(not self.choice.processes.unguarded)
        control.absorbing[:] = [edge in scene.absorbing for edge in EDGES]
        prepare_first_step(arrays)

    # --- counts

    @property
    def most_momentum(self) -> float:
        return MOST_COUNTED / float(self._arrays["parameters"].tally_scale)

    def _counters(self, tally: NDArray[Any]) -> NDArray[Any]:
        """The counts of all workers, in the scene's units: COUNTS, shape (frames,).

        tally: TALLY, shape (workers, frames), in units of the kernels.
        """
        scale, diameter = float(self._arrays["parameters"].tally_scale), 2 * self._scene.largest_radius
        found = np.zeros(tally.shape[1], records.COUNTS)
        for name in records.COUNTS.names or ():
            found[name] = tally[name].sum(axis=0)
        found["deepest"] = tally["deepest"].max(axis=0)
        for name in records.IMPULSES:
            found[name] /= scale
        for name in records.DEPTHS:
            found[name] *= diameter / records.DEPTH_SCALE
        return found

    # --- time

    @property
    def time(self) -> float:
        return self._origin.time + self._frames * self._settings.dt

    @property
    def _frames(self) -> int:
        """Frames done since the origin."""
        return self.frame - self._origin.frame

    def reached(self, time: float) -> bool:
        return time < self.terms.time_of(self.frame + 1) and self.terms.frame_at(time) <= self.frame

    def _frames_to(self, stop: float, most: int) -> int:
        """Number of frames to reach the time `stop`, clipped to [1, most]."""
        frame, terms = self.frame, self.terms
        return min(most, max(terms.frame_at(stop) - frame, 1)) if stop < terms.time_of(frame + most) else most

    @property
    def _box(self) -> Box:
        """The box after the steps done: inside a frame too, where one is run pass by pass."""
        if self._box_at_rest is not None:
            return self._box_at_rest
        steps = float(self._arrays["control"].steps)
        return self._scene._box_at(self._origin.time + steps / self.substeps * self._settings.dt)

    def _state_of(self, found: dict[str, NDArray[Any]], absorbed: NDArray[np.bool_]) -> State:
        """As `state_of`, in the present box."""
        for axis, wrap in enumerate((self._arrays.get("wrap_x"), self._arrays.get("wrap_y"))):
            if wrap is not None:  # a contact may have moved a disc through the border; the next step brings it back
                images = found.get(columns.IMAGE.name)
                wrap_places(found["position"][:, axis], None if images is None else images.T, axis, wrap)
        return state_of(found, absorbed, self._box)

    # --- steps

    def set_speed_limit(self, limit: SpeedLimit) -> None:
        if limit != self._speed_limit:
            self._speed_limit = limit
            self._configure()

    def set_substeps(self, substeps: int) -> None:
        if substeps != self.substeps:
            self.substeps = substeps
            # As if all frames had had as many: the time follows from it, and a snapshot tells the sub-steps.
            self._arrays["control"].steps = self._frames * substeps
            self._configure()

    def _or_too_fast(self, found: Speeds, fastest: Fastest) -> Speeds:
        """These speeds, or that of the disc that was too fast in the last command, or pinched, which is told once."""
        self.too_fast: bool = False
        fraction, disc = fastest[0], -fastest[1]
        if not fraction:
            return found
        if fraction >= records.PRESSED:
            return replace(found, pressed=True) if fraction == records.PRESSED else replace(found, pinched=disc)
        radius, fast = float(self.radii[disc]), float(self._arrays["parameters"].fast)
        speed = fraction / records.FASTEST_SCALE * math.sqrt(fast)
        speed *= radius if has_radii(self._scene) else 1.0  # with own radii `fast` is of speeds per radius
        return found.or_faster(Speeds(disc, speed, radius, when=f"in frame {self.frame - 1}"))

    # --- the grid

    def _grid_of(self, count: int, giant: float | None = None) -> Grid:
        """The grid for so many discs; giant: radius above which discs are kept out of it."""
        largest = self._scene.largest_radius if giant is None else giant
        return grid_for(self._scene, count, largest, self._settings.precision)

    # --- snapshots

    def _snapshot_of(self, moved: SolverState) -> SolverState:
        """What a snapshot holds: what steps have moved, and all else that the next frame depends on."""
        arrays, control = self._arrays, self._arrays["control"]
        found = moved | {"radii": self.radii, "masses": self.masses}
        for column in columns.COLUMNS:
            if column.kept and column.name in arrays and column.name not in moved:
                found[column.name] = column.take(arrays[column.name], self.count)
        return found | {"progress": np.array([control.done, control.steps])} | self._saved_work()

    def _begin_from(self, snapshot: SolverState) -> tuple[int, int]:
        """Take over what a snapshot says of all discs. Returns the frames and the steps that were done."""
        self.radii: NDArray[np.float64] = kept_sizes(snapshot["radii"])
        self.masses: NDArray[np.float64] = kept_sizes(snapshot["masses"])
        self.count: int = len(self.radii)
        frames, steps = snapshot["progress"].tolist()
        self.substeps = steps // frames if frames else self._settings.substeps
        return frames, steps

    @staticmethod
    def check_snapshot(scene: Scene, settings: Settings, snapshot: SolverState) -> None:
        real, count = np.dtype(settings.precision), len(snapshot["radii"])
        shapes: Specs = {"position": (real, (count, 2)), "velocity": (real, (count, 2))}
        kept = [column for column in scene._columns if column.kept]
        shapes |= {column.name: (column.dtype(real), column.rows(count)) for column in kept}
        check_shapes(snapshot, shapes)
        for name in ("velocity", *(column.name for column in kept if column.in_state or column.given)):
            demand(np.isfinite(snapshot[name]).all(), f"{name} must be finite")
        _check_places(scene, snapshot["position"])
        if "exits" in snapshot:
            gone, *places = snapshot["exits"].T
            demand(((gone == 0) | (gone == 1)).all(), "a disc has left or it has not")
            _check_places(scene, np.stack(places, axis=1))
        if "image" in snapshot:
            check_periods(scene, snapshot["image"])


def _check_places(scene: Scene, position: NDArray[np.floating]) -> None:
    """Centres between walls are in the box; through a periodic border a contact may have moved them."""
    for axis, length in enumerate((scene.width, scene.height)):
        places = position[:, axis]
        demand(np.isfinite(places).all(), "position must be finite")
        inside = (places >= -SLACK * length) & (places <= (1 + SLACK) * length)
        demand(scene.periodic[axis] or inside.all(), "position must be in the box")
