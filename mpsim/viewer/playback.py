"""Plays a recording: its frames as states, the time line, a file that still grows."""

import os
import time
import warnings
from functools import partial
from math import nan
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.core.state import State, moved_into
from mpsim.engine.solvers.base import InPlace, in_place
from mpsim.errors import InputError, MpsimError, TrajectoryError, TrajectoryWarning
from mpsim.features.edges import boundary_of
from mpsim.measure.observables import SAME_BOX, placed
from mpsim.output.frames import Frame
from mpsim.output.trajectory import Trajectory
from mpsim.scene.scene import Scene
from mpsim.viewer import export
from mpsim.viewer.gauges import Gauges, Meter
from mpsim.viewer.protocol import command, whole
from mpsim.viewer.source import Source

# --- Reads the frames of a trajectory as states for a view, together with a scene

MOST_GAPS = 1000
"""Largest number of unused disc numbers in a frame, beyond as many as it has discs. If there are more, the discs are
numbered by their order in the file."""


class Recording:
    """The file of a trajectory, which a run may still be writing.

    Args:
        path: path of the file, as for `mpsim.Trajectory`, and `given`, which it takes by name.
        scene: scene of the trajectory; None: a box with the discs of its first frame, without obstacles and forces.
        follow: whether a view starts at the last frame and continues with new ones.

    Raises:
        InputError: if the file has no frame yet.
        TrajectoryError: if it lacks radii, or cannot be read.
    """

    def __init__(self, path: Path, scene: Scene | None = None, follow: bool = False, **given: Any):
        self._path = path
        self.name: str = path.name
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", TrajectoryWarning)  # an incomplete last frame is still being written
            self._trajectory = Trajectory(path, **given)
        self._seen = self._stamp()
        if not len(self):
            raise InputError(
                f"a recording must hold a frame; {str(self._path)!r} holds none yet. Let the run continue for a while."
            )
        first = self._trajectory[0]
        self._corner = first.origin if scene is None else None  # of the box that is shown
        self._fewest = 0 if scene is None else scene.count
        self.scene: Scene = _scene_of(first) if scene is None else scene
        self.follow: bool = follow
        self.at(0)  # which refuses the scene of another box, and a frame that cannot be shown

    def __len__(self) -> int:
        return len(self._trajectory)

    def refresh(self) -> bool:
        """Look for new frames; returns whether the file has changed."""
        now = self._stamp()
        if now == self._seen:
            return False
        self._trajectory.refresh()
        self._seen = now
        return True

    def at(self, index: int) -> tuple[State, InPlace]:
        """The discs of a frame, by number; those that it does not contain are absent. A time that is unknown is NaN.

        Raises:
            TrajectoryError: if it cannot be read, or has other periods than the first one.
        """
        try:
            frame = self._trajectory[index]
        except (OSError, IndexError) as error:
            raise TrajectoryError(
                f"frame {index} must be in {str(self._path)!r} to be shown; it no longer exists ({error})."
            ) from None
        sides, ours = np.array(frame.box), np.array([self.scene.width, self.scene.height])
        if self._corner is not None and ((np.abs(sides / ours - 1) > SAME_BOX) & frame.periodic).any():
            raise TrajectoryError(
                f"frame {index} of {str(self._path)!r} must have the periods of the box that is shown, "
                f"{ours[0]:g} x {ours[1]:g}; it has {sides[0]:g} x {sides[1]:g}. Draw it alone, by "
                f"mpsim.draw(trajectory[{index}])."
            )
        numbers, count = _numbers_of(frame, self._fewest)
        discs = placed(frame.state, self.scene) if self._corner is None else _seen_from(self._corner, frame)
        position = np.zeros((count, 2), frame.position.dtype)
        velocity, radii, present = np.zeros_like(position), np.zeros(count), np.zeros(count, np.bool_)
        position[numbers] = discs.position
        velocity[numbers] = frame.known.get("velocity", nan)  # which the page shows as unknown
        radii[numbers], present[numbers] = frame.radius, True
        # Without a scene no wall is drawn, and measures take the box of the first frame, though a wall may have moved.
        state = State(position, velocity, present=present, box=None if self._corner else discs.box)
        return state, in_place(state, self.scene.box, frame.frame, frame.known.get("time", nan), radii)

    def close(self) -> None:
        """Close the file."""
        self._trajectory.close()

    def _stamp(self) -> tuple[int, ...]:
        try:
            found = os.stat(self._path)
        except OSError:
            return ()
        return found.st_ino, found.st_size, found.st_mtime_ns


def _numbers_of(frame: Frame, fewest: int) -> tuple[NDArray[np.int64], int]:
    """The number of each disc of a frame, and the total number of discs that follows from them, at least `fewest`."""
    ids, count = frame.ids, len(frame.position)
    most = max(2 * count, fewest) + MOST_GAPS
    if count and (ids.min() < 0 or ids.max() >= most or len(np.unique(ids)) < count):  # from another program
        ids = np.arange(count)
    return ids, max(int(ids.max(initial=-1)) + 1, fewest)


