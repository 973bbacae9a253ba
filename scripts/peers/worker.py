"""Runs one engine in a process; commands and answers are lines of JSON.

python -m peers.worker NAME
"""

import json
import os
import sys
import time
from typing import Any

from peers.engine import NotThereError, Plan, Run, Start, energy
from peers.registry import PEERS


class Server:
    """Does what commands say.

    Args:
        name: of the engine.
    """

    def __init__(self, name: str):
        self._peer = PEERS[name]
        self._run: Run | None = None

    def answer(self, command: dict[str, Any]) -> dict[str, Any]:
        """The answer to a command, of which `do` is the name of a method."""
        try:
            return getattr(self, f"do_{command.pop('do')}")(**command)
        except NotThereError as missing:
            return {"missing": str(missing)}
        except Exception as error:  # any engine may fail in any way; the row says how
            return {"error": f"{type(error).__name__}: {error}"}

    def do_prepare(self, path: str, plan: dict[str, Any]) -> dict[str, Any]:
        """Give the engine a start."""
        self.do_drop()
        begun = time.perf_counter()
        engine = getattr(self._peer.load(), self._peer.engine)
        self._run = engine(Start.load(path), Plan(**plan))
        return {"seconds": time.perf_counter() - begun, "steps": self.run_now.steps}

    @property
    def run_now(self) -> Run:
        """The engine with its start."""
        if self._run is None:
            raise RuntimeError("`prepare` comes first")
        return self._run

    def do_run(self, frames: int) -> dict[str, Any]:
        """Run frames."""
        begun = time.perf_counter()
        self.run_now.run(frames)
        return {"seconds": time.perf_counter() - begun}

    def do_measure(self) -> dict[str, Any]:
        """Impulse on all walls since the start, and kinetic energy."""
        position, velocity = self.run_now.state()
        return {
            "impulse": float(self.run_now.walls().sum()),
            "energy": energy(velocity),
            "momentum": [float(part) for part in velocity.sum(axis=0)],
            "walls": [float(part) for part in self.run_now.walls()],
            "discs": len(position),
        }

    def do_drop(self) -> dict[str, Any]:
        """Give back what the engine holds."""
        if self._run is not None:
            self._run.close()
            self._run = None
        return {}


def main() -> None:
    # What engines print goes to the log, so that only answers are on the old standard output.
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    server = Server(sys.argv[1])
    for line in sys.stdin:
        answers.write(json.dumps(server.answer(json.loads(line))) + "\n")
    server.do_drop()


if __name__ == "__main__":
    main()
