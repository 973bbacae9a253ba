"""The method mpi: each rank has a range of columns of the grid, with the discs in them.

All ranks make the same calls, and get the same answers and exceptions. A step is that of `grid`, with two exchanges:
discs that have left a rank's columns go to the rank that has theirs, and at a border both ranks give each other the
columns that meet there, before the pass that resolves them. Columns are dealt in equal numbers of discs, and anew where
these have wandered.
"""

import math
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim import __version__
from mpsim.core import columns
from mpsim.core.columns import ChunkedArray, kept_sizes, ranges
from mpsim.core.deferred_signals import interrupts_held_back
from mpsim.core.state import State
from mpsim.engine.feature_arrays import given_in
from mpsim.engine.solvers.base import (
    NO_WORK,
    BatchResult,
    Choice,
    NewDiscs,
    SolverState,
    Terms,
    absorbed_in,
    work_together,
)
from mpsim.engine.solvers.ranks.messages import LOST, NOT_FINITE, MpiRanks
from mpsim.engine.solvers.ranks.subdomain import (
    Border,
    Question,
    Range,
    Rows,
    Subdomain,
    borders_of,
    dealt,
    in_turns,
    refuse_giants,
)
from mpsim.engine.solvers.speeds import Fastest, Speeds, fastest_in, fastest_of, sides_at, speeds_together
from mpsim.engine.solvers.stepped import Grid, SteppedSolver, disc_at
from mpsim.engine.workers.pool import Team
from mpsim.engine.workers.shared import SharedBlock
from mpsim.engine.workers.worker import write_command
from mpsim.errors import DivergedError, InputError
from mpsim.kernels import records
from mpsim.kernels.compiling import source_digest
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings

Source = Callable[[int, int], tuple[NDArray[Any], NDArray[Any]]]
"""Places and velocities of a range of discs, shape (last - first, 2), called with (first, last)."""

NOWHERE = np.zeros((0, 2))  # places of no disc
BALANCE_EVERY = 64  # frames between two load-balance checks

UNEVEN = 1.1
"""Discs of the rank with the most, in parts of the mean or of what whole columns leave it, from which on columns are
dealt anew."""


