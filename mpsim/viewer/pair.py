"""A second stage: it starts from the same scene with other settings, and is kept at the same time as the first."""

import contextlib
import copy
import dataclasses
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from mpsim.engine.changes import ADD, PARAMETERS, WALL, Change
from mpsim.engine.parameters import OF_SETTINGS
from mpsim.engine.report import Report
from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.errors import ClosedError, InputError, MpsimError
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings
from mpsim.viewer.comparison import Comparison, measures_of
from mpsim.viewer.undo import Moments

SNAPSHOT = 0
"""Number of the moment that a user has marked. The moments before changes have numbers from 1."""

WHOLE = 1e-9
"""Relative deviation from a whole number that counts as rounding."""


class Steps(NamedTuple):
    """How the frames of the second stage correspond to those of the first.

    Attributes:
        first, second: frames of both stages at one moment, from which later frames are counted.
        each: frames of the second stage in one frame of the first, >= 1.
    """

    first: int
    second: int
    each: int


class _Mark(NamedTuple):
    steps: Steps
    taken: int
    comparison: Comparison


class Pair:
    """The second of two stages. Both start from the scene. The first one runs, and this one follows it.

    Args:
        scene: scene of both stages.
        settings: settings of the second stage. Its dt must be that of the first stage divided by a whole number. The
            exact solver has no steps, so it gets the dt of the first stage.
        dt: dt of the first stage [time], > 0.

    Attributes:
        sim: the simulation of the second stage.
        comparison: compares both stages.
        skipped: number of changes by hand that the second stage refused, because a disc was in the way there.

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
        """Run until the frame of the first stage; returns the computing time [s].

        report: report of the first stage since both were last at the same time.
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
        """Apply the new changes of the first stage to this one. Both must be at the same simulated time.

        Changed settings apply only to the first stage, except dt, so that both stay in step. A change that the second
        stage refuses, for example because a disc is in the way, is skipped and counted.

        Args:
            first: the first stage.
            changes: its complete journal.

        Raises:
            InputError: if an added disc or wall finds no free place here, so that the two scenes would differ.
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
        """Fit the frames of this stage to a new dt of the first stage, and change its own dt as little as possible."""
        exact = not capabilities_of(self._settings).has_steps
        own = dt if exact else fitting(self._settings.dt, dt)
        each = round(dt / own)
        if self.sim.settings.dt != own:
            self.sim.change(dt=own)
        self._steps = Steps(first.frame, self.sim.frame, each)

    # --- earlier moments

    def mark(self, number: int) -> None:
        """Remember this moment under the number that it has in the first stage, which can go back to it."""
        self._moments.keep(number, self.sim)
        self._marks[number] = _Mark(self._steps, self._taken, copy.deepcopy(self.comparison))

    @property
    def bytes_of_moments(self) -> Mapping[int, int]:
        """Bytes of the checkpoint of each moment, by number."""
        return self._moments.sizes

    def forget_all_but(self, numbers: Iterable[int]) -> None:
        """Forget all moments except SNAPSHOT and these: the first stage can go back to no others."""
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
    """The dt of a second stage, rounded so that a whole number of its steps is one step of the first stage [time].

    >>> fitting(0.003, dt=0.01), fitting(0.02, dt=0.01)
    (0.0033333333333333335, 0.01)
    """
    return dt / max(round(dt / own), 1)


def in_step(settings: Settings, dt: float) -> tuple[Settings, int]:
    """Settings of a second stage that fit the first one, and the number of its frames in one frame of the first.

    Args:
        settings: requested settings of the second stage.
        dt: dt of the first stage [time].

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
