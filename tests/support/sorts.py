"""The processes of the whole default suite: two with kernels as plain Python, two with machine code.

Each set of features is a compilation of its own, some seconds, and has the same bits in plain Python. So a file says
by its first mark where the whole default suite runs it:

    pytestmark = pytest.mark.plain       features of small scenes: in a process with NUMBA_DISABLE_JIT=1
    pytestmark = pytest.mark.compiled    machine code, workers, thousands of discs: in another

Files without such a mark run as well in either, and examples of docstrings are plain, but for long ones. Of each sort
there are two processes, each with folders of its own, so that some compute while others wait: for processes, signals
and sockets, as tests of faults and pages do half of their time. Each process collects its own files alone.
"""

import fcntl
import os
import re
import tempfile
from pathlib import Path

from xdist.scheduler import EachScheduling

PACKAGE = Path(__file__).parents[2] / "mpsim"

LONG_EXAMPLES = ("tradeoff.py",)  # modules of mpsim whose examples take long in plain Python
FIRST = ("contracts", "doors")  # folders of the first two processes; the other two have the rest

SHARES = {"gw0": ("plain", True), "gw1": ("compiled", True), "gw2": ("plain", False), "gw3": ("compiled", False)}
"""Sort of the files and whether their folder is one of the first, of each process by the name that xdist gives it."""

_VARIABLE = "MPSIM_TESTS_IN_SHARES"
_MARK = re.compile(r"^pytestmark = (?:\[\s*)?pytest\.mark\.(plain|compiled)\b", re.MULTILINE)


def announce() -> None:
    """In the process that starts the others: tell them that each has its share."""
    os.environ[_VARIABLE] = "yes"


def mine() -> tuple[str, bool] | None:
    """The share of this process; None: it runs whatever it is told."""
    return SHARES.get(os.environ.get("PYTEST_XDIST_WORKER", "")) if _VARIABLE in os.environ else None


def variables() -> dict[str, str]:
    """Variables of this process, to be set before Numba is imported: a plain one compiles nothing."""
    share = mine()
    return {"NUMBA_DISABLE_JIT": "1"} if share and share[0] == "plain" else {}


def pytest_sessionstart() -> None:
    """Compile what most compiled files need in one process at a time; the other loads it from the cache."""
    share = mine()
    if share is None or share[0] == "plain":
        return
    import mpsim  # noqa: PLC0415 - which imports Numba, after the variables are set

    with (Path(tempfile.gettempdir()) / f"mpsim-tests-compile-{os.getuid()}").open("w") as turn:
        fcntl.flock(turn, fcntl.LOCK_EX)  # until it is closed
        scene = mpsim.Scene.random(count=9, packing=0.1, radius=0.5)
        for method in ("naive", "grid", "event"):
            with mpsim.Simulation(scene, mpsim.Settings(method=method)) as sim:
                sim.run(frames=1)


def share_of(path: Path) -> tuple[str, bool]:
    """The share to which a file belongs."""
    if path.is_relative_to(PACKAGE):
        return "compiled" if path.name in LONG_EXAMPLES else "plain", True
    found = _MARK.search(path.read_text())
    return found[1] if found else "plain", path.parent.name in FIRST


def pytest_ignore_collect(collection_path: Path) -> bool | None:
    """In the processes of the suite: leave the files of the others to them."""
    return True if collection_path.suffix == ".py" and share_of(collection_path) != mine() else None


class ByShare(EachScheduling):
    """Each process runs all that it has collected."""

    def schedule(self) -> None:
        super().schedule()
        session = self.config.pluginmanager.get_plugin("session")
        session.testscollected = sum(map(len, self.node2collection.values()))  # for the percentages


def pytest_xdist_make_scheduler(config, log):
    """In the process that starts the others."""
    return ByShare(config, log)
