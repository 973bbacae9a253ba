"""Undo: goes back to an earlier moment, by snapshots in memory."""

from collections.abc import Mapping

from mpsim.engine.simulation import Simulation
from mpsim.engine.snapshot import Snapshot
from mpsim.errors import InputError

MOST_POINTS = 16  # largest number of remembered moments before changes; the oldest ones are forgotten

MOST_BYTES = 2**28
"""Largest size of all their snapshots, including those of a second stage, in bytes. With very many discs, fewer
moments are remembered."""


class Moments:
    """Snapshots of moments of one simulation, by number, the oldest first.

    >>> from mpsim import Scene
    >>> sim, moments = Simulation(Scene.random(count=5, packing=0.2, radius=0.5, seed=1)), Moments()
    >>> moments.keep(7, sim)
    >>> for _ in range(2):  # as often as needed
    ...     report = sim.run(frames=3)
    ...     moments.back(7, sim)
    >>> sim.frame, moments.numbers
    (0, (7,))
    >>> sim.close()
    """

    def __init__(self) -> None:
        self._kept: dict[int, Snapshot] = {}

    @property
    def numbers(self) -> tuple[int, ...]:
        """Numbers of the moments."""
        return tuple(self._kept)

    @property
    def sizes(self) -> dict[int, int]:
        """Bytes of each moment, by number."""
        return {number: snapshot.nbytes for number, snapshot in self._kept.items()}

    def keep(self, number: int, sim: Simulation) -> None:
        """Remember this moment under a number, which may replace an earlier moment."""
        self._kept[number] = sim.snapshot()

    def back(self, number: int, sim: Simulation) -> None:
        """Go back to a moment.

        Raises:
            InputError: if that moment is not remembered.
        """
        if number not in self._kept:
            raise InputError("going back needs a remembered moment; got none. Reset starts again.")
        sim.restore(self._kept[number])

    def forget(self, number: int) -> None:
        """Forget a moment, if it is remembered."""
        self._kept.pop(number, None)

    def clear(self) -> None:
        """Forget all moments."""
        self._kept.clear()


class Undo:
    """Remembers the moments before the last changes of one simulation.

    >>> from mpsim import Scene
    >>> sim, undo = Simulation(Scene.random(count=5, packing=0.2, radius=0.5, seed=1)), Undo()
    >>> before = sim.digest()
    >>> undo.mark(sim)
    >>> sim.kick(2, impulse=(1, 0))
    >>> undo.back(sim)
    >>> sim.digest() == before, len(sim.journal), len(undo)
    (True, 0, 0)
    >>> sim.close()
    """

    def __init__(self) -> None:
        self._moments = Moments()
        self._made = 0

    def __len__(self) -> int:
        return len(self.numbers)

    @property
    def numbers(self) -> tuple[int, ...]:
        """Numbers of the moments, the oldest first. A number is never used twice."""
        return self._moments.numbers

    @property
    def last(self) -> int:
        """Number of the last moment; 0 if there is none."""
        return max(self.numbers, default=0)

    def mark(self, sim: Simulation) -> None:
        """Remember this moment."""
        self._made += 1
        self._moments.keep(self._made, sim)

    def trim(self, beside: Mapping[int, int]) -> None:
        """Forget the oldest moments until there are at most MOST_POINTS with at most MOST_BYTES.

        beside: sizes of further snapshots of the same moments, by number, which count too.
        """
        sizes = {number: size + beside.get(number, 0) for number, size in self._moments.sizes.items()}
        for number in self.numbers:
            if len(sizes) <= MOST_POINTS and sum(sizes.values()) <= MOST_BYTES:
                break
            del sizes[number]
            self._moments.forget(number)

    def forget_last(self) -> None:
        """Forget the last moment, because nothing was changed after it."""
        self._moments.forget(self.last)

    def back(self, sim: Simulation) -> None:
        """Go back to the last moment, which is then forgotten.

        Raises:
            InputError: if there is no moment.
        """
        if not self.numbers:
            raise InputError("undo needs a remembered change; got none. Reset goes back to the start.")
        self._moments.back(self.last, sim)
        self.forget_last()

    def clear(self) -> None:
        """Forget all moments."""
        self._moments.clear()
