"""A run in pieces, watched, or grown on the way has the bits of the run in one piece."""

import dataclasses
import time

import numpy as np
import pytest
from support.compare import assert_same_bits
from support.internals import block_name, memory_order, scramble
from support.scenes import crowd, digest_after, features_of, gas, simulate, state_after

METHODS = [("naive", 1), ("grid", 1), ("parallel", 3)]
COUNT, FRAMES = 400, 24


@pytest.mark.slow
@pytest.mark.parametrize(("method", "workers"), METHODS)
@pytest.mark.parametrize("pieces", [[1] * FRAMES, [7, 0, 1, 16], [23, 1]])
def test_a_run_in_pieces_has_the_bits_of_one_run(method, workers, pieces):
    settings = {"method": method, "workers": workers, "dt": 0.02, "substeps": 3}
    expected = state_after(crowd(COUNT, 0.8, seed=1), FRAMES, **settings)
    with simulate(crowd(COUNT, 0.8, seed=1), **settings) as sim:
        for frames in pieces:
            sim.run(frames=frames)
        assert sim.frame == FRAMES
        assert_same_bits(sim.state, expected, f"pieces {pieces}")


@pytest.mark.parametrize(("method", "workers"), METHODS)
def test_looking_on_does_not_change_the_bits(method, workers):
    settings = {"method": method, "workers": workers, "dt": 0.02}
    expected = state_after(crowd(COUNT, 0.8, seed=2), FRAMES, **settings)
    with simulate(crowd(COUNT, 0.8, seed=2), **settings) as sim:
        for _ in range(FRAMES // 4):
            sim.run(frames=4, progress=lambda done, of: time.sleep(0.003))
            assert len(sim.digest()) == 32
            sim.state.position.base[:] = 0
        assert_same_bits(sim.state, expected, "with progress, digests and a spoilt copy of the state")


def grow(method, workers, pieces, scene=None, capacity=None):
    """State after a growth experiment: `pieces` of discs are added, one piece after each two frames."""
    scene = scene or gas(30, 0.1, seed=3)
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


@pytest.mark.parametrize("workers", [2, 3])
def test_growth_has_the_same_bits_on_workers_also_when_they_move_to_a_larger_block(workers):
    pieces = [1] * 20 + [5] * 10 + [40]
    expected, _ = grow("grid", 1, pieces)
    state, blocks = grow("parallel", workers, pieces)
    assert blocks > 2, "the block never grew, which tests half of it"
    assert_same_bits(state, expected, f"growth on {workers} workers")


def test_auto_changes_its_method_while_growing_and_has_the_bits_on_any_number_of_workers():
    pieces = [40] * 20
    scene = gas(30, 0.01, seed=5)
    expected, _ = grow("auto", 1, pieces, scene)
    state, _ = grow("auto", 2, pieces, scene)
    assert_same_bits(state, expected, "auto on 2 workers")


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


def test_accelerations_follow_their_discs_through_growth():
    scene = crowd(60, 0.5, seed=7, **features_of("gravity and acceleration", 60))
    states = []
    for method, workers in (("grid", 1), ("parallel", 2)):
        with simulate(scene, method=method, workers=workers) as sim:
            sim.run(frames=3)
            sim.add([[2, 2], [3, 4]], [[1, 0], [0, 1]], acceleration=[[5, 0], [0, -5]])
            sim.run(frames=20)
            states.append(sim.state)
    assert_same_bits(states[1], states[0], "with accelerations")
    still = simulate(scene, method="grid")
    with still:
        still.run(frames=3)
        still.add([[2, 2], [3, 4]], [[1, 0], [0, 1]])
        still.run(frames=20)
        assert not np.array_equal(still.state.velocity, states[0].velocity), "acceleration of added discs has no effect"


@pytest.mark.parametrize(("method", "workers"), [("grid", 1), ("parallel", 2), ("parallel", 3)])
def test_the_order_of_the_discs_in_memory_does_not_matter(method, workers):
    settings = {"method": method, "workers": workers, "dt": 0.02}
    expected = digest_after(crowd(COUNT, 0.8, seed=8), FRAMES, **settings)
    with simulate(crowd(COUNT, 0.8, seed=8), **settings) as sim:
        for piece in range(FRAMES // 4):
            before = memory_order(sim)
            scramble(sim, seed=piece)
            assert memory_order(sim) != before
            sim.run(frames=4)
        assert sim.digest() == expected, "the memory order left by earlier frames has changed the result"


def test_the_digest_notices_a_single_bit():
    scene = gas(100, 0.3, seed=9)
    with simulate(scene, method="grid") as sim:
        state, digest = sim.state, sim.digest()
    for field in ("position", "velocity"):
        array = getattr(state, field).copy()
        array[57, 1] = np.nextafter(array[57, 1], np.inf)
        assert dataclasses.replace(state, **{field: array}).digest() != digest
        array[57, 1] = np.nextafter(array[57, 1], -np.inf)
        assert dataclasses.replace(state, **{field: array}).digest() == digest
