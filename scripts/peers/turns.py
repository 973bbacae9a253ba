"""Times engines in alternating runs with a reference program, so that load of the machine shows."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from peers.client import Client, FailedError

Tick = Callable[[str], None]
"""Called with what is being done, for progress."""


LATE = "not run: the time for all was up"


@dataclass(frozen=True)
class Effort:
    """How long is measured.

    Attributes:
        turns: how many, >= 1.
        seconds: of an engine's frames in one turn [s].
        budget: that an engine may take for one scene, its start included [s].
    """

    turns: int = 5
    seconds: float = 0.12
    budget: float = 10.0


@dataclass
class Timing:
    """Times of one engine on one scene.

    Attributes:
        frame: seconds of a frame, by turn.
        frames: in each turn.
        steps: of the engine, in a frame.
        setup: seconds until the start was in the engine.
    """

    frames: int
    steps: int
    setup: float
    frame: list[float] = field(default_factory=list)


Times = dict[str, "Timing | str"]
"""By `Client.key`: times, or why there are none."""


def quartiles(values: Sequence[float]) -> tuple[float, float, float]:
    """Lower quartile, median, upper quartile."""
    low, middle, high = np.percentile(np.asarray(values, dtype=np.float64), [25, 50, 75])
    return float(low), float(middle), float(high)


def ratios(yardstick: Timing, other: Timing) -> list[float]:
    """How many times faster than the yardstick, turn by turn."""
    return [y / o for y, o in zip(yardstick.frame, other.frame, strict=True)]


def calibrate(client: Client, effort: Effort) -> int:
    """Frames for one turn, after enough of them that everything is compiled and warm.

    Raises:
        FailedError: if the engine fails, or a frame takes more than its share of the budget.
    """
    client.run(1, effort.budget + 60)  # kernels may be compiled
    frames, taken = 1, client.run(1, effort.budget)
    while taken < effort.seconds / 4 and frames < 1 << 20:
        frames *= 4 if taken < effort.seconds / 16 else 2
        taken = client.run(frames, effort.budget)
    one = taken / frames
    if one * effort.turns > effort.budget:
        raise FailedError(
            f"left out: a frame takes {one:.1f} s; the limit is {effort.budget:.0f} s for {effort.turns} turns"
        )
    return max(1, round(effort.seconds / one))


def timed(client: Client, path: Path, dt: float, effort: Effort, knob: int = -1) -> Timing:
    """An engine with its start, ready for its turns.

    Raises:
        FailedError: as `calibrate`.
    """
    # Kernels that are compiled while an engine is made count with the first start only: give it room.
    made = client.prepare(path, dt, effort.budget + 60, knob=knob)
    return Timing(calibrate(client, effort), made["steps"], made["seconds"])


def by_turns(jobs: Sequence[tuple[str, Client, Timing]], effort: Effort, times: Times) -> None:
    """Run all jobs in each turn, each turn beginning with another; what fails gets its sentence in `times`, by key."""
    for turn in range(effort.turns):
        for shift in range(len(jobs)):
            key, client, timing = jobs[(turn + shift) % len(jobs)]
            if not isinstance(times[key], Timing):
                continue
            try:
                timing.frame.append(client.run(timing.frames, 3 * effort.budget) / timing.frames)
            except FailedError as failed:
                times[key] = str(failed)


def scene(clients: Sequence[Client], path: Path, dt: float, effort: Effort, known: "Known", tick: Tick) -> Times:
    """Times of each engine on one scene."""
    times: Times = {}
    jobs = []
    for client in clients:
        tick(client.peer.title)
        reason = known.too_long(client.key, effort)
        if reason:
            times[client.key] = reason
            continue
        try:
            timing = timed(client, path, dt, effort)
        except FailedError as failed:
            times[client.key] = str(failed)
            known.failed[client.key] = str(failed)
            continue
        known.add(client.key, timing)
        times[client.key] = timing
        jobs.append((client.key, client, timing))
    tick("turns")
    by_turns(jobs, effort, times)
    for _, client, _ in jobs:
        try:
            client.ask("drop", effort.budget + 20)
        except FailedError:
            client.close(now=True)
    return times


class Known:
    """What smaller scenes have told of how long an engine takes; ask it for growing counts."""

    def __init__(self) -> None:
        self.count = 0
        self.failed: dict[str, str] = {}
        self._seen: dict[str, list[tuple[int, float]]] = {}

    def add(self, key: str, timing: Timing) -> None:
        """Keep what a scene of `count` discs took to set up."""
        self._seen.setdefault(key, []).append((self.count, timing.setup))

    def too_long(self, key: str, effort: Effort) -> str:
        """Why an engine should not try `count` discs, in a sentence; "": it should."""
        if key in self.failed:
            return self.failed[key]
        seen = self._seen.get(key, [])
        if len(seen) < 2:
            return ""
        # What does not grow with the discs, such as loading a library, is in both.
        (fewer, short), (more, long) = seen[-2:]
        expected = long + max(0.0, long - short) / (more - fewer) * (self.count - more)
        if expected <= effort.budget:
            return ""
        return f"left out: {self.count:,} discs would take {expected:.0f} s to set up; limit {effort.budget:.0f} s"


def as_plain(times: Times) -> dict[str, Any]:
    """Times as JSON holds them."""
    return {key: value if isinstance(value, str) else vars(value) for key, value in times.items()}
