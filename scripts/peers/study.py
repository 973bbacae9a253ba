"""What is measured: frame times in alternating runs, and costs at given errors.

The error of an engine is that of its pressure: the impulse on the walls over time and perimeter, of runs of TIME from
several starts, relative to that of mpsim's exact solver from the same starts. Nothing is divided by the energy that an
engine has left: what it loses is in its error. The scatter between starts gives the standard error.
"""

import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import mpsim
from peers.client import Client, FailedError
from peers.engine import Start
from peers.registry import PEERS, YARDSTICKS, Peer

RADIUS = 0.5
EXACT = "mpsim-event"

LATE = "not run: the time for all was up"

LIMITS = (0.01, 0.1)
"""Errors of the pressure that are asked for, relative."""

STEPS = (0.1, 0.05, 0.02, 0.01, 0.005, 0.002)
"""Steps that are tried, v dt [diameters]."""

TIME = 20.0
"""Length of a run [diameters / v]."""

SETTLE = 1.0
"""Time before it: soft discs must first share their energy with their springs [diameters / v]."""

EXACT_LONGER = 5
"""So many times longer are the runs of the exact solver, whose error must be the smaller."""

LEAST_STARTS = 3
"""Fewer finished runs give no error bar, and no answer."""

FULL: dict[str, Any] = {
    "peers": tuple(PEERS),
    "counts": (100, 1_000, 10_000, 100_000, 1_000_000),
    "packings": (0.1, 0.4, 0.7),
    "steps": (0.02, 0.002),
    "turns": 5,
    "seconds": 0.12,
    "budget": 10.0,
    "minutes": 25.0,
    "accurate": 1_000,
    "point": 8.0,
    "cost_count": 10_000,
    "starts": 12,
    "accurate_steps": STEPS,
}
"""What is asked for: names of engines; numbers of discs, packings and steps of the scenes; turns, seconds of an engine
in a turn, and those that it may take for one scene with its start; minutes after which nothing new is begun; discs with
which errors are found (0: no such table), seconds for one point of an engine, discs with which frames are timed for it,
runs of each point, and steps tried."""

QUICK = FULL | {
    "peers": ("cpp", "numba", "mpsim-push", EXACT, "numpy"),  # the exact solver has the pressure for comparison
    "counts": (100,),
    "packings": (0.4,),
    "steps": (0.02,),
    "turns": 2,
    "seconds": 0.01,
    "accurate": 100,
    "point": 2.0,
    "cost_count": 100,
    "starts": 3,
    "accurate_steps": (0.1, 0.05),
}

Timing = dict[str, Any]
"""Of one engine on one scene: `frames` of a turn, `setup`, the seconds until the start was in it, and `frame`, seconds
of a frame by turn."""

Times = dict[str, Timing | str]
"""By `Client.key`: times, or why there are none."""


# --- frames, in alternating runs with a reference program, so that load of the machine shows


def ratios(yardstick: Timing, other: Timing) -> list[float]:
    """How many times faster than the yardstick, turn by turn."""
    return [y / o for y, o in zip(yardstick["frame"], other["frame"], strict=True)]


def timed(client: Client, path: Path, dt: float, asked: dict[str, Any], knob: int = -1) -> Timing:
    """An engine with its start, ready for its turns, after enough frames that everything is compiled and warm.

    Raises:
        FailedError: if the engine fails, or a frame takes more than its share of the budget.
    """
    budget, turns, seconds = asked["budget"], asked["turns"], asked["seconds"]
    # Kernels that are compiled while an engine is made count with the first start only: give it room.
    setup = client.prepare(path, dt, budget + 60, knob=knob)
    client.run(1, budget + 60)  # kernels may be compiled
    frames, taken = 1, client.run(1, budget)
    while taken < seconds / 4 and frames < 1 << 20:
        frames *= 4 if taken < seconds / 16 else 2
        taken = client.run(frames, budget)
    one = taken / frames
    if one * turns > budget:
        raise FailedError(f"left out: a frame takes {one:.1f} s; the limit is {budget:.0f} s for {turns} turns")
    return {"frames": max(1, round(seconds / one)), "setup": setup, "frame": []}


def by_turns(jobs: Sequence[tuple[str, Client]], asked: dict[str, Any], times: Times) -> None:
    """Run all jobs in each turn, each turn beginning with another; what fails gets its sentence in `times`, by key."""
    for turn in range(asked["turns"]):
        for shift in range(len(jobs)):
            key, client = jobs[(turn + shift) % len(jobs)]
            timing = times[key]
            if isinstance(timing, str):
                continue
            try:
                timing["frame"].append(client.run(timing["frames"], 3 * asked["budget"]) / timing["frames"])
            except FailedError as failed:
                times[key] = str(failed)


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


