"""The method mpi: frames on the ranks of a communicator, each with a range of the grid's columns and its own discs.

All ranks make the same calls, and get the same answers and exceptions. A step is that of `grid`, with two exchanges:
discs that have left a rank's columns go to the rank that has theirs, and at a border both ranks give each other the
columns that meet there, before the pass that resolves them. Columns are dealt in equal numbers of discs, and anew where
these have wandered.
"""

import hashlib
import math
import os
import pickle
import time
from collections.abc import Callable, Iterable, Mapping
from itertools import chain
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from mpsim.core import columns
from mpsim.core.deferred_signals import interrupts_held_back
from mpsim.core.errors import DivergedError, InputError
from mpsim.core.sizes import kept_sizes
from mpsim.core.state import State
from mpsim.engine.columns import columns_of, given_in
from mpsim.engine.feature_arrays import giant_radius
from mpsim.engine.solvers.base import Capabilities, Choice, NewDiscs
from mpsim.engine.solvers.discs import disc_at, state_of
from mpsim.engine.solvers.mpi_columns import Range, borders_of, columns_of_places, dealt
from mpsim.engine.solvers.mpi_part import Part
from mpsim.engine.solvers.mpi_ranks import LOST, NOT_FINITE, Communicator
from mpsim.engine.solvers.parameters import Present
from mpsim.engine.solvers.slices import Slice, totals
from mpsim.engine.solvers.snapshots import Snapshot
from mpsim.engine.solvers.speed_limit import Fastest, disc_too_fast, fastest_in
from mpsim.engine.solvers.speeds import Speeds
from mpsim.engine.solvers.stepped import SteppedSolver
from mpsim.engine.workers.system_limits import resident_bytes
from mpsim.features.radii import has_radii
from mpsim.kernels import layout
from mpsim.kernels.compiling import source_digest
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings

Result = TypeVar("Result")

BALANCE_EVERY = 64
"""Frames from one look at how the discs are shared to the next."""

UNEVEN = 1.1
"""Discs of the rank with the most, in parts of the mean, from which on columns are dealt anew."""


