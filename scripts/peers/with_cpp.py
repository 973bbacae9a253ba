"""The report's algorithm in C++ (yardstick.cpp), compiled where a compiler is found."""

import ctypes
import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from peers.engine import NotThereError, Plan, Run, Start

SOURCE = Path(__file__).with_name("yardstick.cpp")
FLAGS = ("-std=c++17", "-O3", "-march=native", "-fopenmp", "-shared", "-fPIC")
COMPILERS = ("g++", "clang++", "c++")


def compiler() -> str:
    """Path of a C++ compiler: what CXX names, or the first that is found.

    Raises:
        NotThereError: if there is none.
    """
    for name in (os.environ.get("CXX", ""), *COMPILERS):
        found = shutil.which(name) if name else None
        if found:
            return found
    raise NotThereError(f"no C++ compiler is on the path ({', '.join(COMPILERS)}); install one, or set CXX")


def library(folder: Path | None = None) -> Path:
    """The compiled yardstick, in a folder for temporary files; compiled if it is not there yet.

    Raises:
        NotThereError: if there is no compiler, or it refuses.
    """
    program = compiler()
    folder = folder or Path(tempfile.gettempdir()) / f"mpsim-peers-{os.getuid()}"
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    if folder.stat().st_uid != os.getuid():
        raise NotThereError(f"{folder} belongs to another user, so nothing in it is run; remove it or set TMPDIR")
    version = subprocess.run([program, "--version"], capture_output=True, text=True, check=False).stdout
    what = [SOURCE.read_text(), version, *FLAGS, platform.machine(), platform.node()]
    path = folder / f"yardstick-{hashlib.blake2b(repr(what).encode(), digest_size=8).hexdigest()}.so"
    if not path.exists():
        with tempfile.TemporaryDirectory(dir=folder) as made:
            new = Path(made) / path.name
            command = [program, *FLAGS, str(SOURCE), "-o", str(new)]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                first = (done.stderr.strip().splitlines() or ["no message"])[0]
                raise NotThereError(f"{program} does not compile yardstick.cpp: {first}")
            new.replace(path)
    return path


def _pointer(array: NDArray[np.float64]) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


class Engine(Run):
    """The yardstick with a start in it."""

    def __init__(self, start: Start, plan: Plan):
        code = ctypes.CDLL(str(library()))
        self._plan, self._count = plan, start.count
        self._run, self._read, self._free = (
            getattr(code, f"{plan.precision}_{what}") for what in ("run", "read", "free")
        )
        new = getattr(code, f"{plan.precision}_new")
        new.restype = ctypes.c_void_p
        box = (ctypes.c_double(value) for value in (start.width, start.height, start.radius))
        places, speeds = (np.ascontiguousarray(a, dtype=np.float64) for a in (start.position, start.velocity))
        self._gas = ctypes.c_void_p(new(ctypes.c_int(start.count), *box, _pointer(places), _pointer(speeds)))
        self.impulses = np.zeros(4)

    def run(self, frames: int) -> None:
        walls = _pointer(self.impulses) if self._plan.counting else ctypes.c_void_p()
        threads = ctypes.c_int(self._plan.threads)
        self._run(self._gas, ctypes.c_double(self._plan.dt), ctypes.c_int(frames), threads, walls)

    def state(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        position, velocity = np.empty((2, self._count, 2))
        self._read(self._gas, _pointer(position), _pointer(velocity))
        return position, velocity

    def close(self) -> None:
        self._free(self._gas)
        self._gas = ctypes.c_void_p()
