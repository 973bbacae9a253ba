"""Scripts that a process which has imported mpsim forks: a second of processor time less for each of them.

A new interpreter imports mpsim and loads a first kernel, and Numba with it, before it comes to what a test is about.
The server does that once for a session of tests, and has no simulation, process or thread. A script is a fork of it, in
which little differs from `python script.py`: it leads a session and a process group, it is the module `__main__` with
its file, the file's folder is the present one and first in `sys.path`, its output goes into pipes of its own, and where
it ends the interpreter ends: it prints an uncaught exception, joins threads, calls what is registered for the end, and
has the exit code of a program.

What needs a new interpreter stays with one, as `Script` starts it unless it is asked for a warm one:

- imports and first compilations, and what is read while mpsim is imported: variables of the environment, the cache;
- flags of the interpreter, and programs in front of it;
- the end of a program, whose order is that in which modules were imported and have registered for it;
- the resource tracker, its start and its complaints;
- start methods: workers that import the main module again, and the fork server's own start;
- Ctrl-C while modules, kernels or workers are being loaded; forks of a simulation and what they are refused.
"""

import atexit
import builtins
import ctypes
import gc
import json
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar, Self

import mpsim

SERVER = "from support.script_server import next_script; exec(*next_script())"
"""A program that loops in `next_script`; a fork of it comes back from there with what it is to execute."""

TESTS = Path(__file__).parents[1]
PACKAGE_PARENT = Path(mpsim.__file__).parents[1]
LONGEST_MESSAGE = 1 << 20


def end_with_parent() -> None:
    """Kill this process when its parent ends, however that ends and whatever this one is doing."""
    pr_set_pdeathsig = 1
    ctypes.CDLL(None).prctl(pr_set_pdeathsig, signal.SIGKILL)


def environment() -> dict[str, str]:
    """Variables of a script: those of now, the tests' own modules, and stacks where a signal ends it.

    It compiles, even if this process does not, unless it is told otherwise.
    """
    os_variables = {name: value for name, value in os.environ.items() if name != "NUMBA_DISABLE_JIT"}
    return os_variables | {"PYTHONPATH": f"{PACKAGE_PARENT}:{TESTS}", "PYTHONFAULTHANDLER": "1"}


# --- in the server


def next_script() -> tuple[Any, dict[str, Any]]:
    """Serve until the tests have ended, which ends the server; in each fork return the script's code and its names."""
    requests = socket.socket(fileno=int(os.environ.pop("MPSIM_SCRIPT_SERVER")))
    _warm_up()
    while True:
        message, descriptors, _, _ = socket.recv_fds(requests, LONGEST_MESSAGE, 2)
        if not message:
            os._exit(0)
        wanted = json.loads(message)
        if "reap" in wanted:
            answer = os.waitstatus_to_exitcode(os.waitpid(wanted["reap"], 0)[1])
        elif (answer := _fork(descriptors)) == 0:
            requests.close()
            return _become(Path(wanted["script"]), wanted["environment"])
        requests.send(json.dumps(answer).encode())


def _warm_up() -> None:
    """Import what scripts import, and load one small kernel, with which Numba loads itself: no process, no block."""
    from support.scenes import lattice  # noqa: PLC0415 - who only asks for scripts needs none of this

    lattice(9, 9).overlaps_at_start()
    assert threading.active_count() == 1
    gc.collect()
    gc.freeze()  # or the first collection of each fork would copy all of it


def _fork(descriptors: list[int]) -> int:
    """Fork; in the child (0) make the two descriptors stdout and stderr. It leads its session before this returns."""
    ready, begun = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # 3.12: fork beside threads, those of linear algebra
        pid = os.fork()
    if pid == 0:
        end_with_parent()
        os.setsid()
        for descriptor, number in zip(descriptors, (1, 2), strict=True):
            os.dup2(descriptor, number)
    os.close(begun)
    if pid:
        os.read(ready, 1)  # until its end of the pipe is closed
    for descriptor in (ready, *descriptors):
        os.close(descriptor)
    return pid


def _become(path: Path, environment: dict[str, str]) -> tuple[Any, dict[str, Any]]:
    """Make this process look like `python script.py` in the script's folder."""
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(path.parent)
    sys.argv, sys.path[0] = [str(path)], str(path.parent)
    names = vars(sys.modules["__main__"])
    names.clear()
    names.update(__name__="__main__", __file__=str(path), __builtins__=builtins, __spec__=None, __package__=None)
    return compile(path.read_text(), str(path), "exec"), names


# --- in the tests


class Server:
    """The process that forks scripts. It ends with the process of tests that has started it.

    Attributes:
        running: that of this process, if a script has asked for one.
    """

    running: ClassVar[Self | None] = None

    def __init__(self) -> None:
        self._requests, theirs = socket.socketpair()
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-u", "-W", "error", "-c", SERVER],
                env=environment() | {"MPSIM_SCRIPT_SERVER": str(theirs.fileno())},
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                start_new_session=True,
            )
        self._owner = os.getpid()
        atexit.register(self.close)

    @classmethod
    def get(cls) -> Self:
        """The one that runs, started if need be."""
        cls.running = cls.running or cls()
        return cls.running

    @classmethod
    def pids(cls) -> set[int]:
        return {cls.running._process.pid} if cls.running else set()

    def ask(self, request: dict[str, Any], descriptors: tuple[int, ...] = ()) -> int:
        """The server's answer, a number; an AssertionError if it has ended."""
        with suppress(OSError):
            socket.send_fds(self._requests, [json.dumps(request).encode()], descriptors)
            if answer := self._requests.recv(LONGEST_MESSAGE):
                return json.loads(answer)
        Server.running = None
        raise AssertionError(f"the server of scripts has ended, with exit code {self._process.wait(10)}")

    def close(self) -> None:
        """End it. Forks of the tests have a copy that they leave alone."""
        if os.getpid() == self._owner:
            self._requests.close()
            self._process.wait(10)


class ForkedScript:
    """A script in a fork of the server, with what `Script` needs of a `subprocess.Popen`."""

    def __init__(self, path: Path):
        request, server = {"script": str(path), "environment": environment()}, Server.get()
        out, err = os.pipe(), os.pipe()
        self.stdout, self.stderr = (os.fdopen(reading) for reading, _ in (out, err))
        try:
            self.pid: int = server.ask(request, (out[1], err[1]))
        except AssertionError:
            self.stdout.close()
            self.stderr.close()
            raise
        finally:
            os.close(out[1])
            os.close(err[1])
        self.returncode: int | None = None
        self._end = os.pidfd_open(self.pid)

    def wait(self, timeout: float | None = None) -> int:
        """Its exit code, once it has ended; subprocess.TimeoutExpired if it has not within so many seconds."""
        if self.returncode is None:
            end = select.poll()
            end.register(self._end, select.POLLIN)
            if not end.poll(None if timeout is None else 1000 * timeout):
                raise subprocess.TimeoutExpired("a script in a fork of the server", timeout or 0)
            os.close(self._end)
            self.returncode = Server.get().ask({"reap": self.pid})
        return self.returncode
