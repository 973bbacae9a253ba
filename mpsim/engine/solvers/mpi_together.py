"""Common errors of ranks: an error on one rank is raised on all."""

import contextlib
from abc import abstractmethod
from collections.abc import Callable
from typing import Any, TypeVar

from mpsim.core.deferred_signals import interrupts_held_back
from mpsim.core.team import Team
from mpsim.engine.solvers.mpi_numbers import Asked, DiscsByNumber, answers_to_one
from mpsim.engine.solvers.mpi_ranks import Communicator, raised_together
from mpsim.engine.solvers.stepped import SteppedSolver
from mpsim.errors import BusyError

Result = TypeVar("Result")


class OnRanks(SteppedSolver):
    """A solver that several processes share, each as one rank; `_ranks` are there between `start` and `close`."""

    _ranks: Communicator | None = None
    _numbered: DiscsByNumber | None = None
    _acts_once: bool = False  # this is the first rank, and the others wait for what it asks
    _each_asks: bool = False  # each rank asks for discs of its own

    @abstractmethod
    def _by_number(self) -> DiscsByNumber:
        """The discs of all ranks by number; as long as none moves."""

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
        return raised_together(self.choice.processes.comm)

    def any_of(self, said: bool) -> bool:
        """Whether something is so on any rank."""
        return self._shared().agree(int(said), 0, 0).trouble > 0

    def demand_alike(self, what: str, given: object) -> None:
        """Refuse what differs on some ranks."""
        if self._acts_once:
            raise BusyError("what `once` calls may only read a simulation; it was to be changed. Do it on all ranks.")
        self._shared().demand_alike(what, given)

    def once(self, act: Callable[[], Result]) -> Result:
        """What an act gives that rank 0 alone does; what it raises, all raise. It may read discs of all ranks."""
        if self._acts_once:
            return act()
        ranks = self._shared()
        self._acts_once = ranks.rank == 0
        try:
            return ranks.once(act, self._by_number().own)
        finally:
            self._acts_once, self._numbered = False, None

    def jointly(self, act: Callable[[Team], Result]) -> Result:
        """What an act gives that all ranks do. Signals wait for its end: no rank may leave it before the others."""
        self._each_asks = True
        try:
            with interrupts_held_back():
                return act(self._shared())
        finally:
            self._each_asks, self._numbered = False, None

    def _told_of(self, asked: Asked) -> list[Any]:
        """What each rank has of a range."""
        ranks, own = self._shared(), self._by_number().own
        if self._acts_once:
            return ranks.ask(asked, own)
        if self._each_asks:
            return ranks.each_to_each([own(of_one) for of_one in ranks.all_of(asked)])
        return answers_to_one(ranks.all_of((asked, own(asked))))
