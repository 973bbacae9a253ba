"""Scripts run in processes of their own, with a bound on their time, and what they may leave behind: nothing.

A script starts in a new interpreter or, where its test does not depend on one, in a fork of a process that is warm.
"""

import contextlib
import os
import resource
import signal
import subprocess
import sys
import tempfile
import textwrap
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, Queue
from typing import Any

import psutil

from support.script_server import ForkedScript, environment

SHARED_MEMORY = Path("/dev/shm")


@dataclass(frozen=True)
class Outcome:
    """How a script ended: its exit code (negative: the signal), what it printed, and for how long it ran."""

    code: int
    out: str
    err: str
    seconds: float


class Script:
    """A script running in a process of its own, which leads a session and process group of its own.

    Args:
        text: the script; it may import mpsim and the package `support`.
        prefix: words before the interpreter, such as a wrapper program.
        flags: of the interpreter; by default warnings are errors.
        env: variables to add to the environment.
        warm: whether a process that has mpsim and its kernels loaded forks the script, which takes a tenth of the
            time of a new interpreter. support/script_server.py says what needs a new one.
    """

    def __init__(
        self,
        text: str,
        *,
        prefix: Iterable[str] = (),
        flags: Iterable[str] = ("-W", "error"),
        env: dict[str, str] | None = None,
        warm: bool = False,
    ):
        self._folder = tempfile.TemporaryDirectory(prefix="mpsim-test-")
        path = Path(self._folder.name) / "script.py"
        path.write_text(textwrap.dedent(text))
        assert not (warm and (tuple(prefix), tuple(flags), env) != ((), ("-W", "error"), None)), "for a new one only"
        self._started = time.perf_counter()
        try:
            command = [*prefix, sys.executable, "-u", *flags, str(path)]
            self._process = ForkedScript(path) if warm else _started(command, env)
        except BaseException:
            self._folder.cleanup()
            raise
        self._lines: Queue[str] = Queue()
        self._texts: dict[str, list[str]] = {"stdout": [], "stderr": []}
        self._readers = [threading.Thread(target=self._read, args=(name,), daemon=True) for name in self._texts]
        for reader in self._readers:
            reader.start()

    def __enter__(self) -> "Script":
        return self

    def __exit__(self, *exception: object) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)
        self._process.wait()
        for reader, pipe in zip(self._readers, (self._process.stdout, self._process.stderr), strict=True):
            reader.join(5)
            pipe.close()
        self._folder.cleanup()

    @property
    def pid(self) -> int:
        return self._process.pid

    def line(self, bound: float = 60) -> str:
        """Next line that the script prints."""
        try:
            return self._lines.get(timeout=bound)
        except Empty:
            raise AssertionError(f"no line within {bound} s; {self._ended_texts()}") from None

    def send(self, number: signal.Signals) -> None:
        """Send a signal to the script's process alone."""
        os.kill(self.pid, number)

    def send_to_group(self, number: signal.Signals) -> None:
        """Send a signal to the script and all its processes, as a terminal does at Ctrl-C."""
        os.killpg(self.pid, number)

    def finish(self, bound: float = 60) -> Outcome:
        """Wait for the end. A script that outlives the bound is a failure, with its stacks."""
        try:
            self._process.wait(bound)
        except subprocess.TimeoutExpired:
            self.send(signal.SIGABRT)
            raise AssertionError(f"still running after {bound} s; {self._ended_texts()}") from None
        seconds = time.perf_counter() - self._started
        for reader in self._readers:
            reader.join(5)  # a process left behind would hold the pipes open: do not wait for it
        return Outcome(self._process.returncode, *("".join(lines) for lines in self._texts.values()), seconds)

    def _read(self, name: str) -> None:
        for line in getattr(self._process, name):
            self._texts[name].append(line)
            if name == "stdout":
                self._lines.put(line.rstrip("\n"))

    def _ended_texts(self) -> str:
        time.sleep(0.5)
        return "\n".join(f"its {name}:\n{''.join(lines)}" for name, lines in self._texts.items())


def _started(command: list[str], variables: dict[str, str] | None) -> subprocess.Popen[str]:
    """A command that begins in the folder of the script, its last word."""
    return subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment() | (variables or {}),
        cwd=Path(command[-1]).parent,
        start_new_session=True,
    )


def run_script(text: str, *, bound: float = 60, **options: Any) -> Outcome:
    """Run a script to its end, and require that it leaves no block and no process behind."""
    with Script(text, **options) as script:
        outcome = script.finish(bound)
        assert_nothing_left_of(script.pid)
        return outcome


def assert_clean(outcome: Outcome) -> None:
    """Require exit code 0 and an empty stderr."""
    assert (outcome.code, outcome.err) == (0, ""), f"exit code {outcome.code}; its stderr:\n{outcome.err}"


def blocks_of(pid: int) -> set[str]:
    """Shared blocks that a process has created and that still exist."""
    return {path.name for path in SHARED_MEMORY.glob(f"mpsim-{pid}-*")}


def descendants_of(pid: int) -> set[int]:
    """Children of a process, ended ones that nobody has waited for included, and theirs.

    Read as the kernel lists them: to look at every process of the machine takes milliseconds, after each test.
    """
    found: set[int] = set()
    with contextlib.suppress(FileNotFoundError, ProcessLookupError):  # it has ended meanwhile
        for thread in Path(f"/proc/{pid}/task").iterdir():
            found.update(map(int, (thread / "children").read_text().split()))
    return found.union(*map(descendants_of, found))


def group_of(pid: int) -> list[psutil.Process]:
    """Living processes of a process group."""
    members = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error, ProcessLookupError):
            if os.getpgid(process.pid) == pid and process.status() != psutil.STATUS_ZOMBIE:
                members.append(process)
    return members


def assert_nothing_left_of(pid: int, within: float = 5) -> None:
    """Require that no process of a script's group lives on, nor any block that it made."""
    assert wait_until(lambda: not group_of(pid), within), f"processes left behind: {group_of(pid)}"
    assert wait_until(lambda: not blocks_of(pid), within), f"blocks left behind: {blocks_of(pid)}"


def is_gone(pid: int) -> bool:
    """Whether a process has ended (a zombie that nobody has waited for has ended too)."""
    try:
        return psutil.Process(pid).status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True


def in_another_thread(act: Callable[[], Any], within: float = 100) -> Any:
    """What a function returns that another thread calls, which must be done within so many seconds."""
    found: list[Any] = []
    thread = threading.Thread(target=lambda: found.append(act()), daemon=True)
    thread.start()
    thread.join(within)
    assert found, "it has failed, or hangs"
    return found[0]


def wait_until(condition: Callable[[], bool], within: float) -> bool:
    """Whether the condition comes true within so many seconds."""
    end = time.monotonic() + within
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.01)
    return True


@contextlib.contextmanager
def limited(kind: int, soft: int) -> Iterator[None]:
    """A limit of this process, such as `resource.RLIMIT_FSIZE`."""
    before = resource.getrlimit(kind)
    resource.setrlimit(kind, (soft, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(kind, before)


def refusing(error: BaseException | int) -> Callable[..., Any]:
    """What raises an error, or that of the system with this number, however it is called."""

    def refuse(*_: Any, **__: Any) -> Any:
        raise OSError(error, os.strerror(error)) if isinstance(error, int) else error

    return refuse
