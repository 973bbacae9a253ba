"""`parallel` gives the bits of `grid`, whatever the number of workers."""

import numpy as np
import pytest
from support.compare import assert_parallel_is_grid, assert_same_bits
from support.scenes import FEATURED, crowd, features_of, gas, state_after
from support.selection import long_but

import mpsim

FRAMES = 40

GASES = long_but(
    [(packing, law) for packing in (0.05, 0.75) for law in ("elastic", "reflect")], (0.05, "reflect"), (0.75, "elastic")
)


@pytest.mark.parametrize(("packing", "law"), GASES)
def test_parallel_is_grid_for_gases_of_any_packing(packing, law):
    assert_parallel_is_grid(gas(600, packing, seed=1), workers=(2, 3), law=law, dt=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(("precision", "features"), [("float32", ""), *long_but(FEATURED, FEATURED[0])])
def test_parallel_is_grid_with_every_feature(precision, features):
    scene = crowd(500, 0.85, seed=2, **features_of(features, 500))
    assert_parallel_is_grid(scene, workers=(3,), precision=precision, dt=0.02, substeps=2)


@pytest.mark.parametrize("contact", ["push", "impact"])
def test_parallel_is_grid_for_discs_at_one_point(contact):
    """At rest, in twenty points on the edges of cells, so that groups are shared by two workers as they spread."""
    point = np.stack(np.divmod(np.arange(20), 5), axis=1) * 6.0 + 3.0
    scene = mpsim.Scene(width=30, height=30, position=np.tile(point, (9, 1)), velocity=np.zeros((180, 2)), radius=0.5)
    assert_parallel_is_grid(scene, frames=30, workers=(1, 3), contact=contact)


@pytest.mark.slow
@pytest.mark.parametrize("size", [(2.5, 200.0), (1.0, 200.0), (200.0, 1.5)])
def test_parallel_is_grid_with_more_workers_than_columns_or_discs_in_them(size):
    rng = np.random.default_rng(3)
    position = 0.5 + rng.random((60, 2)) * (np.array(size) - 1)
    scene = mpsim.Scene(width=size[0], height=size[1], position=position, velocity=rng.normal(size=(60, 2)), radius=0.5)
    assert_parallel_is_grid(scene, workers=(5,), dt=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("count", [0, 1, 2])
def test_parallel_is_grid_for_fewer_discs_than_workers(count):
    position = [[3.0, 3.0], [3.5, 3.25]][:count]
    scene = mpsim.Scene(
        width=8, height=8, position=np.reshape(position, (-1, 2)), velocity=np.ones((count, 2)), radius=0.5
    )
    expected = state_after(scene, FRAMES, method="grid", dt=0.05)
    got = state_after(scene, FRAMES, method="parallel", workers=3, dt=0.05)
    assert_same_bits(got, expected, f"{count} discs on 3 workers")


def test_auto_gives_the_bits_of_one_of_the_methods():
    for count, method in ((50, "naive"), (300, "grid"), (1500, "grid")):
        scene = gas(count, 0.5, seed=4)
        expected = state_after(scene, FRAMES, method=method)
        assert_same_bits(state_after(scene, FRAMES, method="auto", workers=2), expected, f"auto, {count} discs")
