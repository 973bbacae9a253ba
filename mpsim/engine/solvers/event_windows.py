"""Runs windows of time on the tiles of the exact solver, with its workers."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.core.deferred_signals import interrupts_held_back
from mpsim.engine.workers.pool import WorkerPool
from mpsim.engine.workers.shared import SharedBlock
from mpsim.engine.workers.tiles import arguments_of
from mpsim.engine.workers.worker import load_kernels
from mpsim.kernels.events import records
from mpsim.kernels.events.windows import link, order_by_tiles, run_windows
from mpsim.kernels.layout import ABORT, RUNNING

PATIENCE = 30_000_000
"""Nanoseconds after which a command ends with the window in hand."""


class Windows:
    """Plays frames on the tiles of a block, by this process and, after `start`, workers.

    Args:
        block: with the arrays of tiles, and a store whose discs have been placed.
        system: the store, its box and features.
        start_method: as of a simulation.
    """

    def __init__(self, block: SharedBlock, system: Any, start_method: str | None):
        self._block = block
        self._arguments: Any = arguments_of(block.arrays, system.features, system.box)
        self._start_method = start_method
        self._pool: WorkerPool | None = None
        self._command: Any = np.zeros((), records.COMMAND)[()]
        self._is_linked = True

    @property
    def failed(self) -> bool:
        """Whether a window was left in the middle, as a worker has died or has not come."""
        shared = self._arguments.shared
        return bool(shared.plan.running and shared.control.signals[ABORT] != RUNNING)

    def start(self, workers: int) -> None:
        """Compile or load the kernels, and start so many workers, this process included."""
        with interrupts_held_back():
            load_kernels(self._block)
        if workers > 1:
            self._pool = WorkerPool(self._block, self._start_method)
            self._pool.start(workers)

    @property
    def workers(self) -> int:
        """Number of those that play, this process included."""
        return 1 + len(self.pids)

    def moved_to(self, block: SharedBlock, system: Any) -> "Windows":
        """Windows on the tiles of another block, for the same workers. The old block must stay open until it returns.

        Raises:
            WorkerDiedError: if one of them has ended. Then these windows can only be closed, before either block is.
        """
        moved = Windows(block, system, self._start_method)
        with interrupts_held_back():
            load_kernels(block)
        if self._pool is not None:
            self._pool.move_to(block)
        moved._pool, self._pool = self._pool, None
        return moved

    def close(self) -> None:
        """Stop the workers. May be called again."""
        pool, self._pool = self._pool, None
        if pool is not None:
            pool.stop()
        self._arguments = None

    @property
    def pids(self) -> list[int]:
        """Process numbers of the workers."""
        return [] if self._pool is None else self._pool.pids

    @property
    def counts(self) -> tuple[int, int, int]:
        """Windows played, those of them played again in parts, and by one worker for all."""
        plan = self._arguments.shared.plan
        return int(plan.windows), int(plan.again), int(plan.as_one)

    def play(
        self,
        frames: int,
        times: NDArray[np.int64],
        totals: NDArray[Any],
        stop: float,
        present: float,
        progress: Any,
        seen: Any,
    ) -> tuple[int, int, int]:
        """Play so many frames or fewer: as `advance_frames`; times: as of `run_windows`.

        present: the time that has been reached.

        Raises:
            WorkerDiedError, WorkerStalledError: if a worker has ended, or has not come.
        """
        self._order(present)
        self._arguments.shared.control.done = progress.frame
        self._command.frames, self._command.stop, self._command.patience = frames, stop, PATIENCE
        pool = self._pool
        if pool is not None:
            pool.wake()
        try:
            outcome = run_windows(*self._arguments, self._command, progress, seen, times, totals, 0, 0)
        finally:
            if pool is not None:
                pool.settle()
        if outcome[1] == records.ABORTED:
            assert pool is not None  # only its watcher, or a barrier, ends a window
            raise pool.failure()
        return outcome

    def link(self) -> None:
        """Make the store of the whole box one that can be played as a whole, and copied."""
        if not self._is_linked:
            with interrupts_held_back():  # between what is done and the word that it is
                link(self._arguments.whole, self._arguments.box, self._arguments.features, self._arguments.own.places)
                self._is_linked = True

    def _order(self, present: float) -> None:
        if self._is_linked:
            whole, features, box, shared, _ = self._arguments
            with interrupts_held_back():
                order_by_tiles(whole, box, features, shared.tiles, shared.plan)
                shared.times.reached = present
                self._is_linked = False
