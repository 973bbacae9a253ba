"""Runs one engine in a process, which takes commands from a pipe and answers them.

python -m peers.worker NAME DESCRIPTOR
"""

import os
import sys
import time
from multiprocessing.connection import Connection
from typing import Any

from peers.engine import NotThereError, Plan, Run, Start
from peers.registry import PEERS


class Server:
    """Does what commands say; name: of the engine."""

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
        self._run = getattr(self._peer.load(), self._peer.engine)(Start.load(path), Plan(**plan))
        return {"seconds": time.perf_counter() - begun}

    def do_run(self, frames: int) -> dict[str, Any]:
        """Run frames."""
        assert self._run is not None
        begun = time.perf_counter()
        self._run.run(frames)
        return {"seconds": time.perf_counter() - begun}

    def do_measure(self) -> dict[str, Any]:
        """Impulse on all walls since the start, and kinetic energy of the discs, of mass 1."""
        assert self._run is not None
        _, velocity = self._run.state()
        return {"impulse": float(self._run.walls().sum()), "energy": 0.5 * float((velocity**2).sum())}

    def do_drop(self) -> dict[str, Any]:
        """Give back what the engine holds."""
        if self._run is not None:
            self._run.close()
            self._run = None
        return {}


def main() -> None:
    descriptor = int(sys.argv[2])
    os.set_inheritable(descriptor, False)
    pipe, server = Connection(descriptor), Server(sys.argv[1])
    try:
        while True:
            pipe.send(server.answer(pipe.recv()))
    except (EOFError, ConnectionError):
        server.do_drop()


if __name__ == "__main__":
    main()
