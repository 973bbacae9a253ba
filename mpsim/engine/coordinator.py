"""The coordinator: owns the solver, runs slices of frames, and recovers from the death of a worker."""

from __future__ import annotations

import math
import signal
import statistics
import time
from collections import deque
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mpsim.core.deferred_signals import Noted, interrupts_held_back
from mpsim.core.state import Discs, StateInChunks
from mpsim.engine.access import Access, Closing, Notices, Once, warn
from mpsim.engine.changes import REMOVE, Change, edited, with_wall
from mpsim.engine.checkpoint import Checkpointer
from mpsim.engine.emission import Emission, Insert, Progress
from mpsim.engine.journal import Changed, parameters_after
from mpsim.engine.observers import Observers
from mpsim.engine.parameters import in_force
from mpsim.engine.report import Report, phase_seconds
from mpsim.engine.snapshot import Snapshot
from mpsim.engine.solvers import base, methods
from mpsim.engine.solvers.base import Choice, NewDiscs, Origin, Processes, Slice, Solver, SolverState, Terms, count_in
from mpsim.engine.step_limits import StepLimits, check_precision
from mpsim.engine.workers.shared import MOST_FRAMES, refusals_named
from mpsim.errors import (
    BusyError,
    ClosedError,
    GuardWarning,
    TooFastError,
    WorkerDiedError,
    WorkerStalledError,
)
from mpsim.kernels.compiling import compile_seconds
from mpsim.kernels.records import PHASES
from mpsim.measure.registry import Run, RunAverages
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings

if TYPE_CHECKING:
    from mpsim.engine.simulation import Simulation

# --- Times and counts that a run has collected so far


class Mark(NamedTuple):
    """How far a run had come: frames and collisions, slices of times, what had been gathered for measures, logged."""

    done: int
    collisions: int
    slices: int
    gathered: Any
    logged: tuple[NDArray[Any], ...]


class RunRecord:
    """Times, collisions and counts of the frames of a run so far.

    Attributes:
        averages: averages for its measures.
        whole: whether it began between two frames, not inside one.
        guarded: losses that the solver's guard had suppressed before.
        done: frames.
        collisions: contacts resolved.
        logged: tables of collisions that nobody has taken yet.
    """

    def __init__(self, workers: int, averages: RunAverages, whole: bool, guarded: int, logged: list[NDArray[Any]]):
        self.averages = averages
        self.whole: bool = whole
        self.guarded: int = guarded
        self.done: int = 0
        self.collisions: int = 0
        self.logged: list[NDArray[Any]] = logged
        self._times = [np.zeros((workers, 0, len(PHASES)), np.int64)]

    def take(self, part: Slice) -> None:
        """Add what one command of the solver took and counted."""
        size = part.times.shape[1]
        self.done += size
        self._times.append(part.times)
        self.collisions += part.contacts
        if size:
            self.averages.take(part.tally, self.done)

    def mark(self) -> Mark:
        """How far the run has come, for `rewind`."""
        return Mark(self.done, self.collisions, len(self._times), self.averages.mark(), tuple(self.logged))

    def rewind(self, mark: Mark) -> None:
        """Forget what came after a mark."""
        self.done, self.collisions = mark.done, mark.collisions
        del self._times[mark.slices :]
        self.averages.rewind(mark.gathered)
        self.logged[:] = mark.logged

    def take_logged(self, frame: int) -> NDArray[Any]:
        """The collisions up to the end of a frame that nobody has taken yet, in order: TABLE. Later ones stay."""
        table = base.joined(self.logged)
        late = table["frame"] > frame
        self.logged[:] = [table[late]]
        return base.in_order(table[~late])

    @property
    def times(self) -> NDArray[np.int64]:
        """Times of all frames, (workers, frames, phases); growth under `auto` may have raised the number of workers."""
        workers = max(part.shape[0] for part in self._times)
        times = np.zeros((workers, sum(part.shape[1] for part in self._times), len(PHASES)), np.int64)
        end = 0
        for part in self._times:
            begin, end = end, end + part.shape[1]
            times[: len(part), begin:end] = part
        return times


