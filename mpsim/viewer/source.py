"""Base class of all sources of pictures: a thread with an inbox of actions, and the clocks of its work."""

import math
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from mpsim.core import checks
from mpsim.core.state import State
from mpsim.errors import InputError, MpsimError
from mpsim.kernels.compiling import announcing
from mpsim.scene.scene import Scene
from mpsim.viewer import export
from mpsim.viewer.gauges import Gauges
from mpsim.viewer.protocol import COMMANDS, Action, Broadcast, Command, scale_of, whole

if TYPE_CHECKING:
    from mpsim.viewer.server import Pages

# --- When frames are due, and how much time repeated work may take

UNIT = 60.0  # frames a second at speed 1: one for each picture of a usual screen
LOOK = 1 / 60  # shortest time between two observations of a run [s]. Each interrupts the run, which costs 0.3 ms
PICTURE_SECONDS = 0.8 * LOOK  # shortest time between two pictures [s]: with LOOK every other observation came too early
GAUGE_SECONDS = 0.4  # shortest time between two readings of the gauges [s]
TURN = 3 * LOOK  # longest time for which frames are run at once [s], and so the longest wait of an action
MOST_BEHIND = 0.1  # largest delay that a simulation catches up [s]. After a longer stop, the missed frames are dropped
MOST_FRAMES = 10_000  # largest number of frames to run at once, however short they are
SPEEDS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100)  # of the page, as in its connection.js
SLOWEST, QUICKEST = 0.01, 1000.0  # bounds of the speed, in units of UNIT frames a second
PICTURES = 25  # recommended pictures of a scene that are shown per second


def first_speed(every: int | None) -> float:
    """The speed at which a scene is first shown: one that the page offers, in units of UNIT frames a second.

    every: frames between two recommended pictures of the scene; None: it recommends none.
    """
    wanted = 1.0 if every is None else every * PICTURES / UNIT
    return float(max((speed for speed in SPEEDS if speed <= wanted), default=SPEEDS[0]))


class FrameRate:
    """Decides which frames are due. All times are from one clock [s].

    Attributes:
        speed: in units of UNIT frames a second; None: as fast as possible.
        look: time between two observations of a run, from LOOK to TURN [s].
    """

    def __init__(self) -> None:
        self.speed: float | None = 1.0
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
        """Number of frames that fit into `look`: a power of two, so that it rarely changes."""
        return 1 << (self._fitting(self.look).bit_length() - 1)

    def note(self, frames: int, seconds: float) -> None:
        """Note how long some frames took [s]."""
        self._seconds_per_frame = max(seconds / frames, 1e-9)

    def _fitting(self, seconds: float) -> int:
        if self._seconds_per_frame is None:
            return 1
        return min(max(int(seconds / self._seconds_per_frame), 1), MOST_FRAMES)


class TimeBudget:
    """Limits the fraction of a core that repeated work takes, by a pause after each use. Times are from one clock [s].

    Args:
        at_least: shortest time between two uses [s].

    Attributes:
        done: the moment of the simulation for which it was used last.
    """

    def __init__(self, at_least: float):
        self.done: object = None
        self._at_least = at_least
        self._last = -math.inf
        self._cost = 0.0  # of the last use [s]

    def use(self, act: Callable[[], None], moment: object, now: float) -> None:
        """Do something for a moment of the simulation, and note its cost."""
        self.done, spent = moment, time.thread_time()
        act()
        self._last, self._cost = now, time.thread_time() - spent

    def charge(self, cost: float) -> None:
        """Add processor time to the cost of the last use [s]."""
        self._cost += cost

    def is_due(self, moment: object, now: float, *limits: float) -> bool:
        """Whether it may be used now, for another moment than the last; limits: as in `wait`."""
        return moment != self.done and not self.wait(now, *limits)

    def wait(self, now: float, share: float = math.inf, at_most: float = math.inf) -> float:
        """Time until the next use, so that the uses take at most a share of a core; 0: now; at_most: of a pause [s]."""
        return max(self._last + min(max(self._cost / share, self._at_least), at_most) - now, 0.0)


