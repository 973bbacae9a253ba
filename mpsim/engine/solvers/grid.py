"""The methods naive, grid and parallel; and one frame of the grid, pass by pass."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mpsim.core.state import State
from mpsim.engine.feature_arrays import giant_radius
from mpsim.engine.solvers.base import Choice, NewDiscs, Solver, SolverState
from mpsim.engine.solvers.block import BlockSolver
from mpsim.engine.solvers.stepped import Grid
from mpsim.engine.workers.pool import WorkerPool
from mpsim.engine.workers.shared import SharedBlock
from mpsim.engine.workers.worker import kernel_arguments, load_kernels
from mpsim.errors import InputError
from mpsim.features.properties import has_radii
from mpsim.kernels import records
from mpsim.kernels.frame.rank import run_part
from mpsim.kernels.frame.stepping import run_grid, run_naive
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings

if TYPE_CHECKING:
    from mpsim.engine.simulation import Simulation

# --- The naive method: all pairs in index order, in one process


def naive_arguments(block: SharedBlock) -> tuple[Any, ...]:
    """Arguments of `run_naive`: views of the block. There is one buffer, which is never sorted."""
    if (known := block.calls.get("naive")) is None:
        grid = kernel_arguments(block, 0)
        known = grid.a, grid.features, grid.parameters, grid.control, grid.team, grid.tally, grid.times
        block.calls["naive"] = known
    return known


class NaiveSolver(BlockSolver):
    """Frames by testing all pairs i < j in index order."""

    def _load_kernels(self) -> None:
        discs, features, parameters, control, *rest = naive_arguments(self._block)
        control = control.copy()
        control.frames = 0
        run_naive(discs, features, parameters, control, *rest)

    def _run_command(self, workers: int) -> int:
        return run_naive(*naive_arguments(self._block))


# --- The methods grid and parallel: a grid whose columns are processed in an even and an odd pass


class Columns(NamedTuple):
    """Who is where in the grid.

    Attributes:
        of_disc: column of each disc, shape (N,).
        owner: the worker to whom the next frame gives that column, shape (N,).
        number: of columns, of equal width.
    """

    of_disc: NDArray[np.int64]
    owner: NDArray[np.int64]
    number: int


def columns_of(solver: Solver) -> Columns:
    """Who is where in the grid of a solver.

    Raises:
        InputError: for a method without columns.
    """
    if not isinstance(solver, GridSolver):
        raise InputError(
            "columns are there only in methods that sort discs into them, 'grid' and 'parallel'; this run is by "
            f"{solver.choice.method!r}. Use Settings(method='parallel', workers=...)."
        )
    return solver.columns()


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
        if abort == records.BAD_STATE:
            return super()._failure(abort)
        assert self._pool is not None  # only a pool's watcher or barrier sets the others
        return self._pool.failure()

    # --- who does what

    def columns(self) -> Columns:
        """Who is where in the grid."""
        x = self.state().position[:, 0].astype(np.float64)
        column = np.clip((x * (self._grid.columns / self._scene.width)).astype(np.int64), 0, self._grid.columns - 1)
        return Columns(column, self.owners()[column], self._grid.columns)

    def owners(self) -> NDArray[np.int64]:
        """The worker to whom the next frame gives each column, shape (columns,)."""
        first = self._shares(self._most_workers)[0][:-1]
        return np.searchsorted(first, np.arange(self._grid.columns), side="right") - 1

    def _deal(self, workers: int) -> None:
        """Assign columns and a slice of the discs to each worker."""
        if workers == 1:
            alone = self._block.arrays["team"][0]
            alone["first_column"], alone["last_column"] = 0, self._grid.columns
            alone["low"], alone["high"] = 0, self.count
            return
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

    def set_discs(self, discs: NewDiscs, numbers: NDArray[np.int64] | None = None) -> None:
        if numbers is None:
            self._sorted_grid = None
        super().set_discs(discs, numbers)

    def _enter(self, snapshot: SolverState) -> None:
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


# --- One frame of the method grid, pass by pass, on a copy of the discs
#
# A solver runs whole frames in one call of its kernel. Here the parts of a step that ranks call one by one
# (`kernels/frame/rank.py`) run the same frame, one part at a time, so that the discs can be looked at in between. They
# are the same compiled loops in the same order, and so the end has the bits of the solver's own frame.


class Pass(NamedTuple):
    """One pass of a frame.

    Attributes:
        name: "even" or "odd".
        number: of the pass in its frame, from 0.
        state: of the discs after it.
        contacts: resolved in it.
        brackets: first column of each bracket, which is resolved with the next column: no two have a column in common,
            shape (K,). Of a periodic axis the last column's next one is the first.
        owners: worker that resolves each bracket, shape (K,).
        columns: of the grid, of equal width.
    """

    name: str
    number: int
    state: State
    contacts: int
    brackets: NDArray[np.int64]
    owners: NDArray[np.int64]
    columns: int


class PassSolver(GridSolver):
    """A grid in one process, whose next frame is run pass by pass."""

    def frame_in_passes(self, owners: NDArray[np.int64]) -> list[Pass]:
        """Run one frame, and return its passes in order.

        Args:
            owners: worker of each column, shape (columns,).

        Raises:
            DivergedError: if a disc is not finite after it has moved.
        """
        self._write_command(1, 1, math.inf, False)
        self._deal(1)
        control, team, found = self._arrays["control"], self._arrays["team"], list[Pass]()
        control.race_free, passes = 0, int(control.passes)  # or both passes of inner columns come with the sort
        for _ in range(int(control.substeps)):
            control.in_order = 0
            self._run_part(records.MOVE)
            if control.signals[records.BAD]:
                raise self._failure(records.BAD_STATE)
            for number in range(passes):
                team["stop"] = self._grid.columns
                self._run_part(records.EVEN if number else records.SORT)
                found.append(self._seen("even", len(found), owners))
                self._run_part(records.ODD)
                found.append(self._seen("odd", len(found), owners))
        control.race_free = 1
        control.done += 1
        return found

    def _run_part(self, part: int) -> None:
        control = self._arrays["control"]
        control.part, control.ahead = part, records.NO_FRAME
        run_part(*kernel_arguments(self._block, 0))

    def _seen(self, name: str, number: int, owners: NDArray[np.int64]) -> Pass:
        """The pass that has just been run."""
        team, columns = self._arrays["team"], self._grid.columns
        contacts = int(team["collisions"].sum())
        team["collisions"] = 0
        first = np.arange(number % 2, columns, 2)
        if not self._scene.periodic[0]:  # what lies beyond the last column is empty
            first = first[first < max(columns - 1, 1)]
        return Pass(name, number, self.state(), contacts, first, owners[first], columns)


def next_frame_in_passes(sim: Simulation) -> list[Pass]:
    """The passes of the frame that the next `run` would begin with, on a copy: the simulation stays as it is.

    Raises:
        InputError: for a method or a scene whose frame is not made of an even and an odd pass alone.
    """
    solver = sim._open_solver()  # pyright: ignore[reportPrivateUsage]
    terms = solver.terms
    if not isinstance(solver, GridSolver):
        reason = f"method {solver.choice.method!r}, which has no columns"
    elif solver.choice.processes.unguarded:
        reason = "unguarded=True, which has no passes"
    else:
        reason = _other_parts(terms.scene, solver.radii)
    if reason:
        raise InputError(
            f"one pass at a time needs frames that are made of an even and an odd pass; this simulation has "
            f"{reason}. Use Settings(method='grid' or 'parallel'), --method on the command line, and a scene "
            "without that."
        )
    assert isinstance(solver, GridSolver)  # or it is refused
    copy = PassSolver(terms.scene, terms.settings, Choice("grid", (1,)))
    try:
        copy.restore(solver.snapshot(), copy.choice, terms)
        copy.set_substeps(solver.substeps)
        return copy.frame_in_passes(solver.owners())
    finally:
        copy.close()


def _other_parts(scene: Scene, radii: NDArray[np.float64]) -> str:
    """The parts of a grid's frames besides an even and an odd pass; "": none."""
    if scene.emitters:
        return "emitters, which add discs inside a frame"
    if giant_radius(radii) is not None:
        return "discs far larger than the others, which have a phase of their own"
    return ""
