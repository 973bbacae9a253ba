"""Starts worker.py with an engine, and asks it with a time limit."""

import contextlib
import os
import signal
import subprocess
import sys
from dataclasses import asdict
from multiprocessing import Pipe
from pathlib import Path
from typing import Any

from harness import TOP

from peers.engine import Plan
from peers.registry import Peer


class FailedError(Exception):
    """An engine has not done what it was asked; the text is a sentence for its row."""


class Client:
    """An engine in a process of its own, which is started when it is first asked and again after it has failed.

    Args:
        peer: which engine.
        threads: with which it computes.
        folder: where its messages are kept.
    """

    def __init__(self, peer: Peer, threads: int, folder: Path):
        self.peer, self.threads = peer, threads
        self.key = f"{peer.name}/{threads}"
        self._log = folder / f"{peer.name}-{threads}.log"
        self._process: subprocess.Popen[bytes] | None = None

    def prepare(self, path: Path, dt: float, timeout: float, counting: bool = False, knob: int = -1) -> float:
        """Give the engine a start; returns the seconds that it took. knob: -1 for the least.

        Raises:
            FailedError: see `ask`.
        """
        chosen = self.peer.knobs[0] if knob < 0 else knob
        plan = Plan(dt, self.peer.precision, self.threads, counting, chosen)
        return self.ask("prepare", timeout, path=str(path), plan=asdict(plan))["seconds"]

    def run(self, frames: int, timeout: float) -> float:
        """Run frames; returns the seconds that they took.

        Raises:
            FailedError: see `ask`.
        """
        return self.ask("run", timeout, frames=frames)["seconds"]

    def ask(self, what: str, timeout: float, **more: Any) -> dict[str, Any]:
        """The answer to a command.

        Raises:
            FailedError: if the engine cannot be had, has failed or has not answered after `timeout` seconds. In the
                last two cases its process is ended.
        """
        process = self._process or self._start()
        answer = None
        try:
            self._pipe.send({"do": what, **more})
            if not self._pipe.poll(timeout):
                self.close(now=True)
                raise FailedError(f"no answer to `{what}` within {timeout:.0f} s")
            answer = self._pipe.recv()
        except (EOFError, ConnectionError):
            os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
            status = self.close(now=True)
            ended = signal.Signals(-status).name if status < 0 else f"status {status}"
            raise FailedError(f"its process ended with {ended}") from None
        if "missing" in answer:
            raise FailedError(answer["missing"])
        if "error" in answer:
            self.close(now=True)
            raise FailedError(" ".join(answer["error"].split())[:160])
        return answer

    def close(self, now: bool = False) -> int:
        """End the process; now: without asking, with all that it has started. Returns its status; 0: there was none."""
        process, self._process = self._process, None
        if process is None:
            return 0
        self._pipe.close()
        if not now:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(timeout=20)
        if process.returncode is None:  # not reaped, so the group's number is still its own
            os.killpg(process.pid, signal.SIGKILL)
        return process.wait()

    def _start(self) -> subprocess.Popen[bytes]:
        paths = [str(TOP / "scripts"), str(TOP), os.environ.get("PYTHONPATH", "")]
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in paths if path)}
        self._pipe, theirs = Pipe()
        command = [sys.executable, "-m", "peers.worker", self.peer.name, str(theirs.fileno())]
        with theirs, self._log.open("ab") as log:  # what engines print
            self._process = subprocess.Popen(
                command, stdout=log, stderr=log, env=environment, start_new_session=True, pass_fds=[theirs.fileno()]
            )
        return self._process
