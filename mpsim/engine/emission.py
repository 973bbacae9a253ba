"""Emitters: discs that enter a running scene."""

import warnings
from typing import TYPE_CHECKING

import numpy as np

from mpsim.engine.provision import has_masses, has_radii
from mpsim.errors import EmitterWarning
from mpsim.features import Emitter
from mpsim.scene import Scene

if TYPE_CHECKING:
    from mpsim.engine.simulation import Simulation


class Emission:
    """What the emitters of a scene have done so far.

    An emitter acts before the frames every, 2 every, ...; a place that is occupied is tried again before each frame. So
    what enters when depends on the state alone, not on how a run is cut into slices.
    """

    def __init__(self, scene: Scene):
        self._scene = scene
        self._emitters = scene.emitters
        self._emitted = [0] * len(scene.emitters)
        self._due = [emitter.every for emitter in scene.emitters]
        self._warned = False

    @property
    def progress(self) -> dict[str, list[int]]:
        """How many discs each emitter has added, and the frame before which it is due again."""
        return {"emitted": list(self._emitted), "due": list(self._due)}

    @progress.setter
    def progress(self, found: dict[str, list[int]]) -> None:
        self._emitted, self._due = list(found["emitted"]), list(found["due"])

    def frames_ahead(self, frame: int) -> int:
        """Frames until an emitter is due again; a very large number without one."""
        return min((max(due - frame, 1) for index, due in enumerate(self._due) if self._open(index)), default=2**62)

    def emit(self, sim: "Simulation") -> None:
        """Add the discs that are due at this frame, where their places are free."""
        for index, emitter in enumerate(self._emitters):
            if self._open(index) and sim.frame >= self._due[index]:
                if self._occupied(sim, emitter):
                    self._warn(index, emitter, sim.frame)
                    continue
                radius = emitter.radius if emitter.radius is not None else self._scene.largest_radius
                mass = emitter.mass if emitter.mass is not None else 1.0
                sim.add(
                    emitter.position,
                    emitter.velocity,
                    radius=radius if has_radii(self._scene) else None,
                    mass=mass if has_masses(self._scene) else None,
                )
                self._emitted[index] += 1
                self._due[index] = sim.frame + emitter.every

    def _open(self, index: int) -> bool:
        """Whether an emitter has discs left."""
        limit = self._emitters[index].limit
        return limit is None or self._emitted[index] < limit

    def _occupied(self, sim: "Simulation", emitter: Emitter) -> bool:
        """Whether a disc overlaps the place of the next one."""
        state, gone = sim.state, sim.absorbed
        radii = sim.radii
        own = emitter.radius if emitter.radius is not None else self._scene.largest_radius
        offset = np.abs(state.position - np.asarray(emitter.position))
        for axis, length in enumerate((self._scene.width, self._scene.height)):
            if self._scene.boundary[axis] == "periodic":
                offset[:, axis] = np.minimum(offset[:, axis], length - offset[:, axis])
        return bool(((offset**2).sum(axis=1) < (radii + own) ** 2)[~gone].any())

    def _warn(self, index: int, emitter: Emitter, frame: int) -> None:
        """Say once that a disc waits."""
        if not self._warned:
            self._warned = True
            warnings.warn(
                f"emitters[{index}] found its place {emitter.position} occupied before frame {frame}: its disc waits "
                "until the place is free. Give a larger `every`, or a velocity that leads away.",
                EmitterWarning,
                stacklevel=4,
            )
