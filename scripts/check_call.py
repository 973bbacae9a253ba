"""Counts what is behind one `run(frames=1)`: Python calls, files of mpsim, kernels; fails where one is above its limit.

python scripts/check_call.py

Counts are the same on a busy machine; check_speed.py and check_waits.py measure times. A change that lowers a count
lowers its limit here.
"""

import json
import subprocess
import sys
from typing import NamedTuple

from rich.console import Console
from rich.table import Table


class Limits(NamedTuple):
    """The most of each: calls of Python functions, files of mpsim that they are in, kernels compiled or loaded."""

    calls: int
    files: int
    kernels: int


SCENES = {
    "naive, 100 discs": Limits(47, 10, 4),
    "grid, 1000 discs": Limits(49, 10, 7),
    "event, 100 discs": Limits(44, 9, 1),
}

COUNTER = """
import json, sys
import mpsim
from mpsim.kernels.compiling import compiled_kernels
scene = mpsim.Scene.random(count={count}, packing=0.4, radius=0.5, temperature=1.0, seed=3)
placed = compiled_kernels()
with mpsim.Simulation(scene, mpsim.Settings(dt=0.02, method="{method}")) as sim:
    sim.run(frames=1)
    kernels = compiled_kernels() - placed
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
    own = [each for each in files if each.startswith(mpsim.__path__[0])]
print(json.dumps([calls, len(own), kernels]))
"""
"""Prints the counts of `Limits`."""


def counted(name: str) -> Limits:
    """Counts of a scene, in a process of its own."""
    method, count = name.removesuffix(" discs").split(", ")
    text = COUNTER.format(count=count, method=method)
    done = subprocess.run([sys.executable, "-c", text], check=True, capture_output=True, text=True)
    return Limits(*json.loads(done.stdout))


def main() -> int:
    """Print the table; 1 if a count is above its limit."""
    table, above = Table("run(frames=1)", *Limits._fields), False
    for name, limits in SCENES.items():
        pairs = list(zip(counted(name), limits, strict=True))
        above |= any(count > most for count, most in pairs)
        words = [f"{count}" if count <= most else f"[red]{count} > {most}" for count, most in pairs]
        table.add_row(name, *words)
    Console().print(table)
    return int(above)


if __name__ == "__main__":
    sys.exit(main())
