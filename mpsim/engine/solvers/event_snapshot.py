"""Snapshots of the exact solver: what is in them, and what such a one must be."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.engine.columns import columns_of, has_masses
from mpsim.engine.feature_arrays import has_radii
from mpsim.engine.solvers.snapshots import MOST_STEPS, REAL, Shapes, Snapshot, check_periods, demand, shapes_in_each
from mpsim.kernels.events import state as events
from mpsim.scene.scene import Scene

KEPT = ("disc", "event", "cell_head", "cell_next", "order", "clock", "counter", "tally", "winding", "spin")
"""Arrays of the block that a snapshot holds; radii and masses come beside them, the calendar is made anew."""

SLACK = 1e-6
"""Fraction of a cell by which rounding may have put a centre beyond its limit."""


def arrays_of(scene: Scene) -> dict[str, bool]:
    """Which of the optional arrays of the kernels a scene needs."""
    spins = any(column.name == "spin" for column in columns_of(scene))
    each = {"tally": True, "radius": has_radii(scene), "mass": has_masses(scene), "winding": any(scene.periodic)}
    return each | {"spin": spins}


def shapes(scene: Scene, count: int) -> Shapes:
    """dtype and shape of every array of a snapshot."""
    optional = arrays_of(scene)
    layout = events.layout(count, _cells(scene, count), [name for name in KEPT if optional.get(name)])
    found: Shapes = {name: (np.dtype(layout[name][0]), layout[name][1]) for name in KEPT if name in layout}
    return found | shapes_in_each(count) | {"seen": (REAL, (events.COUNTED,))}


def check(scene: Scene, arrays: Snapshot, frame_end: float) -> None:
    """Raise ValueError unless discs, events and lists of a snapshot go together, before the end of its frame [time]."""
    disc, count = arrays["disc"], len(arrays["order"])
    demand(checks.equal(np.sort(arrays["order"]), np.arange(count)), "order must be a permutation")
    flight = disc[:, [events.X, events.Y, events.VX, events.VY, events.SINCE]]
    demand(np.isfinite(flight).all(), "position, velocity and their time must be finite")
    times = disc[:, [events.IMPACT, events.BORDER, events.LAST]]
    demand("spin" not in arrays or np.isfinite(arrays["spin"]).all(), "spin must be finite")
    demand(not np.isnan(times).any(), "times of events must not be NaN")
    demand((times[:, :2] >= 0).all(), "no event may lie before the present lap")
    demand(np.isfinite(arrays["tally"]).all() and np.isfinite(arrays["seen"]).all(), "counts must be finite")
    _check_clock(arrays, frame_end)
    _check_links(scene, arrays)
    if "winding" in arrays:
        check_periods(scene, arrays["winding"])


def _check_clock(arrays: Snapshot, frame_end: float) -> None:
    clock, counter = arrays["clock"], arrays["counter"]
    now, base, step, lap = clock[[events.NOW, events.BASE, events.STEP, events.LAP]].tolist()
    steps = events.layout(len(arrays["order"]), (1, 1))["step_head"][1][0]
    demand(np.isfinite(clock).all() and base >= 0 and step > 0, "its clock must be finite, its step > 0")
    demand(np.frexp(step)[0] == 0.5 and lap == step * steps, "its step must be a power of two, its lap all steps")
    demand(now <= lap and base + now <= frame_end * (1 + 1e-9), "its present must lie in its lap and frame")
    others = [events.PAIRS, events.WALLS, events.GUARDS, events.EVENTS, events.LAP_EVENTS, events.STALL]
    demand((counter[others] >= 0).all() and (counter <= MOST_STEPS).all(), "counts must be >= 0")


def _check_links(scene: Scene, arrays: Snapshot) -> None:
    """Whatever one array says of the place of something in another must be a place in it."""
    disc, event, count = arrays["disc"], arrays["event"], len(arrays["order"])
    columns, rows = _cells(scene, count)
    partner, side = event[:, events.PARTNER], event[:, events.SIDE]
    demand(((partner >= -1) & (partner < count)).all(), "partners must be discs")
    meets = disc[:, events.IMPACT] < disc[:, events.BORDER]
    demand(((partner >= 0) & (partner != np.arange(count)))[meets].all(), "an impact must have a partner")
    demand(((side >= 0) & (side <= 3)).all(), "a disc leaves its cell by one of four sides")
    for place, cell, length, cells in (
        (disc[:, events.X], event[:, events.COLUMN], scene.width, columns),
        (disc[:, events.Y], event[:, events.ROW], scene.height, rows),
    ):
        demand(((cell >= 0) & (cell < cells)).all(), "a disc must be in a cell of the box")
        beyond = np.abs(place * (cells / length) - (cell + 0.5)) - 0.5
        demand((beyond <= max(SLACK * cells, 1e-3)).all(), "a disc must be in its cell")
    cell_of_disc = event[:, events.ROW].astype(np.int64) * columns + event[:, events.COLUMN]
    demand(cells_of_lists(arrays["cell_head"], arrays["cell_next"]) == cell_of_disc.tolist(), "lists of cells")


def _cells(scene: Scene, count: int) -> tuple[int, int]:
    found: Any = events.plan_cells(scene.width, scene.height, 2 * scene.largest_radius, count, scene.periodic)
    return found


def cells_of_lists(heads: NDArray[np.int32], following: NDArray[np.int32]) -> list[int]:
    """The cell in whose list each disc is, -1 for none; ValueError if the lists lead anywhere else or in a circle."""
    count = len(following)
    for links in (heads, following):
        demand(((links >= -1) & (links < count)).all(), "lists of cells must lead to discs")
    links = np.concatenate([heads[heads >= 0], following[following >= 0]])
    demand(len(np.unique(links)) == len(links), "a disc must be in one list only")
    cells = np.full(count, -1)
    cell = np.flatnonzero(heads >= 0)
    present = heads[cell]
    while len(present):  # no disc is led to twice, so this ends
        cells[present] = cell
        further = following[present] >= 0
        present, cell = following[present][further], cell[further]
    return cells.tolist()
