"""Ctrl-C in a run that several processes share: it comes to all of them between the same two slices of frames."""

import os
import signal
import threading
from typing import Any

from mpsim.core.deferred_signals import Handled
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
        self._creator = os.getpid()
        self._came = False
        self._handled: Handled | None = None

    def __enter__(self) -> "Interruption":
        if self._is_shared and threading.current_thread() is threading.main_thread():
            self._handled = Handled(signal.SIGINT, self._note)
        return self

    def __exit__(self, kind: type[BaseException] | None, *exception: object) -> None:
        handled, self._handled = self._handled, None
        if handled is not None:
            handled.put_back()
        if kind is None:
            self.look()  # it may have come after the last slice
        elif self._came and kind is not KeyboardInterrupt:
            signal.raise_signal(signal.SIGINT)  # the run has ended otherwise: let it do what it does without us

    def look(self) -> None:
        """Raise KeyboardInterrupt in all processes if Ctrl-C has come to one. All of them look."""
        if self._is_shared and self._solver.any_of(self._came):
            raise KeyboardInterrupt

    @property
    def _is_shared(self) -> bool:
        return self._solver.capabilities.on_ranks

    def _note(self, number: int, frame: Any) -> None:
        if os.getpid() != self._creator and self._handled is not None:  # a fork, where nobody looks
            self._handled.put_back()
            signal.raise_signal(signal.SIGINT)
        self._came = True
