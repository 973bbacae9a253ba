"""Observers: objects that are called during a run, for example to write a trajectory."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Protocol

from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.errors import InputError
from mpsim.kernels.compiling import compile_seconds

if TYPE_CHECKING:
    from mpsim.engine.simulation import Simulation


class Observer(Protocol):
    """What looks at a simulation along a run; what it is to change it changes by set, kick, remove, add and change.

    One that has a method `keep()` is asked by it to write what it has gathered, before each checkpoint of the run: what
    it has in its file then is never behind the checkpoint. Of several ranks the first one is asked.

    Attributes:
        every: frames between two calls, >= 1, counted from frame 0, so that a run in parts shows the same frames.
    """

    every: int

    def observe(self, sim: Simulation, collisions: int) -> None:
        """Look at the simulation between two frames.

        A frame may be shown twice: at the end of one run and the start of the next, or when a run has healed.

        Args:
            sim: as it then stands.
            collisions: contacts resolved since this run began.
        """
        ...


class Observers:
    """The observers of one run. Attribute seconds: the time they have taken, without that of compiling [s].

    Raises:
        InputError: if one of them is no observer.
    """

    def __init__(self, observers: Observer | Iterable[Observer] | None):
        self.seconds: float = 0.0
        given: Any = [] if observers is None else [observers] if hasattr(observers, "observe") else observers
        self._observers: list[Observer] = list(given) if isinstance(given, Iterable) else [given]
        self._of_collisions: list[Any] = []
        for each in self._observers:
            if not callable(getattr(each, "observe", None)):
                raise InputError(
                    "observe must be one observer or several: objects with a number `every`, the frames between two "
                    "calls, and a method observe(sim, collisions), such as mpsim.Trajectory.write(...); "
                    f"got {checks.brief(each)}."
                )
            if hasattr(each, "take_collisions"):
                self._of_collisions.append(each)
            checks.whole("every of an observer", getattr(each, "every", None), 1, 10**12, "1 samples every frame.")

    @property
    def want_collisions(self) -> bool:
        """Whether any of them asks for collisions."""
        return bool(self._of_collisions)

    def begin(self, sim: Simulation) -> None:
        """A run of a simulation begins."""
        for each in self._of_collisions:
            each.begin(sim)

    def take_collisions(self, table: NDArray[Any], frame: int) -> None:
        """Hand over the collisions up to the end of a frame since the last call: TABLE, in order."""
        with self._timed():
            for each in self._of_collisions:
                each.take_collisions(table, frame)

    def frames_ahead(self, frame: int) -> int:
        """Number of frames until the next call; very large without observers."""
        return min((each.every - frame % each.every for each in self._observers), default=2**62)

    def keep(self) -> None:
        """Let those observers that can write what they have gathered."""
        for each in self._observers:
            if callable(keep := getattr(each, "keep", None)):
                keep()

    def observe(self, sim: Simulation, collisions: int) -> None:
        """Call the observers whose frame this is."""
        if not self._observers:
            return
        with self._timed():
            for each in self._observers:
                if sim.frame % each.every == 0:
                    each.observe(sim, collisions)

    @contextmanager
    def _timed(self) -> Iterator[None]:
        started = time.perf_counter() - compile_seconds()
        yield
        self.seconds += time.perf_counter() - compile_seconds() - started
