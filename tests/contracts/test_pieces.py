"""A run in pieces, watched, or grown on the way has the bits of the run in one piece."""

import time

import numpy as np
import pytest
from support.compare import assert_same_bits
from support.internals import block_name, memory_order, scramble
from support.scenes import crowd, digest_after, gas, simulate, state_after

pytestmark = pytest.mark.compiled

METHODS = [("naive", 1), ("grid", 1), ("parallel", 3)]
COUNT, FRAMES = 400, 24


def overwrite(values):
    """Write zeros where an array that cannot be written has its values."""
    owner = values if values.base is None else values.base
    owner.flags.writeable = True
    owner[:] = 0


@pytest.mark.parametrize(("method", "workers"), METHODS)
def test_a_run_in_pieces_that_is_looked_at_has_the_bits_of_one_run(method, workers):
    settings = {"method": method, "workers": workers, "dt": 0.02, "substeps": 2}
    expected = state_after(crowd(COUNT, 0.8, seed=1), FRAMES, **settings)
    with simulate(crowd(COUNT, 0.8, seed=1), **settings) as sim:
        for frames in (1, 1, 1, 7, 0, 1, 13):
            sim.run(frames=frames, progress=lambda done, of: time.sleep(0.0005))
            assert len(sim.digest()) == 32
            overwrite(sim.state.position)  # a copy
        assert sim.frame == FRAMES
        assert_same_bits(sim.state, expected, "in pieces")


def grow(method, workers, pieces, scene):
    """State after a growth experiment, and the number of blocks: `pieces` of discs are added, each after two frames."""
    rng = np.random.default_rng(4)
    places = 0.5 + rng.random((sum(pieces), 2)) * (scene.width - 1)
    speeds = rng.normal(size=(sum(pieces), 2))
    blocks, added = set(), 0
    with simulate(scene, method=method, workers=workers, dt=0.02) as sim:
        for size in pieces:
            sim.run(frames=2)
            sim.add(places[added : added + size], speeds[added : added + size])
            added += size
            blocks.add(block_name(sim))
        sim.run(frames=10)
        assert sim.count == scene.count + added
        return sim.state, len(blocks)


@pytest.mark.parametrize(
    ("method", "pieces", "packing", "on_workers"),
    [("grid", [1] * 20 + [5] * 10 + [40], 0.1, ("parallel", 3)), ("auto", [80] * 10, 0.01, ("auto", 2))],
)
def test_growth_has_the_same_bits_on_workers_in_larger_blocks_and_where_auto_changes_its_method(
    method, pieces, packing, on_workers
):
    scene = gas(30, packing, seed=3)
    expected, _ = grow(method, 1, pieces, scene)
    state, blocks = grow(*on_workers, pieces, scene)
    assert blocks > 2, "the block never grew, which tests half of it"
    assert_same_bits(state, expected, f"growth by {on_workers}")


def test_discs_added_one_by_one_or_together_give_the_same_bits():
    scene = gas(50, 0.2, seed=6)
    with simulate(scene, method="grid") as one, simulate(scene, method="grid") as other:
        places, speeds = scene.position[:6] * 0.99 + 0.01 * scene.width / 2, scene.velocity[:6]
        for place, speed in zip(places, speeds, strict=True):
            one.add(place, speed)
        other.add(places, speeds)
        one.run(frames=30)
        other.run(frames=30)
        assert_same_bits(one.state, other.state, "added one by one")


@pytest.mark.parametrize(("method", "workers"), [("grid", 1), ("parallel", 2)])
def test_the_order_of_the_discs_in_memory_does_not_matter(method, workers):
    settings = {"method": method, "workers": workers, "dt": 0.02}
    expected = digest_after(crowd(COUNT, 0.8, seed=8), FRAMES, **settings)
    with simulate(crowd(COUNT, 0.8, seed=8), **settings) as sim:
        for piece in range(FRAMES // 4):
            before = memory_order(sim)
            scramble(sim, seed=piece)  # no user can: in what order frames before have left them
            assert memory_order(sim) != before
            sim.run(frames=4)
        assert sim.digest() == expected, "the memory order left by earlier frames has changed the result"
