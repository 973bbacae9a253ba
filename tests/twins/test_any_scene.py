"""Random small scenes, shrunk to the simplest that fails: grid is its twin, in any order in memory; nothing is lost."""

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.compare import assert_inside_and_finite, assert_same_bits
from support.internals import scramble
from support.scenes import FEATURED, features_of, simulate
from support.transforms import Units
from support.twins import Twin

import mpsim

pytestmark = [
    pytest.mark.plain,
    pytest.mark.filterwarnings("ignore::mpsim.FastWarning"),
    pytest.mark.filterwarnings("ignore::UserWarning"),
]

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


# --- what searches have found, each case reduced to a few discs


def box_of(**features):
    """A box of 10 x 10 with discs of radius 1/2."""
    return mpsim.Scene(**{"width": 10, "height": 10, "radius": 0.5, **features})


def measured(scene, name, frames=120, **settings):
    with simulate(scene, **{"method": "naive", "contact": "impact", "dt": 0.05, **settings}) as sim:
        return sim.run(frames=frames, measures=[name]).measures[name].value


SMALL = Units(length=2.0**-20, mass=2.0**-40)
"""Of grains a millionth of a unit large, in metres and kilograms say."""

AT_REST = {
    "falls": box_of(position=[[3, 3], [7, 2]], velocity=np.zeros((2, 2)), gravity=(0, -1), mass=[2, 1]),
    "own accelerations": box_of(position=[[3, 3]], velocity=np.zeros((1, 2)), acceleration=[[1, -2]], mass=2),
    "emitter alone": box_of(
        position=np.zeros((0, 2)),
        velocity=np.zeros((0, 2)),
        emitters=mpsim.Emitter((5, 5), (2, 1), interval=1.0, limit=9, mass=2),
    ),
}


@pytest.mark.parametrize(
    ("name", "precision"), [("falls", "float32"), ("own accelerations", "float64"), ("emitter alone", "float32")]
)
def test_impulses_are_counted_where_nothing_moves_at_the_start(name, precision):
    """Impulses were counted in steps of 2^-32 of the scene's units where nothing moved at the start: 0 here."""
    scene = AT_REST[name]
    pressure = measured(scene, "pressure", precision=precision)
    assert pressure > 0.005
    assert measured(SMALL.scene(scene), "pressure", precision=precision) == pressure * SMALL.measure("pressure")


def test_the_contact_time_is_short_where_nothing_moves_at_the_start():
    """It was 1e-6 of the units of time where nothing moved at the start: an age for a disc that an emitter launches."""
    start = box_of(
        position=[[4, 5], [5.5, 5]],
        velocity=np.zeros((2, 2)),
        restitution=0.5,
        emitters=mpsim.Emitter((1, 5), (1, 0), interval=1.0, limit=1),
    )
    fast, energies = Units(time=2.0**-30), []
    for scene, factor in ((start, 1.0), (fast.scene(start), fast.time)):
        with warnings.catch_warnings(), simulate(scene, method="event", dt=factor) as sim:
            warnings.simplefilter("error", mpsim.errors.GuardWarning)
            sim.run(frames=8)
            energies.append((sim.state.velocity**2).sum() * factor**2)
    assert energies[0] < 0.5, "the collisions lose energy"
    assert energies[1] == energies[0]


def test_a_kurtosis_of_discs_that_come_to_rest_ends_no_run():
    """It raised InputError in the middle of the run in which the last disc stopped."""
    scene = box_of(position=[[3, 5], [7, 5]], velocity=[[1, 0], [-1, 0]], restitution=0.0)
    with simulate(scene, method="naive", contact="impact", dt=0.05) as sim:
        report = sim.run(frames=100, measures=["speed_kurtosis", "kinetic_energy"])
        assert sim.frame == 100
    assert np.isnan(report.measures["speed_kurtosis"].value)
    assert report.measures["kinetic_energy"].value > 0


@pytest.mark.parametrize(("name", "height"), [("pressure_virial", 1), ("pressure_xx", 4)])
def test_a_virial_where_the_disc_fills_the_box_is_refused(name, height):
    """It divided by the area in which centres can be, 0, and the report of the whole run was lost."""
    scene = mpsim.Scene(width=1, height=height, position=[[0.5, 0.5]], velocity=[[0, 0]], radius=0.5)
    with simulate(scene, method="naive", dt=0.01) as sim, pytest.raises(mpsim.InputError, match="no room to move"):
        sim.run(frames=1, measures=[name])


def test_an_exact_run_may_begin_without_discs():
    """In plain Python it divided by their number."""
    scene = mpsim.Scene(width=20, height=20, position=np.zeros((0, 2)), velocity=np.zeros((0, 2)), radius=0.01,
                        emitters=mpsim.Emitter((10, 10), (20, 3), interval=0.1, limit=3))  # fmt: skip
    with simulate(scene, method="event", dt=0.1) as sim:
        assert sim.run(frames=8).collisions == 0
        assert sim.count == 3
