"""Rapier's npm package in Node (WebAssembly with vector instructions), driven by rapier.mjs."""

import json
import os
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from peers.engine import NotThereError, Plan, Run, Start

PACKAGE = "@dimforge/rapier2d-simd-compat"
SCRIPT = Path(__file__).with_name("rapier.mjs")
TOP = Path(__file__).parents[2]


def modules() -> Path:
    """The folder `node_modules` that holds Rapier: of NODE_PATH, of results/peers, or of this checkout.

    Raises:
        NotThereError: if there is no Node, or no Rapier.
    """
    if not shutil.which("node"):
        raise NotThereError(f"Node is not on the path; install it, then npm install --prefix results/peers {PACKAGE}")
    named = [Path(folder) for folder in os.environ.get("NODE_PATH", "").split(os.pathsep) if folder]
    for folder in (*named, TOP / "results" / "peers" / "node_modules", TOP / "node_modules"):
        if (folder / PACKAGE / "package.json").exists():
            return folder
    raise NotThereError(f"not installed: npm install --prefix results/peers {PACKAGE}")


def version() -> str:
    """Version of the package."""
    return json.loads((modules() / PACKAGE / "package.json").read_text())["version"]


class Engine(Run):
    """A world in a process of Node; the knob is its number of solver iterations. Single precision."""

    def __init__(self, start: Start, plan: Plan):
        command = ["node", str(SCRIPT), str(modules()), PACKAGE]
        self._node = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        with tempfile.NamedTemporaryFile() as file:
            file.write(np.hstack([start.position, start.velocity]).astype("<f8").tobytes())
            file.flush()
            box = {"width": start.width, "height": start.height, "radius": start.radius}
            settings = {"dt": plan.dt, "knob": plan.knob, "counting": plan.counting}
            self._ask("prepare", path=file.name, **box, **settings)

    def _ask(self, what: str, **more: Any) -> Any:
        assert self._node.stdin
        assert self._node.stdout
        self._node.stdin.write(json.dumps({"do": what, **more}) + "\n")
        self._node.stdin.flush()
        line = self._node.stdout.readline()
        if not line:
            raise ArithmeticError(f"Node ended with status {self._node.wait()}; its message is above")
        return json.loads(line)

    def run(self, frames: int) -> None:
        self._ask("run", frames=frames)

    def state(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        numbers = np.array(self._ask("state"))
        return numbers[:, :2], numbers[:, 2:]

    def walls(self) -> NDArray[np.float64]:
        return np.array(self._ask("walls"), dtype=np.float64)

    def close(self) -> None:
        assert self._node.stdin
        assert self._node.stdout
        self._node.stdin.close()
        self._node.wait(timeout=10)
        self._node.stdout.close()
