"""Base of all sources of pictures: a thread with an inbox of actions.

The thread never waits for a page. A picture is made when somebody has asked for one (`ask`); who is slow asks less
often. While nobody watches, nothing runs and nothing is made.

    pages      submit, ask, watched_by  -->  inbox  -->  the thread: _open, then _do, _advance, _rest again and again
    pages  <--  Broadcast  <--------------------------------------------'
"""

import contextlib
import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future

from mpsim.core.errors import InputError, MpsimError
from mpsim.scene.scene import Scene
from mpsim.viewer import keep, wire
from mpsim.viewer.broadcast import Audience, Broadcast

MOST_WAITING = 1000
"""Actions of one page, or of the program, that wait for their turn at most."""

REPLACING = ("play", "pause", "speed", "reset", "hold", "searching")
"""Actions of which the last one counts, if several follow each other while frames are run; of "hold", for each disc."""

CLOSING_SECONDS = 10.0
"""Time that `close` waits for the thread: longer than any frames, but not than all that may have to be compiled."""

SIGNAL_SECONDS = 0.5
"""Longest time between a signal that did not wake `wait` and its handler."""


class Source(ABC):
    """Something that pages show and control.

    Args:
        scene: whose discs it shows, as it was at the start.
        audience: the pages.

    Attributes:
        scene: as given.
        error: what ended it, if it ended by an error.
    """

    def __init__(self, scene: Scene, audience: Audience):
        self.scene: Scene = scene
        self.error: BaseException | None = None
        self._wake = threading.Condition()
        self._actions: deque[tuple[object, wire.Action]] = deque()  # each with its sender
        self._asked = self._closing = False
        self._watching = 0
        self._charged = 0.0  # processor time of sending [s]
        self._thread = threading.Thread(target=self._live, name="mpsim view: simulation", daemon=True)
        self._ended = threading.Event()
        # of the thread alone
        self._broadcast = Broadcast(audience, scene)

    # --- called by other threads

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def submit(self, action: wire.Action, sender: object = None) -> None:
        """Have an action done, soon; sender: the page that asks for it, None: the program.

        Raises:
            InputError: if too many of the sender wait already.
        """
        with self._wake:
            if action.name in REPLACING:
                self._forget_replaced(action, sender)
            if sum(each is sender for each, _ in self._actions) >= MOST_WAITING:
                raise InputError(f"at most {MOST_WAITING} actions may wait; got one more, {action.name}. Wait.")
            self._actions.append((sender, action))
            self._wake.notify()

    def forget(self, sender: object) -> None:
        """Do nothing of what a sender has asked for and still waits."""
        with self._wake:
            self._actions = deque(waiting for waiting in self._actions if waiting[0] is not sender)

    def _forget_replaced(self, action: wire.Action, sender: object) -> None:
        """Forget the sender's action that this one replaces, if none of another kind has come between."""
        for k in reversed(range(len(self._actions))):
            who, waiting = self._actions[k]
            if who is not sender or waiting.name != action.name:
                return
            if waiting.values.get("id") == action.values.get("id"):
                del self._actions[k]
                return

    def keep(self, what: str) -> "Future[keep.Kept]":
        """Have a file made of what is shown, soon; what: its name among `keep.KEEPING`.

        Raises:
            InputError: as `submit`.
        """
        answer: Future[keep.Kept] = Future()
        self.submit(wire.Action("keep", {"what": what, "answer": answer}))
        return answer

    def ask(self) -> None:
        """Ask for the next picture: the first one that is not the last one."""
        with self._wake:
            self._asked = True
            self._wake.notify()

    def charge(self, seconds: float) -> None:
        """Say how much processor time sending has taken since the last time [s]."""
        with self._wake:
            self._charged += seconds

    def watched_by(self, pages: int) -> None:
        """Say how many pages are watching now."""
        with self._wake:
            self._watching = pages
            self._wake.notify()

    def wait(self, seconds: float | None = None) -> bool:
        """Wait for the end, at most so long; returns whether it has ended.

        Python runs handlers of signals in the main thread. A signal that another thread received, or that came while
        this one was about to sleep, does not wake it. So it wakes by itself.
        """
        if seconds is not None:
            return self._ended.wait(seconds)
        while not self._ended.wait(SIGNAL_SECONDS):
            pass
        return True

    def close(self) -> None:
        """End the thread, after what it does just now, and release what is its own."""
        with self._wake:
            self._closing = True
            self._wake.notify()
        if self._thread.ident is not None:
            self._thread.join(CLOSING_SECONDS)

    # --- the thread

    def _show_scene(self, scene: Scene) -> None:
        """Show another scene with the same box from now on."""
        self.scene = self._broadcast.scene = scene

    def _live(self) -> None:
        try:
            self._open()
            while self._turn():
                pass
        except BaseException as error:  # raised by whoever waits for the end
            self.error = error
            self._stopped_by(error)
        finally:
            self._release()
            self._ended.set()

    def _turn(self) -> bool:
        """Do what is asked for, go on, then wait for more. Returns whether to go on."""
        with self._wake:
            actions, closing, watching = [action for _, action in self._actions], self._closing, self._watching
            self._actions.clear()
        if closing:
            return False
        for action in actions:
            with self._noted():
                self._do(action)
        if watching:
            with self._noted():
                self._advance()
        self._rest()
        return True

    @contextlib.contextmanager
    def _noted(self) -> Iterator[None]:
        """An error of mpsim pauses and is shown on the page; it does not end the thread."""
        try:
            yield
        except MpsimError as error:
            self._refused(error)

    def _rest(self) -> None:
        """Wait until something is due or asked for."""
        with self._wake:
            if self._actions or self._closing:
                return
            seconds = self._seconds_to_next() if self._watching else None
            if seconds is None or seconds > 0:
                self._wake.wait(seconds)

    # --- what each kind of source does in the thread

    @abstractmethod
    def _open(self) -> None:
        """Begin; whatever it raises ends the thread."""

    @abstractmethod
    def _do(self, action: wire.Action) -> None:
        """Do what a page asks for.

        Raises:
            InputError: if it cannot be done here.
        """

    @abstractmethod
    def _advance(self) -> None:
        """Run what is due, and send what is asked for. Called again and again while somebody watches."""

    @abstractmethod
    def _seconds_to_next(self) -> float | None:
        """Time until something is due; None: nothing is, until somebody says something. Called with the lock held."""

    @abstractmethod
    def _refused(self, error: MpsimError) -> None:
        """Pause, and say why on the page."""

    @abstractmethod
    def _stopped_by(self, error: BaseException) -> None:
        """Say on the page what has ended it."""

    @abstractmethod
    def _release(self) -> None:
        """Close what is its own. Must not raise."""