# --- Recovery after the death of a worker: back to the last snapshot in memory, then on with new workers

SNAPSHOT_FRACTION = 0.01
"""Fraction of the running time that in-memory snapshots may take: the next one waits until the last one's time is so
small a fraction of what has passed since."""

SNAPSHOT_SECONDS = 0.2
"""Time between two snapshots, at least."""

MOST_DEATHS = 5
"""Deaths of workers without a snapshot in between after which there is no use in trying again."""


def log_death(death: WorkerDiedError, what_now: str, notices: Notices) -> None:
    """Log a death from which the run recovers."""
    notices.log(
        "mpsim: worker %d (process %s) ended with exit code %s in frame %d, phase '%s'; %s, on new workers.",
        death.worker,
        death.pid,
        death.exitcode,
        death.frame,
        death.phase,
        what_now,
    )


def retried_on_new_workers(act: Callable[[], None], renew: Callable[[], None] | None, notices: Notices) -> None:
    """Act; if a worker dies, act again on new ones.

    Args:
        act: changes nothing if a worker dies.
        renew: starts new workers; None: a death is not to be healed.
        notices: which take a line for each death.

    Raises:
        WorkerDiedError: if that does not help.
    """
    died = False
    for chances in range(MOST_DEATHS, -1, -1):
        try:
            if died and renew is not None:
                renew()
            act()
            return
        except WorkerDiedError as death:
            if renew is None or not chances:
                raise
            log_death(death, "trying again", notices)
            died = True


class RecoveryPoint(NamedTuple):
    """A snapshot, where the record of the run stood, and how many changes there had been."""

    snapshot: Any
    mark: Mark
    changes: int


class RecoverySnapshots:
    """Snapshots of a run, and the return to the last one when a worker has died.

    Args:
        take: copies everything that the next frame depends on.
        restore: goes back to such a copy, on new workers.
        record: of the run, which is rewound too.
        notices: which take a line for each death.
        changes: how often discs or parameters have been changed from outside: a snapshot from before is of no use.
    """

    def __init__(
        self,
        take: Callable[[], Any],
        restore: Callable[[Any], None],
        record: RunRecord,
        notices: Notices,
        changes: Callable[[], int] = lambda: 0,
    ):
        self._changes = changes
        self._take = take
        self._restore = restore
        self._record = record
        self._notices = notices
        self._kept: RecoveryPoint | None = None
        self._due = 0.0
        self._deaths = 0

    def take(self) -> None:
        """Take a snapshot if it is time for one and there is anything new to keep."""
        started = time.perf_counter()
        is_new = self._kept is None or self._record.done > self._kept.mark.done
        is_changed = self._kept is not None and self._kept.changes != self._changes()
        if is_changed or (is_new and started >= self._due):
            self._kept = RecoveryPoint(self._take(), self._record.mark(), self._changes())
            now = time.perf_counter()
            self._due = now + max(SNAPSHOT_SECONDS, (now - started) / SNAPSHOT_FRACTION)
            self._deaths = 0

    def go_back(self, death: WorkerDiedError) -> None:
        """Restore the last snapshot.

        Raises:
            WorkerDiedError: the death itself, if workers die faster than snapshots can be taken.
        """
        while True:
            self._deaths += 1
            if self._kept is None or self._deaths > MOST_DEATHS:
                raise death
            snapshot, mark, _ = self._kept
            frames = self._record.done - mark.done
            log_death(death, f"going back {frames} frames and more" if frames else "trying again", self._notices)
            self._record.rewind(mark)
            try:
                self._restore(snapshot)
                return
            except WorkerDiedError as another:  # a new worker, before it was ready
                death = another


# --- Number of frames of the next command, and number of workers that run it

MOST_SECONDS = 0.05
"""Length of a slice of frames: how long Ctrl-C, progress, or the report of a dead worker may have to wait."""

TRIAL_SECONDS = 0.005
"""Length of a slice that measures how fast a number of workers is."""

