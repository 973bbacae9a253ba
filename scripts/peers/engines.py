"""The engines of the comparison, and how each is asked in a process of its own."""

import contextlib
import importlib
import importlib.util
import os
import time
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

from harness import Apart
from peers import with_cpp
from peers.engine import NotThereError, Plan, Run, Start


@dataclass(frozen=True)
class Peer:
    """An engine: how it is called, found and driven.

    Attributes:
        title: name in tables.
        module: of this package, with the class `engine`.
        driven: how it is driven here, for the page.
        package: what a registry installs, module and distribution; "": nothing.
        threads: numbers of threads or processes with which it is timed.
        knobs: values of its own setting of effort, the least first; (0,): it has none.
        knob: name of that setting, in the plural.
        precision: of its numbers.
        steps: whether its frames are made of steps of dt.
    """

    title: str
    module: str
    driven: str
    package: tuple[str, ...] = ()
    engine: str = "Engine"
    threads: tuple[int, ...] = (1,)
    knobs: tuple[int, ...] = (0,)
    knob: str = ""
    precision: Literal["float32", "float64"] = "float32"
    steps: bool = True

    def effort(self, knob: int) -> str:
        """A value of the setting in words, after a comma; "": there is none."""
        return f", {knob} {self.knob.removesuffix('s') if knob == 1 else self.knob}" if self.knob else ""

    def why_missing(self) -> str:
        """Why the engine cannot be had here, and what to do; "": it can."""
        if self.package and not importlib.util.find_spec(self.package[0]):
            return f"not installed: pip install {self.package[1]}"
        if self.module == "with_cpp":
            try:
                with_cpp.build()
            except NotThereError as missing:
                return str(missing)
        return ""

    def version(self) -> str:
        """Version of the installed package."""
        return version(self.package[1]) if self.package else "-"


PEERS = {
    "cpp": Peer(
        "the report's algorithm in C++",
        "with_cpp",
        f"`scripts/peers/yardstick.cpp` with `{' '.join(with_cpp.FLAGS[:4])}`: a grid of lists of indices, both "
        "orders of each pair. On two threads its columns are unguarded, a race, as they were in the report.",
        threads=(1, 2),
    ),
    "mpsim-push": Peer(
        "mpsim, contact `push`",
        "with_mpsim",
        "Method `grid`, on two processes `parallel`, with the report's contact, as on the page of benchmarks.",
        engine="Push",
        threads=(1, 2),
    ),
    "mpsim": Peer(
        "mpsim, contact `impact`",
        "with_mpsim",
        "The same with the default contact.",
        threads=(1, 2),
    ),
    "mpsim-event": Peer(
        "mpsim, method `event`",
        "with_mpsim",
        "The exact solver. It has no step, so it is in the second table only.",
        engine="Exact",
        precision="float64",
        steps=False,
    ),
    "numpy": Peer(
        "NumPy, vectorised",
        "with_numpy",
        "Discs sorted by cell; all contacts of a frame at once, with `np.add.at`.",
        package=("numpy", "numpy"),
    ),
    "pymunk": Peer(
        "pymunk",
        "with_pymunk",
        "Chipmunk: elasticity 1, no friction, no spin, no slop, spatial hash.",
        package=("pymunk", "pymunk"),
        knobs=(1, 10),
        knob="iterations",
        precision="float64",
    ),
    "box2d": Peer(
        "Box2D 3",
        "with_box2d",
        "By the package pyb2d3, which has no wheels beyond Python 3.11: restitution 1 from speed 0 on, no "
        "friction, no spin, no sleep.",
        package=("pyb2d3", "pyb2d3"),
        threads=(1, 2),
        knobs=(1, 4),
        knob="sub-steps",
    ),
    "taichi": Peer(
        "Taichi, CPU",
        "with_taichi",
        "One kernel a frame: cells with room for eight discs, filled by atomics; each disc gathers from the nine "
        "cells around it, all contacts of a frame at once.",
        package=("taichi", "taichi"),
        threads=(1, 2),
    ),
    "lammps": Peer(
        "LAMMPS, `gran/hooke`",
        "with_lammps",
        "Soft discs: springs without friction and damping. They are as stiff as it takes for a contact at the "
        "thermal speed to be v·dt deep, so it lasts 2.2 dt; 20 steps in that make 10 steps a frame.",
        package=("lammps", "lammps"),
        threads=(1, 2),
        precision="float64",
    ),
}
"""By name, in the order of the tables; the first is the yardstick."""


