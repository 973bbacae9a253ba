"""Stepped solvers in shared memory: the block, its growth, and the execution of commands."""

import math
import os
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mpsim.core import columns
from mpsim.core.columns import kept_sizes
from mpsim.core.deferred_signals import interrupts_held_back
from mpsim.core.state import State
from mpsim.engine.feature_arrays import feature_specs, fill_features, given_in, wall_limits
from mpsim.engine.solvers import base, stepped
from mpsim.engine.solvers.base import (
    Choice,
    InPlace,
    NewDiscs,
    Origin,
    Result,
    Slice,
    SolverState,
    Terms,
    count_in,
)
from mpsim.engine.solvers.speeds import SpeedLimit, Speeds, disc_too_fast, fastest_in, speeds_of
from mpsim.engine.solvers.stepped import (
    SteppedSolver,
    absorbed_in,
    discs_of,
    first_not_finite,
    live_discs,
    places_and_speeds,
    state_in,
    state_of,
    write_discs,
    write_discs_of,
)
from mpsim.engine.workers.shared import MOST_FRAMES, ArraySpec, Grid, SharedBlock, block_arrays, resident_bytes
from mpsim.errors import DivergedError
from mpsim.features.edges import EDGES
from mpsim.features.properties import has_radii
from mpsim.kernels import records
from mpsim.kernels.features import collisions
from mpsim.kernels.features.collisions import ROWS
from mpsim.kernels.features.hooks import prepare_first_step
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings

# --- The log of collisions of stepped solvers


class Begun(NamedTuple):
    """When a command began, and what then was in force.

    Attributes:
        scene: in force.
        origin: since when it is.
        frame: frames done.
        dt: length of a frame [time].
        substeps: steps of each.
    """

    scene: Scene
    origin: Origin
    frame: int
    dt: float
    substeps: int


