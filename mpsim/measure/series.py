"""A function of the state as a time series along a run, and what observers read from a simulation."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.core.binding import Binding
from mpsim.core.state import State
from mpsim.errors import InputError
from mpsim.measure.statistics import Equilibration, equilibration
from mpsim.scene.scene import Scene

if TYPE_CHECKING:
    from mpsim.engine.simulation import Simulation

# --- Reads from a simulation what observers measure, and binds each observer to one simulation


class OneSimulation:
    """Binds an observer to the first simulation that it sees.

    Args:
        name: of the observer, for the error.
    """

    def __init__(self, name: str):
        self._name = name
        self._owner = Binding()

    def bind_or_check(self, sim: Simulation) -> None:
        """Bind to this simulation the first time; from then on make sure that it is the same.

        Raises:
            InputError: if it is another one.
        """
        if refusal := self._owner.refusal(sim):
            raise InputError(
                f"{self._name} belongs to {refusal}. Make one for each; measure.independent_average takes means over "
                "them."
            )


# --- A function of the state as a time series along a run


class Series:
    """An observer for `Simulation.run(observe=...)` that records a function of the state every few frames.

    The series is kept in memory only, at 16 bytes a sample; `mpsim run --out` writes a table to a file. A frame is
    recorded once.

    Args:
        function: called as function(state, scene), gives a number [any], such as `measure.temperature`.
        every: frames between two samples, >= 1.

    Raises:
        InputError: naming the argument, its rule and the value received; in the run, if the function gives no number,
            or the simulation is another one.

    >>> import mpsim
    >>> scene = mpsim.Scene.random(count=50, packing=0.2, radius=0.5, seed=1)
    >>> kurtosis = mpsim.measure.Series(lambda state, scene: mpsim.measure.speed_kurtosis(state), every=10)
    >>> with mpsim.Simulation(scene, mpsim.Settings(dt=0.02, method="grid")) as sim:
    ...     report = sim.run(frames=1000, observe=kurtosis)
    >>> len(kurtosis.value), kurtosis.time[-1].round(9)
    (101, np.float64(20.0))
    """

    def __init__(self, function: Callable[[State, Scene], float], every: int = 1):
        if not callable(function):
            raise InputError(
                f"function of a Series must be called as function(state, scene); got {checks.brief(function)}. Use "
                "mpsim.measure.temperature, for instance."
            )
        self.every: int = checks.whole("every", every, 1, 10**12, "1 samples every frame.")
        self._function = function
        self._owner = OneSimulation("a Series")
        self._frame = -1
        self._rows: list[tuple[float, float]] = []

    def observe(self, sim: Simulation, collisions: int) -> None:
        """Record the value at the present frame, unless it has been recorded.

        Args:
            sim: the simulation, always the same.
            collisions: not used.
        """
        del collisions
        self._owner.bind_or_check(sim)
        if sim.frame <= self._frame:
            return
        value = checks.number("what function of a Series gives", self._function(sim.state, sim.scene), "a number")
        self._rows.append((sim.time, value))
        self._frame = sim.frame

    @property
    def time(self) -> NDArray[np.float64]:
        """Times of the samples, shape (n,) [time]."""
        return np.array([time for time, _ in self._rows])

    @property
    def value(self) -> NDArray[np.float64]:
        """Values of the function, shape (n,) [of the function]."""
        return np.array([value for _, value in self._rows])

    def equilibration(self, *, batch: int = 5) -> Equilibration:
        """Where the stationary part of the series begins, from `measure.equilibration` of its values.

        Args:
            batch: number of samples in a batch.

        Raises:
            InputError: if there are too few values, or one is not finite.
        """
        return equilibration(self.value, batch=batch)

    def __repr__(self) -> str:
        return f"<Series: {len(self._rows)} values>"
