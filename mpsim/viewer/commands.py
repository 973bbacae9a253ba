"""Actions with which pages control a simulation, how many frames a picture takes, and frames pass by pass."""

import contextlib
import dataclasses
import math
import time
from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

from mpsim.engine.simulation import Simulation, next_frame_in_passes
from mpsim.engine.solvers.base import in_place
from mpsim.engine.solvers.grid import Pass, has_passes_by_grid
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.errors import ClosedError, InputError
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings, frames_between_pictures, settings_for
from mpsim.viewer import keep, link, wire
from mpsim.viewer.broadcast import Audience
from mpsim.viewer.gauges import CollisionCount
from mpsim.viewer.hands import Hands
from mpsim.viewer.link import Link
from mpsim.viewer.pair import SNAPSHOT
from mpsim.viewer.source import Source
from mpsim.viewer.trading import Trade, Tuning, demand_one_process
from mpsim.viewer.undo import Moments

# --- Decides how many frames to run before the next picture, for a given speed and quick responses

UNIT = 60.0
"""Frames a second at speed 1: one for each picture of a usual screen."""

LOOK = 1 / 60
"""Shortest time between two observations of a run [s]. Each interrupts the run, which costs 0.3 ms."""

TURN = 3 * LOOK
"""Longest time for which frames are run at once [s]; an action waits at most so long. To start and end a run takes
0.3 ms."""

MOST_BEHIND = 0.1
"""Largest delay that a simulation catches up [s]. After a longer stop, the missed frames are dropped."""

MOST_FRAMES = 10_000
"""Largest number of frames to run at once, however short they are."""

SPEEDS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100)
"""Speeds that the page offers, as in its link.js."""

PICTURES = 25
"""Recommended pictures of a scene that are shown per second."""


def first_speed(every: int | None) -> float:
    """The speed at which a scene is first shown: one that the page offers, in units of UNIT frames a second.

    Args:
        every: frames between two recommended pictures of the scene; None: it recommends none.

    >>> first_speed(None), first_speed(10)
    (1.0, 2.0)
    """
    wanted = 1.0 if every is None else every * PICTURES / UNIT
    return float(max((speed for speed in SPEEDS if speed <= wanted), default=SPEEDS[0]))


