"""Actions with which pages control a simulation: play, change, go back, restart, show a frame pass by pass."""

import contextlib
import dataclasses
import time
from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers.base import in_place
from mpsim.errors import ClosedError, InputError
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings, frames_between_pictures, settings_for
from mpsim.viewer import keep, link, wire
from mpsim.viewer.broadcast import Audience
from mpsim.viewer.gauges import CollisionCount
from mpsim.viewer.hands import Hands
from mpsim.viewer.link import Link
from mpsim.viewer.pace import Pace, first_speed
from mpsim.viewer.pair import SNAPSHOT
from mpsim.viewer.passes import PassView
from mpsim.viewer.source import Source
from mpsim.viewer.trading import Trade, Tuning, demand_one_process
from mpsim.viewer.undo import Moments

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
