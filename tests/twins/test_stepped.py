"""`naive` and `grid` do, bit for bit, what their slow obvious twins do: bare, with each feature, with any of them."""

import numpy as np
import pytest
from support.anything import anything
from support.compare import assert_same_bits
from support.internals import scramble
from support.scenes import ZOO, after, crowd, gas, simulate, zoo
from support.twins import Twin, assert_is_its_twin

import mpsim

pytestmark = [
    pytest.mark.plain,
    pytest.mark.filterwarnings("ignore::mpsim.errors.EmitterWarning"),
    pytest.mark.filterwarnings("ignore::mpsim.FastWarning"),  # of tails of speeds, and of discs dropped on others
]

METHODS = ("grid", "naive")
KINDS = [(contact, precision) for precision in ("float64", "float32") for contact in ("impact", "push")]


def kind(turn):
    """A contact and a precision in turn."""
    return dict(zip(("contact", "precision"), KINDS[turn % 4], strict=True))


# --- bare scenes

LOSSES = {"restitution": 0.75, "wall_restitution": 0.5}
BARE = [
    (gas(30, 0.2, seed=2), {"law": "reflect", "contact": "push", "precision": "float32"}),
    (gas(30, 0.6, seed=4, **LOSSES), {"passes": 2, "contact": "impact"}),
    (crowd(30, 0.85, seed=5), {"law": "reflect", "contact": "impact", "precision": "float32"}),
    (crowd(30, 1.5, seed=6, **LOSSES), {"contact": "push", "passes": 3}),
    (crowd(30, 0.7, seed=9, gravity=(0, -1)), {"contact": "push", "substeps": 3, "dt": 0.1}),
]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("number", range(len(BARE)))
def test_frames_are_what_the_slow_twin_says(number, method):
    scene, settings = BARE[number]
    assert assert_is_its_twin(scene, 12, "bare", **{"method": method, "dt": 0.05, **settings}).contacts > 10


@pytest.mark.parametrize("method", METHODS)
def test_discs_at_one_point_are_what_the_slow_twin_says(method):
    scene = mpsim.Scene(width=9, height=9, position=[[4.5, 4.5]] * 12, velocity=[[1, 2]] * 12, radius=0.5)
    assert assert_is_its_twin(scene, 6, "twelve at one point", method=method, dt=0.01).contacts >= 66


def scattered(width, height, count, **features):
    """Discs anywhere in a box of any shape."""
    rng = np.random.default_rng(10)
    position = 0.5 + rng.random((count, 2)) * (np.array([width, height]) - 1)
    return mpsim.Scene(width=width, height=height, position=position, velocity=rng.normal(size=(count, 2)),
                       **{"radius": 0.5, **features})  # fmt: skip


@pytest.mark.parametrize("size", [(1.0, 30.0), (30.0, 1.0), (1.0, 1.0), (2.5, 2.5)])
@pytest.mark.parametrize("method", METHODS)
def test_boxes_of_one_row_or_column_are_what_the_slow_twin_says(method, size):
    assert assert_is_its_twin(scattered(*size, 10), 12, f"box {size}", method=method, dt=0.05).contacts > 0


@pytest.mark.parametrize("size", [(2.0, 20.0), (20.0, 2.0), (2.0, 2.0), (3.0, 3.0)])
def test_periodic_boxes_of_two_columns_or_rows_are_what_the_slow_twin_says(size):
    """Two diameters are the least; discs then meet each other from both sides."""
    radius = np.where(np.arange(int(size[0] * size[1])) % 2, 0.5, 0.4)
    scene = scattered(*size, len(radius), radius=radius, boundary="periodic")
    assert assert_is_its_twin(scene, 12, f"{size}", method="grid", contact="impact", dt=0.05).contacts > 2


# --- features


def check_feature(name, frames=12, count=24, **settings):
    """One scene of the zoo, in which something happens."""
    scene = zoo(ZOO[name], count, seed=1)
    twin = assert_is_its_twin(scene, frames, name, dt=0.05, **settings)
    assert twin.contacts > 10, f"{name}: {twin.contacts} contacts test little"
    assert not scene.absorbing or twin.gone.sum() >= 2, f"{name}: {twin.gone.sum()} discs left, which tests little"
    assert not scene.emitters or len(twin.p) > count, f"{name}: nothing entered"


@pytest.mark.parametrize("name", ZOO)
def test_each_feature_is_what_the_slow_twin_says(name):
    turn = list(ZOO).index(name)
    check_feature(name, method="grid", **kind(turn))
    if turn % 2:  # the rest of `naive` is shared
        check_feature(name, method="naive", **kind(turn + 1))


