"""Quantities that the colours of discs can show, such as speed, and their scales."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mpsim.core import checks
from mpsim.core.errors import InputError
from mpsim.engine.collision_observers import Collisions
from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers.in_place import InPlace
from mpsim.viewer.colours import ABSORBED, FASTEST, KNEE

CHOICES = ("speed", "worker", "column", "collision", "own")
"""What colours may stand for: speed; worker; parity of the column, so the pass in which contacts are resolved; time
since the last collision; an array of the program."""

LOW, MIDDLE = FASTEST - KNEE, FASTEST // 2
"""Byte below which the lowest 2 % of values are, as the highest 2 % are above KNEE; and byte of what has no value."""

PERCENTILES = (0, 2, 98, 100)
"""Where the scale of values has its corners: at bytes 0, LOW, KNEE and FASTEST."""


class Colouring:
    """The colours of the discs of one simulation.

    Args:
        own: numbers to colour by, shape (N,), as `own_colours` returns them; None: there are none. They are read at
            each picture.

    Attributes:
        by: one of CHOICES.
    """

    def __init__(self, own: NDArray[np.float64] | None = None):
        self._own = own
        self.by: str = "speed" if own is None else "own"
        self._legend: dict[str, Any] = {}
        self.begin()

    def begin(self) -> None:
        """Begin anew, as another simulation is shown or other colours: no collision has been seen yet."""
        self._last = np.zeros(0)
        self._since: float | None = None
        self._has_columns: bool | None = None  # not known yet
        self._collisions = Collisions(each=self._collided)

    def choices(self, sim: Simulation) -> list[str]:
        """What there is to choose from."""
        if self._has_columns is None:
            self._has_columns = _has_columns(sim)
        there = {"worker": self._has_columns, "column": self._has_columns, "own": self._own is not None}
        return [name for name in CHOICES if there.get(name, True)]

    def choose(self, by: str, sim: Simulation) -> None:
        """Have the colours stand for something else from now on.

        Raises:
            InputError: for what this simulation does not have.
        """
        self.by = checks.choice("by of colour", by, self.choices(sim))
        self.begin()

    def observers(self, every: int) -> list[Collisions]:
        """Observers of the next run; every: frames between two looks."""
        self._collisions.every = every
        return [self._collisions] if self.by == "collision" else []

    def end_run(self, sim: Simulation) -> None:
        """Take what has been observed since the last look of a run that has ended."""
        if self.by == "collision":
            self._collisions.look(sim, 0)

    def _collided(self, sim: Simulation, table: NDArray[Any]) -> None:
        """Note when discs collided."""
        self._last_of(sim.count)
        for name, rows in (("i", table), ("j", table[table["kind"] == 0])):
            np.maximum.at(self._last, rows[name], rows["time"])

    def _last_of(self, count: int) -> NDArray[np.float64]:
        """Time of the last collision of each disc, -infinity before the first."""
        if len(self._last) < count:
            self._last = np.append(self._last, np.full(count - len(self._last), -math.inf))
        return self._last[:count]

    def bytes_of(self, sim: Simulation, discs: InPlace) -> NDArray[np.uint8] | None:
        """The colour of each disc, in the order of their numbers; None: that of the speeds' scale."""
        if self.by == "speed":
            self._legend = {}
            return None
        if self.by in ("worker", "column"):
            found = sim.columns()
            classes = found.owner if self.by == "worker" else found.of_disc % 2
            number = 2 if self.by == "column" else int(found.owner.max(initial=0)) + 1
            colours = (classes * (FASTEST / max(number - 1, 1))).astype(np.uint8)
            self._legend = {"classes": number}
        else:
            colours = self._on_scale(self._values(discs))
        if discs.absent is not None:
            colours[discs.absent] = ABSORBED
        return colours

    def _values(self, discs: InPlace) -> NDArray[np.float64]:
        """A number for each disc; not finite where there is none."""
        count = len(discs.number)
        if self.by == "collision":
            since = discs.time if self._since is None else self._since
            self._since = since
            return discs.time - np.maximum(self._last_of(count), since)
        values = np.full(count, math.nan)
        assert self._own is not None  # or it could not have been chosen
        known = min(count, len(self._own))
        values[:known] = self._own[:known]
        return values

    def _on_scale(self, values: NDArray[np.float64]) -> NDArray[np.uint8]:
        """Values as bytes, by percentiles of those that there are."""
        here = np.isfinite(values)
        if not here.any():
            self._legend = {}
            return np.full(len(values), MIDDLE, np.uint8)
        corners = np.percentile(values[here], PERCENTILES)
        self._legend = {"values": corners.tolist()}
        if corners[0] == corners[-1]:
            return np.full(len(values), MIDDLE, np.uint8)
        found = np.interp(values, corners, (0, LOW, KNEE, FASTEST))
        return np.where(here, found + 0.5, MIDDLE).astype(np.uint8)

    def told(self, sim: Simulation) -> dict[str, Any]:
        """What pages need for the legend: what the colours stand for, the corners of the scale or number of classes."""
        return {"by": self.by, "choices": self.choices(sim), **self._legend}


def _has_columns(sim: Simulation) -> bool:
    """Whether discs are sorted into columns, which belong to workers."""
    try:
        return sim.columns().number > 0
    except InputError:
        return False


def own_colours(colour: ArrayLike | None, count: int) -> NDArray[np.float64] | None:
    """Numbers to colour discs by, checked; an array of float64 is taken as it is, so that its program can change it.

    Args:
        colour: shape (N,), a number for each disc, or None. NaN: this disc has none.
        count: N.

    Raises:
        InputError: for another shape, or what are no numbers.

    >>> own_colours([1, 2.5], 2).tolist()
    [1.0, 2.5]
    """
    if colour is None:
        return None
    try:
        found = np.asarray(colour, np.float64)
    except (TypeError, ValueError):
        found = np.zeros(())
    if found.shape != (count,):
        raise InputError(
            f"colour must be an array of {count} numbers, one for each disc; got {checks.brief(colour)}. "
            "Use mpsim.view(sim, colour=values)."
        )
    return found
