"""The shared block of the exact solver: its arrays for a scene, and the arguments of its kernels."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mpsim.engine.solvers import collisions, event_features, event_snapshot
from mpsim.engine.solvers.base import Origin
from mpsim.engine.solvers.event_scene import refuse_overlap
from mpsim.engine.solvers.event_tiles import WHOLE, Tiling, lay_out, packed, specs_of, tiling_of
from mpsim.engine.workers.arrays import ArraySpec
from mpsim.engine.workers.shared import SharedBlock
from mpsim.errors import InputError
from mpsim.features import FEATURES
from mpsim.features.radii import has_radii
from mpsim.kernels import collision_log
from mpsim.kernels.events import records, solver
from mpsim.kernels.events import state as stores
from mpsim.kernels.events.boundary import Box
from mpsim.kernels.events.features.hooks import features_of
from mpsim.scene.scene import Scene


class System(NamedTuple):
    """What kernels take of a block: its arrays, the box with its cells, and what the scene has besides."""

    store: Any
    box: Any
    features: Any


class Plan(NamedTuple):
    """What says which arrays a block has, and what stands in those that do not change.

    Attributes:
        scene: in force.
        dt: length of a frame [time].
        units: of sums of impulses and of virials [mass length/time], [mass length^2/time].
        contact_time: of the guard [time].
        crushing_speed: of a disc that a wall crushes [length/time]; None without a wall that moves.
        origin: from which frames and the clock count.
        workers: at most, the coordinator included.
        logging: whether collisions are logged.
    """

    scene: Scene
    dt: float
    units: tuple[float, float]
    contact_time: float
    crushing_speed: float | None
    origin: Origin
    workers: int
    logging: bool

    def room(self, count: int) -> SharedBlock:
        """A block for so many discs, which is still to be made."""
        cells, tiling = event_snapshot.cells_for(self.scene, count), self._tiling(count)
        shapes = stores.layout(count, cells) | event_snapshot.column_shapes(self.scene, count)
        specs = {name: ArraySpec(np.dtype(dtype), shape) for name, (dtype, shape) in shapes.items()}
        if self.logging:
            specs |= collisions.specs_of(count, self.workers if tiling != WHOLE else 1)
        if tiling != WHOLE:
            laws = packed(self._box(count), features_of(self.scene, self._given(count)))
            specs |= specs_of(count, tiling, self.workers, shapes, laws)
        return SharedBlock(specs, alone=tiling == WHOLE or self.workers == 1)

    def placed(
        self,
        block: SharedBlock,
        position: NDArray[np.floating],
        velocity: NDArray[np.floating],
        columns: dict[str, NDArray[Any]],
        time: float,
    ) -> System:
        """Make a block, with discs in it that are ready to go at a time [time].

        Raises:
            InputError: for discs that overlap, or are faster than can be computed.
        """
        block.create()
        system = self.system_in(block)
        status, particle = stores.place(position, velocity, columns, time, *system)
        if status != records.REACHED:
            raise InputError(
                f"velocity[{particle}] must be below 1e100 for method='event'; got {velocity[particle].tolist()}. "
                "Choose units in which the numbers are smaller."
            )
        refuse_overlap(system, 2 * self.scene.largest_radius)
        solver.schedule(*system)
        return system

    def system_in(self, block: SharedBlock) -> System:
        """What kernels take of a block."""
        scene, arrays = self.scene, block.arrays
        store = stores.store_of(arrays)
        count = len(store.order)
        box, features = self._box(count), features_of(scene, arrays | self._given(count))
        features = features._replace(log=collision_log.log_of(arrays, 0))
        if "tiles" in arrays:
            lay_out(arrays, self._tiling(count), box, self.dt, self.workers, packed(box, features))
        return System(store, box, features)

    def _tiling(self, count: int) -> Tiling:
        """The tiles for so many discs."""
        if not all(feature.on_tiles for feature in FEATURES if feature.is_in(self.scene)):
            return WHOLE
        cells = event_snapshot.cells_for(self.scene, count)
        return tiling_of(count, cells, self.scene.periodic, self.workers)

    def _box(self, count: int) -> Box:
        """The box with the cells for so many discs."""
        scene, (impulse, virial) = self.scene, self.units
        common = 0.0 if has_radii(scene) else scene.largest_radius
        return Box(
            scene.width, scene.height, *scene.periodic, *event_snapshot.cells_for(scene, count), common, impulse, virial
        )

    def _given(self, count: int) -> dict[str, Any]:
        """What features are given besides arrays of the block."""
        cells = event_snapshot.cells_for(self.scene, count)
        of_scene = event_features.given(self.scene, cells, self.dt, self.origin)
        return {"contact_time": self.contact_time, "crushing_speed": self.crushing_speed, **of_scene}
