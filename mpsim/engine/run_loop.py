"""The loop of a run: slices of frames, and between them observers, checkpoints, progress and readers."""

from collections.abc import Callable
from typing import Generic

from mpsim.engine.access import Access
from mpsim.engine.checkpointer import Checkpointer
from mpsim.engine.coordinator import Coordinator
from mpsim.engine.observers import Observed, Observers
from mpsim.engine.recovery import RecoverySnapshots
from mpsim.engine.run_record import RunRecord


class RunLoop(Generic[Observed]):
    """One run of a simulation.

    Args:
        sim: which observers look at.
        coordinator, access: of the simulation.
        record: of the run.
        observers, checkpoints: what happens between slices.
        progress: called as progress(done, of_frames) after each slice; None: nobody asks.
    """

    def __init__(
        self,
        sim: Observed,
        coordinator: Coordinator,
        access: Access,
        record: RunRecord,
        observers: Observers[Observed],
        checkpoints: Checkpointer,
        progress: Callable[[int, int], None] | None,
    ):
        self._sim = sim
        self._coordinator = coordinator
        self._access = access
        self._record = record
        self._observers = observers
        self._checkpoints = checkpoints
        self._progress = progress

    def run(self, frames: int, recovery: RecoverySnapshots | None) -> None:
        """Run so many frames; if workers die, return to the snapshots of `recovery`, where there are any."""
        record, access = self._record, self._access
        with access.callbacks():
            if record.whole:
                self._observers.look(self._sim, 0)
            if not frames:
                self._checkpoints.look(0, last=True)
        while record.done < frames:
            ahead = min(frames - record.done, self._checkpoints.frames_ahead(record.done))
            access.let_readers_in()
            with access.whole:
                access.waiting = False
                before = self._coordinator.open_solver().frame  # which says so if an observer has closed it
                self._coordinator.advance(min(ahead, self._observers.frames_ahead(before)), record, recovery)
                done = self._coordinator.solver.frame > before
            with access.callbacks():
                access.notices.give()
                if done:
                    self._observers.look(self._sim, record.collisions)
                self._checkpoints.look(record.done, last=record.done == frames)
                if self._progress is not None:
                    self._progress(record.done, frames)