TRIALS = 7
"""Slices that decide: their median leaves out the first ones, in which caches are cold and workers asleep."""

FEW_TRIALS, HOPELESS = 3, 1.3
"""Slices after which a number of workers is given up if all of them were so many times slower than another number: so
that a run that is not long does not consist of trials."""

TRIAL_AFTER = 1.0
"""Seconds of running after which `auto` tries the slower number of workers again: machine and scene may change."""


class BatchSizer:
    """Chooses the next slice of a run from the frame times of those before.

    Args:
        choices: numbers of workers to choose from, the likely best first. All give the same bits, so the choice may
            follow the clock.
        most_frames: frames of a slice at most.
    """

    def __init__(self, choices: tuple[int, ...], most_frames: int):
        self._most_frames = most_frames
        self._recent = {workers: deque(maxlen=TRIALS) for workers in choices}
        self._seconds_run = 0.0

    @property
    def best(self) -> int:
        """The number of workers with the shortest recent frame time."""
        return min(self._recent, key=self._seconds)

    def next_slice(self, remaining: int) -> tuple[int, int]:
        """Workers and frames of the next slice."""
        if len(self._recent) > 1 and self._seconds_run > TRIAL_AFTER:
            self._seconds_run = 0.0
            self._recent[max(self._recent, key=self._seconds)].clear()
        for workers, recent in self._recent.items():
            if len(self._recent) > 1 and len(recent) < TRIALS and not self._is_hopeless(workers):
                return workers, self._fit(TRIAL_SECONDS, self._seconds(workers), remaining)
        return self.best, self._fit(MOST_SECONDS, self._seconds(self.best), remaining)

    def _is_hopeless(self, workers: int) -> bool:
        """Whether so many workers need not be tried further."""
        recent, others = self._recent[workers], (self._seconds(other) for other in self._recent if other != workers)
        return len(recent) >= FEW_TRIALS and min(recent) > HOPELESS * min(others)

    def note(self, workers: int, frames: int, seconds_per_frame: float) -> None:
        """Note the time of a frame in the last slice: its median, which one late worker does not disturb [s]."""
        self._seconds_run += frames * seconds_per_frame
        self._recent[workers].append(max(seconds_per_frame, 1e-9))

    def _seconds(self, workers: int) -> float:
        """Median frame time of the last slices on so many workers; infinite before the first."""
        return statistics.median(self._recent[workers]) if self._recent[workers] else math.inf

    def _fit(self, seconds: float, seconds_per_frame: float, remaining: int) -> int:
        """Number of frames that take so many seconds; one where nothing is known yet."""
        frames = 1 if math.isinf(seconds_per_frame) else int(seconds / seconds_per_frame)
        return max(min(frames, remaining, self._most_frames), 1)


# --- The coordinator: owns the solver, and does what happens between two commands to it
#
# Emitters add discs, speeds are checked, the length of the next command is chosen, and if a worker has died the run
# goes back to a snapshot. Who may call is settled before (`access.py`); who calls holds `access.state_lock`.

MANY_GUARDED = 1_000_000
"""So many collisions of a run in which the guard acts, up to a second of work, and it is said before the run ends."""


