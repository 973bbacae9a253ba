"""Runs a simulation in a view: runs frames, carries out commands, makes pictures and gauges.

Each picture shows the state between two frames.
"""

import contextlib
import math
import time
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.core.state import State
from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers.base import InPlace, in_place
from mpsim.engine.solvers.methods import in_one_process
from mpsim.errors import BusyError, ClosedError, InputError, MpsimError
from mpsim.scene.scene import Scene, frames_between_pictures, settings_for
from mpsim.scene.settings import Settings
from mpsim.viewer import export, share_url
from mpsim.viewer.comparison import Comparison
from mpsim.viewer.edits import Interactions, Moment
from mpsim.viewer.gauges import Gauges, Meter
from mpsim.viewer.protocol import Action, OwnColours, command, scale_of, whole
from mpsim.viewer.share_url import Link
from mpsim.viewer.source import LOOK, MOST_STEPS, TURN, Source, TimeBudget, first_speed

COMPARISON_SECONDS = 0.1  # shortest time between two comparisons of two stages [s]

FULL_SPEED, WAITING = (1 / 100, 0.5), (1 / 80, 0.1)
"""Largest fraction of a core for making and sending pictures, and the longest time between two of them [s]; if both
conflict, the time counts. FULL_SPEED is for running as fast as possible, where a picture also interrupts the run.
WAITING is for all other speeds, where the run waits for its next frame anyway."""

READING, COMPARING = (1 / 200, 5.0), (1 / 100, 2.0)
"""The same fraction and time for the gauges, and for comparisons of two stages."""

MOST_PLAIN = 50_000
"""Largest number of discs for which the first picture is made in Python, which is sooner than loading a kernel."""

SLICE_SECONDS = 3e-4
"""Processor time that a picture costs by interrupting the run, when it runs as fast as possible [s]."""

LOOK_SECONDS = 0.1  # time between two checks of a simulation that the user's program may be running [s]


