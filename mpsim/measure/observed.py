"""Reads from a simulation what observers measure, and binds each observer to one simulation."""

from typing import Protocol

from mpsim.core.binding import Binding
from mpsim.core.state import State
from mpsim.errors import InputError
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings


class Observed(Protocol):
    """What observers read from a simulation."""

    @property
    def frame(self) -> int:
        """Frames done."""
        ...

    @property
    def time(self) -> float:
        """Simulated time [time]."""
        ...

    @property
    def count(self) -> int:
        """Number of discs."""
        ...

    @property
    def state(self) -> State:
        """All discs."""
        ...

    @property
    def scene(self) -> Scene:
        """Its scene."""
        ...

    @property
    def settings(self) -> Settings:
        """Its settings."""
        ...


class OneSimulation:
    """Binds an observer to the first simulation that it sees.

    Args:
        name: of the observer, for the error.
    """

    def __init__(self, name: str):
        self._name = name
        self._owner = Binding()

    def bind_or_check(self, sim: Observed) -> None:
        """Bind to this simulation the first time; from then on make sure that it is the same.

        Raises:
            InputError: if it is another one.
        """
        if not self._owner.is_to(sim):
            raise InputError(
                f"{self._name} must observe one simulation, {self._owner}; got another, {sim}. "
                "Make one for each; measure.independent_average takes means over them."
            )
