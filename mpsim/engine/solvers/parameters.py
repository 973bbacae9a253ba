"""The records `parameters` and `control` of stepped solvers, from scene, settings and number of discs."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mpsim.engine.feature_arrays import typical_momentum, wall_limits
from mpsim.engine.solvers.speed_limit import SpeedLimit
from mpsim.engine.workers.arrays import Grid
from mpsim.features import FEATURES
from mpsim.features.edges import EDGES
from mpsim.features.radii import has_radii
from mpsim.kernels import layout
from mpsim.kernels.features.hooks import prepare_first_step
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings


class Present(NamedTuple):
    """What changes while a scene is simulated.

    Attributes:
        radii: of all discs, shape (N,) [length].
        grid: of the broad phase.
        giant: radius above which discs are kept out of it [length]; None: there are no such discs.
        substeps: steps of a frame.
        speed_limit: when a disc is too fast.
        origin: frame and time from which frames and steps are counted.
        unguarded: whether neighbouring columns are resolved at the same time, a race.
    """

    radii: NDArray[np.float64]
    grid: Grid
    giant: float | None
    substeps: int
    speed_limit: SpeedLimit
    origin: tuple[int, float]
    unguarded: bool = False


def configure(arrays: dict[str, Any], scene: Scene, settings: Settings, now: Present) -> None:
    """Write both records into a block."""
    grid, dt = now.grid, settings.dt / now.substeps
    smallest = float(now.radii.min(initial=scene.largest_radius))
    common = None if has_radii(scene) else scene.largest_radius
    parameters = arrays["parameters"]
    parameters.dt = dt
    parameters.diameter = 2 * scene.largest_radius
    parameters.limit[:] = wall_limits(scene)
    parameters.cells_per_x = grid.columns / scene.width
    parameters.cells_per_y = grid.rows / scene.height
    parameters.half_one_plus_e = (1 + scene.restitution) / 2
    parameters.wall_restitution = scene.wall_restitution
    parameters.wall_bounce = scene.wall_restitution if settings.contact == "impact" else 0.0
    parameters.tally_scale = _tally_scale(scene, settings)
    parameters.fast = now.speed_limit.square(dt, common, smallest, settings.precision)
    for feature in FEATURES:
        feature.begin(scene, arrays, settings.dt, now.origin)
    if "giants" in arrays:
        arrays["giants"][0] = np.inf if now.giant is None else now.giant
    control = arrays["control"]
    control.count = len(now.radii)
    control.columns = grid.columns
    control.rows = grid.rows
    control.cells = grid.table_size - 1
    control.substeps = now.substeps
    control.law = layout.LAWS[settings.law].number
    control.contact = layout.CONTACTS[settings.contact]
    control.passes = settings.passes
    control.race_free = int(not now.unguarded)
    control.absorbing[:] = [edge in scene.absorbing for edge in EDGES]
    prepare_first_step(arrays)


def _tally_scale(scene: Scene, settings: Settings) -> float:
    """A power of two that makes a typical momentum some 2^32: fine steps, and 2^31 discs' worth of room above."""
    typical = typical_momentum(scene, settings.dt)
    # Where the exponent of the run's floats would end, sums are coarser or the room above is less.
    most = np.finfo(settings.precision).maxexp - 28
    return 2.0 ** float(np.clip(32 - np.frexp(typical)[1], -most, most))
