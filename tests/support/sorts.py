"""Two sorts of tests in two processes: kernels as plain Python in the one, machine code in the other.

Each set of features is a compilation of its own, some seconds, and has the same bits in plain Python. So a file says
by its first mark where the whole default suite runs it:

    pytestmark = pytest.mark.plain       features of small scenes: in the process with NUMBA_DISABLE_JIT=1
    pytestmark = pytest.mark.compiled    machine code, workers, thousands of discs: in the other

Files without such a mark run in either, when its own are done. Examples of docstrings are plain, but for long ones.
"""

import os
import re
from functools import cache
from pathlib import Path

from xdist.scheduler import LoadFileScheduling

PACKAGE = Path(__file__).parents[2] / "mpsim"

LONG_EXAMPLES = ("tradeoff.py",)
"""Modules of mpsim whose examples take long in plain Python."""

PLAIN_NODE = "gw0"
"""The process of the plain files, by the name that xdist gives it."""

_VARIABLE = "MPSIM_TESTS_IN_PLAIN_PYTHON"
_MARK = re.compile(r"^pytestmark = (?:\[\s*)?pytest\.mark\.(plain|compiled)\b", re.MULTILINE)


def announce() -> None:
    """In the process that starts the others: tell them that they are two sorts."""
    os.environ[_VARIABLE] = PLAIN_NODE


def variables() -> dict[str, str]:
    """Variables of this process, to be set before Numba is imported: the plain one compiles nothing."""
    plain = os.environ.get(_VARIABLE, "none") == os.environ.get("PYTEST_XDIST_WORKER")
    return {"NUMBA_DISABLE_JIT": "1"} if plain else {}


@cache
def sort_of(path: Path) -> str | None:
    """`plain`, `compiled`, or None for a file of no sort."""
    if path.is_relative_to(PACKAGE):
        return "compiled" if path.name in LONG_EXAMPLES else "plain"
    found = _MARK.search(path.read_text())
    return found.group(1) if found else None


class ByFileAndSort(LoadFileScheduling):
    """Each process gets the files of its sort first, then those of none, then those whose own process has ended."""

    def _reschedule(self, node):
        if self.workqueue and self._next_for(node) is None:
            node.shutdown()
        else:
            super()._reschedule(node)

    def _assign_work_unit(self, node):
        if (scope := self._next_for(node)) is not None:
            self.workqueue.move_to_end(scope, last=False)
            super()._assign_work_unit(node)

    def _next_for(self, node) -> str | None:
        mine, others = _sort_of_node(node), {_sort_of_node(each) for each in self.nodes}
        orphaned = {"plain", "compiled"} - others
        sorts = {scope: sort_of(self.config.rootpath / scope) for scope in self.workqueue}
        wanted = [mine, None, *orphaned]
        return next((scope for each in wanted for scope, sort in sorts.items() if sort == each), None)


def _sort_of_node(node) -> str:
    return "plain" if node.gateway.id == PLAIN_NODE else "compiled"


def pytest_xdist_make_scheduler(config, log):
    """Register this module as a plugin where the sorts apply."""
    return ByFileAndSort(config, log)
