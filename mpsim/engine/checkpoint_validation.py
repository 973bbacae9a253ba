"""Whether a simulation can be in the state that a checkpoint holds.

The digest of a file tells that it is what was written. Whoever writes a file of his own can give it the right digest;
kernels index arrays without looking, so nothing that they follow may lead out of them.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.core.archive import Arrays
from mpsim.engine.checkpoint import Checkpoint
from mpsim.engine.feature_arrays import has_masses, has_radii
from mpsim.engine.step_limits import MOST_SUBSTEPS
from mpsim.kernels.events import state as events
from mpsim.scene.scene import LARGEST_COUNT, Scene

MOST_STEPS = 2**60

SLACK = 1e-6
"""Part of the box, or of a cell, by which rounding may have put a centre beyond its limit."""

COUNTS_OF_PERIODS = {"image", "winding"}
"""Arrays that files of format 1 lack: they count from there on."""

_INTEGER, _REAL = np.dtype(np.int64), np.dtype(np.float64)


def check(found: Checkpoint) -> None:
    """Raise ValueError for a checkpoint in which no simulation can have been, saying why."""
    scene, arrays = found.scene, found.arrays
    exact = found.settings.method == "event"
    count = len(arrays["order" if exact else "position"])
    _demand(scene.count <= count <= LARGEST_COUNT, f"it has {count} discs; its scene has {scene.count}")
    shapes = exact_arrays(scene, count) if exact else stepped_arrays(scene, count, np.dtype(found.settings.precision))
    missing = shapes.keys() - arrays.keys()
    _demand(
        arrays.keys() <= shapes.keys() and missing <= COUNTS_OF_PERIODS,
        f"it holds arrays {sorted(arrays)}; needed are {sorted(shapes)}",
    )
    for name, array in arrays.items():
        dtype, shape = shapes[name]
        _demand(
            array.dtype == dtype and array.shape == shape,
            f"{name} must be {dtype} of shape {shape}; got {array.dtype} of shape {array.shape}",
        )
    _check_sizes(scene, arrays)
    frames, second = arrays["progress"].tolist()
    _demand(0 <= frames <= MOST_STEPS and second >= 0, f"frames and steps must be >= 0; got {frames}, {second}")
    _demand(found.run["frame"] == frames, f"its frame must be {frames}; got {found.run['frame']!r}")
    _check_emission(scene, found.run["emission"], count)
    if exact:
        _check_exact(scene, arrays, (frames + 1) * found.settings.dt)
    else:
        substeps, adapts = found.settings.substeps, found.settings.on_fast == "substep"
        most = max(MOST_SUBSTEPS, substeps) if adapts else substeps
        each, rest = divmod(second, frames) if frames else (substeps, second)
        _demand(rest == 0 and substeps <= each <= most, f"{frames} frames cannot have {second} steps")
        _check_stepped(scene, arrays)


Shapes = dict[str, tuple[np.dtype[Any], tuple[int, ...]]]


def stepped_arrays(scene: Scene, count: int, real: np.dtype[Any]) -> Shapes:
    """dtype and shape of every array of a snapshot of the stepped solver."""
    shapes: Shapes = {"position": (real, (count, 2)), "velocity": (real, (count, 2))}
    if scene.acceleration is not None:
        shapes["acceleration"] = real, (count, 2)
    if scene.absorbing:
        shapes["exits"] = real, (3, count)
    if any(scene.periodic):
        shapes["image"] = _INTEGER, (2, count)
    return shapes | {"radii": (_REAL, (count,)), "masses": (_REAL, (count,)), "progress": (_INTEGER, (2,))}


def exact_arrays(scene: Scene, count: int) -> Shapes:
    """dtype and shape of every array of a snapshot of the exact solver."""
    cells: Any = events.plan_cells(scene.width, scene.height, 2 * scene.largest_radius, count, scene.periodic)
    names = ("disc", "event", "cell_head", "cell_next", "order", "clock", "counter", "tally")
    layout = events.layout(count, cells, ["tally", "winding"])
    names += ("winding",) if any(scene.periodic) else ()
    shapes: Shapes = {name: (np.dtype(layout[name][0]), layout[name][1]) for name in names}
    shapes |= {"radii": (_REAL, (count,)), "masses": (_REAL, (count,))}
    return shapes | {"progress": (_INTEGER, (2,)), "seen": (_REAL, (events.COUNTED,))}


def _demand(condition: Any, text: str) -> None:
    if not condition:
        raise ValueError(text)


def _check_sizes(scene: Scene, arrays: Arrays) -> None:
    """Radii and masses: those of the scene first, and no disc larger than its largest."""
    radii, masses = arrays["radii"], arrays["masses"]
    for name, values, own in (("radii", radii, scene.radii), ("masses", masses, scene.masses)):
        _demand(checks.equal(values[: len(own)], own), f"{name} must begin with those of the scene")
        _demand((np.isfinite(values) & (values > 0)).all(), f"{name} must be finite and > 0")
    _demand((radii <= scene.largest_radius).all(), "radii must be at most that of the scene's largest disc")
    _demand(has_radii(scene) or (radii == scene.largest_radius).all(), "all discs of this scene have one radius")
    _demand(has_masses(scene) or (masses == 1).all(), "all discs of this scene have mass 1")


def _check_emission(scene: Scene, emission: Any, count: int) -> None:
    """What emitters have done: whole numbers, one each, and no more discs than there are."""
    _demand(isinstance(emission, dict) and emission.keys() == {"emitted", "due"}, "emission must have emitted and due")
    for name, values in emission.items():
        whole = isinstance(values, list) and all(type(value) is int and 0 <= value <= MOST_STEPS for value in values)
        _demand(whole and len(values) == len(scene.emitters), f"{name} must be one whole number per emitter")
    _demand(sum(emission["emitted"]) <= count - scene.count, "emitters cannot have added more discs than there are")


def _check_stepped(scene: Scene, arrays: Arrays) -> None:
    _demand(np.isfinite(arrays["velocity"]).all(), "velocity must be finite")
    _check_places(scene, arrays["position"])
    if "acceleration" in arrays:
        _demand(np.isfinite(arrays["acceleration"]).all(), "acceleration must be finite")
    if "exits" in arrays:
        gone, *places = arrays["exits"]
        _demand(((gone == 0) | (gone == 1)).all(), "a disc has left or it has not")
        _check_places(scene, np.stack(places, axis=1))
    if "image" in arrays:
        _check_periods(scene, arrays["image"].T)


def _check_periods(scene: Scene, image: NDArray[np.int64]) -> None:
    """Counts of periods, shape (N, 2), are 0 along axes with walls."""
    _demand((image[:, ~np.array(scene.periodic)] == 0).all(), "no disc can have moved through a wall")


def _check_places(scene: Scene, position: NDArray[np.floating]) -> None:
    """Centres between walls are in the box; through a periodic border a contact may have moved them."""
    for axis, length in enumerate((scene.width, scene.height)):
        places = position[:, axis]
        _demand(np.isfinite(places).all(), "position must be finite")
        inside = (places >= -SLACK * length) & (places <= (1 + SLACK) * length)
        _demand(scene.periodic[axis] or inside.all(), "position must be in the box")


# --- the exact solver


def _check_exact(scene: Scene, arrays: Arrays, frame_end: float) -> None:
    disc, count = arrays["disc"], len(arrays["order"])
    _demand(checks.equal(np.sort(arrays["order"]), np.arange(count)), "order must be a permutation")
    flight = disc[:, [events.X, events.Y, events.VX, events.VY, events.SINCE]]
    _demand(np.isfinite(flight).all(), "position, velocity and their time must be finite")
    times = disc[:, [events.IMPACT, events.BORDER, events.LAST]]
    _demand(not np.isnan(times).any(), "times of events must not be NaN")
    _demand((times[:, :2] >= 0).all(), "no event may lie before the present lap")
    _demand(np.isfinite(arrays["tally"]).all() and np.isfinite(arrays["seen"]).all(), "counts must be finite")
    _check_clock(arrays, frame_end)
    _check_links(scene, arrays)
    if "winding" in arrays:
        _check_periods(scene, arrays["winding"])


def _check_clock(arrays: Arrays, frame_end: float) -> None:
    clock, counter = arrays["clock"], arrays["counter"]
    now, base, step, lap = clock[[events.NOW, events.BASE, events.STEP, events.LAP]].tolist()
    steps = events.layout(len(arrays["order"]), (1, 1))["step_head"][1][0]
    _demand(np.isfinite(clock).all() and base >= 0 and step > 0, "its clock must be finite, its step > 0")
    _demand(np.frexp(step)[0] == 0.5 and lap == step * steps, "its step must be a power of two, its lap all steps")
    _demand(now <= lap and base + now <= frame_end * (1 + 1e-9), "its present must lie in its lap and frame")
    others = [events.PAIRS, events.WALLS, events.GUARDS, events.EVENTS, events.LAP_EVENTS, events.STALL]
    _demand((counter[others] >= 0).all() and (counter <= MOST_STEPS).all(), "counts must be >= 0")


def _check_links(scene: Scene, arrays: Arrays) -> None:
    """Whatever one array says of the place of something in another must be a place in it."""
    disc, event, count = arrays["disc"], arrays["event"], len(arrays["order"])
    columns, rows = _cells(scene, count)
    partner, side = event[:, events.PARTNER], event[:, events.SIDE]
    _demand(((partner >= -1) & (partner < count)).all(), "partners must be discs")
    meets = disc[:, events.IMPACT] < disc[:, events.BORDER]
    _demand(((partner >= 0) & (partner != np.arange(count)))[meets].all(), "an impact must have a partner")
    _demand(((side >= 0) & (side <= 3)).all(), "a disc leaves its cell by one of four sides")
    for place, cell, length, cells in (
        (disc[:, events.X], event[:, events.COLUMN], scene.width, columns),
        (disc[:, events.Y], event[:, events.ROW], scene.height, rows),
    ):
        _demand(((cell >= 0) & (cell < cells)).all(), "a disc must be in a cell of the box")
        beyond = np.abs(place * (cells / length) - (cell + 0.5)) - 0.5
        _demand((beyond <= max(SLACK * cells, 1e-3)).all(), "a disc must be in its cell")
    cell_of_disc = event[:, events.ROW].astype(np.int64) * columns + event[:, events.COLUMN]
    _demand(cells_of_lists(arrays["cell_head"], arrays["cell_next"]) == cell_of_disc.tolist(), "lists of cells")


def _cells(scene: Scene, count: int) -> tuple[int, int]:
    found: Any = events.plan_cells(scene.width, scene.height, 2 * scene.largest_radius, count, scene.periodic)
    return found


def cells_of_lists(heads: NDArray[np.int32], following: NDArray[np.int32]) -> list[int]:
    """The cell in whose list each disc is, -1 for none; ValueError if the lists lead anywhere else or in a circle."""
    count = len(following)
    for links in (heads, following):
        _demand(((links >= -1) & (links < count)).all(), "lists of cells must lead to discs")
    links = np.concatenate([heads[heads >= 0], following[following >= 0]])
    _demand(len(np.unique(links)) == len(links), "a disc must be in one list only")
    cells = np.full(count, -1)
    cell = np.flatnonzero(heads >= 0)
    present = heads[cell]
    while len(present):  # no disc is led to twice, so this ends
        cells[present] = cell
        further = following[present] >= 0
        present, cell = following[present][further], cell[further]
    return cells.tolist()
