"""`Simulation`, the public class: its life, its frames, and what changes it in between.

It owns the solver, and acts between two commands to it: emitters add discs, speeds are checked, the length of the next
command is chosen, and if a worker has died the run goes back to a snapshot. Who may call what is settled at the doors
(`access.py`); what moves discs holds `access.state_lock`.
"""

# pyright: reportPrivateUsage=false, reportUnnecessaryIsInstance=false
# Names of Scene with an underscore are for all of mpsim. Arguments are checked for callers without a type checker, too.

from __future__ import annotations

import contextlib
import dataclasses
import functools
import itertools
import math
import os
import threading
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple, NoReturn, TypeVar, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mpsim.core import checks
from mpsim.core.checks import Closable, ReadOnly
from mpsim.core.columns import GivenColumns
from mpsim.core.deferred_signals import interrupts_held_back
from mpsim.core.late import named
from mpsim.core.progress import checked_progress, of_frames
from mpsim.core.state import State
from mpsim.engine import changes, checkpoint
from mpsim.engine.access import Access, Closing, Notices, Once, exclusive, reading
from mpsim.engine.changes import REMOVE, Change, Parameters, edited, terms_after
from mpsim.engine.checkpoint import Snapshot, checked_place
from mpsim.engine.emission import Emission
from mpsim.engine.journal import Journal, replayed
from mpsim.engine.observers import Observer, Observers
from mpsim.engine.report import Measures, Report
from mpsim.engine.run import (
    BatchSizer,
    Beside,
    RecoverySnapshots,
    RunRecord,
    frames_skipped,
    frames_wanted,
    retried_on_new_workers,
)
from mpsim.engine.solvers import methods
from mpsim.engine.solvers.base import (
    MOST_FRAMES_OF_A_RUN,
    NOTHING_DONE,
    BatchResult,
    Choice,
    CollisionLog,
    InPlace,
    NewDiscs,
    OnWorkerDeath,
    Processes,
    Solver,
    StartMethod,
    Steps,
    Terms,
    digest_of_state,
    is_between_frames,
    log_collisions,
    over_all_discs,
    resources_of,
    set_substeps,
)
from mpsim.engine.solvers.methods import capabilities_of, check_processes, on_ranks, settings_to_go_on
from mpsim.engine.step_limits import StepLimits, check_precision
from mpsim.engine.workers.shared import MOST_FRAMES, refusals_named
from mpsim.errors import (
    BusyError,
    ClosedError,
    GuardWarning,
    InputError,
    TooFastError,
    WorkerDiedError,
    WorkerStalledError,
)
from mpsim.features.capsules import of_discs
from mpsim.features.motions import Movement
from mpsim.features.obstacles import Obstacle
from mpsim.kernels.compiling import compile_seconds
from mpsim.scene.scene import Scene, settings_for
from mpsim.scene.settings import Settings
from mpsim.scene.starts import check_region, is_in

MEMORY_SECONDS = 0.1
"""Time of frames between two readings of the memory of processes, at least: each opens files of the system."""

MEASURES = "mpsim.measure.registry"  # the module that a run with measures needs, and no other

Result = TypeVar("Result")


class Memory(NamedTuple):
    """Resident memory of each process and size of the block [bytes], of these workers, for so long a run [s]."""

    until: float
    pids: list[int]
    resources: tuple[tuple[int, ...], int]


