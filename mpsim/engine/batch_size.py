"""Number of frames of the next command, and number of workers that run it."""

import math
import statistics
from collections import deque

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