# --- errors of the pressure


class Point(NamedTuple):
    """One engine at one step.

    Attributes:
        dt: step [diameters / v].
        knob: the engine's setting of effort.
        pressure: mean over the starts [mass / time^2].
        scatter: its standard error.
        drift: relative change of the kinetic energy per unit of time, mean over the starts.
        starts: how many were run in the time there was.
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


def one_run(client: Client, path: Path, dt: float, knob: int, longer: float, budget: float) -> tuple[float, float]:
    """Pressure of a run from one start, and the drift of the energy were it always the same."""
    start = Start.load(path)
    client.prepare(path, dt, budget + 60, counting=True, knob=knob)
    client.run(max(1, round(SETTLE / dt)), 3 * budget + 60)
    before, frames = client.ask("measure", budget + 60), round(TIME * longer / dt)
    client.run(frames, 3 * budget + 60)
    after, duration = client.ask("measure", budget + 60), frames * dt
    pressure = (after["impulse"] - before["impulse"]) / duration / (2 * (start.width + start.height))
    return pressure, math.expm1(math.log(max(after["energy"], 1e-300) / before["energy"]) / duration)


def point(client: Client, paths: Sequence[Path], dt: float, knob: int, budget: float, longer: float = 1) -> Point:
    """Pressure and drift of an engine at one step, of as many starts as `budget` seconds allow.

    Raises:
        FailedError: if the engine fails, or has finished fewer than LEAST_STARTS in that time.
    """
    client.prepare(paths[0], dt, budget + 60, counting=True, knob=knob)
    client.run(1, budget + 60)  # what is to be compiled is not of the budget
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


def longest(points: Sequence[Point], exact: Point, limit: float) -> Point | None:
    """The point of the longest step that is within the limit with all shorter ones that were tried."""
    answer = None
    for each in sorted(points, key=lambda each: each.dt):
        if abs(each.error(exact)) > limit:
            break
        answer = each
    return answer


# --- a study


class Study:
    """A study that runs; `record` is what it has found.

    Args:
        asked: see FULL.
        folder: for starts and messages.
        tick: called with what is being done, for progress.
        save: called with the record whenever there is more in it.
        record: what it has before.
    """

    def __init__(
        self,
        asked: dict[str, Any],
        folder: Path,
        tick: Callable[[str], None],
        save: Callable[[dict[str, Any]], None],
        record: dict[str, Any],
    ):
        self.asked, self.folder, self.tick, self.record = asked, folder, tick, record
        self._save, self._clients = save, dict[str, Client]()
        self._begun = time.monotonic()

    def run(self) -> dict[str, Any]:
        """Everything that was asked for, the most wanted first."""
        self._look_for_peers()
        packings, steps = self.asked["packings"], self.asked["steps"]
        main = min(packings, key=lambda each: abs(each - 0.4)), min(steps, key=lambda each: abs(each - 0.02))
        self.record["cells"] = []
        now = True
        try:
            self._frames(*main)
            if self.asked["accurate"]:
                self._accuracy(main[0])
            for packing in packings:
                for step in steps:
                    if (packing, step) != main:
                        self._frames(packing, step)
            now = False
        finally:
            for client in self._clients.values():
                client.close(now)
        self._keep()
        return self.record

    def _is_late(self) -> bool:
        return time.monotonic() > self._begun + 60 * self.asked["minutes"]

    def _keep(self) -> None:
        self.record["minutes"] = (time.monotonic() - self._begun) / 60
        self._save(self.record)

    def _look_for_peers(self) -> None:
        self.tick("looking for engines")
        found = {}
        for name in self.asked["peers"]:
            missing = PEERS[name].why_missing()
            found[name] = {"missing": missing, "version": "" if missing else PEERS[name].version()}
        there = [name for name in YARDSTICKS if name in found and not found[name]["missing"]]
        effort = {name: self.asked[name] for name in ("turns", "seconds", "budget")}
        self.record |= {"peers": found, "yardstick": there[0] if there else "", "effort": effort}

    def _client(self, peer: Peer, threads: int) -> Client:
        client = Client(peer, threads, self.folder)
        return self._clients.setdefault(client.key, client)

    def _present(self) -> list[Peer]:
        """Engines that are there, the yardstick first."""
        names = [name for name, found in self.record["peers"].items() if not found["missing"]]
        return [PEERS[name] for name in sorted(names, key=lambda name: name != self.record["yardstick"])]

    def _start(self, count: int, packing: float, seed: int = 1) -> Path:
        path = self.folder / f"start-{count}-{packing:g}-{seed}.npz"
        if not path.exists():
            self.tick(f"a start of {count:,} discs")
            scene = mpsim.Scene.random(count=count, packing=packing, radius=RADIUS, temperature=1.0, seed=seed)
            Start(scene.width, scene.height, RADIUS, scene.position, scene.velocity).save(path)
        return path

    def _frames(self, packing: float, step: float) -> None:
        """Times of frames at one packing and step, for growing counts."""
        clients = [self._client(peer, threads) for peer in self._present() if peer.steps for threads in peer.threads]
        setups: dict[str, list[tuple[int, float]]] = {client.key: [] for client in clients}
        failed: dict[str, str] = {}
        budget = self.asked["budget"]
        for count in sorted(self.asked["counts"]):
            times: Times = {}
            path = Path() if self._is_late() else self._start(count, packing)
            for client in clients:
                key = client.key
                reason = LATE if self._is_late() else failed.get(key) or too_long(setups[key], count, budget)
                if reason:
                    times[key] = reason
                    continue
                self.tick(f"{count:,} discs, packing {packing:g}, v·dt {step:g}: {client.peer.title}")
                try:
                    times[key] = timing = timed(client, path, step * 2 * RADIUS, self.asked)
                    setups[key].append((count, timing["setup"]))
                except FailedError as error:
                    times[key] = failed[key] = str(error)
            self.tick(f"{count:,} discs, packing {packing:g}, v·dt {step:g}: turns")
            jobs = [(client.key, client) for client in clients if isinstance(times[client.key], dict)]
            by_turns(jobs, self.asked, times)
            for _, client in jobs:
                try:
                    client.ask("drop", budget + 20)
                except FailedError:
                    client.close(now=True)
            self.record["cells"].append({"count": count, "packing": packing, "step": step, "times": times})
            self._keep()

    def _accuracy(self, packing: float) -> None:
        """Costs at given errors."""
        count, steps, seconds = self.asked["accurate"], self.asked["accurate_steps"], self.asked["point"]
        paths = [self._start(count, packing, 1 + number) for number in range(self.asked["starts"])]
        self.tick("the exact pressure")
        exact = point(self._client(PEERS[EXACT], 1), paths, 1.0, 0, 10 * seconds, EXACT_LONGER)
        series: dict[str, list[dict[str, Any]]] = {}
        wanted: dict[tuple[str, Point], None] = {}
        for peer in sorted(self._present(), key=list(PEERS.values()).index):
            if not peer.accuracy or not peer.steps:
                continue
            series[peer.name] = []
            for knob in peer.knobs:
                points, ended = self._series(peer, knob, paths, exact)
                series[peer.name].append({"points": [each._asdict() for each in points], "ended": ended})
                found = (longest(points, exact, limit) for limit in LIMITS)
                wanted |= {(peer.name, each): None for each in found if each}
        self.record["accuracy"] = {
            "count": count,
            "cost_count": self.asked["cost_count"],
            "packing": packing,
            "steps": list(steps),
            "exact": exact._asdict(),
            "series": series,
        }
        self._keep()
        self._costs(list(wanted), packing)

    def _series(self, peer: Peer, knob: int, paths: Sequence[Path], exact: Point) -> tuple[list[Point], str]:
        """Points at ever shorter steps, until two in turn are within the least limit; and why it ended early, or ""."""
        found: list[Point] = []
        for dt in self.asked["accurate_steps"]:
            if self._is_late():
                return found, LATE
            self.tick(f"error of {peer.title}{peer.effort(knob)}, v·dt {dt:g}")
            try:
                found.append(point(self._client(peer, 1), paths, dt, knob, self.asked["point"]))
            except FailedError as failed:
                return found, str(failed)
            if len(found) > 1 and all(abs(each.error(exact)) <= min(LIMITS) for each in found[-2:]):
                break
        return found, ""

    def _costs(self, wanted: Sequence[tuple[str, Point]], packing: float) -> None:
        """Times of frames at the steps that were found, and of the exact solver, each in a process of its own."""
        self.tick("what the steps cost")
        if not self.record["yardstick"]:
            return
        path, times = self._start(self.asked["cost_count"], packing), Times()
        pairs = {"yardstick": (self.record["yardstick"], Point(0.02, 0))}
        pairs |= {f"{name} {each.dt:g} {each.knob}": (name, each) for name, each in [*wanted, (EXACT, Point(1.0, 0))]}
        clients = {key: Client(PEERS[name], 1, self.folder) for key, (name, _) in pairs.items()}
        self._clients |= {f"cost {key}": client for key, client in clients.items()}
        for key, client in clients.items():
            try:
                times[key] = timed(client, path, pairs[key][1].dt, self.asked, pairs[key][1].knob)
            except FailedError as failed:
                times[key] = str(failed)
        by_turns(list(clients.items()), self.asked, times)
        for client in clients.values():
            client.close()
        self.record["accuracy"]["costs"] = times
        self._keep()
