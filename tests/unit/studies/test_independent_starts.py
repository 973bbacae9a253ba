"""The ensemble of a scene: other starts of its kind, or the same start but for a tiny variation."""

import copy
import pickle

import numpy as np
import pytest
from support.scenes import gas

import mpsim
from mpsim import Emitter, InputError, Scene
from mpsim.scene import scenefile
from mpsim.studies.independent_starts import VARIATION, Starts, varied

CRADLE = Scene.load("cradle")


def touching() -> Scene:
    """Three discs in a row that touch each other and both walls: none can be displaced along the row."""
    return Scene(width=3, height=4, position=[[0.5, 2], [1.5, 2], [2.5, 2]], velocity=np.zeros((3, 2)), radius=0.5)


# Scene.redrawn


@pytest.mark.parametrize("name", ["gas", "dense", "mixture", "brownian", "sediment"])
def test_another_start_is_of_the_same_kind(name):
    scene = Scene.load(name)
    other = scene.redrawn(1)
    assert not (other.position == scene.position).all()
    assert other.digest() == scene.redrawn(1).digest() != scene.redrawn(2).digest()
    for what in ("count", "width", "height", "packing", "boundary", "restitution", "duration", "largest_radius"):
        assert getattr(other, what) == getattr(scene, what), what
    assert np.array_equal(other.masses, scene.masses)
    energy = [float((each.masses[:, None] * each.velocity**2).sum()) for each in (scene, other)]
    assert energy[1] == pytest.approx(energy[0], rel=1e-9)
    assert other.overlaps_at_start() == ""
    assert other.redrawn(5).digest() != other.digest(), "another start has others, too"


def test_a_mixture_keeps_what_its_file_says_of_each_kind():
    scene = Scene.load("mixture")
    assert not scene.redrawn(3).velocity[:100].any(), "the heavy ones start at rest"


@pytest.mark.parametrize(
    "scene", [CRADLE, Scene.load("hopper"), gas(5, 0.1).starting_from(mpsim.State(*np.ones((2, 5, 2))))]
)
def test_a_scene_that_was_given_has_no_others(scene):
    assert not scene.can_redraw
    with pytest.raises(
        InputError, match=r"drawn at random, by Scene.random, Scene.lattice or a scene file.*Make other starts"
    ):
        scene.redrawn(1)


def test_seeds_are_checked():
    with pytest.raises(InputError, match="seed must be a whole number"):
        gas(5, 0.1).redrawn(-1)


def test_how_a_scene_was_made_is_no_part_of_it():
    scene = gas(5, 0.1)
    plain = Scene(
        width=scene.width, height=scene.height, position=scene.position, velocity=scene.velocity, radius=scene.radius
    )
    assert plain.digest() == scene.digest()
    assert not copy.copy(scene).can_redraw
    assert pickle.loads(pickle.dumps(scene)).digest() == scene.digest()


# The same start, varied


@pytest.mark.parametrize("name", scenefile.names())
def test_the_variation_is_tiny_and_leads_to_no_overlap(name):
    scene = Scene.load(name)
    other = varied(scene, 1)
    assert other.overlaps_at_start() == scene.overlaps_at_start() == ""
    assert np.abs(other.position - scene.position).max(initial=0) <= VARIATION * 2 * scene.smallest_radius
    energy = [float((each.masses[:, None] * each.velocity**2).sum()) for each in (scene, other)]
    assert energy[1] == pytest.approx(energy[0], rel=1e-12)
    moved = (other.position != scene.position).any() or other.emitters != scene.emitters
    assert moved, "discs at rest and scenes without any are varied, too"
    assert varied(scene, 1).digest() == other.digest() != varied(scene, 2).digest()


def test_a_disc_without_room_along_one_axis_is_displaced_along_the_other():
    other = varied(touching(), 3)
    assert (other.position[:, 0] == touching().position[:, 0]).all()
    assert (other.position[:, 1] != 2).any()


def test_what_an_emitter_adds_is_varied_and_stays_in_the_box():
    spout = Emitter((0.5, 0.5), (1.0, 2.0), interval=0.5)
    scene = Scene(width=4, height=4, position=[], velocity=[], radius=0.5, emitters=spout)
    places = np.array([varied(scene, seed).emitters[0].position for seed in range(20)])
    assert (places >= 0.5).all()
    assert len(np.unique(places[:, 0])) > 5
    assert np.abs(places - 0.5).max() <= VARIATION
    assert varied(scene, 1).emitters[0].velocity != spout.velocity


# Starts


