"""A simulation that is watched: it runs in a thread of its own, obeys the deeds of pages, and hands out pictures.

The thread never waits for a page. A picture is made when somebody has asked for one (`ask`), from the state between two
frames, and handed to the audience; who is slow asks less often. While nobody watches, nothing runs and nothing is made.
"""

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mpsim.core.errors import ClosedError, InputError, MpsimError
from mpsim.core.state import State
from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings
from mpsim.viewer import keep, wire
from mpsim.viewer.colours import SpeedScale, scale_of
from mpsim.viewer.gauges import Gauges, Meter
from mpsim.viewer.hands import Hands
from mpsim.viewer.pace import LOOK, Pace

PICTURE_SECONDS = 0.8 * LOOK
"""Shortest time between two pictures: a little less than between two looks, or every other one would come too early."""

GAUGE_SECONDS = 0.4
"""Shortest time between two readings of the gauges."""

PICTURE_SHARE, GAUGE_SHARE = 1 / 50, 1 / 200
"""Largest part of its time that pictures and gauges take from a simulation that runs as fast as it goes ..."""

LONGEST_WAIT = 0.5
"""... but for very many discs, of which there is a picture after so many seconds at the latest."""

MOST_WAITING = 1000
"""Deeds that wait for their turn at most."""

REPLACING = ("play", "pause", "speed", "reset", "hold")
"""Deeds of which the last one counts, if several follow each other while frames are run."""

CLOSING_SECONDS = 10.0
"""Time that `close` waits for the thread: longer than any frames, but not than all that may have to be compiled."""

LOOK_SECONDS = 0.1
"""Time between two looks at a simulation that the program itself may be running."""


class Audience(Protocol):
    """Who is shown the simulation. Called by the thread of the session; must return at once."""

    def show(self, picture: "Shown") -> None:
        """Take a picture, in place of those before."""
        ...

    def tell(self, kind: str, text: str) -> None:
        """Take a message for all pages, in place of the one of this kind before."""
        ...


@dataclass(frozen=True)
class Shown:
    """A picture for pages.

    Attributes:
        serial: its number, from 1.
        packed: `wire.pack`.
        radii: `wire.pack_radii` of its discs, the same object as long as these are.
    """

    serial: int
    packed: bytes | bytearray
    radii: bytes


