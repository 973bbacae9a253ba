"""Speed against accuracy in a view: a second stage, and how far it and the first have come apart.

Hard discs are chaotic: any difference between two runs grows until the position of a disc in one run says nothing about
the same disc in the other. From then on their distance means nothing, and only averages can be compared.
"""

import contextlib
import copy
import dataclasses
import math
import threading
from collections.abc import Callable, Collection, Mapping, Sequence
from types import SimpleNamespace
from typing import Any, NamedTuple, TypeVar

import numpy as np

from mpsim.core.state import State
from mpsim.engine.changes import ADD, OF_SETTINGS, PARAMETERS, WALL, make_room
from mpsim.engine.checkpoint import Snapshot
from mpsim.engine.observers import Observer
from mpsim.engine.report import Report
from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers.base import InPlace, in_place
from mpsim.engine.solvers.methods import capabilities_of, in_one_process
from mpsim.errors import ClosedError, InputError, MpsimError
from mpsim.features.capsules import of_discs
from mpsim.features.obstacles import capsules_of
from mpsim.measure.observables import trajectory_error
from mpsim.measure.registry import refusal
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings
from mpsim.studies.preliminary import AGREEMENT, divergence
from mpsim.studies.tradeoff import label
from mpsim.viewer.gauges import MeanPressure

# --- How far two stages have come apart since their common start: distance of corresponding discs, counts, times

PARTED = 0.5
"""Distance at which two runs have parted, in diameters, root mean square over all discs. A disc that has missed a
collision is displaced by about as much. Later the distance grows to that of unrelated discs."""

SATURATED = 0.01
"""Distance above which the growth is no longer exponential, in diameters, root mean square over all discs."""


class Counts:
    """Contacts resolved, computing time [s] and mean pressure of one stage."""

    def __init__(self) -> None:
        self.collisions: int = 0
        self.seconds: float = 0.0
        self.pressure: MeanPressure = MeanPressure()

    def note(self, report: Report) -> None:
        """Add a run."""
        self.collisions += report.collisions
        self.seconds += float(report.frame_seconds.sum())
        self.pressure.note(report)


def measures_of(scene: Scene, count: int) -> tuple[str, ...]:
    """The measures that both stages take along their runs: the pressure, where it is defined."""
    return () if refusal("pressure", scene, count) else ("pressure",)


class Difference:
    """Compares two stages of a scene since their common start."""

    def __init__(self, scene: Scene):
        self.first: Counts = Counts()
        self.second: Counts = Counts()
        self._parted: float | None = None  # time at which they were seen, or predicted, to part
        self._saturated: float | None = None  # time at which the distance was first seen to reach SATURATED
        self._scene = scene

    def _distance(self, one: State, other: State, time: float, agree_until: float | None) -> float | None:
        """Root mean square distance of corresponding discs, in diameters of the smallest; None where it means nothing.

        The states have parted for good once they are PARTED diameters apart: from then on their distance is chance.
        Discs in a dense packing rarely leave the cages of their neighbours, so their distance may stay below PARTED.
        Therefore states that are at least SATURATED diameters apart also count as parted after `agree_until`.
        """
        try:
            distance = trajectory_error(one, other, self._scene).rms / (2 * self._scene.smallest_radius)
        except InputError:  # there are no discs, or a disc was added to only one of them
            return None
        if self._parted is None and distance >= PARTED:
            self._parted = time
        if self._saturated is None and distance >= SATURATED:
            self._saturated = time
        if agree_until is not None and agree_until <= time and self._saturated is not None:
            self._parted = min(max(agree_until, self._saturated), math.inf if self._parted is None else self._parted)
        return distance if self._parted is None else None

    def read(self, one: State, other: State, time: float, agree_until: float | None) -> dict[str, Any]:
        """The numbers that a page shows, of the states of both stages at a time; NaN and None are shown as dashes.

        `missed` is the number of collisions that the second stage has counted and the first one has not. Once the
        stages have parted, these are different collisions, and only the fraction is meaningful.

        agree_until: time until which two correct solvers agree, from the Lyapunov time; None: not known.
        """
        first, second = self.first, self.second
        distance = self._distance(one, other, time, agree_until)
        pressures = first.pressure.read(), second.pressure.read()
        missed = second.collisions - first.collisions
        return {
            "time": time,
            "distance": distance,
            "parted": self._parted,
            "collisions": [first.collisions, second.collisions],
            "missed": missed if self._parted is None else None,
            "missed_fraction": missed / second.collisions if second.collisions else math.nan,
            "pressure": [each.value for each in pressures],
            "pressure_difference": pressures[0].value - pressures[1].value,
            "difference_error": math.hypot(*(each.error for each in pressures)),
            "cost_ratio": second.seconds / first.seconds if first.seconds else math.nan,
        }


# --- A second stage: it starts from the same scene with other settings, and is kept at the same time as the first

