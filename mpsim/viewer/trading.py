"""Speed against accuracy in a view: a second stage is compared, or settings are searched for, in a thread."""

import contextlib
import dataclasses
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from mpsim.engine.observers import Observer
from mpsim.engine.report import Report
from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers.base import InPlace, in_place
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.errors import InputError, MpsimError
from mpsim.measure.predictability import Predictability
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings
from mpsim.studies.comparison import divergence
from mpsim.studies.tradeoff import label
from mpsim.studies.tune import tune
from mpsim.viewer.pair import SNAPSHOT, Pair, fitting, measures_of

# --- Runs long work in a thread of its own, and can cancel it

CLOSING_SECONDS = 5.0
"""Longest time that `stop` waits for cancelled work to end."""

Check = Callable[[], None]
"""The work calls this from time to time. It raises an exception once the work was cancelled."""


class _GivenUpError(Exception):
    """The work was cancelled."""


class Background:
    """Runs one piece of work at a time.

    Args:
        name: name of the thread.

    >>> found, work = [], Background("an example")
    >>> work.start(lambda check: found.append(1))
    >>> work.wait()
    >>> found
    [1]
    """

    def __init__(self, name: str):
        self._name = name
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()

    def start(self, work: Callable[[Check], None]) -> None:
        """Start the work, which is called with a `Check`. Work that is still running is cancelled."""
        self.stop()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=_do, args=(work, self._stop), name=self._name, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Cancel the work; it ends at its next check."""
        self._stop.set()
        self.wait(CLOSING_SECONDS)
        self._thread = None

    def wait(self, seconds: float | None = None) -> None:
        """Wait until the work ends, for at most this time [s]; None: without a limit."""
        if self._thread is not None:
            self._thread.join(seconds)


def _do(work: Callable[[Check], None], stop: threading.Event) -> None:
    def check() -> None:
        if stop.is_set():
            raise _GivenUpError

    try:
        work(check)
        check()
    except _GivenUpError:
        pass


# --- Searches for settings in a thread, and reports its progress

SECONDS = 60.0
"""Approximate time limit of a search [s]."""


class Tuning:
    """Runs one search at a time.

    Args:
        news: called when there is new progress to report.
        finished: called with the number of the search and the settings that it has found. The thread of the search
            calls both.

    Attributes:
        number: number of the present search. A result with another number is out of date.

    >>> tuning = Tuning(news=lambda: None, finished=print)
    >>> tuning.told()["phase"]
    'none'
    """

    def __init__(self, news: Callable[[], None], finished: Callable[[int, Settings], None]):
        self._news, self._finished = news, finished
        self.number: int = 0
        self._work = Background("mpsim view: tune")
        self._told: dict[str, Any] = {"phase": "none", "text": "", "done": 0, "of": 1}

    @property
    def running(self) -> bool:
        """Whether a search is under way."""
        return self._told["phase"] == "searching"

    def told(self) -> dict[str, Any]:
        """The message for pages, for `wire.text_of`.

        phase: "none", "searching", "found" or "failed". text: the present step, the result, or why there is none.
        """
        return dict(self._told)

    def start(self, scene: Scene, budgets: Mapping[str, float]) -> None:
        """Start a search and cancel a running one; budgets: as in `mpsim.tune`."""
        self.stop()
        self._told = {"phase": "searching", "text": "preliminary run", "done": 0, "of": 1}
        number = self.number
        self._work.start(lambda check: self._search(scene, budgets, check, number))

    def stop(self) -> None:
        """Cancel the search; it ends when it next reports its progress."""
        self.number += 1
        self._work.stop()
        self._told = {**self._told, "phase": "none"}

    def _search(self, scene: Scene, budgets: Mapping[str, float], check: Check, number: int) -> None:
        def progress(done: int, of: int, what: str) -> None:
            check()
            self._tell(phase="searching", text=what, done=done, of=of)

        try:
            found = tune(scene, budgets, seconds=SECONDS, progress=progress)
        except Exception as error:  # any error: the stages must not wait any longer
            check()
            self._tell(phase="failed", text=str(error) or type(error).__name__)
            if isinstance(error, MpsimError):
                return
            raise
        check()
        self._tell(phase="found", text=str(found))
        self._finished(number, found.settings)

    def _tell(self, **values: Any) -> None:
        self._told = {**self._told, **values}
        self._news()


# --- Shows speed against accuracy in a view: runs a second stage and compares it with the first

MOST_DIVERGING = 5000
"""Largest number of discs for which the Lyapunov time is computed, by two short exact runs."""

Beside = Settings | Mapping[str, Any] | None
"""A requested second stage: its settings, or how they differ from those of the first stage, as in `settings_beside`."""


class Glance:
    """An observer that calls a function during a run.

    Args:
        every: frames between two calls.
        act: function to call, with the number of collisions since the run began.
    """

    def __init__(self, every: int, act: Callable[[int], None]):
        self.every: int = every
        self._act = act

    def observe(self, sim: Simulation, collisions: int) -> None:
        """Call the function."""
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
        self._wanted: Beside = beside  # as requested, or with dt fitted to another first stage
        self._settings: Settings | None = None
        self._note: str | None = None
        self._predictability: Predictability | None = None
        self._diverging: Scene | None = None  # whose Lyapunov time is known, or being found
        self._work = Background("mpsim view: divergence")

    def choose(self, beside: Beside) -> None:
        """Choose the second stage; it applies from the next restart on."""
        self._asked = self._wanted = beside

    def fit(self, dt: float) -> None:
        """Fit the dt of the requested second stage to another first stage; it applies from the next restart on.

        dt: dt of the first stage [time].
        """
        if isinstance(self._asked, Settings):
            self._wanted = dataclasses.replace(self._asked, dt=fitting(self._asked.dt, dt))

    @property
    def settings(self) -> Settings | None:
        """Settings of the second stage, or of the one that was refused; None: none was requested."""
        return self._settings if self.pair is None else self.pair.sim.settings

    def begin(self, scene: Scene, settings: Settings) -> None:
        """Start the second stage with a scene; settings: those of the first stage."""
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
        observers: Sequence[Observer] = (),
    ) -> tuple[list[Report], float]:
        """Run frames of the first stage, and the second stage up to the same time.

        If there is a second stage, the run is divided: both stages are at the same time whenever `look` is called, so
        that they can be compared.

        Args:
            sim: the first stage.
            frames: number of frames of the first stage.
            every: frames between two calls of `look`.
            look: called with the number of collisions of the first stage since this call began.
            measures: measures of the first stage, besides those for the comparison.
            observers: observers of the first stage, called before `look`.

        Returns:
            The reports of the first stage, and the computing time of both stages [s].
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
        """Run the second stage up to the first one; returns the computing time [s]."""
        with self._ended_by_errors():
            if self.pair is not None:
                return self.pair.follow(sim, report)
        return 0.0

    # --- changes of the first stage

    def changed(self, sim: Simulation, mark: int | None = None) -> None:
        """Apply the changes that were made by hand on the first stage.

        mark: number of the moment before them, if it was remembered.
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
        """Forget all moments except these, to which the first stage can go back."""
        if self.pair is not None:
            self.pair.forget_all_but(numbers)

    def remember(self) -> None:
        """Remember this moment, like the first stage."""
        with self._ended_by_errors():
            if self.pair is not None:
                self.pair.mark(SNAPSHOT)

    def back(self, number: int) -> None:
        """Go back to a moment, like the first stage."""
        with self._ended_by_errors():
            if self.pair is not None:
                self.pair.back(number)

    @contextlib.contextmanager
    def _ended_by_errors(self) -> Any:
        """If the second stage fails, end it and show why. The first stage continues."""
        try:
            yield
        except MpsimError as error:
            self._end(f"The second stage has ended: {error}")

    def _end(self, note: str | None) -> None:
        pair, self.pair, self._note = self.pair, None, note
        if pair is not None:
            with contextlib.suppress(MpsimError):
                pair.close()

    # --- for the pages

    def shown(self) -> InPlace | None:
        """The discs of the second stage, for its picture; None: there is no second stage."""
        if self.pair is None:
            return None
        sim = self.pair.sim
        return in_place(sim.state, sim.scene.box, sim.frame, sim.time, sim.radii)

    def told(self, sim: Simulation) -> dict[str, Any]:
        """The message for pages, for `wire.text_of`; sim: the first stage."""
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
        assert scene is not None  # set before the work was started
        with contextlib.suppress(MpsimError):  # a scene that the exact solver cannot run, or without a Lyapunov time
            found = divergence(scene, progress=lambda done, of: check())
            check()
            self._predictability = found


def settings_beside(first: Settings, values: Mapping[str, Any]) -> Settings:
    """Settings of a second stage: those of the first with some changes.

    Args:
        first: settings of the first stage.
        values: changed settings among method, contact, passes and precision; and `frames`, the number of frames of the
            second stage in one frame of the first, >= 1.

    >>> settings_beside(Settings(dt=0.02, method="grid"), {"frames": 4, "passes": 2}).dt
    0.005
    """
    changed = {name: value for name, value in values.items() if name != "frames"}
    if changed.get("method", first.method) != first.method:
        changed["workers"] = None
    return dataclasses.replace(first, dt=first.dt / values.get("frames", 1), **changed)


def demand_one_process(settings: Settings) -> Settings:
    """Settings that a view can run, unchanged.

    Raises:
        InputError: if they need several ranks.
    """
    if capabilities_of(settings).on_ranks:
        raise InputError(
            f"a view runs in one process; got method {settings.method!r}, which runs on ranks. Use method='grid', "
            "which has the same bits."
        )
    return settings
