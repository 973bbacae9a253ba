"""Observers: objects that are called during a run; those of collisions count them or keep all of them."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mpsim.core import checks
from mpsim.core.checks import Binding
from mpsim.engine.solvers.base import joined
from mpsim.errors import InputError
from mpsim.features.edges import EDGES
from mpsim.kernels.compiling import compile_seconds

if TYPE_CHECKING:
    from mpsim.engine.simulation import Simulation


# --- Observers of collisions: a table of all of them, and counters for an obstacle, a wall or a region

KINDS = ("discs", "walls", "obstacles")  # what a disc can collide with; `kind` of a table is an index of these


class Collisions:
    """Every collision of a run, for `Simulation.run(observe=...)`; the run stays the same to the bit.

    The table is a structured array with one row for each collision, in the order of `frame`, `time`, `i`, `j`, on any
    number of workers:

    - `frame`: the number that `sim.frame` has at the end of the frame in which it happens, from 1;
    - `time` [time]: exact with `event`. With the other methods and contact `impact`, the time at which the discs
      touched, if it was computed; otherwise the end of the step;
    - `kind`: 0, two discs; 1, a disc and a wall; 2, a disc and an obstacle;
    - `i`, `j`: numbers of the discs, i < j. With a wall j is 0 left, 1 right, 2 bottom, 3 top; with an obstacle its
      index in `Scene.obstacles`;
    - `impulse`, shape (2,) [mass length/time]: on disc i, along the normal; that on j is the opposite. With law
      `reflect`, the mean of both discs';
    - `tangential_impulse`, shape (2,) [mass length/time]: on disc i, across the normal, by friction or a thermal wall;
      that on j is the opposite. Both together are the change of the momentum of disc i;
    - `place`, shape (2,) [length]: the point at which the surfaces touch.

    A contact that changes no velocity does not count as a collision, nor does leaving through an absorbing edge. The
    observer belongs to the first simulation that it observes. All methods except `mpi` support it.

    Args:
        callback: a function, called as callback(sim, table) every `every` frames with the collisions since the last
            call, which are then not stored. None: they are stored, with about 90 bytes each.
        every: frames between two calls, >= 1, counted from frame 0. Runs are faster if this is larger.
        between: "discs", "walls" or "obstacles", or several of these: the collisions to record, by what discs collide
            with; None: all three.
        ids: numbers of discs: record collisions that involve one of them; None: all.

    Raises:
        InputError: for an argument out of range; by `run` for another simulation, or with `mpi`.

    Source: the order of events in event-driven molecular dynamics (`docs/exact.md`).

    >>> import mpsim
    >>> bounces = mpsim.Collisions()
    >>> with mpsim.Simulation(mpsim.Scene.load("pi"), mpsim.Settings(method="event", dt=1.0)) as sim:
    ...     report = sim.run(until=42, observe=bounces)
    >>> len(bounces.table), int((bounces.table["kind"] == 1).sum())
    (314, 157)
    >>> first = bounces.table[0]
    >>> float(first["time"]), first["place"].tolist(), round(float(first["impulse"][0]), 4)
    (5.0, [6.0, 0.5], -1.9998)
    """

    def __init__(
        self,
        *,
        callback: Callable[[Simulation, NDArray[Any]], None] | None = None,
        every: int = 1,
        between: str | Iterable[str] | None = None,
        ids: ArrayLike | None = None,
    ):
        if callback is not None and not callable(callback):
            raise InputError(f"callback must be a function of a simulation and a table; got {checks.brief(callback)}.")
        self.every: int = checks.whole("every", every, 1, 10**12, "1 hands over the collisions of every frame.")
        self._callback = callback
        self._kinds = _kinds_of(between)
        self._ids = None if ids is None else _ids_of(ids)
        self._owner = Binding(type(self).__name__, "Make one for each.")
        self._seen = self._handed = -1
        self._kept: list[NDArray[Any]] = []
        self._waiting: list[NDArray[Any]] = []

    @property
    def table(self) -> NDArray[Any]:
        """The collisions so far, without those passed to `callback`: a structured array, shape (n,)."""
        self._kept, self._waiting = [joined([*self._kept, *self._waiting])], []
        return self._kept[0]

    def begin(self, sim: Simulation) -> None:
        """A run of the simulation `sim` begins.

        Raises:
            InputError: if this belongs to another one.
        """
        if self._handed < 0:
            self._handed = sim.frame
        self._owner.bind_or_check(sim)

    def take_collisions(self, table: NDArray[Any], frame: int) -> None:
        """Take a table: the collisions up to the end of a frame, those of frames that have been taken left out."""
        chosen = (table["frame"] > self._seen) & np.isin(table["kind"], self._kinds)
        if self._ids is not None:
            other = (table["kind"] == 0) & np.isin(table["j"], self._ids)
            chosen &= np.isin(table["i"], self._ids) | other
        self._waiting.append(table[chosen])
        self._seen = max(self._seen, frame)

    def observe(self, sim: Simulation, collisions: int) -> None:
        """Hand over what has been taken, once a frame of `sim`; collisions: not used, as a report counts others too."""
        if sim.frame > self._handed:
            self._handed = sim.frame
            self._hand_over(sim)

    def _hand_over(self, sim: Simulation) -> None:
        if self._callback is not None:
            table, self._waiting = joined(self._waiting), []
            self._callback(sim, table)


class Sensor(Collisions):
    """A counter of the collisions on an obstacle, on a wall or in a region, for `Simulation.run(observe=...)`.

    Give one of obstacle, wall and region. `frames`, `counts`, `impulse` and `tangential_impulse` have an entry for each
    look.

    Args:
        obstacle: index in `Scene.obstacles`.
        wall: "left", "right", "bottom" or "top".
        region: (x_low, x_high, y_low, y_high): collisions at a place in it, low edges included, high ones not [length].
        every: frames that are counted together, >= 1.
        between: as of `Collisions`; of use with a region.

    Raises:
        InputError: for none or several of the three, or one out of range; by `run` as for `Collisions`.

    Source: as `Collisions`; the sum of impulses on a wall over length and time is the pressure (`mpsim.measure`).

    >>> import mpsim
    >>> sensor = mpsim.Sensor(wall="left", every=21)
    >>> with mpsim.Simulation(mpsim.Scene.load("pi"), mpsim.Settings(method="event", dt=1.0)) as sim:
    ...     report = sim.run(until=42, observe=sensor)
    >>> sensor.frames.tolist(), sensor.counts.tolist()
    ([21, 42], [156, 1])
    """

    def __init__(
        self,
        *,
        obstacle: int | None = None,
        wall: str | None = None,
        region: tuple[float, float, float, float] | None = None,
        every: int = 1,
        between: str | Iterable[str] | None = None,
    ):
        super().__init__(every=every, between=between)
        if (obstacle is not None) + (wall is not None) + (region is not None) != 1:
            raise InputError(
                f"a Sensor must be given one of obstacle, wall and region; got obstacle={obstacle!r}, wall={wall!r}, "
                f"region={checks.brief(region)}. Make one for each."
            )
        self._obstacle = None if obstacle is None else checks.whole(
            "obstacle", obstacle, 0, 2**31, "It is an index in Scene.obstacles."
        )  # fmt: skip
        self._edge = None if wall is None else EDGES.index(checks.choice("wall", wall, EDGES))
        self._region = None if region is None else _region_of(region)
        self._found: list[tuple[int, int, float, float]] = []

    @property
    def frames(self) -> NDArray[np.int64]:
        """Frames done at each look, shape (n,)."""
        return np.array([each[0] for each in self._found], np.int64)

    @property
    def counts(self) -> NDArray[np.int64]:
        """Collisions since the look before, shape (n,)."""
        return np.array([each[1] for each in self._found], np.int64)

    @property
    def impulse(self) -> NDArray[np.float64]:
        """Sum of the sizes of their impulses along the normal, without those of friction, (n,) [mass length/time]."""
        return np.array([each[2] for each in self._found], np.float64)

    @property
    def tangential_impulse(self) -> NDArray[np.float64]:
        """Sum of the sizes of their impulses across the normal, shape (n,) [mass length/time]."""
        return np.array([each[3] for each in self._found], np.float64)

    def begin(self, sim: Simulation) -> None:
        """As that of `Collisions`; the scene of `sim` must have the obstacle too."""
        number = len(sim.scene.obstacles)
        if self._obstacle is not None and self._obstacle >= number:
            raise InputError(
                f"obstacle of a Sensor must be an index in Scene.obstacles, which has {number}; got {self._obstacle}."
            )
        super().begin(sim)

    def _hand_over(self, sim: Simulation) -> None:
        table, self._waiting = joined(self._waiting), []
        met = table[self._meets(table)]
        along, across = (math.fsum(np.hypot(*met[name].T).tolist()) for name in ("impulse", "tangential_impulse"))
        self._found.append((sim.frame, len(met), along, across))

    def _meets(self, table: NDArray[Any]) -> NDArray[np.bool_]:
        if self._obstacle is not None:
            return (table["kind"] == 2) & (table["j"] == self._obstacle)
        if self._region is None:
            return (table["kind"] == 1) & (table["j"] == self._edge)
        (x_low, x_high, y_low, y_high), (x, y) = self._region, table["place"].T
        return (x >= x_low) & (x < x_high) & (y >= y_low) & (y < y_high)


def _kinds_of(between: str | Iterable[str] | None) -> list[int]:
    words = KINDS if between is None else [between] if isinstance(between, str) else between
    if not isinstance(words, Iterable):
        raise InputError(f"between must be one or several of {', '.join(KINDS)}; got {checks.brief(between)}.")
    return [KINDS.index(checks.choice("between", word, KINDS)) for word in words]


def _ids_of(ids: ArrayLike) -> NDArray[np.int64]:
    found = np.atleast_1d(np.asarray(ids))
    if found.ndim != 1 or found.dtype.kind not in "iu" or (found < 0).any():
        raise InputError(f"ids must be numbers of discs, whole and >= 0; got {checks.brief(ids)}. None is all.")
    return found.astype(np.int64)


def _region_of(region: Any) -> tuple[float, float, float, float]:
    x_low, x_high, y_low, y_high = checks.finite_array("region", region, (4,), "(4,)").tolist()
    if not (x_low < x_high and y_low < y_high):
        raise InputError(f"region must be (x_low, x_high, y_low, y_high) with low < high; got {checks.brief(region)}.")
    return x_low, x_high, y_low, y_high


# --- Observers: objects that are called during a run, for example to write a trajectory


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


def _every_of(observer: Any) -> int:
    """Frames between two calls of an observer, which may change them during a run."""
    every = getattr(observer, "every", None)
    return checks.whole("every of an observer", every, 1, 10**12, "1 samples every frame.")


class Observers:
    """The observers of one run.

    Attributes:
        seconds: the time they have taken, without that of compiling [s].
        want_collisions: whether any of them asks for collisions.

    Raises:
        InputError: if one of them is no observer.
    """

    def __init__(self, observers: Observer | Iterable[Observer]):
        self.seconds: float = 0.0
        given: Any = [observers] if hasattr(observers, "observe") else observers
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
            _every_of(each)
        self.want_collisions: bool = bool(self._of_collisions)

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
        return min(((every := _every_of(each)) - frame % every for each in self._observers), default=2**62)

    def keep(self) -> None:
        """Let those observers that can write what they have gathered."""
        for each in self._observers:
            if callable(keep := getattr(each, "keep", None)):
                keep()

    def observe(self, sim: Simulation, collisions: int) -> None:
        """Call the observers whose frame this is."""
        with self._timed():
            for each in self._observers:
                if sim.frame % _every_of(each) == 0:
                    each.observe(sim, collisions)

    @contextmanager
    def _timed(self) -> Iterator[None]:
        started = time.perf_counter() - compile_seconds()
        yield
        self.seconds += time.perf_counter() - compile_seconds() - started