WHOLE = 1e-9  # relative deviation from a whole number that counts as rounding


class Mark(NamedTuple):
    """A moment of the second stage, to which it can go back."""

    snapshot: Snapshot
    taken: int
    difference: Difference


class SecondStage:
    """The second of two stages. Both start from the scene. The first one, whose dt is given, runs; this one follows it.

    Raises:
        InputError: if the settings do not fit that dt, as `in_step` says, or cannot run the scene.
    """

    def __init__(self, scene: Scene, settings: Settings, dt: float):
        self._settings = in_step(settings, dt)
        self.sim: Simulation = Simulation(scene, self._settings)
        self.difference: Difference = Difference(scene)
        self.skipped: int = 0  # changes by hand that were refused here, because a disc was in the way
        self._taken = 0  # entries of the first one's journal

    def close(self) -> None:
        """End the second stage. May be called again."""
        self.sim.close()

    def follow(self, first: Simulation, report: Report) -> float:
        """Run until the time of the first stage, which has made this report since; returns the computing time [s]."""
        sim = self.sim
        frames = round((first.time - sim.time) / sim.settings.dt)
        if frames <= 0:
            return 0.0
        own = sim.run(frames=frames, measures=measures_of(sim.scene, sim.count))
        self.difference.first.note(report)
        self.difference.second.note(own)
        return float(own.frame_seconds.sum())

    def take(self, first: Simulation) -> None:
        """Apply the new changes of the first stage to this one. Both must be at the same simulated time.

        Changed settings apply only to the first stage, except dt, so that both stay in step. A change that the second
        stage refuses, for example because a disc is in the way, is skipped and counted.

        Raises:
            InputError: if an added disc or wall finds no free place here, so that the two scenes would differ.
        """
        for change in list(first.journal)[self._taken :]:
            self._taken += 1
            values = dict(change.values)
            if change.what == PARAMETERS:
                if "dt" in values:
                    self._fit(values["dt"])
                values = {name: value for name, value in values.items() if name not in OF_SETTINGS}
            if values:
                self._change(change.what, values)

    def _change(self, what: str, values: Mapping[str, Any]) -> None:
        try:
            if what == WALL:
                make_room(self.sim, capsules_of((values["wall"],)))
            elif what == ADD:
                places = values["position"]
                radii = np.broadcast_to(values.get("radius", self.sim.scene.largest_radius), len(places))
                make_room(self.sim, of_discs(places, radii))
            getattr(self.sim, what)(**values)
        except ClosedError:
            raise
        except MpsimError as error:
            if what in (ADD, WALL):
                raise InputError(
                    "a second stage must have the discs and walls of the first one; there was no room for one that was "
                    f"added: {error} Reset restarts both."
                ) from error
            self.skipped += 1

    def _fit(self, dt: float) -> None:
        """Change dt as little as possible, so that a whole number of steps is one step `dt` of the first stage."""
        exact = not capabilities_of(self._settings).has_steps
        own = dt if exact else dt / max(round(dt / self._settings.dt), 1)
        if self.sim.settings.dt != own:
            self.sim.change(dt=own)

    def mark(self) -> Mark:
        return Mark(self.sim.snapshot(), self._taken, copy.deepcopy(self.difference))

    def back(self, mark: Mark) -> None:
        self.sim.restore(mark.snapshot)
        self._taken, self.difference = mark.taken, copy.deepcopy(mark.difference)


def in_step(settings: Settings, dt: float) -> Settings:
    """Settings of a second stage that fit the dt of the first: a whole number of its steps is one step of the first.

    Raises:
        InputError: if they do not fit.

    >>> in_step(Settings(method="grid", dt=0.005), dt=0.02).dt, in_step(Settings(method="event"), dt=0.02).dt
    (0.005, 0.02)
    """
    if not capabilities_of(settings).has_steps:
        return dataclasses.replace(settings, dt=dt)
    each = round(dt / settings.dt)
    if each < 1 or abs(dt / settings.dt - each) > WHOLE * each:
        raise InputError(
            f"dt of a second stage must be that of the first one, {dt:g}, or a whole fraction of it; got "
            f"{settings.dt:g}. Use Settings(dt={dt / max(each, 1):g})."
        )
    return dataclasses.replace(settings, dt=dt / each)


# --- The comparison on a page: runs a second stage, if there is one

MOST_DIVERGING = 5000  # largest number of discs for which the Lyapunov time is computed, by two short exact runs

CLOSING_SECONDS = 5.0  # longest time that `close` waits for these runs to end [s]

Result = TypeVar("Result")
Beside = Settings | Callable[[Settings], Settings] | None
"""A requested second stage: its settings, or what makes them from those of the first stage."""


class _StoppedError(Exception):
    """The Lyapunov time is no longer wanted."""


