"""One frame of a trajectory, and what the files of trajectories have in common."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mpsim.engine.simulation import Simulation
from mpsim.errors import TrajectoryError
from mpsim.state import State


@dataclass(frozen=True)
class Frame:
    """The discs at one moment, in the order of their numbers. Discs that had left by then are not in it.

    Attributes:
        frame: number of the frame of the simulation.
        box: width and height [length].
        periodic: whether x, and whether y, is periodic.
        position: shape (N, 2) [length], in the precision of the run.
        source: the file, for error texts.
        known: what else the file holds of time, velocity, radius and ids; each is also an attribute, which raises
            TrajectoryError where the file lacks it.
    """

    frame: int
    box: tuple[float, float]
    periodic: tuple[bool, bool]
    position: NDArray[np.floating]
    source: Path
    known: dict[str, Any]

    @property
    def time(self) -> float:
        """Simulated time [time]."""
        return float(self._get("time"))

    @property
    def velocity(self) -> NDArray[np.floating]:
        """Velocities, shape (N, 2) [length/time], in the precision of the run."""
        return self._get("velocity")

    @property
    def radius(self) -> NDArray[np.float64]:
        """Radii, shape (N,) [length]."""
        return self._get("radius")

    @property
    def ids(self) -> NDArray[np.int64]:
        """Numbers of the discs in their scene, shape (N,); of a file without numbers 0, 1, 2, ..."""
        return self.known.get("ids", np.arange(len(self.position)))

    @property
    def state(self) -> State:
        """Positions and velocities as a State, which knows its digest."""
        return State(self.position, self.velocity)

    def _get(self, name: str) -> Any:
        if name not in self.known:
            found = ", ".join(["position", *sorted(self.known)])
            raise TrajectoryError(
                f"{name} must be in a trajectory to be read from it; {str(self.source)!r} holds only {found}. "
                f"Have the program that wrote it write {WRITTEN_AS[name]}, too."
            )
        return self.known[name]

    def __repr__(self) -> str:
        time = f", time {self.time:g}" if "time" in self.known else ""
        return f"<Frame {self.frame}: {len(self.position)} discs in {self.box[0]:g} x {self.box[1]:g}{time}>"


WRITTEN_AS = {
    "time": "the key Time (extended XYZ) or log/mpsim/time (GSD)",
    "velocity": "the column velo:R:3 (extended XYZ) or particles/velocity (GSD)",
    "radius": "the column radius:R:1 (extended XYZ) or particles/diameter (GSD)",
}


def frame_of(sim: Simulation) -> Frame:
    """The discs of a simulation as they are now, between two frames."""
    state, scene, here = sim.state, sim.scene, ~sim.absorbed
    known = {
        "time": sim.frame * sim.settings.dt,  # sim.time but for the rounding of the exact solver's clock
        "velocity": state.velocity[here],
        "radius": sim.radii[here],
        "ids": np.flatnonzero(here),
    }
    return Frame(sim.frame, (scene.width, scene.height), scene.periodic, state.position[here], Path(), known)


def differs(a: Frame, b: Frame) -> str | None:
    """In what two frames differ, or None if they have the same bits."""
    for name in ("frame", "box", "periodic", "time"):
        if getattr(a, name) != getattr(b, name):
            return f"its {name} is {getattr(a, name)} and not {getattr(b, name)}"
    for name in ("ids", "position", "velocity", "radius"):
        if not np.array_equal(getattr(a, name), getattr(b, name)):
            return f"its {name} of discs is another"
    return None


class Reader(Protocol):
    """What reads a file of frames."""

    def __len__(self) -> int:
        """Whole frames in the file."""
        ...

    def read(self, index: int) -> Frame:
        """The frame of an index, 0 <= index < len."""
        ...

    def number(self, index: int) -> int:
        """The frame of the simulation that is at an index."""
        ...

    def close(self) -> None:
        """Let go of the file."""
        ...


class Writer(Protocol):
    """What writes a file of frames; each frame has reached the operating system when `write` returns."""

    def write(self, frame: Frame) -> None:
        """Append a frame."""
        ...

    def keep(self, frames: int) -> None:
        """Cut the file after its first frames."""
        ...

    def close(self) -> None:
        """Close the file."""
        ...
