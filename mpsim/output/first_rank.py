"""Files of MPI ranks: the first rank reads and writes them, and sends the content to the others."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from mpsim.core import joint_file
from mpsim.core.joint_file import JointFile
from mpsim.core.team import Alone
from mpsim.engine.solvers.mpi_ranks import communicator_of

Result = TypeVar("Result")


class FirstRank:
    """Does for all ranks what only one process may do, such as writing a file. Without ranks, this process does it.

    All ranks make the same calls, except `alone`.

    Args:
        comm: a communicator of mpi4py; None: there are no ranks.

    Attributes:
        comm: as it was given.
    """

    def __init__(self, comm: Any = None):
        self.comm: Any = comm
        self._ranks = None if comm is None else communicator_of(comm)

    def opened(self, path: Path) -> JointFile:
        """A file made by the first rank, opened by all that write to it."""
        return joint_file.opened(Alone() if self._ranks is None else self._ranks, path)

    def once(self, act: Callable[[], Result]) -> Result:
        """The result of a call made by the first rank; an error that it raises is raised on all ranks."""
        return act() if self._ranks is None else self._ranks.once(act)

    def alone(self, act: Callable[[], None]) -> None:
        """Let the first rank do something without the others: when a run fails, they may never make the call."""
        if self._ranks is None or self._ranks.rank == 0:
            act()

    def any_of(self, said: bool) -> bool:
        """Whether something is true on any rank."""
        return said if self._ranks is None else self._ranks.agree(int(said), 0, 0).trouble > 0

    def close(self) -> None:
        """Release the communicator. May be called again."""
        ranks, self._ranks = self._ranks, None
        if ranks is not None:
            ranks.close()