class Comparison:
    """The second stage of a view, if there is one; beside: its settings."""

    def __init__(self, beside: Settings | None):
        self.second: SecondStage | None = None
        self._wanted: Beside = beside
        self._settings: Settings | None = None
        self._note: str | None = None
        self._rate: float | None = None  # at which runs diverge [1/time]
        self._diverging: Scene | None = None  # whose Lyapunov time is known, or being found
        self._stopped = threading.Event()
        self._work: threading.Thread | None = None  # that finds the Lyapunov time

    def choose(self, beside: Beside) -> None:
        """Choose the second stage; it applies from the next restart on."""
        self._wanted = beside

    @property
    def settings(self) -> Settings | None:
        """Settings of the second stage, or of the one that was refused; None: none was requested."""
        return self._settings if self.second is None else self.second.sim.settings

    def begin(self, scene: Scene, settings: Settings) -> None:
        """Start the second stage with a scene; settings: those of the first stage."""
        self._end(None)
        self._settings = None
        if self._wanted is None:
            return
        try:
            wanted = self._wanted if isinstance(self._wanted, Settings) else self._wanted(settings)
            self._settings = in_one_process(wanted, "a view")
            self.second = SecondStage(scene, wanted, settings.dt)
        except MpsimError as error:
            self._note = str(error)
            return
        if self._diverging is not scene and scene.count <= MOST_DIVERGING:
            self._diverging, self._rate = scene, None
            self._stop_work()
            self._work = threading.Thread(target=self._find_divergence, args=(scene, self._stopped), daemon=True)
            self._work.start()

    def close(self) -> None:
        """End the second stage."""
        self._stop_work()
        self._end(None)

    def _stop_work(self) -> None:
        self._stopped.set()
        if self._work is not None:
            self._work.join(CLOSING_SECONDS)
        self._stopped = threading.Event()

    def run(
        self,
        sim: Simulation,
        frames: int,
        every: int,
        look: Callable[[], None],
        measures: Collection[str],
        observers: Sequence[Observer],
    ) -> tuple[list[Report], float]:
        """Run frames of the first stage, `sim`, and the second stage up to the same time; `look` every so many frames.

        If there is a second stage, the run is divided: both stages are at the same time whenever `look` is called, so
        that they can be compared. Returns the reports of the first stage, and the computing time of both stages [s].
        """
        if self.second is None:
            watched: Any = SimpleNamespace(every=every, observe=lambda sim, collisions: look())
            report = sim.run(frames=frames, measures=measures, observe=[*observers, watched])
            return [report], float(report.frame_seconds.sum())
        reports, seconds, end = list[Report](), 0.0, sim.frame + frames
        wanted = dict.fromkeys([*measures, *measures_of(sim.scene, sim.count)])
        while sim.frame < end:
            ahead = min(end - sim.frame, every - sim.frame % every)
            reports.append(sim.run(frames=ahead, measures=wanted, observe=observers))
            seconds += float(reports[-1].frame_seconds.sum())
            seconds += self.on_second(lambda second: second.follow(sim, reports[-1])) or 0.0
            look()
        return reports, seconds

    def on_second(self, act: Callable[[SecondStage], Result]) -> Result | None:
        """Call a function with the second stage, if there is one. If it fails, the stage ends; the page shows why."""
        try:
            return None if self.second is None else act(self.second)
        except MpsimError as error:
            self._end(f"The second stage has ended: {error}")
            return None

    def _end(self, note: str | None) -> None:
        second, self.second, self._note = self.second, None, note
        if second is not None:
            with contextlib.suppress(MpsimError):
                second.close()

    def shown(self) -> InPlace | None:
        """The discs of the second stage, for its picture; None: there is no second stage."""
        if self.second is None:
            return None
        sim = self.second.sim
        return in_place(sim.state, sim.scene.box, sim.frame, sim.time, sim.radii)

    def told(self, sim: Simulation) -> dict[str, Any]:
        """The message for pages, for `protocol.text_of`; sim: the first stage."""
        second, rate = self.second, self._rate
        told: dict[str, Any] = {
            "first": label(sim.settings),
            "second": None if second is None else label(second.sim.settings),
            "exact": second is not None and capabilities_of(second.sim.settings).is_exact,
            "note": self._note,
            "skipped": 0 if second is None else second.skipped,
            "lyapunov_time": None if rate is None else 1 / rate,
            "agree_until": None if rate is None else AGREEMENT / rate,
        }
        if second is not None:
            told |= second.difference.read(sim.state, second.sim.state, sim.time, told["agree_until"])
        return told

    def _find_divergence(self, scene: Scene, stopped: threading.Event) -> None:
        def check(done: int, of: int) -> None:
            if stopped.is_set():
                raise _StoppedError

        with contextlib.suppress(MpsimError, _StoppedError):  # of a scene that has none, or that `event` cannot run
            rate = divergence(scene, progress=check)
            check(1, 1)
            self._rate = rate
