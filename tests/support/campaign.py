"""Trade-off studies whose runs are made up: errors and costs are known, and nothing is simulated but the first look.

The runs are handed to an executor that answers with what a law says; the costs stand in the file of an earlier study.
"""

import json
from collections.abc import Callable, Iterable
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

import numpy as np

import mpsim

SCENE = mpsim.Scene.lattice(count=30, packing=0.75, radius=0.5, seed=1)
"""Of temperature 1, and dense, so that the first look at it is short."""

UNTIL, PIECES = 10.0, 16  # length of the runs, and the number of pieces of which each has an average
TIME = (np.arange(PIECES) + 0.5) / PIECES  # the middle of each piece, as a fraction of a run

COARSE, FINE = mpsim.Settings(dt=0.1, method="grid"), mpsim.Settings(dt=0.02, method="grid")
PUSH = mpsim.Settings(dt=0.05, method="grid", contact="push")
REFLECT = mpsim.Settings(dt=0.05, method="grid", contact="push", law="reflect")

Law = Callable[[mpsim.Settings, int], dict[str, Any]]
"""What a run with these settings, from the start of this number, has found in each piece, by the name of a measure."""


def start(number: int) -> mpsim.Scene:
    """The scene, which tells its number by the duration that it recommends."""
    parts = {name: getattr(SCENE, name) for name in ("width", "height", "position", "velocity", "radius")}
    return mpsim.Scene(**parts, duration=number + 1.0)


class MadeUp(Executor):
    """Answers for each run what a law says, and keeps a list of (settings, number of the start)."""

    def __init__(self, law: Law):
        self.law, self.asked = law, list[tuple[mpsim.Settings, int]]()

    def submit(self, run: Any, scene: mpsim.Scene, settings: mpsim.Settings, /, *rest: Any) -> Future[Any]:
        number = round(scene.duration or 0) - 1
        self.asked.append((settings, number))
        future = Future[Any]()
        found = {"met": np.full(PIECES, 10), "centre": TIME} | self.law(settings, number)
        future.set_result({name: np.asarray(values).tolist() for name, values in found.items()})
        return future


class Costs:
    """Files of an earlier study, in which nothing but costs is known."""

    def __init__(self, folder: Path, **how: Any):
        path = folder / "costs.json"
        self.how = {"until": UNTIL, "starts": start, **how}
        nothing = MadeUp(lambda settings, number: {"overlap": np.full(PIECES, 0.01 * (1 + number % 3))})
        first = {"executor": nothing, "path": path, "measures": "overlap", "replicas": 2}
        mpsim.tradeoff(SCENE, mpsim.Settings(method="grid"), **first, **self.how)
        self._head, *lines = path.read_text().splitlines()
        (cost,) = [each for each in map(json.loads, lines) if each["key"].startswith("cost ")]
        self._cost, self._names = cost["result"], json.loads(cost["key"].removeprefix("cost ")).keys()
        self._keys = dict[mpsim.Settings, str]()

    def _key(self, settings: mpsim.Settings) -> str:
        if settings not in self._keys:
            values = {name: value for name, value in vars(settings).items() if name in self._names}
            values |= {"on_fast": settings.on_fast} if settings.on_fast != "warn" else {}
            self._keys[settings] = f"cost {json.dumps(values, sort_keys=True)}"
        return self._keys[settings]

    def write(self, path: Path, candidates: Iterable[mpsim.Settings], price: Callable[[mpsim.Settings], float]) -> Path:
        """A file with the price of each candidate."""
        prices = ("median", "low", "high")
        costs = ((self._key(each), self._cost | dict.fromkeys(prices, price(each))) for each in candidates)
        lines = (json.dumps({"key": key, "result": cost}) for key, cost in costs)
        path.write_text("".join(f"{line}\n" for line in (self._head, *lines)))
        return path