class Session(Source):
    """Runs and shows one simulation, or a scene, also one of a link, which can be restarted.

    A simulation stays with its owner; those of a scene are made and closed here. The arguments are those of
    `mpsim.view`.

    Raises:
        InputError: if settings need several ranks.
    """

    def __init__(
        self,
        source: Scene | Simulation | Link,
        settings: Settings | None = None,
        *,
        name: str,
        playing: bool,
        colour: NDArray[np.float64] | None,
        beside: Settings | None,
    ):
        if beside is not None:
            in_one_process(beside, "a view")
        link = None
        if isinstance(source, Link):
            link, source = source, source.given
            settings, name, beside = link.settings, link.scene, link.beside
        self._sim = source if isinstance(source, Simulation) else None
        self._owned = self._sim is None
        super().__init__(source if isinstance(source, Scene) else source.scene, name, playing)
        own = settings_for(self.scene, settings) if self._sim is None else self._sim.settings
        self._settings = in_one_process(own, "a view")
        self._given, self._seed = self.scene, 0
        self._parameters: Mapping[str, Any] = {} if link is None else link.changed
        self._has_link = self._owned and export.is_named(self.scene, name)
        # of the thread alone
        self._steps = 0
        self._run = 0
        self._comparison = Comparison(beside)
        self._meter = Meter()
        self._gauges: Gauges | None = None
        self._told_dt: float | None = None
        self._own_colours = OwnColours(colour)
        self._last: object = None  # moment of the last observation
        self._comparisons = TimeBudget(COMPARISON_SECONDS)
        if link is not None:
            self._redraw(link.seed)
        self._rate.speed = first_speed(frames_between_pictures(self.scene, self._settings))

    @property
    def _simulation(self) -> Simulation:
        assert self._sim is not None  # otherwise it is over
        return self._sim

    # --- begin and end

    def _open(self) -> None:
        self._tell_scene()
        if self._owned:
            scene = self.scene
            start = State(scene.position, scene.velocity, box=scene.box)
            self._broadcast.scale = scale_of(start)
            # before anything is compiled, or loaded
            discs = in_place(start, scene.box, 0, 0.0, scene.radii)
            self._broadcast.show(discs, plain=scene.count <= MOST_PLAIN)
        self._begin()

    def _begin(self) -> None:
        """Begin at the start of the scene, or at the present frame of a given simulation."""
        self._drop()
        if self._owned:
            self._sim = Simulation(self.scene, self._settings)
            if self._parameters:
                self._sim.change(**self._parameters)
        sim, self._steps, self._over = self._simulation, 0, False
        self._run += 1
        state = sim.state
        self._gauges, self._broadcast.scale = Gauges(self.scene, state, self._settings.law), scale_of(state)
        self._broadcast.scene = self.scene
        self._meter.begin(sim, from_start=self._owned)
        self._meter.start(time.perf_counter())
        self._pictures.done = self._readings.done = None
        self._broadcast.forget_radii()
        self._edits = Interactions(sim, self._owned, self._moment, self._back)
        if self._owned:
            self._comparison.begin(self.scene, self._settings)
            self._comparison.take(sim)
        self._resume()
        self._tell_scene()
        self._tell_comparison()
        self._tell_edits()

    def _resume(self) -> None:
        if self._playing or self._steps:  # in a pause the page keeps the last frame rate
            self._meter.start(time.perf_counter())
        super()._resume()

    def _drop(self) -> None:
        if self._owned and self._sim is not None:
            self._sim.close()
            self._sim = None

    def _release(self) -> None:
        with contextlib.suppress(Exception):  # the first error counts
            self._drop()
        self._comparison.close()

    def _refused(self, error: MpsimError) -> None:
        why_over = self._why_over()
        self._playing, self._steps, self._over = False, 0, why_over is not None
        # a run that met the close of its program was refused as "busy", which is over by now
        self._note = why_over if why_over and isinstance(error, BusyError) else str(error)
        self._tell()

    def _why_over(self) -> str | None:
        """Why no simulation is left that could run; None where one is."""
        try:
            return "There is no simulation." if self._sim is None or self._sim.count < 0 else None
        except ClosedError as error:
            return str(error)

    # --- frames

    def _advance(self) -> None:
        if not self._over:
            self._run_due()
            self._look()

    def _run_due(self) -> None:
        now = time.perf_counter()
        self._rate.look = min(max(self._pictures.wait(now, *self._picture_share), LOOK), TURN)
        frames = self._rate.due(now) if self._playing else min(self._steps, 1)
        if not frames:
            return
        if self._edits.hold_still(time.perf_counter()):
            self._changed()
        self._run_frames(frames)
        if self._steps:
            self._steps -= frames

    def _run_frames(self, frames: int) -> None:
        sim, looks = self._simulation, self._rate.frames_between_looks
        logs = [] if self._meter.log is None else [self._meter.log]
        for log in logs:
            log.every = looks
        try:
            reports, seconds = self._comparison.run(sim, frames, looks, self._picture, self._meter.measures(sim), logs)
        except BaseException:
            self._meter.collisions = math.nan  # unknown until the simulation goes back
            raise
        for log in logs:
            log.observe(sim, 0)  # what came after its last observation
        self._rate.note(frames, seconds)
        for report in reports:
            self._meter.note(report)

    def _look(self) -> None:
        """Make gauges, comparison and picture if they are due and the simulation has moved since the last ones."""
        sim, now = self._simulation, time.perf_counter()
        walls_differ = sim.scene.obstacles is not self._broadcast.scene.obstacles
        if walls_differ or sim.settings.dt != self._told_dt:  # a wall was drawn, dt was changed, or this was undone
            self._broadcast.scene = sim.scene
            self._tell_scene()
        self._last = self._moment_of(sim)
        if self._readings.is_due(self._last, now, *READING):
            self._readings.use(self._read_gauges, self._last, now)
        if self._comparison.second is None:
            self._broadcast.tell_if_new("pair", self._comparison.told(sim))  # it may just have ended, and why
        elif self._comparisons.is_due(self._last, now, *COMPARING):
            self._comparisons.use(self._tell_comparison, self._last, now)
        self._picture()

    def _moment_of(self, sim: Simulation) -> object:
        """What a picture or a reading shows; `_run` grows with each change by hand."""
        return self._run, sim.frame, sim.count

    def _picture(self) -> None:
        """Make a picture if one is asked for and due; also during a run."""
        sim, now = self._simulation, time.perf_counter()
        self._last = self._moment_of(sim)
        with self._wake:
            charged, self._charged = self._charged, 0.0
        self._pictures.charge(charged)
        if self._asked and self._pictures.is_due(self._last, now, *self._picture_share):
            self._asked = False
            self._pictures.use(lambda: sim._read_in_place(self._show), self._last, now)  # pyright: ignore[reportPrivateUsage]
            self._pictures.charge(SLICE_SECONDS if self._picture_share is FULL_SPEED else 0.0)

    def _show(self, discs: InPlace) -> None:
        self._broadcast.show(discs, self._own_colours.bytes_of(discs), self._comparison.shown())
        self._broadcast.tell_if_new("colours", self._own_colours.told())

    @property
    def _picture_share(self) -> tuple[float, float]:
        """The fraction of a core that pictures may take now, and the longest time between two of them [s]."""
        return FULL_SPEED if self._playing and self._rate.speed is None else WAITING

    def _seconds_to_next(self) -> float | None:
        if self._over:
            return None
        if self._steps:
            return 0.0
        now, due = time.perf_counter(), list[float]()
        if self._playing:
            due.append(self._rate.wait(now))
        if not self._owned:
            due.append(LOOK_SECONDS)
        work = [(self._readings, READING)]
        if self._comparison.second is not None:
            work.append((self._comparisons, COMPARING))
        if self._asked:
            work.append((self._pictures, self._picture_share))
        due += [budget.wait(now, *limits) for budget, limits in work if budget.done != self._last]
        return min(due, default=None)

    cannot = "a simulation cannot {}. Send it to the server."

    # --- commands: play

    def do_play(self) -> None:
        self._playing = True

    def do_pause(self) -> None:
        self._playing, self._steps = False, 0

    def do_step(self, frames: int) -> None:
        self._playing, self._steps = False, min(self._steps + frames, MOST_STEPS)

    def do_reset(self) -> None:
        self._demand_scene("reset")
        self._begin()

    @command(value=checks.truth)
    def do_count(self, value: bool) -> None:
        """Switch the counting of pressure and overlap."""
        self._meter.counting = value
        self._meter.forget()

    # --- commands: begin again in another way

    @command(value=whole(0, 10**9))
    def do_seed(self, value: int) -> None:
        """Restart with other random positions and velocities."""
        self._demand_scene("seed")
        self._redraw(value)
        self._begin()

    def _redraw(self, seed: int) -> None:
        """Take other random positions and velocities of the scene, or those that it has, from the next restart on."""
        self.scene: Scene = self._given.redrawn(seed) if seed else self._given
        self._seed = seed

    @command(settings=lambda name, value: None if value is None else checks.text(name, value))
    def do_beside(self, settings: str | None) -> None:
        """Restart with another second stage, or with none; settings: as in a link."""
        self._demand_scene("beside")
        self._comparison.wanted = None if settings is None else partial(share_url.beside_of, text=settings)
        self._begin()

    # --- commands: changes by hand

    def _do(self, action: Action) -> None:
        if not hasattr(self._edits, f"do_{action.name}"):
            super()._do(action)
            return
        self._demand_simulation(action.name)
        self._edits.do(action, time.perf_counter())
        self._changed()

    def _changed(self) -> None:
        """Note that the simulation was changed at this frame: the energy drift is measured from here."""
        self._run += 1
        self._gauges = None
        self._meter.forget()
        self._comparison.take(self._simulation)
        self._tell_edits()

    def _moment(self) -> Moment:
        return Moment(self._simulation.snapshot(), self._meter.collisions, self._comparison.mark())

    def _back(self, moment: Moment) -> None:
        self._simulation.restore(moment.snapshot)
        self._broadcast.forget_radii()
        self._meter.back(moment.collisions)
        self._comparison.back(moment.second)

    def _exported(self, what: str) -> "export.Download":
        return export.FILES[what](self._demand_simulation("a file to keep"), self._name)

    def _demand_simulation(self, what: str) -> Simulation:
        if self._over:
            raise InputError(f"{what} needs a simulation; this one has ended. Reset it.")
        return self._simulation

    def _demand_scene(self, what: str) -> None:
        if not self._owned:
            raise InputError(
                f"{what} needs a scene to start from; this view shows a simulation that belongs to a program. "
                "Open the view with its scene."
            )

    # --- messages to pages

    def _tell_scene(self) -> None:
        self._told_dt = (self._settings if self._sim is None else self._sim.settings).dt
        can = {"can_reset": self._owned, "can_redraw": self._owned and self._given._redraw is not None}
        self._broadcast.tell_scene(self._name, method=self._settings.method, dt=self._told_dt, **can, seed=self._seed)
        self._tell()

    def _tell_edits(self) -> None:
        """Send what hands have changed, and a link to it, with present values; only scenes of mpsim have one."""
        self._broadcast.tell_if_new("hands", self._edits.told())
        text = None
        if self._has_link:
            sim = self._sim
            settings, scene = (self._settings, self.scene) if sim is None else (sim.settings, sim.scene)
            changed = share_url.changed_of(scene, self._given)
            text = share_url.write(Link(self._name, self._seed, settings, changed, self._comparison.settings))
        self._broadcast.tell_if_new("link", {"text": text})

    def _tell_comparison(self) -> None:
        sim = self._simulation
        self._comparisons.done = self._moment_of(sim)
        self._broadcast.tell_if_new("pair", self._comparison.told(sim))

    def _read_gauges(self) -> None:
        sim = self._simulation
        frame, moment, state = sim.frame, sim.time, sim.state  # of a fast run of a program, the state may be later
        if self._gauges is None:  # after a change by hand
            self._gauges = Gauges(sim.scene, state, self._settings.law)
        counts = self._meter.read(time.perf_counter())
        self._tell_gauges(self._gauges, state, frame=frame, time=moment, **counts)
