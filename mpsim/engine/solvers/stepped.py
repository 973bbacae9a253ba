"""The stepped solver as the coordinator sees it: the block, its parameters, and one command after the other."""

import math
import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.core.errors import DivergedError, InputError
from mpsim.core.state import State
from mpsim.engine.feature_arrays import (
    box_now,
    feature_specs,
    fill_features,
    giant_radius,
    has_radii,
    typical_momentum,
    wall_limits,
)
from mpsim.engine.frame_count import frames_until
from mpsim.engine.insertion import NewDiscs
from mpsim.engine.report import Slice, tallied
from mpsim.engine.solvers.base import Capabilities, Choice, Columns, Snapshot, Solver, count_in
from mpsim.engine.speed_alarm import Alert, caught
from mpsim.engine.speed_estimates import Pace, pace_of
from mpsim.engine.workers.arrays import Grid, block_arrays, grid_for
from mpsim.engine.workers.pool import WorkerPool
from mpsim.engine.workers.shared import SharedBlock
from mpsim.engine.workers.system_limits import resident_bytes
from mpsim.engine.workers.worker import kernel_arguments, live_discs, load_kernels, naive_arguments
from mpsim.features.edges import EDGES
from mpsim.kernels import layout
from mpsim.kernels.features.hooks import prepare_step
from mpsim.kernels.features.images import wrap_places
from mpsim.kernels.frame.stepping import run_grid, run_naive
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings

LIMITS = (layout.X_LOW, layout.X_HIGH, layout.Y_LOW, layout.Y_HIGH)
BY_ID = ("exits", "image")
"""Arrays of features, by id, that frames change: a snapshot holds them."""

_CONTACTS = {"push": layout.PUSH, "impact": layout.IMPACT}
_LAWS = {"reflect": layout.REFLECT, "elastic": layout.ELASTIC}


