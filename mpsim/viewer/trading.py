"""Speed against accuracy in a view: a second stage, and its comparison with the first."""

import contextlib
import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from mpsim.core.errors import InputError, MpsimError
from mpsim.engine.observers import Observer
from mpsim.engine.report import Report
from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers.in_place import InPlace, in_place
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.measure.predictability import Predictability
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings
from mpsim.studies.comparison import divergence
from mpsim.studies.tradeoff import label
from mpsim.viewer.background import Background, Check
from mpsim.viewer.comparison import measures_of
from mpsim.viewer.pair import SNAPSHOT, Pair, fitting

MOST_DIVERGING = 5000
"""Discs of a scene at most for which the Lyapunov time is found, by two short exact runs."""

Beside = Settings | Mapping[str, Any] | None
"""A second stage as it is asked for: settings, or what is different from those of the first, as `settings_beside`."""


class Glance:
    """Looks at a run on its way, as an observer.

    Args:
        every: frames between two looks.
        act: called at each with the collisions since the run began.
    """

    def __init__(self, every: int, act: Callable[[int], None]):
        self.every: int = every
        self._act = act

    def look(self, sim: Simulation, collisions: int) -> None:
        """Look."""
        self._act(collisions)


class Trade:
    """The second stage of a view, if there is one.

    Args:
        beside: settings of the second stage; None: there is none.

    Attributes:
        pair: the second stage.

    >>> scene, settings = Scene.random(count=20, packing=0.2, radius=0.5, seed=1), Settings(dt=0.02, method="grid")
    >>> trade = Trade(Settings(method="event"))
    >>> with Simulation(scene, settings) as sim:
    ...     trade.begin(scene, settings)
    ...     reports, seconds = trade.run(sim, frames=10, every=5, look=lambda collisions: None)
    ...     told = trade.told(sim)
    >>> told["first"], told["second"], round(told["time"], 9), told["distance"] < 0.1
    ('grid impact dt=0.02', 'event', 0.2, True)
    >>> trade.close()
    """

    def __init__(self, beside: Settings | None):
        self.pair: Pair | None = None
        self._asked: Beside = beside
        self._wanted: Beside = beside  # as asked for, or fitted to another first stage
        self._settings: Settings | None = None
        self._note: str | None = None
        self._predictability: Predictability | None = None
        self._diverging: Scene | None = None  # whose Lyapunov time is known, or being found
        self._work = Background("mpsim view: divergence")

    def choose(self, beside: Beside) -> None:
        """From the next beginning on, have this second stage."""
        self._asked = self._wanted = beside

    def fit(self, dt: float) -> None:
        """From the next beginning on, have what was asked for, with a dt that fits another first stage.

        dt: of that stage [time].
        """
        if isinstance(self._asked, Settings):
            self._wanted = dataclasses.replace(self._asked, dt=fitting(self._asked.dt, dt))

    @property
    def settings(self) -> Settings | None:
        """Settings of the second stage, or of the one that was refused; None: none was asked for."""
        return self._settings if self.pair is None else self.pair.sim.settings

    def begin(self, scene: Scene, settings: Settings) -> None:
        """Begin both stages with a scene; settings: of the first one."""
        self._end(None)
        self._settings = None
        if self._wanted is None:
            return
        try:
            wanted = self._wanted if isinstance(self._wanted, Settings) else settings_beside(settings, self._wanted)
            self._settings = demand_one_process(wanted)
            self.pair = Pair(scene, wanted, settings.dt)
        except MpsimError as error:
            self._note = str(error)
            return
        if self._diverging is not scene and scene.count <= MOST_DIVERGING:
            self._diverging, self._predictability = scene, None
            self._work.start(self._find_divergence)

    def close(self) -> None:
        """End the second stage."""
        self._work.stop()
        self._end(None)

    def run(
        self,
        sim: Simulation,
        frames: int,
        every: int,
        look: Callable[[int], None],
        measures: Sequence[str] = (),
        observers: Sequence[Observer[Simulation]] = (),
    ) -> tuple[list[Report], float]:
        """Run frames of the first stage, and the second one beside it; at each look both are at the same time.

        With a second stage each look ends a run of both, so that what is compared there is of the same time, too.

        Args:
            sim: the first stage.
            frames: of it.
            every: frames between two looks.
            look: called at each with the collisions of the first stage since this began.
            measures: of the first stage, for others than this comparison.
            observers: of the first stage, who look before.

        Returns:
            The reports of the first stage, and the time of computing of both [s].
        """
        if self.pair is None:
            report = sim.run(frames=frames, measures=measures, observe=[*observers, Glance(every, look)])
            return [report], float(report.frame_seconds.sum())
        reports, seconds, end = list[Report](), 0.0, sim.frame + frames
        wanted = dict.fromkeys([*measures, *measures_of(sim.scene, sim.count)])
        while sim.frame < end:
            ahead = min(end - sim.frame, every - sim.frame % every)
            reports.append(sim.run(frames=ahead, measures=wanted, observe=observers))
            seconds += float(reports[-1].frame_seconds.sum()) + self._follow(sim, reports[-1])
            look(sum(report.collisions for report in reports))
        return reports, seconds

    def _follow(self, sim: Simulation, report: Report) -> float:
        """Run the second stage to where the first one is; returns the time of computing that it took [s]."""
        with self._ended_by_errors():
            if self.pair is not None:
                return self.pair.follow(sim, report)
        return 0.0

    # --- what is done to the first stage

    def changed(self, sim: Simulation, mark: int | None = None) -> None:
        """Make the changes that were made by hand on the first stage.

        mark: number of the moment before them, if it is remembered.
        """
        with self._ended_by_errors():
            if self.pair is not None:
                if mark is not None:
                    self.pair.mark(mark)
                self.pair.take(sim, sim.journal)

    @property
    def bytes_of_moments(self) -> Mapping[int, int]:
        """Bytes of the checkpoint of each moment of the second stage, by number."""
        return {} if self.pair is None else self.pair.bytes_of_moments

    def forget_all_but(self, numbers: Iterable[int]) -> None:
        """Forget the moments to which the first stage cannot go back; numbers: of those to which it can."""
        if self.pair is not None:
            self.pair.forget_all_but(numbers)

    def remember(self) -> None:
        """Remember this moment, as the first stage does."""
        with self._ended_by_errors():
            if self.pair is not None:
                self.pair.mark(SNAPSHOT)

    def back(self, number: int) -> None:
        """Go back to a moment, as the first stage has done."""
        with self._ended_by_errors():
            if self.pair is not None:
                self.pair.back(number)

    @contextlib.contextmanager
    def _ended_by_errors(self) -> Any:
        """An error of the second stage ends it and is shown; the first one continues."""
        try:
            yield
        except MpsimError as error:
            self._end(f"The second stage has ended: {error}")

    def _end(self, note: str | None) -> None:
        pair, self.pair, self._note = self.pair, None, note
        if pair is not None:
            with contextlib.suppress(MpsimError):
                pair.close()

    # --- what pages are told

    def shown(self) -> InPlace | None:
        """The discs of the second stage, for a picture beside that of the first; None: there is none."""
        if self.pair is None:
            return None
        sim = self.pair.sim
        return in_place(sim.state, sim.scene.box, sim.frame, sim.time, sim.radii)

    def told(self, sim: Simulation) -> dict[str, Any]:
        """What pages are told, as `wire.text_of` takes it; sim: the first stage."""
        pair, found = self.pair, self._predictability
        told: dict[str, Any] = {
            "first": label(sim.settings),
            "second": None if pair is None else label(pair.sim.settings),
            "exact": pair is not None and capabilities_of(pair.sim.settings).is_exact,
            "note": self._note,
            "skipped": 0 if pair is None else pair.skipped,
            "lyapunov_time": None if found is None else found.lyapunov_time,
            "agree_until": None if found is None else found.horizon,
        }
        if pair is not None:
            told |= pair.comparison.read(sim.state, pair.sim.state, sim.time, told["agree_until"])
        return told

    def _find_divergence(self, check: Check) -> None:
        scene = self._diverging
        assert scene is not None  # before the work was begun
        with contextlib.suppress(MpsimError):  # a scene that the exact solver cannot run, or without a Lyapunov time
            found = divergence(scene, progress=lambda done, of: check())
            check()
            self._predictability = found


def settings_beside(first: Settings, values: Mapping[str, Any]) -> Settings:
    """Settings of a second stage from what is different there.

    Args:
        first: settings of the first stage.
        values: method, contact, passes, precision; frames: how many of them are one frame of the first, >= 1.

    >>> settings_beside(Settings(dt=0.02, method="grid"), {"frames": 4, "passes": 2}).dt
    0.005
    """
    changed = {name: value for name, value in values.items() if name != "frames"}
    if changed.get("method", first.method) != first.method:
        changed["workers"] = None
    return dataclasses.replace(first, dt=first.dt / values.get("frames", 1), **changed)


def demand_one_process(settings: Settings) -> Settings:
    """Settings that a view can run, as they are given.

    Raises:
        InputError: for those that run on ranks.
    """
    if capabilities_of(settings).on_ranks:
        raise InputError(
            f"a view runs in one process; got method {settings.method!r}, which runs on ranks. Use method='grid', "
            "which has the same bits."
        )
    return settings
