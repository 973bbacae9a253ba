"""Common code of stepped solvers: time, division of frames into steps, the grid, snapshots."""

from abc import abstractmethod
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from mpsim.core.sizes import kept_sizes
from mpsim.core.state import Box
from mpsim.engine.frame_count import frames_until
from mpsim.engine.solvers import slices, stepped_snapshot
from mpsim.engine.solvers.base import Capabilities, Choice, NewDiscs, Solver
from mpsim.engine.solvers.snapshots import Shapes, Snapshot
from mpsim.engine.solvers.speed_limit import SpeedLimit
from mpsim.engine.solvers.speeds import Speeds, speeds_of
from mpsim.engine.workers.arrays import Grid, grid_for
from mpsim.features.radii import has_radii
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings


class SteppedSolver(Solver):
    """Runs frames that are made of equal steps."""

    capabilities: ClassVar[Capabilities] = Capabilities(has_steps=True)
    count: int

    def __init__(self, scene: Scene, settings: Settings, choice: Choice):
        super().__init__(scene, settings, choice)
        self.substeps: int = settings.substeps
        self._speed_limit = SpeedLimit()

    @abstractmethod
    def _configure(self) -> None:
        """Write the records `parameters` and `control`, which follow from what is simulated now."""

    @property
    @abstractmethod
    def _control(self) -> Any:
        """The record `control`."""

    @property
    @abstractmethod
    def _parameters(self) -> Any:
        """The record `parameters`."""

    @property
    def most_momentum(self) -> float:
        """Momenta whose sum is larger make impulses that a frame's counts cannot hold [mass length/time]."""
        return slices.MOST_COUNTED / float(self._parameters.tally_scale)

    # --- counts

    def _begin_counts(self, arrays: dict[str, Any], frames: int) -> None:
        """Write zeros where workers count in the next frames, and whether they count what measures need."""
        self._control.tallied = self.tallied
        for name in ("times", "tally") if self.tallied else ("times",):
            arrays[name][:, :frames] = 0

    def _totals(self, tally: NDArray[Any]) -> NDArray[Any]:
        """What all workers counted, in the scene's units: COUNTS, shape (frames,). tally: as of `slices.totals`."""
        return slices.totals(tally, float(self._parameters.tally_scale), 2 * self._scene.largest_radius)

    # --- time

    @property
    def time(self) -> float:
        """Simulated time since the start [time]."""
        return self.time_of(self.frame)

    @property
    def _frames(self) -> int:
        """Frames done since the origin."""
        return self.frame - self.origin.frame

    def reached(self, time: float) -> bool:
        """Whether the last frame has reached a time [time]; one that ends within rounding of it has."""
        frames, dt, time = self._frames, self._settings.dt, time - self.origin.time
        return time < (frames + 1) * dt and frames_until(time, dt) <= frames

    def _frames_to(self, stop: float, most: int) -> int:
        """Frames until one reaches the time `stop`, at least one, and at most so many."""
        frames, dt, stop = self._frames, self._settings.dt, stop - self.origin.time
        return min(most, max(frames_until(stop, dt) - frames, 1)) if stop < (frames + most) * dt else most

    @property
    def _box(self) -> Box:
        """The box after the steps done: inside a frame too, where one is run pass by pass."""
        return self._scene.box_at(self.origin.time + float(self._control.steps) / self.substeps * self._settings.dt)

    # --- steps

    def set_speed_limit(self, limit: SpeedLimit) -> None:
        """From now on end a command with the frame in which a disc is so fast."""
        self._speed_limit = limit
        self._configure()

    def divide(self, substeps: int) -> None:
        """Divide the frames that follow into so many steps.

        The count of steps becomes what it would be if all frames had had as many: so the time follows from it as
        before, and a snapshot tells the number of sub-steps.
        """
        if substeps != self.substeps:
            self.substeps = substeps
            self._control.steps = self._frames * substeps
            self._configure()

    def _speeds(self, velocity: NDArray[Any], absorbed: NDArray[np.bool_], new: NewDiscs | None) -> Speeds:
        """How fast discs of such velocities are, those that are about to be added included."""
        scene, radii, present = self._scene, self._radii, ~absorbed
        if new is not None:
            velocity, radii = np.concatenate([velocity, new.velocity]), kept_sizes(radii, new.radius)
            present = np.append(present, np.ones(len(new.position), bool))
        return speeds_of(velocity, radii, scene, self.time, present if scene.loses_discs else None)

    # --- the grid

    def _grid_of(self, count: int, giant: float | None = None) -> Grid:
        """The grid for so many discs; giant: radius above which discs are kept out of it."""
        scene = self._scene
        largest = scene.largest_radius if giant is None else giant
        outside = scene.loses_discs or has_radii(scene)
        return grid_for(
            count, scene.width, scene.height, 2 * largest, self._settings.precision, scene.boundary, outside
        )

    # --- snapshots

    def _begin_from(self, snapshot: Snapshot) -> tuple[int, int]:
        """Take over what a snapshot says of all discs. Returns the frames and the steps that were done."""
        self._radii, self._masses = kept_sizes(snapshot["radii"]), kept_sizes(snapshot["masses"])
        self.count = len(self._radii)
        frames, steps = snapshot["progress"].tolist()
        self.substeps = steps // frames if frames else self._settings.substeps
        return frames, steps

    @staticmethod
    def snapshot_shapes(scene: Scene, settings: Settings, count: int) -> Shapes:
        """dtype and shape of every array of a snapshot of so many discs."""
        return stepped_snapshot.shapes(scene, np.dtype(settings.precision), count)

    @staticmethod
    def check_snapshot(scene: Scene, settings: Settings, snapshot: Snapshot) -> None:
        """Raise ValueError for a snapshot in which no solver can have been, saying why."""
        stepped_snapshot.check(scene, snapshot)
