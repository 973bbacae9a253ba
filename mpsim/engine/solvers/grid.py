"""The methods grid and parallel: a grid whose columns are processed in an even and an odd pass."""

import numpy as np
from numpy.typing import NDArray

from mpsim.engine.feature_arrays import giant_radius
from mpsim.engine.solvers.base import Choice, Columns, NewDiscs
from mpsim.engine.solvers.block import BlockSolver
from mpsim.engine.solvers.snapshots import Snapshot
from mpsim.engine.workers.arrays import Grid
from mpsim.engine.workers.pool import WorkerPool
from mpsim.engine.workers.worker import kernel_arguments, load_kernels
from mpsim.features.radii import has_radii
from mpsim.kernels import layout
from mpsim.kernels.frame.stepping import run_grid
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings


class GridSolver(BlockSolver):
    """Frames by the passes of a grid. This process is worker 0; the others are there where `choice` may use them."""

    def __init__(self, scene: Scene, settings: Settings, choice: Choice):
        self._sorted_grid: Grid | None = None  # by which the discs lie in memory
        self._pool: WorkerPool | None = None
        super().__init__(scene, settings, choice)

    # --- frames

    def _load_kernels(self) -> None:
        load_kernels(self._block)

    def _run_command(self, workers: int) -> int:
        self._deal(workers)
        return self._run_grid(self._pool if workers > 1 else None)

    def _run_grid(self, pool: WorkerPool | None) -> int:
        """Start the command on all workers, and run worker 0's share of it."""
        if pool is not None:
            pool.wake()
        try:
            abort = run_grid(*kernel_arguments(self._block, 0))
        finally:
            if pool is not None:
                pool.settle()
        self._sorted_grid = self._grid
        return abort

    def _failure(self, abort: int) -> Exception:
        if abort == layout.BAD_STATE:
            return super()._failure(abort)
        assert self._pool is not None  # only a pool's watcher or barrier sets the others
        return self._pool.failure()

    # --- who does what

    def columns(self) -> Columns:
        """Column and owner of each disc."""
        x = self.state().position[:, 0].astype(np.float64)
        column = np.clip((x * (self._grid.columns / self._scene.width)).astype(np.int64), 0, self._grid.columns - 1)
        return Columns(column, self.owners()[column], self._grid.columns)

    def owners(self) -> NDArray[np.int64]:
        """The worker to whom the next frame gives each column, shape (columns,)."""
        first = self._shares(self._most_workers)[0][:-1]
        return np.searchsorted(first, np.arange(self._grid.columns), side="right") - 1

    @property
    def has_giants(self) -> bool:
        """Whether some discs are too large for the grid."""
        return self._giant_radius(self._radii) is not None

    def _deal(self, workers: int) -> None:
        """Assign columns and a slice of the discs to each worker."""
        team = self._block.arrays["team"][:workers]
        columns, slots = self._shares(workers)
        team["first_column"], team["last_column"] = columns[:-1], columns[1:]
        team["low"], team["high"] = slots[:-1], slots[1:]

    def _shares(self, workers: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """First column and first disc of each worker, and the ends: equal numbers, whole columns once sorted."""
        share = np.arange(workers + 1) * self.count // workers
        if self._sorted_grid == self._grid:
            first_of_column = self._block.arrays["start"][: self._grid.table_size : self._grid.rows + 2]
            columns = shares_of(first_of_column[: self._grid.columns], share)
            slots = first_of_column[columns].astype(np.int64)
            slots[-1] = self.count  # discs that were added since lie behind the sorted ones
        else:
            columns, slots = np.arange(workers + 1) * self._grid.columns // workers, share
        return columns, slots

    # --- workers and giants

    @property
    def pids(self) -> list[int]:
        """Process numbers of the workers other than the coordinator."""
        pool = self._pool  # which the thread of a run may just be replacing
        return pool.pids if pool is not None else []

    def _start_workers(self) -> None:
        if self._most_workers > 1:
            self._pool = WorkerPool(self._block, self.choice.processes.start_method)
            self._pool.start(self._most_workers)

    def _move_workers(self) -> None:
        if self._pool is not None:
            self._pool.move_to(self._block)

    def _stop_workers(self) -> None:
        if self._pool is not None:
            self._pool.stop()
            self._pool = None

    def replace(self, discs: NewDiscs) -> None:
        """Write other discs in the place of those that are there: the next step sorts them anew."""
        self._sorted_grid = None
        super().replace(discs)

    def _enter(self, snapshot: Snapshot) -> None:
        self._sorted_grid = None
        super()._enter(snapshot)

    def _giant_radius(self, radii: NDArray[np.float64]) -> float | None:
        return giant_radius(radii) if has_radii(self._scene) else None


def shares_of(first_of_column: NDArray[np.integer], share: NDArray[np.int64]) -> NDArray[np.int64]:
    """First column of each worker, and the end, shape (workers + 1,): whole columns, in nearly equal numbers of discs.

    Args:
        first_of_column: number of discs in the columns before each, shape (columns,).
        share: number of discs before each worker's equal share, and that of all, shape (workers + 1,).
    """
    columns = np.searchsorted(first_of_column, share)
    columns[0], columns[-1] = 0, len(first_of_column)
    return columns
