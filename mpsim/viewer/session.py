"""Runs a simulation in a view: runs frames, executes actions, makes pictures and gauges.

Each picture shows the state between two frames.
"""

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.core.state import State
from mpsim.engine.simulation import Simulation, read_in_place
from mpsim.engine.solvers.base import InPlace
from mpsim.errors import BusyError, MpsimError
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings
from mpsim.viewer import wire
from mpsim.viewer.broadcast import Audience
from mpsim.viewer.colouring import Colouring, scale_of
from mpsim.viewer.commands import LOOK, TURN, Allowance, Commanded, Where
from mpsim.viewer.gauges import Counting, Gauges, Meter, bulk_pressure
from mpsim.viewer.link import Link

PICTURE_SECONDS = 0.8 * LOOK
"""Shortest time between two pictures [s]. It is a little less than LOOK; otherwise every other observation of the run
would come too early for a picture."""

GAUGE_SECONDS = 0.4
"""Shortest time between two readings of the gauges [s]."""

PAIR_SECONDS = 0.1
"""Shortest time between two comparisons of two stages [s]."""

FULL_SPEED, WAITING = (1 / 100, 0.5), (1 / 80, 0.1)
"""Largest fraction of a core for making and sending pictures, and the longest time between two of them [s]; if both
conflict, the time counts. FULL_SPEED is for running as fast as possible, where a picture also interrupts the run.
WAITING is for all other speeds, where the run waits for its next frame anyway."""

MOST_PLAIN = 50_000
"""Largest number of discs for which the first picture is made in Python, which is sooner than loading a kernel."""

SLICE_SECONDS = 3e-4
"""Processor time that a picture costs by interrupting the run, when it runs as fast as possible [s]."""

READING, COMPARING = (1 / 200, 5.0), (1 / 100, 2.0)
"""The same fraction and time for the gauges, and for comparisons of two stages."""

LOOK_SECONDS = 0.1
"""Time between two checks of a simulation that the user's program may be running [s]."""


