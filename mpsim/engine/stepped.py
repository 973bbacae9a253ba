"""The stepped solver as the coordinator sees it: the block, its parameters, and one command after the other."""

from typing import Any

import numpy as np
import psutil
from numpy.typing import NDArray

from mpsim.engine.methods import Choice
from mpsim.engine.pool import WorkerPool
from mpsim.engine.report import Slice
from mpsim.engine.shared import SharedBlock
from mpsim.engine.worker import kernel_arguments, load_kernels
from mpsim.errors import DivergedError, SharedMemoryError
from mpsim.kernels import layout
from mpsim.kernels.stepping import run_grid, run_naive
from mpsim.scene import Scene
from mpsim.settings import Settings
from mpsim.state import Grid, State, block_arrays, grid_for

_CONTACTS = {"push": layout.PUSH, "impact": layout.IMPACT}
_LAWS = {"reflect": layout.REFLECT, "elastic": layout.ELASTIC}


class SteppedSolver:
    """Runs frames of a scene by `naive`, `grid` or `parallel`.

    The state lives in the shared block, in whatever order the last frame sorted it; ids bring it back to the scene's.
    """

    def __init__(self, scene: Scene, settings: Settings, choice: Choice):
        self.count = scene.count
        self.choice = choice
        self._scene = scene
        self._settings = settings
        self._sorted_grid: Grid | None = None
        self._tallying = False
        self._pool: WorkerPool | None = None
        self._processes = [psutil.Process()]
        self._block = self._new_block(max(scene.count, 1))
        try:
            self._write_state(scene.position, scene.velocity, scene.acceleration)
            self._configure()
            self._prepare()
        except BaseException:
            self.close()
            raise

    def _prepare(self) -> None:
        """Compile or load the kernels, then start the workers: they find the machine code and no frame waits for it."""
        self._load_kernels()
        if self._most_workers > 1:
            self._pool = WorkerPool(self._most_workers, self._block, self._settings.start_method)
            self._processes += [psutil.Process(pid) for pid in self._pool.pids]

    @property
    def _most_workers(self) -> int:
        return max(self.choice.workers)

    # --- frames

    def advance(self, frames: int, workers: int) -> Slice:
        """Run up to MOST_FRAMES frames on all workers or on one (the coordinator, while the others rest).

        Raises:
            DivergedError, WorkerDied, WorkerStalled: the solver can then only be closed.
        """
        arrays, control = self._block.arrays, self._block.arrays["control"]
        control[layout.FRAMES] = frames
        control[layout.WORKERS] = workers
        arrays["team"][:, layout.COLLISIONS] = 0
        self._deal(workers)
        times, tally = arrays["times"], arrays.get("tally")
        for counts in (times, tally):
            if counts is not None:
                counts[:, :frames] = 0
        if self.choice.method == "naive":
            abort = run_naive(*self._naive_arguments())
        else:
            abort = self._run_grid(self._pool if workers > 1 else None)
        if abort != layout.RUNNING:
            raise self._failure(abort)
        contacts = int(arrays["team"][:, layout.COLLISIONS].sum())
        return Slice(times[:, :frames].copy(), contacts, None if tally is None else self._tallied(tally[:, :frames]))

    def _tallied(self, tally: NDArray[np.int64]) -> NDArray[np.float64]:
        """What all workers counted in each frame, in the scene's units, shape (frames, tallies)."""
        totals = tally.sum(axis=0).astype(np.float64)
        totals[:, layout.DEEPEST] = tally[:, :, layout.DEEPEST].max(axis=0)
        scale = float(self._block.arrays["parameters"][layout.TALLY_SCALE])
        totals[:, [layout.WALL_X, layout.WALL_Y, layout.VIRIAL]] /= scale
        totals[:, [layout.DEPTH, layout.DEEPEST]] *= 2 * self._scene.radius / scale
        return totals

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

    def _deal(self, workers: int) -> None:
        """Give each worker its columns and its slice: equal numbers of discs, whole columns where they are sorted."""
        team = self._block.arrays["team"][:workers]
        share = np.arange(workers + 1) * self.count // workers
        if self._sorted_grid == self._grid:
            first_of_column = self._block.arrays["start"][: self._grid.table_size : self._grid.rows + 2]
            columns = np.searchsorted(first_of_column[: self._grid.columns], share)
            columns[0], columns[-1] = 0, self._grid.columns
            slots = first_of_column[columns].astype(np.int64)
            slots[-1] = self.count  # discs that were added since lie behind the sorted ones
        else:
            columns, slots = np.arange(workers + 1) * self._grid.columns // workers, share
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

    @property
    def guarded(self) -> int:
        """Nothing: the stepped solver has no guard, and needs none."""
        return 0

    def state(self) -> State:
        """Copies in the order of the scene's discs."""
        discs = self._live_discs()
        order = discs.id[: self.count]
        position = np.empty((self.count, 2), discs.x.dtype)
        velocity = np.empty_like(position)
        for column, (place, speed) in enumerate(((discs.x, discs.vx), (discs.y, discs.vy))):
            position[order, column] = place[: self.count]
            velocity[order, column] = speed[: self.count]
        return State(position, velocity)

    def add(
        self,
        position: NDArray[np.float64],
        velocity: NDArray[np.float64],
        acceleration: NDArray[np.float64] | None,
        choice: Choice,
    ) -> None:
        """Append discs, ids continuing, and go on as `choice` says. The block doubles when it is full."""
        count = self.count + len(position)
        if choice != self.choice or count > self._capacity:
            self._move(max(2 * self._capacity, count) if count > self._capacity else self._capacity, choice)
        self._write_state(position, velocity, acceleration, self.count)
        self.count = count
        self._configure()

    def resources(self) -> tuple[tuple[int, ...], int]:
        """Resident bytes of each process, and the size of the block."""
        return tuple(process.memory_info().rss for process in self._processes), self._block.nbytes

    @property
    def pids(self) -> list[int]:
        """Process numbers of the workers other than the coordinator."""
        return self._pool.pids if self._pool is not None else []

    def close(self) -> None:
        """Stop the workers and remove the block. May be called again."""
        self._stop_pool()
        self._block.close()

    def _stop_pool(self) -> None:
        if self._pool is not None:
            self._pool.stop()
            self._pool = None
            del self._processes[1:]

    # --- the block

    @property
    def _tally_scale(self) -> float:
        """A power of two that makes a typical velocity some 2^32: fine steps, and 2^31 discs' worth of room above."""
        speeds = self._scene.velocity
        typical = float(np.sqrt((speeds**2).mean())) if len(speeds) else 0.0
        # Far from 1 the exponent of a float32 would end; sums are then coarser or the room above is less.
        return 2.0 ** float(np.clip(32 - np.frexp(typical)[1], -100, 100)) if typical > 0 else 2.0**32

    def _new_block(self, capacity: int) -> SharedBlock:
        scene, features = self._scene, {}
        if scene.gravity is not None:
            features["gravity"] = (2,)
        if scene.acceleration is not None:
            features["acceleration"] = (2, capacity)
        grid = self._grid_for(capacity)
        self._capacity = capacity
        specs = block_arrays(capacity, grid, self._most_workers, self._settings.precision, features, self._tallying)
        block = SharedBlock.create(specs)
        block.arrays["team"][:, layout.BAD_SLOT] = -1
        if scene.gravity is not None:
            block.arrays["gravity"][:] = scene.gravity
        return block

    def _move(self, capacity: int, choice: Choice) -> None:
        """Move everything to a new block, larger or for another method, and the workers with it."""
        old, same = self._block, choice == self.choice
        loaded = "tally" in old.arrays or not self._tallying
        state, count = self.state(), self.count
        acceleration = old.arrays["acceleration"][:, :count].T.copy() if "acceleration" in old.arrays else None
        before = self.choice, self._capacity
        self.choice = choice
        try:
            self._block = self._new_block(capacity)
        except SharedMemoryError:
            self.choice, self._capacity = before
            raise
        try:
            self._write_state(state.position, state.velocity, acceleration)
            self._block.arrays["control"][layout.DONE] = old.arrays["control"][layout.DONE]
            self._sorted_grid = None
            self._configure()
            if not same:
                self._stop_pool()
                self._prepare()
                return
            if not loaded:
                self._load_kernels()
            if self._pool is not None:
                self._pool.move_to(self._block)
        finally:
            old.close()

    def _grid_for(self, count: int) -> Grid:
        scene = self._scene
        return grid_for(count, scene.width, scene.height, 2 * scene.radius, self._settings.precision)

    def _write_state(self, position: NDArray, velocity: NDArray, acceleration: NDArray | None, first: int = 0) -> None:
        """Write discs `first`, `first + 1`, ... behind those that are there."""
        arrays = self._block.arrays
        discs = self._live_discs()
        last = first + len(position)
        discs.x[first:last], discs.y[first:last] = position.T
        discs.vx[first:last], discs.vy[first:last] = velocity.T
        discs.id[first:last] = np.arange(first, last)
        if "acceleration" in arrays:
            arrays["acceleration"][:, first:last] = 0 if acceleration is None else acceleration.T

    def _configure(self) -> None:
        """Write the parameters and control words that follow from scene, settings and number of discs."""
        scene, settings = self._scene, self._settings
        self._grid = self._grid_for(self.count)
        values: dict[int, Any] = {
            layout.DT: settings.dt / settings.substeps,
            layout.DIAMETER: 2 * scene.radius,
            layout.X_LOW: scene.radius,
            layout.X_HIGH: scene.width - scene.radius,
            layout.Y_LOW: scene.radius,
            layout.Y_HIGH: scene.height - scene.radius,
            layout.CELLS_PER_X: self._grid.columns / scene.width,
            layout.CELLS_PER_Y: self._grid.rows / scene.height,
            layout.EXCHANGE: (1 + scene.restitution) / 2,
            layout.WALL_RESTITUTION: scene.wall_restitution,
            layout.WALL_BOUNCE: scene.wall_restitution if settings.contact == "impact" else 0.0,
            layout.TALLY_SCALE: self._tally_scale,
        }
        for index, value in values.items():
            self._block.arrays["parameters"][index] = value
        words = {
            layout.COUNT: self.count,
            layout.COLUMNS: self._grid.columns,
            layout.ROWS: self._grid.rows,
            layout.SUBSTEPS: settings.substeps,
            layout.LAW: _LAWS[settings.law],
            layout.CONTACT: _CONTACTS[settings.contact],
            layout.PASSES: settings.passes,
            layout.GUARDED: int(not settings.unguarded),
        }
        for index, word in words.items():
            self._block.arrays["control"][index] = word

    def _live_discs(self) -> layout.Discs:
        """The buffer that holds the state."""
        return kernel_arguments(self._block, 0)[int(self._block.arrays["control"][layout.LIVE])]

    def _naive_arguments(self) -> tuple[Any, ...]:
        discs, _, _, _, gravity, acceleration, *rest = kernel_arguments(self._block, 0)
        parameters, control, team, _, tally, times, *_ = rest
        return discs, gravity, acceleration, parameters, control, team, tally, times

    def _load_kernels(self) -> None:
        """Compile or load what will run, by running no frame."""
        if self.choice.method != "naive":
            load_kernels(self._block)
            return
        arguments = list(self._naive_arguments())
        arguments[4] = arguments[4].copy()
        arguments[4][layout.FRAMES] = 0
        run_naive(*arguments)