# --- Base class of all sources of pictures: a thread with an inbox of actions
#
# The thread never waits for a page. A picture is made only on request (`ask`); a slow page asks less often. While no
# page is visible, nothing runs.
#
#     pages      submit, ask, watched_by  -->  inbox  -->  the thread: _open, then _do, _advance, _rest again and again
#     pages  <--  Broadcast  <--------------------------------------------'

MOST_WAITING = 1000  # largest number of waiting actions of one page, or of the program
MOST_STEPS = 10_000  # largest number of frames in the command `step`

CLOSING_SECONDS = 10.0
"""Longest time that `close` waits for the thread [s]. Frames take less; compiling kernels may take longer."""

SIGNAL_SECONDS = 0.5  # longest time until a signal is handled that did not wake `wait` [s]


class _Waiting(NamedTuple):
    """What waits in the inbox: its sender, its name, the disc that it concerns, if any, and how it is done."""

    sender: object
    name: str
    disc: int | None
    act: Callable[[], None]


def _speed(name: str, value: object) -> float | None:
    return None if value is None else checks.between(name, value, SLOWEST, QUICKEST)


COMMANDS |= {
    "play": Command({}, replaces=True),
    "pause": Command({}, replaces=True),
    "step": Command({"frames": whole(1, MOST_STEPS)}),  # pause, and advance by some frames
    "speed": Command({"value": _speed}, replaces=True),  # as in `FrameRate`
    "reset": Command({}, replaces=True),
}
"""Commands that every source has."""


