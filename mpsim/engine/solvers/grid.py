"""The methods naive, grid and parallel: discs in the shared block, its growth, commands."""

import math
from bisect import bisect_left
from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.core import columns
from mpsim.core.columns import ChunkedArray, kept_sizes
from mpsim.core.deferred_signals import interrupts_held_back
from mpsim.core.state import State, part_of
from mpsim.engine.feature_arrays import feature_specs, fill_features, giant_radius, given_in
from mpsim.engine.solvers import base
from mpsim.engine.solvers.base import (
    BatchResult,
    Choice,
    CollisionLog,
    InPlace,
    NewDiscs,
    SolverState,
    Terms,
    count_in,
)
from mpsim.engine.solvers.speeds import Speeds, fastest_in, speeds_of
from mpsim.engine.solvers.stepped import Grid, SteppedSolver, block_arrays, disc_at
from mpsim.engine.workers.pool import Team
from mpsim.engine.workers.shared import MOST_FRAMES, SharedBlock
from mpsim.engine.workers.worker import LINGER, call_of, kernel_arguments, load_kernels, numbers_of, write_command
from mpsim.errors import DivergedError
from mpsim.features.properties import has_radii
from mpsim.kernels import records
from mpsim.kernels.compiling import bound
from mpsim.kernels.features import collisions
from mpsim.kernels.frame.sorting import put_in_order
from mpsim.kernels.frame.stepping import run_grid, run_naive
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings

# --- Discs in the block, where the last frame has sorted them, and in the order of their numbers


def live_discs(block: SharedBlock) -> records.Discs:
    """The buffer that holds the state."""
    its = kernel_arguments(block)
    return its.b if numbers_of(block)[0].live else its.a


def _pairs_by_id(x: NDArray[Any], y: NDArray[Any], ids: NDArray[np.int32]) -> NDArray[np.floating]:
    """Components as rows (x, y), that of disc ids[k] from place k."""
    found = np.empty((len(x), 2), x.dtype)
    put_in_order(x, y, ids, found)
    return found


class AsTheyLay(ChunkedArray):
    """Pairs of numbers of each disc, copied as they lay in memory, and put in order when somebody reads them.

    Args:
        x, y: shape (N,).
        numbers: of the discs, shape (N,).
    """

    def __init__(self, x: NDArray[np.floating], y: NDArray[np.floating], numbers: NDArray[np.int32]):
        self.dtype: np.dtype[Any] = x.dtype  # and no function that reads, which would keep this alive
        self.shape: tuple[int, ...] = len(x), 2
        self.x: NDArray[np.floating] = x
        self.y: NDArray[np.floating] = y
        self.numbers: NDArray[np.int32] = numbers
        self.nbytes: int = x.nbytes + y.nbytes

    def __getitem__(self, rows: slice) -> NDArray[np.floating]:
        return self._in_order[rows]

    @cached_property
    def _in_order(self) -> NDArray[np.floating]:
        return _pairs_by_id(self.x, self.y, self.numbers)


def _as_laid(pairs: Any) -> Any:
    """Both components of pairs that a snapshot holds: as they lay, or else in the order of their discs."""
    return (pairs.x, pairs.y) if isinstance(pairs, AsTheyLay) else np.asarray(pairs).T


def naive_call(block: SharedBlock) -> Callable[[], int]:
    """`run_naive` with its arguments: views of the block. There is one buffer, which is never sorted."""
    if (known := block.calls.get("naive")) is None:
        its = kernel_arguments(block)
        parameters, control = records.row_of(its.parameters), records.row_of(its.control)
        call = its.a, its.features, parameters, control, its.team, its.tally, its.times
        known = block.calls["naive"] = bound(run_naive, *call)
    return known


TIMED = 8
"""Frames, of one command or several, whose times tell how to deal: in a single one, a worker that wakes looks slow."""

