"""What a scene may have besides discs in a box: every rule with its text, random scenes of all kinds, overlaps."""

import numpy as np
import pytest
from support.scenes import gas

from mpsim import Emitter, FixedDisc, InputError, Piston, Polyline, Scene, Settings, Simulation
from mpsim.features.capsules import distance

PLACES = [[2.0, 2.0], [4.0, 3.0]]


def scene_of(**changes):
    arguments = {"width": 8.0, "height": 6.0, "position": PLACES, "velocity": np.zeros((2, 2)), "radius": 0.5}
    return Scene(**(arguments | changes))


WRONG = {
    "radius of another shape": ({"radius": [0.5] * 3}, ["radius must have shape () or (2,)", "(3,)"]),
    "radius not positive": ({"radius": [0.5, 0.0]}, ["radius must be > 0 [length]", "radius[1] is 0.0"]),
    "radius not finite": ({"radius": [0.5, np.nan]}, ["radius must be finite", "radius[1] is nan"]),
    "mass of another shape": ({"mass": [1.0]}, ["mass must have shape () or (2,)", "(1,)"]),
    "mass not positive": ({"mass": [1.0, -2.0]}, ["mass must be > 0 [mass]", "mass[1] is -2.0"]),
    "a large disc by the wall": (
        {"radius": [2.5, 0.5]},
        ["position[0] must lie in [2.5, 5.5] x [2.5, 3.5]", "(2.0, 2.0)"],
    ),
    "too large for the box": ({"radius": [0.5, 3.5]}, ["at most half the box, 3 here", "3.5", "larger box"]),
    "too large for a periodic axis": (
        {"radius": [0.5, 1.6], "boundary": ("walls", "periodic")},
        ["at most a quarter of a periodic axis, 1.5 here", "1.6", "larger box"],
    ),
    "an unknown boundary": ({"boundary": "perodic"}, ["boundary must be one of", "Did you mean 'periodic'?"]),
    "three boundaries": ({"boundary": ("walls",) * 3}, ["one for x and one for y"]),
    "beyond a periodic edge": (
        {"boundary": "periodic", "position": [[2, 2], [8.5, 3]]},
        ["position[1] must lie in [0, 8] x [0, 6]", "(8.5, 3.0)"],
    ),
    "an obstacle of another kind": ({"obstacles": [1]}, ["obstacles[0] must be an mpsim.FixedDisc", "int"]),
    "an obstacle outside": ({"obstacles": FixedDisc((9, 1), 1)}, ["obstacles[0] must lie in the box", "(9.0, 1.0)"]),
    "an emitter of another kind": ({"emitters": [1]}, ["emitters[0] must be an mpsim.Emitter", "int"]),
    "an emitter outside": (
        {"emitters": Emitter((0.2, 3), (1, 0), every=1)},
        ["the position of emitters[0] must lie in [0.5, 7.5]", "(0.2, 3.0)"],
    ),
    "an emitter without a radius": (
        {"radius": [0.5, 0.4], "emitters": Emitter((2, 3), (1, 0), every=1)},
        ["emitters[0] must have a radius", "got None"],
    ),
    "an emitter without a mass": (
        {"mass": [1, 2], "emitters": Emitter((2, 3), (1, 0), every=1)},
        ["emitters[0] must have a mass", "got None"],
    ),
    "an unknown edge": ({"absorbing": "botom"}, ["absorbing must be one of", "Did you mean 'bottom'?"]),
    "a periodic edge that absorbs": (
        {"absorbing": "left", "boundary": ("periodic", "walls")},
        ["absorbing must name a wall", "'left'", "periodic along x", "another edge"],
    ),
    "a piston of another kind": ({"piston": 1}, ["piston must be an mpsim.Piston", "int"]),
    "a piston on a periodic axis": (
        {"piston": Piston("top", -1, 3), "boundary": ("walls", "periodic")},
        ["piston must name a wall", "'top'", "periodic along y"],
    ),
    "an absorbing piston": (
        {"piston": Piston("top", -1, 3), "absorbing": "top"},
        ["piston must not be an absorbing edge", "'top'", "Choose one"],
    ),
    "a piston that stops outside": ({"piston": Piston("left", 1, 9)}, ["stop of the piston", "(0, 8)", "9"]),
    "a piston that leaves no room": ({"piston": Piston("left", 1, 7.5)}, ["room for the largest disc", "0.5"]),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_broken_rule_is_named_with_the_value(case):
    changes, words = WRONG[case]
    with pytest.raises(InputError) as raised:
        scene_of(**changes)
    for word in words:
        assert word in str(raised.value), f"{word!r} is missing in {str(raised.value)!r}"


PARTS = {
    "a peg without a radius": (lambda: FixedDisc((1, 1), 0), ["radius of a FixedDisc", "> 0"]),
    "a peg at no point": (lambda: FixedDisc((1, 1, 1), 1), ["position of a FixedDisc", "shape (2,)"]),
    "a wall of one corner": (lambda: Polyline([(0, 0)]), ["at least two", "Use a FixedDisc"]),
    "a wall that stands still": (lambda: Polyline([(0, 0), (0, 0)]), ["at different places"]),
    "a wall of no shape": (lambda: Polyline([(0, 0, 0)]), ["points of a Polyline", "(K, 2)"]),
    "a negative thickness": (lambda: Polyline([(0, 0), (1, 0)], -1), ["thickness of a Polyline", ">= 0"]),
    "an emitter of no frames": (lambda: Emitter((0, 0), (1, 0), every=0), ["every of an Emitter", "from 1"]),
    "an emitter of no discs": (lambda: Emitter((0, 0), (1, 0), every=1, limit=0), ["limit of an Emitter", "no end"]),
    "an emitter of no size": (
        lambda: Emitter((0, 0), (1, 0), every=1, radius=0),
        ["radius of an Emitter", "> 0 [length]"],
    ),
    "an emitter of no mass": (lambda: Emitter((0, 0), (1, 0), every=1, mass=-1), ["mass of an Emitter", "> 0 [mass]"]),
    "a piston of no wall": (lambda: Piston("front", 1, 1), ["wall of a Piston", "'front'"]),
    "a piston that pulls": (lambda: Piston("right", 1, 1), ["must point into the box", "< 0 for the right wall"]),
    "a piston at rest": (lambda: Piston("left", 0, 1), ["must point into the box", "> 0 for the left wall"]),
    "a piston without an end": (lambda: Piston("left", 1, 0), ["stop of a Piston", "> 0"]),
}


@pytest.mark.parametrize("case", PARTS)
def test_a_part_checks_itself(case):
    make, words = PARTS[case]
    with pytest.raises(InputError) as raised:
        make()
    for word in words:
        assert word in str(raised.value), f"{word!r} is missing in {str(raised.value)!r}"


def test_what_is_equal_for_all_counts_as_one():
    scene = scene_of(radius=[0.5, 0.5], mass=[1.0, 1.0])
    assert (scene.radius, scene.mass) == (0.5, None)
    assert scene_of(mass=2.0).masses.tolist() == [2, 2]
    assert (scene_of(radius=[0.5, 0.25]).smallest_radius, scene_of(radius=[0.5, 0.25]).largest_radius) == (0.25, 0.5)
    wide = scene_of(emitters=Emitter((4, 3), (0, 1), every=1, radius=0.75))
    assert (wide.smallest_radius, wide.largest_radius) == (0.5, 0.75)


def test_arrays_are_read_only_copies():
    radius, mass = np.array([0.5, 0.25]), np.array([1.0, 3.0])
    scene = scene_of(radius=radius, mass=mass)
    radius[0] = mass[0] = 9
    assert (scene.radius[0], scene.mass[0]) == (0.5, 1.0)
    for array in (scene.radius, scene.mass):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


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
    with pytest.raises(InputError, match=r"4 discs of packing 0.8 were not brought into a box.*larger box"):
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
        "1 pairs of discs overlap at the start, discs 0 and 1 deepest, by 0.2; "
        "2 discs overlap an obstacle at the start, disc 2 and obstacles[1] deepest, by 0.1"
    )
    # Negative control: between walls the first pair is far apart, and so is disc 2 from the obstacle.
    scene = Scene(width=8, height=6, position=np.clip(places, 0.4, None), velocity=np.zeros((4, 2)),
                  radius=[0.4, 0.2, 0.3, 0.35], obstacles=walls)  # fmt: skip
    assert scene.overlaps_at_start() == (
        "1 discs overlap an obstacle at the start, disc 3 and obstacles[0] deepest, by 0.05"
    )


