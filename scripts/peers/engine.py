"""The interface of all engines of the comparison."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray


class NotThereError(Exception):
    """An engine cannot be had here; the text says why and what to do."""


@dataclass(frozen=True)
class Start:
    """A closed box of equal discs of mass 1, the same for every engine.

    Attributes:
        width, height: of the box [length].
        radius: [length].
        position, velocity: shape (N, 2), float64 [length], [length/time].
    """

    width: float
    height: float
    radius: float
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]

    @property
    def count(self) -> int:
        """Number of discs."""
        return len(self.position)

    def save(self, path: Path) -> None:
        """Write a .npz file."""
        np.savez(path, **vars(self))

    @classmethod
    def load(cls, path: str | Path) -> "Start":
        """Read the file that `save` wrote."""
        with np.load(path) as held:
            values: dict[str, Any] = {name: value if value.ndim else float(value) for name, value in held.items()}
        return cls(**values)


@dataclass(frozen=True)
class Plan:
    """How an engine is to run a start.

    Attributes:
        dt: time of one frame [time].
        precision: "float32" or "float64", for engines that have a choice.
        threads: threads or processes that compute.
        counting: whether impulses on the walls are summed. Without it a frame does nothing for it.
        knob: one of the engine's own settings of effort, such as its number of iterations; 0: it has none.
    """

    dt: float
    precision: Literal["float32", "float64"] = "float32"
    threads: int = 1
    counting: bool = False
    knob: int = 0


class Run(ABC):
    """An engine with a start in it.

    Attributes:
        impulses: on the left, right, lower and upper wall since the start [mass length/time], each >= 0, or their sum
            alone. Defined if the plan said `counting`.
    """

    impulses: NDArray[np.float64]

    @abstractmethod
    def run(self, frames: int) -> None:
        """Run frames; returns when they are done."""

    @abstractmethod
    def state(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Positions and velocities, shape (N, 2), in any order of the discs."""

    def walls(self) -> NDArray[np.float64]:
        """`impulses`, for engines that have them elsewhere."""
        return self.impulses

    def close(self) -> None:
        """Give back what the engine holds."""
        return
