"""Starts worker.py with an engine, and asks it with a time limit."""

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

from peers.engine import Plan
from peers.registry import Peer

TOP = Path(__file__).parents[2]


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
        self._log = folder / f"{self.key.replace('/', '-')}.log"
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def key(self) -> str:
        """Name of the engine with its threads, such as cpp/2."""
        return f"{self.peer.name}/{self.threads}"

    def prepare(self, path: Path, dt: float, timeout: float, counting: bool = False, knob: int = -1) -> dict[str, Any]:
        """Give the engine a start; knob: -1 for the least.

        Raises:
            FailedError: see `ask`.
        """
        chosen = self.peer.knobs[0] if knob < 0 else knob
        plan = Plan(dt, self.peer.precision, self.threads, counting, chosen)
        return self.ask("prepare", timeout, path=str(path), plan=asdict(plan))

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
        process = self._running()
        assert process.stdin
        assert process.stdout
        try:
            process.stdin.write(json.dumps({"do": what, **more}).encode() + b"\n")
            process.stdin.flush()
            line = self._line(timeout)
        except BrokenPipeError:
            line = b""
        if line is None:
            self.close(now=True)
            raise FailedError(f"no answer to `{what}` within {timeout:.0f} s")
        if not line:
            os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
            status = self.close(now=True)
            ended = signal.Signals(-status).name if status < 0 else f"status {status}"
            raise FailedError(f"its process ended with {ended}")
        answer = json.loads(line)
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
        assert process.stdin
        assert process.stdout
        with contextlib.suppress(OSError):
            process.stdin.close()
        if not now:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(timeout=20)
        if process.returncode is None:  # not reaped, so the group's number is still its own
            os.killpg(process.pid, signal.SIGKILL)
        process.stdout.close()
        return process.wait()

    def _running(self) -> subprocess.Popen[bytes]:
        if self._process is None:
            paths = [str(TOP / "scripts"), str(TOP), os.environ.get("PYTHONPATH", "")]
            environment = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in paths if path)}
            with self._log.open("ab") as log:
                self._process = subprocess.Popen(
                    [sys.executable, "-m", "peers.worker", self.peer.name],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=log,
                    env=environment,
                    start_new_session=True,
                    bufsize=0,
                )
        return self._process

    def _line(self, timeout: float) -> bytes | None:
        """The next line that the process writes; None: not in time; empty: it has ended."""
        process = self._running()
        assert process.stdout
        until, line = time.monotonic() + timeout, b""
        while not line.endswith(b"\n"):
            left = until - time.monotonic()
            if left <= 0 or not select.select([process.stdout], [], [], left)[0]:
                return None
            part = os.read(process.stdout.fileno(), 1 << 16)
            if not part:
                return b""
            line += part
        return line
