"""The record of a study: frame times in alternating runs, and costs at given errors."""

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import mpsim
from peers import accuracy, turns
from peers.accuracy import Point
from peers.client import Client, FailedError
from peers.engine import Start
from peers.registry import PEERS, YARDSTICKS, Peer
from peers.turns import LATE, Effort, Tick, Times, Timing

RADIUS = 0.5

EXACT = "mpsim-event"


@dataclass(frozen=True)
class Asked:
    """What is to be measured.

    Attributes:
        peers: names of engines.
        counts: numbers of discs.
        packings: packing fractions.
        steps: v dt [diameters], v being the thermal speed of one component.
        effort: of timing frames.
        minutes: after which nothing new is begun.
        accurate_count: discs with which errors are found; 0: no such table.
        cost_count: discs with which frames are timed for it.
        starts: runs of each point.
        point_seconds: for one point of an engine.
        accurate_steps: steps tried.
    """

    peers: Sequence[str]
    counts: Sequence[int]
    packings: Sequence[float]
    steps: Sequence[float]
    effort: Effort
    minutes: float = 25.0
    accurate_count: int = 1_000
    cost_count: int = 10_000
    starts: int = 12
    point_seconds: float = 8.0
    accurate_steps: Sequence[float] = accuracy.STEPS


@dataclass
class Study:
    """A study that runs; `record` is what it has found.

    Attributes:
        folder: for starts and messages.
        save: called with the record whenever there is more in it.
    """

    asked: Asked
    folder: Path
    tick: Tick
    save: Callable[[dict[str, Any]], None]
    record: dict[str, Any] = field(default_factory=dict)
    late: float = 0.0
    _clients: dict[str, Client] = field(default_factory=dict)

    def run(self) -> dict[str, Any]:
        """Everything that was asked for, the most wanted first."""
        self.late = time.monotonic() + 60 * self.asked.minutes
        self._look_for_peers()
        asked = self.asked
        try:
            main = (_nearest(asked.packings, 0.4), _nearest(asked.steps, 0.02))
            self.record["cells"] = []
            self._frames(*main)
            if asked.accurate_count:
                self._accuracy(main[0])
            for packing in asked.packings:
                for step in asked.steps:
                    if (packing, step) != main:
                        self._frames(packing, step)
        except BaseException:
            self.close(now=True)
            raise
        self.close()
        self._keep()
        return self.record

    def _keep(self) -> None:
        self.record["minutes"] = self.asked.minutes + (time.monotonic() - self.late) / 60
        self.save(self.record)

    def close(self, now: bool = False) -> None:
        """End the processes of all engines; now: in the middle of what they do."""
        for client in self._clients.values():
            client.close(now)
        self._clients.clear()

    def _look_for_peers(self) -> None:
        self.tick("looking for engines")
        found = {}
        for name in self.asked.peers:
            peer = PEERS[name]
            missing = peer.why_missing()
            found[name] = {"missing": missing, "version": "" if missing else peer.version()}
        there = [name for name in YARDSTICKS if found.get(name, {"missing": "x"})["missing"] == ""]
        effort = asdict(self.asked.effort)
        self.record |= {"peers": found, "yardstick": there[0] if there else "", "effort": effort}

    def _client(self, peer: Peer, threads: int) -> Client:
        client = Client(peer, threads, self.folder)
        return self._clients.setdefault(client.key, client)

    def _present(self) -> list[Peer]:
        """Engines that are there, the yardstick first."""
        found = self.record["peers"]
        names = [name for name in self.asked.peers if not found[name]["missing"]]
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
        known = turns.Known()
        for count in sorted(self.asked.counts):
            cell: dict[str, Any] = {"count": count, "packing": packing, "step": step}
            times: Times = {client.key: LATE for client in clients}
            if time.monotonic() < self.late:
                known.count = count
                what = f"{count:,} discs, packing {packing:g}, v·dt {step:g}: "

                def tick(word: str, what: str = what) -> None:
                    self.tick(what + word)

                path, dt = self._start(count, packing), step * 2 * RADIUS
                times = turns.scene(clients, path, dt, self.asked.effort, known, tick)
            self.record["cells"].append(cell | {"times": turns.as_plain(times)})
            self._keep()

    def _accuracy(self, packing: float) -> None:
        """Costs at given errors."""
        asked, present = self.asked, self._present()
        kept: dict[str, Any] = {"count": asked.accurate_count, "cost_count": asked.cost_count, "packing": packing}
        kept["steps"] = list(asked.accurate_steps)
        paths = [self._start(asked.accurate_count, packing, 1 + number) for number in range(asked.starts)]
        self.tick("the exact pressure")
        exact = accuracy.point(
            self._client(PEERS[EXACT], 1), paths, 1.0, 0, 10 * asked.point_seconds, accuracy.EXACT_LONGER
        )
        series = {}
        for peer in present:
            if peer.accuracy and peer.steps:
                series[peer.name] = [self._series(peer, knob, paths, exact) for knob in peer.knobs]
        self.record["accuracy"] = kept | {
            "exact": asdict(exact),
            "series": {
                name: [{"points": [asdict(each) for each in points], "ended": ended} for points, ended in each]
                for name, each in series.items()
            },
        }
        self._keep()
        wanted = sorted(
            {
                (name, each)
                for name, all_points in series.items()
                for points, _ in all_points
                for limit in accuracy.LIMITS
                if (each := accuracy.longest(points, exact, limit))
            },
            key=lambda pair: (list(PEERS).index(pair[0]), pair[1].dt, pair[1].knob),
        )
        self._costs(wanted, packing)

    def _series(self, peer: Peer, knob: int, paths: Sequence[Path], exact: Point) -> tuple[list[Point], str]:
        client = self._client(peer, 1)

        def ask(dt: float) -> Point:
            if time.monotonic() > self.late:
                raise FailedError(LATE)
            self.tick(f"error of {peer.title}{peer.effort(knob)}, v·dt {dt:g}")
            return accuracy.point(client, paths, dt, knob, self.asked.point_seconds)

        return accuracy.series(ask, self.asked.accurate_steps, exact)

    def _costs(self, wanted: Sequence[tuple[str, Point]], packing: float) -> None:
        """Times of frames at the steps that were found, and of the exact solver, each in a process of its own."""
        self.tick("what the steps cost")
        if not self.record["yardstick"]:
            return
        path = self._start(self.asked.cost_count, packing)
        first = Point(0.02, 0, 0, 0, 0, 0)
        exact = Point(1.0, 0, 0, 0, 0, 0)
        pairs = [(self.record["yardstick"], first), *wanted, (EXACT, exact)]
        jobs: list[tuple[str, Client, Timing]] = []
        times: Times = {}
        clients = []
        for number, (name, each) in enumerate(pairs):
            client = Client(PEERS[name], 1, self.folder)
            clients.append(client)
            self._clients[f"cost {number}"] = client
            key = "yardstick" if number == 0 else f"{name} {each.dt:g} {each.knob}"
            try:
                timing = turns.timed(client, path, each.dt, self.asked.effort, each.knob)
            except FailedError as failed:
                times[key] = str(failed)
                continue
            times[key] = timing
            jobs.append((key, client, timing))
        turns.by_turns(jobs, self.asked.effort, times)
        for client in clients:
            client.close()
        self.record["accuracy"]["costs"] = turns.as_plain(times)
        self._keep()


def _nearest(values: Sequence[float], wanted: float) -> float:
    """The value that is nearest to a number."""
    return min(values, key=lambda value: abs(value - wanted))