class MpiSolver(SteppedSolver):
    """Frames on the ranks of `choice.processes.comm`; this process is one of them."""

    def __init__(self, scene: Scene, settings: Settings, choice: Choice):
        super().__init__(scene, settings, choice)
        refuse_giants(scene, scene.radii)
        self._fastest: Fastest = 0, 0
        self._ranks: MpiRanks | None = None
        self._part = Subdomain(scene, settings)
        self._team = Team()  # of this process alone: the other ranks are its workers
        self._last_frame = 0
        self._half_done = False
        self._tolerated, self._is_uneven = math.inf, False

    @property
    def ranks(self) -> MpiRanks:
        assert self._ranks is not None  # between `start` and `close`
        return self._ranks

    @property
    def block(self) -> SharedBlock:
        return self._part.block

    @property
    def _arrays(self) -> dict[str, Any]:
        return self._part.arrays

    @property
    def _control(self) -> Any:
        return self._part.arrays["control"]

    def start(self) -> None:
        self._meet()
        self._enter_all(self._scene.rows, given_in(self._scene), (0, 0))
        self._count_work_from(NO_WORK, 0.0)

    def close(self) -> None:
        self._leave_part()
        ranks, self._ranks = self._ranks, None
        if ranks is not None:
            ranks.close()

    def _leave_part(self) -> None:
        """Remove the block of this rank."""
        if self._part.arrays:
            self._last_frame = self.frame
        self._part.close()

    def _meet(self) -> None:
        """Duplicate the communicator, and refuse ranks that were given different scenes or settings."""
        if self._ranks is None:
            self._ranks = MpiRanks(self.choice.processes.comm)
            self._ranks.answer = self._answer
        self._ranks.assert_same_on_ranks("versions of mpsim and of its compiler", (__version__, source_digest()))
        self._ranks.assert_same_on_ranks("scene and settings", (self._scene.digest(), self._settings))

    def _enter_all(self, rows: Source, given: Mapping[str, NDArray[Any]], progress: tuple[int, int]) -> None:
        """Take the discs of own columns, of all discs.

        Args:
            rows: called with (first, last), gives places and velocities of a range: each rank asks for its share.
            given: columns by id of all discs, by name, shape (N, *components).
            progress: frames and steps done.
        """
        ranks, all_given = self.ranks, {**given, columns.MASS.name: self.masses}
        first, last = (self.count * each // ranks.size for each in (ranks.rank, ranks.rank + 1))
        share = {name: values[first:last] for name, values in all_given.items()}
        entering = NewDiscs(*rows(first, last), self.radii[first:last], share)
        of_all = NewDiscs(NOWHERE, NOWHERE, self.radii, all_given)
        self._enter(lambda part, grid: part.records_of(entering, first, grid), of_all, 0, progress)

    def _enter(
        self,
        records: Callable[[Subdomain, Grid], NDArray[Any]],
        brought: NewDiscs,
        first: int,
        progress: tuple[int, int],
    ) -> None:
        """Deal the columns of the grid, and the discs to whom they belong.

        Args:
            records: of this rank's share of all discs, whichever those are.
            brought, first: as of `Subdomain.fill`.
            progress: frames and steps done.
        """
        ranks = self.ranks
        self._grid = grid = self._grid_of(self.count)
        if grid.columns < ranks.size:
            raise InputError(
                f"ranks must be at most as many as the grid has columns, {grid.columns} for this scene; got "
                f"{ranks.size}. Start fewer: mpiexec -n {grid.columns}."
            )
        if not self._part.arrays:
            self._part = Subdomain(self._scene, self._settings)
        part = self._part
        given = records(part, grid)
        column = given["cell"] // (grid.rows + 2)
        counts = ranks.sum_of(np.bincount(column, minlength=grid.columns))
        own = self._take(dealt(counts, ranks.size))
        self._tolerate(counts)
        taken = ranks.deal(given, self._rank_of(column), max(ranks.size, 2))
        with ranks.collective():
            part.fill(taken, own, grid, self.count, brought, first)
            self._control.done, self._control.steps = progress
            self._configure()
            part.start()

    def _configure(self) -> None:
        self._write_parameters(self._grid)
        self._part.configure()

    # --- frames

    def advance(self, frames: int, workers: int, stop: float = math.inf, count_enabled: bool = False) -> BatchResult:
        part, ranks, frames = self._part, self.ranks, self._frames_to(stop, frames)
        self._half_done = True
        with interrupts_held_back():  # it is many calls, which no rank may leave before the others
            if self.frame % BALANCE_EVERY == 0 or self._is_uneven:
                self._balance(part, ranks)
            frames = min(frames, BALANCE_EVERY - self.frame % BALANCE_EVERY)
            write_command(part.block, ranks.agree(0, 0, frames).frames, count_enabled)
            part.stop_at(any(border.is_left for border in self._borders))
            frames = self._run(part, ranks)
            result = self._result(part, ranks, frames, count_enabled)
            self._control.done += frames
        self._half_done = False
        return result

    def _balance(self, part: Subdomain, ranks: MpiRanks) -> None:
        """Deal the columns anew where one rank has far more discs than others: all know how many each column has."""
        if ranks.size == 1 or self._control.in_order == 0:
            return
        counts = np.concatenate(ranks.all_of(part.discs_in_columns()))
        firsts = self._firsts
        if self._most_in(counts) * ranks.size >= UNEVEN * counts.sum():
            firsts = dealt(counts, ranks.size)
        if not np.array_equal(firsts, self._firsts):
            own, discs = self._take(firsts), part.discs()
            arrived = ranks.deal(discs, self._rank_of(part.columns_of(discs)), ranks.size)
            with ranks.collective():
                part.move_to(own, arrived)
            self._configure()
        self._tolerate(counts)

    def _most_in(self, counts: NDArray[np.int64]) -> int:
        """Discs of the rank that has the most; counts: in each column."""
        return int(np.add.reduceat(counts, self._firsts[:-1]).max())

    def _tolerate(self, counts: NDArray[np.int64]) -> None:
        """From now on columns are to be dealt anew when a rank has far more discs than it has to have."""
        mean = counts.sum() / len(self._firsts[:-1])
        self._tolerated, self._is_uneven = UNEVEN * max(self._most_in(counts), mean), False

    def _take(self, firsts: NDArray[np.int64]) -> Range:
        """From now on each rank r has the columns from firsts[r] to before firsts[r + 1]. Returns own ones."""
        ranks = self.ranks
        own = Range(*map(int, firsts[ranks.rank : ranks.rank + 2]))
        self._firsts, self._borders = firsts, borders_of(own, ranks.rank, ranks.size, self._scene.periodic[0])
        self._together = in_turns(self._borders, own)
        return own

    def _rank_of(self, column: NDArray[np.int64]) -> NDArray[np.int64]:
        """The rank that has each of some columns."""
        return np.searchsorted(self._firsts, column, side="right") - 1

    def _run(self, part: Subdomain, ranks: MpiRanks) -> int:
        """Run the command that stands in `control`; returns the frames that were run."""
        started, frame = time.monotonic(), 0
        part.arrays["team"]["frame"] = 0
        part.run(records.MOVE)
        while frame < self._control.frames:
            if ranks.rank == 0 and time.monotonic() - started > records.SLICE * 1e-9:
                self._control.frames = frame + 1
            for step in range(self.substeps):
                self._step(part, ranks, frame, step)
            frame += 1
        return frame

    def _result(self, part: Subdomain, ranks: MpiRanks, frames: int, count_enabled: bool) -> BatchResult:
        """The times and counts of all ranks."""
        arrays = part.arrays
        tally = arrays["tally"][:1, :frames] if count_enabled else None
        counts = fastest_in(part.team), int(part.team["collisions"].sum())
        told = ranks.all_of((part.failure, *counts, arrays["times"][:1, :frames], tally, self._work_counted()))
        failures, fastest, contacts, times, tallies, works = zip(*told, strict=True)
        ranks.raise_any(failures)
        self._fastest = max(fastest)
        self._count_work_from(work_together(self._work_before, *works), self.work_unit)
        self.too_fast: bool = self._fastest[0] > 0
        counters = self._counters(np.concatenate(tallies)) if count_enabled else None
        return BatchResult(np.concatenate(times), sum(contacts), counters, too_fast=self.too_fast)

    def _step(self, part: Subdomain, ranks: MpiRanks, frame: int, step: int) -> None:
        """A step of this rank that has begun, and the beginning of the next one of this command, where there is one."""
        part.take_in(self._migrated(part, ranks, frame))
        ahead = frame if step + 1 < self.substeps else frame + 1
        if ahead == self._control.frames:
            ahead = records.NO_FRAME
        part.run(records.SORT)
        for turn in range(self._settings.passes):
            if turn:
                part.run(records.EVEN)
            for borders in self._together:
                self._resolve_borders(borders, part, ranks, frame)
            part.run(records.ODD, records.NO_FRAME if turn + 1 < self._settings.passes else ahead)

    def _migrated(self, part: Subdomain, ranks: MpiRanks, frame: int) -> NDArray[Any]:
        """Give away the discs that have left own columns; returns those that have come."""
        began = time.perf_counter_ns()
        leaving = part.emigrants()
        target, farthest = np.zeros(0, np.int64), 0
        if len(leaving):
            target = self._rank_of(part.columns_of(leaving))
            farthest = ranks.distance(target)
        trouble = LOST if part.failure is not None else 0 if part.is_finite else NOT_FINITE
        agreed = ranks.agree(trouble, farthest, int(self._control.frames), part.count)
        if agreed.trouble == LOST:
            ranks.raise_any(ranks.all_of(part.failure))
        if agreed.trouble:
            raise self._diverged(part, ranks)
        self._is_uneven = agreed.discs > self._tolerated
        self._control.frames = min(agreed.frames, frame + 1) if self._is_uneven else agreed.frames
        arrived = ranks.deal(leaving, target, agreed.farthest) if agreed.farthest else leaving[:0]
        part.arrays["times"][0, frame, records.WAIT] += time.perf_counter_ns() - began
        return arrived

    def _resolve_borders(self, borders: list[Border], part: Subdomain, ranks: MpiRanks, frame: int) -> None:
        """The brackets at some borders."""
        began = time.perf_counter_ns()
        given = [(border.other, int(border.is_periodic), part.column_at(border)) for border in borders]
        taken = ranks.exchange(given)
        part.arrays["times"][0, frame, records.WAIT] += time.perf_counter_ns() - began
        for border, (_, _, own), beyond in zip(borders, given, taken, strict=True):
            part.resolve_at(records.ODD if border.is_odd else records.EVEN, border, len(own), beyond)

    def _diverged(self, part: Subdomain, ranks: MpiRanks) -> DivergedError:
        """The exception for a disc that is not finite, the one of the least number."""
        own = [disc_at(part.live, int(slot)) for slot in part.team["bad_slot"] if slot >= 0]
        disc, values = min(each for told in ranks.all_of(own) for each in told)
        return DivergedError(disc, self.frame + int(part.team[0].frame), values[:2], values[2:])

    @property
    def frame(self) -> int:
        arrays = self._part.arrays
        return self._origin.frame + int(arrays["control"].done) if arrays else self._last_frame

    @property
    def half_done(self) -> bool:
        return self._half_done

    # --- steps

    def speeds(self, new: NewDiscs | None = None, numbers: NDArray[np.int64] | None = None) -> Speeds:
        scene, radii, count = self._scene, self.radii, self.count
        present = ~self.absorbed if scene._loses_discs else None
        own, state = self.local_state()
        velocity, sides = state.velocity, sides_at(scene, self.time)
        if new is not None:
            radii = kept_sizes(radii, new.radius)
            present = None if present is None else np.append(present, np.ones(len(new.position), bool))
            if self.ranks.is_root:
                own, velocity = np.append(own, range(count, len(radii))), np.append(velocity, new.velocity, 0)
        part = fastest_of(own, velocity, radii[own], sides, scene.periodic, scene.largest_radius)
        found = speeds_together(*part, self.ranks.all_of, radii if present is None else radii[present], sides)
        fastest, self._fastest = self._fastest, (0, 0)
        return self._or_too_fast(found, fastest)

    # --- discs, of which no rank has to hold all

    def state(self, first: int = 0, last: int | None = None) -> State:
        last = self.count if last is None else last
        rows = self._rows(first, last)
        return self._state_of(rows, absorbed_in(rows, last - first))

    def local_state(self) -> tuple[NDArray[np.int64], State]:
        numbers, rows = self._part.own()
        return numbers, self._state_of(rows, absorbed_in(rows, len(numbers)))

    @property
    def absorbed(self) -> NDArray[np.bool_]:
        found = np.zeros(self.count, bool)
        if self._scene._loses_discs:
            for first, last in ranges(self.count):
                found[first:last] = absorbed_in(self._rows(first, last), last - first)
        return found

    def _rows(self, first: int, last: int, name: str | None = None) -> Rows:
        """What steps have changed of the discs of a range, in their order; of a name, or all."""
        found: Rows = {}
        for numbers, own in self._ask(Question(first, last, name)):
            for each, values in own.items():
                if each not in found:
                    found[each] = np.empty((last - first, *values.shape[1:]), values.dtype)
                found[each][numbers - first] = values
        return found

    def _answer(self, question: Question) -> tuple[NDArray[np.int64], Rows]:
        return self._part.answer(question)

    def _ask(self, question: Question) -> list[Any]:
        """The answer of each rank."""
        if self.ranks.acting:
            return self.ranks.ask(question)
        told = self.ranks.all_of((question, self.ranks.answer(question)))
        if len({asked for asked, _ in told}) > 1:
            others = ", ".join(str(tuple(asked[:2])) for asked, _ in told)
            raise InputError(
                f"the range of discs must be the same on all ranks; got {others}. Ask for one range, or use "
                "local_state."
            )
        return [answer for _, answer in told]

    def add(self, new: NewDiscs, choice: Choice) -> None:
        radii, masses = kept_sizes(self.radii, new.radius), kept_sizes(self.masses, new.mass)
        refuse_giants(self._scene, radii)
        first, own = self.count, self._part.discs()
        self._half_done = True
        self.count: int = len(radii)
        self.radii: NDArray[np.float64] = radii
        self.masses: NDArray[np.float64] = masses

        def records(part: Subdomain, grid: Grid) -> NDArray[Any]:
            """Own discs, and of one rank the new ones."""
            added = part.records_of(new, first, grid)
            return np.concatenate([part.in_grid(own, grid), added[: len(added) * self.ranks.is_root]])

        self._enter(records, new, first, (self._frames, int(self._control.steps)))
        self._half_done = False

    def discs(self, numbers: NDArray[np.int64] | None = None) -> NewDiscs:
        rows = self._rows(0, self.count)
        position, velocity = rows.pop("position"), rows.pop("velocity")
        for column in self._scene._columns:
            if column.name not in rows:  # what stays as it is, which all ranks know
                rows[column.name] = self._arrays[column.name][..., : self.count].T.copy()
        found = NewDiscs(position, velocity, self.radii, {**rows, columns.MASS.name: self.masses})
        return found if numbers is None else found.rows(numbers)

    def set_discs(self, discs: NewDiscs, numbers: NDArray[np.int64] | None = None) -> None:
        if numbers is not None:
            discs = self.discs().with_rows(discs, numbers)
        self._continue_with(discs, (self._frames, int(self._control.steps)))

    def _continue_with(self, discs: NewDiscs, progress: tuple[int, int]) -> None:
        self._half_done = True
        self._enter_all(lambda a, b: (discs.position[a:b], discs.velocity[a:b]), discs.columns, progress)
        self._half_done = False

    def _set_terms(self, terms: Terms) -> None:
        refuse_giants(terms.scene, self.radii)
        super()._set_terms(terms)

    def change_scene(self, terms: Terms, choice: Choice) -> None:
        discs, progress = self.discs(), (self._frames, int(self._control.steps))
        if terms.origin != self._origin:
            progress = 0, 0
            self.substeps: int = terms.settings.substeps
        self._set_terms(terms)
        self.choice = choice
        self._leave_part()
        self._continue_with(discs, progress)
        self._count_work_from(self._work_before, self.work_unit)

    # --- snapshots

    def snapshot(self) -> SolverState:
        def reader(name: str) -> Callable[[int, int], NDArray[Any]]:
            return lambda first, last: self._rows(first, last, name)[name]

        moved: SolverState = {
            name: ChunkedArray(none.dtype, (self.count, *none.shape[1:]), reader(name))
            for name, none in self._rows(0, 0).items()
        }
        return self._snapshot_of(moved)

    def restore(self, snapshot: SolverState, choice: Choice, terms: Terms, new_workers: bool = True) -> None:
        self._set_terms(terms)
        self._meet()
        refuse_giants(self._scene, np.asarray(snapshot["radii"]))
        self.choice: Choice = choice
        self._leave_part()
        progress = self._begin_from(snapshot)
        names = [column.name for column in self._scene._columns if column.name in snapshot]
        given = {name: np.asarray(snapshot[name]) for name in names}
        position, velocity = snapshot["position"], snapshot["velocity"]
        self._enter_all(lambda first, last: (position[first:last], velocity[first:last]), given, progress)
        self._restore_work(snapshot)
