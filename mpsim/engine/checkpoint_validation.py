"""Checks whether the state in a checkpoint is possible for its scene."""

import math
from typing import Any

import numpy as np

from mpsim.core import checks
from mpsim.core.archive import Arrays
from mpsim.engine.checkpoint import Checkpoint
from mpsim.engine.journal import parameters_after
from mpsim.engine.solvers import event_snapshot
from mpsim.engine.solvers.methods import METHODS, choose
from mpsim.engine.solvers.snapshots import MOST_STEPS, count_in, demand
from mpsim.engine.step_limits import MOST_SUBSTEPS
from mpsim.features.masses import has_masses
from mpsim.features.radii import has_radii
from mpsim.scene.scene import LARGEST_COUNT, Scene
from mpsim.scene.settings import Settings

NOT_IN_ALL_FILES = {"image", "winding", event_snapshot.CRUSHING_SPEED}
"""Arrays that older files lack: counts of periods those of format 1, which count from there on."""


def check(found: Checkpoint) -> None:
    """Raise ValueError for a checkpoint in which no simulation can have been, saying why."""
    arrays, changed = found.arrays, found.changed
    scene, settings = parameters_after(found.scene, found.settings, changed.changes)
    count = count_in(arrays)
    demand(scene.count <= count <= LARGEST_COUNT, f"it has {count} discs; its scene has {scene.count}")
    solver = METHODS[choose(count, settings).method].solver
    shapes = solver.snapshot_shapes(scene, settings, count)
    missing = shapes.keys() - arrays.keys()
    demand(
        arrays.keys() <= shapes.keys() and missing <= NOT_IN_ALL_FILES,
        f"it holds arrays {sorted(arrays)}; needed are {sorted(shapes)}",
    )
    for name, array in arrays.items():
        dtype, shape = shapes[name]
        demand(
            array.dtype == dtype and array.shape == shape,
            f"{name} must be {dtype} of shape {shape}; got {array.dtype} of shape {array.shape}",
        )
    _check_sizes(scene, arrays)
    frames, second = arrays["progress"].tolist()
    demand(0 <= frames <= MOST_STEPS and second >= 0, f"frames and steps must be >= 0; got {frames}, {second}")
    frame = changed.origin.frame + frames
    demand(found.run["frame"] == frame, f"its frame must be {frame}; got {found.run['frame']!r}")
    _check_emission(scene, found.run["emission"], count)
    if solver.capabilities.has_steps:
        _check_steps(settings, frames, second)
    solver.check_snapshot(scene, settings, arrays)


def _check_steps(settings: Settings, frames: int, steps: int) -> None:
    """Every frame has had as many steps: those that are set, or that on_fast="substep" has chosen."""
    most = max(MOST_SUBSTEPS, settings.substeps) if settings.on_fast == "substep" else settings.substeps
    each, rest = divmod(steps, frames) if frames else (settings.substeps, steps)
    demand(rest == 0 and settings.substeps <= each <= most, f"{frames} frames cannot have {steps} steps")


def _check_sizes(scene: Scene, arrays: Arrays) -> None:
    """Radii and masses: those of the scene first, and no disc larger than its largest."""
    radii, masses = arrays["radii"], arrays["masses"]
    for name, values, own in (("radii", radii, scene.radii), ("masses", masses, scene.masses)):
        demand(checks.equal(values[: len(own)], own), f"{name} must begin with those of the scene")
        demand((np.isfinite(values) & (values > 0)).all(), f"{name} must be finite and > 0")
    demand((radii <= scene.largest_radius).all(), "radii must be at most that of the scene's largest disc")
    demand(has_radii(scene) or (radii == scene.largest_radius).all(), "all discs of this scene have one radius")
    demand(has_masses(scene) or (masses == 1).all(), "all discs of this scene have mass 1")


def _check_emission(scene: Scene, emission: Any, count: int) -> None:
    """What emitters have done: whole numbers, one each, and no more discs than there are."""
    known = isinstance(emission, dict) and emission.keys() - {"since"} == {"emitted", "due"}
    demand(known, "emission must have emitted and due")
    for name, values in emission.items():
        if name == "since":
            times = isinstance(values, list) and all(type(value) is float and math.isfinite(value) for value in values)
            demand(times and len(values) == len(scene.emitters), "since must be one time per emitter")
            continue
        whole = isinstance(values, list) and all(type(value) is int and 0 <= value <= MOST_STEPS for value in values)
        demand(whole and len(values) == len(scene.emitters), f"{name} must be one whole number per emitter")
    demand(sum(emission["emitted"]) <= count - scene.count, "emitters cannot have added more discs than there are")