class Session(Commanded):
    """Runs and shows one simulation, or a scene that can be restarted.

    Args:
        source: a scene, or a link to one; the session makes and closes its simulations. Or a simulation; it stays with
            its owner.
        settings: settings for a scene; None: those it recommends, or the defaults.
        name: title on the page.
        playing: whether it starts as soon as a page is visible.
        colour: initial numbers to colour discs by, see `Colouring`; None: their speed.
        beside: settings of a second stage, which runs the same scene; None: none, until a page asks for one.
        audience: the pages.

    Attributes:
        error: the error that ended the session, if any.
    """

    def __init__(
        self,
        source: Scene | Simulation | Link,
        settings: Settings | None = None,
        *,
        name: str = "",
        playing: bool = True,
        colour: NDArray[np.float64] | None = None,
        beside: Settings | None = None,
        audience: Audience,
    ):
        super().__init__(source, settings, name, beside, audience)
        # of the thread alone
        self._playing = playing
        self._meter = Meter(time.perf_counter())
        self._gauges: Gauges | None = None
        self._told_dt: float | None = None
        self._last: Where | None = None  # moment of the last observation, ...
        self._gauged: Where | None = None  # ... of the last reading of the gauges, ...
        self._compared: Where | None = None  # ... and of the last comparison of both stages
        self._pictures = Allowance(PICTURE_SECONDS)
        self._readings = Allowance(GAUGE_SECONDS)
        self._comparisons = Allowance(PAIR_SECONDS)
        self._counting = Counting()
        self._colouring = Colouring(colour)

    # --- the thread

    def _open(self) -> None:
        self._tell_scene("starting")
        if self._owned:
            start = State(self.scene.position, self.scene.velocity, box=self.scene.box)
            self._broadcast.scale = scale_of(start)
            # before anything is compiled, or loaded
            self._broadcast.show(start, self.scene.radii, 0, 0.0, plain=self.scene.count <= MOST_PLAIN)
        self._begin()

    def _stopped_by(self, error: BaseException) -> None:
        self._over, self._note = True, str(error) or type(error).__name__
        self._tell()

    def _begin(self) -> None:
        self._drop()
        if self._owned:
            self._sim = Simulation(self.scene, self._settings)
            if self._parameters:
                self._sim.change(**self._parameters)
        assert self._sim is not None
        state = self._sim.state
        self._gauges, self._broadcast.scale = Gauges(self.scene, state, self._settings.law), scale_of(state)
        self._run += 1
        self._counting.forget()
        self._collisions.begin(self._sim, from_start=self._owned)
        self._colouring.begin()
        self._shown = self._gauged = None
        self._broadcast.forget_radii()
        self._over = False
        self._hands.begin(self._sim)
        self._passes.close()
        self._forget_moment()
        if self._owned:
            self._trade.begin(self.scene, self._settings)
            self._trade.changed(self._sim)
        self._resume()
        self._tell_trade()
        self._broadcast.tell_if_new("pass", self._passes.told())
        self._broadcast.tell_if_new("hands", self._hands.told(self._sim))
        self._tell_link()

    def _show_more(self, action: wire.Action) -> None:
        if action.name == "count":
            self._counting.wanted = action.values["value"]
            self._counting.forget()
        else:
            self._colouring.choose(action.values["by"], self._demand_simulation("colour"))
            self._shown = None

    def _forget_own_colours(self) -> None:
        self._colouring = Colouring(None)

    def _renew_gauges(self) -> None:
        self._gauges = None
        self._counting.forget()
        self._colouring.begin()

    def _resume(self) -> None:
        now = time.perf_counter()
        self._pace.start(now)
        self._meter.start(now)
        self._note = None
        self._tell()

    def _refused(self, error: MpsimError) -> None:
        why_over = self._why_over()
        self._playing, self._steps, self._over = False, 0, why_over is not None
        # a run that met the close of its program was refused as "busy", which is over by now
        self._note = why_over if why_over and isinstance(error, BusyError) else str(error)
        self._tell()

    def _advance(self) -> None:
        if not self._over and not self._tuning.running:
            self._run_due()
            self._look()

    def _run_due(self) -> None:
        """Run the frames that are due."""
        now = time.perf_counter()
        self._pace.look = min(max(self._pictures.wait(now, *self._picture_share), LOOK), TURN)
        frames = self._pace.due(now) if self._playing else min(self._steps, 1)
        if not frames:
            return
        self._close_passes()
        if self._hands.hold_still(self._simulation, time.perf_counter()):
            self._changed()
        self._run_frames(frames)
        if self._steps:
            self._steps -= frames

    def _run_frames(self, frames: int) -> None:
        looks = self._pace.frames_between_looks
        measures = self._counting.measures(self._simulation)
        sim = self._simulation
        observers = [*self._colouring.observers(looks), *self._collisions.observers(looks)]
        try:
            reports, seconds = self._trade.run(sim, frames, looks, self._look, measures, observers)
        except BaseException:
            self._collisions.lose()
            raise
        self._colouring.end_run(sim)
        self._collisions.end_run(sim, reports)
        self._pace.note(frames, seconds)
        for report in reports:
            self._meter.note(report)
            self._counting.note(report)

    def _look(self, collisions: int = 0) -> None:
        """Make the picture and the gauges if they are due and the simulation has moved since the last ones.

        collisions: collisions between discs so far in the present run.
        """
        sim, now = self._simulation, time.perf_counter()
        walls_differ = sim.scene.obstacles is not self._broadcast.scene.obstacles
        if walls_differ or sim.settings.dt != self._told_dt:  # a wall was drawn, dt was changed, or this was undone
            self._broadcast.scene = sim.scene
            self._tell_scene("playing" if self._playing else "paused")
        where = self._last = (self._run, sim.frame, sim.count)
        with self._wake:
            charged, self._charged = self._charged, 0.0
            asked = self._asked
        self._pictures.charge(charged)
        if where != self._gauged and not self._readings.wait(now, *READING):
            spent = time.thread_time()
            self._gauged = where
            now_shown = (sim.state, sim.frame, sim.time) if self._owned else _now(sim)
            self._tell_gauges(*now_shown, self._collisions.so_far(sim, collisions))
            self._readings.use(now, time.thread_time() - spent)
        if self._trade.pair is None:
            self._broadcast.tell_if_new("pair", self._trade.told(sim))  # it may just have ended, and why
        elif where != self._compared and not self._comparisons.wait(now, *COMPARING):
            spent = time.thread_time()
            self._tell_trade()
            self._comparisons.use(now, time.thread_time() - spent)
        if asked and where != self._shown and not self._pictures.wait(now, *self._picture_share):
            now, spent = time.perf_counter(), time.thread_time()
            with self._wake:
                self._asked = False
            self._shown = where
            read_in_place(sim, self._show)
            self._broadcast.tell_if_new("colours", self._colouring.told(sim))
            slice_cost = SLICE_SECONDS if self._picture_share is FULL_SPEED else 0.0
            self._pictures.use(now, time.thread_time() - spent + slice_cost)

    def _show(self, discs: InPlace) -> None:
        """Send a picture with the chosen colours."""
        colours = self._colouring.bytes_of(self._simulation, discs)
        self._broadcast.show_in_place(discs, colours, self._trade.shown())

    @property
    def _picture_share(self) -> tuple[float, float]:
        """The fraction of a core that pictures may take now, and the longest time between two of them [s]."""
        return FULL_SPEED if self._playing and self._pace.speed is None else WAITING

    def _seconds_to_next(self) -> float | None:
        if self._over or self._tuning.running:
            return None
        if self._steps:
            return 0.0
        now, due = time.perf_counter(), list[float]()
        if self._playing:
            due.append(self._pace.wait(now))
        if not self._owned:
            due.append(LOOK_SECONDS)
        if self._last != self._gauged:
            due.append(self._readings.wait(now, *READING))
        if self._trade.pair is not None and self._last != self._compared:
            due.append(self._comparisons.wait(now, *COMPARING))
        if self._asked and self._last != self._shown:
            due.append(self._pictures.wait(now, *self._picture_share))
        return min(due, default=None)

    # --- messages to pages

    def _tell_scene(self, phase: str) -> None:
        self._told_dt = (self._settings if self._sim is None else self._sim.settings).dt
        self._broadcast.tell_scene(
            self._name,
            method=self._settings.method,
            dt=self._told_dt,
            can_reset=self._owned,
            can_redraw=self._owned and self._given.can_redraw,
            seed=self._seed,
        )
        self._broadcast.tell("status", self._status(phase))

    def _tell(self) -> None:
        self._broadcast.tell("status", self._status("over" if self._over else "playing" if self._playing else "paused"))

    def _status(self, phase: str) -> dict[str, Any]:
        remembered = {"can_remember": self._owned, "snapshot": self._snapshot}
        return {"phase": phase, "speed": self._pace.speed, "note": self._note, **remembered}

    def _tell_trade(self) -> None:
        """Send the state of the second stage, and the comparison of both."""
        sim = self._simulation
        self._compared = (self._run, sim.frame, sim.count)
        self._broadcast.tell_if_new("pair", self._trade.told(sim))

    def _tell_gauges(self, state: State, frame: int, moment: float, collisions: float) -> None:
        if self._gauges is None:  # after a change by hand
            self._gauges = Gauges(self._simulation.scene, state, self._settings.law)
        self._broadcast.scale = scale_of(state)
        numbers = self._gauges.of(state)
        workers = self._meter.workers()
        rates = self._meter.read(numbers["discs"], time.perf_counter())
        numbers |= self._counting.numbers() | {"bulk_pressure": bulk_pressure(state, self._simulation.scene)}
        numbers |= {"collisions": collisions, "with_walls": self._collisions.with_walls}
        self._broadcast.tell("gauges", {"frame": frame, "time": moment, **numbers, **vars(rates), **workers})


def _now(sim: Simulation) -> tuple[State, int, float]:
    """State, frame and time of a simulation that another thread of the user's program may be running.

    If it runs fast, the state may be a few frames later than frame and time.
    """
    frame, moment, state = sim.frame, sim.time, sim.state
    for _ in range(3):
        if sim.frame == frame:
            break
        frame, moment, state = sim.frame, sim.time, sim.state
    return state, frame, moment
