"""A scene that is saved and loaded keeps every bit."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from support.scenefiles import HEAD

import mpsim
from mpsim.scene import scenefile
from mpsim.scene.scenefile import arrays

finite = st.floats(allow_nan=False, allow_infinity=False, min_value=-1e300, max_value=1e300)
tiny = st.floats(min_value=1e-3, max_value=0.2)
inside = st.floats(min_value=1.0, max_value=9.0)
fraction = st.floats(min_value=0, max_value=1)


def pairs(of, count):
    return st.lists(st.tuples(of, of), min_size=count, max_size=count)


@st.composite
def scenes(draw):
    """Scenes with every feature, some of each left out."""
    count = draw(st.sampled_from([0, 1, 2, 5, arrays.INLINE + 1]))
    few = min(count, 5)  # the rest repeats them, which is quicker and no easier

    def rows(of, size=2):
        drawn = draw(pairs(of, few) if size == 2 else st.lists(of, min_size=few, max_size=few))
        shape = (count, 2) if size == 2 else (count,)
        return np.resize(np.array(drawn, dtype=float), shape) if count else np.empty(shape)

    boundary = (draw(st.sampled_from(["walls", "periodic"])), "walls")
    features = {
        "gravity": draw(st.none() | st.tuples(finite, finite)),
        "acceleration": rows(finite) if draw(st.booleans()) else None,
        "mass": rows(st.floats(1e-3, 1e3), 1) if draw(st.booleans()) else None,
        "duration": draw(st.none() | st.floats(1e-9, 1e9)),
        "restitution": draw(fraction),
        "wall_restitution": draw(fraction),
        "absorbing": draw(st.sampled_from([(), ("bottom",), ("bottom", "top")])),
        "obstacles": draw(
            st.lists(
                st.builds(mpsim.FixedDisc, st.tuples(inside, inside), tiny)
                | st.builds(mpsim.Polyline, st.just([(1.0, 1.0), (1 / 3, 2.0), (3.0, 0.1)]), tiny | st.just(0.0)),
                max_size=3,
            )
        ),
        "emitters": draw(
            st.lists(
                st.builds(
                    mpsim.Emitter,
                    st.tuples(inside, inside),
                    st.tuples(finite, finite),
                    **draw(st.sampled_from([{"every": st.integers(1, 10**12)}, {"interval": st.floats(1e-9, 1e9)}])),
                    limit=st.none() | st.integers(1, 10**8),
                    radius=tiny,
                    mass=tiny,
                ),
                max_size=2,
            )
        ),
    }
    if draw(st.booleans()) and "top" not in features["absorbing"]:
        features["piston"] = mpsim.Piston("top", -draw(st.floats(1e-9, 1e9)), draw(st.floats(0.5, 9.5)))
    radius = rows(tiny, 1) if draw(st.booleans()) else draw(tiny)
    places = {"position": rows(inside), "velocity": rows(finite), "radius": radius}
    try:
        return mpsim.Scene(width=10.0, height=10.0, boundary=boundary, **places, **features)
    except mpsim.InputError as error:  # of a piston that leaves no room, or an emitter in an obstacle
        assume("arrangement of them is denser" not in str(error) and "from every obstacle" not in str(error))
        raise


@hypothesis_settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(scene=scenes())
def test_saved_and_loaded_a_scene_has_the_same_bits(scene, tmp_path):
    scene.save(tmp_path / "saved.toml")
    again = mpsim.Scene.load(tmp_path / "saved.toml")
    assert again.digest() == scene.digest()
    assert again.duration == scene.duration
    assert repr(again) == repr(scene)


@given(
    words=st.text(st.characters(exclude_categories=("Cs",)), max_size=50),
    look_for=st.text("\x7f\"'\\\n\t\b ", max_size=9),
)
@hypothesis_settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_texts_and_settings_are_saved_too(words, look_for, tmp_path):
    settings = mpsim.Settings(dt=1 / 3, method="grid", workers=2, law="reflect", precision="float32")
    scenefile.save(mpsim.Scene.load("cradle"), tmp_path / "a.toml", settings, title="x", text=words, look_for=look_for)
    file = scenefile.load(tmp_path / "a.toml")
    assert (file.settings, file.title, file.text, file.look_for) == (settings, "x", words, look_for)


def test_the_digest_tells_scenes_apart():
    one = mpsim.Scene(width=4, height=4, position=[[1, 1]], velocity=[[0, 0]], radius=0.5)
    other = mpsim.Scene(width=4, height=4, position=[[1, 1]], velocity=[[0, -0.0]], radius=0.5)
    assert one.digest() != other.digest()


def test_large_arrays_lie_beside_the_file_and_small_ones_in_it(tmp_path):
    gas = mpsim.Scene.random(count=65, packing=0.2, radius=0.5)
    gas.save(tmp_path / "gas.toml")
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "gas.position.npy",
        "gas.toml",
        "gas.velocity.npy",
    ]
    mpsim.Scene.load("cradle").save(tmp_path / "small.toml")
    assert not list(tmp_path.glob("small.*.npy"))


def test_a_saved_scene_is_found_from_any_folder_and_may_be_moved(tmp_path, monkeypatch):
    gas = mpsim.Scene.random(count=65, packing=0.2, radius=0.5)
    (tmp_path / "a").mkdir()
    gas.save(tmp_path / "a" / "gas.toml")
    monkeypatch.chdir(tmp_path)
    assert mpsim.Scene.load("a/gas.toml").digest() == gas.digest()
    (tmp_path / "a").rename(tmp_path / "b")
    assert mpsim.Scene.load(Path("b") / "gas.toml").digest() == gas.digest()


def test_saving_where_it_cannot_be_done(tmp_path):
    scene = mpsim.Scene.load("cradle")
    with pytest.raises(mpsim.InputError, match=r"path of a scene file must end in \.toml; got 'x\.txt'"):
        scene.save("x.txt")
    with pytest.raises(
        mpsim.errors.OutputError, match=r"path must be a place where files can be written; got .*No such file"
    ):
        scene.save(tmp_path / "none" / "x.toml")
    (tmp_path / "folder.toml").mkdir()
    with pytest.raises(mpsim.errors.OutputError, match=r"Is a directory"):
        scene.save(tmp_path / "folder.toml")
    assert [path.name for path in tmp_path.iterdir()] == ["folder.toml"]


def test_arrays_of_other_kinds_of_numbers_are_fine(load, tmp_path):
    for kind in ("<f4", ">f8", "i2", "u8"):
        np.save(tmp_path / "a.npy", np.array([[1, 2], [3, 4]], dtype=kind))
        scene = load(HEAD + "[[discs]]\nposition = 'a.npy'\nradius = 0.5\n").scene
        assert scene.position.tolist() == [[1, 2], [3, 4]]
