"""An observer that writes belongs to one simulation: frames of two in one file would mean nothing."""

import weakref
from pathlib import Path

from mpsim.engine.simulation import Simulation
from mpsim.errors import OutputError


class Ownership:
    """Holds an observer that writes to the first simulation that it observes.

    Args:
        what: what is written, for the error: "trajectory".
        path: of the file.
        advice: how the other simulation gets its own.
    """

    def __init__(self, what: str, path: Path, advice: str):
        self._name = f"{what} {str(path)!r}"
        self._advice = advice
        self._owner: weakref.ref[Simulation] | None = None

    def check(self, sim: Simulation) -> None:
        """Make sure that it is the same simulation as before.

        Raises:
            OutputError: if it is another; nothing was written.
        """
        if self._owner is None:
            self._owner = weakref.ref(sim)
        owner = self._owner()
        if owner is not sim:
            raise OutputError(
                f"the {self._name} belongs to one simulation, {owner or 'which is gone by now'}; got another, {sim}. "
                f"{self._advice}"
            )
