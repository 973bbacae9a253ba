"""Changes taken back: a checkpoint before each, so that going back costs no run from the start."""

import tempfile
from collections import deque
from pathlib import Path
from typing import NamedTuple

from mpsim.core.errors import InputError
from mpsim.engine.simulation import Simulation

MOST_POINTS = 16
"""Changes that can be taken back at most, the last ones."""

MOST_BYTES = 2**28
"""Bytes of their checkpoints together at most; of very many discs fewer changes can be taken back."""


class _Point(NamedTuple):
    path: Path
    size: int


class Undo:
    """Checkpoints of one simulation, in a folder of their own that `close` removes.

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
        self._points: deque[_Point] = deque()
        self._folder: tempfile.TemporaryDirectory[str] | None = None  # from the first point
        self._made = 0

    def __len__(self) -> int:
        return len(self._points)

    def mark(self, sim: Simulation) -> None:
        """Remember this moment; of too many the first ones are forgotten.

        Raises:
            OutputError: if the checkpoint cannot be written.
        """
        if self._folder is None:
            self._folder = tempfile.TemporaryDirectory(prefix="mpsim-view-")
        self._made += 1
        path = sim.save(Path(self._folder.name) / f"{self._made}.mpsim")
        self._points.append(_Point(path, path.stat().st_size))
        while len(self._points) > MOST_POINTS or sum(each.size for each in self._points) > MOST_BYTES:
            self._points.popleft().path.unlink()

    def forget_last(self) -> None:
        """Forget the last moment, after which nothing has been changed."""
        if self._points:
            self._points.pop().path.unlink()

    def back(self, sim: Simulation) -> Simulation:
        """The simulation as it was at the last moment, which is then forgotten; the given one is closed.

        Raises:
            InputError: if there is none.
        """
        if not self._points:
            raise InputError("undo needs a change before; got none that is remembered. Reset goes back to the start.")
        settings = sim.settings
        again = Simulation.resume(self._points[-1].path, workers=settings.workers, start_method=settings.start_method)
        self.forget_last()
        sim.close()
        return again

    def clear(self) -> None:
        """Forget all."""
        while self._points:
            self.forget_last()

    def close(self) -> None:
        """Forget all, and remove the folder."""
        self._points.clear()
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None