def test_a_giant_among_many_is_found_quickly():
    """Linear: a search in cells of the giant's size would look at 10^8 pairs."""
    rng = np.random.default_rng(5)
    position = np.append(rng.uniform(10, 90, (20_000, 2)), [[50.0, 50.0]], axis=0)
    radius = np.append(np.full(20_000, 1e-3), 5.0)
    scene = Scene(width=100, height=100, position=position, velocity=np.zeros_like(position), radius=radius)
    inside = np.hypot(*(position[:-1] - 50).T) < 5.001
    pairs = int(scene.overlaps_at_start().split()[0])
    assert inside.sum() <= pairs <= inside.sum() + 5  # small ones may touch each other by chance


def test_packing_and_repr_are_of_the_box_at_the_start():
    scene = Scene(
        width=20, height=10, position=[[1, 1], [3, 3]], velocity=np.zeros((2, 2)), radius=0.5,
        piston=Piston("right", -1, 4, start=5),
    )  # fmt: skip
    assert scene.packing == pytest.approx(2 * np.pi * 0.25 / 50)
    assert repr(scene) == "<Scene: 2 discs of radius 0.5 in 5 x 10 of 20 x 10, packing 0.0314, piston>"


def test_what_is_kept_of_obstacles_is_of_those_that_a_scene_has():
    """Attributes of a scene may be replaced; what was computed of the earlier ones must not stay."""

    def start(x):
        peg = FixedDisc((x, 2), 0.5)
        return Scene(width=9, height=4, position=[[1, 2]], velocity=[[1, 0]], radius=0.5, obstacles=peg)

    scene, other = start(4), start(6)
    with Simulation(scene, Settings(method="grid")) as sim:
        sim.run(until=4)
    scene.obstacles = other.obstacles
    assert scene.capsules.tolist() == other.capsules.tolist()
    with Simulation(scene, Settings(method="grid")) as sim:
        sim.run(until=4)
        replaced = sim.digest()
    with Simulation(other, Settings(method="grid")) as sim:
        sim.run(until=4)
        assert sim.digest() == replaced
