"""Parameters and control words of the stepped solvers: what follows from scene, settings and number of discs."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mpsim.engine.feature_arrays import has_radii, typical_momentum, wall_limits
from mpsim.engine.speed_alarm import Alert
from mpsim.engine.workers.arrays import Grid
from mpsim.features.edges import EDGES
from mpsim.kernels import layout
from mpsim.kernels.features.hooks import prepare_step
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings

LIMITS = (layout.X_LOW, layout.X_HIGH, layout.Y_LOW, layout.Y_HIGH)

_CONTACTS = {"push": layout.PUSH, "impact": layout.IMPACT}
_LAWS = {"reflect": layout.REFLECT, "elastic": layout.ELASTIC}


class Present(NamedTuple):
    """What changes while a scene is simulated.

    Attributes:
        radii: of all discs, shape (N,) [length].
        grid: of the broad phase.
        giant: radius above which discs are kept out of it [length]; None: there are no such discs.
        substeps: steps of a frame.
        alert: when a disc is too fast.
    """

    radii: NDArray[np.float64]
    grid: Grid
    giant: float | None
    substeps: int
    alert: Alert


def configure(arrays: dict[str, Any], scene: Scene, settings: Settings, now: Present) -> None:
    """Write parameters and control words into the arrays of a block."""
    grid, dt = now.grid, settings.dt / now.substeps
    smallest = float(now.radii.min(initial=scene.largest_radius))
    common = None if has_radii(scene) else scene.largest_radius
    parameters: dict[int, float] = {
        layout.DT: dt,
        layout.DIAMETER: 2 * scene.largest_radius,
        **dict(zip(LIMITS, wall_limits(scene), strict=True)),
        layout.CELLS_PER_X: grid.columns / scene.width,
        layout.CELLS_PER_Y: grid.rows / scene.height,
        layout.EXCHANGE: (1 + scene.restitution) / 2,
        layout.WALL_RESTITUTION: scene.wall_restitution,
        layout.WALL_BOUNCE: scene.wall_restitution if settings.contact == "impact" else 0.0,
        layout.TALLY_SCALE: _tally_scale(scene, settings),
        layout.FAST: now.alert.square(dt, common, smallest, settings.precision),
    }
    for index, value in parameters.items():
        arrays["parameters"][index] = value
    prepare_step(arrays)
    if "giants" in arrays:
        arrays["giants"][0] = np.inf if now.giant is None else now.giant
    control = {
        layout.COUNT: len(now.radii),
        layout.COLUMNS: grid.columns,
        layout.ROWS: grid.rows,
        layout.SUBSTEPS: now.substeps,
        layout.LAW: _LAWS[settings.law],
        layout.CONTACT: _CONTACTS[settings.contact],
        layout.PASSES: settings.passes,
        layout.GUARDED: int(not settings.unguarded),
        layout.CELLS: grid.table_size - 1,
        layout.ABSORBING: sum(1 << EDGES.index(edge) for edge in scene.absorbing),
    }
    for index, word in control.items():
        arrays["control"][index] = word


def _tally_scale(scene: Scene, settings: Settings) -> float:
    """A power of two that makes a typical momentum some 2^32: fine steps, and 2^31 discs' worth of room above."""
    typical = typical_momentum(scene, settings.dt)
    # Where the exponent of the run's floats would end, sums are coarser or the room above is less.
    most = np.finfo(settings.precision).maxexp - 28
    return 2.0 ** float(np.clip(32 - np.frexp(typical)[1], -most, most))
