"""Measures how long a user waits for machine code: from the start of a process to its result, with an empty cache.

python scripts/check_waits.py              all cases
python scripts/check_waits.py readme view-hopper

Each case runs twice in the same new cache: cold, when everything is compiled, and warm. Printed beside the seconds:
processor seconds, and how many files of machine code above 100 kB the case left behind.
"""

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from page_blocks import blocks_of
from rich.console import Console
from rich.table import Table

ROOT = Path(__file__).resolve().parents[1]
LARGE = 100_000
"""Bytes of machine code from which on it counts as a kernel that somebody waited for."""

FIRST_MOVING_PICTURE = """
import json, struct, sys, mpsim
from urllib.parse import urlsplit
from websockets.sync.client import connect
with mpsim.view(mpsim.Scene.load({name!r}), browser=False, wait=False) as view:
    where = urlsplit(view.address)
    host = where.netloc
    with connect(f"ws://{{host}}{{where.path}}socket", origin=f"http://{{host}}", max_size=None) as page:
        page.send(json.dumps(dict(do="visible", value=True)))
        frame = 0
        while frame < 1:
            message = page.recv()
            if isinstance(message, bytes):
                kind, serial, frame = struct.unpack_from("<4xxBxxIxxxxQ", message)
                if kind == 1:
                    page.send(json.dumps(dict(do="ack", serial=serial)))
"""


def readme() -> str:
    """README's example as a program."""
    blocks = blocks_of((ROOT / "README.md").read_text())
    lines = next(block.code for block in blocks if block.language == "python").splitlines()
    return "\n".join(line[4:] for line in lines if line.startswith((">>>", "...")))


CASES = {
    "readme": ["-c", readme()],
    "run-hopper": ["-m", "mpsim", "run", "hopper", "--frames", "20", "--quiet"],
    "view-gas": ["-c", FIRST_MOVING_PICTURE.format(name="gas")],
    "view-hopper": ["-c", FIRST_MOVING_PICTURE.format(name="hopper")],
}


def timed(command: list[str], cache: str) -> tuple[float, float]:
    """Seconds, and processor seconds, of a new interpreter with this cache, in a folder of its own."""
    environment = os.environ | {"NUMBA_CACHE_DIR": cache, "PYTHONPATH": str(ROOT)}
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, *command], env=environment, cwd=folder, check=True, stdout=subprocess.DEVNULL)
    seconds, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    return seconds, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    """Print the table."""
    table = Table("case", "cold [s]", "processor [s]", "warm [s]", "kernels above 100 kB")
    for name in sys.argv[1:] or CASES:
        with tempfile.TemporaryDirectory() as cache:
            (cold, processor), (warm, _) = timed(CASES[name], cache), timed(CASES[name], cache)
            large = sum(path.stat().st_size > LARGE for path in Path(cache).rglob("*.nbc"))
        table.add_row(name, f"{cold:.1f}", f"{processor:.1f}", f"{warm:.1f}", str(large))
    Console().print(table)


if __name__ == "__main__":
    main()
