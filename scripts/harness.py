"""What the scripts share: command lines, turns, the machine, tables in Markdown, pages of the docs, exit codes."""

import argparse
import multiprocessing
import platform
import re
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import psutil
from numpy.typing import ArrayLike
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

import mpsim
from mpsim.core import files
from mpsim.core.machine import usable_cores

TOP = Path(__file__).parents[1]
DOCS = TOP / "docs"
TOOL = Path(sys.argv[0]).stem
"""Name of the script that runs."""

BUSY = 1.25
"""Time of a loop, median over least, from which on other work takes so much of the machine that no ratio is printed."""

Found = TypeVar("Found")

console = Console(soft_wrap=True, highlight=False)


# --- a script


def parser_of(text: str | None) -> argparse.ArgumentParser:
    """A parser whose help begins with a script's docstring, in its own lines."""
    return argparse.ArgumentParser(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)


def say(text: str) -> None:
    """Print a text that may have brackets."""
    console.print(text, markup=False)


def exit_code(main: Callable[[], int | None]) -> int:
    """Run a script; an error is printed: 2 where an argument or a file is wrong, 1 for mpsim's other errors."""
    try:
        return main() or 0
    except (mpsim.MpsimError, OSError) as error:
        console.print(f"{TOOL}: {error}", style="red", markup=False)
        return 2 if isinstance(error, mpsim.InputError | OSError) else 1


def make_folder(path: Path) -> None:
    with files.writable("--out", path, "be a folder that can be made and written to", "Choose another place."):
        path.mkdir(parents=True, exist_ok=True)


def progress_bar() -> Progress:
    columns = (TextColumn("{task.description:36.36}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    return Progress(*columns, console=console)


class Apart:
    """A process of its own that calls functions, and another one after it has crashed or was too slow.

    begin, words: a function that each new process calls first, and its arguments.
    """

    def __init__(self, begin: Callable[..., object] | None = None, *words: Any):
        self._begin, self._words = begin, words
        self.pool: ProcessPoolExecutor | None = None

    def call(self, timeout: float, function: Callable[..., Any], *arguments: Any) -> Any:
        """The result of a function, or its error; TimeoutError or BrokenProcessPool if the process has been ended."""
        context = multiprocessing.get_context("spawn")
        self.pool = self.pool or ProcessPoolExecutor(1, context, self._begin, self._words)
        try:
            return self.pool.submit(function, *arguments).result(timeout)
        except (BrokenProcessPool, TimeoutError):
            self.close(now=True)
            raise

    def close(self, now: bool = False) -> None:
        """End the process; now: without waiting for what it does."""
        pool, self.pool = self.pool, None
        if pool is not None:
            for process in (pool._processes or {}).values() if now else ():
                process.kill()
            pool.shutdown()


# --- measurements


def by_turns(runs: Mapping[str, Callable[[], Found]], turns: int) -> dict[str, list[Found]]:
    """The results of each run, all of which take their turn, so that other load of the machine falls on all alike."""
    found: dict[str, list[Found]] = {name: [] for name in runs}
    for _ in range(turns):
        for name, run in runs.items():
            found[name].append(run())
    return found


def with_quartiles(values: ArrayLike) -> str:
    """A median, and the quartiles in brackets."""
    low, middle, high = np.percentile(np.asarray(values, np.float64), [25, 50, 75])
    return f"{middle:.2f} ({low:.2f} to {high:.2f})"


def slowed() -> float:
    """How much other work slows this process down: a loop of a millisecond, timed for 0.3 s, median over least."""
    times, end = [], time.perf_counter() + 0.3
    while time.perf_counter() < end:
        started = time.perf_counter()
        sum(range(50_000))
        times.append(time.perf_counter() - started)
    return float(np.median(times) / np.min(times))


def is_busy(machine_now: dict[str, Any]) -> bool:
    """Whether other work disturbs the times, by the load before, or by what it does to a loop before and after."""
    return machine_now["load_before"] > machine_now["usable_cores"] / 2 or max(machine_now["slowed"]) > BUSY


def machine() -> dict[str, Any]:
    """What the figures were measured on, and with."""
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "commit": commit(),
        "processor": _processor(),
        "usable_cores": usable_cores(),
        "memory_bytes": psutil.virtual_memory().total,
        "system": platform.platform(),
        "python": platform.python_version(),
        "versions": {"mpsim": mpsim.__version__} | {name: version(name) for name in ("numpy", "numba", "llvmlite")},
        "load_before": psutil.getloadavg()[0],
        "slowed": [slowed()],
    }


def commit() -> str:
    """The commit of this checkout, with -dirty where files have changed since."""
    command = ["git", "describe", "--always", "--dirty"]
    return subprocess.run(command, cwd=TOP, capture_output=True, text=True, check=False).stdout.strip() or "unknown"


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


# --- pages


def table(heads: Sequence[str], rows: Iterable[Iterable[object]], right: int = 0) -> str:
    """A table in Markdown; right: number of columns at its right whose cells end alike."""
    rule = "|---" * (len(heads) - right) + "|---:" * right + "|"
    head, *lines = (f"| {' | '.join(map(str, row))} |" for row in (heads, *rows))
    return "\n".join([head, rule, *lines])


def made_by(machine_now: dict[str, Any] | None = None) -> str:
    """Where, when and how the figures came about."""
    now = machine_now or machine()
    return (
        f"Made by `python {shlex.join(sys.argv)}` on {now['usable_cores']} cores of {now['processor']}, "
        f"{now['date'][:10]}, commit {now['commit']}."
    )


def publish(page: Path, text: str) -> None:
    """Print a table with where it was made, and renew the block `table` of a page with both."""
    text = f"{text}\n\n{made_by()}"
    say(text)
    fill_page(page, {"table": text})


def fill_page(page: Path, blocks: Mapping[str, str], pictures: Mapping[str, Path] | None = None) -> None:
    """Renew what stands between `<!-- SCRIPT: NAME -->` and `<!-- end -->`.

    Args:
        page: a Markdown file; a new one has all blocks.
        blocks: texts by NAME; what the page has no place for is left out, and what is not given stays.
        pictures: files by the name that they have in the page's own folder.
    """
    if not page.exists():
        page.write_text("\n".join(f"<!-- {TOOL}: {name} -->\n<!-- end -->\n" for name in blocks))

    def filled(match: re.Match[str]) -> str:
        return f"{match[1]}\n{blocks[match[2]]}\n{match[3]}" if match[2] in blocks else match[0]

    block = re.compile(rf"(<!-- {TOOL}: ([\w-]+) -->)\n.*?( *<!-- end -->)", re.DOTALL)
    page.write_text(block.sub(filled, page.read_text()))
    for name, source in (pictures or {}).items():
        page.with_suffix("").mkdir(exist_ok=True)
        shutil.copyfile(source, page.with_suffix("") / name)