def _seen_from(corner: tuple[float, float], frame: Frame) -> State:
    """The discs of a frame from a corner of the box; along periodic axes from that of its own."""
    x, y = np.where(frame.periodic, frame.origin, corner).tolist()
    state = frame.state
    assert state.box is not None  # that of a frame is known
    return moved_into(state, state.box, frame.periodic, (x, y))


def _scene_of(frame: Frame) -> Scene:
    (width, height), mass = frame.box, frame.known.get("mass")
    room = np.minimum(frame.radius, min(width, height) / 2)[:, None]
    place = np.asarray(_seen_from(frame.origin, frame).position, np.float64)
    place = np.where(frame.periodic, place, np.clip(place, room, np.array([width, height]) - room))
    return Scene(
        width=width,
        height=height,
        position=place,
        velocity=np.asarray(frame.known.get("velocity", 0 * place), np.float64),
        radius=frame.radius,
        mass=None if mass is None or (mass == 1).all() else mass,
        boundary=boundary_of(frame.periodic),
    )


# --- Plays a recording: play, step, move along the time line, follow a file that is still being written

SPEED = 0.5  # initial speed, in the units of `FrameRate`: 30 recorded frames a second
FILE_SECONDS = 0.5  # time between two checks whether the file has grown [s]


class Playback(Source):
    """Shows a recording on the pages of a view, and closes it at the end."""

    def __init__(self, recording: Recording, *, name: str, playing: bool):
        super().__init__(recording.scene, name or recording.name, playing and not recording.follow)
        self._recording = recording
        # of the thread alone
        self._follow = recording.follow
        self._index = 0
        self._moment: tuple[State, InPlace] | None = None  # the frame at the index, read when it is needed
        self._radii = np.zeros(0)
        self._next_file = 0.0
        self._rate.speed = SPEED
        self._rate.note(1, 0.0)  # skipped frames take no time

    # --- the thread

    def _open(self) -> None:
        self._broadcast.tell_scene(self._name, recording=self._recording.name, can_reset=True)
        self._broadcast.tell("link", {"text": None})  # a page that was opened with a link then says what to do instead
        self._gauges = Gauges(self.scene, self._recording.at(0)[0])
        if self._follow:
            self._index = self._last
        self._resume()

    @property
    def _last(self) -> int:
        return len(self._recording) - 1

    def _tell(self) -> None:
        super()._tell()
        place = {"count": len(self._recording), "index": self._index, "follow": self._follow}
        self._broadcast.tell_if_new("timeline", place)

    # --- commands

    cannot = "a recording cannot {}: it only shows what was written. View the scene instead."

    def do_play(self) -> None:
        if self._index == self._last:
            self._go(0)
        self._playing = True

    def do_pause(self) -> None:
        self._playing = self._follow = False

    def do_step(self, frames: int) -> None:
        self._playing = False
        self._go(self._index + frames)

    def do_reset(self) -> None:
        self._go(0)

    @command(index=whole(0, 2**31 - 1))
    def do_seek(self, index: int) -> None:
        """Go to a recorded frame."""
        self._go(index)

    @command(value=checks.truth)
    def do_follow(self, value: bool) -> None:
        """Stay at the last frame while the file grows, or not."""
        self._go(self._last if value else self._index)
        self._follow, self._playing = value, False

    def _exported(self, what: str) -> "export.Download":
        raise InputError("a recording has no session, scene or program to keep; its file contains everything.")

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
        self._tell()
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
            self._moment = self._pictures.done = self._readings.done = self._note = None
            self._tell()
        if self._follow or self._index > self._last:
            self._index, self._moment = max(self._last, 0), None

    def _play(self, now: float) -> None:
        frames = self._rate.due(now) if self._rate.speed is not None else int(self._pictures.done == self._index)
        if frames:
            self._go(self._index + frames)
        self._playing = self._index < self._last

    def _look(self, now: float) -> None:
        """Make the picture and the gauges if they are due and another frame is reached."""
        gauges, picture = (budget.is_due(self._index, now) for budget in (self._readings, self._pictures))
        picture = picture and self._asked
        if not gauges and not picture:
            return
        if self._moment is None:
            self._moment = self._recording.at(self._index)
        state, discs = self._moment
        if gauges:
            counts = Meter().read(0.0)  # nothing runs, so there is no rate
            tell = partial(self._tell_gauges, self._gauges, state, frame=discs.frame, time=discs.time, **counts)
            self._readings.use(tell, self._index, now)
        if picture:
            self._asked = False
            if not np.array_equal(discs.radii, self._radii):
                self._radii = discs.radii
                self._broadcast.forget_radii()
            self._pictures.use(partial(self._broadcast.show, discs), self._index, now)

    def _seconds_to_next(self) -> float | None:
        now = time.perf_counter()
        due = [self._next_file - now]
        if self._playing and self._rate.speed is not None:
            due.append(self._rate.wait(now))
        if self._index != self._readings.done:
            due.append(self._readings.wait(now))
        if self._asked and (self._index != self._pictures.done or self._playing):
            due.append(self._pictures.wait(now))
        return max(min(due), 0.0)

    def _refused(self, error: MpsimError) -> None:
        self._playing = self._follow = False
        self._pictures.done = self._readings.done = self._index  # a frame that cannot be read is not tried again
        self._note = str(error)
        self._tell()

    def _release(self) -> None:
        self._recording.close()
