"""Arrays of features: giants, and the grid of obstacles."""

import itertools

import numpy as np
import pytest

import mpsim
from mpsim.engine import feature_arrays
from mpsim.features.capsules import distance
from mpsim.features.obstacles import OBSTACLES


def test_giants_are_few_and_more_than_twice_as_large_as_all_others():
    small = np.full(100, 1.0)
    assert feature_arrays.giant_radius(small) is None
    assert feature_arrays.giant_radius(np.append(small, 2.0)) is None, "twice as large is not enough"
    assert feature_arrays.giant_radius(np.append(small, 2.5)) == 1.0
    assert feature_arrays.giant_radius(np.append(small, [1.5, 1.9, 40.0])) == 1.9, "the grid keeps all but the giants"
    assert feature_arrays.giant_radius(np.append(small, np.full(8, 9.0))) == 1.0
    assert feature_arrays.giant_radius(np.append(small, np.full(9, 9.0))) is None, "nine are too many for giants"
    assert feature_arrays.giant_radius(np.append(np.full(15, 1.0), 9.0)) is None, "too few discs for a grid"
    assert feature_arrays.giant_radius(np.array([])) is None


@pytest.mark.parametrize("boundary", ["walls", "periodic", ("periodic", "walls")])
def test_the_grid_of_obstacles_lists_all_that_a_disc_can_touch(boundary):
    rng = np.random.default_rng(3)
    pegs = [mpsim.FixedDisc(rng.uniform(0, 20, 2), rng.uniform(0.1, 2)) for _ in range(20)]
    walls = [mpsim.Polyline(rng.uniform(0, 20, (3, 2)), rng.uniform(0, 1)) for _ in range(10)]
    scene = mpsim.Scene(
        width=20, height=20, position=[[5, 5]], velocity=[[0, 0]], radius=0.5, obstacles=pegs + walls, boundary=boundary
    )
    arrays = OBSTACLES.arrays(scene)
    places = rng.uniform(0, 20, (4000, 2))
    touches = distance(places[:, None], arrays["capsule"]) < 0.5
    columns, rows = arrays["grid"]
    column, row = (np.minimum((places * arrays["per_length"]).astype(int), [columns - 1, rows - 1])).T
    listed = 0
    for place, cell in enumerate(column * rows + row):
        near = arrays["index"][arrays["near"][cell] : arrays["near"][cell + 1]]
        assert set(np.flatnonzero(touches[place])) <= set(near.tolist()), f"at {places[place]}"
        assert sorted(near) == list(near), "in the order of the scene"
        listed += len(near)
    assert listed < 4 * touches.sum() + len(places), "the grid lists far more than what is near"
    steps = [(-20, 0, 20) if word == "periodic" else (0,) for word in scene.boundary]
    wraps = [np.array(step) for step in itertools.product(*steps)]
    images = np.min([distance((places + s)[:, None], scene.capsules).min(axis=1) for s in wraps], axis=0)
    assert np.array_equal(images < 0.5, touches.any(axis=1)), "what lies beyond a border must be felt"
