"""The run loop: slices of frames, with observers, checkpoints, progress and readers between them."""

from collections.abc import Callable
from typing import Generic, NamedTuple

from mpsim.engine.access import Access
from mpsim.engine.checkpointer import Checkpointer
from mpsim.engine.coordinator import Coordinator
from mpsim.engine.interruption import Interruption
from mpsim.engine.observers import Observed, Observers
from mpsim.engine.run_record import RunRecord


class BetweenSlices(NamedTuple, Generic[Observed]):
    """What happens between two slices of a run.

    Attributes:
        sim: at which observers look.
        observers, checkpoints: those of the run.
        progress: called as progress(done, of_frames); None: nobody asks.
        interruption: Ctrl-C, where processes share the run.
    """

    sim: Observed
    observers: Observers[Observed]
    checkpoints: Checkpointer
    progress: Callable[[int, int], None] | None
    interruption: Interruption


def run_frames(
    frames: int, coordinator: Coordinator, access: Access, record: RunRecord, between: BetweenSlices[Observed]
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
