"""Speed against accuracy in a view: a second stage, and how far it and the first have come apart.

Hard discs are chaotic: any difference between two runs grows until the position of a disc in one run says nothing about
the same disc in the other. From then on their distance means nothing, and only averages can be compared.
"""

import contextlib
import copy
import dataclasses
import math
import threading
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np

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
from mpsim.studies.runner import Stopped
from mpsim.studies.tradeoff import label
from mpsim.viewer.gauges import MeanPressure

PARTED = 0.5
"""Distance at which two runs have parted, in diameters, root mean square over all discs. A disc that has missed a
collision is displaced by about as much. Later the distance grows to that of unrelated discs."""

SATURATED = 0.01
"""Distance above which the growth is no longer exponential, in diameters, root mean square over all discs."""

WHOLE = 1e-9  # relative deviation from a whole number that counts as rounding
MOST_DIVERGING = 5000  # largest number of discs for which the Lyapunov time is computed, by two short exact runs
CLOSING_SECONDS = 5.0  # longest time that `close` waits for these runs to end [s]


def in_step(settings: Settings, dt: float) -> Settings:
    """Settings of a second stage that fit the dt of the first: a whole number of its steps is one step of the first.

    Raises:
        InputError: if they do not fit.

    >>> in_step(Settings(method="grid", dt=0.005), dt=0.02).dt, in_step(Settings(method="event"), dt=0.02).dt
    (0.005, 0.02)
    """
    own = _nearest_in_step(settings, dt)
    if capabilities_of(settings).has_steps and abs(own / settings.dt - 1) > WHOLE:
        raise InputError(
            f"dt of a second stage must be that of the first one, {dt:g}, or a whole fraction of it; got "
            f"{settings.dt:g}. Use Settings(dt={own:g})."
        )
    return dataclasses.replace(settings, dt=own)


def _nearest_in_step(settings: Settings, dt: float) -> float:
    """The dt nearest to that of some settings of which a whole number is `dt`; `dt` itself where there are no steps."""
    return dt / max(round(dt / settings.dt), 1) if capabilities_of(settings).has_steps else dt


@dataclass
class History:
    """The past of two stages since their common start. Of each pair, the first value is that of the first stage."""

    taken: int = 0  # changes of the first stage that were applied to the second
    collisions: list[int] = field(default_factory=lambda: [0, 0])
    seconds: list[float] = field(default_factory=lambda: [0.0, 0.0])  # of computing [s]
    pressure: tuple[MeanPressure, MeanPressure] = field(default_factory=lambda: (MeanPressure(), MeanPressure()))
    parted: float | None = None  # time at which they were seen, or predicted, to part
    saturated: float | None = None  # time at which the distance was first seen to reach SATURATED


