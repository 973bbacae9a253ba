"""Random small scenes, shrunk to the simplest that fails: grid is its twin, in any order in memory; nothing is lost."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.compare import assert_inside_and_finite, assert_same_bits
from support.internals import scramble
from support.scenes import FEATURED, features_of, simulate
from support.twins import Twin

import mpsim

pytestmark = [pytest.mark.plain, pytest.mark.filterwarnings("ignore::mpsim.FastWarning")]  # any discs in any box

FEW = settings(max_examples=settings().max_examples // 3)
"""A third of those of the profile: with --long there are more."""

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
    position = np.clip(position, radius, np.array([width, height]) - radius)
    box = {"width": width, "height": height, "radius": radius}
    return mpsim.Scene(
        position=position, velocity=np.reshape(speeds, (count, 2)), **box, **features_of(features, count)
    )


@st.composite
def runs(draw):
    """A scene and settings."""
    precision, features = draw(st.sampled_from([("float64", ""), ("float32", ""), FEATURED[0]]))
    how = {
        "precision": precision,
        "law": draw(st.sampled_from(["elastic", "reflect"])),
        "contact": draw(st.sampled_from(["push", "impact"])),
        "dt": draw(st.sampled_from([0.01, 0.3, 5.0])),
        "substeps": draw(st.integers(1, 3)),
    }
    return draw(scenes(features=features)), how


@FEW
@given(runs(), st.integers(0, 2**32))
def test_grid_is_its_twin_in_any_scene_and_any_order_in_memory(run, seed):
    scene, how = run
    twin = Twin(scene, method="grid", **how)
    with simulate(scene, method="grid", **how) as sim, simulate(scene, method="grid", **how) as other:
        for frame in range(5):
            scramble(other, seed + frame)
            for each in (sim, other):
                each.run(frames=1)
            twin.run(1)
            assert_same_bits(sim.state, twin.state, f"{how}, after frame {frame + 1}")
            assert_same_bits(other.state, twin.state, f"{how}, scrambled, after frame {frame + 1}")


@FEW
@given(runs(), st.sampled_from(["naive", "grid"]))
def test_every_disc_stays_inside_and_finite_in_any_scene_and_energy_stays_where_there_is_no_force(run, method):
    scene, how = run
    with simulate(scene, method=method, **how) as sim:
        for frame in range(4):
            sim.run(frames=4)
            assert len(sim.state.position) == scene.count
            assert_inside_and_finite(sim.state, scene, f"{method}, {how}, after frame {4 * frame + 4}")
        if scene.gravity is None and scene.acceleration is None and how["precision"] == "float64":
            before, after = ((each.velocity**2).sum() for each in (scene, sim.state))
            assert np.isclose(after, before, rtol=1e-11, atol=0), f"energy {before!r} became {after!r}"