@pytest.mark.parametrize("number", range(4))
def test_everything_is_what_the_slow_twin_says(number):
    check_feature("everything rough", method=METHODS[number % 2], **kind(number))


def check_anything(first, last):
    """Random scenes, in any order in memory: the bits of the twin, and nothing lost. Returns the number of contacts."""
    contacts = 0
    for seed in range(first, last):
        scene, settings = anything(seed)
        note = f"scene {seed}, {scene}"
        twin = assert_is_its_twin(scene, 6, note, **settings)
        contacts += twin.contacts
        assert_nothing_is_lost(scene, twin.state, f"{note}, {settings}")
        if settings["method"] == "grid":
            with simulate(scene, **settings) as sim:
                for frame in range(6):
                    scramble(sim, seed + frame)
                    sim.run(frames=1)
                assert_same_bits(sim.state, twin.state, f"{note}, {settings}, scrambled")
    return contacts


def assert_nothing_is_lost(scene, state, note):
    """Every disc is finite and inside; energy stays where nothing gives or takes any."""
    eps = float(np.finfo(state.position.dtype).eps)
    low, high = scene.limits(scene.radii)
    place, slack = state.position[: scene.count], 2 * eps * max(scene.width, scene.height)
    assert np.isfinite([state.position, state.velocity]).all(), note
    assert ((place >= low - slack) & (place <= high + slack)).all(), f"{note}: {place.tolist()}"
    driven = any(each is not None for each in (scene.gravity, scene.acceleration, scene.piston))
    driven |= bool(scene.emitters or scene.absorbing or scene.friction or scene.wall_friction)
    if not driven and scene.restitution == scene.wall_restitution == 1:
        before, after = (scene.masses @ (each.astype(float) ** 2) for each in (scene.velocity, state.velocity))
        assert after.sum() == pytest.approx(before.sum(), rel=1e5 * eps), note


def test_any_features_are_what_the_slow_twin_says():
    assert check_anything(0, 24) > 150, "too few contacts to show anything"


@pytest.mark.parametrize("boundary", ["walls", "periodic"])
def test_joints_of_chains_are_what_the_slow_twin_says(boundary):
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
    assert_is_its_twin(scene, 40, "joints", method="naive", dt=0.03, **kind(boundary == "walls"))


@pytest.mark.parametrize("until", [0.5, 2.0])
def test_a_piston_that_starts_inside_is_what_the_slow_twin_says(until):
    """On its way (0.75 in 0.5), and arrived."""
    scene = zoo("piston lossy", 24)
    there = scene.starting_from(after(scene, until, method="grid", contact="push", dt=0.03))
    assert there.piston.start == (8 - 1.5 * 0.51 if until == 0.5 else 6.4)
    assert assert_is_its_twin(there, 12, f"start {until}", method="grid", contact="impact", dt=0.03).contacts > 10


def test_added_discs_bring_their_radius_and_mass():
    """Small discs are added until the large ones are giants, and the block must grow on the way."""
    scene, rng = zoo(ZOO["everything"], 10, seed=10, side=10.0), np.random.default_rng(11)
    added = [(rng.uniform(2, 7, 2), rng.normal(size=2), rng.choice([0.1, 0.3]), rng.uniform(1, 2)) for _ in range(24)]
    twin = Twin(scene, method="grid", contact="impact", dt=0.03)
    with simulate(scene, method="grid", contact="impact", dt=0.03) as sim:
        for position, velocity, radius, mass in added:
            for each in (twin, sim):
                each.run(1)
            twin.add(position, velocity, radius, mass)
            sim.add(position, velocity, radius=radius, mass=mass)
        twin.run(5)
        sim.run(frames=5)
        assert_same_bits(sim.state, twin.state, "growth with radii and masses")


@pytest.mark.parametrize(("count", "method"), [(0, "grid"), (0, "naive"), (1, "grid"), (2, "naive")])
def test_no_disc_one_and_two_run_with_all_features(count, method):
    scene = zoo(ZOO["everything"].replace("giants", "radii"), count, seed=12)  # what enters is of another size
    assert_is_its_twin(scene, 15, f"{count} discs", method=method, contact="impact", dt=0.05)


# --- compiled


@pytest.mark.long
@pytest.mark.parametrize("name", ZOO)
def test_each_feature_is_what_the_slow_twin_says_compiled(name):
    for method in METHODS:
        for contact, precision in KINDS:
            check_feature(name, method=method, contact=contact, precision=precision)
