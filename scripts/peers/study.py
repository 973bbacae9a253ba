"""What is measured: frame times in alternating runs, and costs at given errors.

The error of an engine is that of its pressure: the impulse on the walls over time and perimeter, of runs of TIME from
several starts, relative to that of mpsim's exact solver from the same starts. Nothing is divided by the energy that an
engine has left: what it loses is in its error. The scatter between starts gives the standard error.
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from peers.engine import Start
from peers.engines import PEERS, Client, FailedError

import mpsim

RADIUS = 0.5
EXACT = "mpsim-event"
STEP = 0.02
"""Step of the first tables, v dt [diameters]."""

CALLS = {
    "run": "many frames a call",
    "step": "one",
    "watch": "one, and positions and velocities read after it",
}
"""How frames are asked for, by the command of the engine."""

LIMITS = (0.01, 0.1)
"""Errors of the pressure that are asked for, relative."""

TIME, SETTLE = 20.0, 1.0
"""Length of a run, and time before it: soft discs must first share their energy with their springs [diameters / v]."""

EXACT_LONGER = 5
"""Factor of the length of runs of the exact solver, whose error must be the smaller."""

LEAST_STARTS = 3
"""Fewer finished runs give no error bar, and no answer."""


@dataclass(frozen=True)
class Effort:
    """What is asked for.

    Attributes:
        peers: names of engines.
        counts, packings: of the scenes of the first tables.
        turns, seconds: number of turns, and time of an engine in one [s].
        budget: time of an engine for one scene with its start [s].
        accurate: discs with which errors are found; 0: no second table.
        point, starts: time for one step of an engine [s], and its runs at most.
        steps: tried for the second table, v dt [diameters].
        cost_count: discs with which frames are timed for the second table.
        game: numbers of discs of the table of game loops.
    """

    peers: Sequence[str] = tuple(PEERS)
    counts: Sequence[int] = (100, 1_000, 10_000, 100_000, 1_000_000)
    packings: Sequence[float] = (0.4, 0.7)
    turns: int = 5
    seconds: float = 0.12
    budget: float = 10.0
    accurate: int = 1_000
    point: float = 20.0
    starts: int = 12
    steps: Sequence[float] = (0.1, 0.05, 0.02, 0.01, 0.005, 0.002)
    cost_count: int = 10_000
    game: Sequence[int] = (100, 300, 1_000, 3_000, 100_000)


QUICK = Effort(
    ("cpp", "mpsim-push", EXACT, "numpy"), (100,), (0.4,), 2, 0.01, 10.0, 100, 2.0, 3, (0.1, 0.05), 100, (100,)
)  # fmt: skip


class Timing(NamedTuple):
    """Times of an engine on one scene: frames of a turn, set-up [s], and a frame by turn [s]."""

    frames: int
    setup: float
    frame: list[float]


Times = dict[tuple[str, int], Timing | str]
"""By engine and threads: times, or why there are none."""


class Point(NamedTuple):
    """One engine at one step.

    Attributes:
        dt: step [diameters / v].
        knob: the engine's setting of effort.
        pressure: mean over the starts [mass / time^2].
        scatter: its standard error.
        drift: relative change of the kinetic energy per unit of time, mean over the starts.
        starts: number of runs.
    """

    dt: float
    knob: int
    pressure: float = 0.0
    scatter: float = 0.0
    drift: float = 0.0
    starts: int = 0

    def error(self, exact: "Point") -> float:
        """Relative error of the pressure."""
        return self.pressure / exact.pressure - 1

    def uncertainty(self, exact: "Point") -> float:
        """Standard error of `error`."""
        return math.hypot(self.scatter, exact.scatter) / exact.pressure


@dataclass
class Accuracy:
    """Costs at given errors.

    Attributes:
        exact: what the exact solver has found.
        series: for each engine and effort the points at ever shorter steps, and why they end early, or "".
        costs: of a disc and unit of time by engine and point [ns], or why there are none.
    """

    exact: Point
    series: dict[str, list[tuple[list[Point], str]]] = field(default_factory=dict)
    costs: dict[tuple[str, Point], float | str] = field(default_factory=dict)

    def within(self, name: str, limit: float) -> list[Point]:
        """For each effort the longest step that is within a limit with all shorter ones that were tried."""
        found = []
        for points, _ in self.series[name]:
            best = None
            for each in sorted(points):
                if abs(each.error(self.exact)) > limit:
                    break
                best = each
            found += [best] if best else []
        return found


# --- frames, in alternating runs with a reference program, so that load of the machine shows


def timed(client: Client, path: Path, dt: float, effort: Effort, knob: int = -1, what: str = "run") -> Timing:
    """An engine with its start, ready for its turns, after enough frames that everything is compiled and warm.

    Raises:
        FailedError: if the engine fails, or a frame takes more than its share of the budget.
    """
    budget = effort.budget
    # Kernels that are compiled while an engine is made count with the first start only: give it room.
    setup = client.prepare(path, dt, budget + 60, knob=knob)
    client.ask(what, budget + 60, 1)
    frames, taken = 1, client.ask(what, budget, 1)
    while taken < effort.seconds / 4 and frames < 1 << 20:
        frames *= 4 if taken < effort.seconds / 16 else 2
        taken = client.ask(what, budget, frames)
    one = taken / frames
    if one * effort.turns > budget:
        raise FailedError(f"left out: a frame takes {one:.1f} s; the limit is {budget:.0f} s for {effort.turns} turns")
    return Timing(max(1, round(effort.seconds / one)), setup, [])


def by_turns(jobs: Mapping[Client, Timing], effort: Effort, what: str = "run") -> dict[Client, Timing | str]:
    """Run all jobs in each turn, each turn beginning with another; the words of an error for what fails."""
    order, failed = list(jobs), {}
    for turn in range(effort.turns):
        for shift in range(len(order)):
            client = order[(turn + shift) % len(order)]
            if client in failed:
                continue
            timing = jobs[client]
            try:
                timing.frame.append(client.ask(what, 3 * effort.budget, timing.frames) / timing.frames)
            except FailedError as error:
                failed[client] = str(error)
    return {**jobs, **failed}


def too_long(setups: Sequence[tuple[int, float]], count: int, budget: float) -> str:
    """Why an engine should not try `count` discs, from what smaller scenes took to set up; "": it should."""
    if len(setups) < 2:
        return ""
    # What does not grow with the discs, such as loading a library, is in both.
    (fewer, short), (more, long) = setups[-2:]
    expected = long + max(0.0, long - short) / (more - fewer) * (count - more)
    if expected <= budget:
        return ""
    return f"left out: {count:,} discs would take {expected:.0f} s to set up; limit {budget:.0f} s"


class Study:
    """Measurements of the engines that are present, the yardstick first.

    Args:
        effort: what is asked for.
        folder: for starts and messages.
        tick: called with what is being done, for progress.
    """

    def __init__(self, effort: Effort, folder: Path, tick: Callable[[str], None]):
        self.effort, self.folder, self._tick = effort, folder, tick
        self.missing = {name: PEERS[name].why_missing() for name in PEERS if name in effort.peers}
        self.present = [name for name, why in self.missing.items() if not why]

    def frames(self, packing: float, counts: Sequence[int], what: str = "run") -> dict[int, Times]:
        """Times of frames by number of discs; one a call only on one thread."""
        clients = [
            Client(name, threads, self.folder / f"{name}-{threads}.log")
            for name in self.present if PEERS[name].steps
            for threads in PEERS[name].threads if threads == 1 or what == "run"
        ]  # fmt: skip
        setups: dict[Client, list[tuple[int, float]]] = {client: [] for client in clients}
        failed: dict[Client, str] = {}
        found: dict[int, Times] = {}
        for count in sorted(counts):
            path, jobs = self._start(count, packing), {}
            reasons = {}
            for client in clients:
                reason = failed.get(client) or too_long(setups[client], count, self.effort.budget)
                if reason:
                    reasons[client] = reason
                    continue
                self._tick(f"{count:,} discs, packing {packing:g}: {client.peer.title}")
                try:
                    jobs[client] = timed(client, path, STEP * 2 * RADIUS, self.effort, what=what)
                    setups[client].append((count, jobs[client].setup))
                except FailedError as error:
                    reasons[client] = failed[client] = str(error)
            self._tick(f"{count:,} discs, packing {packing:g}: turns")
            results = reasons | by_turns(jobs, self.effort, what)
            found[count] = {(client.name, client.threads): results[client] for client in clients}
            for client in jobs:
                with suppress(FailedError):
                    client.ask("drop", self.effort.budget + 20)
        for client in clients:
            client.close()
        return found

    def accuracy(self, packing: float) -> Accuracy:
        """Costs at given errors."""
        effort = self.effort
        paths = [self._start(effort.accurate, packing, 1 + number) for number in range(effort.starts)]
        self._tick("the exact pressure")
        log = self.folder / "accuracy.log"
        solver = Client(EXACT, 1, log)
        found = Accuracy(self._point(solver, paths, 1.0, 0, 10 * effort.point, EXACT_LONGER))
        solver.close()
        for name in self.present:
            if PEERS[name].steps:
                client = Client(name, 1, log)
                found.series[name] = [self._series(client, knob, paths, found.exact) for knob in PEERS[name].knobs]
                client.close()
        wanted = {(name, each) for name in found.series for limit in LIMITS for each in found.within(name, limit)}
        found.costs = self._costs(sorted(wanted | {(EXACT, Point(1.0, 0))}), packing)
        return found

    def _start(self, count: int, packing: float, seed: int = 1) -> Path:
        path = self.folder / f"start-{count}-{packing:g}-{seed}.npz"
        if not path.exists():
            self._tick(f"a start of {count:,} discs")
            scene = mpsim.Scene.random(count=count, packing=packing, radius=RADIUS, temperature=1.0, seed=seed)
            Start(scene.width, scene.height, RADIUS, scene.position, scene.velocity).save(path)
        return path

    def _series(self, client: Client, knob: int, paths: Sequence[Path], exact: Point) -> tuple[list[Point], str]:
        """Points at ever shorter steps, until two in turn are within the least limit; and why it ended early, or ""."""
        found: list[Point] = []
        for dt in self.effort.steps:
            self._tick(f"error of {client.peer.title}{client.peer.effort(knob)}, v·dt {dt:g}")
            try:
                found.append(self._point(client, paths, dt, knob, self.effort.point))
            except FailedError as failed:
                return found, str(failed)
            if len(found) > 1 and all(abs(each.error(exact)) <= min(LIMITS) for each in found[-2:]):
                break
        return found, ""

    @staticmethod
    def _point(client: Client, paths: Sequence[Path], dt: float, knob: int, budget: float, longer: float = 1) -> Point:
        """Pressure and drift of an engine at one step, of as many starts as `budget` seconds allow.

        Raises:
            FailedError: if the engine fails, or has finished fewer than LEAST_STARTS in that time.
        """
        client.prepare(paths[0], dt, budget + 60, counting=True, knob=knob)
        client.ask("run", budget + 60, 1)  # compiling is not part of the budget
        found, begun = [], time.monotonic()
        for path in paths:
            found.append(one_run(client, path, dt, knob, longer, budget))
            if (time.monotonic() - begun) * (1 + 1 / len(found)) > budget:
                break
        if len(found) < LEAST_STARTS:
            raise FailedError(f"{budget:.0f} s were enough for {len(found)} of {LEAST_STARTS} runs at v·dt = {dt:g}")
        pressure, drift = np.array(found).T
        scatter = float(pressure.std(ddof=1)) / math.sqrt(len(found))
        return Point(dt, knob, float(pressure.mean()), scatter, float(drift.mean()), len(found))

    def _costs(self, wanted: Sequence[tuple[str, Point]], packing: float) -> dict[tuple[str, Point], float | str]:
        """Costs of a disc and unit of time at the steps that were found [ns], each in a process of its own."""
        self._tick("what the steps cost")
        count, jobs = self.effort.cost_count, {}
        clients = {key: Client(key[0], 1, self.folder / "costs.log") for key in wanted}
        failed: dict[Client, str] = {}
        for (_, point), client in zip(wanted, clients.values(), strict=True):
            try:
                jobs[client] = timed(client, self._start(count, packing), point.dt, self.effort, point.knob)
            except FailedError as error:
                failed[client] = str(error)
        found = failed | by_turns(jobs, self.effort)
        for client in clients.values():
            client.close()
        timings = {key: found[client] for key, client in clients.items()}
        return {
            key: each if isinstance(each, str) else float(np.median(each.frame)) * 1e9 / count / key[1].dt
            for key, each in timings.items()
        }


def one_run(client: Client, path: Path, dt: float, knob: int, longer: float, budget: float) -> tuple[float, float]:
    """Pressure of a run from one start, and the drift of the energy per unit of time."""
    start = Start.load(path)
    client.prepare(path, dt, budget + 60, counting=True, knob=knob)
    client.ask("run", 3 * budget + 60, max(1, round(SETTLE / dt)))
    impulse, energy = client.ask("measure", budget + 60)
    frames = round(TIME * longer / dt)
    client.ask("run", 3 * budget + 60, frames)
    later, left = client.ask("measure", budget + 60)
    duration = frames * dt
    pressure = (later - impulse) / duration / (2 * (start.width + start.height))
    return pressure, math.expm1(math.log(max(left, 1e-300) / energy) / duration)
