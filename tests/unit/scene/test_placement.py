"""Random places, of one size and of many: no overlap, no lattice; overlaps of given places against all pairs."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.scenes import gas

from mpsim import FixedDisc, InputError, Polyline, Scene, State
from mpsim.core import pieces
from mpsim.features.capsules import distance
from mpsim.scene import placement


def overlaps_twin(position, diameter):
    """Number of overlapping pairs, the deepest pair and its depth, by looking at all pairs."""
    pairs, deepest, depth = 0, (0, 0), 0.0
    for j in range(len(position)):
        for i in range(j):
            distance = math.dist(position[i], position[j])
            if distance < diameter:
                pairs += 1
                if diameter - distance > depth:
                    deepest, depth = (i, j), diameter - distance
    return pairs, deepest, depth


@given(st.integers(0, 2**32), st.integers(0, 60), st.floats(1, 40), st.floats(1, 40), st.floats(0.05, 1))
def test_overlaps_are_those_of_all_pairs(seed, count, width, height, diameter):
    rng = np.random.default_rng(seed)
    position = rng.random((count, 2)) * [width, height]
    pairs, deepest, depth = placement.overlaps(position, width, height, diameter)
    expected_pairs, expected_deepest, expected_depth = overlaps_twin(position, diameter)
    assert pairs == expected_pairs
    if pairs:
        assert deepest == expected_deepest
        assert depth == pytest.approx(expected_depth, abs=1e-12)


@pytest.fixture
def threads(monkeypatch):
    """A function that has loops of any length done by so many threads from then on."""

    def use(number):
        monkeypatch.setattr(pieces, "usable_cores", lambda: number)
        monkeypatch.setattr(pieces, "WORTH_A_THREAD", 1)

    return use


@pytest.mark.parametrize("seed", range(5))
def test_any_number_of_threads_finds_the_same_overlaps(seed, threads):
    position = np.random.default_rng(seed).integers(0, 40, (300, 2)) * 0.5  # so that many pairs are equally deep
    expected = placement.overlaps(position, 20, 20, 1.1)
    assert expected[0] > 100
    for number in (2, 3, 7):
        threads(number)
        assert placement.overlaps(position, 20, 20, 1.1) == expected


@pytest.mark.parametrize("count", [40, 3000, 60_000])
def test_any_number_of_threads_makes_the_same_random_places(count, threads):
    expected = gas(count, 0.39, seed=3).position
    for number in (2, 3):
        threads(number)
        assert (gas(count, 0.39, seed=3).position == expected).all()
        assert (gas(count, 0.39, seed=4).position != expected).any()


def test_random_places_fill_the_box_evenly():
    """Chi-squared over 10 x 10 fields: sequential addition at this packing spreads more evenly than chance."""
    places = placement.random_places(5000, 200.0, 200.0, 0.5, np.random.default_rng(1))
    counts = np.histogram2d(*places.T, bins=10, range=[[0, 200]] * 2)[0]
    assert ((counts - 50) ** 2 / 50).sum() < 150


@pytest.mark.parametrize(("count", "width", "height"), [(4, 1.9, 2.5), (3, 1.5, 2.2), (100, 9.3, 9.3)])
def test_discs_that_fit_no_arrangement_are_refused_with_the_gap(count, width, height):
    with pytest.raises(InputError, match=rf"{count} discs of radius 0.5 do not fit.*is needed.*larger box"):
        placement.random_places(count, width, height, 0.5, np.random.default_rng(1))


@pytest.mark.parametrize(("count", "width", "height"), [(1, 1.0, 1.0), (4, 2.001, 2.001), (12, 12.1, 1.01)])
def test_discs_that_just_fit_are_placed(count, width, height):
    places = placement.random_places(count, width, height, 0.5, np.random.default_rng(1))
    assert places.shape == (count, 2)
    assert overlaps_twin(places, 1.0)[0] == 0
    assert ((places >= 0.5) & (places <= np.array([width, height]) - 0.5)).all()


def test_the_largest_packing_is_reached():
    side = math.sqrt(3000 * math.pi / 4 / placement.LARGEST_PACKING)
    places = placement.random_places(3000, side, side, 0.5, np.random.default_rng(2))
    assert placement.overlaps(places, side, side, 1.0)[0] == 0


# --- random scenes


def deepest(scene):
    """Depth of the deepest overlap, by looking at all pairs and all obstacles; negative: the narrowest gap."""
    r = scene.position[:, None] - scene.position[None]
    for axis, length in enumerate((scene.width, scene.height)):
        if scene.periodic[axis]:
            r[..., axis] -= length * np.round(r[..., axis] / length)
    depth = scene.radii[:, None] + scene.radii[None] - np.hypot(r[..., 0], r[..., 1])
    np.fill_diagonal(depth, -np.inf)
    walls = scene.radii[:, None] - distance(scene.position[:, None], scene.capsules)
    return max(depth.max(initial=-np.inf), walls.max(initial=-np.inf))


SIZES = {
    "one size": np.full(300, 0.5),
    "two sizes": np.repeat([0.5, 0.35], 150),
    "many sizes": np.geomspace(0.1, 1.0, 300),
    "a giant": np.append(np.full(299, 0.2), 1.5),
}


@pytest.mark.parametrize("boundary", ["periodic", ("periodic", "walls"), "walls"])
@pytest.mark.parametrize("packing", [0.2, 0.5, 0.7, 0.8])
@pytest.mark.parametrize("sizes", SIZES)
def test_random_discs_of_any_size_have_no_overlap_in_any_box(sizes, packing, boundary):
    if packing == 0.8 and boundary != "periodic" and sizes == "a giant":
        pytest.skip("walls leave no room for it")
    scene = Scene.random(count=300, radius=SIZES[sizes], packing=packing, boundary=boundary, seed=1)
    assert scene.packing == pytest.approx(packing, rel=1e-12)
    assert deepest(scene) < 0
    # Negative control: the twin sees one disc moved on top of another, through the border too.
    moved = scene.position.copy()
    moved[1] = np.clip(
        moved[0] + 0.05, *(limit[1] if limit.ndim > 1 else limit for limit in scene.limits(scene.radius))
    )
    other = Scene(width=scene.width, height=scene.height, position=moved, velocity=scene.velocity, radius=scene.radius,
                  boundary=boundary)  # fmt: skip
    assert deepest(other) > 0


@pytest.mark.parametrize("packing", [0.2, 0.55])
def test_random_discs_stay_clear_of_obstacles(packing):
    walls = [FixedDisc((5, 5), 1.5), Polyline([(1, 8), (4, 12), (9, 12)], thickness=0.3)]
    scene = Scene.random(count=int(packing * 225 / 0.5), radius=0.4, width=15, height=15, obstacles=walls, seed=3)
    assert deepest(scene) < 0
    assert scene.overlaps_at_start() == ""


def test_the_same_seed_gives_the_same_crowd_and_another_seed_another():
    radius = SIZES["many sizes"]
    one, again, other = (
        Scene.random(count=300, radius=radius, packing=0.7, boundary="periodic", mass=radius**2, seed=seed)
        for seed in (6, 6, 7)
    )
    assert one.digest() == again.digest() != other.digest()


def test_a_dense_crowd_is_no_lattice_and_fills_the_box_evenly():
    scene = Scene.random(count=3000, radius=0.5, packing=0.6, boundary="periodic", seed=2)
    assert len(np.unique(np.round(scene.position[:, 1], 3))) > 2000
    counts = np.histogram2d(*scene.position.T, bins=10, range=[[0, scene.width]] * 2)[0]
    assert ((counts - 30) ** 2 / 30).sum() < 99  # of chance alone it would be 99


def test_a_mixture_has_exactly_the_temperature_asked_for_and_no_momentum():
    mass = np.repeat([1.0, 16.0], 500)
    scene = Scene.random(count=1000, radius=0.5, packing=0.2, mass=mass, temperature=2.5, seed=4)
    assert (mass[:, None] * scene.velocity**2).mean() == pytest.approx(2.5, rel=1e-12)
    assert np.abs(mass @ scene.velocity).max() < 1e-9
    light, heavy = ((scene.velocity[part] ** 2).mean() for part in (slice(500), slice(500, None)))
    assert light / heavy == pytest.approx(16, rel=0.15)


def test_what_fits_no_box_is_refused():
    with pytest.raises(InputError, match=r"4 discs of packing 0.8 could not be placed in a box.*larger box"):
        Scene.random(count=4, radius=[0.5, 0.5, 0.5, 0.4], packing=0.8)
    with pytest.raises(InputError, match=r"packing must be at most 0\.8"):
        Scene.random(count=300, radius=SIZES["many sizes"], packing=0.81)
    with pytest.raises(InputError, match=r"a quarter of a periodic axis, 1 here; got 1\.5"):
        Scene.random(count=1, radius=1.5, width=4, height=40, boundary="periodic")


def test_random_scenes_of_one_size_between_walls_are_those_of_before():
    """Every pinned digest and published figure starts from them."""
    scene = gas(100, 0.4, seed=7)
    assert scene.digest() == Scene.random(count=100, packing=0.4, radius=np.full(100, 0.5), seed=7).digest()


def test_no_disc_is_a_scene_too():
    none = Scene.random(count=0, radius=[], packing=0.5, boundary="periodic")
    assert (none.count, none.packing) == (0, 0)


# --- overlaps of given starts


def test_overlaps_are_found_through_periodic_borders_and_with_obstacles():
    walls = [FixedDisc((4, 3), 0.1), Polyline([(7.9, 0.5), (7.9, 1.0)], thickness=0.2)]
    places = [[0.1, 5.0], [7.7, 5.0], [0.2, 0.75], [4.4, 3.0]]
    scene = Scene(width=8, height=6, position=places, velocity=np.zeros((4, 2)), radius=[0.4, 0.2, 0.3, 0.35],
                  boundary="periodic", obstacles=walls)  # fmt: skip
    assert scene.overlaps_at_start() == (
        "1 pair of discs overlaps at the start: discs 0 and 1, by 0.2; "
        "2 discs overlap an obstacle at the start, disc 2 and obstacles[1] deepest, by 0.1"
    )
    # Negative control: between walls the first pair is far apart, and so is disc 2 from the obstacle.
    scene = Scene(width=8, height=6, position=np.clip(places, 0.4, None), velocity=np.zeros((4, 2)),
                  radius=[0.4, 0.2, 0.3, 0.35], obstacles=walls)  # fmt: skip
    assert scene.overlaps_at_start() == "disc 3 overlaps obstacles[0] at the start, by 0.05"


def test_a_giant_among_many_is_found_quickly():
    """Linear: a search in cells of the giant's size would look at 10^8 pairs."""
    rng = np.random.default_rng(5)
    position = np.append(rng.uniform(10, 90, (20_000, 2)), [[50.0, 50.0]], axis=0)
    radius = np.append(np.full(20_000, 1e-3), 5.0)
    scene = Scene(width=100, height=100, position=position, velocity=np.zeros_like(position), radius=radius)
    inside = np.hypot(*(position[:-1] - 50).T) < 5.001
    pairs = int(scene.overlaps_at_start().split()[0])
    assert inside.sum() <= pairs <= inside.sum() + 5  # small ones may touch each other by chance


def test_overlaps_of_a_scene_are_looked_for_once_and_again_in_one_that_starts_elsewhere(monkeypatch):
    scene = Scene(width=9, height=9, position=[[2, 2], [2.75, 2]], velocity=np.zeros((2, 2)), radius=0.5)
    looks = []
    look = placement.overlaps
    monkeypatch.setattr(placement, "overlaps", lambda *arguments: (looks.append(arguments), look(*arguments))[1])
    assert [scene.overlaps_at_start()[:7] for _ in range(3)] == ["1 pair "] * 3
    assert len(looks) == 1
    apart = State(np.array([[2.0, 2.0], [3.5, 2.0]]), scene.velocity)
    assert scene.starting_from(apart).overlaps_at_start() == ""
    assert len(looks) == 2
