"""Room for a disc or a wall that a user puts among discs: those in the way are pushed aside, as few as possible."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.errors import InputError
from mpsim.features.capsules import gaps, of_discs, shifted, with_images
from mpsim.measure.observables import to_nearest_image
from mpsim.scene.starts import GAP, pushed_aside

if TYPE_CHECKING:
    from mpsim.engine.simulation import Simulation

Floats = NDArray[np.float64]

NEAR, FAR = 4.0, 64.0
"""Distance up to which discs are pushed at first, and in the end, in radii of the largest disc; it is doubled."""

BARRIER = 3.0  # thickness of the layer of discs that stay and keep in those that are pushed, in the same unit


def make_room(sim: Simulation, capsules: Floats) -> None:
    """Push discs aside that overlap capsules, shape (K, ROW).

    Raises:
        InputError: if there is no room for them; then nothing has changed.
    """
    for ids, position in room_for(sim, capsules):
        sim.set(ids, position=position)


def room_for(sim: Simulation, capsules: Floats) -> list[tuple[NDArray[np.int64], Floats]]:
    """Ids of discs that must make room for capsules, and their new places; [] if none must."""
    if not len(capsules):
        return []
    scene, state = sim.scene, sim.state
    numbers, radius = np.flatnonzero(state.present), sim.radii[state.present]
    low, high = scene.walls_at(sim.time)
    position, (width, height) = state.position[numbers].astype(np.float64) - low, (high - low).tolist()
    largest = float(radius.max(initial=0.0))
    images = with_images(shifted(capsules, -low), (width, height), scene.periodic, width + height).capsule
    gap = np.min([gaps(position, radius, each) for each in images], axis=0)
    if not (gap < 0).any():
        return []
    solid = shifted(np.concatenate([scene._capsules_at(sim.time), capsules]), -low)
    rounding = 8 * checks.resolution(state.position) * max(scene.width, scene.height)
    scale = 1 + GAP + rounding / float(radius.min())
    reach = NEAR * largest
    while True:
        near = gap < reach
        fixed, around = (~near & (gap < reach + layer * largest) for layer in (BARRIER, 3 * BARRIER))
        others = np.concatenate([solid, of_discs(position[fixed], radius[fixed])])
        found = pushed_aside(position[near], radius[near], (width, height), scene.periodic, others, scale)
        if found is not None:
            moved = (found != position[near]).any(axis=1)
            apart = to_nearest_image(found[moved, None] - position[around], scene)
            if (np.hypot(*np.moveaxis(apart, -1, 0)) >= radius[near][moved, None] + radius[around]).all():
                return [(numbers[near][moved], found[moved] + low)]
        if near.all() or reach >= FAR * largest:
            raise InputError("there must be room for it; got too little between the discs. Remove some of them.")
        reach *= 2
