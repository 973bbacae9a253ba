"""The report's algorithm in C++ (yardstick.cpp), compiled where a compiler is found."""

import ctypes
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from peers.engine import NotThereError, Plan, Run, Start

SOURCE = Path(__file__).with_name("yardstick.cpp")
LIBRARY = Path(__file__).parents[2] / "results" / "peers" / "yardstick.so"
FLAGS = ("-std=c++17", "-O3", "-march=native", "-fopenmp", "-shared", "-fPIC")
COMPILERS = ("g++", "clang++", "c++")


def build() -> None:
    """Compile the yardstick.

    Raises:
        NotThereError: if there is no compiler, or it refuses.
    """
    found = [path for name in (os.environ.get("CXX", ""), *COMPILERS) if name and (path := shutil.which(name))]
    if not found:
        raise NotThereError(f"no C++ compiler is on the path ({', '.join(COMPILERS)}); install one, or set CXX")
    LIBRARY.parent.mkdir(parents=True, exist_ok=True)
    new = LIBRARY.with_name(f"{os.getpid()}.so")
    done = subprocess.run([found[0], *FLAGS, SOURCE, "-o", new], capture_output=True, text=True, check=False)
    if done.returncode:
        raise NotThereError(f"{found[0]} does not compile yardstick.cpp: {done.stderr.strip().partition(chr(10))[0]}")
    new.replace(LIBRARY)


def _pointer(array: NDArray[np.float64]) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


class Engine(Run):
    """The yardstick with a start in it. Single precision."""

    def __init__(self, start: Start, plan: Plan):
        code = ctypes.CDLL(str(LIBRARY))
        self._plan, self._count = plan, start.count
        self._run, self._read, self._free = code.yardstick_run, code.yardstick_read, code.yardstick_free
        code.yardstick_new.restype = ctypes.c_void_p
        box = (ctypes.c_double(value) for value in (start.width, start.height, start.radius))
        places, speeds = (np.ascontiguousarray(a, dtype=np.float64) for a in (start.position, start.velocity))
        self._gas = ctypes.c_void_p(
            code.yardstick_new(ctypes.c_int(start.count), *box, _pointer(places), _pointer(speeds))
        )
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
