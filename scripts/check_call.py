"""Counts what is behind one `run(frames=1)`: Python calls, files of mpsim, kernels; fails where one is above its limit.

python scripts/check_call.py            with the machine code that is kept
python scripts/check_call.py --cold     with none, so that the seconds of the first frame are those of compiling

Counts are the same on a busy machine. Times are printed beside them, and decide nothing. A change that lowers a count
lowers its limit here.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from typing import NamedTuple

from rich.console import Console
from rich.table import Table


class Limits(NamedTuple):
    """The most of each: calls of Python functions, files of mpsim that they are in, kernels compiled or loaded."""

    calls: int
    files: int
    kernels: int


SCENES = {
    "naive, 100 discs": Limits(48, 11, 4),
    "grid, 1000 discs": Limits(50, 11, 7),
    "event, 100 discs": Limits(45, 9, 1),
}

COUNTER = """
import json, sys, time
import mpsim
from mpsim.kernels.compiling import compiled_kernels
scene = mpsim.Scene.random(count={count}, packing=0.4, radius=0.5, temperature=1.0, seed=3)
placed = compiled_kernels()
begin = time.perf_counter()
with mpsim.Simulation(scene, mpsim.Settings(dt=0.02, method="{method}")) as sim:
    sim.run(frames=1)
    first, kernels = time.perf_counter() - begin, compiled_kernels() - placed
    sim.run(frames=20)
    calls, files = 0, set()
    def note(frame, event, argument):
        global calls
        if event == "call":
            calls += 1
            files.add(frame.f_code.co_filename)
    sys.setprofile(note)
    sim.run(frames=1)
    sys.setprofile(None)
    seconds = []
    for _ in range(300):
        begin = time.perf_counter()
        sim.run(frames=1)
        seconds.append(time.perf_counter() - begin)
    own = [each for each in files if each.startswith(mpsim.__path__[0])]
print(json.dumps([calls, len(own), kernels, sorted(seconds)[150], first]))
"""
"""Prints the counts of `Limits`, the median time of a call, and the time of construction and first frame [s]."""


def counted(name: str, cold: bool) -> tuple[Limits, float, float]:
    """Counts and times of a scene, in a process of its own; cold: without machine code that is kept."""
    method, count = name.removesuffix(" discs").split(", ")
    with tempfile.TemporaryDirectory() as empty:
        environment = os.environ | ({"NUMBA_CACHE_DIR": empty} if cold else {})
        text = COUNTER.format(count=count, method=method)
        done = subprocess.run([sys.executable, "-c", text], env=environment, check=True, capture_output=True, text=True)
    *counts, seconds, first = json.loads(done.stdout)
    return Limits(*counts), seconds, first


def main() -> int:
    """Print the table; 1 if a count is above its limit."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--cold", action="store_true", help="compile everything anew")
    cold = parser.parse_args().cold
    table, above = Table("run(frames=1)", *Limits._fields, "a call", "first frame"), False
    for name, limits in SCENES.items():
        counts, seconds, first = counted(name, cold)
        pairs = list(zip(counts, limits, strict=True))
        above |= any(count > most for count, most in pairs)
        words = [f"{count}" if count <= most else f"[red]{count} > {most}" for count, most in pairs]
        table.add_row(name, *words, f"{seconds * 1e6:.0f} us", f"{first:.1f} s")
    Console().print(table)
    return int(above)


if __name__ == "__main__":
    sys.exit(main())