class SteppedSolver(Solver):
    """Runs frames of a scene by `naive`, `grid` or `parallel`.

    The state lives in the shared block, in whatever order the last frame sorted it; ids bring it back to the scene's.
    """

    capabilities = Capabilities(has_steps=True, has_columns=True)

    def __init__(self, scene: Scene, settings: Settings, choice: Choice):
        self.count: int = scene.count
        self.choice: Choice = choice
        self._scene = scene
        self._settings = settings
        self.substeps: int = settings.substeps
        self._sorted_grid: Grid | None = None
        self._tallying = self._moving = False
        self._alert = Alert()
        self._begun = -1  # frames that were done when the last command was given to this block
        self._pool: WorkerPool | None = None
        self._radii = scene.radii.astype(float)
        self._masses = scene.masses.astype(float)
        self._block = self._next_block(max(scene.count, 1))

    def start(self) -> None:
        """Make the block, write the scene's discs into it, and start the workers."""
        self._fill(self._block)
        scene = self._scene
        self._write_state(scene.position, scene.velocity, scene.acceleration)
        self._configure()
        self._prepare()

    def _prepare(self) -> None:
        """Compile or load the kernels, then start the workers: they find the machine code and no frame waits for it."""
        self._load_kernels()
        if self._most_workers > 1:
            self._pool = WorkerPool(self._block, self._settings.start_method)
            self._pool.start(self._most_workers)

    @property
    def _most_workers(self) -> int:
        return max(self.choice.workers)

    # --- frames

    def advance(self, frames: int, workers: int, stop: float = math.inf) -> Slice:
        """Run frames on so many workers; while it is the coordinator alone, the others rest."""
        arrays, control, dt = self._block.arrays, self._block.arrays["control"], self._settings.dt
        if stop < (self.frame + frames) * dt:
            frames = min(frames, max(frames_until(stop, dt) - self.frame, 1))
        control[layout.FRAMES] = frames
        control[layout.WORKERS] = workers
        arrays["team"][:, [layout.COLLISIONS, layout.FASTEST]] = 0
        self._deal(workers)
        times, tally = arrays["times"], arrays.get("tally")
        for counts in (times, tally):
            if counts is not None:
                counts[:, :frames] = 0
        self._begun = int(control[layout.DONE])
        if self.choice.method == "naive":
            abort = run_naive(*naive_arguments(self._block))
        else:
            abort = self._run_grid(self._pool if workers > 1 else None)
        if abort != layout.RUNNING:
            raise self._failure(abort)
        frames = int(control[layout.FRAMES])
        contacts = int(arrays["team"][:, layout.COLLISIONS].sum())
        if tally is not None:
            scale = float(arrays["parameters"][layout.TALLY_SCALE])
            tally = tallied(tally[:, :frames], scale, 2 * self._scene.largest_radius)
        return Slice(times[:, :frames].copy(), contacts, tally)

    @property
    def torn(self) -> bool:
        """Whether the last command was left inside a frame, by a death say, or a move to another block half done."""
        words = self._block.arrays.get("control", np.zeros(layout.CONTROL, np.int64))  # none after `close`
        return self._moving or bool((words[layout.ABORT] or words[layout.BAD]) and words[layout.DONE] == self._begun)

    def pace(self, new: NewDiscs | None = None) -> Pace:
        """How fast the discs are, those that are about to be added included."""
        velocity, radii, present = self._places_and_speeds()[1], self._radii[: self.count], ~self.absorbed
        if new is not None:
            velocity, radii = np.concatenate([velocity, new.velocity]), np.concatenate([radii, new.radius])
            present = np.append(present, np.ones(len(new.position), bool))
        return pace_of(velocity, radii, self._scene, self.time, present if self._scene.absorbing else None)

    @property
    def alarmed(self) -> bool:
        """Whether a disc was too fast in the last command, and so ended it."""
        return bool(self._block.arrays["team"][:, layout.FASTEST].any())

    def caught(self) -> Pace | None:
        """The disc that was too fast in the last command, reported once; None where there was none."""
        return caught(self._block.arrays, self._radii, has_radii(self._scene), self.frame - 1)

    def set_alert(self, alert: Alert) -> None:
        """From now on end a command with the frame in which a disc is so fast."""
        self._alert = alert
        self._configure()

    def divide(self, substeps: int) -> None:
        """Divide the frames that follow into so many steps.

        The count of steps becomes what it would be if all frames had had as many: so the place of a piston follows from
        it as before, and a snapshot tells the number of sub-steps.
        """
        if substeps != self.substeps:
            self.substeps = substeps
            self._block.arrays["control"][layout.STEPS] = self.frame * substeps
            self._configure()

    def record(self, tallied: bool) -> None:
        """Have what measures need counted from now on, or not: frames that are not measured pay nothing for it."""
        if tallied != self._tallying:
            self._tallying = tallied
            self._move(self._capacity, self.choice)

    def _run_grid(self, pool: WorkerPool | None) -> int:
        """Give the command to everybody and do the coordinator's part of it."""
        if pool is not None:
            pool.wake()
        try:
            abort = run_grid(*kernel_arguments(self._block, 0))
        finally:
            if pool is not None:
                pool.settle()
        self._sorted_grid = self._grid
        return abort

    def _shares(self, workers: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """First column and first disc of each worker, and the ends: equal numbers, whole columns once sorted."""
        share = np.arange(workers + 1) * self.count // workers
        if self._sorted_grid == self._grid:
            first_of_column = self._block.arrays["start"][: self._grid.table_size : self._grid.rows + 2]
            columns = np.searchsorted(first_of_column[: self._grid.columns], share)
            columns[0], columns[-1] = 0, self._grid.columns
            slots = first_of_column[columns].astype(np.int64)
            slots[-1] = self.count  # discs that were added since lie behind the sorted ones
        else:
            columns, slots = np.arange(workers + 1) * self._grid.columns // workers, share
        return columns, slots

    def _deal(self, workers: int) -> None:
        """Give each worker its columns and its slice."""
        team = self._block.arrays["team"][:workers]
        columns, slots = self._shares(workers)
        team[:, layout.FIRST_COLUMN], team[:, layout.LAST_COLUMN] = columns[:-1], columns[1:]
        team[:, layout.LOW], team[:, layout.HIGH] = slots[:-1], slots[1:]

    def _failure(self, abort: int) -> Exception:
        if abort != layout.BAD_STATE:
            assert self._pool is not None  # only a pool's watcher or barrier sets these
            return self._pool.failure()
        team = self._block.arrays["team"]
        frame = self.frame + int(team[0, layout.FRAME])
        # After an odd number of steps the state lies in the other buffer; the bad slot is the one that is not finite.
        candidates = [
            (int(buffer.id[slot]), values)
            for buffer in kernel_arguments(self._block, 0)[:2]
            for slot in team[team[:, layout.BAD_SLOT] >= 0, layout.BAD_SLOT]
            if not np.isfinite(values := [float(array[slot]) for array in buffer[:4]]).all()
        ]
        particle, (x, y, vx, vy) = min(candidates)
        return DivergedError(particle, frame, (x, y), (vx, vy))

    # --- state

    @property
    def frame(self) -> int:
        """Frames finished since the start."""
        return int(self._block.arrays["control"][layout.DONE])

    @property
    def time(self) -> float:
        """Simulated time since the start [time]."""
        return self.frame * self._settings.dt

    def reached(self, time: float) -> bool:
        """Whether the last frame has reached a time [time]; one that ends within rounding of it has."""
        frame, dt = self.frame, self._settings.dt
        return time < (frame + 1) * dt and frames_until(time, dt) <= frame

    def state(self) -> State:
        """Copies in the order of the scene's discs."""
        (position, velocity), arrays = self._places_and_speeds(), self._block.arrays
        image = arrays["image"][:, : self.count].copy() if "image" in arrays else None
        for axis, wrap in enumerate((arrays.get("wrap_x"), arrays.get("wrap_y"))):
            if wrap is not None:  # a contact may have moved a disc through the border; the next step brings it back
                wrap_places(position[:, axis], image, axis, wrap)
        image = None if image is None else image.T
        return State(position, velocity, present=~self.absorbed, image=image, box=box_now(self._scene, arrays))

    def _places_and_speeds(self) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        """Positions and velocities as they lie in the block, in the order of the scene's discs."""
        discs = live_discs(self._block)
        order = discs.id[: self.count]
        position = np.empty((self.count, 2), discs.x.dtype)
        velocity = np.empty_like(position)
        for column, (place, speed) in enumerate(((discs.x, discs.vx), (discs.y, discs.vy))):
            position[order, column] = place[: self.count]
            velocity[order, column] = speed[: self.count]
        return position, velocity

    @property
    def radii(self) -> NDArray[np.float64]:
        """Radius of each disc, shape (N,) [length]."""
        return self._radii[: self.count].copy()

    @property
    def masses(self) -> NDArray[np.float64]:
        """Mass of each disc, shape (N,) [mass]."""
        return self._masses[: self.count].copy()

    def columns(self) -> Columns:
        """Column and owner of each disc."""
        if self.choice.method == "naive":
            raise InputError(
                "columns are there only in methods that sort discs into them, 'grid' and 'parallel'; this run is by "
                f"{self.choice.method!r}. Use Settings(method='parallel', workers=...)."
            )
        x = self.state().position[:, 0].astype(np.float64)
        column = np.clip((x * (self._grid.columns / self._scene.width)).astype(np.int64), 0, self._grid.columns - 1)
        first = self._shares(self._most_workers)[0][:-1]
        return Columns(column, np.searchsorted(first, column, side="right") - 1, self._grid.columns)

    @property
    def absorbed(self) -> NDArray[np.bool_]:
        """Which discs have left through an absorbing edge, shape (N,)."""
        exits = self._block.arrays.get("exits")
        return np.zeros(self.count, bool) if exits is None else exits[0, : self.count] != 0

    def add(self, new: NewDiscs, choice: Choice) -> None:
        """Append discs, ids continuing, and go on as `choice` says. The block doubles when it is full."""
        count = self.count + len(new.position)
        radii = np.append(self._radii[: self.count], new.radius)
        masses = np.append(self._masses[: self.count], new.mass)
        self._radii, self._masses = radii, masses
        # Discs that make giants of others leave the grid finer than one for as many discs without giants.
        crowded = self._grid_for(count).table_size > len(self._block.arrays["start"])
        if choice != self.choice or count > self._capacity or crowded:
            self._move(max(2 * self._capacity, count) if count > self._capacity else self._capacity, choice)
            self._radii, self._masses = radii, masses  # the move has carried over the discs of before
        self._write_state(new.position, new.velocity, new.acceleration, self.count)
        if "image" in self._block.arrays:
            self._block.arrays["image"][:, self.count : count] = new.image.T
        self.count = count
        self._configure()

    @property
    def array_names(self) -> tuple[str, ...]:
        """Names of the arrays in the block."""
        return tuple(self._block.specs)

    def resources(self) -> tuple[tuple[int, ...], int]:
        """Resident bytes of each process, and the size of the block."""
        return tuple(map(resident_bytes, (os.getpid(), *self.pids))), self._block.nbytes

    @property
    def pids(self) -> list[int]:
        """Process numbers of the workers other than the coordinator."""
        pool = self._pool  # which the thread of a run may just be replacing
        return pool.pids if pool is not None else []

    def close(self) -> None:
        """Stop the workers and remove the block. May be called again."""
        self._stop_pool()
        self._block.close()

    def _stop_pool(self) -> None:
        if self._pool is not None:
            self._pool.stop()
            self._pool = None

    # --- the block

    @property
    def _tally_scale(self) -> float:
        """A power of two that makes a typical momentum some 2^32: fine steps, and 2^31 discs' worth of room above."""
        typical = typical_momentum(self._scene, self._settings.dt)
        # Where the exponent of the run's floats would end, sums are coarser or the room above is less.
        most = np.finfo(self._settings.precision).maxexp - 28
        return 2.0 ** float(np.clip(32 - np.frexp(typical)[1], -most, most))

    def _next_block(self, capacity: int) -> SharedBlock:
        """A block for so many discs, which is still to be filled."""
        precision = self._settings.precision
        features = feature_specs(self._scene, capacity, self._most_workers, precision)
        grid = self._grid_for(capacity)
        self._capacity = capacity
        return SharedBlock(block_arrays(capacity, grid, self._most_workers, precision, features, self._tallying))

    def _fill(self, block: SharedBlock) -> None:
        """Make a block, and fill it with what the scene has."""
        block.create()
        block.arrays["team"][:, layout.BAD_SLOT] = -1
        fill_features(block.arrays, self._scene)

    def _move(self, capacity: int, choice: Choice) -> None:
        """Move everything to a new block, larger or for another method, and the workers with it."""
        self._replace_block(capacity, choice, self.snapshot(), new_pool=choice != self.choice)

    def _replace_block(self, capacity: int, choice: Choice, snapshot: Snapshot, new_pool: bool) -> None:
        """A new block that holds a snapshot; the workers attach to it, or others are started."""
        old, before = self._block, (self.choice, self._capacity)
        loaded = "tally" in old.arrays or not self._tallying
        self.choice = choice
        try:
            with (new := self._next_block(capacity)).closed_on_error():
                self._fill(new)
        except BaseException:
            self.choice, self._capacity = before
            raise
        self._moving, self._block, self._begun = True, new, -1
        try:
            self._enter(snapshot)
            if new_pool:
                self._stop_pool()
                self._prepare()
            else:
                if not loaded:
                    self._load_kernels()
                if self._pool is not None:
                    self._pool.move_to(self._block)
        finally:
            old.close()
        self._moving = False

    def snapshot(self) -> Snapshot:
        """Copies of everything that the next frame depends on, in the order of the scene's discs."""
        (position, velocity), count, arrays = self._places_and_speeds(), self.count, self._block.arrays
        control = arrays["control"]
        found: Snapshot = {"position": position, "velocity": velocity}
        found |= {"radii": self._radii[:count].copy(), "masses": self._masses[:count].copy()}
        if "acceleration" in arrays:
            found["acceleration"] = arrays["acceleration"][:, :count].T.copy()
        for name in BY_ID:
            if name in arrays:
                found[name] = arrays[name][:, :count].copy()
        found["progress"] = np.array([control[layout.DONE], control[layout.STEPS]])
        return found

    def restore(self, snapshot: Snapshot, choice: Choice, new_workers: bool) -> None:
        """Go back (or on) to a snapshot; on new workers where those that were there may be dead."""
        capacity = max(self._capacity, count_in(snapshot))
        self._radii = snapshot["radii"].copy()  # which the size of the grid may depend on
        self._replace_block(capacity, choice, snapshot, new_pool=new_workers or choice != self.choice)

    def _enter(self, snapshot: Snapshot) -> None:
        """Write a snapshot into the present, new block."""
        self._radii, self._masses = snapshot["radii"].copy(), snapshot["masses"].copy()
        self.count = len(self._radii)
        self._write_state(snapshot["position"], snapshot["velocity"], snapshot.get("acceleration"))
        control = self._block.arrays["control"]
        frames, steps = snapshot["progress"].tolist()
        control[layout.DONE], control[layout.STEPS] = frames, steps
        self.substeps = steps // frames if frames else self._settings.substeps
        for name in BY_ID:
            if name in snapshot:  # in files of older versions there is no image, and it counts from there on
                self._block.arrays[name][:, : self.count] = snapshot[name]
        self._sorted_grid = None
        self._configure()

    def _grid_for(self, count: int) -> Grid:
        scene, precision = self._scene, self._settings.precision
        giant = self._giant_radius()
        largest = scene.largest_radius if giant is None else giant
        outside = bool(scene.absorbing) or has_radii(scene)
        return grid_for(count, scene.width, scene.height, 2 * largest, precision, scene.boundary, outside)

    def _giant_radius(self) -> float | None:
        """Radius above which discs are kept out of the grid."""
        return giant_radius(self._radii) if has_radii(self._scene) and self.choice.method != "naive" else None

    def _write_state(self, position: NDArray, velocity: NDArray, acceleration: NDArray | None, first: int = 0) -> None:
        """Write discs `first`, `first + 1`, ... behind those that are there."""
        arrays = self._block.arrays
        discs = live_discs(self._block)
        last = first + len(position)
        discs.x[first:last], discs.y[first:last] = position.T
        discs.vx[first:last], discs.vy[first:last] = velocity.T
        discs.id[first:last] = np.arange(first, last)
        if discs.radius is not None:
            discs.radius[first:last] = self._radii[first:last]
        if "mass" in arrays:
            arrays["mass"][first:last] = self._masses[first:last]
        if "acceleration" in arrays:
            arrays["acceleration"][:, first:last] = 0 if acceleration is None else acceleration.T

    def _configure(self) -> None:
        """Write the parameters and control words that follow from scene, settings and number of discs."""
        scene, settings = self._scene, self._settings
        self._grid = self._grid_for(self.count)
        smallest = float(self._radii[: self.count].min(initial=scene.largest_radius))
        common = None if has_radii(scene) else scene.largest_radius
        values: dict[int, Any] = {
            layout.DT: settings.dt / self.substeps,
            layout.DIAMETER: 2 * scene.largest_radius,
            **dict(zip(LIMITS, wall_limits(scene), strict=True)),
            layout.CELLS_PER_X: self._grid.columns / scene.width,
            layout.CELLS_PER_Y: self._grid.rows / scene.height,
            layout.EXCHANGE: (1 + scene.restitution) / 2,
            layout.WALL_RESTITUTION: scene.wall_restitution,
            layout.WALL_BOUNCE: scene.wall_restitution if settings.contact == "impact" else 0.0,
            layout.TALLY_SCALE: self._tally_scale,
            layout.FAST: self._alert.square(settings.dt / self.substeps, common, smallest, settings.precision),
        }
        for index, value in values.items():
            self._block.arrays["parameters"][index] = value
        prepare_step(self._block.arrays)
        if "giants" in self._block.arrays:
            giant = self._giant_radius()
            self._block.arrays["giants"][0] = np.inf if giant is None else giant
        words = {
            layout.COUNT: self.count,
            layout.COLUMNS: self._grid.columns,
            layout.ROWS: self._grid.rows,
            layout.SUBSTEPS: self.substeps,
            layout.LAW: _LAWS[settings.law],
            layout.CONTACT: _CONTACTS[settings.contact],
            layout.PASSES: settings.passes,
            layout.GUARDED: int(not settings.unguarded),
            layout.CELLS: self._grid.table_size - 1,
            layout.ABSORBING: sum(1 << EDGES.index(edge) for edge in scene.absorbing),
        }
        for index, word in words.items():
            self._block.arrays["control"][index] = word

    def _load_kernels(self) -> None:
        """Compile or load what will run, by running no frame."""
        if self.choice.method != "naive":
            load_kernels(self._block)
            return
        arguments = list(naive_arguments(self._block))
        arguments[3] = arguments[3].copy()
        arguments[3][layout.FRAMES] = 0
        run_naive(*arguments)
