"""`naive` and `grid` do, bit for bit, what their slow obvious twins do."""

from functools import partial

import numpy as np
import pytest
from support.compare import assert_same_bits
from support.scenes import FEATURED, crowd, features_of, gas, simulate
from support.selection import long_but
from support.twins import Twin

import mpsim

COUNT = 40

SCENES = {
    "gas 0.05": partial(gas, COUNT, 0.05, seed=1),
    "gas 0.2": partial(gas, COUNT, 0.2, seed=2),
    "gas 0.4": partial(gas, COUNT, 0.4, seed=3),
    "gas 0.6": partial(gas, COUNT, 0.6, seed=4),
    "crowd 0.85": partial(crowd, COUNT, 0.85, seed=5),
    "crowd 1.5": partial(crowd, COUNT, 1.5, seed=6),
}


def compare(scene, note, frames=40, at_least=1, **settings):
    """Run simulation and twin side by side, comparing after each frame; require that contacts happened."""
    twin = Twin(scene, **settings)
    contacts = 0
    with simulate(scene, **settings) as sim:
        for frame in range(frames):
            contacts += sim.run(frames=1).collisions
            twin.run(1)
            assert_same_bits(sim.state, twin.state, f"{note}, {settings}, after frame {frame + 1}")
    assert contacts == twin.contacts, f"{note}, {settings}: {contacts} contacts reported, the twin has {twin.contacts}"
    assert contacts >= at_least, f"{note}, {settings}: only {contacts} contacts, which tests little"


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("law", ["elastic", "reflect"])
@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("method", ["grid", "naive"])
def test_a_frame_is_what_the_slow_twin_says(method, precision, law, name):
    compare(SCENES[name](), name, method=method, precision=precision, law=law, dt=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(("precision", "features"), long_but(FEATURED, FEATURED[0]))
@pytest.mark.parametrize("method", ["grid", "naive"])
@pytest.mark.parametrize("contact", ["push", "impact"])
@pytest.mark.parametrize("wall_restitution", [1.0, 0.5])
def test_gravity_and_acceleration_are_what_the_slow_twin_says(wall_restitution, contact, method, precision, features):
    scene = crowd(COUNT, 0.7, seed=8, wall_restitution=wall_restitution, **features_of(features, COUNT))
    compare(scene, f"crowd with {features}", method=method, precision=precision, contact=contact, dt=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("substeps", [2, 3])
@pytest.mark.parametrize("method", ["grid", "naive"])
def test_substeps_are_what_the_slow_twin_says(method, substeps):
    scene = crowd(COUNT, 0.7, seed=9, gravity=(0, -1))
    compare(scene, "crowd", method=method, substeps=substeps, dt=0.1)


@pytest.mark.parametrize("method", ["grid", "naive"])
def test_discs_at_one_point_are_what_the_slow_twin_says(method):

    scene = mpsim.Scene(width=9, height=9, position=[[4.5, 4.5]] * 12, velocity=[[1, 2]] * 12, radius=0.5)
    compare(scene, "twelve discs at one point", at_least=66, method=method, dt=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("contact", ["push", "impact"])
@pytest.mark.parametrize("boundary", ["walls", "periodic"])
def test_joints_of_chains_are_what_the_slow_twin_says(boundary, contact, precision):
    """Flat ones, through a border, short ones, bends, a ring, and one of three segments given in both directions."""
    line = mpsim.Polyline([(0, 3), (2, 3.2), (4, 3), (6, 3), (6.3, 3), (6.6, 3), (8, 4.5), (10, 3)], thickness=0.1)
    ring = mpsim.Polyline([(3, 6), (5, 6), (5.5, 8), (3, 8), (3, 6)])
    fork = [mpsim.Polyline([(7, 6), (8, 7), (8, 9)]), mpsim.Polyline([(9, 6), (8, 7)])]
    rng = np.random.default_rng(11)
    scene = mpsim.Scene(
        width=10, height=10, position=0.4 + 9.2 * rng.random((12, 2)), velocity=3 * rng.normal(size=(12, 2)),
        radius=0.35, gravity=(0.5, -3), obstacles=[line, ring, *fork, mpsim.FixedDisc((1, 8), 0.5)], boundary=boundary,
        wall_friction=0.3, spin=1.0, wall_restitution=0.5,
    )  # fmt: skip
    compare(scene, "joints", method="naive", contact=contact, precision=precision, dt=0.03, frames=60)


@pytest.mark.parametrize("size", [(1.0, 30.0), (30.0, 1.0), (1.0, 1.0), (2.5, 2.5)])
@pytest.mark.parametrize("method", ["grid", "naive"])
def test_boxes_of_one_row_or_column_are_what_the_slow_twin_says(method, size):

    rng = np.random.default_rng(10)
    position = 0.5 + rng.random((10, 2)) * (np.array(size) - 1)
    scene = mpsim.Scene(width=size[0], height=size[1], position=position, velocity=rng.normal(size=(10, 2)), radius=0.5)
    compare(scene, f"box {size}", method=method, dt=0.05)


def test_the_comparison_notices_a_twin_with_another_order_of_contacts():
    scene = SCENES["crowd 1.5"]()
    twin, other = (Twin(scene, method=method, dt=0.05) for method in ("grid", "naive"))
    twin.run(5)
    other.run(5)
    with pytest.raises(AssertionError, match="discs differ in position; the first is disc"):
        assert_same_bits(twin.state, other.state, "negative control")
