"""Plays a recording: play, step, move along the time line, follow a file that is still being written."""

import time

import numpy as np

from mpsim.errors import InputError, MpsimError
from mpsim.viewer import wire
from mpsim.viewer.broadcast import Audience
from mpsim.viewer.colours import scale_of
from mpsim.viewer.gauges import Gauges, Meter
from mpsim.viewer.pace import Pace
from mpsim.viewer.recording import Moment, Recording
from mpsim.viewer.session import GAUGE_SECONDS, PICTURE_SECONDS
from mpsim.viewer.source import Source

SPEED = 0.5
"""Initial speed, in the units of `Pace`: 30 recorded frames a second."""

FILE_SECONDS = 0.5
"""Time between two checks whether the file has grown [s]."""


class Playback(Source):
    """Shows a recording on the pages of a view.

    Args:
        recording: the recording; it is closed at the end.
        name: title on the page.
        playing: whether it plays as soon as a page is visible.
        audience: the pages.
    """

    def __init__(self, recording: Recording, *, name: str = "", playing: bool = True, audience: Audience):
        super().__init__(recording.scene, audience)
        self._recording = recording
        self._name = name or recording.name
        # of the thread alone
        self._follow = recording.follow
        self._playing = playing and not self._follow
        self._index = 0
        self._moment: Moment | None = None  # the frame at the index, read when it is needed
        self._shown = self._gauged = -1  # indices
        self._radii = np.zeros(0)
        self._next_picture = self._next_gauges = self._next_file = 0.0
        self._note: str | None = None
        self._over = False
        self._pace = Pace(SPEED)
        self._pace.note(1, 0.0)  # skipped frames take no time

    # --- the thread

    def _open(self) -> None:
        self._broadcast.tell_scene(self._name, recording=self._recording.name, can_reset=True)
        self._broadcast.tell("link", {"text": None})  # a page that was opened with a link then says what to do instead
        self._gauges = Gauges(self.scene, self._recording.at(0).state)
        if self._follow:
            self._index = self._last
        self._resume()

    @property
    def _last(self) -> int:
        return len(self._recording) - 1

    def _resume(self) -> None:
        self._pace.start(time.perf_counter())
        self._note = None
        self._tell()

    def _tell(self) -> None:
        phase = "over" if self._over else "playing" if self._playing else "paused"
        self._broadcast.tell_if_new("status", {"phase": phase, "speed": self._pace.speed, "note": self._note})
        self._tell_place()

    def _tell_place(self) -> None:
        count = len(self._recording)
        self._broadcast.tell_if_new("timeline", {"count": count, "index": self._index, "follow": self._follow})

    def _do(self, action: wire.Action) -> None:
        match action.name:
            case "play":
                if self._index == self._last:
                    self._go(0)
                self._playing = True
            case "pause":
                self._playing = self._follow = False
            case "step":
                self._playing = False
                self._go(self._index + action.values["frames"])
            case "seek":
                self._go(action.values["index"])
            case "follow":
                self._go(self._last if action.values["value"] else self._index)
                self._follow, self._playing = action.values["value"], False
            case "speed":
                self._pace.speed = action.values["value"]
            case "reset":
                self._go(0)
            case "keep":
                error = InputError(
                    "a recording has no session, scene or program to keep; its file contains everything."
                )
                action.values["answer"].set_exception(error)
                return
            case name:
                raise InputError(f"a recording cannot {name}: it only shows what was written. View the scene instead.")
        self._resume()

    def _go(self, index: int) -> None:
        """Go to an index, or the nearest one that exists, and stop following the file."""
        self._index, self._moment, self._follow = max(min(index, self._last), 0), None, False

    def _advance(self) -> None:
        now = time.perf_counter()
        if now >= self._next_file:
            self._next_file = now + FILE_SECONDS
            self._read_on()
        if self._playing:
            self._play(now)
        self._tell_place()
        self._look(now)

    def _read_on(self) -> None:
        """Look for new frames. If the file was written anew, read the shown frame again."""
        before = len(self._recording)
        if not self._recording.refresh():
            return
        if not len(self._recording):
            raise InputError(
                f"a recording must hold a frame; {self._name!r} holds none any more. Let the run continue."
            )
        if self._note is not None or len(self._recording) < before:
            self._moment, self._shown, self._gauged, self._note = None, -1, -1, None
            self._tell()
        if self._follow or self._index > self._last:
            self._index, self._moment = max(self._last, 0), None

    def _play(self, now: float) -> None:
        """Advance by the frames that are due; at full speed by one frame for each picture."""
        frames = self._pace.due(now) if self._pace.speed is not None else int(self._shown == self._index)
        if frames:
            self._go(self._index + frames)
        if self._index == self._last:
            self._playing = False
            self._tell()

    def _look(self, now: float) -> None:
        """Make the picture and the gauges if they are due and another frame is reached."""
        gauges = now >= self._next_gauges and self._index != self._gauged
        with self._wake:
            picture = self._asked and now >= self._next_picture and self._index != self._shown
        if not gauges and not picture:
            return
        if self._moment is None:
            self._moment = self._recording.at(self._index)
        if gauges:
            self._gauged, self._next_gauges = self._index, now + GAUGE_SECONDS
            self._tell_gauges(self._moment)
        if picture:
            with self._wake:
                self._asked = False
            self._shown, self._next_picture = self._index, now + PICTURE_SECONDS
            self._show(self._moment)

    def _show(self, moment: Moment) -> None:
        if not np.array_equal(moment.radii, self._radii):
            self._radii = moment.radii
            self._broadcast.forget_radii()
        self._broadcast.show(moment.state, moment.radii, moment.frame, moment.time)

    def _tell_gauges(self, moment: Moment) -> None:
        self._broadcast.scale = scale_of(moment.state)
        numbers = self._gauges.of(moment.state)
        meter = Meter(0.0)  # nothing runs, so it has no rates
        told = {"frame": moment.frame, "time": moment.time, **numbers, **vars(meter.read(0, 0.0)), **meter.workers()}
        self._broadcast.tell("gauges", told)

    def _seconds_to_next(self) -> float | None:
        now = time.perf_counter()
        due = [self._next_file - now]
        if self._playing and self._pace.speed is not None:
            due.append(self._pace.wait(now))
        if self._index != self._gauged:
            due.append(self._next_gauges - now)
        if self._asked and (self._index != self._shown or self._playing):
            due.append(self._next_picture - now)
        return max(min(due), 0.0)

    def _refused(self, error: MpsimError) -> None:
        self._playing = self._follow = False
        self._shown = self._gauged = self._index  # a frame that cannot be read is not tried again
        self._note = str(error)
        self._tell()

    def _stopped_by(self, error: BaseException) -> None:
        self._over, self._note = True, str(error) or type(error).__name__
        self._tell()

    def _release(self) -> None:
        self._recording.close()
