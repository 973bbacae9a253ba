"""`naive` and `grid` visit the same contacts in different orders, and that is all that they differ by.

A contact's result does not depend on which of the two discs comes first. So the bits are the same as long as no disc
has two contacts in one frame; where discs have several, the order in which they are resolved matters a little.
"""

import numpy as np
import pytest
from support.compare import assert_same_bits, overlapping_pairs
from support.scenes import gas, state_after

import mpsim

pytestmark = pytest.mark.compiled


def tangled_discs(scene, dt):
    """Discs in groups of touching discs in which some disc has two contacts or more, in the first frame.

    A push moves each disc by half of an overlap, so a pair counts if its gap is less than the deepest overlap.
    """
    moved = scene.position + scene.velocity * dt
    moved = np.clip(moved, scene.radius, np.array([scene.width, scene.height]) - scene.radius)
    deepest = (2 * scene.radius - overlapping_pairs(moved, 2 * scene.radius)[2]).max(initial=0)
    i, j = overlapping_pairs(moved, 2 * scene.radius + deepest)[:2]
    tangled = np.bincount(np.concatenate([i, j]), minlength=scene.count) > 1
    for _ in range(scene.count):
        spread = tangled.copy()
        spread[i] |= tangled[j]
        spread[j] |= tangled[i]
        if (spread == tangled).all():
            break
        tangled = spread
    return tangled


@pytest.mark.parametrize("contact", ["push", "impact"])
def test_the_bits_of_pairs_at_one_point_are_equal(contact):
    point = np.stack(np.divmod(np.arange(16), 4), axis=1) * 5.0 + 2.5
    scene = mpsim.Scene(width=20, height=20, position=np.tile(point, (2, 1)), velocity=np.ones((32, 2)), radius=0.5)
    naive, grid = (state_after(scene, 3, method=method, contact=contact, dt=0.02) for method in ("naive", "grid"))
    assert_same_bits(naive, grid, contact)
    directions = np.round((grid.position[16:] - grid.position[:16]), 6)
    assert len({tuple(each) for each in directions}) == 16, "pairs of different ids part in the same direction"


@pytest.mark.parametrize("law", ["elastic", "reflect"])
def test_in_one_frame_only_discs_in_groups_with_several_contacts_differ(law):
    scene, dt = gas(1000, 0.7, seed=22), 0.02
    naive, grid = (state_after(scene, 1, method=method, law=law, dt=dt) for method in ("naive", "grid"))
    tangled = tangled_discs(scene, dt)
    alone = ~tangled
    assert min(tangled.sum(), alone.sum()) > 20, f"{tangled.sum()} of {scene.count} discs have entangled contacts"
    left, right = (mpsim.State(each.position[alone], each.velocity[alone]) for each in (naive, grid))
    assert_same_bits(left, right, "discs without entangled contacts")
    assert (naive.position[tangled] != grid.position[tangled]).any(), "the orders do not differ, which tests nothing"