class StepLog:
    """What is in the logs of a block, as tables, and how much room there is in them.

    Attributes:
        frames_that_fit: frames that a command may have, so that a log is about half full after it; at least one.
    """

    def __init__(self) -> None:
        self._least = 1
        self._tables: list[NDArray[Any]] = []
        self.frames_that_fit: int = MOST_FRAMES

    def specs(self, count: int, workers: int) -> dict[str, ArraySpec]:
        """The arrays of the logs in a block for so many discs."""
        return base.specs_of(count, workers, self._least)

    def begin(self, arrays: Mapping[str, Any]) -> None:
        """Empty the logs for a command."""
        arrays[collisions.STATE][:] = 0

    def take(self, arrays: Mapping[str, Any], frames: int, begun: Begun) -> bool:
        """Take over what a command of so many frames has left in the logs. False: not all of it has fitted.

        Then a block that is made from now on has room for it.
        """
        longest, room = base.longest(arrays), arrays[collisions.ROWS].shape[1]
        if longest > room:
            self._least = 2 * longest
            return False
        self.frames_that_fit = max(min(frames * room // (2 * longest or 1), 2 * self.frames_that_fit, MOST_FRAMES), 1)
        arrays[collisions.STATE][:, collisions.AGREED] = arrays[collisions.STATE][:, collisions.COUNT]
        self._tables.append(_table(base.emptied(arrays), begun))
        return True

    def taken(self) -> NDArray[Any]:
        """The collisions since the last call."""
        tables, self._tables = self._tables, []
        return base.in_order(base.joined(tables))


def _table(rows: NDArray[Any], begun: Begun) -> NDArray[Any]:
    step, origin = rows["span"] - 1, begun.origin
    frame, ended = begun.frame + step // begun.substeps, (step % begun.substeps + 1) / begun.substeps
    time = origin.time + ((frame - origin.frame + ended) * begun.dt - rows["time"])
    for edge in range(4):
        hit = (rows["kind"] == collisions.WALL) & (rows["j"] == edge)
        rows["place"][hit, edge // 2] = _wall_at(begun.scene, edge, time[hit])
    return base.table_of(rows, frame + 1, time, begun.scene)


def _wall_at(scene: Scene, edge: int, time: NDArray[np.float64]) -> float | NDArray[np.float64]:
    """Where the wall of an edge is at times [length]."""
    wall = scene._moving_wall
    if wall is None or wall.edge != edge:
        return scene.box[edge]
    return np.array([wall.place(each) for each in time.tolist()])


# --- The records `parameters` and `control` of stepped solvers, from scene, settings and number of discs


class Present(NamedTuple):
    """What changes while a scene is simulated.

    Attributes:
        radii: of all discs, shape (N,) [length].
        grid: of the broad phase.
        giant: radius above which discs are kept out of it [length]; None: there are no such discs.
        substeps: steps of a frame.
        speed_limit: when a disc is too fast.
        origin: frame and time from which frames and steps are counted.
        tally_scale: by which impulses are multiplied before they are counted.
        unguarded: whether neighbouring columns are resolved at the same time, a race.
    """

    radii: NDArray[np.float64]
    grid: Grid
    giant: float | None
    substeps: int
    speed_limit: SpeedLimit
    origin: tuple[int, float]
    tally_scale: float
    unguarded: bool = False


def configure(arrays: dict[str, Any], scene: Scene, settings: Settings, now: Present) -> None:
    """Write both records into a block."""
    grid, dt = now.grid, settings.dt / now.substeps
    smallest = float(now.radii.min(initial=scene.largest_radius))
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
    parameters.tally_scale = now.tally_scale
    parameters.fast = now.speed_limit.square(dt, common, smallest, settings.precision)
    for feature in scene._features:
        feature.begin(scene, arrays, settings.dt, now.origin)
    if "giants" in arrays:
        arrays["giants"][0] = np.inf if now.giant is None else now.giant
    control = arrays["control"]
    control.count = len(now.radii)
    control.columns = grid.columns
    control.rows = grid.rows
    control.cells = grid.table_size - 1
    control.substeps = now.substeps
    control.law = records.LAWS[settings.law].number
    control.contact = records.CONTACTS[settings.contact]
    control.passes = settings.passes
    control.race_free = int(not now.unguarded)
    control.absorbing[:] = [edge in scene.absorbing for edge in EDGES]
    prepare_first_step(arrays)


FEW = 16
"""Discs that are fewer than one in so many are looked for in memory; otherwise all are put in order."""


class BlockSolver(SteppedSolver):
    """What `naive`, `grid` and `parallel` have in common.

    The state lives in the shared block, in whatever order the last frame sorted it; ids bring it back to the scene's.
    """

    count: int
    choice: Choice
    origin: Origin
    logging: bool

    def __init__(self, scene: Scene, settings: Settings, choice: Choice):
        super().__init__(scene, settings, choice)
        self._moving = False
        self._log: StepLog = StepLog()
        self._begun = -1  # frames that were done when the last command was given to this block
        self._block = self._next_block(max(scene.count, 1), self._radii)

    def start(self) -> None:
        self._fill(self._block)
        scene = self._scene
        self._write(scene.position, scene.velocity, given_in(scene))
        self._configure()
        self._prepare()

    def close(self) -> None:
        self._stop_workers()
        self._block.close()

    # --- what each of them does in its own way

    @abstractmethod
    def _load_kernels(self) -> None:
        """Compile or load what will run, by running no frame."""

    @abstractmethod
    def _run_command(self, workers: int) -> int:
        """Run the command that the record `control` holds. Returns layout.RUNNING, or why it has ended before."""

    def _failure(self, abort: int) -> Exception:
        """The exception for a command that has ended before its time."""
        assert abort == records.BAD_STATE
        frame = self.frame + int(self._block.arrays["team"][0].frame)
        particle, position, velocity = first_not_finite(self._block)
        return DivergedError(particle, frame, position, velocity)

    def _start_workers(self) -> None:
        """Start the workers, where there are any."""

    def _move_workers(self) -> None:
        """Let the workers, where there are any, attach to the present block."""

    def _stop_workers(self) -> None:
        """Stop the workers, where there are any. May be called again."""

    def _giant_radius(self, radii: NDArray[np.float64]) -> float | None:
        """Radius above which discs of such radii are kept out of the grid; None: there are no such discs."""
        return None

    # --- frames

    def advance(self, frames: int, workers: int, stop: float = math.inf) -> Slice:
        if not self.logging:
            return self._command(frames, workers, stop)
        with interrupts_held_back():  # what a log could not hold is found out before anybody else comes
            return self._logged_command(frames, workers, stop)

    def _logged_command(self, frames: int, workers: int, stop: float) -> Slice:
        """The same, with all collisions in the log: if they do not fit, the frames are run again with more room."""
        log, before = self._log, self.snapshot()
        frames = min(frames, log.frames_that_fit)
        begun = Begun(self._scene, self.origin, self.frame, self._settings.dt, self.substeps)
        while True:
            log.begin(self._block.arrays)
            part = self._command(frames, workers, stop)
            if log.take(self._block.arrays, part.times.shape[1], begun):
                return part
            self.restore(before, self.choice)

    def _command(self, frames: int, workers: int, stop: float) -> Slice:
        """Run frames."""
        self._write_command(frames, workers, stop)
        abort = self._run_command(workers)
        if abort != records.RUNNING:
            raise self._failure(abort)
        arrays = self._block.arrays
        frames, team = int(arrays["control"]["frames"]), arrays["team"]
        contacts = int(team["collisions"].sum())
        self.too_fast: bool = bool(team["fastest"].any())
        tally = self._totals(arrays["tally"][:, :frames]) if self.tallied else None
        return Slice(arrays["times"][:, :frames].copy(), contacts, tally)

    def _write_command(self, frames: int, workers: int, stop: float) -> None:
        """Write a command into the block: its record, and zeros where it counts."""
        arrays = self._block.arrays
        control, team = arrays["control"], arrays["team"]
        if stop < math.inf:
            frames = self._frames_to(stop, frames)
        control["frames"] = frames
        control["workers"] = control["members"] = workers
        team["collisions"] = 0
        team["fastest"] = 0
        control["tallied"] = self.tallied
        arrays["times"][:, :frames] = 0
        if self.tallied:
            arrays["tally"][:, :frames] = 0
        self._begun = int(control["done"])

    def log_collisions(self, wanted: bool) -> None:
        if wanted != self.logging:
            self.logging = wanted
            try:
                self._move(self._capacity, self.choice, self._radii)
            except BaseException:
                self.logging = not wanted
                raise

    def take_collisions(self) -> NDArray[Any]:
        return self._log.taken()

    @property
    def half_done(self) -> bool:
        control = self._block.arrays.get("control")
        if self._moving or control is None:  # none after `close`
            return self._moving
        left = control.signals[records.ABORT] or control.signals[records.BAD]
        return bool(left and control.done == self._begun)

    @property
    def frame(self) -> int:
        return self.origin.frame + int(self._block.arrays["control"]["done"])

    # --- steps

    def speeds(self, new: NewDiscs | None = None, numbers: NDArray[np.int64] | None = None) -> Speeds:
        if numbers is not None:
            found = speeds_of(self.discs(numbers).velocity, self._radii[numbers], self._scene, self.time)
            return replace(found, disc=int(numbers[found.disc]))
        return self._speeds(places_and_speeds(self._block, self.count)[1], self.absorbed, new)

    def disc_too_fast(self) -> Speeds | None:
        arrays = self._block.arrays
        found, fast = fastest_in(arrays["team"]), float(arrays["parameters"].fast)
        arrays["team"]["fastest"], self.too_fast = 0, False
        return disc_too_fast(found, fast, self._radii, has_radii(self._scene), self.frame - 1)

    # --- discs

    def state(self) -> State:
        return state_in(self._block, self._box, self.count)

    def state_between(self, first: int, last: int) -> State:
        if (last - first) * FEW > self.count:
            return super().state_between(first, last)
        discs = self.discs(np.arange(first, last))
        found = {each.name: discs.of(each) for each in columns.in_state() if each.name in self._block.arrays}
        return state_of(self._box, self._block.arrays, discs.position, discs.velocity, found, discs.absent)

    def read_in_place(self, read: Callable[[InPlace], Result]) -> Result:
        count, arrays, discs = self.count, self._block.arrays, live_discs(self._block)
        x, y, vx, vy, number = (column[:count] for column in (discs.x, discs.y, discs.vx, discs.vy, discs.id))
        absent, box = self.absorbed if "exits" in arrays else None, self._box
        return read(InPlace(x, y, vx, vy, number, absent, box, self.frame, self.time, self._radii))

    @property
    def absorbed(self) -> NDArray[np.bool_]:
        return absorbed_in(self._block, self.count)

    def add(self, new: NewDiscs, choice: Choice) -> None:
        count = self.count + len(new.position)
        radii, masses = kept_sizes(self._radii, new.radius), kept_sizes(self._masses, new.mass)
        # Discs that make giants of others leave the grid finer than one for as many discs without giants.
        crowded = self._grid_of(count, self._giant_radius(radii)).table_size > len(self._block.arrays["start"])
        if choice != self.choice or count > self._capacity or crowded:
            self._move(max(2 * self._capacity, count) if count > self._capacity else self._capacity, choice, radii)
        write_discs(self._block, new, self.count)
        self.count, self._radii, self._masses = count, radii, masses
        self._configure()

    def discs(self, numbers: NDArray[np.int64] | None = None) -> NewDiscs:
        if numbers is not None:
            return discs_of(self._block, numbers, self._radii, self._masses)
        position, velocity = places_and_speeds(self._block, self.count)
        arrays, count = self._block.arrays, self.count
        found = {each.name: arrays[each.name][..., :count].T.copy() for each in columns.COLUMNS if each.name in arrays}
        return NewDiscs(position, velocity, self._radii, {**found, columns.MASS.name: self._masses})

    def replace(self, discs: NewDiscs, numbers: NDArray[np.int64] | None = None) -> None:
        if numbers is None:
            write_discs(self._block, discs, 0)
        else:
            write_discs_of(self._block, discs, numbers, self.count)

    def adopt(self, terms: Terms, choice: Choice) -> None:
        snapshot = self.snapshot()
        if terms.origin != self.origin:
            snapshot["progress"] = np.zeros(2, np.int64)
        with self._assumed(terms):
            if choice == self.choice and self._fits(self._capacity, self._radii):
                fill_features(self._block.arrays, self._scene)
                self._control.done, self._control.steps = self._begin_from(snapshot)
                self._configure()
            else:
                self._replace_block(self._capacity, choice, snapshot, self._radii, choice != self.choice, anew=True)

    @contextmanager
    def _assumed(self, terms: Terms) -> Iterator[None]:
        """Terms that are in force from here on, unless the body of the `with` raises before there is another block."""
        before, block = self.terms, self._block
        try:
            self._assume(terms)
            yield
        except BaseException:
            if self._block is block:  # else a worker has died on the new one
                self._assume(before)
            raise

    def _fits(self, capacity: int, radii: NDArray[np.float64]) -> bool:
        """Whether the present block is as one for so many discs, of these radii, would be now."""
        return capacity == self._capacity and self._next_block(capacity, radii).specs == self._block.specs

    # --- snapshots

    def snapshot(self) -> SolverState:
        return stepped.taken(self._block, self._radii, self._masses)

    def restore(
        self,
        snapshot: SolverState,
        choice: Choice,
        room: int = 0,
        terms: Terms | None = None,
        new_workers: bool = True,
    ) -> None:
        capacity, radii = max(self._capacity, count_in(snapshot), room), snapshot["radii"]
        with self._assumed(terms or self.terms):
            if not new_workers and choice == self.choice and self._fits(capacity, radii):
                self._moving = True
                fill_features(self._block.arrays, self._scene)
                self._enter(snapshot)
                self._moving = False
            else:
                other_workers = new_workers or choice != self.choice
                self._replace_block(capacity, choice, snapshot, radii, other_workers, anew=terms is not None)

    # --- the block

    @property
    def array_names(self) -> tuple[str, ...]:
        return tuple(self._block.specs)

    def resources(self) -> tuple[tuple[int, ...], int]:
        return tuple(map(resident_bytes, (os.getpid(), *self.pids))), self._block.nbytes

    @property
    def _most_workers(self) -> int:
        return max(self.choice.workers)

    @property
    def _control(self) -> Any:
        return self._block.arrays["control"]

    @property
    def _parameters(self) -> Any:
        return self._block.arrays["parameters"]

    def _next_block(self, capacity: int, radii: NDArray[np.float64]) -> SharedBlock:
        """A block for so many discs, which is still to be filled."""
        precision = self._settings.precision
        features = feature_specs(self._scene, capacity, precision)
        grid = self._grid_of(capacity, self._giant_radius(radii))
        self._capacity = capacity
        arrays = block_arrays(capacity, grid, self._most_workers, precision, features)
        arrays |= self._log.specs(capacity, self._most_workers) if self.logging else {}
        return SharedBlock(arrays, alone=self._most_workers == 1)

    def _fill(self, block: SharedBlock) -> None:
        """Make a block, and fill it with what the scene has."""
        block.create()
        block.arrays["team"]["bad_slot"] = -1
        fill_features(block.arrays, self._scene)

    def _prepare(self) -> None:
        """Compile or load the kernels, then start the workers: they find the machine code and no frame waits for it."""
        self._load_undisturbed()
        self._start_workers()

    def _load_undisturbed(self) -> None:
        """`_load_kernels`, while Ctrl-C waits: Numba looks up the types of arguments inside exceptions of its own.

        It comes in this frame, which holds no view of the block.
        """
        with interrupts_held_back():
            self._load_kernels()

    def _move(self, capacity: int, choice: Choice, radii: NDArray[np.float64]) -> None:
        """Move everything to a new block, larger or for other workers, and the workers with it."""
        self._replace_block(capacity, choice, self.snapshot(), radii, new_workers=choice != self.choice)

    def _replace_block(
        self,
        capacity: int,
        choice: Choice,
        snapshot: SolverState,
        radii: NDArray[np.float64],
        new_workers: bool,
        anew: bool = False,
    ) -> None:
        """A new block that holds a snapshot; the workers attach to it, or others are started.

        radii: of the discs for which it is to have a grid, shape (M,): those of the snapshot, and of any to be added.
        anew: whether the kernels are others.
        """
        old, before = self._block, (self.choice, self._capacity)
        loaded = (ROWS in old.arrays) == self.logging and not anew
        self.choice = choice
        try:
            with (new := self._next_block(capacity, radii)).closed_on_error():
                self._fill(new)
        except BaseException:
            self.choice, self._capacity = before
            raise
        self._moving, self._block = True, new
        try:
            self._enter(snapshot)
            if new_workers:
                self._stop_workers()
                self._prepare()
            else:
                if not loaded:
                    self._load_undisturbed()
                self._move_workers()
        finally:
            old.close()
        self._moving = False

    def _enter(self, snapshot: SolverState) -> None:
        """Write a snapshot into the present block."""
        arrays = self._block.arrays
        self._begun = -1
        arrays["team"]["fastest"], self.too_fast = 0, False
        frames, steps = self._begin_from(snapshot)
        if not stepped.put_as_they_lay(self._block, snapshot):
            self._write(np.asarray(snapshot["position"]), np.asarray(snapshot["velocity"]), {})
        self._control.done, self._control.steps = frames, steps
        for column in columns.COLUMNS:
            if column.name in snapshot:
                column.put(arrays[column.name], snapshot[column.name])
        self._configure()

    def _write(self, position: NDArray[Any], velocity: NDArray[Any], brought: dict[str, NDArray[Any]]) -> None:
        """Write all discs into a new block. brought: of columns by id, by name, besides masses."""
        given = {**brought, columns.MASS.name: self._masses}
        write_discs(self._block, NewDiscs(position, velocity, self._radii, given), 0)

    def _configure(self) -> None:
        giant = self._giant_radius(self._radii)
        self._grid = self._grid_of(self.count, giant)
        unguarded = self.choice.processes.unguarded
        limit, scale = self._speed_limit, self._tally_scale
        now = Present(self._radii, self._grid, giant, self.substeps, limit, self.origin, scale, unguarded)
        configure(self._block.arrays, self._scene, self._settings, now)
