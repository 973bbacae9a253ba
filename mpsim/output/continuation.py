"""Checks that a trajectory file belongs to a simulation before it is continued."""

import math

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.engine.simulation import Simulation
from mpsim.measure.pairs import lengths_of, to_nearest_image
from mpsim.output.frames import Frame, differs, select
from mpsim.scene.scene import Scene

NEEDED = {"time": "times", "velocity": "velocities", "radius": "radii", "mass": "masses", "ids": "numbers of discs"}
"""What frames must hold to be continued, besides positions, in words: all frames of a file hold the same."""

ROUNDING = 16
"""Multiples of the precision by which computed places may differ: those of a moving wall, and of discs at the start."""


def lacking(frame: Frame) -> list[str]:
    """What mpsim writes but this frame, of another program or an earlier version, lacks, in words."""
    return [words for name, words in NEEDED.items() if name not in frame.known]


def discrepancy(sim: Simulation, now: Frame, first: Frame, last: Frame) -> str | None:
    """Why frames of a file cannot be those of a simulation, in words that follow the file's name; None if they can.

    Box, boundaries, precision and dt must agree, and so must radii and masses of the discs that both have. The discs
    must be possible ones: added discs have new numbers, and absorbed ones do not return. If both hold the same moment,
    the present or the start, positions and velocities must agree too.

    Args:
        sim: as it is now.
        now: its present frame.
        first: of the file; compared with the start of the scene if it is frame 0.
        last: of the file up to now; the first one if all are later.
    """
    wrong = _setting(sim, now, last) or _discs(sim, now, last)
    if wrong is None and last.frame == now.frame:
        # The frame may have been written before discs were added at it; they are in the next one.
        wrong = differs(last, select(now, last.ids))
    if wrong is not None:
        return f"at frame {last.frame} {wrong}"
    if first.frame == 0 and not _begins_as(sim.scene, first):
        return "its frame 0 shows another start of such a scene"
    return None


def _setting(sim: Simulation, now: Frame, last: Frame) -> str | None:
    """What differs of box, boundaries, precision and dt."""
    if last.periodic != now.periodic:
        return f"its periodic axes (x, y) are {last.periodic} and not {now.periodic}"
    if last.position.dtype != now.position.dtype:
        return f"its precision is {last.position.dtype} and not {now.position.dtype}"
    since, began = sim.origin
    if last.frame < since or last.time < sim.scene.piston_began:  # dt or the piston's speed has been changed after it
        return None
    time = began + (last.frame - since) * sim.settings.dt
    if not math.isclose(last.time, time, rel_tol=1e-9):
        return f"its time is {last.time:g} and not {time:g}, as dt = {sim.settings.dt:g} makes it"
    corners = np.array([*last.origin, *np.add(last.origin, last.box)])
    expected = np.concatenate(sim.scene.walls_at(time))
    if np.abs(corners - expected).max() > _slack(sim.scene, last):
        return f"its box is {_walls(corners)} and not {_walls(expected)}"
    return None


def _discs(sim: Simulation, now: Frame, last: Frame) -> str | None:
    """What differs of the discs: which are present, radii and masses."""
    behind = last.frame <= now.frame
    highest = int(last.ids.max(initial=-1))
    if behind and highest >= sim.count:
        return f"it has a disc {highest}, and the simulation has only {sim.count}"
    known = last.ids < sim.count
    ids = last.ids[known]
    for name, theirs, ours in (("radius", last.radius, sim.radii), ("mass", last.mass, sim.masses)):
        other = np.flatnonzero(theirs[known] != ours[ids])
        if len(other):
            disc = int(ids[other[0]])
            return f"its {name} of disc {disc} is {theirs[known][other[0]]:g} and not {ours[disc]:g}"
    if behind:
        back = now.ids[~np.isin(now.ids, last.ids) & (now.ids < max(highest + 1, sim.scene.count))]
        if len(back):
            return f"it has no disc {back[0]}, and the simulation has had it from before"
    return None


def _begins_as(scene: Scene, first: Frame) -> bool:
    """Whether the discs of the scene are in the first frame where they start, as fast as they start."""
    ids = np.arange(scene.count)
    start = select(first, ids)
    if not checks.equal(start.ids, ids):
        return False
    offset = np.abs(to_nearest_image(start.position - scene.position, lengths_of(scene)))
    change, fastest = np.abs(start.velocity - scene.velocity), float(np.abs(scene.velocity).max(initial=0.0))
    rounding = ROUNDING * float(np.finfo(first.position.dtype).eps)
    return bool((offset <= _slack(scene, first)).all() and (change <= rounding * fastest).all())


def _slack(scene: Scene, frame: Frame) -> float:
    """Rounding of a place in the box [length]."""
    return ROUNDING * float(np.finfo(frame.position.dtype).eps) * max(scene.width, scene.height)


def _walls(corners: NDArray[np.float64]) -> str:
    """Corners (x, y) of a box, lower left and upper right, in words."""
    x_low, y_low, x_high, y_high = corners
    return f"[{x_low:g}, {x_high:g}] x [{y_low:g}, {y_high:g}]"