class Source(ABC):
    """Something that pages show and control. Its methods `do_NAME` carry out the commands of pages."""

    _broadcast: Broadcast  # from `start` on

    def __init__(self, scene: Scene, name: str, playing: bool):
        self.scene: Scene = scene  # as at the start
        self._name = name
        self.error: BaseException | None = None  # which ended it
        self._wake = threading.Condition()
        self._inbox: deque[_Waiting] = deque()
        self._asked = self._closing = False
        self._watching = 0
        self._charged = 0.0  # processor time of sending [s]
        self._thread = threading.Thread(target=self._live, name="mpsim view: simulation", daemon=True)
        self._ended = threading.Event()
        # of the thread alone
        self._playing, self._begun, self._over = playing, False, False
        self._note: str | None = None
        self._rate = FrameRate()
        self._pictures, self._readings = TimeBudget(PICTURE_SECONDS), TimeBudget(GAUGE_SECONDS)

    # --- called by other threads

    def start(self, audience: "Pages") -> None:
        """Start the thread, for these pages."""
        self._broadcast = Broadcast(audience, self.scene)
        self._thread.start()

    def submit(self, action: Action, sender: object) -> None:
        """Put the action of a page into the inbox, or raise InputError if too many of this page are waiting."""
        waiting = _Waiting(sender, action.name, action.values.get("id"), partial(self._do, action))
        self._put(waiting, COMMANDS[action.name].replaces)

    def _put(self, new: _Waiting, replaces: bool = False) -> None:
        """Put something into the inbox; replaces: in place of the same that waits, unless others came between."""
        with self._wake:
            for k in reversed(range(len(self._inbox))) if replaces else ():
                if self._inbox[k][:2] != new[:2]:
                    break
                if self._inbox[k].disc == new.disc:
                    del self._inbox[k]
                    break
            if sum(each.sender is new.sender for each in self._inbox) >= MOST_WAITING:
                raise InputError(f"at most {MOST_WAITING} actions may wait; got one more, {new.name}. Wait.")
            self._inbox.append(new)
            self._wake.notify()

    def forget(self, sender: object) -> None:
        """Drop the waiting actions of a page."""
        with self._wake:
            self._inbox = deque(waiting for waiting in self._inbox if waiting.sender is not sender)

    def export(self, what: str) -> "Future[export.Download]":
        """Request a file of what is shown; what: its name among `export.FILES`. It raises errors as `submit`."""
        made: Future[export.Download] = Future()

        def make() -> None:
            if not made.set_running_or_notify_cancel():
                return
            try:
                made.set_result(self._exported(what))
            except (MpsimError, OSError) as error:
                made.set_exception(error)

        self._put(_Waiting(None, "export", None, make))
        return made

    def ask(self) -> None:
        """Request the next picture, as soon as it differs from the last one."""
        with self._wake:
            self._asked = True
            self._wake.notify()

    def charge(self, seconds: float) -> None:
        """Report the processor time of sending since the last report [s]."""
        with self._wake:
            self._charged += seconds

    def watched_by(self, pages: int) -> None:
        """Report how many pages are watching now."""
        with self._wake:
            self._watching = pages
            self._wake.notify()

    def wait(self, seconds: float | None = None) -> bool:
        """Wait for the end, at most this time [s]; returns whether it has ended.

        Python runs signal handlers in the main thread. A signal does not wake this thread if another thread received
        it, or if it came just before this thread went to sleep. So this thread wakes up regularly.
        """
        if seconds is not None:
            return self._ended.wait(seconds)
        while not self._ended.wait(SIGNAL_SECONDS):
            pass
        return True

    def close(self) -> None:
        """End the thread after its present task, and release what it owns."""
        with self._wake:
            self._closing = True
            self._wake.notify()
        if self._thread.ident is not None:
            self._thread.join(CLOSING_SECONDS)

    # --- the thread

    def _live(self) -> None:
        try:
            with announcing(lambda text: self._broadcast.tell("compiling", {"text": text})):
                self._open()
                while self._turn():
                    pass
        except BaseException as error:  # `View.wait` raises it again
            self.error = error
            self._over, self._note = True, str(error) or type(error).__name__
            self._tell()
        finally:
            self._release()
            self._ended.set()

    def _turn(self) -> bool:
        """Do the waiting actions, advance, then wait for more. Returns whether to continue."""
        with self._wake:
            acts, closing, watching = [waiting.act for waiting in self._inbox], self._closing, self._watching
            self._inbox.clear()
        if closing:
            return False
        for act in [*acts, self._advance] if watching else acts:
            try:
                act()
            except MpsimError as error:
                self._refused(error)
        self._rest()
        return True

    def _do(self, action: Action) -> None:
        """Do the action of a page, or raise InputError if this source cannot do it."""
        act = getattr(self, f"do_{action.name}", None)
        if act is None:
            raise InputError(self.cannot.format(action.name))
        act(**action.values)
        self._resume()

    def do_speed(self, value: float | None) -> None:
        self._rate.speed = value

    def _resume(self) -> None:
        """Start the clock afresh: the time before now does not count."""
        self._rate.start(time.perf_counter())
        self._note, self._begun = None, True
        self._tell()

    def _tell(self) -> None:
        """Send the present status to the pages."""
        self._broadcast.tell_if_new("status", {"phase": self._phase, "speed": self._rate.speed, "note": self._note})

    def _tell_gauges(self, gauges: Gauges, state: State, **more: Any) -> None:
        """Send the measures of a state and more numbers, and fit the scale of speeds to the state."""
        self._broadcast.scale = scale_of(state)
        self._broadcast.tell("gauges", {**more, **gauges.of(state)})

    def _rest(self) -> None:
        with self._wake:
            if self._inbox or self._closing:
                return
            seconds = self._seconds_to_next() if self._watching else None
            if seconds is None or seconds > 0:
                self._wake.wait(seconds)

    @property
    def _phase(self) -> str:
        return "over" if self._over else "starting" if not self._begun else "playing" if self._playing else "paused"

    # --- what each kind of source does in the thread, besides the commands that all have

    cannot: ClassVar[str]  # says that this source has no such command

    @abstractmethod
    def _open(self) -> None:
        """Begin. An exception ends the thread."""

    @abstractmethod
    def _exported(self, what: str) -> "export.Download":
        """A file of what is shown, or an error of mpsim."""

    @abstractmethod
    def _advance(self) -> None:
        """Run the frames that are due, and send what is requested. Called repeatedly while a page is watching."""

    @abstractmethod
    def _seconds_to_next(self) -> float | None:
        """Time until something is due [s]; None: nothing is due before the next action. Called with the lock held."""

    @abstractmethod
    def _refused(self, error: MpsimError) -> None:
        """Pause, and show the reason on the page."""

    @abstractmethod
    def _release(self) -> None:
        """Release what this source owns. Must not raise."""