class Simulation(ReadOnly, Closable):
    """A scene being simulated. Use it in a `with` block: leaving it stops the workers and frees the shared memory.

    Args:
        scene: what is simulated, in its own units of [length], [time] and [mass].
        settings: how it is simulated; None: those that the scene recommends, or the defaults.
        comm: with method="mpi", a communicator of mpi4py whose ranks all make the same calls; None: all ranks.
        start_method: how worker processes start: "forkserver" (the default where it exists: safe with threads, and fast
            after the first start), "fork" (fastest, but unsafe in a program with threads) or "spawn".
        on_worker_death: "raise" WorkerDiedError, or "restart": continue from the last snapshot in memory with new
            workers and the same bits. Snapshots take 1 % of the time or less.
        unguarded: True processes neighbouring columns at the same time, which is a race condition and *wrong*: each run
            of `parallel` then differs. It demonstrates the purpose of the even and odd passes; never use it for
            results.

    Raises:
        InputError: if the numbers of the scene do not fit the precision of the run.
        TooFastError: with on_fast="error", or "substep" if too many were needed; also during a run, which can go on.
        ResourceError, WorkerDiedError: if the block (SharedMemoryError) or the workers cannot be created.
        BusyError, ForkedError: at any use while another thread changes it, or in a fork of the process that made it.

    Warns:
        OverlapWarning: if discs overlap at the start.
        FastWarning: if discs move so far in a step that they may pass through each other (also during a run, once).
        ResolutionWarning: if the precision of the run is too coarse for the scene.

    >>> scene = Scene.random(count=50, packing=0.2, radius=0.5, seed=1)
    >>> with Simulation(scene, Settings(dt=0.01, method="grid")) as sim:
    ...     report = sim.run(frames=100)
    ...     sim.frame, round(sim.time, 9), report.frames, report.method
    (100, 1.0, 100, 'grid')
    """

    _instead = "Use sim.change(...) for parameters and settings, and sim.set(...) for discs"

    def __init__(
        self,
        scene: Scene,
        settings: Settings | None = None,
        *,
        comm: object = None,
        start_method: StartMethod | None = None,
        on_worker_death: OnWorkerDeath = "raise",
        unguarded: bool = False,
    ):
        chosen = scene.settings if settings is None and isinstance(scene, Scene) else settings
        with _collective(chosen, comm):
            self._set_up(scene, settings, Processes(comm, start_method, on_worker_death, unguarded))
        self._begin(self._step_limits.at_start, self._solver.start)

    def _set_up(self, scene: Scene, settings: Settings | None, processes: Processes) -> None:
        """All that comes before the solver is started."""
        settings = settings_for(scene, settings)
        scene = scene._begun()
        check_processes(settings, processes)
        for feature in scene._features:
            feature.check_law(scene, settings.law)
        check_precision(scene, settings)
        self._access = Access()
        self._processes = processes
        self._restores = 0
        self._last_frame: int = 0
        self._last_time: float = 0.0
        self._start: tuple[Scene, Settings] = (scene, settings)
        self._changes: list[Change] = []
        self._record: RunRecord | None = None
        self._compiled_before = compile_seconds()
        self._emission: Emission = Emission(scene, settings, self._access.notices)
        choice = methods.choose(scene.count, settings, processes)
        self._can = capabilities_of(settings)
        self._step_limits: StepLimits = StepLimits(scene, settings)
        self._batch_sizer = BatchSizer(choice.workers, MOST_FRAMES)
        self._memory: Memory | None = None
        self._guard = Once()
        self._logged: list[Any] = []  # collisions of a frame in hand: an interrupted run leaves them to the next one
        self._solver: Solver = methods.solver_of(choice.method)(scene, settings, choice)
        self._closing = Closing(self, self._solver, self._access)  # before there is anything to close

    def _begin(self, look: Callable[[Notices], None], start: Callable[[], None]) -> None:
        notices = self._access.notices
        try:
            with _collective(self._start[1], self._processes.comm):
                try:
                    look(notices)
                finally:
                    notices.give()
            methods.note_remark(self._solver.choice, None, notices)
            notices.give()
            with self._access.state_lock, refusals_named():  # the end of the program waits until it can be closed
                start()
                self._step_limits.set_limit(self._solver)
        except BaseException:
            with interrupts_held_back():
                self._closing()
            raise

    def close(self) -> None:
        """Stop the workers and free the shared memory. May be repeated; a call in a fork does not affect the parent.

        Raises:
            BusyError: while another thread is changing the simulation.
        """
        if self._closing.alive:  # not in a fork, where it was closed at the fork
            self._close()

    @exclusive
    def _close(self) -> None:
        self._end()

    def _end(self) -> None:
        """Close the simulation, also from within another call of this thread; Ctrl-C waits."""
        with interrupts_held_back(), self._access.moving():
            if self._closing.alive:
                self._last_frame, self._last_time = self._solver.frame, self._solver.terms.time_of(self._solver.frame)
                self._closing()

    def _open_solver(self) -> Solver:
        """The solver, unless it is closed, or was made in another process."""
        if not self._closing.alive:  # nor in a fork, where it was closed at the fork
            self._access.demand_own_process()
            self._access.stop_if_ending()
            raise ClosedError(
                f"this simulation was closed after frame {self._last_frame}. A closed simulation has no state. "
                "Use it inside its `with` block, take sim.state before, or make a new one."
            )
        return self._solver

    def __reduce__(self) -> NoReturn:
        raise InputError(
            "a Simulation cannot be pickled or copied, as its discs are in shared memory. Pass sim.state on, or a file "
            "of sim.save(...), from which Simulation.resume(...) continues."
        )

    def __repr__(self) -> str:
        return f"<Simulation: of process {self._access.creator}>" if self._access.forked else self._described()

    @reading
    def _described(self) -> str:
        if not self._closing.alive:
            return f"<Simulation: closed after frame {self._last_frame}>"
        method = self._solver.choice.method
        return f"<Simulation: {self.count} discs by {method}, frame {self.frame}, time {self.time:g}>"

    # --- what is there

    @property
    def scene(self) -> Scene:
        """The scene as given, with the changes made by `change` and `add_wall`, but without discs added since."""
        return self._solver.terms.scene

    @property
    def settings(self) -> Settings:
        """The settings as given, with the changes made by `change`."""
        return self._solver.terms.settings

    @property
    @reading
    def frame(self) -> int:
        """Number of frames since the start; after `close`, the number at that time."""
        return self._solver.frame if self._closing.alive else self._last_frame

    @property
    @reading
    def time(self) -> float:
        """Simulated time since the start [time]: frame * dt; a little more after Ctrl-C inside a frame of `event`."""
        return self._solver.time if self._closing.alive else self._last_time

    @property
    @reading
    def count(self) -> int:
        """Number of discs now."""
        return self._open_solver().count

    @property
    @reading
    def substeps(self) -> int:
        """Steps in each frame now: as set, or as chosen by on_fast="substep"; 1 for `event`, which has no steps."""
        solver = self._open_solver()
        return solver.substeps if isinstance(solver, Steps) else 1

    @property
    @reading
    def state(self) -> State:
        """Read-only copies of all positions and velocities, in the order of the scene's discs (added ones follow)."""
        return self._whole("state").state()

    @reading
    def state_between(self, first: int, last: int) -> State:
        """The state of the discs numbered `first` to `last` - 1; on several ranks, of discs of all ranks.

        Args:
            first, last: 0 <= first <= last <= count.

        Raises:
            InputError: naming the argument, its rule and the value received.

        >>> scene = Scene.random(count=50, packing=0.2, radius=0.5, seed=1)
        >>> with Simulation(scene) as sim:
        ...     bool((sim.state_between(10, 20).position == sim.state.position[10:20]).all())
        True
        """
        solver = self._whole("state_between")
        last = checks.whole("last", last, 0, solver.count, "It is the number behind the last disc.")
        first = checks.whole("first", first, 0, last, "It is the number of the first disc, at most last.")
        return solver.state(first, last)

    def nearest(self, x: float, y: float) -> int:
        """Id of the disc whose centre is nearest to a point, through periodic borders too.

        Args:
            x, y: the point [length].

        Raises:
            InputError: if there is no disc, or the point is none.

        >>> with Simulation(Scene.load("cradle")) as sim:
        ...     sim.nearest(0, 0)
        0
        """
        state, point = self.state, checks.point("point", (x, y))
        if not state.present.any():
            raise InputError("nearest needs a disc; got a simulation without any. Add one.")
        apart = self.scene._to_nearest_image(state.position.astype(np.float64) - point)
        return int(np.where(state.present, np.hypot(*apart.T), np.inf).argmin())

    def within(self, shape: ArrayLike | Obstacle) -> NDArray[np.int64]:
        """Ids of the discs with centres, or images of them through a periodic border, in a shape, shape (K,).

        Args:
            shape: (x_low, y_low, x_high, y_high) [length], a Circle or a closed Polyline.

        Raises:
            InputError: for any other shape.

        >>> scene = Scene(width=9, height=4, position=[[2, 2], [7, 2]], velocity=[[1, 0], [0, 0]], radius=0.5)
        >>> with Simulation(scene) as sim:
        ...     sim.within((0, 0, 4, 4)).tolist()
        [0]
        """
        state, region, scene = self.state, check_region("shape", shape), self.scene
        here, position = np.zeros(len(state.position), bool), state.position.astype(np.float64)
        for image in itertools.product(*((-1, 0, 1) if wraps else (0,) for wraps in scene.periodic)):
            here |= is_in(region, position + np.multiply(image, (scene.width, scene.height)))
        return np.flatnonzero(here & state.present)

    @reading
    def local_state(self) -> tuple[NDArray[np.int64], State]:
        """The discs that this process holds: their numbers, in ascending order, and their state.

        Without ranks these are all discs. With several ranks each holds its own, without absorbed discs. Nothing is
        sent: to sum over all ranks, use a reduction of your own.

        >>> scene = Scene.random(count=50, packing=0.2, radius=0.5, seed=1)
        >>> with Simulation(scene) as sim:
        ...     numbers, state = sim.local_state()
        ...     len(numbers), state.position.shape
        (50, (50, 2))
        """
        return self._open_solver().local_state()

    @property
    @reading
    def absorbed(self) -> NDArray[np.bool_]:
        """Discs that have left through an absorbing edge, shape (N,), bool. They stay where they left."""
        return self._open_solver().absorbed

    @property
    @reading
    def radii(self) -> NDArray[np.float64]:
        """Radius of each disc, including added ones, shape (N,), read-only [length]."""
        return self._open_solver().radii

    @property
    @reading
    def masses(self) -> NDArray[np.float64]:
        """Mass of each disc, including added ones, shape (N,), read-only [mass]."""
        return self._open_solver().masses

    @property
    @reading
    def work(self) -> dict[int | str, float]:
        """Energy that each moving surface and heat bath has given to discs since the start [mass length^2/time^2].

        By the name of a wall that moves or is thermal, the number of an obstacle with a motion or a surface_velocity,
        and "thermostat". Of a surface it is the sum, over all contacts, of the impulse on the disc times the velocity
        of the surface's material at the point of contact; of a bath, the kinetic energy that the new velocities have
        more than the old ones. Without gravity, what discs have gained less than all of it, collisions have lost.

        >>> from mpsim import Piston
        >>> scene = Scene.random(count=50, width=10, height=10, radius=0.2, piston=Piston("right", -0.5, 8), seed=1)
        >>> with Simulation(scene) as sim:
        ...     report = sim.run(frames=100)
        ...     sim.work["right"] > 0
        True
        """
        return self._whole("work").work.energies()

    @property
    @reading
    def array_names(self) -> tuple[str, ...]:
        """Names of the arrays in the shared block; those of a feature exist only if the scene has the feature."""
        return tuple(self._open_solver().block.specs)

    @property
    def pids(self) -> list[int]:
        """Process numbers of the worker processes, without this process, the coordinator. May be read at any moment."""
        return self._open_solver().pids

    @reading
    def digest(self) -> str:
        """Hex digest of the state in the order of the scene's discs: equal digests mean equal bits."""
        return digest_of_state(self._whole("digest"))

    def once(self, act: Callable[[], Result]) -> Result:
        """Call a function on the first rank only, and return its result on all ranks.

        All ranks must call `once`. The function may read the simulation, and sees the discs of all ranks. If it raises
        an error, all ranks raise it. Without ranks it is simply called.

        Args:
            act: called without arguments. It must not run or change the simulation.

        >>> scene = Scene.random(count=50, packing=0.2, radius=0.5, seed=1)
        >>> with Simulation(scene) as sim:
        ...     sim.once(lambda: sim.count)
        50
        """
        return self._open_solver().ranks.on_root(act)

    @reading
    def _read_in_place(self, read: Callable[[InPlace], Result]) -> Result:
        """What a function gives that reads the discs where they lie, between two slices of frames.

        It must keep no view of them, write nothing, and be quick: the simulation waits.
        """
        return read(self._whole("discs in place").in_place())

    def _whole(self, what: str) -> Solver:
        """The solver, with a whole state to read."""
        solver, use = self._open_solver(), self._access.use
        if self._can.on_ranks and use is not None and use.thread != threading.get_ident():
            raise self._access.busy(f"reading {what} of other ranks", use)  # whose turn comes at other moments
        if solver.half_done:  # in a signal handler, just after a worker has died
            raise self._access.busy(f"reading {what}", use)
        return solver

    # --- runs

    @exclusive
    def run(
        self,
        frames: int | None = None,
        *,
        until: float | None = None,
        measures: Iterable[str] | None = None,
        start: float | None = None,
        progress: bool | Callable[[int, int], None] | None = None,
        observe: Observer | Iterable[Observer] | None = None,
        checkpoint: str | os.PathLike[str] | None = None,
        checkpoint_every: int | None = None,
        checkpoint_seconds: float = 60.0,
    ) -> Report:
        """Run a number of frames, or until a time is reached.

        Args:
            frames: how many, >= 0.
            until: simulated time at which to stop, not in the past [time]. The first frame that reaches it is the last.
            measures: what to measure during the run, for report.measures: "pressure", "pressure_virial", "pressure_xx",
                "pressure_yy", "pressure_xy", "collision_rate", "contact_rate", "overlap", "largest_overlap",
                "kinetic_energy", "temperature", "speed_kurtosis", "energy_drift", "momentum_drift". Measuring never
                changes the digest; measures that are not asked for cost nothing. If a run begins inside a frame
                (`event`, after Ctrl-C), the two drifts are NaN.
            start: measure only from the first frame on that begins at this time or later [time], when the scene has
                settled; the report has the times of all frames. None: from the beginning.
            progress: True: a line on standard error, with rate and time left; or a function, called as progress(done,
                of_frames) about twenty times a second. `event` calls it inside a long frame as well, other methods only
                at the end of a frame.
            observe: an observer or several that are called during the run, such as mpsim.Trajectory.write(...).
            checkpoint: file for `resume`, written during the run, at its end, and on SIGTERM, which then ends the
                process by SystemExit.
            checkpoint_every: frames between two checkpoints, >= 1; None: every checkpoint_seconds [s], > 0.

        Raises:
            InputError: for both or neither of frames and until, or one out of range.
            ClosedError: after `close`.
            DivergedError, WorkerDiedError, WorkerStalledError: the run cannot continue; the simulation is closed.
            OutputError: a checkpoint or trajectory cannot be written; the simulation is as it was before that.
        """
        access, solver = self._access, self._open_solver()
        if self._batch_sizer.best > 1:
            solver.wake_workers()
        if measures is not None and isinstance(measures, Iterable) and not isinstance(measures, str):
            measures = tuple(measures)
        if on_ranks := self._can.on_ranks:
            given = frames, until, measures, start, checkpoint, checkpoint_every, checkpoint_seconds
            solver.ranks.assert_same_on_ranks("arguments of run", given)
        if progress is not None:
            progress = checked_progress(progress, "progress(done, of_frames)")
            if progress is True and not solver.ranks.is_root:
                progress = None  # of several ranks the first one shows it
        if until is not None or type(frames) is not int or not 0 <= frames <= MOST_FRAMES_OF_A_RUN:
            frames = frames_wanted(frames, until, solver.terms, solver.frame, solver.time)
        skipped = 0 if start is None else frames_skipped(start, measures, frames, solver.terms, solver.frame)
        observers = None if observe is None else Observers(observe)
        names = () if measures is None else named(f"{MEASURES}:checked")(measures, self.scene, solver.count)
        with access.state_lock:
            record = self._begin_record(names, frames, observers is not None and observers.want_collisions, skipped)
        if progress or on_ranks or checkpoint is not None or checkpoint_every is not None or checkpoint_seconds != 60.0:
            place = None if checkpoint is None else solver.ranks.on_root(lambda: checked_place(checkpoint))

            def save(path: Path) -> None:
                if observers is not None:
                    self._open_solver().ranks.on_root(observers.keep)
                self.save(path)

            beside = Beside(solver.ranks, on_ranks, save, place, checkpoint_every, checkpoint_seconds)
            with beside.end, beside.stop, of_frames(progress) as beside.progress:
                self._run_frames(frames, record, observers, beside)
        else:
            self._run_frames(frames, record, observers)
        with access.state_lock:
            return self._report(record, 0.0 if observers is None else observers.seconds)

    def _begin_record(self, names: tuple[str, ...], frames: int, logged: bool, skipped: int) -> RunRecord:
        """Begin the record of a run, with averages for measures of these names but for the first `skipped` frames."""
        solver = self._solver
        averages = None
        if names:  # not of self: a cycle would keep a simulation that is dropped from being closed at once
            over_discs, whole = functools.partial(over_all_discs, solver), is_between_frames(solver)
            averages = named(f"{MEASURES}:RunAverages")(names, frames, self.scene, over_discs, whole, skipped)
        if logged != (isinstance(solver, CollisionLog) and solver.logging):
            self._between_frames(lambda: log_collisions(solver, logged))
        if not logged:
            self._logged.clear()
        work = solver.work if solver.work_unit else NOTHING_DONE
        self._record = RunRecord(max(solver.choice.workers), averages, self._logged, work)
        return self._record

    def _run_frames(
        self, frames: int, record: RunRecord, observers: Observers | None, beside: Beside | None = None
    ) -> None:
        """Run frames in slices, and record them. Between two slices others read, and callbacks may change something."""
        access, use, recovery = self._access, self._access.use, None
        if self._processes.on_worker_death == "restart":
            recovery = RecoverySnapshots(self._moment, self._go_on_from, record, access.notices)
        assert use is not None  # that of `run`
        use.in_callback = True
        if observers is not None:
            whole = is_between_frames(self._solver)
            observers.begin(self)
            if whole:
                observers.observe(self, 0)
        if beside is not None and not frames:
            beside.keep(0, self._open_solver().time, last=True)
        use.in_callback = False
        while record.done < frames:
            ahead = frames - record.done
            if beside is not None:
                ahead = min(ahead, beside.frames_ahead(record.done))
            access.let_readers_in()
            with access.state_lock:
                access.waiting = False
                before = self._open_solver().frame  # which says so if an observer has closed it
                if observers is not None:
                    ahead = min(ahead, observers.frames_ahead(before))
                self._advance(ahead, before, record, recovery)
            use.in_callback = True
            if access.notices.waiting:
                access.notices.give()
            if observers is not None and (frame := self._solver.frame) > before:
                if observers.want_collisions:
                    observers.take_collisions(record.take_logged(frame), frame)
                observers.observe(self, record.collisions)
            if beside is not None:
                beside.look(record.done, self._open_solver().time, frames)
            use.in_callback = False

    def _advance(self, most: int, frame: int, record: RunRecord, recovery: RecoverySnapshots | None) -> None:
        """Run one slice of frames, `most` at most: emitters add discs, the solver runs a command; see to deaths."""
        solver = self._solver
        if (isinstance(solver, Steps) and solver.too_fast) or self._step_limits.is_due(frame, solver.count):
            self._adapt()
        try:
            if self._emission.emits:
                self._emit(count_frames=True)
            if recovery is not None and self._solver.pids:
                recovery.take(len(self._changes))
            workers, frames, until = self._next_slice(most, frame, record)
            part = self._solver.advance(frames, workers, until, record.count_enabled)
        except WorkerDiedError as death:
            try:
                if recovery is None or not self._closing.alive:
                    raise
                with interrupts_held_back():
                    recovery.go_back(death)
            except Exception:
                self._end()
                raise
            return
        except BaseException as error:
            refused = isinstance(error, (BusyError, TooFastError))  # which change nothing
            if self._solver.half_done or (isinstance(error, Exception) and not refused):
                self._end()
            raise
        if frames := part.times.shape[1]:
            of_one = frames == 1  # then without NumPy, which takes longer than the sum
            took = sum(part.times[0, 0].tolist()) if of_one else float(np.median(part.times[0].sum(axis=1)))
            self._batch_sizer.note(workers, frames, took * 1e-9)
        record.take(part)
        self._look_after(record, part)

    def _next_slice(self, most: int, frame: int, record: RunRecord) -> tuple[int, int, float]:
        """Workers of the next command, its frames, and the time at which it ends if that comes first."""
        solver, emission, averages, until = self._solver, self._emission, record.averages, math.inf
        if emission.emits:
            most, until = min(most, emission.frames_ahead(frame)), emission.next_time
        if averages is not None:
            most = min(most, averages.frames_to_sample(record.done))
        most = min(most, self._step_limits.frames_ahead(frame, solver.count))
        workers, frames = self._batch_sizer.next_slice(most)
        if not isinstance(solver, Steps):  # `event` ends a command in time by itself, and a window at its last frame
            frames = min(most, MOST_FRAMES)
        return workers, frames, until

    def _look_after(self, record: RunRecord, part: BatchResult) -> None:
        """Look at what has come of a command: collisions, discs at rest, too fast or pressed, and those to enter."""
        solver, limits = self._solver, self._step_limits
        if part.logged:
            self._take_collisions()
        if record.guarded:
            self._warn_of_guard()
        if part.too_fast:  # look now: the run may end here, or be saved
            self._adapt()
        if limits.may_be_pressed(solver.count):
            limits.look_for_pressed(solver, self._access.notices)
        if self._emission.emits:
            self._emit(count_frames=False)

    def _take_collisions(self) -> None:
        """Take over what the solver has logged, before it moves to another block."""
        solver = self._solver
        if isinstance(solver, CollisionLog) and solver.logging:
            with interrupts_held_back():
                self._logged.append(solver.take_collisions())

    def _warn_of_guard(self) -> None:
        """Warn once that the guard has acted, as in inelastic collapse or for discs at rest."""
        self._access.notices.warn(
            "the contact-time guard suppresses the loss of energy where the previous collision of a disc was less than "
            f"the contact time {self._solver.contact_time:.3g} ago, as in inelastic collapse or for a disc at rest, "
            "whose tiny bounces method='event' simulates. Without it the run would never end. If frames take long, "
            "give a longer contact_time (the result is then a model, not exact), or use contact='impact' with another "
            "method. This is said once; report.guarded counts.",
            GuardWarning,
            self._guard,
        )

    def _emit(self, count_frames: bool) -> None:
        """Have the emitters add what is due, at the begin of a frame or in time."""
        before = self._solver.count
        try:
            self._emission.enter(self._solver, lambda new: self._insert(new, self._look(new)), count_frames)
        except Exception:  # of a signal handler, say
            if self._solver.count != before:  # the discs are there, and the emitters' books do not know of them
                self._end()
            raise

    def _adapt(self) -> None:
        """Check the speeds, and divide the following frames into as many steps as they need."""
        with interrupts_held_back():
            set_substeps(self._solver, self._look())

    def _look(self, new: NewDiscs | None = None, changed: NDArray[np.int64] | None = None) -> int:
        """Check the speeds of new discs, changed ones, or all; returns the sub-steps from now on."""
        solver, notices = self._solver, self._access.notices
        with interrupts_held_back(), self._access.moving():
            return self._step_limits.check(solver, notices, new, changed)

    def _report(self, record: RunRecord, observing_seconds: float) -> Report:
        solver, averages, measures = self._open_solver(), record.averages, Measures()
        if averages is not None:
            measures = Measures(averages.measures(self.scene, solver.count, self.settings.dt))
        choice, workers = solver.choice, self._batch_sizer.best
        found_faster = workers == 1 and len(choice.workers) > 1  # by `auto`, than many
        if compiled := compile_seconds() - self._compiled_before:
            self._compiled_before += compiled
        return Report(
            record.times,
            record.collisions,
            "grid" if found_faster else choice.method,
            workers,
            *self._resources(solver),
            measures,
            record.guarded,
            observing_seconds,
            compiled,
            solver.contact_time,
            (record.work_before, solver.work if solver.work_unit else NOTHING_DONE),
        )

    def _resources(self, solver: Solver) -> tuple[tuple[int, ...], int]:
        """Memory of the processes and of the block, read anew after a while, and by another solver's processes."""
        now, known = self._batch_sizer.seconds_run, self._memory
        if self._can.on_ranks or known is None or now >= known.until or known.pids != solver.pids:
            known = self._memory = Memory(now + MEMORY_SECONDS, solver.pids, resources_of(solver))
        return known.resources

    # --- changes between two frames
    #
    # Between two calls of `run`, or in a callback of one. A change is made as a whole or, if it is refused, not at all.
    # It is an entry of the journal, and the same on any number of workers.

    @exclusive
    def add(
        self,
        position: ArrayLike,
        velocity: ArrayLike,
        acceleration: ArrayLike | None = None,
        *,
        radius: ArrayLike | None = None,
        mass: ArrayLike | None = None,
        overlap: str = "allow",
        **others: Unpack[GivenColumns],
    ) -> NDArray[np.int64]:
        """Add one disc, or several.

        Args:
            position, velocity: shape (2,) or (K, 2); centres inside the box as it is now, clear of what stands in it
                [length], [length/time].
            acceleration: as position, only in a scene that has it; left out it is zero [length/time^2].
            radius, mass: one or one each; needed in a scene whose discs have one each, and only there. No disc may be
                larger than the largest of the scene [length], [mass].
            overlap: "refuse" discs that overlap others or each other, "push" those in the way aside, or "allow" it: the
                next frames push them apart.
            others: what else discs of the scene have, by name, such as spin [1/time] in a scene of rough discs: one or
                one each; left out it is zero.

        Returns:
            The ids of the new discs, shape (K,), as `set` and `remove` take them.

        Raises:
            InputError: naming the argument, its rule and the value received; then nothing is added.
            TooFastError: as settings.on_fast says; then nothing is added either.
        """
        solver = self._demand_alike("add", position, velocity, acceleration, radius, mass, overlap, others)
        new = changes.checked(solver, position, velocity, radius, mass, {"acceleration": acceleration, **others})
        if checks.choice("overlap", overlap, ("refuse", "push", "allow")) == "refuse":
            changes.demand_apart(solver, new)
        changes.check_momentum(solver, "velocity", new.velocity, new.mass)
        substeps = self._look(new)
        self._access.notices.give()  # where a filter makes an error of a warning, nothing is added
        if overlap == "push":
            for ids, aside in changes.room_for(self, of_discs(new.position, new.radius)):
                self._change_discs(changes.checked_set(solver, ids, aside, None, {}))
        change = changes.made(solver, changes.ADD, changes.arguments_of(solver.terms.scene, new))
        with interrupts_held_back():
            self._insert(new, substeps)
            self._note(change)
        count = self._open_solver().count
        return np.arange(count - len(new.position), count)

    @exclusive
    def set(
        self,
        ids: ArrayLike,
        position: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        acceleration: ArrayLike | None = None,
        **others: Unpack[GivenColumns],
    ) -> None:
        """Put discs elsewhere, or give them other velocities, between two frames.

        What is left out stays as it is; image flags do, so that a disc that is put elsewhere has jumped.

        Args:
            ids: numbers of discs that are there, one or shape (K,), each once.
            position: shape (2,) for one disc or (K, 2); centres inside the box as it is now, clear of what stands in it
                [length]. Discs may overlap others, which the next frames push apart; of `event` they must not.
            velocity: one for all, shape (2,), or one each, shape (K, 2) [length/time].
            acceleration: shape (K, 2), only in a scene that has it [length/time^2].
            others: what else discs of the scene have, by name, such as spin [1/time] in a scene of rough discs: one or
                one each.

        Raises:
            InputError: naming the argument, its rule and the value received; then nothing is changed.
            TooFastError: as settings.on_fast says; then nothing is changed either.

        >>> scene = Scene(width=4, height=3, position=[[1, 1], [3, 2]], velocity=[[1, 0], [0, 0]], radius=0.5)
        >>> with Simulation(scene) as sim:
        ...     sim.set(1, position=(2.5, 1.5), velocity=(0, 1))
        ...     sim.state.position.tolist(), sim.state.velocity.tolist()
        ([[1.0, 1.0], [2.5, 1.5]], [[1.0, 0.0], [0.0, 1.0]])
        """
        solver = self._demand_alike("set", ids, position, velocity, acceleration, others)
        given = {"acceleration": acceleration, **others}
        self._change_discs(changes.checked_set(solver, ids, position, velocity, given))

    @exclusive
    def kick(self, ids: ArrayLike, impulse: ArrayLike) -> None:
        """Give discs a kick between two frames: impulse / mass is added to their velocities.

        Args:
            ids: numbers of discs that are there, one or shape (K,), each once.
            impulse: one for all, shape (2,), or one each, shape (K, 2) [mass length/time].

        Raises:
            InputError, TooFastError: as `set`.

        >>> scene = Scene(width=4, height=3, position=[[1, 1]], velocity=[[1, 0]], radius=0.5)
        >>> with Simulation(scene) as sim:
        ...     sim.kick(0, (0.5, 2.0))
        ...     sim.state.velocity.tolist()
        [[1.5, 2.0]]
        """
        self._change_discs(changes.checked_kick(self._demand_alike("kick", ids, impulse), ids, impulse))

    @exclusive
    def remove(self, ids: ArrayLike) -> None:
        """Take discs out between two frames.

        The numbers of the others stay. A removed disc keeps its own, as one does that an edge has absorbed: `count` and
        the rows of arrays include it, `sim.state.present` is False for it, it rests where it was, meets nobody, and no
        observable, picture or trajectory has it. It does not come back; add another one.

        The first one that is removed from a scene without absorbing edges makes the simulation load other kernels,
        compiled once on each machine, and the exact solver then plays the box as a whole, in one process.

        Args:
            ids: numbers of discs that are there, one or shape (K,), each once.

        Raises:
            InputError: as `set`.

        >>> scene = Scene.random(count=5, packing=0.2, radius=0.5, seed=1)
        >>> with Simulation(scene) as sim:
        ...     sim.remove([1, 3])
        ...     sim.count, sim.state.present.tolist()
        (5, [True, False, True, False, True])
        """
        solver = self._demand_alike("remove", ids)
        self._change_discs(changes.made(solver, REMOVE, {"ids": changes.present_numbers(solver, ids)}))

    @exclusive
    def change(self, **parameters: Unpack[Parameters]) -> None:
        """Change parameters of the scene or the settings between two frames; those not given stay as they are.

        `scene` and `settings` then are those in force.

        Args:
            parameters: by name, as Scene, Emitter and Settings have them: gravity, restitution, wall_restitution, dt,
                contact, passes, substeps (the last three not of "event", which has no steps), workers; friction and
                wall_friction, of a scene in which they are > 0, and > 0 again; temperature, of a thermostat;
                wall_temperature, one number for all thermal walls or a list with one for each, in the order left,
                right, bottom, top; interval or every of emitters, one number for all that have it or a list with one
                for each; piston_speed, of a piston that then goes on from where it is; obstacles, of which those equal
                to one of `scene.obstacles` stay as they are with their numbers, the others there are removed, and new
                ones come as by `add_wall`. What is left of an emitter's interval shrinks or grows as the interval
                does. dt not in a callback of `run`.

        Raises:
            InputError, TooFastError: as `set`; the first says what can be changed.

        >>> scene = Scene(width=9, height=9, position=[[4, 5]], velocity=[[0, 0]], radius=0.5, gravity=(0, -1))
        >>> with Simulation(scene) as sim:
        ...     sim.change(gravity=(1, 0), dt=0.005)
        ...     sim.run(frames=200).frames, sim.state.velocity.round(12).tolist(), round(sim.time, 12)
        (200, [[1.0, 0.0]], 1.0)
        """
        given = dict(parameters)
        solver = self._demand_alike("change", given)
        changes.check_parameters(given, solver.terms.settings)
        use = self._access.use
        if "dt" in given and use is not None and use.outer is not None:
            raise InputError(
                "dt can be changed between two runs, not in a callback of a run, which counts frames of this "
                "length; got "
                f"{given['dt']!r}. Return from the run before."
            )
        self._take_over(changes.checked_parameters(solver, self._start[0], given))

    @exclusive
    def add_wall(self, wall: ArrayLike | Obstacle) -> int:
        """Put up a wall, or any other obstacle, between two frames: one more among the obstacles of `scene`.

        The first obstacle of a scene makes the simulation load other kernels, compiled once on each machine. Measures
        that mean nothing in a scene with obstacles are NaN for a run in which a wall is put up.

        Args:
            wall: a FixedDisc, Polyline or Circle, whose motion counts its times from now; or the points of a Polyline,
                shape (K, 2) [length].

        Returns:
            Its number, the index in `scene.obstacles`. An obstacle keeps its number; none is used twice.

        Raises:
            InputError: as `set`, also where it leaves a disc, an emitter or the piston no room.

        >>> scene = Scene(width=8, height=4, position=[[2, 2]], velocity=[[1, 0]], radius=0.5)
        >>> with Simulation(scene) as sim:
        ...     wall = sim.add_wall([(4, 0), (4, 4)])
        ...     report = sim.run(frames=300)
        ...     wall, sim.scene.obstacles, sim.state.velocity.tolist()
        (0, (Polyline(points=((4.0, 0.0), (4.0, 4.0)), thickness=0.0),), [[-1.0, 0.0]])
        """
        solver = self._demand_alike("add_wall", wall)
        self._take_over(changes.checked_wall(solver, self._start[0], changes.WALL, wall))
        return len(self.scene.obstacles) - 1

    @exclusive
    def move_wall(self, wall: int, motion: Movement | None = None) -> None:
        """Give an obstacle another motion between two frames, from where it is.

        Args:
            wall: its number, the index in `scene.obstacles`.
            motion: a Translation, Oscillation, Rotation or Path, whose times count from now; None: it stays there.

        Raises:
            InputError, TooFastError: as `set`, also where the motion would leave the box, or begin elsewhere.

        >>> from mpsim import Translation
        >>> scene = Scene(width=8, height=4, position=[[2, 2]], velocity=[[0, 0]], radius=0.5)
        >>> with Simulation(scene) as sim:
        ...     wall = sim.add_wall([(4, 0), (4, 4)])
        ...     sim.move_wall(wall, Translation((-1, 0), stop=3))
        ...     report = sim.run(frames=200)
        ...     sim.state.velocity.round(9).tolist()
        [[-2.0, 0.0]]
        """
        solver = self._demand_alike("move_wall", wall, motion)
        self._take_over(changes.checked_wall(solver, self._start[0], changes.MOVE_WALL, wall, motion))

    @exclusive
    def remove_wall(self, wall: int) -> None:
        """Take an obstacle away between two frames; the others keep their numbers.

        Args:
            wall: its number, the index in `scene.obstacles`.

        Raises:
            InputError: if there is no such obstacle, with those that are there.

        >>> from mpsim import Polyline
        >>> partition = Polyline([(4, 0), (4, 4)])
        >>> scene = Scene(width=8, height=4, position=[[3, 2]], velocity=[[1, 0]], radius=0.5, obstacles=partition)
        >>> with Simulation(scene) as sim:
        ...     sim.remove_wall(0)
        ...     report = sim.run(frames=200)
        ...     sim.state.position.round(9).tolist()
        [[5.0, 2.0]]
        """
        solver = self._demand_alike("remove_wall", wall)
        self._take_over(changes.checked_wall(solver, self._start[0], changes.REMOVE_WALL, wall))

    def _demand_alike(self, call: str, *given: Any) -> Solver:
        """The solver, at a call that is alike on all ranks; all but `add` need a whole frame."""
        solver = self._open_solver()
        solver.ranks.assert_same_on_ranks(f"arguments of {call}", given)
        if call != "add":
            changes.demand_whole_frame(solver, call)
        return solver

    def _change_discs(self, change: Change) -> None:
        """Make a change of discs that has been checked, and note it in the journal."""
        numbers = change.values["ids"]
        before = self._solver.discs(numbers)
        after = edited(before, change)

        def act() -> None:
            terms = changes.after(self._solver.terms, change)
            if terms.scene is not self._solver.terms.scene:
                self._adopt(terms)
            self._solver.set_discs(after, numbers)

        with interrupts_held_back():
            self._between_frames(act)
            self._note(change)
        if change.what != REMOVE:  # which makes no disc faster
            self._look_or_undo(lambda: self._solver.set_discs(before, numbers), numbers)

    def _look_or_undo(self, undo: Callable[[], None], numbers: NDArray[np.int64]) -> None:
        """Check the speeds after the last change of the journal, of these discs; where they are refused, undo it."""
        try:
            substeps = self._look(changed=numbers)
            self._access.notices.give()  # where a filter makes an error of a warning, nothing is changed
            if isinstance(self._solver, Steps) and self._solver.substeps != substeps:
                self._between_frames(lambda: set_substeps(self._solver, substeps))
        except Exception:
            with interrupts_held_back():
                self._between_frames(undo)
                self._changes.pop()
            raise

    def _take_over(self, change: Change) -> None:
        """Continue under the scene and settings that a change makes, and note it in the journal."""
        solver, notices = self._solver, self._access.notices
        before, terms = solver.choice, changes.after(solver.terms, change)
        check_precision(terms.scene, terms.settings)
        emission = self._emission.under(terms.scene, terms.settings, solver.frame, solver.time)
        limits = self._step_limits.under(*terms)
        try:
            with interrupts_held_back(), self._access.moving():
                substeps = limits.check(solver, notices)
            notices.give()  # where a filter makes an error of a warning, nothing is changed
        except Exception:
            self._step_limits.set_limit(solver)
            raise

        def act() -> None:
            self._adopt(terms)
            limits.set_limit(self._solver)
            set_substeps(self._solver, substeps)

        with interrupts_held_back():
            self._between_frames(act)
            self._emission, self._step_limits = emission, limits
            self._note_choice(before)
            self._note(change)

    def _note(self, change: Change) -> None:
        self._changes.append(change)
        if self._record is not None and self._record.averages is not None:
            self._record.averages.interrupted(self.scene, self._solver.count)

    def _adopt(self, terms: Terms) -> None:
        """Take another scene and settings for those in force."""
        self._solver.change_scene(terms, methods.choose(self._solver.count, terms.settings, self._processes))

    def _note_choice(self, before: Choice) -> None:
        """After a move of the solver: measure other numbers of workers anew, and say why there are no more of them."""
        choice = self._solver.choice
        methods.note_remark(choice, before, self._access.notices)
        if choice != before:
            self._batch_sizer, self._memory = BatchSizer(choice.workers, MOST_FRAMES), None

    def _insert(self, new: NewDiscs, substeps: int) -> None:
        """Add discs that have been checked; the solver may then continue by another method."""
        count = self._solver.count + len(new.position)
        before, choice = self._solver.choice, methods.choose(count, self.settings, self._processes)

        def grow() -> None:
            self._solver.add(new, choice)
            set_substeps(self._solver, substeps)

        self._between_frames(grow)
        self._note_choice(before)

    def _between_frames(self, action: Callable[[], None]) -> None:
        """Do what may move the discs to another block; on new workers if one has died. Signals wait for its end."""
        self._take_collisions()
        renew = (lambda: self._go_on_from(self._moment())) if self._processes.on_worker_death == "restart" else None
        with interrupts_held_back(), self._access.moving():
            try:
                retried_on_new_workers(action, renew, self._access.notices)
            except BaseException as error:
                left_halfway = isinstance(error, BusyError | WorkerDiedError | WorkerStalledError)
                if self._solver.half_done or left_halfway:
                    self._end()
                raise

    # --- earlier moments: journal, snapshots and checkpoints

    @property
    @reading
    def journal(self) -> Journal:
        """What the simulation started from, and every change by set, kick, remove, add, change or of walls, in order.

        A checkpoint holds it, so that of a resumed simulation begins where the first one did. `journal.save` writes it,
        and `Simulation.replay` runs it again, with the same bits. On ranks all ask for it; one of them saves it.

        >>> scene = Scene.random(count=5, packing=0.2, radius=0.5, seed=1)
        >>> with Simulation(scene) as sim:
        ...     sim.kick([0, 1], impulse=(1, 0))
        ...     [(change.frame, change.what, change.values["ids"].tolist()) for change in sim.journal]
        [(0, 'kick', [0, 1])]
        """
        solver = self._open_solver()
        return Journal(*self._start, tuple(self._changes), solver.frame, digest_of_state(solver))

    @property
    @reading
    def origin(self) -> tuple[int, float]:
        """Frame and time [time] of the last `change` of dt, since which frames are counted; (0, 0.0) without one."""
        frame, time = self._open_solver().terms.origin
        return frame, time

    @exclusive
    def snapshot(self) -> Snapshot:
        """Copies of everything that the next frame depends on, in memory, for `restore` and `from_snapshot`.

        The frames that follow are the same to the bit as without it.

        Raises:
            InputError: with method="mpi", whose ranks hold a part of the discs each.
        """
        self._demand_one_process("snapshot")
        with self._access.state_lock:
            self._open_solver()
            return self._moment()

    @exclusive
    def restore(self, snapshot: Snapshot) -> None:
        """Go back to a snapshot of this simulation: frame, time, discs, scene, settings and journal are those of it.

        All changes made since are undone, and the next frames have the same bits as they had, on any number of workers.
        Observers, such as `Collisions` and an open trajectory, do not go back: one that has observed this simulation
        before refuses to go on, as frames that it has seen are undone. Make a new one for each part.

        Args:
            snapshot: of this simulation, or of another one of the same scene and settings. It can be used again.

        Raises:
            InputError: for a snapshot of another scene or other settings, in a callback of `run`, and with
                method="mpi"; then nothing has changed.

        >>> scene = Scene.random(count=50, packing=0.2, radius=0.5, seed=1)
        >>> with Simulation(scene) as sim:
        ...     snap = sim.snapshot()
        ...     sim.kick(3, impulse=(2, 0))
        ...     report = sim.run(frames=10)
        ...     sim.restore(snap)
        ...     sim.frame, len(sim.journal), bool((sim.state.velocity == scene.velocity).all())
        (0, 0, True)
        """
        self._demand_one_process("restore")
        self._open_solver()
        if not isinstance(snapshot, Snapshot):
            raise InputError(f"restore needs a Snapshot, from sim.snapshot(); got {checks.brief(snapshot)}.")
        use = self._access.use
        if use is not None and use.outer is not None:
            raise InputError(
                "restore must be called between two runs, not in a callback of a run, which counts its frames; got one "
                f"in frame {self.frame}. Return from the run before, or continue elsewhere by Simulation.from_snapshot."
            )
        (scene, settings), (own, wanted) = snapshot.start, self._start
        is_same = dataclasses.replace(settings, workers=wanted.workers) == wanted
        if not is_same or (scene is not own and scene.digest() != own.digest()):
            raise InputError(
                f"restore needs a snapshot of a simulation of the same scene and settings; got {snapshot!r} of another "
                "one. Use Simulation.from_snapshot to continue that one."
            )
        self._go_back(snapshot)
        self._restores += 1

    @property
    @reading
    def restores(self) -> int:
        """Number of calls of `restore` so far. When it rises, frames that an observer has seen may be undone."""
        return self._restores

    @classmethod
    def from_snapshot(
        cls,
        snapshot: Snapshot,
        *,
        workers: int | None = None,
        method: str | None = None,
        start_method: StartMethod | None = None,
        on_worker_death: OnWorkerDeath = "raise",
    ) -> Simulation:
        """Start another simulation from a snapshot: a branch, with the same bits as long as it is not changed.

        Args:
            snapshot: of any simulation, which may be closed.
            workers: as in Settings; the result has the same bits with any number.
            method: "grid" or "parallel", for a snapshot of the other one: they have the same bits.
            start_method, on_worker_death: as of a new simulation.

        Raises:
            InputError: if it is not a snapshot, or for a method that does not give the same bits.

        >>> with Simulation(Scene.random(count=50, packing=0.2, radius=0.5, seed=1)) as sim:
        ...     snap = sim.snapshot()
        ...     with Simulation.from_snapshot(snap) as branch:
        ...         branch.run(frames=10).frames, branch.frame, sim.frame
        (10, 10, 0)
        """
        if not isinstance(snapshot, Snapshot):
            raise InputError(f"from_snapshot needs a Snapshot, from sim.snapshot(); got {checks.brief(snapshot)}.")
        if on_ranks(method):
            raise InputError(f"method={method!r} cannot start from a snapshot in memory. Use sim.save and resume.")
        settings = settings_to_go_on(snapshot.start[1], method, workers)
        return cls._continued(snapshot, settings, Processes(None, start_method, on_worker_death))

    def _demand_one_process(self, what: str) -> None:
        if self._can.on_ranks:
            raise InputError(
                f"{what} is not there with method={self.settings.method!r}, whose ranks hold a part of the discs each. "
                "Use sim.save and Simulation.resume."
            )

    @exclusive
    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write everything that the next frame depends on to a file, from which `resume` continues with the same bits.

        The file is never incomplete, even if the process or the machine dies while it is written. The previous one is
        kept as <path>.previous. The file contains no pickle: reading it runs no code.

        Raises:
            OutputError: if it cannot be written, or would hold an object of a class derived from one of mpsim; an
                existing file is left untouched.
            ClosedError: after `close`.

        >>> import tempfile
        >>> scene = Scene.random(count=50, packing=0.2, radius=0.5, seed=1)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     with Simulation(scene, Settings(method="grid")) as sim:
        ...         report = sim.run(frames=10)
        ...         path = sim.save(f"{folder}/run.mpsim")
        ...         report = sim.run(frames=10)
        ...     with Simulation.resume(path) as again:
        ...         report = again.run(frames=10)
        ...         again.frame
        20
        """
        self._open_solver().ranks.assert_same_on_ranks("paths of checkpoints", path)
        with self._access.state_lock:
            solver, moment = self._open_solver(), self._moment()
        return solver.ranks.on_root(lambda: checkpoint.write(path, moment))

    @classmethod
    def resume(
        cls,
        path: str | os.PathLike[str],
        *,
        workers: int | None = None,
        method: str | None = None,
        comm: object = None,
        start_method: StartMethod | None = None,
        on_worker_death: OnWorkerDeath = "raise",
    ) -> Simulation:
        """Continue a simulation where `save` was called, with the same bits as in an uninterrupted run.

        Args:
            path: of the file. If it is damaged, the previous one is used, with a CheckpointWarning that names both.
            workers: as in Settings; the result has the same bits with any number.
            method: "grid", "parallel" or "mpi", for one that was saved by another of them: they have the same bits.
            comm, start_method, on_worker_death: as of a new simulation.

        Raises:
            CheckpointError: if there is no undamaged file, or a newer version wrote it.
            InputError: for a method that does not give the same bits as the saved one.
        """
        saved = checkpoint.method_of(path) if method is None else method
        found = _read(path, comm, on_ranks(saved) or comm is not None)
        settings = settings_to_go_on(found.snapshot.start[1], method, workers)
        return cls._continued(found.snapshot, settings, Processes(comm, start_method, on_worker_death))

    @classmethod
    def replay(
        cls,
        source: Journal | str | os.PathLike[str],
        *,
        frame: int | None = None,
        workers: int | None = None,
        method: str | None = None,
        comm: object = None,
        start_method: StartMethod | None = None,
    ) -> Simulation:
        """Run the simulation of a journal again, and return it; it can be continued.

        Its state has the digest of the journal, on one machine with one version; see docs/determinism.md for others.

        Args:
            source: `sim.journal`, or a path to which `journal.save` has written it.
            frame: where to stop, with the changes that were made there; None: where the journal ends.
            workers: as in Settings; the result has the same bits with any number. Changes of workers in the journal
                are left out.
            method: "grid", "parallel" or "mpi", for one that was recorded by another of them: they have the same bits.
            comm, start_method: as of a new simulation.

        Raises:
            InputError: if source is not a journal, or a change in it is refused or was made inside a frame.

        >>> scene = Scene.random(count=50, packing=0.2, radius=0.5, seed=1)
        >>> with Simulation(scene) as sim:
        ...     report = sim.run(frames=10)
        ...     sim.kick(3, impulse=(2, 0))
        ...     report = sim.run(frames=10)
        ...     journal = sim.journal
        >>> with Simulation.replay(journal, workers=1) as again:
        ...     again.frame, again.digest() == journal.digest
        (20, True)
        """
        return replayed(cls, source, frame, workers=workers, method=method, comm=comm, start_method=start_method)

    @classmethod
    def _continued(cls, moment: Snapshot, settings: Settings, processes: Processes) -> Simulation:
        """A simulation that goes on from a moment, under settings of maybe another method or number of workers."""
        scene, sim = moment.start[0], cls.__new__(cls)
        sim._set_up(scene, settings, processes)
        terms = terms_after(scene, settings, moment.changes)
        if moment.changes:
            sim._emission = sim._emission.under(terms.scene, terms.settings, 0, 0.0)
            sim._step_limits = sim._step_limits.under(*terms)
        sim._changes = list(moment.changes)
        to = dataclasses.replace(moment, terms=terms)
        sim._begin(sim._step_limits.at_resume, lambda: sim._go_on_from(to))
        return sim

    def _moment(self) -> Snapshot:
        """Copies of everything that the next frame depends on."""
        solver, changes = self._solver, tuple(self._changes)
        now = solver.snapshot(), self._emission.progress
        return Snapshot(solver.frame, solver.time, self._start, changes, solver.terms, *now)

    def _go_on_from(self, to: Snapshot) -> None:
        """Go back, or on, to a snapshot, on new workers."""
        before, choice = self._solver.choice, methods.choose(to.count, to.terms.settings, self._processes)
        with interrupts_held_back(), self._access.moving():
            self._solver.restore(to.arrays, choice, to.terms)
            self._emission.progress = to.emission
            self._note_choice(before)

    def _go_back(self, to: Snapshot) -> None:
        """Continue from a snapshot of this simulation, under the scene and settings then in force."""
        before, choice = self._solver.choice, methods.choose(to.count, to.terms.settings, self._processes)
        emission = self._emission.under(to.terms.scene, to.terms.settings, to.frame, to.time)
        emission.progress = to.emission
        limits = self._step_limits.under(*to.terms)

        def act() -> None:
            self._solver.restore(to.arrays, choice, to.terms, new_workers=False)
            limits.set_limit(self._solver)

        with interrupts_held_back():
            self._between_frames(act)
            self._emission, self._step_limits, self._changes = emission, limits, list(to.changes)
            self._logged.clear()
            self._note_choice(before)


def _collective(settings: Settings | None, comm: object) -> contextlib.AbstractContextManager[None]:
    """What one rank refuses in the block, all refuse; without ranks it is as ever."""
    if isinstance(settings, Settings) and on_ranks(settings.method):
        return named(f"{methods.RANKS}:collective")(comm)
    return contextlib.nullcontext()


def _read(path: str | os.PathLike[str], comm: object, together: bool) -> checkpoint.Checkpoint:
    """A checkpoint, verified; together: on ranks, by each of them, none of which holds its arrays in memory."""
    if not together:
        return checkpoint.read(path)
    with contextlib.closing(named(f"{methods.RANKS}:MpiRanks")(comm)) as ranks:
        ranks.assert_same_on_ranks("paths of checkpoints", str(checkpoint.place_of(path)))
        with ranks.collective():
            found = checkpoint.read(path, mapped=True)
        ranks.assert_same_on_ranks("checkpoints", found.digest)
        return found
