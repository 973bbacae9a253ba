"""Back in time: to the moment before a change, or to one that was remembered, from checkpoints."""

import tempfile
from collections.abc import Container
from pathlib import Path

from mpsim.core.errors import InputError
from mpsim.engine.simulation import Simulation

MOST_POINTS = 16
"""Moments before changes, of one simulation, that are remembered at most, the last ones."""

MOST_BYTES = 2**28
"""Bytes of their checkpoints together at most; of very many discs fewer moments are remembered."""


class Moments:
    """Moments of one simulation, by number, in a folder of their own that `close` removes.

    >>> from mpsim import Scene
    >>> sim, moments = Simulation(Scene.random(count=5, packing=0.2, radius=0.5, seed=1)), Moments()
    >>> moments.keep(7, sim)
    >>> for _ in range(2):  # as often as one likes
    ...     report = sim.run(frames=3)
    ...     sim = moments.back(7, sim)
    >>> sim.frame, len(moments), moments.last
    (0, 1, 7)
    >>> sim.close(); moments.close()
    """

    def __init__(self) -> None:
        self._sizes: dict[int, int] = {}  # bytes of the checkpoint of each, the oldest first
        self._folder: tempfile.TemporaryDirectory[str] | None = None  # from the first one

    def __len__(self) -> int:
        return len(self._sizes)

    @property
    def last(self) -> int:
        """Number of the last moment; 0 if there is none."""
        return next(reversed(self._sizes), 0)

    def keep(self, number: int, sim: Simulation) -> None:
        """Remember this moment under a number, in place of the one that had it.

        Raises:
            OutputError: if the checkpoint cannot be written.
        """
        if self._folder is None:
            self._folder = tempfile.TemporaryDirectory(prefix="mpsim-view-")
        self.forget(number)
        self._sizes[number] = sim.save(self._path(number)).stat().st_size

    def trim(self, spared: Container[int] = ()) -> list[int]:
        """Forget the first of more than MOST_POINTS or MOST_BYTES; returns their numbers. Spared ones do not count."""
        counted = [number for number in self._sizes if number not in spared]
        forgotten: list[int] = []
        while len(counted) > MOST_POINTS or sum(self._sizes[number] for number in counted) > MOST_BYTES:
            forgotten.append(counted.pop(0))
            self.forget(forgotten[-1])
        return forgotten

    def back(self, number: int, sim: Simulation) -> Simulation:
        """The simulation as it was at a moment; the given one is closed.

        Raises:
            InputError: if that moment is not remembered.
        """
        if number not in self._sizes:
            raise InputError("going back needs a remembered moment; got none. Reset starts again.")
        settings = sim.settings
        again = Simulation.resume(self._path(number), workers=settings.workers, start_method=settings.start_method)
        sim.close()
        return again

    def forget(self, number: int) -> None:
        """Forget a moment, if it is remembered."""
        if self._sizes.pop(number, None) is not None:
            self._path(number).unlink()

    def close(self) -> None:
        """Forget all, and remove the folder."""
        self._sizes.clear()
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None

    def _path(self, number: int) -> Path:
        assert self._folder is not None  # since the first one
        return Path(self._folder.name) / f"{number}.mpsim"


class Undo:
    """The moments before the last changes of one simulation.

    >>> from mpsim import Scene
    >>> sim, undo = Simulation(Scene.random(count=5, packing=0.2, radius=0.5, seed=1)), Undo()
    >>> before = sim.digest()
    >>> undo.mark(sim)
    >>> sim.kick(2, impulse=(1, 0))
    >>> sim = undo.back(sim)
    >>> sim.digest() == before, len(sim.journal), len(undo)
    (True, 0, 0)
    >>> sim.close(); undo.close()
    """

    def __init__(self) -> None:
        self._moments = Moments()
        self._made = 0

    def __len__(self) -> int:
        return len(self._moments)

    @property
    def last(self) -> int:
        """Number of the last moment; 0 if there is none. No two have the same."""
        return self._moments.last

    def mark(self, sim: Simulation) -> None:
        """Remember this moment; of too many the first ones are forgotten.

        Raises:
            OutputError: if the checkpoint cannot be written.
        """
        self._made += 1
        self._moments.keep(self._made, sim)
        self._moments.trim()

    def forget_last(self) -> None:
        """Forget the last moment, after which nothing has been changed."""
        self._moments.forget(self.last)

    def back(self, sim: Simulation) -> Simulation:
        """The simulation as it was at the last moment, which is then forgotten; the given one is closed.

        Raises:
            InputError: if there is none.
        """
        if not self._moments:
            raise InputError("undo needs a remembered change; got none. Reset goes back to the start.")
        again = self._moments.back(self.last, sim)
        self.forget_last()
        return again

    def clear(self) -> None:
        """Forget all."""
        while self._moments:
            self.forget_last()

    def close(self) -> None:
        """Forget all, and remove the folder."""
        self._moments.close()