class Pace:
    """Decides which frames are due. All times are from one clock [s].

    Attributes:
        speed: in units of UNIT frames a second; None: as fast as possible.
        look: time between two observations of a run, from LOOK to TURN [s].

    >>> pace = Pace(speed=1.0)
    >>> pace.start(now=10.0)
    >>> pace.due(now=10.0), pace.due(now=10.001), round(pace.wait(now=10.001), 4)
    (1, 0, 0.0157)
    """

    def __init__(self, speed: float | None = 1.0):
        self.speed: float | None = speed
        self.look: float = LOOK
        self._next = 0.0
        self._seconds_per_frame: float | None = None

    def start(self, now: float) -> None:
        """Start at this moment; the first frame is due at once."""
        self._next = now

    def due(self, now: float) -> int:
        """Number of frames to run now, at most as many as fit into TURN. They then no longer count as due."""
        if self.speed is None:
            looks = self.frames_between_looks
            return max(self._fitting(TURN) // looks, 1) * looks
        rate = self.speed * UNIT
        self._next = max(self._next, now - MOST_BEHIND)
        if now < self._next:
            return 0
        frames = min(int((now - self._next) * rate) + 1, self._fitting(TURN))
        self._next += frames / rate
        return frames

    def wait(self, now: float) -> float:
        """Time until the next frame is due [s]."""
        return 0.0 if self.speed is None else max(self._next - now, 0.0)

    @property
    def frames_between_looks(self) -> int:
        """Number of frames that fit into `look`, at least one.

        It is a power of two, so that it stays the same although the time of a frame varies a little.
        """
        return 1 << (self._fitting(self.look).bit_length() - 1)

    def note(self, frames: int, seconds: float) -> None:
        """Note how long some frames took [s]."""
        self._seconds_per_frame = max(seconds / frames, 1e-9)

    def _fitting(self, seconds: float) -> int:
        """Number of frames that take so long; one if the time of a frame is not known yet."""
        if self._seconds_per_frame is None:
            return 1
        return min(max(int(seconds / self._seconds_per_frame), 1), MOST_FRAMES)


class Allowance:
    """Limits the fraction of a core that repeated work takes, by a pause after each use. Times are from one clock [s].

    Args:
        at_least: shortest time between two uses [s].

    >>> allowance = Allowance(at_least=0.01)
    >>> allowance.use(now=10.0, cost=0.001)
    >>> allowance.charge(0.002)
    >>> [round(allowance.wait(10.0, share, at_most=0.5), 3) for share in (0.001, 0.02, 0.5)]
    [0.5, 0.15, 0.01]
    """

    def __init__(self, at_least: float):
        self._at_least = at_least
        self._last = -math.inf
        self._cost = 0.0

    def use(self, now: float, cost: float) -> None:
        """Note a use at this moment; cost: processor time that it took [s]."""
        self._last, self._cost = now, cost

    def charge(self, cost: float) -> None:
        """Add processor time to the cost of the last use [s]."""
        self._cost += cost

    def wait(self, now: float, share: float, at_most: float) -> float:
        """Time until the next use [s], so that the uses take at most this fraction of a core; 0: now.

        at_most: longest time between two uses [s], whatever they cost.
        """
        pause = min(max(self._cost / share, self._at_least), at_most)
        return max(self._last + pause - now, 0.0)


# --- Shows one frame pass by pass, with the worker that resolves each contact


class PassView:
    """Shows the passes of the next frame one after the other. The simulation itself does not change meanwhile.

    >>> from mpsim import Scene, Settings
    >>> view = PassView()
    >>> with Simulation(Scene.random(count=50, packing=0.4, radius=0.5, seed=1), Settings(method="grid")) as sim:
    ...     names = [view.next(sim).name, view.next(sim).name]
    ...     view.is_last
    True
    >>> names
    ['even', 'odd']
    """

    def __init__(self) -> None:
        self._passes: list[Pass] = []
        self._shown = -1

    @property
    def is_open(self) -> bool:
        """Whether a pass is shown."""
        return self._shown >= 0

    @property
    def is_last(self) -> bool:
        """Whether the last pass of the frame is shown. Its discs are where the frame leaves them."""
        return self.is_open and self._shown == len(self._passes) - 1

    def next(self, sim: Simulation) -> Pass:
        """The next pass. After the last pass of a frame comes the first pass of the following frame.

        Raises:
            InputError: if the method or the scene has no passes.
        """
        if not self.is_open or self.is_last:
            self._passes, self._shown = next_frame_in_passes(sim), -1
        self._shown += 1
        return self._passes[self._shown]

    def demand_end(self, digest: str) -> None:
        """Check that the frame has ended as its last pass did; digest: that of the simulation after the frame.

        Raises:
            InputError: if not, for example because the frame was divided into more steps than the one before.
        """
        if self._passes[self._shown].state.digest() != digest:
            raise InputError(
                "the passes that were shown must end where the frame does; this frame was divided into other steps "
                "than the one before. Show the next one."
            )

    def offer(self, sim: Simulation) -> dict[str, Any] | None:
        """The message for pages if frames have no passes but would have them with the method grid; None otherwise.

        >>> from mpsim import Scene, Settings
        >>> with Simulation(Scene.random(count=5, packing=0.2, radius=0.5, seed=1), Settings(method="naive")) as sim:
        ...     PassView().offer(sim)["offer"]
        'The method naive tests all pairs of discs at once, so a frame has no passes. The method grid has passes.'
        """
        if _has_columns(sim) or not has_passes_by_grid(sim.scene, sim.settings, sim.radii):
            return None
        what = "method naive tests all pairs of discs at once"
        if not capabilities_of(sim.settings).has_steps:
            what = "exact solver resolves one collision after another"
        return {"name": None, "offer": f"The {what}, so a frame has no passes. The method grid has passes."}

    def close(self) -> None:
        """Stop showing passes."""
        self._passes, self._shown = [], -1

    def told(self) -> dict[str, Any]:
        """The message for pages, for `wire.text_of`. Its `name` is that of the pass; None: no pass is shown."""
        if not self.is_open:
            return {"name": None}
        shown = self._passes[self._shown]
        return {
            "name": shown.name,
            "number": shown.number + 1,
            "of": len(self._passes),
            "contacts": shown.contacts,
            "columns": shown.columns,
            "brackets": shown.brackets.tolist(),
            "owners": shown.owners.tolist(),
        }


def _has_columns(sim: Simulation) -> bool:
    try:
        sim.columns()
    except InputError:
        return False
    return True


# --- Actions with which pages control a simulation: play, change, go back, restart, show a frame pass by pass

Where = tuple[int, int, int]
"""The moment that a picture or a reading shows: a number that grows with each change by hand, the frame, and the number
of discs."""


class Commanded(Source):
    """A simulation that pages control; `Session` runs and shows it.

    Args:
        source, settings, name, beside, audience: as in `Session`.
    """

    def __init__(
        self,
        source: Scene | Simulation | Link,
        settings: Settings | None,
        name: str,
        beside: Settings | None,
        audience: Audience,
    ):
        asked = source if isinstance(source, Link) else None
        shown = source.given if isinstance(source, Link) else source
        super().__init__(shown if isinstance(shown, Scene) else shown.scene, audience)
        self._owned = isinstance(shown, Scene)
        self._sim = None if isinstance(shown, Scene) else shown
        self._settings = _checked(settings, self._sim, self.scene)
        self._given, self._seed, self._name = self.scene, 0, name
        self._parameters: Mapping[str, Any] = {}
        self._has_link = self._owned and keep.is_named(self.scene, name)
        # of the thread alone
        self._playing = False
        self._steps = 0
        self._note: str | None = None
        self._pace = Pace(first_speed(frames_between_pictures(self.scene, self._settings)))
        self._over = True  # until there is one
        self._run = 0
        self._shown: Where | None = None  # moment of the last picture
        self._hands = Hands(self._owned)
        self._trade = Trade(_demand_owned(beside, self._owned))
        self._tuning = Tuning(lambda: self.submit(wire.Action("searching", {})), self._found)
        self._passes = PassView()
        self._collisions = CollisionCount()
        self._moments = Moments()
        self._snapshot: int | None = None  # frame of the moment that is remembered
        if asked is not None:
            self._take(asked)

    def _take(self, asked: Link) -> None:
        """Take the scene and settings of a link; they apply from the next restart on."""
        scene = asked.given.redrawn(asked.seed) if asked.seed else asked.given
        self._given, self._seed, self._name, self._has_link = asked.given, asked.seed, asked.scene, True
        self._settings, self._parameters = asked.settings, asked.changed
        self._show_scene(scene)
        self._trade.choose(asked.beside)
        self._pace.speed = first_speed(frames_between_pictures(scene, asked.settings))

    def _link(self) -> str | None:
        """The link to what is shown, with its present values; None: only scenes that come with mpsim have a link."""
        if not self._has_link:
            return None
        sim = self._sim
        settings, scene = (self._settings, self.scene) if sim is None else (sim.settings, sim.scene)
        changed = link.changed_of(scene, self._given)
        return link.write(Link(self._name, self._seed, settings, changed, self._trade.settings))

    def _tell_link(self) -> None:
        self._broadcast.tell_if_new("link", {"text": self._link()})

    def _release(self) -> None:
        with contextlib.suppress(Exception):  # the first error counts
            self._drop()
        self._tuning.stop()
        self._trade.close()
        for each in (self._hands, self._moments):
            with contextlib.suppress(OSError):
                each.close()

    def _drop(self) -> None:
        """Close the simulation if it belongs to the view."""
        if self._owned and self._sim is not None:
            self._sim.close()
            self._sim = None

    def _why_over(self) -> str | None:
        """Why no simulation is left that could run; None where one is."""
        try:
            return "There is no simulation." if self._sim is None or self._sim.count < 0 else None
        except ClosedError as error:
            return str(error)

    @property
    def _simulation(self) -> Simulation:
        assert self._sim is not None  # otherwise it is over
        return self._sim

    def _do(self, action: wire.Action) -> None:
        match action.name:
            case "play":
                self._playing = True
                self._resume()
            case "pause":
                self._playing, self._steps = False, 0
                self._tell()
            case "step":
                self._playing, self._steps = False, min(self._steps + action.values["frames"], wire.MOST_STEPS)
                self._resume()
            case "speed":
                self._pace.speed = action.values["value"]
                self._resume()
            case "reset":
                self._demand_scene("reset")
                self._steps = 0
                self._begin()
            case "count" | "colour":
                self._show_more(action)
            case "keep":
                keep.answer(None if self._over else self._sim, self._name, **action.values)
            case "hold" | "release" | "add" | "stroke" | "remove" | "wall" | "change" | "undo":
                self._by_hand(action)
            case "pass" | "snapshot" | "return" as name:
                {"pass": self._show_pass, "snapshot": self._remember, "return": self._go_back}[name]()
            case "seed" | "beside" | "open" | "grid" | "found":
                self._choose(action)
            case "tune" | "stop_tuning" | "searching":
                self._search(action)
            case name:
                raise InputError(f"a simulation cannot {name}. Send it to the server.")

    def _by_hand(self, action: wire.Action) -> None:
        """Change discs as a user asks. A refused change is reported on the page; the simulation continues."""
        sim = self._demand_simulation(action.name)
        if action.name == "undo":
            self._broadcast.forget_radii()
        undo = self._hands.undo
        before = undo.last
        self._sim = self._hands.do(sim, action, time.perf_counter())
        if action.name == "undo" and undo.last != before:  # otherwise it was refused
            self._trade.back(before)
            self._collisions.back(before)
        self._changed(undo.last if undo.last > before else None)

    def _changed(self, mark: int | None = None) -> None:
        """Note that the simulation was changed at this frame: the energy drift is measured from here.

        mark: number of the moment before the change, if it was newly remembered.
        """
        self._run += 1
        self._renew_gauges()
        self._close_passes()
        if mark is not None:
            self._collisions.mark(mark)
        self._trade.changed(self._simulation, mark)
        self._hands.undo.trim(self._trade.bytes_of_moments)
        self._trade.forget_all_but(self._hands.undo.numbers)
        self._collisions.forget_all_but((SNAPSHOT, *self._hands.undo.numbers))
        self._broadcast.tell_if_new("hands", self._hands.told(self._simulation))
        self._tell_link()

    # --- time

    def _show_pass(self) -> None:
        """Show the next pass of the next frame. With its last pass, the frame is run."""
        self._playing, self._steps = False, 0
        sim = self._demand_simulation("pass")
        try:
            shown = self._passes.next(sim)
        except InputError:
            if not self._owned or (offer := self._passes.offer(sim)) is None:
                raise
            self._tell()
            self._broadcast.tell("pass", offer)
            return
        if self._passes.is_last:
            self._run_frames(1)
            self._passes.demand_end(sim.digest())
        else:
            self._shown = self._run, sim.frame, sim.count
            discs = in_place(shown.state, self.scene.box, sim.frame, sim.time, sim.radii)
            self._broadcast.show_in_place(discs, second=self._trade.shown())
        self._tell()
        self._broadcast.tell_if_new("pass", self._passes.told())

    def _close_passes(self) -> None:
        """Show the simulation itself again, instead of a pass of its next frame."""
        if self._passes.is_open:
            self._passes.close()
            self._shown = None
            self._broadcast.tell_if_new("pass", self._passes.told())

    def _remember(self) -> None:
        """Remember this moment, which replaces the one remembered before."""
        sim = self._demand_simulation("snapshot")
        self._demand_scene("snapshot")
        self._moments.keep(SNAPSHOT, sim)
        self._snapshot = sim.frame
        self._collisions.mark(SNAPSHOT)
        self._trade.remember()
        self._tell()

    def _forget_moment(self) -> None:
        """Forget the remembered moment."""
        self._moments.forget(SNAPSHOT)
        self._snapshot = None

    def _go_back(self) -> None:
        """Go back to the remembered moment. The history of undo starts afresh there."""
        self._sim = sim = self._moments.back(SNAPSHOT, self._demand_simulation("return"))
        self._steps = 0
        self._hands.begin(sim)
        self._collisions.back(SNAPSHOT)
        self._trade.back(SNAPSHOT)
        self._broadcast.forget_radii()
        self._changed()
        self._resume()

    def _choose(self, action: wire.Action) -> None:
        """Restart with another initial state, another second stage, or other settings."""
        self._demand_scene(action.name)
        values = action.values
        match action.name:
            case "found" if values["number"] != self._tuning.number:
                return  # that search was cancelled meanwhile
            case "seed":
                self._tuning.stop()  # it searches for another initial state
                self._seed = values["value"]
                self._show_scene(self._given.redrawn(self._seed) if self._seed else self._given)
            case "beside":
                self._trade.choose(values["settings"])
            case "open":
                self._take(values["link"])
                self._tuning.stop()
                self._forget_own_colours()
            case "grid":
                self._tuning.stop()
                self._settings = dataclasses.replace(self._settings, method="grid", workers=None)
            case _:  # found
                self._settings = values["settings"]
                self._trade.fit(self._settings.dt)
        self._broadcast.tell_if_new("tune", self._tuning.told())
        self._steps = 0
        if action.name == "open":
            self._open()
        else:
            self._begin()
        self._tell_scene("playing" if self._playing else "paused")
        if action.name == "grid":
            self._show_pass()

    def _search(self, action: wire.Action) -> None:
        """Start or stop a search for settings, or report its progress."""
        self._demand_scene(action.name)
        if action.name == "tune":
            self._tuning.start(self.scene, {action.values["measure"]: action.values["budget"]})
        elif action.name == "stop_tuning":
            self._tuning.stop()
        self._broadcast.tell_if_new("tune", self._tuning.told())

    def _found(self, number: int, settings: Settings) -> None:
        """Submit settings that the search has found, so that they are applied. Called by the thread of the search."""
        self.submit(wire.Action("found", {"number": number, "settings": settings}))

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

    # --- how it runs

    @abstractmethod
    def _begin(self) -> None:
        """Begin at the start of the scene, or at the present frame of a given simulation."""

    @abstractmethod
    def _resume(self) -> None:
        """Start the clocks afresh: the time before now does not count."""

    @abstractmethod
    def _run_frames(self, frames: int) -> None:
        """Run this number of frames."""

    @abstractmethod
    def _show_more(self, action: wire.Action) -> None:
        """Switch the counting of pressure and overlap, or the quantity that the colours show."""

    @abstractmethod
    def _forget_own_colours(self) -> None:
        """Colour discs by speed: the numbers from the user's program belong to another scene."""

    @abstractmethod
    def _renew_gauges(self) -> None:
        """Measure the energy drift from now on: the simulation was changed at this frame."""

    @abstractmethod
    def _tell(self) -> None:
        """Send the present status to the pages."""

    @abstractmethod
    def _tell_scene(self, phase: str) -> None:
        """Send the description of what is shown to the pages."""


def _checked(settings: Settings | None, sim: Simulation | None, scene: Scene) -> Settings:
    """The settings to run with.

    Raises:
        InputError: if settings are given with a simulation, which has its own, or need several ranks.
    """
    if sim is not None and settings is not None:
        raise InputError(
            "settings can be given only with a scene; got them with a simulation, which has its own. Leave them out."
        )
    return demand_one_process(sim.settings if sim is not None else settings_for(scene, settings))


def _demand_owned(beside: Settings | None, owned: bool) -> Settings | None:
    """Settings of a second stage, unchanged.

    Raises:
        InputError: if they are given with a simulation, whose initial state is not known, or need several ranks.
    """
    if beside is not None and not owned:
        raise InputError(
            "beside needs a scene, from which both stages start; got it with a simulation. Open the view with its "
            "scene."
        )
    return None if beside is None else demand_one_process(beside)