class MpiSolver(SteppedSolver):
    """Frames on the ranks of `choice.comm`; this process is one of them."""

    capabilities: ClassVar[Capabilities] = Capabilities(has_steps=True, on_ranks=True)
    count: int
    tallied: bool

    def __init__(self, scene: Scene, settings: Settings, choice: Choice):
        super().__init__(scene, settings, choice)
        _refuse(scene, settings, scene.radii)
        self._fastest = Fastest()
        self._workers = 1  # of each rank, itself included
        self._ranks: Communicator | None = None
        self._part: Part | None = None
        self._last_frame = 0
        self._half_done = False

    def start(self) -> None:
        """Take the discs of own columns."""
        scene = self._scene
        self._meet({})
        self._enter(NewDiscs(scene.position, scene.velocity, self._radii, self._brought(given_in(scene))), (0, 0))

    def close(self) -> None:
        """Stop the workers of this rank, remove its block, and free the communicator."""
        self._leave_part()
        ranks, self._ranks = self._ranks, None
        if ranks is not None:
            ranks.close()

    def _leave_part(self) -> None:
        """Stop the workers of this rank, and remove its block."""
        if self._part is not None and self._part.arrays:
            self._last_frame = self.frame
        part, self._part = self._part, None
        if part is not None:
            part.close()

    def _meet(self, snapshot: Snapshot) -> None:
        """Duplicate the communicator, and refuse ranks that were given different scenes, settings or checkpoints."""
        if self._ranks is None:
            self._ranks = Communicator(self.choice.comm)
        self._workers = max(self.choice.workers) // self._ranks.size
        self._demand_alike("scene, settings and checkpoint", _fingerprint(self._scene, self._settings, snapshot))

    def _demand_alike(self, what: str, digest: str) -> None:
        """Refuse what differs on some ranks."""
        told = self._shared().all_of(digest)
        if others := [rank for rank, each in enumerate(told) if each != told[0]]:
            raise InputError(
                f"{what} must be the same on all ranks; those of rank {others[0]} differ from those of rank 0. Make "
                "them alike, with the same seed or file, on each."
            )

    def _brought(self, given: dict[str, Any]) -> dict[str, NDArray[Any]]:
        return {**given, columns.MASS.name: self._masses}

    def _enter(self, discs: NewDiscs, progress: tuple[int, int]) -> None:
        """Deal the columns, and take the discs of own ones."""
        ranks, scene = self._shared(), self._scene
        self._grid = self._grid_of(self.count)
        if self._grid.columns < ranks.size:
            raise InputError(
                f"ranks must be at most as many as the grid has columns, {self._grid.columns} for this scene; got "
                f"{ranks.size}. Start fewer: mpiexec -n {self._grid.columns}."
            )
        column = columns_of_places(discs.position[:, 0], self._grid, scene.width, self._settings.precision)
        column[discs.of(columns.EXITS)[:, 0] != 0] = self._grid.columns  # of no rank
        own = self._take(dealt(np.bincount(column, minlength=self._grid.columns)[: self._grid.columns], ranks.size))
        if self._part is None:
            self._part = Part(scene, self._settings, self._workers, self.tallied)
        part = self._part

        def begin() -> None:
            part.fill(discs, np.flatnonzero((column >= own.first) & (column < own.last)), own, self._grid)
            self._control.done, self._control.steps = progress
            self._configure()
            part.start()

        self._on_all(begin)

    def _on_all(self, act: Callable[[], None]) -> None:
        """Act on each rank alone; what one of them raises, all raise."""
        error: Exception | None = None
        try:
            act()
        except Exception as raised:
            error = raised
        self._raise_any(self._shared().all_of(error))

    @staticmethod
    def _raise_any(errors: Iterable[Exception | None]) -> None:
        for rank, error in enumerate(errors):
            if error is not None:
                error.add_note(f"on rank {rank}")
                raise error

    def _configure(self) -> None:
        """Write what follows from what is simulated now."""
        self._held().configure(Present(self._radii, self._grid, None, self.substeps, self._speed_limit))

    def _shared(self) -> Communicator:
        assert self._ranks is not None  # between `start` and `close`
        return self._ranks

    def _held(self) -> Part:
        assert self._part is not None  # likewise
        return self._part

    @property
    def _control(self) -> Any:
        return self._held().arrays["control"]

    # --- frames

    def advance(self, frames: int, workers: int, stop: float = math.inf) -> Slice:
        """Run frames on all ranks: as many as the rank that is given the fewest."""
        part, ranks, frames = self._held(), self._shared(), self._frames_to(stop, frames)
        self._half_done = True
        with interrupts_held_back():  # it is many calls, which no rank may leave before the others
            if self.frame % BALANCE_EVERY == 0:
                self._balance(part, ranks)
            frames = min(frames, BALANCE_EVERY - self.frame % BALANCE_EVERY)
            self._begin_command(part, ranks.agree(0, 0, frames).frames)
            done = self._run(part, ranks)
        self._half_done = False
        return done

    def _begin_command(self, part: Part, frames: int) -> None:
        """Deal own columns to the workers, and write zeros where they count."""
        self._control.frames = frames
        part.deal(any(border.is_left for border in self._borders))
        team = part.arrays["team"]
        team["collisions"] = team["fastest"] = team["frame"] = 0
        for counts in (part.arrays["times"], part.arrays.get("tally")):
            if counts is not None:
                counts[:, :frames] = 0

    def _balance(self, part: Part, ranks: Communicator) -> None:
        """Deal the columns anew where one rank has far more discs than others: all know how many each column has."""
        if ranks.size == 1 or self._control.in_order == 0:
            return
        counts = np.concatenate(ranks.all_of(part.discs_in_columns()))
        if np.add.reduceat(counts, self._firsts[:-1]).max() * ranks.size < UNEVEN * counts.sum():
            return
        firsts = dealt(counts, ranks.size)
        if np.array_equal(firsts, self._firsts):
            return
        own, discs = self._take(firsts), part.discs()
        arrived = ranks.deal(discs, self._rank_of(part.columns_of(discs)), ranks.size)
        self._on_all(lambda: part.move_to(own, arrived))
        self._configure()

    def _take(self, firsts: NDArray[np.int64]) -> Range:
        """From now on each rank r has the columns from firsts[r] to before firsts[r + 1]. Returns own ones."""
        ranks = self._shared()
        own = Range(*map(int, firsts[ranks.rank : ranks.rank + 2]))
        self._firsts, self._borders = firsts, borders_of(own, ranks.rank, ranks.size, self._scene.periodic[0])
        return own

    def _rank_of(self, column: NDArray[np.int64]) -> NDArray[np.int64]:
        """The rank that has each of some columns."""
        return np.searchsorted(self._firsts, column, side="right") - 1

    def _run(self, part: Part, ranks: Communicator) -> Slice:
        """Run the command that stands in `control`."""
        started, frame = time.monotonic(), 0
        part.arrays["team"]["frame"] = 0
        part.run(layout.MOVE)
        while frame < self._control.frames:
            if ranks.rank == 0 and time.monotonic() - started > layout.SLICE * 1e-9:
                self._control.frames = frame + 1
            for step in range(self.substeps):
                self._step(part, ranks, frame, step)
            frame += 1
        done = self._slice(part, ranks, frame)
        self._control.done += frame
        return done

    @property
    def half_done(self) -> bool:
        """Whether the last command was left in the middle."""
        return self._half_done

    def _slice(self, part: Part, ranks: Communicator, frames: int) -> Slice:
        """What all ranks took and counted."""
        arrays, own = part.arrays, slice(self._workers)
        tally = arrays["tally"][own, :frames] if "tally" in arrays else None
        counts = fastest_in(part.team), int(part.team["collisions"].sum())
        told = ranks.all_of((part.failure, *counts, arrays["times"][own, :frames], tally))
        failures, fastest, collisions, times, tallies = zip(*told, strict=True)
        self._raise_any(failures)
        self._fastest = max(fastest)
        if tally is not None:
            scale = float(arrays["parameters"].tally_scale)
            tally = totals(np.concatenate(tallies), scale, 2 * self._scene.largest_radius)
        return Slice(np.concatenate(times), sum(collisions), tally)

    def _step(self, part: Part, ranks: Communicator, frame: int, step: int) -> None:
        """A step of this rank that has begun, and the beginning of the next one of this command, where there is one."""
        part.take_in(self._migrated(part, ranks, frame))
        ahead = frame if step + 1 < self.substeps else frame + 1
        if ahead == self._control.frames:
            ahead = layout.NO_FRAME
        part.run(layout.SORT)
        for turn in range(self._settings.passes):
            if turn:
                part.run(layout.EVEN)
            for phase in (layout.EVEN, layout.ODD):  # brackets of a pass need not wait for each other
                self._resolve_borders(phase, part, ranks, frame)
            part.run(layout.ODD, layout.NO_FRAME if turn + 1 < self._settings.passes else ahead)

    def _migrated(self, part: Part, ranks: Communicator, frame: int) -> NDArray[Any]:
        """Give away the discs that have left own columns; returns those that have come."""
        began = time.perf_counter_ns()
        leaving = part.emigrants()
        target, farthest = np.zeros(0, np.int64), 0
        if len(leaving):
            target = self._rank_of(part.columns_of(leaving))
            farthest = ranks.distance(target)
        trouble = LOST if part.failure is not None else 0 if part.is_finite else NOT_FINITE
        agreed = ranks.agree(trouble, farthest, int(self._control.frames))
        if agreed.trouble == LOST:
            self._raise_any(ranks.all_of(part.failure))
        if agreed.trouble:
            raise self._diverged(part, ranks)
        self._control.frames = agreed.frames
        arrived = ranks.deal(leaving, target, agreed.farthest) if agreed.farthest else leaving[:0]
        part.arrays["times"][0, frame, layout.WAIT] += time.perf_counter_ns() - began
        return arrived

    def _resolve_borders(self, phase: int, part: Part, ranks: Communicator, frame: int) -> None:
        """The brackets at borders that this pass has."""
        parity = int(phase == layout.ODD)
        borders = [each for each in self._borders if (each.column - (not each.is_left)) % 2 == parity]
        began = time.perf_counter_ns()
        given = [(border.other, int(border.is_periodic), part.column_at(border)) for border in borders]
        taken = ranks.exchange(given)
        part.arrays["times"][0, frame, layout.WAIT] += time.perf_counter_ns() - began
        for border, (_, _, own), beyond in zip(borders, given, taken, strict=True):
            part.resolve_at(phase, border, len(own), beyond)

    def _diverged(self, part: Part, ranks: Communicator) -> DivergedError:
        """The exception for a disc that is not finite, the one of the least number."""
        own = [disc_at(part.live, int(slot)) for slot in part.team["bad_slot"] if slot >= 0]
        disc, values = min(each for told in ranks.all_of(own) for each in told)
        return DivergedError(disc, self.frame + int(part.team[0].frame), values[:2], values[2:])

    def set_tallied(self, tallied: bool) -> None:
        """Have what measures need counted from now on, or not."""
        part, self._half_done = self._held(), True
        self._on_all(lambda: part.set_tallied(tallied))
        self.tallied, self._half_done = tallied, False

    @property
    def frame(self) -> int:
        """Frames finished since the start."""
        arrays = {} if self._part is None else self._part.arrays
        return int(arrays["control"].done) if arrays else self._last_frame

    # --- steps

    def speeds(self, new: NewDiscs | None = None) -> Speeds:
        """How fast the discs of all ranks are."""
        found = self._gathered()
        return self._speeds(found["velocity"], self._absorbed_in(found), new)

    @property
    def too_fast(self) -> bool:
        """Whether a disc of any rank was too fast in the last command."""
        return self._fastest.fraction > 0

    def disc_too_fast(self) -> Speeds | None:
        """The disc that was too fast in the last command, reported once; None where there was none."""
        found, self._fastest = self._fastest, Fastest()
        fast = float(self._held().arrays["parameters"].fast)
        return disc_too_fast(found, fast, self._radii, has_radii(self._scene), self.frame - 1)

    # --- discs

    def state(self) -> State:
        """Copies of the discs of all ranks, on each of them, in the order of the scene's."""
        found = self._gathered()
        absorbed = self._absorbed_in(found)
        found.pop(columns.EXITS.name, None)
        position, velocity = found.pop("position"), found.pop("velocity")
        return state_of(self._scene, self._held().arrays, position, velocity, found, absorbed)

    @property
    def absorbed(self) -> NDArray[np.bool_]:
        """Which discs have left through an absorbing edge, shape (N,)."""
        return self._absorbed_in(self._gathered()) if self._scene.absorbing else np.zeros(self.count, bool)

    def _absorbed_in(self, found: dict[str, NDArray[Any]]) -> NDArray[np.bool_]:
        exits = found.get(columns.EXITS.name)
        return np.zeros(self.count, bool) if exits is None else exits[:, 0] != 0

    def _gathered(self) -> dict[str, NDArray[Any]]:
        """What steps have changed of the discs of all ranks, in the order of the scene's: a row for each, by name."""
        ids, own = self._held().rows()
        found = {name: np.empty((self.count, *rows.shape[1:]), rows.dtype) for name, rows in own.items()}
        for order, rows in self._shared().all_of((ids, own)):
            for name, values in rows.items():
                found[name][order] = values
        return found

    def add(self, new: NewDiscs, choice: Choice) -> None:
        """Append discs, ids continuing. All discs are dealt anew: the grid may be another one."""
        radii, masses = kept_sizes(self._radii, new.radius), kept_sizes(self._masses, new.mass)
        _refuse(self._scene, self._settings, radii)
        old = self._discs_of(self.snapshot())
        given = {each.name: np.concatenate([old.of(each), new.of(each)]) for each in columns_of(self._scene)}
        position = np.concatenate([old.position, new.position])
        velocity = np.concatenate([old.velocity, new.velocity])
        self._half_done = True
        self.count, self._radii, self._masses = len(radii), radii, masses
        given[columns.MASS.name] = masses
        self._enter(NewDiscs(position, velocity, radii, given), (self.frame, int(self._control.steps)))
        self._half_done = False

    # --- snapshots

    def snapshot(self) -> Snapshot:
        """Copies of everything that the next frame depends on, of all ranks and on each of them."""
        part, found = self._held(), self._gathered()
        found |= {"radii": self._radii, "masses": self._masses}
        for column in columns_of(self._scene):
            if column.name in part.changing:
                found[column.name] = found[column.name] if column.discs_first else found[column.name].T.copy()
            elif column.kept:
                found[column.name] = column.take(part.arrays[column.name], self.count)
        found["progress"] = np.array([self._control.done, self._control.steps])
        return found

    def restore(self, snapshot: Snapshot, choice: Choice, room: int = 0) -> None:
        """Go back, or on, to a snapshot, which all ranks have."""
        self._meet(snapshot)
        _refuse(self._scene, self._settings, snapshot["radii"])
        self.choice = choice
        self._leave_part()
        progress = self._begin_from(snapshot)
        self._enter(self._discs_of(snapshot), progress)

    def _discs_of(self, snapshot: Snapshot) -> NewDiscs:
        """All discs of a snapshot."""
        given = {
            column.name: snapshot[column.name] if column.discs_first else snapshot[column.name].T
            for column in columns_of(self._scene)
            if column.name in snapshot
        }
        return NewDiscs(snapshot["position"], snapshot["velocity"], self._radii, self._brought(given))

    def demand_alike(self, what: str, given: object) -> None:
        """Refuse what differs on some ranks."""
        self._demand_alike(what, hashlib.blake2b(pickle.dumps(given)).hexdigest())

    def any_of(self, said: bool) -> bool:
        """Whether something is so on any rank."""
        return self._shared().agree(int(said), 0, 0).trouble > 0

    def once(self, act: Callable[[], Result]) -> Result:
        """What an act gives that rank 0 alone does; what it raises, all raise."""
        return self._shared().once(act)

    # --- what a report says

    @property
    def array_names(self) -> tuple[str, ...]:
        """Names of the arrays of a rank."""
        return self._held().names

    @property
    def pids(self) -> list[int]:
        """Process numbers of the workers of this rank, without itself."""
        return [] if self._part is None else self._part.pids

    def resources(self) -> tuple[tuple[int, ...], int]:
        """Resident bytes of each rank, and the size of the arrays of all."""
        own = [resident_bytes(pid) for pid in (os.getpid(), *self.pids)]
        resident, arrays = zip(*self._shared().all_of((own, self._held().nbytes)), strict=True)
        return tuple(chain.from_iterable(resident)), sum(arrays)


def _refuse(scene: Scene, settings: Settings, radii: NDArray[np.float64]) -> None:
    """Refuse, by name, what ranks cannot do; radii: of all discs.

    Raises:
        InputError: naming it.
    """
    reasons = {
        "discs far larger than all but a few": has_radii(scene) and giant_radius(radii) is not None,
        "unguarded=True": settings.unguarded,
        "on_worker_death='restart'": settings.on_worker_death != "raise",
    }
    if found := [name for name, there in reasons.items() if there]:
        raise InputError(
            f"method='mpi' cannot do everything that others can; here are {', '.join(found)}. "
            "Leave them out, or use method='parallel' on one machine."
        )


def _fingerprint(scene: Scene, settings: Settings, snapshot: Snapshot) -> str:
    """Of what all ranks must have been given alike; without a snapshot they start."""
    return _digest_of(snapshot, f"{scene.digest()} {settings} {source_digest()}")


def _digest_of(arrays: Mapping[str, Any], text: str = "") -> str:
    """Hex digest over a text and arrays, by name; what is no array is left out."""
    digest = hashlib.blake2b(text.encode())
    for name, values in sorted(arrays.items()):
        if isinstance(values, np.ndarray):
            digest.update(name.encode())
            digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()
