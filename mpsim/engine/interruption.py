"""Ctrl-C in a run on MPI ranks: all ranks stop after the same slice of frames."""

import signal

from mpsim.core.deferred_signals import Noted
from mpsim.engine.solvers.base import Solver


class Interruption:
    """Notes Ctrl-C, and raises it where all processes look. Use it in a `with` block.

    Else it would come to each of them somewhere else, and the others would wait there for ever. In a run of one process
    it comes as it always does.

    Args:
        solver: that runs the frames.
    """

    def __init__(self, solver: Solver):
        self._solver = solver
        self._noted = Noted(signal.SIGINT)

    def __enter__(self) -> "Interruption":
        if self._is_shared:
            self._noted.begin()
        return self

    def __exit__(self, kind: type[BaseException] | None, *exception: object) -> None:
        self._noted.end()
        if kind is None:
            self.look()  # it may have come after the last slice
        elif self._noted.came and kind is not KeyboardInterrupt:  # the run has ended otherwise
            self._noted.send_again()

    def look(self) -> None:
        """Raise KeyboardInterrupt in all processes if Ctrl-C has come to one. All of them look."""
        if self._is_shared and self._solver.any_of(self._noted.came):
            raise KeyboardInterrupt

    @property
    def _is_shared(self) -> bool:
        return self._solver.capabilities.on_ranks
