"""Recovery after the death of a worker: back to the last snapshot in memory, then on with new workers."""

import time
from collections.abc import Callable
from typing import Any, NamedTuple

from mpsim.engine.notices import Notices
from mpsim.engine.run_record import Mark, RunRecord
from mpsim.errors import WorkerDiedError

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


class Kept(NamedTuple):
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
        self._kept: Kept | None = None
        self._due = 0.0
        self._deaths = 0

    def take(self) -> None:
        """Take a snapshot if it is time for one and there is anything new to keep."""
        started = time.perf_counter()
        is_new = self._kept is None or self._record.done > self._kept.mark.done
        is_changed = self._kept is not None and self._kept.changes != self._changes()
        if is_changed or (is_new and started >= self._due):
            self._kept = Kept(self._take(), self._record.mark(), self._changes())
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
