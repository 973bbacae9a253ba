"""Undo: goes back to an earlier moment, by checkpoints."""

import contextlib
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path

from mpsim.engine.simulation import Simulation
from mpsim.errors import InputError, OutputError

MOST_POINTS = 16
"""Largest number of remembered moments before changes; the oldest ones are forgotten."""

MOST_BYTES = 2**28
"""Largest size of all their checkpoints, including those of a second stage, in bytes. With very many discs, fewer
moments are remembered."""


class Moments:
    """Checkpoints of moments of one simulation, by number, in a temporary folder that `close` removes.

    Something else may remove them before, such as a cleaner of temporary files: these moments are then forgotten.

    Attributes:
        sizes: size of each checkpoint in bytes, by number, the oldest first.

    >>> from mpsim import Scene
    >>> sim, moments = Simulation(Scene.random(count=5, packing=0.2, radius=0.5, seed=1)), Moments()
    >>> moments.keep(7, sim)
    >>> for _ in range(2):  # as often as needed
    ...     report = sim.run(frames=3)
    ...     sim = moments.back(7, sim)
    >>> sim.frame, list(moments.sizes)
    (0, [7])
    >>> sim.close(); moments.close()
    """

    def __init__(self) -> None:
        self.sizes: dict[int, int] = {}
        self._folder: tempfile.TemporaryDirectory[str] | None = None  # made for the first moment

    def keep(self, number: int, sim: Simulation) -> None:
        """Remember this moment under a number, which may replace an earlier moment.

        Raises:
            OutputError: if the checkpoint cannot be written. An earlier moment of this number is then kept.
        """
        if self._folder is not None and not os.path.isdir(self._folder.name):
            self.close()
        if self._folder is None:
            try:
                self._folder = tempfile.TemporaryDirectory(prefix="mpsim-view-", ignore_cleanup_errors=True)
            except OSError as error:
                raise OutputError(
                    f"undo needs a folder for temporary files; got {error.strerror or error}. Make the folder that "
                    "TMPDIR names, or make room in it."
                ) from None
        new = sim.save(self._path(number).with_suffix(".new"))
        self.forget(number)
        self.sizes[number] = new.stat().st_size
        os.replace(new, self._path(number))

    def back(self, number: int, sim: Simulation) -> Simulation:
        """The simulation as it was at a moment; the given one is closed.

        Raises:
            InputError: if that moment is not remembered.
        """
        if number not in self.sizes:
            raise InputError("going back needs a remembered moment; got none. Reset starts again.")
        if not self._path(number).exists():
            raise InputError(
                "going back needs the file of that moment; something has removed it from the folder for temporary "
                "files. Reset starts again."
            )
        again = Simulation.resume(self._path(number), workers=sim.settings.workers)
        sim.close()
        return again

    def forget(self, number: int) -> None:
        """Forget a moment, if it is remembered."""
        if self.sizes.pop(number, None) is not None:
            with contextlib.suppress(OSError):  # it was removed, or its folder was
                self._path(number).unlink()

    def close(self) -> None:
        """Forget all moments and remove the folder."""
        self.sizes.clear()
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None

    def _path(self, number: int) -> Path:
        assert self._folder is not None  # made by `keep`
        return Path(self._folder.name) / f"{number}.mpsim"


class Undo:
    """Remembers the moments before the last changes of one simulation.

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
        return len(self._moments.sizes)

    @property
    def numbers(self) -> tuple[int, ...]:
        """Numbers of the moments, the oldest first. A number is never used twice."""
        return tuple(self._moments.sizes)

    @property
    def last(self) -> int:
        """Number of the last moment; 0 if there is none."""
        return max(self.numbers, default=0)

    def mark(self, sim: Simulation) -> None:
        """Remember this moment.

        Raises:
            OutputError: if the checkpoint cannot be written.
        """
        self._made += 1
        self._moments.keep(self._made, sim)

    def trim(self, beside: Mapping[int, int]) -> None:
        """Forget the oldest moments until there are at most MOST_POINTS with at most MOST_BYTES.

        beside: sizes of further checkpoints of the same moments, by number, which count too.
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

    def back(self, sim: Simulation) -> Simulation:
        """The simulation as it was at the last moment, which is then forgotten. The given simulation is closed.

        Raises:
            InputError: if there is no moment.
        """
        if not self.numbers:
            raise InputError("undo needs a remembered change; got none. Reset goes back to the start.")
        again = self._moments.back(self.last, sim)
        self.forget_last()
        return again

    def clear(self) -> None:
        """Forget all moments."""
        while self.numbers:
            self.forget_last()

    def close(self) -> None:
        """Forget all moments and remove the folder."""
        self._moments.close()
