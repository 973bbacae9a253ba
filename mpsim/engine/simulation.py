"""Simulation: the coordinator. It checks what comes in, runs the frame loop in slices, and hands out copies."""

# pyright: reportUnnecessaryIsInstance=false
# Arguments are checked when the program runs as well, for callers without a type checker.

import dataclasses
import os
import warnings
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mpsim.core.deferred_signals import interrupts_held_back
from mpsim.core.errors import (
    BusyError,
    CheckpointError,
    ClosedError,
    FastWarning,
    InputError,
    OverlapWarning,
    TooFastError,
    WorkerDied,
    WorkerStalled,
    level_of_caller,
)
from mpsim.core.state import State
from mpsim.engine import checkpoint as checkpoint_file
from mpsim.engine import checkpoint_validation, frame_count, insertion, precision_check, run_loop, step_limits
from mpsim.engine.access import Access, exclusive, reading
from mpsim.engine.batch_size import Pacer
from mpsim.engine.emission import Emission, Insert
from mpsim.engine.report import Report, phase_seconds
from mpsim.engine.run_loop import Checkpointer, Keeper, Ledger, Observer, Observers
from mpsim.engine.shutdown import Closing
from mpsim.engine.solvers import methods
from mpsim.engine.solvers.base import Choice, Columns, Solver
from mpsim.engine.solvers.snapshots import Snapshot, count_in
from mpsim.engine.workers.arrays import MOST_FRAMES
from mpsim.engine.workers.system_limits import refusals_named
from mpsim.measure.run_averages import Gathering, Run, checked
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings


class Simulation:
    """A scene being simulated. Use it in a `with` block: leaving it stops the workers and frees the shared memory.

    Args:
        scene: what is simulated, in units of its own: [length], [time], [mass].
        settings: how; the defaults if left out.

    Raises:
        InputError: if the numbers of the scene do not fit the precision of the run.
        TooFastError: as settings.on_fast says; also during a run, which can then go on.
        ResourceError, WorkerDied: if the block (SharedMemoryError) or the workers cannot be had.
        BusyError, ForkedError: at any use, while another thread changes it, or in a fork of the process that made it.

    Warns:
        OverlapWarning: if discs of the start overlap.
        FastWarning: if discs move so far in a step that they may pass through each other (also during a run, once).
        ResolutionWarning: if the precision of the run is too coarse for the scene.

    >>> scene = Scene.random(count=50, packing=0.2, radius=0.5, seed=1)
    >>> with Simulation(scene, Settings(dt=0.01, method="grid")) as sim:
    ...     report = sim.run(frames=100)
    ...     sim.frame, round(sim.time, 9), report.frames, report.method
    (100, 1.0, 100, 'grid')
    """

    def __init__(self, scene: Scene, settings: Settings | None = None):
        if not isinstance(scene, Scene):
            raise InputError(f"scene must be an mpsim.Scene; got {type(scene).__name__}. Make one with Scene(...).")
        settings = Settings() if settings is None else settings
        if not isinstance(settings, Settings):
            raise InputError(f"settings must be mpsim.Settings; got {type(settings).__name__}. Use Settings(dt=...).")
        self._scene = scene
        self._settings = settings
        self._access = Access()
        precision_check.check_precision(scene, settings)
        self._last_frame = 0
        self._emission = Emission(scene, settings, self._access.notices)
        choice = methods.choose(scene.count, settings)
        made_by = methods.METHODS[choice.method].solver
        self._watch = step_limits.Watch(scene, settings, made_by.capabilities.has_steps)
        for text, kind in self._watch.at_start():
            warnings.warn(text, kind, stacklevel=level_of_caller())
        methods.note_remark(choice, None, self._access.notices)
        self._access.notices.give()
        self._pacer = Pacer(choice.workers, MOST_FRAMES)
        self._solver: Solver = made_by(scene, settings, choice)
        self._closing = Closing(self, self._solver, self._access)  # before there is anything to close
        try:
            with self._access.whole, refusals_named():  # the end of the program waits until it can be closed
                self._solver.start()
                self._watch.arm(self._solver)
        except BaseException:
            with interrupts_held_back():
                self._closing()
            raise

    def __enter__(self) -> "Simulation":
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop the workers and free the shared memory. May be called again; in a fork it takes nothing from its parent.

        Raises:
            BusyError: while another thread is changing the simulation.
        """
        if self._closing.alive:  # not in a fork, where it was closed at the fork
            self._close()

    @exclusive
    def _close(self) -> None:
        self._end()

    def _end(self) -> None:
        """Close the simulation, from within whatever this thread is doing with it; Ctrl-C waits."""
        with interrupts_held_back(), self._access.moving():
            if self._closing.alive:
                self._last_frame = self._solver.frame
                self._closing()

    @property
    def scene(self) -> Scene:
        """The scene as it was given (discs added since are not in it)."""
        return self._scene

    @property
    def settings(self) -> Settings:
        """The settings as they were given."""
        return self._settings

    @property
    @reading
    def frame(self) -> int:
        """Frames done since the start; after `close`, until then."""
        return self._solver.frame if self._closing.alive else self._last_frame

    @property
    @reading
    def time(self) -> float:
        """Simulated time since the start [time]: frame * dt (of `event` after Ctrl-C inside a frame: a little more)."""
        return self._solver.time if self._closing.alive else self._last_frame * self._settings.dt

    @property
    @reading
    def count(self) -> int:
        """Number of discs now."""
        return self._open_solver().count

    @property
    @reading
    def substeps(self) -> int:
        """Steps of a frame now: as set, or as on_fast="substep" has chosen; 1 for `event`, which has none."""
        return self._open_solver().substeps

    @property
    @reading
    def state(self) -> State:
        """Copies of all positions and velocities, in the order of the scene's discs (added ones follow)."""
        if (solver := self._open_solver()).torn:  # in a signal handler, just after a worker has died
            raise self._access.busy("reading state", self._access.use)
        return solver.state()

    @property
    def pids(self) -> list[int]:
        """Process numbers of the worker processes (the coordinator, this process, is not among them); at any moment."""
        return self._open_solver().pids

    def digest(self) -> str:
        """Hex digest of the state in the order of the scene's discs: equal digests mean equal bits."""
        return self.state.digest()

    @exclusive
    def run(
        self,
        frames: int | None = None,
        *,
        until: float | None = None,
        measures: Iterable[str] | None = None,
        progress: Callable[[int, int], None] | None = None,
        observe: "Observer[Simulation] | Iterable[Observer[Simulation]] | None" = None,
        checkpoint: str | os.PathLike[str] | None = None,
        checkpoint_every: int | None = None,
        checkpoint_seconds: float = 60.0,
    ) -> Report:
        """Run a number of frames, or until a time is reached.

        Args:
            frames: how many, >= 0.
            until: simulated time at which to stop [time]: the first frame that reaches it is the last; not before now.
            measures: names of what to gather along the way, for report.measures: "pressure", "pressure_virial",
                "pressure_xx", "pressure_yy", "pressure_xy", "collision_rate", "contact_rate", "overlap",
                "largest_overlap", "kinetic_energy", "temperature", "speed_kurtosis", "energy_drift", "momentum_drift".
                Gathering never changes the digest; what is not asked for costs nothing. Of a run that begins inside a
                frame (`event`, after Ctrl-C) the two drifts are NaN.
            progress: called as progress(done, of_frames) about twenty times a second, inside a long frame as well
                (of `event`; of the others at the end of each frame).
            observe: who looks on every so many frames, such as mpsim.Trajectory.write(...); changes no bit.
            checkpoint: file for `save`, written along the way and at the end; on SIGTERM too, which then ends the
                process by SystemExit. See `resume`.
            checkpoint_every: frames between two checkpoints, >= 1; None: checkpoint_seconds [s], > 0, count.

        Raises:
            InputError: both or neither of frames and until, or one out of range.
            ClosedError: after `close`.
            DivergedError, WorkerDied, WorkerStalled: the run cannot go on; the simulation is closed.
            OutputError: a checkpoint or trajectory cannot be written; the simulation is as it was before that.
        """
        solver = self._open_solver()
        frames = frame_count.frames_wanted(frames, until, self._settings.dt, self.frame, self.time)
        observers, names = Observers(observe), checked(measures, self._scene, self.count)
        with self._access.whole:
            whole, guarded = solver.time == solver.frame * self._settings.dt, solver.guarded
            gathering = Gathering(names, frames, self._state, whole)
            self._between_frames(lambda: self._solver.record(gathering.counting))
            ledger = Ledger(max(solver.choice.workers), gathering)
        restart, notices = self._settings.on_worker_death == "restart", self._access.notices
        keeper = Keeper(self._snapshot, self._restore, ledger, notices) if restart else None
        place = None if checkpoint is None else checkpoint_file.checked_place(checkpoint)
        with Checkpointer(self.save, place, checkpoint_every, checkpoint_seconds) as checkpoints:
            with self._access.callbacks():
                if whole:
                    observers.look(self, 0)
                if not frames:
                    checkpoints.look(0, last=True)
            while ledger.done < frames:
                ahead = min(frames - ledger.done, checkpoints.frames_ahead(ledger.done))
                self._access.let_readers_in()
                with self._access.whole:
                    self._access.waiting = False
                    before = self._open_solver().frame  # which says so if an observer has closed the simulation
                    self._advance(min(ahead, observers.frames_ahead(before)), ledger, keeper)
                    done = self._solver.frame > before
                with self._access.callbacks():
                    notices.give()
                    if done:
                        observers.look(self, ledger.collisions)
                    checkpoints.look(ledger.done, last=ledger.done == frames)
                    if progress is not None:
                        progress(ledger.done, frames)
        with self._access.whole:
            solver = self._open_solver()  # emitters may have changed it, too
            resources = solver.resources()
            ran = methods.what_ran(solver.choice, self._pacer.best, self._settings)
            gathered = gathering.measures(Run(self._scene, solver.count, self._settings.dt))
            guarded = solver.guarded - guarded
            run_loop.warn_of_guard(guarded, notices)
        counts = (*phase_seconds(ledger.times), ledger.collisions, *ran, *resources)
        return Report(*counts, gathered, guarded, observers.seconds)

    def _advance(self, most: int, ledger: Ledger, keeper: Keeper | None) -> None:
        """One slice of frames: what emitters add, a command of the solver, and, where wanted, the way back."""
        self._adapt()
        try:
            self._emit(self._emission.before_frame)
            solver = self._solver
            if keeper is not None and solver.pids:
                keeper.keep()
            ahead = min(
                ledger.gathering.frames_to_sample(ledger.done),
                self._emission.frames_ahead(solver.frame),
                self._watch.frames_ahead(solver.frame, solver.count),
            )
            workers, size = self._pacer.next_slice(int(min(most, ahead)))
            part = solver.advance(size, workers, self._emission.next_time)
        except WorkerDied as death:
            try:
                if keeper is None or not self._closing.alive:
                    raise
                with interrupts_held_back():
                    keeper.go_back(death)
            except Exception:
                self._end()
                raise
            return
        except BaseException as error:
            refused = isinstance(error, (BusyError, TooFastError))  # which change nothing
            if self._solver.torn or (isinstance(error, Exception) and not refused):
                self._end()
            raise
        if part.times.shape[1]:
            self._pacer.note(workers, part.times.shape[1], float(np.median(part.times[0].sum(axis=1))) * 1e-9)
        ledger.take(part, self._scene)
        self._last_frame = solver.frame
        if solver.capabilities.has_steps and solver.alarmed:  # look now: the run may end here, or be saved
            self._adapt()
        self._watch.look_for_pressed(solver, self._access.notices)
        self._emit(self._emission.in_time)

    def _emit(self, enter: Callable[[Solver, Insert], None]) -> None:
        """Have the emitters add what is due."""
        before = self._solver.count
        try:
            enter(self._solver, lambda new: self._insert(new, self._look(new)))
        except Exception:  # of a signal handler, say
            if self._solver.count != before:  # the discs are there, and the emitters' books do not know of them
                self._end()
            raise

    def _adapt(self) -> None:
        """Look at the speeds where there is reason to, and divide the frames to come as they need it."""
        solver = self._solver
        if not solver.capabilities.has_steps:
            return
        if solver.alarmed or self._watch.is_due(solver.frame, solver.count):
            with interrupts_held_back(), self._access.moving():
                solver.divide(self._watch.judge(solver, self._access.notices))

    def _look(self, new: insertion.NewDiscs) -> int:
        """Look at the speeds with new discs, and warn or refuse as is set. Returns the sub-steps from now on."""
        solver, notices = self._solver, self._access.notices
        with interrupts_held_back(), self._access.moving():
            return self._watch.judge(solver, notices, new)

    def _state(self) -> State:
        return self._solver.state()

    def _snapshot(self) -> tuple[Any, Any]:
        return self._solver.snapshot(), self._emission.progress

    def _restore(self, kept: tuple[Any, Any], new_workers: bool = True) -> None:
        snapshot, progress = kept
        before, choice = self._solver.choice, methods.choose(count_in(snapshot), self._settings)
        with interrupts_held_back(), self._access.moving():
            if methods.of_one_solver(before, choice):
                self._solver.restore(snapshot, choice, new_workers)
            else:
                self._succeed(choice, snapshot)
            methods.note_remark(choice, before, self._access.notices)
            self._emission.progress = progress
            self._pacer = Pacer(choice.workers, MOST_FRAMES)

    def _succeed(self, choice: Choice, snapshot: Snapshot, room: int = 0) -> None:
        """Put another solver in the place of the present one, where `auto` changes the method."""
        old, new = self._solver, methods.METHODS[choice.method].solver(self._scene, self._settings, choice)
        new.tallied = old.tallied
        self._closing.solvers.append(new)  # before there is anything to close
        try:
            new.restore(snapshot, choice, new_workers=True, room=room)
            self._watch.arm(new)
        except BaseException:
            self._closing.solvers.remove(new)
            new.close()
            raise
        self._solver = new
        self._closing.solvers.remove(old)
        old.close()

    def _between_frames(self, action: Callable[[], None]) -> None:
        """Do what may move to another block, on new workers if one has died. Signals wait: half a move is no state."""
        renew = (lambda: self._restore(self._snapshot())) if self._settings.on_worker_death == "restart" else None
        with interrupts_held_back(), self._access.moving():
            try:
                run_loop.retried_on_new_workers(action, renew, self._access.notices)
            except BaseException as error:
                if self._solver.torn or isinstance(error, (BusyError, WorkerDied, WorkerStalled)):  # left halfway
                    self._end()
                raise

    @exclusive
    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write everything that the next frame depends on to a file; `resume` goes on with the same bits.

        The file is whole or not there, whenever the process or the machine dies; the one before it is kept as
        <path>.previous. No pickle: reading it runs no code.

        Raises:
            OutputError: if it cannot be written; what was there before is untouched.
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
        with self._access.whole:
            solver = self._open_solver()
            run, arrays = {"frame": solver.frame, "emission": self._emission.progress}, solver.snapshot()
        return checkpoint_file.write(path, self._scene, self._settings, run, arrays)

    @classmethod
    def resume(
        cls, path: str | os.PathLike[str], *, workers: int | None = None, start_method: str | None = None
    ) -> "Simulation":
        """A simulation that goes on where `save` was called, with the same bits as if it had never stopped.

        Args:
            path: of the file. If it is damaged, the one before it is taken, with a CheckpointWarning that names both.
            workers, start_method: as in Settings; they change no bit.

        Raises:
            CheckpointError: if there is no whole file, or it is of a newer version.
        """
        found = checkpoint_file.read(path, checkpoint_validation.check)
        settings = dataclasses.replace(found.settings, workers=workers, start_method=start_method)
        try:
            with warnings.catch_warnings():
                for kind in (OverlapWarning, FastWarning):  # of the start, long ago
                    warnings.simplefilter("ignore", kind)
                sim = cls(found.scene, settings)
        except InputError as error:
            raise CheckpointError(
                f"the checkpoint {str(found.path)!r} must hold a scene and settings that go together; {error}"
            ) from error
        try:
            sim._restore((found.arrays, found.run["emission"]), new_workers=False)
            sim._watch = step_limits.Watch(found.scene, settings, sim._solver.capabilities.has_steps)
            sim._watch.arm(sim._solver)
        except BaseException:
            sim.close()
            raise
        return sim

    @exclusive
    def add(
        self,
        position: ArrayLike,
        velocity: ArrayLike,
        acceleration: ArrayLike | None = None,
        *,
        radius: ArrayLike | None = None,
        mass: ArrayLike | None = None,
    ) -> None:
        """Add one disc, or several.

        Args:
            position, velocity: shape (2,) or (K, 2); centres inside the box as it is now, clear of what stands in it
                [length], [length/time]. A new disc may overlap others: the next frames push them apart.
            acceleration: as position, only in a scene that has it; left out it is zero [length/time^2].
            radius, mass: one or one each; needed in a scene whose discs have one each, and only there. No disc may be
                larger than the largest of the scene [length], [mass].

        Raises:
            InputError: naming the argument, its rule and the value received; then nothing was added.
            TooFastError: as settings.on_fast says; then nothing was added either.
        """
        now = (self._settings.precision, self.time, self.radii)
        new = insertion.checked(self._scene, *now, position, velocity, acceleration, radius, mass)
        substeps = self._look(new)
        self._access.notices.give()  # where a filter makes an error of a warning, nothing is added
        self._insert(new, substeps)

    def _insert(self, new: insertion.NewDiscs, substeps: int) -> None:
        """Add discs that have been checked; the solver may then continue by another method."""
        count = self._solver.count + len(new.position)
        before, choice = self._solver.choice, methods.choose(count, self._settings)

        def grow() -> None:
            if not methods.of_one_solver(self._solver.choice, choice):
                self._succeed(choice, self._solver.snapshot(), count)
            self._solver.add(new, choice)
            if substeps != self._solver.substeps:
                self._solver.divide(substeps)

        self._between_frames(grow)
        methods.note_remark(choice, before, self._access.notices)
        if choice != before:
            self._pacer = Pacer(choice.workers, MOST_FRAMES)

    def __repr__(self) -> str:
        return f"<Simulation: of process {self._access.creator}>" if self._access.forked else self._described()

    @reading
    def _described(self) -> str:
        if not self._closing.alive:
            return f"<Simulation: closed after frame {self._last_frame}>"
        method = self._solver.choice.method
        return f"<Simulation: {self.count} discs by {method}, frame {self.frame}, time {self.time:g}>"

    @property
    @reading
    def array_names(self) -> tuple[str, ...]:
        """Names of the arrays in the shared block: those of features are there only where the scene has them."""
        return self._open_solver().array_names

    @property
    @reading
    def radii(self) -> NDArray[np.float64]:
        """Radius of each disc, those added included, shape (N,) [length]."""
        return self._open_solver().radii

    @property
    @reading
    def masses(self) -> NDArray[np.float64]:
        """Mass of each disc, those added included, shape (N,) [mass]."""
        return self._open_solver().masses

    @reading
    def columns(self) -> Columns:
        """Column of the grid that each disc is in, the worker that the column belongs to, and how many there are.

        Raises:
            InputError: for `naive` and `event`, which have no columns.
        """
        solver = self._open_solver()
        if not solver.capabilities.has_columns:
            raise InputError(
                "columns are there only in methods that sort discs into them, 'grid' and 'parallel'; this run is by "
                f"{solver.choice.method!r}. Use Settings(method='parallel', workers=...)."
            )
        return solver.columns()

    @property
    @reading
    def absorbed(self) -> NDArray[np.bool_]:
        """Which discs have left through an absorbing edge, shape (N,): they rest where they left, and meet nobody."""
        return self._open_solver().absorbed

    def _open_solver(self) -> Solver:
        self._access.demand_own_process()
        if not self._closing.alive:
            self._access.stop_if_over()
            raise ClosedError(
                f"this simulation was closed after frame {self._last_frame}. A closed simulation has no state. "
                "Use it inside its `with` block, take sim.state before, or make a new one."
            )
        return self._solver
