"""What features have of each disc and of the scene reaches scenes and files from one declaration."""

import dataclasses

import numpy as np
import pytest

import mpsim
from mpsim.engine import checkpoint_scene
from mpsim.features import FEATURES, NUMBERS, PER_DISC, VECTORS
from mpsim.features.masses import has_masses
from mpsim.features.radii import has_radii
from mpsim.scene.scenefile import schema

EACH = {"radius": [0.3, 0.4, 0.5], "mass": [1.0, 2.0, 3.0], "acceleration": [[0, 1], [2, 3], [4, 5]], "spin": [1, 2, 3]}


def scene(**given):
    places, rest = [[1, 1], [3, 3], [5, 5]], np.zeros((3, 2))
    return mpsim.Scene(**{"width": 8, "height": 8, "position": places, "velocity": rest, "radius": 0.5} | given)


def test_there_is_a_value_of_each():
    assert EACH.keys() == PER_DISC.keys()


@pytest.mark.parametrize("name", PER_DISC)
def test_discs_that_stay_keep_what_is_their_own(name):
    whole = scene(**{name: EACH[name]})
    state = mpsim.State(whole.position, whole.velocity, present=np.array([True, False, True]))
    assert np.array_equal(getattr(whole.starting_from(state), name), np.array(EACH[name])[[0, 2]])


@pytest.mark.parametrize("name", PER_DISC)
def test_files_hold_what_each_disc_has(name, tmp_path):
    whole = scene(**{name: EACH[name]})
    whole.save(tmp_path / "own.toml")
    for read in (
        mpsim.Scene.load(tmp_path / "own.toml"),
        checkpoint_scene.scene_from(*checkpoint_scene.scene_parts(whole)),
    ):
        assert np.array_equal(getattr(read, name), EACH[name])
        assert read.digest() == whole.digest()


@pytest.mark.parametrize("name", PER_DISC)
def test_discs_of_a_group_that_gives_none_have_the_default(name, tmp_path):
    each = PER_DISC[name]
    own = np.array(EACH[name][0], float).tolist()
    group = "[[discs]]\nposition = [[{x}, 1]]\n"
    radius = "" if name == "radius" else "radius = 0.5\n"
    first = f"{group.format(x=1)}{radius}{name} = {[own] if each.components else own}\n"
    second = group.format(x=4) + radius
    (tmp_path / "two.toml").write_text(f"schema = 1\nwidth = 8\nheight = 8\n{first}{second}")
    if each.default is None:
        with pytest.raises(mpsim.InputError, match=r"discs\[1\].radius"):
            mpsim.Scene.load(tmp_path / "two.toml")
        return
    read = getattr(mpsim.Scene.load(tmp_path / "two.toml"), name)
    expected = [own, np.full_like(own, each.default)]
    assert (read is None) if np.all(np.array(expected) == 1) else np.array_equal(read, expected)


def test_every_argument_of_a_feature_is_a_key_of_scene_files():
    assert {*NUMBERS, *VECTORS} <= schema.SceneTable.model_fields.keys()
    assert PER_DISC.keys() <= schema.Discs.model_fields.keys()


def test_the_first_argument_of_numbers_names_the_feature():
    for feature in FEATURES:
        first = [*feature.numbers, *feature.vectors, *feature.per_disc][:1]
        assert first in ([], [feature.argument])
        assert feature.is_numeric == bool(first)


def test_masses_and_radii_of_emitters_count():
    """The control: those of all discs do not."""
    for given, masses, radii in (
        ({}, False, False), ({"mass": 2.0}, True, False), ({"radius": 0.4}, False, True), ({"mass": 1}, False, False),
        ({"radius": 0.5}, False, False),
    ):  # fmt: skip
        with_emitter = scene(emitters=mpsim.Emitter((1, 7), (1, 0), interval=1.0, **given))
        assert (has_masses(with_emitter), has_radii(with_emitter)) == (masses, radii)
        assert "mass" not in repr(with_emitter)


def test_the_arguments_of_features_are_those_of_scenes():
    assert dataclasses.is_dataclass(mpsim.Piston)
    names = {*NUMBERS, *VECTORS, *PER_DISC, *(feature.argument for feature in FEATURES)}
    assert all(hasattr(scene(), name) for name in names)