class Coordinator:
    """The solver of a simulation, and what acts on it between two commands.

    Args:
        simulation: which it belongs to; when that is collected, the solver is closed.
        scene, settings: of the simulation.
        access: to it.
        processes: how it uses processes.

    Attributes:
        scene, settings: in force.
        solver: what runs the frames; another one after `auto` has changed the method.
        last_frame, last_time: frames done when it was closed, and the time then [time].
        start_of_all: scene and settings at the start.
        journal: the changes so far, in order.
        record: of the run that is in progress, or of the last one.
        emission: what the emitters have done.
        step_limits: whether steps are short enough for the speeds.
    """

    def __init__(self, simulation: object, scene: Scene, settings: Settings, access: Access, processes: Processes):
        self.scene: Scene = scene
        self.settings: Settings = settings
        self._access = access
        self._processes = processes
        self.last_frame: int = 0
        self.last_time: float = 0.0
        self.start_of_all: tuple[Scene, Settings] = (scene, settings)
        self.journal: list[Change] = []
        self.record: RunRecord | None = None
        self._compiled_before = compile_seconds()
        self.emission: Emission = Emission(scene, settings, access.notices)
        choice = methods.choose(scene.count, settings, processes)
        solver = methods.METHODS[choice.method].solver
        self.step_limits: StepLimits = StepLimits(scene, settings, solver.capabilities.has_steps)
        self._batch_sizer = BatchSizer(choice.workers, MOST_FRAMES)
        self._rest, self._guard = Once(), Once()
        self._logged: list[Any] = []  # collisions of a frame in hand: an interrupted run leaves them to the next one
        self.solver: Solver = solver(scene, settings, choice)
        self._closing = Closing(simulation, self.solver, access)  # before there is anything to close

    def start(self) -> None:
        """Start the solver; if that fails, close it."""
        self._begin(self.step_limits.at_start(), self.solver.start)

    def resume(self, snapshot: SolverState, emission: Progress, changed: Changed) -> None:
        """Start the solver from a checkpoint; if that fails, close it."""
        if changed.changes:
            scene, settings = parameters_after(self.scene, self.settings, changed.changes)
            self.emission = self.emission.under(scene, settings, 0, 0.0)
            self.step_limits = self.step_limits.under(scene, settings, changed.origin)
            self.scene, self.settings, self.journal = scene, settings, list(changed.changes)
        terms = Terms(self.scene, self.settings, changed.origin)
        self._begin(self.step_limits.at_resume(), lambda: self.restore((snapshot, emission), terms))

    def _begin(self, warned_of: Iterable[tuple[str, type[Warning]]], start: Callable[[], None]) -> None:
        try:
            with self.solver.together():
                for text, kind in warned_of:
                    warn(text, kind)
            methods.note_remark(self.solver.choice, None, self._access.notices)
            self._access.notices.give()
            with self._access.state_lock, refusals_named():  # the end of the program waits until it can be closed
                start()
                self.step_limits.set_limit(self.solver)
        except BaseException:
            with interrupts_held_back():
                self._closing()
            raise

    @property
    def alive(self) -> bool:
        """Whether the solver is still to be closed."""
        return self._closing.alive

    def end(self) -> None:
        """Close the simulation, also from within another call of this thread; Ctrl-C waits."""
        with interrupts_held_back(), self._access.moving():
            if self.alive:
                self.last_frame, self.last_time = self.solver.frame, self.solver.time_of(self.solver.frame)
                self._closing()

    def open_solver(self) -> Solver:
        """The solver.

        Raises:
            ClosedError, ForkedError: if there is none any more, or none in this process.
        """
        self._access.demand_own_process()
        if not self.alive:
            self._access.stop_if_ending()
            raise ClosedError(
                f"this simulation was closed after frame {self.last_frame}. A closed simulation has no state. "
                "Use it inside its `with` block, take sim.state before, or make a new one."
            )
        return self.solver

    @property
    def changed(self) -> Changed:
        """What has been changed since the start, for a checkpoint."""
        return Changed(tuple(self.journal), self.solver.origin)

    # --- runs

    def begin_record(self, names: tuple[str, ...], frames: int, logged: bool = False, skipped: int = 0) -> RunRecord:
        """Begin the record of a run of so many frames, with averages for measures of these names.

        logged: whether collisions are logged. skipped: frames at the beginning that the averages leave out.
        """
        solver = self.solver
        whole, guarded = solver.time == solver.time_of(solver.frame), solver.guarded
        averages = RunAverages(names, frames, self.scene, self._of_discs, whole, skipped)
        self.between_frames(lambda: self.solver.log_collisions(logged))
        self.solver.tallied = averages.counting
        if not logged:
            self._logged.clear()
        self.record = RunRecord(max(solver.choice.workers), averages, whole, guarded, self._logged)
        return self.record

    def _of_discs(self, function: Callable[[Discs], Any]) -> Any:
        """What a function of the present state gives, in all processes that share the simulation.

        On ranks, where no process has it all, it is read in chunks.
        """
        solver = self.solver
        if solver.capabilities.on_ranks:
            return solver.once(lambda: function(StateInChunks(solver.state_between, solver.count)))
        return function(solver.state())

    def recovery(self, record: RunRecord) -> RecoverySnapshots | None:
        """Snapshots for a run to go back to if a worker dies; None where the error is raised."""
        if self._processes.on_worker_death != "restart":
            return None
        changes = lambda: len(self.journal)  # noqa: E731
        return RecoverySnapshots(self.snapshot, self.restore, record, self._access.notices, changes)

    def report(self, record: RunRecord, observing_seconds: float) -> Report:
        """The report of a run that is over."""
        solver = self.open_solver()
        resources = solver.resources()
        ran = methods.what_ran(solver.choice, self._batch_sizer.best, self.settings)
        gathered = record.averages.measures(Run(self.scene, solver.count, self.settings.dt))
        guarded = solver.guarded - record.guarded
        if guarded:
            self._access.notices.warn(
                f"in {guarded} collisions the contact-time guard suppressed the loss of energy, because the previous "
                "collision of a disc was less than the contact time ago, as in inelastic collapse or for a disc at "
                "rest. Without the guard the run would never end. This is said once; report.guarded counts.",
                GuardWarning,
                self._guard,
            )
        compiled, self._compiled_before = compile_seconds() - self._compiled_before, compile_seconds()
        counts = (*phase_seconds(record.times), record.collisions, *ran, *resources)
        return Report(*counts, gathered, guarded, observing_seconds, compiled, solver.contact_time)

    def advance(self, most: int, record: RunRecord, recovery: RecoverySnapshots | None) -> None:
        """Run one slice of frames: emitters add discs, the solver runs a command; if a worker dies, go back."""
        self._adapt()
        try:
            self._emit(self.emission.before_frame)
            solver = self.solver
            if recovery is not None and solver.pids:
                recovery.take()
            ahead = min(
                record.averages.frames_to_sample(record.done),
                self.emission.frames_ahead(solver.frame),
                self.step_limits.frames_ahead(solver.frame, solver.count),
            )
            workers, size = self._batch_sizer.next_slice(int(min(most, ahead)))
            part = solver.advance(size, workers, self.emission.next_time)
        except WorkerDiedError as death:
            try:
                if recovery is None or not self.alive:
                    raise
                with interrupts_held_back():
                    recovery.go_back(death)
            except Exception:
                self.end()
                raise
            return
        except BaseException as error:
            refused = isinstance(error, (BusyError, TooFastError))  # which change nothing
            if self.solver.half_done or (isinstance(error, Exception) and not refused):
                self.end()
            raise
        if part.times.shape[1]:
            self._batch_sizer.note(workers, part.times.shape[1], float(np.median(part.times[0].sum(axis=1))) * 1e-9)
        record.take(part)
        self._take_collisions()
        self.last_frame, self.last_time = solver.frame, solver.time_of(solver.frame)
        self._warn_of_rest(solver.guarded - record.guarded)
        if solver.too_fast:  # look now: the run may end here, or be saved
            self._adapt()
        self.step_limits.look_for_pressed(solver, self._access.notices)
        self._emit(self.emission.in_time)

    def _take_collisions(self) -> None:
        """Take over what the solver has logged, before it moves to another block."""
        if self.solver.logging:
            with interrupts_held_back():
                self._logged.append(self.solver.take_collisions())

    def _warn_of_rest(self, guarded: int) -> None:
        """Warn once, while it runs, if the guard has acted so often in a run that discs must be at rest."""
        if guarded < MANY_GUARDED:
            return
        self._access.notices.warn(
            "discs seem to have come to rest: method='event' simulates each of their tiny bounces, "
            f"{guarded} so far, so its frames take long. Give a contact_time longer than "
            f"{self.solver.contact_time:.3g} (the result is then a model, not exact), use contact='impact' with "
            "another method, or end the run earlier.",
            GuardWarning,
            self._rest,
        )

    def _emit(self, enter: Callable[[Solver, Insert], None]) -> None:
        """Have the emitters add what is due."""
        before = self.solver.count
        try:
            enter(self.solver, lambda new: self.insert(new, self.look(new)))
        except Exception:  # of a signal handler, say
            if self.solver.count != before:  # the discs are there, and the emitters' books do not know of them
                self.end()
            raise

    def _adapt(self) -> None:
        """Check the speeds if it is time to, and divide the following frames into as many steps as they need."""
        solver = self.solver
        if solver.too_fast or self.step_limits.is_due(solver.frame, solver.count):
            with interrupts_held_back(), self._access.moving():
                solver.divide(self.step_limits.check(solver, self._access.notices))

    def look(self, new: NewDiscs | None = None, changed: NDArray[np.int64] | None = None) -> int:
        """Check the speeds of all discs and new ones; warn or refuse as is set. Returns the sub-steps from now on.

        changed: numbers of the discs that alone can have become faster.
        """
        solver, notices = self.solver, self._access.notices
        with interrupts_held_back(), self._access.moving():
            return self.step_limits.check(solver, notices, new, changed)

    def snapshot(self) -> tuple[Any, Any]:
        """Copies of everything that the next frame depends on: of the solver, and of the emitters."""
        return self.solver.snapshot(), self.emission.progress

    def restore(self, kept: tuple[Any, Any], terms: Terms | None = None) -> None:
        """Go back, or on, to such a snapshot, on new workers; see `Solver.restore`."""
        snapshot, progress = kept
        before, choice = self.solver.choice, methods.choose(count_in(snapshot), self.settings, self._processes)
        with interrupts_held_back(), self._access.moving():
            self._enter(choice, snapshot, terms or self.solver.terms)
            methods.note_remark(choice, before, self._access.notices)
            self.emission.progress = progress
            self._batch_sizer = BatchSizer(choice.workers, MOST_FRAMES)

    def moment(self) -> Snapshot:
        """A snapshot of this moment, for `go_back` and for other simulations."""
        solver, (arrays, emission) = self.solver, self.snapshot()
        changes = tuple(self.journal)
        return Snapshot(solver.frame, solver.time, self.start_of_all, changes, solver.terms, arrays, emission)

    def go_back(self, to: Snapshot) -> None:
        """Continue from a snapshot of this simulation, under the scene and settings then in force."""
        scene, settings, origin = to.terms
        before, choice = self.solver.choice, methods.choose(to.count, settings, self._processes)
        emission = self.emission.under(scene, settings, to.frame, to.time)
        emission.progress = to.emission
        limits = self.step_limits.under(scene, settings, origin)

        def act() -> None:
            self._enter(choice, to.arrays, to.terms, new_workers=False)
            limits.set_limit(self.solver)

        with interrupts_held_back():
            self.between_frames(act)
            self.scene, self.settings, self.journal = scene, settings, list(to.changes)
            self.emission, self.step_limits = emission, limits
            self.last_frame, self.last_time = to.frame, self.solver.time_of(to.frame)
            self._logged.clear()
            if choice != before:
                self._batch_sizer = BatchSizer(choice.workers, MOST_FRAMES)
        methods.note_remark(choice, before, self._access.notices)

    def _enter(self, choice: Choice, snapshot: SolverState, terms: Terms, new_workers: bool = True) -> None:
        """Have the solver, or another one that `choice` asks for, continue from a snapshot."""
        if methods.same_solver(self.solver.choice, choice):
            self.solver.restore(snapshot, choice, terms=terms, new_workers=new_workers)
        else:
            self._replace_solver(choice, snapshot, terms)

    def _replace_solver(self, choice: Choice, snapshot: SolverState, terms: Terms, room: int = 0) -> None:
        """Replace the solver by one of another method, chosen by `auto`."""
        old, new = self.solver, methods.METHODS[choice.method].solver(terms.scene, terms.settings, choice)
        new.tallied, new.logging = old.tallied, old.logging
        self._closing.solvers.append(new)  # before there is anything to close
        try:
            new.restore(snapshot, choice, room, terms)
            self.step_limits.set_limit(new)
        except BaseException:
            self._closing.solvers.remove(new)
            new.close()
            raise
        self.solver = new
        self._closing.solvers.remove(old)
        old.close()

    def between_frames(self, action: Callable[[], None]) -> None:
        """Do what may move the discs to another block; on new workers if one has died. Signals wait for its end."""
        self._take_collisions()
        renew = (lambda: self.restore(self.snapshot())) if self._processes.on_worker_death == "restart" else None
        with interrupts_held_back(), self._access.moving():
            try:
                retried_on_new_workers(action, renew, self._access.notices)
            except BaseException as error:
                left_halfway = isinstance(error, BusyError | WorkerDiedError | WorkerStalledError)
                if self.solver.half_done or left_halfway:
                    self.end()
                raise

    def insert(self, new: NewDiscs, substeps: int) -> None:
        """Add discs that have been checked; the solver may then continue by another method."""
        count = self.solver.count + len(new.position)
        before, choice = self.solver.choice, methods.choose(count, self.settings, self._processes)

        def grow() -> None:
            if not methods.same_solver(self.solver.choice, choice):
                self._replace_solver(choice, self.solver.snapshot(), self.solver.terms, count)
            self.solver.add(new, choice)
            if substeps != self.solver.substeps:
                self.solver.divide(substeps)

        self.between_frames(grow)
        methods.note_remark(choice, before, self._access.notices)
        if choice != before:
            self._batch_sizer = BatchSizer(choice.workers, MOST_FRAMES)

    # --- changes between two frames

    def change(self, change: Change) -> None:
        """Make a change of discs that has been checked, and note it in the journal."""
        numbers = change.values["ids"]
        before = self.solver.discs(numbers)
        after = edited(before, change)

        def act() -> None:
            if change.what == REMOVE and not self.scene.loses_discs:
                self._adopt(self.scene.replace(has_gaps=True), self.settings, self.solver.origin)
            self.solver.replace(after, numbers)

        with interrupts_held_back():
            self.between_frames(act)
            self._note(change)
        if change.what != REMOVE:  # which makes no disc faster
            self._look_or_undo(lambda: self.solver.replace(before, numbers), numbers)

    def add(self, change: Change, new: NewDiscs, substeps: int) -> None:
        """Add discs that have been checked, from outside, and note it in the journal."""
        with interrupts_held_back():
            self.insert(new, substeps)
            self._note(change)

    def _look_or_undo(self, undo: Callable[[], None], numbers: NDArray[np.int64]) -> None:
        """Check the speeds after the last change of the journal, of these discs; where they are refused, undo it."""
        try:
            substeps = self.look(changed=numbers)
            self._access.notices.give()  # where a filter makes an error of a warning, nothing is changed
            if substeps != self.solver.substeps:
                self.between_frames(lambda: self.solver.divide(substeps))
        except Exception:
            with interrupts_held_back():
                self.between_frames(undo)
                self.journal.pop()
            raise

    def change_parameters(self, change: Change) -> None:
        """Change parameters of scene or settings, and note it in the journal."""
        origin = Origin(change.frame, change.time) if "dt" in change.values else self.solver.origin
        self._take_over(change, *in_force(self.scene, self.settings, change.values, change.time), origin)

    def add_wall(self, change: Change) -> None:
        """Add a wall that has been checked, and note it in the journal."""
        self._take_over(change, with_wall(self.scene, change.values), self.settings, self.solver.origin)

    def _take_over(self, change: Change, scene: Scene, settings: Settings, origin: Origin) -> None:
        """Continue under the scene and settings that a change has made, and note it in the journal."""
        solver, notices = self.solver, self._access.notices
        check_precision(scene, settings)
        emission = self.emission.under(scene, settings, solver.frame, solver.time)
        limits = self.step_limits.under(scene, settings, origin)
        try:
            with interrupts_held_back(), self._access.moving():
                substeps = limits.check(solver, notices)
            notices.give()  # where a filter makes an error of a warning, nothing is changed
        except Exception:
            self.step_limits.set_limit(solver)
            raise

        def act() -> None:
            self._adopt(scene, settings, origin)
            limits.set_limit(self.solver)
            self.solver.divide(substeps)

        with interrupts_held_back():
            before = self.solver.choice
            self.between_frames(act)
            self.emission, self.step_limits = emission, limits
            if self.solver.choice != before:
                self._batch_sizer = BatchSizer(self.solver.choice.workers, MOST_FRAMES)
            self._note(change)

    def _note(self, change: Change) -> None:
        """Note a change that has been made."""
        self.journal.append(change)
        if self.record is not None:
            self.record.averages.interrupted(self.scene, self.solver.count)

    def _adopt(self, scene: Scene, settings: Settings, origin: Origin) -> None:
        """Take another scene and settings for those in force."""
        choice = methods.choose(self.solver.count, settings, self._processes)
        self.solver.adopt(Terms(scene, settings, origin), choice)
        self.scene, self.settings = scene, settings


