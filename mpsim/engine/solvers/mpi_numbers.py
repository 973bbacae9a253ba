"""Ranges of the discs of all ranks in the order of their numbers, so that no rank has to hold all discs."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mpsim.core import columns
from mpsim.core.chunks import Array, ChunkedArray, ranges
from mpsim.core.state import Box, State, digest_of, in_chunks
from mpsim.engine.columns import columns_of
from mpsim.engine.solvers.base import NewDiscs
from mpsim.engine.solvers.discs import state_of
from mpsim.engine.solvers.mpi_part import Part
from mpsim.errors import InputError
from mpsim.scene.scene import Scene


class Asked(NamedTuple):
    """What is asked of discs: those of a range of numbers, from `first` to before `last`; one of their rows, or all."""

    first: int
    last: int
    name: str | None = None


Rows = dict[str, NDArray[Any]]
"""A row for each disc, by name of what it is."""


class Sorted(NamedTuple):
    """Own discs by number.

    Attributes:
        numbers: in order.
        places: where each of them is among those of `Part.numbers`.
    """

    numbers: NDArray[np.int64]
    places: NDArray[np.int64]


class DiscsByNumber:
    """What a rank tells of its discs, and what all ranks together know of a range.

    Args:
        part: of this rank.
        scene: of the simulation.
        box: as it is now.
        count: number of all discs.
        ask: what each rank answers, by `own`.
    """

    def __init__(self, part: Part, scene: Scene, box: Box, count: int, ask: Callable[[Asked], list[tuple[Any, Rows]]]):
        self._part = part
        self._scene = scene
        self._box = box
        self._count = count
        self._ask = ask
        self._sorted: Sorted | None = None

    def own(self, asked: Asked) -> tuple[NDArray[np.int64], Rows]:
        """The numbers that this rank has of a range, and a row for each, by name."""
        if (asked.first, asked.last) == (0, self._count):  # of all, none has to be looked for
            return self._part.rows_of(np.arange(len(self._part.numbers())), asked.name)
        if self._sorted is None:  # kept, as who asks for one range asks for the next
            numbers = self._part.numbers()
            order = np.argsort(numbers)
            self._sorted = Sorted(numbers[order], order)
        first, last = np.searchsorted(self._sorted.numbers, asked[:2])
        return self._part.rows_of(self._sorted.places[first:last], asked.name)

    def rows(self, first: int, last: int, name: str | None = None) -> Rows:
        """What steps have changed of the discs of a range, in their order; of a name, or all."""
        found: Rows = {}
        for numbers, own in self._ask(Asked(first, last, name)):
            for each, values in own.items():
                if each not in found:
                    found[each] = np.empty((last - first, *values.shape[1:]), values.dtype)
                found[each][numbers - first] = values
        return found

    def state(self, first: int, last: int) -> State:
        """The discs of a range, in their order."""
        return self._state_of(self.rows(first, last), last - first)

    def own_state(self) -> tuple[NDArray[np.int64], State]:
        """Numbers, rising, of the discs that this rank moves, and their state."""
        live = self._part.numbers()[: self._part.count]
        numbers, found = self._part.rows_of(np.argsort(live))
        return numbers, self._state_of(found, len(live))

    def absorbed(self) -> NDArray[np.bool_]:
        """Which of all discs have left through an absorbing edge, shape (N,), read in chunks."""
        found = np.zeros(self._count, bool)
        for first, last in ranges(self._count):
            found[first:last] = absorbed_in(self.rows(first, last), last - first)
        return found

    def digest(self) -> str:
        """Digest of the state of all discs, read in chunks."""
        values = in_chunks(self.state, self._count)
        if not self._scene.loses_discs:
            del values["present"]  # which all of them are
        return digest_of(values)

    def _state_of(self, found: Rows, count: int) -> State:
        """The state of so many discs of which this is found."""
        absorbed = absorbed_in(found, count)
        found.pop(columns.EXITS.name, None)
        position, velocity = found.pop("position"), found.pop("velocity")
        return state_of(self._box, self._part.arrays, position, velocity, found, absorbed)

    def discs(self, radii: NDArray[np.float64], masses: NDArray[np.float64]) -> NewDiscs:
        """All discs, of these radii and masses, shape (N,) [length], [mass]."""
        found = self.rows(0, self._count)
        position, velocity = found.pop("position"), found.pop("velocity")
        for column in columns_of(self._scene):
            if column.name not in found:  # what stays as it is, which all ranks know
                found[column.name] = self._part.arrays[column.name][..., : self._count].T.copy()
        return NewDiscs(position, velocity, radii, {**found, columns.MASS.name: masses})

    def snapshot(self) -> dict[str, Array]:
        """What steps have changed, as a snapshot holds it, to be read in chunks."""
        return {
            name: ChunkedArray(none.dtype, (self._count, *none.shape[1:]), self._reader(name))
            for name, none in self.rows(0, 0).items()
        }

    def _reader(self, name: str) -> Callable[[int, int], NDArray[Any]]:
        return lambda first, last: self.rows(first, last, name)[name]


def absorbed_in(rows: Rows, count: int) -> NDArray[np.bool_]:
    """Which of the discs of a range have left through an absorbing edge, shape (count,)."""
    exits = rows.get(columns.EXITS.name)
    return np.zeros(count, bool) if exits is None else exits[:, 0] != 0


def answers_to_one(told: list[tuple[Asked, Any]]) -> list[Any]:
    """What ranks have told, with what each was asked.

    Raises:
        InputError: if they were not asked the same.
    """
    if len({asked for asked, _ in told}) > 1:
        ranges = ", ".join(str(tuple(asked[:2])) for asked, _ in told)
        raise InputError(
            f"the range of discs must be the same on all ranks; got {ranges}. Ask for one range, or use local_state."
        )
    return [answer for _, answer in told]