class Comparison:
    """A second stage, if one is wanted. It has the scene of the first one and other settings, and follows it in time.

    If it fails, it ends, and the page shows why.

    Attributes:
        wanted: settings of the second stage from the next start on, or a function that makes them from those of the
            first stage; None: no second stage.
        second: the second stage; None: there is none.
    """

    def __init__(self, wanted: Settings | None):
        self.wanted: Settings | Callable[[Settings], Settings] | None = wanted
        self.second: Simulation | None = None
        self._settings: Settings | None = None  # as given
        self._scene: Scene  # at the common start
        self._note: str | None = None
        self._skipped = 0  # changes by hand that were refused here, because a disc was in the way
        self._history = History()
        self._rate: float | None = None  # at which runs diverge [1/time]
        self._diverging: Scene | None = None  # whose Lyapunov time is known, or being found
        self._stopped = threading.Event()
        self._work: threading.Thread | None = None  # that finds the Lyapunov time

    @property
    def settings(self) -> Settings | None:
        """Settings of the second stage, or of the one that was refused; None: none was requested."""
        return self._settings if self.second is None else self.second.settings

    def begin(self, scene: Scene, settings: Settings) -> None:
        """Start the second stage with a scene; settings: those of the first stage."""
        self._end(None)
        self._settings = None
        if self.wanted is None:
            return
        try:
            wanted = self.wanted if isinstance(self.wanted, Settings) else self.wanted(settings)
            self._settings = in_one_process(wanted, "a view")
            self.second = Simulation(scene, in_step(wanted, settings.dt))
        except MpsimError as error:
            self._note = str(error)
            return
        self._scene, self._skipped, self._history = scene, 0, History()
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

    def _find_divergence(self, scene: Scene, stopped: threading.Event) -> None:
        def check(done: int, of: int) -> None:
            if stopped.is_set():
                raise Stopped

        with contextlib.suppress(MpsimError, Stopped):  # of a scene that has none, or that `event` cannot run
            rate = divergence(scene, progress=check)
            check(1, 1)
            self._rate = rate

    def _end(self, note: str | None) -> None:
        second, self.second, self._note = self.second, None, note
        if second is not None:
            with contextlib.suppress(MpsimError):
                second.close()

    @contextlib.contextmanager
    def _ended_by_errors(self) -> Iterator[None]:
        try:
            yield
        except MpsimError as error:
            self._end(f"The second stage has ended: {error}")

    # --- both stages run

    def run(
        self,
        sim: Simulation,
        frames: int,
        every: int,
        look: Callable[[], None],
        measures: Collection[str],
        observers: Sequence[Observer],
    ) -> tuple[list[Report], float]:
        """Run n frames of the first stage, `sim`, and the second stage up to the same time; `look` every n-th frame.

        If there is a second stage, the run is divided: both stages are at the same time whenever `look` is called, so
        that they can be compared. Returns the reports of the first stage, and the computing time of both stages [s].
        """
        if self.second is None:
            watched: Any = SimpleNamespace(every=every, observe=lambda sim, collisions: look())
            report = sim.run(frames=frames, measures=measures, observe=[*observers, watched])
            return [report], float(report.frame_seconds.sum())
        reports, seconds, end = list[Report](), 0.0, sim.frame + frames
        wanted = dict.fromkeys([*measures, *_measures_of(sim)])
        while sim.frame < end:
            ahead = min(end - sim.frame, every - sim.frame % every)
            reports.append(sim.run(frames=ahead, measures=wanted, observe=observers))
            seconds += float(reports[-1].frame_seconds.sum())
            with self._ended_by_errors():
                seconds += self._follow(sim, reports[-1])
            look()
        return reports, seconds

    def _follow(self, first: Simulation, report: Report) -> float:
        """Run until the time of the first stage, which has made this report since; returns the computing time [s]."""
        sim, history = self.second, self._history
        frames = 0 if sim is None else round((first.time - sim.time) / sim.settings.dt)
        if sim is None or frames <= 0:
            return 0.0
        own = sim.run(frames=frames, measures=_measures_of(sim))
        for k, each in enumerate((report, own)):
            history.collisions[k] += each.collisions
            history.seconds[k] += float(each.frame_seconds.sum())
            history.pressure[k].note(each)
        return float(own.frame_seconds.sum())

    # --- changes by hand

    def take(self, first: Simulation) -> None:
        """Apply the new changes of the first stage to the second. Both must be at the same simulated time.

        Changed settings apply only to the first stage, except dt, so that both stay in step. A change that the second
        stage refuses, for example because a disc is in the way, is skipped and counted.
        """
        if self.second is None:
            return
        with self._ended_by_errors():
            for change in list(first.journal)[self._history.taken :]:
                self._history.taken += 1
                values = dict(change.values)
                if change.what == PARAMETERS:
                    if "dt" in values:
                        self._fit(self.second, values["dt"])
                    values = {name: value for name, value in values.items() if name not in OF_SETTINGS}
                if values:
                    self._change(self.second, change.what, values)

    def _change(self, sim: Simulation, what: str, values: Mapping[str, Any]) -> None:
        try:
            if what == WALL:
                make_room(sim, capsules_of((values["wall"],)))
            elif what == ADD:
                places = values["position"]
                radii = np.broadcast_to(values.get("radius", sim.scene.largest_radius), len(places))
                make_room(sim, of_discs(places, radii))
            getattr(sim, what)(**values)
        except ClosedError:
            raise
        except MpsimError as error:
            if what in (ADD, WALL):
                raise InputError(
                    "a second stage must have the discs and walls of the first one; there was no room for one that was "
                    f"added: {error} Reset restarts both."
                ) from error
            self._skipped += 1

    def _fit(self, sim: Simulation, dt: float) -> None:
        """Change dt as little as possible, so that a whole number of steps is one step `dt` of the first stage."""
        assert self._settings is not None  # since the start
        if sim.settings.dt != (own := _nearest_in_step(self._settings, dt)):
            sim.change(dt=own)

    def mark(self) -> tuple[Snapshot, History] | None:
        """The present moment of the second stage, to which `back` can go; None: there is no second stage."""
        with self._ended_by_errors():
            return None if self.second is None else (self.second.snapshot(), copy.deepcopy(self._history))

    def back(self, mark: tuple[Snapshot, History] | None) -> None:
        """Go back to a moment."""
        if self.second is not None and mark is not None:
            with self._ended_by_errors():
                self.second.restore(mark[0])
                self._history = copy.deepcopy(mark[1])

    # --- what the page shows

    def shown(self) -> InPlace | None:
        """The discs of the second stage, for its picture; None: there is no second stage."""
        sim = self.second
        return None if sim is None else in_place(sim.state, sim.scene.box, sim.frame, sim.time, sim.radii)

    def told(self, sim: Simulation) -> dict[str, Any]:
        """The message for pages, for `protocol.text_of`; sim: the first stage. NaN and None are shown as dashes.

        `missed` is the number of collisions that the second stage has counted and the first one has not. Once the
        stages have parted, these are different collisions, and only the fraction is meaningful.
        """
        second, rate, history = self.second, self._rate, self._history
        agree_until = None if rate is None else AGREEMENT / rate
        told: dict[str, Any] = {
            "first": label(sim.settings),
            "second": None if second is None else label(second.settings),
            "exact": second is not None and capabilities_of(second.settings).is_exact,
            "note": self._note,
            "skipped": 0 if second is None else self._skipped,
            "lyapunov_time": None if rate is None else 1 / rate,
            "agree_until": agree_until,
        }
        if second is None:
            return told
        distance = self._distance(sim, second, agree_until)
        pressures = [each.read() for each in history.pressure]
        missed = history.collisions[1] - history.collisions[0]
        return told | {
            "time": sim.time,
            "distance": distance,
            "parted": history.parted,
            "collisions": history.collisions,
            "missed": missed if history.parted is None else None,
            "missed_fraction": missed / history.collisions[1] if history.collisions[1] else math.nan,
            "pressure": [each.value for each in pressures],
            "pressure_difference": pressures[0].value - pressures[1].value,
            "difference_error": math.hypot(*(each.error for each in pressures)),
            "cost_ratio": history.seconds[1] / history.seconds[0] if history.seconds[0] else math.nan,
        }

    def _distance(self, sim: Simulation, second: Simulation, agree_until: float | None) -> float | None:
        """Root mean square distance of corresponding discs, in diameters of the smallest; None where it means nothing.

        The stages have parted for good once they are PARTED diameters apart: from then on their distance is chance.
        Discs in a dense packing rarely leave the cages of their neighbours, so their distance may stay below PARTED.
        Therefore stages that are at least SATURATED diameters apart also count as parted after `agree_until`, the time
        until which two correct solvers agree; None: it is not known.
        """
        scene, time, history = self._scene, sim.time, self._history
        try:
            distance = trajectory_error(sim.state, second.state, scene).rms / (2 * scene.smallest_radius)
        except InputError:  # there are no discs, or a disc was added to only one of them
            return None
        if history.parted is None and distance >= PARTED:
            history.parted = time
        if history.saturated is None and distance >= SATURATED:
            history.saturated = time
        if agree_until is not None and agree_until <= time and history.saturated is not None:
            seen = math.inf if history.parted is None else history.parted
            history.parted = min(max(agree_until, history.saturated), seen)
        return distance if history.parted is None else None


def _measures_of(sim: Simulation) -> tuple[str, ...]:
    """The measures that both stages take along their runs: the pressure, where it is defined."""
    return () if refusal("pressure", sim.scene, sim.count) else ("pressure",)