class Session:
    """One simulation, or a scene that is simulated again and again.

    Args:
        source: a scene, whose simulations the session makes and closes; or a simulation, which stays its owner's.
        settings: of the scene's simulations; None: the defaults.
        name: what it is called on the page.
        playing: whether it begins as soon as somebody watches.
        audience: who is shown it.

    Attributes:
        error: what ended the session, if it ended by an error.
    """

    def __init__(
        self,
        source: Scene | Simulation,
        settings: Settings | None = None,
        *,
        name: str = "",
        playing: bool = True,
        audience: Audience,
    ):
        self._owned = isinstance(source, Scene)
        self._sim = None if isinstance(source, Scene) else source
        self._scene: Scene = source if isinstance(source, Scene) else source.scene
        self._settings = _checked(settings, self._sim)
        self._name = name
        self._audience = audience
        self.error: BaseException | None = None
        self._wake = threading.Condition()
        self._deeds: deque[wire.Deed] = deque()
        self._asked = self._closing = False
        self._watching = 0
        self._thread = threading.Thread(target=self._live, name="mpsim view: simulation", daemon=True)
        self._ended = threading.Event()
        # of the thread alone
        self._playing = playing
        self._steps = 0
        self._note: str | None = None
        self._pace = Pace()
        self._meter = Meter(time.perf_counter())
        self._gauges: Gauges | None = None
        self._scale = SpeedScale(1.0, 2.0)
        self._over = True  # until there is one
        self._run = self._serial = 0
        self._last: tuple[int, int, int] | None = None  # run, frame and count that were looked at, ...
        self._shown: tuple[int, int, int] | None = None  # ... that the last picture shows, ...
        self._gauged: tuple[int, int, int] | None = None  # ... and that the gauges are of
        self._next_picture = self._next_gauges = 0.0
        self._radii: tuple[NDArray[np.float64], bytes] | None = None
        self._hands = Hands(self._owned)

    # --- called by other threads

    @property
    def scene(self) -> Scene:
        """What is shown, as it was at the start."""
        return self._scene

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def obey(self, deed: wire.Deed) -> None:
        """Have a deed done, soon.

        Raises:
            InputError: if too many wait already.
        """
        with self._wake:
            if self._deeds and deed.name in REPLACING and self._deeds[-1].name == deed.name:
                self._deeds.pop()
            if len(self._deeds) >= MOST_WAITING:
                raise InputError(f"at most {MOST_WAITING} deeds may wait; got one more, {deed.name}. Wait.")
            self._deeds.append(deed)
            self._wake.notify()

    def keep(self, what: str) -> "Future[keep.Kept]":
        """Have a file made of the simulation, soon; what: its name among `keep.KEEPING`.

        Raises:
            InputError: as `obey`.
        """
        answer: Future[keep.Kept] = Future()
        self.obey(wire.Deed("keep", {"what": what, "answer": answer}))
        return answer

    def ask(self) -> None:
        """Ask for the next picture: the first one that is not the last one."""
        with self._wake:
            self._asked = True
            self._wake.notify()

    def watched_by(self, pages: int) -> None:
        """Say how many pages are watching now."""
        with self._wake:
            self._watching = pages
            self._wake.notify()

    def wait(self, seconds: float | None = None) -> bool:
        """Wait for the end of the session, at most so long; returns whether it has ended."""
        return self._ended.wait(seconds)

    def close(self) -> None:
        """End the thread, after the frames that it runs; simulations of a scene are closed."""
        with self._wake:
            self._closing = True
            self._wake.notify()
        if self._thread.ident is not None:
            self._thread.join(CLOSING_SECONDS)

    # --- the thread

    def _live(self) -> None:
        try:
            self._tell_scene("starting")
            if self._owned:
                start = State(self._scene.position, self._scene.velocity, box=self._scene.box)
                self._scale = scale_of(start)
                self._show(start, 0, 0.0)  # before anything is compiled
            self._begin()
            while self._turn():
                pass
        except BaseException as error:  # raised by whoever waits for the end
            self.error, self._over, self._note = error, True, str(error) or type(error).__name__
            self._tell()
        finally:
            with contextlib.suppress(Exception):  # the first error counts
                self._drop()
            with contextlib.suppress(OSError):
                self._hands.close()
            self._ended.set()

    def _drop(self) -> None:
        """Close a simulation of one's own."""
        if self._owned and self._sim is not None:
            self._sim.close()
            self._sim = None

    def _begin(self) -> None:
        """Begin at the start of the scene, or where the given simulation is."""
        self._drop()
        if self._owned:
            self._sim = Simulation(self._scene, self._settings)
        assert self._sim is not None
        state = self._sim.state
        self._gauges, self._scale = Gauges(self._scene, state), scale_of(state)
        self._run += 1
        self._radii = self._shown = self._gauged = None
        self._over = False
        self._hands.begin(self._sim)
        self._resume()
        self._hands.tell(self._sim, self._audience.tell)

    def _resume(self) -> None:
        """Begin to run from now on: the time before does not count."""
        now = time.perf_counter()
        self._pace.start(now)
        self._meter.start(now)
        self._note = None
        self._tell()

    def _turn(self) -> bool:
        """Do what is asked for, run some frames, make a picture; then wait for more. Returns whether to go on."""
        with self._wake:
            deeds, closing, watching = list(self._deeds), self._closing, self._watching
            self._deeds.clear()
        if closing:
            return False
        for deed in deeds:
            with self._noted():
                self._do(deed)
        with self._noted():
            if watching and not self._over:
                self._advance()
                self._look()
        self._rest()
        return True

    @contextlib.contextmanager
    def _noted(self) -> Iterator[None]:
        """An error of mpsim pauses the simulation and is shown on the page; it does not end the session."""
        try:
            yield
        except MpsimError as error:
            self._playing, self._steps, self._note, self._over = False, 0, str(error), self._is_over()
            self._tell()

    def _is_over(self) -> bool:
        """Whether there is no simulation any more that could run on."""
        try:
            return self._sim is None or self._sim.count < 0
        except ClosedError:
            return True

    def _do(self, deed: wire.Deed) -> None:
        match deed.name:
            case "play":
                self._playing = True
                self._resume()
            case "pause":
                self._playing, self._steps = False, 0
                self._tell()
            case "step":
                self._playing, self._steps = False, min(self._steps + deed.values["frames"], wire.MOST_STEPS)
                self._resume()
            case "speed":
                self._pace.speed = deed.values["value"]
                self._resume()
            case "reset":
                if not self._owned:
                    raise InputError(
                        "reset needs a scene to start from; this view shows a simulation that belongs to a program. "
                        "Open the view with its scene."
                    )
                self._steps = 0
                self._begin()
            case "keep":
                keep.answer(None if self._over else self._sim, self._name, **deed.values)
            case "hold" | "release" | "add" | "remove" | "change" | "undo":
                self._by_hand(deed)
            case name:
                raise InputError(f"a simulation cannot {name}. Send it to the server.")

    def _by_hand(self, deed: wire.Deed) -> None:
        """Do what people do to the discs; a refusal is told beside, and stops nothing."""
        if self._over:
            raise InputError(f"{deed.name} needs a simulation; this one has ended. Reset it.")
        if deed.name == "undo":
            self._radii = None
        self._sim = self._hands.do(self._simulation, deed, time.perf_counter())
        self._changed()

    def _changed(self) -> None:
        """Note that the simulation is another than it was at this frame: energies count from now on."""
        self._run += 1
        self._gauges = None
        self._hands.tell(self._simulation, self._audience.tell)

    def _advance(self) -> None:
        """Run the frames that are due."""
        frames = self._pace.due(time.perf_counter()) if self._playing else min(self._steps, 1)
        if not frames:
            return
        if self._hands.hold_still(self._simulation, time.perf_counter()):
            self._changed()
        report = self._simulation.run(frames=frames, observe=_Glance(self._pace.frames_between_looks, self._look))
        self._pace.note(frames, float(report.frame_seconds.sum()))
        self._meter.note(report)
        if self._steps:
            self._steps -= frames

    @property
    def _simulation(self) -> Simulation:
        assert self._sim is not None  # or it is over
        return self._sim

    def _look(self) -> None:
        """Make the picture and the gauges that are due, if the simulation has moved since the last ones."""
        sim, now = self._simulation, time.perf_counter()
        where = self._last = (self._run, sim.frame, sim.count)
        gauges = now >= self._next_gauges and where != self._gauged
        with self._wake:
            picture = self._asked and now >= self._next_picture and where != self._shown
        if not gauges and not picture:
            return
        frame, moment, state = (sim.frame, sim.time, sim.state) if self._owned else _now(sim)
        if gauges:
            spent = time.thread_time()
            self._gauged = where
            self._tell_gauges(state, frame, moment)
            self._next_gauges = now + max(GAUGE_SECONDS, (time.thread_time() - spent) / GAUGE_SHARE)
        if picture:
            now, spent = time.perf_counter(), time.thread_time()
            with self._wake:
                self._asked = False
            self._shown = where
            self._show(state, frame, moment)
            self._next_picture = now + max(PICTURE_SECONDS, self._fair_wait(time.thread_time() - spent))

    def _fair_wait(self, took: float) -> float:
        """Time to the next picture after one that took so much processor time, so as not to slow down the run [s]."""
        at_full_speed = self._playing and self._pace.speed is None  # else it has time left
        return min(took / PICTURE_SHARE, LONGEST_WAIT) if at_full_speed else 0.0

    def _rest(self) -> None:
        """Wait until something is due or asked for."""
        with self._wake:
            if self._deeds or self._closing:
                return
            seconds = self._seconds_to_next()
            if seconds is None or seconds > 0:
                self._wake.wait(seconds)

    def _seconds_to_next(self) -> float | None:
        """Time until something is due; None: nothing is, until somebody says something."""
        if not self._watching or self._over:
            return None
        if self._steps:
            return 0.0
        now, due = time.perf_counter(), list[float]()
        if self._playing:
            due.append(self._pace.wait(now))
        if not self._owned:
            due.append(LOOK_SECONDS)
        if self._last != self._gauged:
            due.append(max(self._next_gauges - now, 0.0))
        if self._asked and self._last != self._shown:
            due.append(max(self._next_picture - now, 0.0))
        return min(due, default=None)

    # --- what pages are shown and told

    def _show(self, state: State, frame: int, moment: float) -> None:
        self._serial += 1
        scene = self._scene
        walls = scene.box if state.box is None else state.box
        header = wire.Header(self._serial, frame, moment, walls, (scene.width, scene.height), self._scale)
        radii = scene.radii if self._sim is None else self._sim.radii
        if self._radii is None or len(self._radii[0]) != len(state.position):
            self._radii = radii, wire.pack_radii(radii, header)
        self._audience.show(Shown(self._serial, wire.pack(header, state), self._radii[1]))

    def _tell_scene(self, phase: str) -> None:
        """Tell what is shown: what stays the same as long as the session."""
        scene = self._scene
        wall = scene.moving_wall
        fixed = {
            "version": wire.VERSION,
            "name": self._name,
            "width": scene.width,
            "height": scene.height,
            "periodic": list(scene.periodic),
            "capsules": scene.capsules.tolist(),
            "wall": None if wall is None else wall.edge,
            "method": self._settings.method,
            "dt": self._settings.dt,
            "can_reset": self._owned,
            "command": keep.command(scene, self._settings, self._name) if self._owned else None,
        }
        self._audience.tell("scene", wire.text_of("scene", fixed))
        self._audience.tell("status", self._status(phase))

    def _tell(self) -> None:
        """Tell what the session does now."""
        self._audience.tell("status", self._status("over" if self._over else "playing" if self._playing else "paused"))

    def _status(self, phase: str) -> str:
        return wire.text_of("status", {"phase": phase, "speed": self._pace.speed, "note": self._note})

    def _tell_gauges(self, state: State, frame: int, moment: float) -> None:
        if self._gauges is None:  # something has been changed
            self._gauges = Gauges(self._simulation.scene, state)
        self._scale = scale_of(state)
        numbers = self._gauges.of(state)
        rates = self._meter.read(numbers["discs"], time.perf_counter())
        text = wire.text_of("gauges", {"frame": frame, "time": moment, **numbers, **vars(rates)})
        self._audience.tell("gauges", text)


class _Glance:
    """Looks at a run on its way, as an observer."""

    def __init__(self, every: int, act: Callable[[], None]):
        self.every: int = every
        self._act = act

    def look(self, sim: Simulation, collisions: int) -> None:
        """Look."""
        self._act()


def _now(sim: Simulation) -> tuple[int, float, State]:
    """Frame, time and state of a simulation that another thread of the program may be running.

    Where that is quick, the state may be one of a few frames later.
    """
    frame, moment, state = sim.frame, sim.time, sim.state
    for _ in range(3):
        if sim.frame == frame:
            break
        frame, moment, state = sim.frame, sim.time, sim.state
    return frame, moment, state


def _checked(settings: Settings | None, sim: Simulation | None) -> Settings:
    """The settings to run with.

    Raises:
        InputError: for settings beside a simulation, which has its own, and for ranks.
    """
    if sim is not None and settings is not None:
        raise InputError("settings go with a scene; got them beside a simulation, which has its own. Leave them out.")
    found = sim.settings if sim is not None else settings or Settings()
    if capabilities_of(found).on_ranks:
        raise InputError(
            f"a view runs in one process; got method {found.method!r}, which runs on ranks. Use method='grid', which "
            "has the same bits."
        )
    return found
