"""Reads the frames of a trajectory as states for a view, together with a scene."""

import os
import warnings
from dataclasses import dataclass
from math import nan
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.core.state import State, moved_into
from mpsim.errors import InputError, TrajectoryError, TrajectoryWarning
from mpsim.features.edges import boundary_of
from mpsim.measure.moments import SAME_BOX, placed
from mpsim.output.frames import Frame
from mpsim.output.trajectory import Trajectory
from mpsim.scene.scene import Scene

MOST_GAPS = 1000
"""Largest number of unused disc numbers in a frame, beyond as many as it has discs. If there are more, the discs are
numbered by their order in the file."""


@dataclass(frozen=True)
class Moment:
    """One frame of a recording.

    Attributes:
        frame: frame of the simulation.
        time: simulated time [time]; NaN if the file does not contain it.
        state: all discs, ordered by number; those that the frame does not contain are absent.
        radii: radii of the discs, shape (N,) [length].
    """

    frame: int
    time: float
    state: State
    radii: NDArray[np.float64]


class Recording:
    """The file of a trajectory, which a run may still be writing.

    Args:
        path: path of the file, as for `mpsim.Trajectory`, and `given`, which it takes by name.
        scene: scene of the trajectory; None: a box with the discs of its first frame, without obstacles and forces.
        follow: whether a view starts at the last frame and continues with new ones.

    Attributes:
        scene, follow: as above.

    Raises:
        InputError: if the file has no frame yet.
        TrajectoryError: if it lacks radii, or cannot be read.

    >>> import tempfile, mpsim
    >>> scene = Scene.random(count=50, packing=0.2, radius=0.5, seed=1)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with mpsim.Simulation(scene) as sim, Trajectory.write(f"{folder}/run.xyz", every=10) as out:
    ...         report = sim.run(frames=50, observe=out)
    ...     recording = Recording(Path(folder, "run.xyz"))
    ...     len(recording), recording.at(2).frame, recording.scene.count
    (6, 20, 50)
    """

    def __init__(self, path: Path, scene: Scene | None = None, follow: bool = False, **given: Any):
        self._path = path
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

    @property
    def name(self) -> str:
        """Name of the file."""
        return self._path.name

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

    def at(self, index: int) -> Moment:
        """The frame of an index, 0 <= index < len.

        Raises:
            TrajectoryError: if it cannot be read, no longer exists, or has other periods than the first one.
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
        return Moment(frame.frame, frame.known.get("time", nan), state, radii)

    def close(self) -> None:
        """Close the file."""
        self._trajectory.close()

    def _stamp(self) -> tuple[int, ...]:
        """Values that change when the file changes."""
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
    """A scene with the box, boundaries and discs of a frame."""
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
