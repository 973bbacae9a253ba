"""What the ranks of a solver do together: what one of them raises, all raise."""

import contextlib
from collections.abc import Callable

from mpsim.engine.solvers.mpi_ranks import Communicator, raised_together
from mpsim.engine.solvers.stepped import SteppedSolver


class OnRanks(SteppedSolver):
    """A solver that several processes share, each as one rank; `_ranks` are there between `start` and `close`."""

    _ranks: Communicator | None = None

    def _shared(self) -> Communicator:
        assert self._ranks is not None  # between `start` and `close`
        return self._ranks

    def _on_all(self, act: Callable[[], None]) -> None:
        """Act on each rank alone; what one of them raises, all raise."""
        error: Exception | None = None
        try:
            act()
        except Exception as raised:
            error = raised
        self._shared().raise_any(self._shared().all_of(error))

    def together(self) -> contextlib.AbstractContextManager[None]:
        """A block in which what one rank raises, all raise."""
        return raised_together(self.choice.comm)

    def any_of(self, said: bool) -> bool:
        """Whether something is so on any rank."""
        return self._shared().agree(int(said), 0, 0).trouble > 0
