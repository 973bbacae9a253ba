"""Observers that write files belong to one simulation, because mixed frames would be meaningless."""

from pathlib import Path

from mpsim.core.binding import Binding
from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.errors import InputError, OutputError


class Ownership:
    """Binds an observer that writes to the first simulation that it observes.

    Args:
        what: what is written, for the error: "trajectory".
        path: of the file.
        advice: how the other simulation can have its own.
        on_ranks: whether all ranks of a communicator observe together.
    """

    def __init__(self, what: str, path: Path, advice: str, on_ranks: bool = False):
        self._on_ranks = on_ranks
        self._name = f"{what} {str(path)!r}"
        self._advice = advice
        self._owner = Binding()
        self._closed: str | None = None

    def close(self, advice: str) -> None:
        """Refuse every simulation from now on. advice: how to continue the file."""
        self._closed = advice

    def bind_or_check(self, sim: Simulation) -> None:
        """Bind to this simulation the first time; after that, check that it is the same.

        Raises:
            OutputError: if it is another one, or after `close`; nothing was written.
            InputError: if the simulation runs on ranks and the observer does not, or the other way round.
        """
        if self._closed is not None:
            raise OutputError(
                f"the {self._name} must be open to be written to, and was closed, as by the end of its `with` block; "
                f"got {sim} to observe. Put all its runs into that block. {self._closed}"
            )
        if capabilities_of(sim.settings).on_ranks != self._on_ranks:
            raise InputError(
                f"the {self._name} must be given comm, the communicator of the simulation, with method='mpi' and only "
                f"there; the method is {sim.settings.method!r}. Open it on all ranks, or without comm."
            )
        if not self._owner.is_to(sim):
            raise OutputError(
                f"the {self._name} belongs to one simulation, {self._owner}; got another, {sim}. {self._advice}"
            )
