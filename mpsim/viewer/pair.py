"""A second stage: the same start with other settings, kept at the same time as the first."""

import contextlib
import copy
import dataclasses
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from mpsim.core.errors import ClosedError, InputError, MpsimError
from mpsim.engine.changes import ADD, PARAMETERS, WALL, Change
from mpsim.engine.parameters import OF_SETTINGS
from mpsim.engine.report import Report
from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings
from mpsim.viewer.comparison import Comparison, measures_of
from mpsim.viewer.undo import Moments

SNAPSHOT = 0
"""Number of the moment that a page has asked to remember; those before changes have numbers from 1."""

WHOLE = 1e-9
"""Deviation from a whole number, relative, that is rounding."""


class Steps(NamedTuple):
    """How frames of the second stage fit those of the first.

    Attributes:
        first, second: frames of both at one moment; later ones are counted from there.
        each: frames of the second stage in one of the first, >= 1.
    """

    first: int
    second: int
    each: int


class _Mark(NamedTuple):
    steps: Steps
    taken: int
    comparison: Comparison


class Pair:
    """The second of two stages. Both begin with the scene; the first one runs, this one follows.

    Args:
        scene: of both.
        settings: of the second stage. Its dt is that of the first one divided by a whole number; of the exact solver,
            whose frames mean nothing else, it becomes that of the first one.
        dt: of the first stage [time], > 0.

    Attributes:
        sim: the second stage.
        comparison: of both.
        skipped: changes by hand that the second stage refused, as a disc was in the way there.

    Raises:
        InputError: if dt does not fit, or the settings cannot run the scene.

    >>> from mpsim import Scene
    >>> scene = Scene.random(count=20, packing=0.2, radius=0.5, seed=1)
    >>> with Simulation(scene, Settings(dt=0.02, method="grid")) as first:
    ...     pair = Pair(scene, Settings(method="event"), dt=0.02)
    ...     seconds = pair.follow(first, first.run(frames=10))
    ...     pair.sim.frame, pair.sim.time == first.time
    (10, True)
    >>> pair.close()
    """

    def __init__(self, scene: Scene, settings: Settings, dt: float):
        self._settings, each = in_step(settings, dt)
        self.sim: Simulation = Simulation(scene, self._settings)
        self.comparison: Comparison = Comparison(scene)
        self.skipped: int = 0
        self._steps = Steps(0, 0, each)
        self._taken = 0  # entries of the first one's journal
        self._moments = Moments()
        self._marks: dict[int, _Mark] = {}  # by the numbers of the moments

    def close(self) -> None:
        """End the second stage. May be called again."""
        self.sim.close()
        with contextlib.suppress(OSError):
            self._moments.close()

    def follow(self, first: Simulation, report: Report) -> float:
        """Run to where the first stage is; returns the time of computing that it took [s].

        report: of the first stage, of its frames since both were at the same time.
        """
        steps, sim = self._steps, self.sim
        frames = steps.second + (first.frame - steps.first) * steps.each - sim.frame
        if frames <= 0:
            return 0.0
        own, duration = sim.run(frames=frames, measures=measures_of(sim.scene, sim.count)), frames * sim.settings.dt
        self.comparison.first.note(report, duration)
        self.comparison.second.note(own, duration)
        return float(own.frame_seconds.sum())

    # --- changes by hand

    def take(self, first: Simulation, changes: Iterable[Change]) -> None:
        """Make the changes of the first stage that are new, at the same simulated time; both stand at it.

        Settings that are changed stay with the first stage, but for dt, so that both stay in step. A change that the
        second stage refuses, as where a disc is in the way, is skipped and counted.

        Args:
            first: the first stage.
            changes: all of its journal.

        Raises:
            InputError: if a disc that was added, or a wall, finds no room here: both would be of different scenes.
        """
        for change in list(changes)[self._taken :]:
            self._taken += 1
            self._take(first, change)

    def _take(self, first: Simulation, change: Change) -> None:
        values = dict(change.values)
        if change.what == PARAMETERS:
            if "dt" in values:
                self._renew_steps(first, values["dt"])
            values = {name: value for name, value in values.items() if name not in OF_SETTINGS}
            if not values:
                return
        try:
            getattr(self.sim, change.what)(**values)
        except ClosedError:
            raise
        except MpsimError as error:
            if change.what in (ADD, WALL):
                raise InputError(
                    "a second stage must have the discs and walls of the first one; there was no room for one that was "
                    f"added: {error} Reset restarts both."
                ) from error
            self.skipped += 1

    def _renew_steps(self, first: Simulation, dt: float) -> None:
        """Fit frames to another dt of the first stage: as long as they were, nearly."""
        exact = not capabilities_of(self._settings).has_steps
        own = dt if exact else fitting(self._settings.dt, dt)
        each = round(dt / own)
        if self.sim.settings.dt != own:
            self.sim.change(dt=own)
        self._steps = Steps(first.frame, self.sim.frame, each)

    # --- back

    def mark(self, number: int) -> None:
        """Remember this moment, as one that the first stage can go back to; number: what that calls it."""
        self._moments.keep(number, self.sim)
        self._marks[number] = _Mark(self._steps, self._taken, copy.deepcopy(self.comparison))

    @property
    def bytes_of_moments(self) -> Mapping[int, int]:
        """Bytes of the checkpoint of each moment, by number."""
        return self._moments.sizes

    def forget_all_but(self, numbers: Iterable[int]) -> None:
        """Forget the moments but for these and SNAPSHOT: the first stage can go back to no others."""
        for number in self._marks.keys() - {SNAPSHOT, *numbers}:
            self._moments.forget(number)
            del self._marks[number]

    def back(self, number: int) -> None:
        """Go back to a moment.

        Raises:
            InputError: if it is not remembered.
        """
        self.sim = self._moments.back(number, self.sim)
        mark = self._marks[number]
        self._steps, self._taken, self.comparison = mark.steps, mark.taken, copy.deepcopy(mark.comparison)


def fitting(own: float, dt: float) -> float:
    """The whole fraction of a first stage's dt that is nearest to that of a second one [time].

    >>> fitting(0.003, dt=0.01), fitting(0.02, dt=0.01)
    (0.0033333333333333335, 0.01)
    """
    return dt / max(round(dt / own), 1)


def in_step(settings: Settings, dt: float) -> tuple[Settings, int]:
    """Settings of a second stage whose frames fit those of a first one, and how many of them are one of its frames.

    Args:
        settings: as they are asked for.
        dt: of the first stage [time].

    Raises:
        InputError: if they do not fit.

    >>> in_step(Settings(method="grid", dt=0.005), dt=0.02)[1], in_step(Settings(method="event"), dt=0.02)[1]
    (4, 1)
    """
    if not capabilities_of(settings).has_steps:
        return dataclasses.replace(settings, dt=dt), 1
    each = round(dt / settings.dt)
    if each < 1 or abs(dt / settings.dt - each) > WHOLE * each:
        raise InputError(
            f"dt of a second stage must be that of the first one, {dt:g}, or a whole fraction of it; got "
            f"{settings.dt:g}. Use Settings(dt={dt / max(each, 1):g})."
        )
    return dataclasses.replace(settings, dt=dt / each), each