def test_a_random_scene_has_starts_of_its_kind_and_a_given_one_its_own():
    scene = gas(10, 0.2)
    kind, same = Starts(scene), Starts(CRADLE)
    assert (kind.name, kind.same) == ("other starts of the same kind", False)
    assert (same.name, same.same) == ("this start, each disc displaced by up to 0.001 of a diameter", True)
    assert kind[0] is scene
    assert same[0] is CRADLE
    assert kind[3].digest() == scene.redrawn(3).digest()
    assert same[3].digest() == varied(CRADLE, 3).digest()
    assert Starts(scene, "same")[3].digest() == varied(scene, 3).digest()


def test_a_function_or_a_list_gives_starts():
    scenes = [gas(4, 0.1, seed) for seed in range(3)]
    assert Starts(scenes[0], scenes)[2] is scenes[2]
    assert Starts(scenes[0], scenes.__getitem__)[1] is scenes[1]
    with pytest.raises(InputError, match="a Scene for every run; 3 were given, and number 3 is needed"):
        Starts(scenes[0], scenes)[3]


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ("kinds", "starts must be 'kind', 'same', a function or a list of Scenes; got 'kinds'"),
        (5, "starts must be .*; got 5"),
        ([], r"starts must be .*; got \[\]"),
        ([1, 2], r"starts must be .*; got \[1, 2\]"),
        ("kind", "another start needs a scene that was drawn at random"),
    ],
)
def test_bad_starts_are_refused_by_name(given, text):
    with pytest.raises(InputError, match=text):
        Starts(CRADLE, given)


def test_a_function_that_gives_no_scene_is_refused():
    with pytest.raises(InputError, match="starts must give Scenes; for 0 it gave int"):
        Starts(CRADLE, lambda number: number)[2]


def test_a_file_of_other_starts_is_refused(tmp_path):
    """As before: the second function got the numbers of the first."""
    path = tmp_path / "kept.json"
    how = {"candidates": [mpsim.Settings(method="grid", dt=0.05)], "until": 2.0, "replicas": 2, "measures": "overlap"}

    def given(seed):
        return lambda number: Scene.random(count=20, packing=0.3, radius=0.5, seed=seed + number)

    scene = given(0)(0)
    first = mpsim.tradeoff(scene, starts=given(0), path=path, **how)
    assert mpsim.tradeoff(scene, starts=given(0), path=path, **how).rows[0].errors == first.rows[0].errors
    for other in (given(100), [given(0)(number) for number in range(8)], "same"):
        with pytest.raises(InputError, match="path must be a file of the same scene"):
            mpsim.tradeoff(scene, starts=other, path=path, **how)


def test_discs_before_a_piston_that_starts_inside_stay_before_it():
    """As before: they were displaced within the whole box, and most of these starts were refused."""
    scene = Scene(
        width=20,
        height=6,
        position=[[0.51 + 1.02 * k, 0.51 + 1.02 * row] for k in range(9) for row in range(5)],
        velocity=[[1, 0.5]] * 45,
        radius=0.5,
        piston=mpsim.Piston("right", -0.1, 9.0, start=9.18),
    )
    starts = Starts(scene)
    assert all(starts[number].position[:, 0].max() <= 9.18 - 0.5 for number in range(20))
    assert not np.array_equal(starts[1].position, scene.position), "and they are displaced"


def test_an_emitter_that_touches_an_obstacle_is_not_displaced_into_it():
    scene = Scene(
        width=12, height=10, position=[], velocity=[], radius=0.5,
        obstacles=mpsim.FixedDisc((3, 5), 1.0), emitters=Emitter((4.5, 5), (1, 0), interval=1.0, limit=5),
    )  # fmt: skip
    places = np.array([Starts(scene)[number].emitters[0].position for number in range(40)])
    assert (np.hypot(*(places - (3, 5)).T) >= 1.5).all()
    assert len(np.unique(places, axis=0)) > 10, "elsewhere it is"


@pytest.mark.parametrize(
    ("given", "text"),
    [
        (lambda: 3, r"starts must be a function of one number.*takes 0 positional arguments|too many positional"),
        (np.arange(3), "starts must be 'kind', 'same', a function or a list"),
    ],
)
def test_what_is_no_start_is_refused_in_words(given, text):
    with pytest.raises(InputError, match=text):
        Starts(CRADLE, given)


@pytest.mark.parametrize("path", [5, b"x/y", True, "a\0b"])
def test_what_is_no_path_is_refused_in_words(path):
    with pytest.raises(InputError, match="path must be a file in a folder that can be written to; got"):
        mpsim.tradeoff(gas(10, 0.2), path=path)
