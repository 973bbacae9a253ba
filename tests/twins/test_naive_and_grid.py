"""`naive` and `grid` visit the same contacts in different orders, and that is all that they differ by.

A contact's result does not depend on which of the two discs comes first. So the bits are the same as long as no disc
has two contacts in one frame; where discs have several, the order in which they are resolved matters a little.
"""

import numpy as np
import pytest
from support.compare import assert_same_bits, overlapping_pairs
from support.scenes import crowd, gas, simulate, state_after

import mpsim


def contacts_of_next_frame(state, scene, dt):
    """Pairs i, j that overlap after the motion of the next frame, or may be pushed into each other then.

    A push moves each disc by half of an overlap, so a pair counts if its gap is less than the deepest overlap.
    """
    moved = state.position.astype(float) + state.velocity.astype(float) * dt
    moved = np.clip(moved, scene.radius, np.array([scene.width, scene.height]) - scene.radius)
    distances = overlapping_pairs(moved, 2 * scene.radius)[2]
    deepest = (2 * scene.radius - distances).max(initial=0)
    return overlapping_pairs(moved, 2 * scene.radius + deepest)[:2]


def chains(pairs_i, pairs_j, count):
    """For each disc whether it is in a group of touching discs in which some disc has two contacts or more."""
    contacts = np.bincount(np.concatenate([pairs_i, pairs_j]), minlength=count)
    tangled = contacts > 1
    for _ in range(count):
        spread = tangled.copy()
        spread[pairs_i] |= tangled[pairs_j]
        spread[pairs_j] |= tangled[pairs_i]
        if (spread == tangled).all():
            break
        tangled = spread
    return tangled


@pytest.mark.slow
@pytest.mark.parametrize("law", ["elastic", "reflect"])
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_the_bits_are_equal_as_long_as_no_disc_has_two_contacts_in_a_frame(law, precision):
    scene, dt, contacts = gas(300, 0.03, seed=21), 0.005, 0
    settings = {"law": law, "precision": precision, "dt": dt}
    with simulate(scene, method="naive", **settings) as naive, simulate(scene, method="grid", **settings) as grid:
        for frame in range(700):
            i, j = contacts_of_next_frame(grid.state, scene, dt)
            if chains(i, j, scene.count).any():
                break
            contacts += naive.run(frames=1).collisions
            grid.run(frames=1)
            assert_same_bits(naive.state, grid.state, f"frame {frame}, {settings}")
    assert contacts > 30, f"only {contacts} contacts before the first disc with two: this tests little"


@pytest.mark.parametrize("contact", ["push", "impact"])
def test_the_bits_of_pairs_at_one_point_are_equal(contact):
    point = np.stack(np.divmod(np.arange(16), 4), axis=1) * 5.0 + 2.5
    scene = mpsim.Scene(width=20, height=20, position=np.tile(point, (2, 1)), velocity=np.ones((32, 2)), radius=0.5)
    naive, grid = (state_after(scene, 3, method=method, contact=contact, dt=0.02) for method in ("naive", "grid"))
    assert_same_bits(naive, grid, contact)
    directions = np.round((grid.position[16:] - grid.position[:16]), 6)
    assert len({tuple(each) for each in directions}) == 16, "pairs of different ids part in the same direction"


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_in_one_frame_only_discs_in_groups_with_several_contacts_differ(precision):
    scene, dt = gas(1000, 0.7, seed=22), 0.02
    settings = {"precision": precision, "dt": dt}
    naive, grid = (state_after(scene, 1, method=method, **settings) for method in ("naive", "grid"))
    start = mpsim.State(scene.position, scene.velocity)
    tangled = chains(*contacts_of_next_frame(start, scene, dt), scene.count)
    alone = ~tangled
    assert min(tangled.sum(), alone.sum()) > 20, f"{tangled.sum()} of {scene.count} discs have entangled contacts"
    assert_same_bits(
        mpsim.State(naive.position[alone], naive.velocity[alone]),
        mpsim.State(grid.position[alone], grid.velocity[alone]),
        "discs without entangled contacts",
    )
    assert (naive.position[tangled] != grid.position[tangled]).any(), "the orders do not differ, which tests nothing"


def test_after_one_frame_positions_differ_by_less_than_the_overlaps_that_were_resolved():
    """How far: a fraction of the overlap, at most about v dt, where a push of one contact changes the next."""
    scene, dt = gas(1000, 0.7, seed=22), 0.02
    naive, grid = (state_after(scene, 1, method=method, dt=dt) for method in ("naive", "grid"))
    fastest = np.hypot(*scene.velocity.T).max()
    apart = np.abs(naive.position - grid.position).max()
    assert 0 < apart < fastest * dt, f"positions are {apart:.3g} apart; the fastest disc moves {fastest * dt:.3g}"


def test_the_two_orders_agree_in_what_is_conserved():
    scene = crowd(400, 0.6, seed=23)
    for state in (state_after(scene, 200, method=method, dt=0.02) for method in ("naive", "grid")):
        energy = (state.velocity**2).sum()
        assert energy == pytest.approx((scene.velocity**2).sum(), rel=1e-12)
