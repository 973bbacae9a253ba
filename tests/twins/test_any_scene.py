"""Random small scenes, shrunk to the simplest one that fails: grid equals its twin, and no disc is ever lost."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.compare import assert_inside_and_finite, assert_same_bits
from support.internals import scramble
from support.scenes import FEATURED, features_of, simulate
from support.twins import Twin

import mpsim

pytestmark = pytest.mark.slow

SIXTEENTHS = st.integers(0, 16)
"""Places as fractions of the box: coincident discs, discs at walls and on the edges of cells are likely."""

SPEEDS = st.sampled_from([0.0, -0.0, 1.0, -1.0, 0.25, -3.0, 1e-30, 50.0, -1e5])


@st.composite
def scenes(draw, features=""):
    """A scene of up to a dozen discs in a box of up to 12 x 12 radii."""
    radius = draw(st.sampled_from([0.5, 0.1, 3.0]))
    width, height = (radius * draw(st.sampled_from([2.0, 2.5, 4.0, 7.3, 12.0])) for _ in range(2))
    places = draw(st.lists(st.tuples(SIXTEENTHS, SIXTEENTHS), max_size=12))
    count = len(places)
    free = np.array([width, height]) - 2 * radius
    position = radius + np.reshape(places, (count, 2)) / 16 * free
    position += draw(st.sampled_from([0.0, 1e-9, 0.01])) * np.arange(count)[:, None] * (position < free)
    speeds = draw(st.lists(st.tuples(SPEEDS, SPEEDS), min_size=count, max_size=count))
    velocity = np.reshape(speeds, (count, 2))
    position = np.clip(position, radius, np.array([width, height]) - radius)
    return mpsim.Scene(
        width=width,
        height=height,
        position=position,
        velocity=velocity,
        radius=radius,
        **features_of(features, count),
    )


@st.composite
def runs(draw):
    """A scene and settings; only combinations of features that the suite compiles anyway."""
    precision, features = draw(st.sampled_from([("float64", ""), ("float32", ""), FEATURED[0]]))
    settings = {
        "precision": precision,
        "law": draw(st.sampled_from(["elastic", "reflect"])),
        "contact": draw(st.sampled_from(["push", "impact"])),
        "dt": draw(st.sampled_from([0.01, 0.3, 5.0])),
        "substeps": draw(st.integers(1, 3)),
    }
    return draw(scenes(features=features)), settings


@given(runs())
def test_grid_is_its_twin_in_any_scene(run):
    scene, settings = run
    twin = Twin(scene, method="grid", **settings)
    with simulate(scene, method="grid", **settings) as sim:
        for frame in range(6):
            sim.run(frames=1)
            twin.run(1)
            assert_same_bits(sim.state, twin.state, f"{settings}, after frame {frame + 1}")


@pytest.mark.filterwarnings("ignore::mpsim.FastWarning")  # any discs in any box
@given(runs(), st.sampled_from(["naive", "grid"]))
def test_every_disc_stays_inside_and_finite_in_any_scene(run, method):
    scene, settings = run
    with simulate(scene, method=method, **settings) as sim:
        for frame in range(30):
            sim.run(frames=1)
            state = sim.state
            assert len(state.position) == scene.count
            assert_inside_and_finite(state, scene, f"{method}, {settings}, after frame {frame + 1}")


@pytest.mark.filterwarnings("ignore::mpsim.FastWarning")
@given(runs(), st.integers(0, 2**32))
def test_the_memory_order_never_matters_in_any_scene(run, seed):

    scene, settings = run
    with simulate(scene, method="grid", **settings) as sim, simulate(scene, method="grid", **settings) as other:
        for frame in range(4):
            sim.run(frames=1)
            scramble(other, seed + frame)
            other.run(frames=1)
            assert_same_bits(other.state, sim.state, f"{settings}, after frame {frame + 1}")


@given(scenes())
def test_the_energy_never_changes_in_any_scene_without_forces(scene):
    before = (scene.velocity**2).sum()
    with simulate(scene, method="grid", dt=0.3) as sim:
        sim.run(frames=30)
        after = (sim.state.velocity**2).sum()
    assert np.isclose(after, before, rtol=1e-12, atol=0), f"energy {before!r} became {after!r}"
