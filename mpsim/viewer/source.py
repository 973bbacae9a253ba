"""Base class of all sources of pictures: a thread with an inbox of actions, and its line while it compiles."""

import contextlib
import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import ExitStack, contextmanager

from mpsim.errors import InputError, MpsimError
from mpsim.kernels.compiling import Announcer, announced_by
from mpsim.scene.scene import Scene
from mpsim.viewer import keep, wire
from mpsim.viewer.broadcast import Audience, Broadcast

# --- The line on all pages while kernels are compiled: at the start, or later, as for the first disc that is removed

Tell = Callable[[str | None], None]
"""Takes what is being compiled, or None at the end of it. Called by any thread; must return at once."""


class Listeners:
    """Announces compilation to several listeners, and to the announcer before it.

    As the compiler is one for the process, all are notified of what any of them waits for.

    >>> heard, listeners = [], Listeners()
    >>> with listeners.notifying(heard.append):
    ...     listeners.begin("compiling a small kernel (move), once")
    ...     listeners.end()
    >>> heard
    ['compiling a small kernel (move), once', None]
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._tells: list[Tell] = []
        self._before: Announcer | None = None
        self._installed = ExitStack()
        self._under_way = 0

    @contextmanager
    def notifying(self, tell: Tell) -> Iterator[None]:
        """Notify a listener of what is compiled in this block. Blocks of several threads may end in any order."""
        with self._lock:
            if not self._tells:
                self._before = self._installed.enter_context(announced_by(self))
            self._tells.append(tell)
        try:
            yield
        finally:
            with self._lock:
                self._tells.remove(tell)
                if not self._tells:
                    self._installed.close()

    def begin(self, text: str) -> None:
        """Say what is being compiled."""
        if self._before is not None:
            self._before.begin(text)
        with self._lock:
            self._under_way += 1
            self._tell(text)

    def end(self) -> None:
        """One compilation has ended; others may be under way."""
        if self._before is not None:
            self._before.end()
        with self._lock:
            self._under_way -= 1
            if not self._under_way:
                self._tell(None)

    def _tell(self, text: str | None) -> None:
        for tell in self._tells:
            tell(text)


LISTENERS = Listeners()
"""Those of this process."""


# --- Base class of all sources of pictures: a thread with an inbox of actions
#
# The thread never waits for a page. A picture is made only on request (`ask`); a slow page asks less often. While no
# page is visible, nothing runs.
#
#     pages      submit, ask, watched_by  -->  inbox  -->  the thread: _open, then _do, _advance, _rest again and again
#     pages  <--  Broadcast  <--------------------------------------------'

MOST_WAITING = 1000
"""Largest number of waiting actions of one page, or of the program."""

REPLACING = ("play", "pause", "speed", "reset", "hold", "searching")
"""Actions that replace a waiting one of the same name, if no other action came between; "hold" for each disc."""

CLOSING_SECONDS = 10.0
"""Longest time that `close` waits for the thread [s]. Frames take less; compiling kernels may take longer."""

SIGNAL_SECONDS = 0.5
"""Longest time until a signal is handled that did not wake `wait` [s]."""


class Source(ABC):
    """Something that pages show and control.

    Args:
        scene: scene that it shows, as at the start.
        audience: the pages.

    Attributes:
        scene: as given.
        error: the error that ended it, if any.
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
        """Start the thread, unless it was started before."""
        if self._thread.ident is None:
            self._thread.start()

    def submit(self, action: wire.Action, sender: object = None) -> None:
        """Put an action into the inbox; sender: the page that has sent it, None: the program.

        Raises:
            InputError: if too many actions of this sender are waiting.
        """
        with self._wake:
            if action.name in REPLACING:
                self._forget_replaced(action, sender)
            if sum(each is sender for each, _ in self._actions) >= MOST_WAITING:
                raise InputError(f"at most {MOST_WAITING} actions may wait; got one more, {action.name}. Wait.")
            self._actions.append((sender, action))
            self._wake.notify()

    def forget(self, sender: object) -> None:
        """Drop the waiting actions of a sender."""
        with self._wake:
            self._actions = deque(waiting for waiting in self._actions if waiting[0] is not sender)

    def _forget_replaced(self, action: wire.Action, sender: object) -> None:
        """Remove the waiting action that this one replaces, unless another action came between."""
        for k in reversed(range(len(self._actions))):
            who, waiting = self._actions[k]
            if who is not sender or waiting.name != action.name:
                return
            if waiting.values.get("id") == action.values.get("id"):
                del self._actions[k]
                return

    def keep(self, what: str) -> "Future[keep.Kept]":
        """Request a file of what is shown; what: its name among `keep.KEEPING`.

        Raises:
            InputError: as `submit`.
        """
        answer: Future[keep.Kept] = Future()
        self.submit(wire.Action("keep", {"what": what, "answer": answer}))
        return answer

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
        """Wait for the end, at most so many seconds; returns whether it has ended.

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

    def _show_scene(self, scene: Scene) -> None:
        """Show another scene with the same box."""
        self.scene = self._broadcast.scene = scene

    def _live(self) -> None:
        try:
            with LISTENERS.notifying(self._tell_compiling):
                self._open()
                while self._turn():
                    pass
        except BaseException as error:  # `View.wait` raises it again
            self.error = error
            self._stopped_by(error)
        finally:
            self._release()
            self._ended.set()

    def _tell_compiling(self, text: str | None) -> None:
        """Tell what is being compiled; None: nothing any more. Called by other threads."""
        self._broadcast.tell("compiling", {"text": text})

    def _turn(self) -> bool:
        """Do the waiting actions, advance, then wait for more. Returns whether to continue."""
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
        """Turn an error of mpsim into a pause and a message on the page, so that it does not end the thread."""
        try:
            yield
        except MpsimError as error:
            self._refused(error)

    def _rest(self) -> None:
        """Wait until something is due or requested."""
        with self._wake:
            if self._actions or self._closing:
                return
            seconds = self._seconds_to_next() if self._watching else None
            if seconds is None or seconds > 0:
                self._wake.wait(seconds)

    # --- what each kind of source does in the thread

    @abstractmethod
    def _open(self) -> None:
        """Begin. An exception ends the thread."""

    @abstractmethod
    def _do(self, action: wire.Action) -> None:
        """Do an action that a page has sent.

        Raises:
            InputError: if this source cannot do it.
        """

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
    def _stopped_by(self, error: BaseException) -> None:
        """Show on the page which error ended the thread."""

    @abstractmethod
    def _release(self) -> None:
        """Release what this source owns. Must not raise."""
