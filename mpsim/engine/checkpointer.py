"""Writes checkpoints during a run, and one more on SIGTERM."""

import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mpsim.core import checks
from mpsim.core.deferred_signals import Noted
from mpsim.engine.frame_count import MOST_FRAMES_OF_A_RUN
from mpsim.errors import InputError


class Checkpointer:
    """Writes checkpoints while a run continues, and one when the process is asked to end (SIGTERM).

    Whatever handled SIGTERM before does so again afterwards, also a handler in C.

    Args:
        save: writes one.
        path: where; None: no checkpoints, and SIGTERM is left alone.
        every: frames between two; None: `seconds` count.
        seconds: between two.
        any_of: whether what is said here is said in any of the processes that share the simulation; all ask alike.

    Raises:
        InputError: naming the argument of `run` that is out of range.
    """

    def __init__(
        self,
        save: Callable[[Path], Any],
        path: Path | None,
        every: int | None,
        seconds: float,
        any_of: Callable[[bool], bool],
    ):
        if every is not None:
            checks.whole("checkpoint_every", every, 1, MOST_FRAMES_OF_A_RUN, "Frames between two checkpoints.")
            if path is None:
                raise InputError(f"checkpoint_every needs checkpoint, the file to write; got {every!r} and no file.")
        self._save = save
        self._any_of = any_of
        self._path = path
        self._every = every
        self._seconds = checks.positive("checkpoint_seconds", seconds, "[s]")
        self._last = time.monotonic()
        self._frames = 0
        self._termination = Noted(signal.SIGTERM)

    def __enter__(self) -> "Checkpointer":
        if self._path is not None:
            self._termination.begin()
        return self

    def __exit__(self, kind: type[BaseException] | None, *exception: object) -> None:
        self._termination.end()
        if kind is None:
            if self._path is not None and self._any_of(self._termination.came):  # after the last look
                raise SystemExit(128 + signal.SIGTERM)
        elif self._termination.came and kind is not SystemExit:  # the run has ended otherwise
            self._termination.send_again()

    def frames_ahead(self, done: int) -> int:
        """Number of frames until the next checkpoint; very large if frames do not count."""
        if self._path is None or self._every is None:
            return 2**62
        return self._every - done % self._every

    def look(self, done: int, last: bool) -> None:
        """Write a checkpoint if it is time for one, or the last frame is done, or the process is to end.

        Raises:
            SystemExit: with 143, after SIGTERM and its checkpoint.
        """
        if self._path is None:
            return
        by_frames = self._every is not None and done - self._frames >= self._every
        by_time = self._every is None and time.monotonic() - self._last >= self._seconds
        asked_to_end = self._any_of(self._termination.came)
        if self._any_of(by_frames or by_time) or last or asked_to_end:
            self._save(self._path)
            self._last, self._frames = time.monotonic(), done
        if asked_to_end:
            raise SystemExit(128 + signal.SIGTERM)