# --- Ctrl-C in a run on MPI ranks: all ranks stop after the same slice of frames


class Interruption:
    """Notes Ctrl-C, and raises it where all processes look. Use it in a `with` block.

    Else it would come to each of them somewhere else, and the others would wait there for ever. In a run of one process
    it comes as it always does.

    Args:
        solver: that runs the frames.
    """

    def __init__(self, solver: Solver):
        self._solver = solver
        self._noted = Noted(signal.SIGINT)

    def __enter__(self) -> Interruption:
        if self._is_shared:
            self._noted.begin()
        return self

    def __exit__(self, kind: type[BaseException] | None, *exception: object) -> None:
        self._noted.end()
        if kind is None:
            self.look()  # it may have come after the last slice
        elif self._noted.came and kind is not KeyboardInterrupt:  # the run has ended otherwise
            self._noted.send_again()

    def look(self) -> None:
        """Raise KeyboardInterrupt in all processes if Ctrl-C has come to one. All of them look."""
        if self._is_shared and self._solver.any_of(self._noted.came):
            raise KeyboardInterrupt

    @property
    def _is_shared(self) -> bool:
        return self._solver.capabilities.on_ranks


# --- The run loop: slices of frames, with observers, checkpoints, progress and readers between them


class BetweenSlices(NamedTuple):
    """What happens between two slices of a run.

    Attributes:
        sim: at which observers look.
        observers, checkpoints: those of the run.
        progress: called as progress(done, of_frames); None: nobody asks.
        interruption: Ctrl-C, where processes share the run.
    """

    sim: Simulation
    observers: Observers
    checkpoints: Checkpointer
    progress: Callable[[int, int], None] | None
    interruption: Interruption


def run_frames(
    frames: int, coordinator: Coordinator, access: Access, record: RunRecord, between: BetweenSlices
) -> None:
    """Run so many frames, and record them; if a worker dies, go back to a snapshot if the settings say so."""
    sim, observers, checkpoints, progress, interruption = between
    recovery = coordinator.recovery(record)
    with access.callbacks():
        observers.begin(sim)
        if record.whole:
            observers.observe(sim, 0)
        if not frames:
            checkpoints.look(0, last=True)
    while record.done < frames:
        ahead = min(frames - record.done, checkpoints.frames_ahead(record.done))
        access.let_readers_in()
        with access.state_lock:
            access.waiting = False
            before = coordinator.open_solver().frame  # which says so if an observer has closed it
            coordinator.advance(min(ahead, observers.frames_ahead(before)), record, recovery)
            done = coordinator.solver.frame > before
        with access.callbacks():
            access.notices.give()
            if done and observers.want_collisions:
                frame = coordinator.solver.frame
                observers.take_collisions(record.take_logged(frame), frame)
            if done:
                observers.observe(sim, record.collisions)
            checkpoints.look(record.done, last=record.done == frames)
            if progress is not None:
                progress(record.done, frames)
            interruption.look()