# --- an engine in a process of its own


class FailedError(Exception):
    """An engine has not done what it was asked; the text is a sentence for its row."""


class Client:
    """An engine in a process of its own, which is started when it is first asked and again after it has failed.

    Args:
        name: of the engine.
        threads: number with which it computes.
        log: file for its messages.
    """

    def __init__(self, name: str, threads: int, log: Path):
        self.name, self.peer, self.threads = name, PEERS[name], threads
        self._process = Apart(begin, name, log)

    def prepare(self, path: Path, dt: float, timeout: float, counting: bool = False, knob: int = -1) -> float:
        """Give the engine a start; returns the seconds that it took. knob: -1 for the least.

        Raises:
            FailedError: see `ask`.
        """
        chosen = self.peer.knobs[0] if knob < 0 else knob
        return self.ask("prepare", timeout, path, Plan(dt, self.peer.precision, self.threads, counting, chosen))

    def ask(self, what: str, timeout: float, *words: Any) -> Any:
        """The answer to a command: prepare, run, step, watch, measure or drop.

        Raises:
            FailedError: if the engine has failed or has not answered after `timeout` seconds; its process is ended.
        """
        try:
            return self._process.call(timeout, answer, what, *words)
        except TimeoutError:
            reason = f"no answer to `{what}` within {timeout:.0f} s"
        except BrokenProcessPool:
            reason = "its process has ended"
        except Exception as error:  # any engine may fail in any way; the row says how
            reason = " ".join(f"{type(error).__name__}: {error}".split())[:160]
        self._process.close(now=True)
        raise FailedError(reason)

    def close(self) -> None:
        """Give back what the engine holds, and end its process."""
        if self._process.pool is not None:
            with contextlib.suppress(FailedError):
                self.ask("drop", 20)
            self._process.close()


class Server:
    """The commands of `Client.ask`."""

    def __init__(self, peer: Peer):
        self._peer = peer
        self._run: Run | None = None

    def prepare(self, path: Path, plan: Plan) -> float:
        """Give the engine a start; seconds."""
        self.drop()
        begun = time.perf_counter()
        engine = getattr(importlib.import_module(f"peers.{self._peer.module}"), self._peer.engine)
        self._run = engine(Start.load(path), plan)
        return time.perf_counter() - begun

    def run(self, frames: int) -> float:
        """Run frames; seconds."""
        assert self._run is not None
        begun = time.perf_counter()
        self._run.run(frames)
        return time.perf_counter() - begun

    def step(self, frames: int, watched: bool = False) -> float:
        """Run frames, one a call, as a game does; seconds. watched: positions and velocities are read after each."""
        assert self._run is not None
        begun = time.perf_counter()
        for _ in range(frames):
            self._run.run(1)
            if watched:
                self._run.state()
        return time.perf_counter() - begun

    def watch(self, frames: int) -> float:
        """Run frames, one a call, and read positions and velocities after each; seconds."""
        return self.step(frames, watched=True)

    def measure(self) -> tuple[float, float]:
        """Impulse on all walls since the start, and kinetic energy of the discs, of mass 1."""
        assert self._run is not None
        _, velocity = self._run.state()
        return float(self._run.walls().sum()), 0.5 * float((velocity**2).sum())

    def drop(self) -> float:
        """Give back what the engine holds."""
        if self._run is not None:
            self._run.close()
            self._run = None
        return 0.0


_servers: list[Server] = []


def begin(name: str, log: Path) -> None:
    """Make this process that of an engine."""
    with log.open("ab") as file:  # what engines print
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    _servers.append(Server(PEERS[name]))


def answer(what: str, *words: Any) -> Any:
    """What the engine of this process says to a command: seconds or measures."""
    return getattr(_servers[0], what)(*words)