SHORT, LONG = 100_000, 20_000_000
"""Nanoseconds of a command that is so short that its times are not worth reading, or so long that they suffice."""

FEW = 16
"""Discs that are fewer than one in so many are looked for in memory, so few one by one; else all are put in order."""


# --- The solver


class GridSolver(SteppedSolver, CollisionLog):
    """Frames by the passes of a grid; of `naive`, by testing all pairs i < j in index order.

    The state lives in the shared block, in whatever order the last frame sorted it; ids bring it back to the scene's.
    This process is worker 0; the others are there where `choice` may use them.
    """

    def __init__(self, scene: Scene, settings: Settings, choice: Choice):
        super().__init__(scene, settings, choice)
        self._moving = False
        self._tables: list[NDArray[Any]] = []  # of collisions that were logged and not taken yet
        self._least_log = 1  # rows of each log, at least
        self._frames_that_fit = MOST_FRAMES  # so that a log is about half full after them
        self._begun = -1  # frames that were done when the last command was given to this block
        self._sorted_grid: Grid | None = None  # by which the discs lie in memory
        self._borders: list[float] = []  # fraction of the discs before those of each worker but the first
        self._dealt: Any = None  # the workers, count, span of frames and borders for which that was done last
        self._timed = 0  # frames since the borders moved,
        self._busy = np.zeros(0, np.int64)  # and the shortest time of each worker in them
        self._team = Team()
        self._capacity = max(scene.count, 1)

    def start(self) -> None:
        scene = self._scene
        start: SolverState = {"position": scene.position, "velocity": scene.velocity, **given_in(scene)}
        start |= {"radii": self.radii, "masses": self.masses, "progress": np.zeros(2, np.int64)}
        self.restore(start, self.choice, self.terms)

    def close(self) -> None:
        self._team.close()

    # --- frames

    def advance(self, frames: int, workers: int, stop: float = math.inf, count_enabled: bool = False) -> BatchResult:
        if not self.logging:
            return self._command(frames, workers, stop, count_enabled)
        with interrupts_held_back():  # what a log could not hold is found out before anybody else comes
            before, frame = self.snapshot(), self.frame
            while True:
                self._arrays[collisions.STATE][:] = 0
                result = self._command(min(frames, self._frames_that_fit), workers, stop, count_enabled)
                if self._take_logs(result.times.shape[1], frame):
                    return result
                self.restore(before, self.choice, self.terms)  # to run the frames again with more room

    def _take_logs(self, frames: int, frame: int) -> bool:
        """Make a table of what a command has logged. False: not all has fitted; a block that is made now has room.

        frames, frame: of the command, and done when it began.
        """
        arrays, terms, substeps = self._arrays, self.terms, self.substeps
        state, room = arrays[collisions.STATE], arrays[collisions.ROWS].shape[1]
        longest = int(state[:, collisions.COUNT].max())
        if longest > room:
            self._least_log = 2 * longest
            return False
        fitting = min(frames * room // (2 * longest or 1), 2 * self._frames_that_fit, MOST_FRAMES)
        self._frames_that_fit = max(fitting, 1)
        state[:, collisions.AGREED] = state[:, collisions.COUNT]
        rows = base.emptied(arrays)
        step, origin = rows["span"] - 1, terms.origin
        number, ended = frame + step // substeps, (step % substeps + 1) / substeps
        time = origin.time + ((number - origin.frame + ended) * terms.settings.dt - rows["time"])
        moving = {wall.edge: wall for wall in terms.scene._moving_walls}
        for edge, place in enumerate(terms.scene.box):
            hit = (rows["kind"] == collisions.WALL) & (rows["j"] == edge)
            wall = moving.get(edge)
            rows["place"][hit, edge // 2] = place if wall is None else [wall.place(each) for each in time[hit].tolist()]
        self._tables.append(base.table_of(rows, number + 1, time, terms.scene))
        return True

    def _command(self, frames: int, workers: int, stop: float, count_enabled: bool) -> BatchResult:
        if stop < math.inf:
            frames = self._frames_to(stop, frames)
        write_command(self._team.block, frames, count_enabled)
        control, _ = numbers_of(self._team.block)
        control.workers = control.members = workers
        self._begun = control.done
        abort = self._run_kernel(workers)
        if abort != records.RUNNING:
            raise self._failure(abort)
        arrays, frames = self._team.block.arrays, control.frames
        team = arrays["team"]
        contacts = sum(team["collisions"].tolist())  # of a few workers: quicker than by NumPy
        self.too_fast: bool = any(team["fastest"].tolist())
        if workers > 1:
            self._balance(workers, frames)
        counters = self._counters(arrays["tally"][:, :frames]) if count_enabled else None
        return BatchResult(arrays["times"][:, :frames].copy(), contacts, counters, 0, self.too_fast, self.logging)

    def _run_kernel(self, workers: int) -> int:
        """Run the command that the record `control` holds. Returns records.RUNNING, or why it has ended before."""
        if self.choice.method == "naive":
            return naive_call(self._team.block)()
        self._deal(workers)
        kernel = call_of(self._team.block, run_grid, 0, LINGER)
        abort = kernel() if workers == 1 else self._team.pool.run(kernel)
        self._sorted_grid = self._grid
        return abort

    def _failure(self, abort: int) -> Exception:
        """The exception for a command that has ended before its time, at the not finite disc of the least id."""
        if abort != records.BAD_STATE:
            return self._team.pool.failure()
        team = self._arrays["team"]
        # After an odd number of steps the state lies in the other buffer, so both are looked at.
        slots = [int(slot) for slot in team["bad_slot"] if slot >= 0]
        candidates = [disc_at(discs, slot) for discs in kernel_arguments(self._team.block)[:2] for slot in slots]
        disc, values = min(each for each in candidates if not np.isfinite(each[1]).all())
        return DivergedError(disc, self.frame + int(team[0].frame), values[:2], values[2:])

    def take_collisions(self) -> NDArray[Any]:
        tables, self._tables = self._tables, []
        return base.in_order(base.joined(tables))

    @property
    def half_done(self) -> bool:
        if self._moving or not self._team.block.arrays:  # none after `close`
            return self._moving
        control, _ = numbers_of(self._team.block)
        left = control.signals[records.ABORT] or control.signals[records.BAD]
        return bool(left and control.done == self._begun)

    @property
    def frame(self) -> int:
        return self._origin.frame + numbers_of(self._team.block)[0].done

    # --- who does what

    def _deal(self, workers: int) -> None:
        """Assign columns and a slice of the discs to each worker: whole columns once sorted."""
        team, grid, count = numbers_of(self._team.block)[1], self._grid, self.count
        dealt = workers, count, self.frame // TIMED, self._borders
        if self._dealt == dealt and self._sorted_grid == grid:
            return  # the kernel keeps slices that end with columns
        self._dealt = dealt
        if workers == 1:
            alone = team[0]
            alone.first_column, alone.last_column, alone.low, alone.high = 0, grid.columns, 0, count
            return
        if len(self._borders) != workers - 1:
            self._borders = [worker / workers for worker in range(1, workers)]
        slots = [int(border * count) for border in self._borders]
        if self._sorted_grid == grid:
            first_of_column = self._team.block.arrays["start"][: grid.table_size : grid.rows + 2]
            middles = first_of_column[: grid.columns] + first_of_column[1 : grid.columns + 1]  # twice: nearest columns
            columns = [bisect_left(middles, 2 * slot) for slot in slots]
            slots = [int(first_of_column[column]) for column in columns]
        else:
            columns = [worker * grid.columns // workers for worker in range(1, workers)]
        column = slot = 0
        # The last worker has the discs that were added since the last sort, too: they lie behind the sorted ones.
        for mine, last, high in zip(team, [*columns, grid.columns], [*slots, count], strict=False):
            mine.first_column, mine.last_column, mine.low, mine.high = column, last, slot, high
            column, slot = last, high

    def _balance(self, workers: int, frames: int) -> None:
        """Move the borders half way to where the times of the last frames, without waiting, would have been equal."""
        times, ends = self._arrays["times"][:workers, :frames], self._arrays["team"]["high"][:workers]
        took = LONG if frames >= TIMED else sum(map(sum, times[0].tolist()))
        if took < SHORT:
            return
        busy = times[..., : records.WAIT].sum(axis=2).min(axis=1)  # the shortest: others may have been interrupted
        self._timed += TIMED if took >= LONG else frames
        self._busy = busy = np.minimum(self._busy, busy) if len(self._busy) == len(busy) else busy
        if self._timed < TIMED:
            return
        self._timed, self._busy = 0, self._busy[:0]
        taken, shares = np.append(0, busy.cumsum()), np.append(0, ends) / max(self.count, 1)
        equal = np.interp(np.linspace(0, taken[-1], len(taken)), taken, shares)
        self._borders = ((self._borders + equal[1:-1]) / 2).tolist()  # not from ends of columns: they would stay there

    # --- steps

    def speeds(self, new: NewDiscs | None = None, numbers: NDArray[np.int64] | None = None) -> Speeds:
        radii, velocity = self.radii, self._places_and_speeds(numbers)[1]
        if new is not None:
            velocity, radii = np.concatenate([velocity, new.velocity]), kept_sizes(radii, new.radius)
        if numbers is not None:
            radii = radii[numbers]
        elif self._scene._loses_discs:
            numbers = np.append(np.flatnonzero(~self.absorbed), np.arange(self.count, len(radii)))
            velocity, radii = velocity[numbers], radii[numbers]
        found = speeds_of(velocity, radii, self._scene, self.time, numbers)
        fastest = fastest_in(self._arrays["team"])
        self._arrays["team"]["fastest"] = 0
        return self._or_too_fast(found, fastest)

    # --- discs

    def _as_they_lie(self) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any], NDArray[np.int32]]:
        """Views of x, y, vx, vy and the numbers."""
        discs, count = live_discs(self._team.block), self.count
        return discs.x[:count], discs.y[:count], discs.vx[:count], discs.vy[:count], discs.id[:count]

    def _places_and_speeds(
        self, numbers: NDArray[np.int64] | None = None
    ) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        """Copies of positions and velocities as they lie in the block, of the discs of these numbers; None: of all."""
        x, y, vx, vy, ids = self._as_they_lie()
        if numbers is None:
            return _pairs_by_id(x, y, ids), _pairs_by_id(vx, vy, ids)
        slots = self._slots_of(numbers)
        position, velocity = np.empty((2, len(slots), 2), x.dtype)
        position[:, 0], position[:, 1], velocity[:, 0], velocity[:, 1] = x[slots], y[slots], vx[slots], vy[slots]
        return position, velocity

    def _slots_of(self, numbers: NDArray[np.int64]) -> NDArray[np.int64]:
        """Where the discs of these numbers lie."""
        ids = self._as_they_lie()[-1]
        if len(numbers) <= FEW:
            return np.array([(ids == number).argmax() for number in numbers.tolist()], np.intp)
        wanted = np.zeros(self.count, bool)
        wanted[numbers] = True
        slots = np.flatnonzero(wanted[ids])
        found = np.empty_like(slots)
        found[np.argsort(numbers)] = slots[np.argsort(ids[slots])]
        return found

    def state(self, first: int = 0, last: int | None = None) -> State:
        last = self.count if last is None else last
        few = (last - first) * FEW <= self.count
        numbers, arrays = np.arange(first, last) if few else None, self._arrays
        rows = slice(self.count) if numbers is None else numbers
        found = {each.name: arrays[each.name][..., rows].T.copy() for each in columns.IN_STATE if each.name in arrays}
        found["position"], found["velocity"] = self._places_and_speeds(numbers)
        state = self._state_of(found, self.absorbed[rows])
        return state if few else part_of(state, first, last)

    def in_place(self) -> InPlace:
        absent = self.absorbed if "exits" in self._arrays else None
        return InPlace(*self._as_they_lie(), absent, self._box, self.frame, self.time, self.radii)

    @property
    def absorbed(self) -> NDArray[np.bool_]:
        exits = self._arrays.get("exits")
        return np.zeros(self.count, bool) if exits is None else exits[0, : self.count] != 0

    def discs(self, numbers: NDArray[np.int64] | None = None) -> NewDiscs:
        rows, arrays = slice(self.count) if numbers is None else numbers, self._arrays
        position, velocity = self._places_and_speeds(numbers)
        found = {each.name: arrays[each.name][..., rows].T.copy() for each in columns.COLUMNS if each.name in arrays}
        return NewDiscs(position, velocity, self.radii[rows], {**found, columns.MASS.name: self.masses[rows]})

    def set_discs(self, discs: NewDiscs, numbers: NDArray[np.int64] | None = None) -> None:
        if numbers is None:
            self._sorted_grid = None
            self._write_discs(discs, slice(self.count))
        else:
            self._write_discs(discs, numbers, self._slots_of(numbers))

    def add(self, new: NewDiscs, choice: Choice) -> None:
        count = self.count + len(new.position)
        radii, masses = kept_sizes(self.radii, new.radius), kept_sizes(self.masses, new.mass)
        # Discs that make giants of others leave the grid finer than one for as many discs without giants.
        crowded = self._grid_of(count, self._giant_radius(radii)).table_size > len(self._arrays["start"])
        if choice != self.choice or count > self._capacity or crowded:
            capacity = max(2 * self._capacity, count) if count > self._capacity else self._capacity
            self._continue(self.snapshot(), choice, self.terms, capacity, radii)
        self._write_discs(new, slice(self.count, count))
        self.count: int = count
        self.radii: NDArray[np.float64] = radii
        self.masses: NDArray[np.float64] = masses
        self._configure()

    def _write_discs(self, new: NewDiscs, rows: Any, slots: Any = None) -> None:
        """Write discs of these numbers to these slots; None: to those of their numbers."""
        numbers = np.arange(*rows.indices(self._capacity)) if isinstance(rows, slice) else rows
        self._lay(rows if slots is None else slots, numbers, new.position.T, new.velocity.T, new.radius)
        for column in columns.COLUMNS:
            if column.name in self._arrays:
                self._arrays[column.name][..., rows] = new.of(column).T

    def _lay(self, slots: Any, numbers: Any, places: Any, speeds: Any, radii: NDArray[np.float64]) -> None:
        """Write discs of these numbers to these slots, components of places and speeds apart."""
        discs = live_discs(self._team.block)
        discs.x[slots], discs.y[slots] = places
        discs.vx[slots], discs.vy[slots] = speeds
        discs.id[slots] = numbers
        if discs.radius is not None:
            discs.radius[slots] = radii
        self._arrays["control"].in_order = 0

    # --- snapshots, and other terms

    def snapshot(self) -> SolverState:
        *rows, ids = self._as_they_lie()
        (x, y, vx, vy), numbers = np.stack(rows), ids.copy()
        return self._snapshot_of({"position": AsTheyLay(x, y, numbers), "velocity": AsTheyLay(vx, vy, numbers)})

    def restore(self, snapshot: SolverState, choice: Choice, terms: Terms, new_workers: bool = True) -> None:
        capacity = max(self._capacity, count_in(snapshot))
        self._continue(snapshot, choice, terms, capacity, snapshot["radii"], new_workers)

    def change_scene(self, terms: Terms, choice: Choice) -> None:
        snapshot = self.snapshot()
        if terms.origin != self._origin:
            snapshot["progress"] = np.zeros(2, np.int64)
        self._continue(snapshot, choice, terms, self._capacity, self.radii)

    def _continue(
        self,
        snapshot: SolverState,
        choice: Choice,
        terms: Terms,
        capacity: int,
        radii: NDArray[np.float64],
        new_workers: bool = False,
    ) -> None:
        """Continue from a snapshot: in the present block where another one would be the same, with the same workers.

        Args:
            snapshot, choice, terms: as of `restore`.
            capacity: discs for which the block has room.
            radii: of the discs for which it is to have a grid, shape (M,): of the snapshot, and of any to be added.
            new_workers: whether others are started, as if `choice` were another.
        """
        before = self.terms, self.choice, self._capacity
        new_workers = new_workers or choice != self.choice
        try:
            self._set_terms(terms)
            self.choice: Choice = choice
            block = self._next_block(capacity, radii)
            stays = not new_workers and block.specs == self._team.block.specs
            if stays:
                fill_features(self._arrays, self._scene)
            else:
                with self._team.moving_to(block):
                    block.create()
                    block.arrays["team"]["bad_slot"] = -1
                    fill_features(block.arrays, self._scene)
                    with interrupts_held_back():  # Numba looks up the types of arguments inside exceptions of its own
                        (naive_call if choice.method == "naive" else load_kernels)(block)
                    self._moving = not new_workers  # else nothing is lost if they do not come
                    self._team.man(self._most_workers, choice.processes.start_method, new_workers)
        except BaseException:
            self._set_terms(before[0])
            _, self.choice, self._capacity = before
            raise
        self._moving = True
        if not stays:
            self._team.take()
        self._enter(snapshot)
        self._moving = False

    # --- the block

    @property
    def _arrays(self) -> dict[str, Any]:
        return self._team.block.arrays

    @property
    def _most_workers(self) -> int:
        return max(self.choice.workers)

    def _giant_radius(self, radii: NDArray[np.float64]) -> float | None:
        """Radius above which discs of such radii are kept out of the grid; None: there are no such discs."""
        return giant_radius(radii) if has_radii(self._scene) and self.choice.method != "naive" else None

    def _next_block(self, capacity: int, radii: NDArray[np.float64]) -> SharedBlock:
        """A block for so many discs, which is still to be filled."""
        precision = self._settings.precision
        features = feature_specs(self._scene, capacity, precision) | base.work_specs(self._scene, self._most_workers)
        grid = self._grid_of(capacity, self._giant_radius(radii))
        self._capacity = capacity
        arrays = block_arrays(capacity, grid, self._most_workers, precision, features)
        arrays |= base.specs_of(capacity, self._most_workers, self._least_log) if self.logging else {}
        return SharedBlock(arrays, alone=self._most_workers == 1)

    def _enter(self, snapshot: SolverState) -> None:
        """Write a snapshot into the present block."""
        arrays = self._arrays
        self._begun, self._sorted_grid = -1, None
        arrays["team"]["fastest"], self.too_fast = 0, False
        frames, steps = self._begin_from(snapshot)
        position, velocity = snapshot["position"], snapshot["velocity"]
        numbers = position.numbers if isinstance(position, AsTheyLay) else np.arange(self.count)
        self._lay(slice(self.count), numbers, _as_laid(position), _as_laid(velocity), self.radii[numbers])
        arrays["control"].done, arrays["control"].steps = frames, steps
        if columns.MASS.name in arrays:
            columns.MASS.put(arrays[columns.MASS.name], self.masses)
        for column in columns.COLUMNS:
            if column.kept and column.name in snapshot:
                column.put(arrays[column.name], snapshot[column.name])
        self._restore_work(snapshot)
        self._configure()

    def _configure(self) -> None:
        giant = self._giant_radius(self.radii)
        self._grid = self._grid_of(self.count, giant)
        self._write_parameters(self._grid, giant)
