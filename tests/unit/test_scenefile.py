"""Scene files: what they may hold, every error with its text and all at once, and a round trip that keeps every bit."""

import logging
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from support.compare import overlapping_pairs

import mpsim
from mpsim.scene import scenefile
from mpsim.scene.scenefile import arrays, schema

HEAD = "schema = 1\nwidth = 10.0\nheight = 8.0\n"
ONE = "[[discs]]\nposition = [[2.0, 3.0]]\nradius = 0.5\n"


@pytest.fixture
def load(tmp_path):
    """Load a scene file of this text."""

    def load_text(text: str) -> scenefile.SceneFile:
        path = tmp_path / "scene.toml"
        path.write_text(text)
        return scenefile.load(path)

    return load_text


# --- what a file means


def test_a_file_says_the_same_as_python(load, tmp_path):
    np.save(tmp_path / "mass.npy", np.array([1.0, 2.5]))
    (tmp_path / "speeds.csv").write_text("vx, vy\n1, 0\n\n-0.5, 1e-3\n")
    file = load("""
        schema = 1
        width = 20
        height = 10.0
        boundary = ["periodic", "walls"]
        gravity = [0, -1]
        restitution = 0.9
        wall_restitution = 0.8
        absorbing = ["bottom"]
        duration = 12.5
        obstacles = [{ position = [5, 5], radius = 1 }, { points = [[1, 1], [2, 1], [2, 3]], thickness = 0.1 }]
        [about]
        title = "A test"
        look_for = "Nothing."
        [settings]
        dt = 0.5
        passes = 2
        [[discs]]
        position = [[1, 2], [9, 3]]
        velocity = "speeds.csv"
        radius = [0.5, 0.25]
        mass = "mass.npy"
        acceleration = [1, 0]
        [[emitters]]
        position = [10, 5]
        velocity = [1, 1]
        every = 7
        limit = 3
        radius = 0.2
        mass = 2
        [piston]
        wall = "top"
        speed = -1
        stop = 6
    """)
    same = mpsim.Scene(
        width=20,
        height=10,
        boundary=("periodic", "walls"),
        gravity=(0, -1),
        restitution=0.9,
        wall_restitution=0.8,
        absorbing="bottom",
        position=[[1, 2], [9, 3]],
        velocity=[[1, 0], [-0.5, 1e-3]],
        radius=[0.5, 0.25],
        mass=[1, 2.5],
        acceleration=[[1, 0], [1, 0]],
        obstacles=[mpsim.FixedDisc((5, 5), 1), mpsim.Polyline([(1, 1), (2, 1), (2, 3)], 0.1)],
        emitters=mpsim.Emitter((10, 5), (1, 1), every=7, limit=3, radius=0.2, mass=2),
        piston=mpsim.Piston("top", -1, 6),
    )
    assert file.scene.digest() == same.digest()
    assert file.scene.duration == 12.5
    assert file.settings == mpsim.Settings(dt=0.5, passes=2)
    assert (file.name, file.title, file.text, file.look_for) == ("scene", "A test", "", "Nothing.")
    assert [path.name for path in file.read] == ["scene.toml", "mass.npy", "speeds.csv"]


def test_random_places_are_those_of_python(load):
    text = 'schema = 1\n{}[[discs]]\nplaces = "random"\ncount = 50\nradius = 0.5\ntemperature = 2.0\nseed = 3\n'
    same = mpsim.Scene.random(count=50, packing=0.3, radius=0.5, temperature=2.0, seed=3)
    assert load(text.format("packing = 0.3\n")).scene.digest() == same.digest()
    same = mpsim.Scene.random(count=50, width=10, height=20, radius=0.5, temperature=2.0, seed=3)
    assert load(text.format("width = 10\nheight = 20\n")).scene.digest() == same.digest()


def test_random_places_in_a_periodic_box_among_obstacles_are_those_of_python(load):
    radii = [0.5] * 20 + [0.25] * 30
    text = f"""
        {HEAD}
        boundary = ["periodic", "walls"]
        obstacles = [{{ position = [5, 4], radius = 1.0 }}]
        [[discs]]
        places = "random"
        count = 50
        radius = {radii}
        mass = 2.0
        temperature = 1.5
        seed = 9
    """
    same = mpsim.Scene.random(
        count=50,
        width=10,
        height=8,
        radius=radii,
        mass=2.0,
        temperature=1.5,
        seed=9,
        boundary=("periodic", "walls"),
        obstacles=mpsim.FixedDisc((5, 4), 1.0),
    )
    assert load(text).scene.digest() == same.digest()


def test_random_places_in_a_region_lie_in_it(load):
    group = '[[discs]]\nplaces = "random"\ncount = 12\nradius = {}\nregion = [2, 3, 5, 6]\n'
    for radius in (0.25, [0.125, 0.25] * 6):
        for others in ("", ONE):
            scene = load(HEAD + group.format(radius) + others.replace("2.0, 3.0", "9.0, 7.0")).scene
            places = scene.position[:12]
            assert (places >= [2, 3]).all()
            assert (places <= [5, 6]).all()


def test_groups_at_random_places_keep_clear_of_each_other_and_of_obstacles(load):
    scene = load(
        HEAD
        + """
        obstacles = [{ position = [5, 4], radius = 1.5 }, { points = [[1, 1], [3, 1]], thickness = 0.2 }]
        [[discs]]
        position = [[2.0, 5.0]]
        radius = 1.0
        [[discs]]
        places = "random"
        count = 60
        radius = 0.25
        temperature = 1.0
        """
    ).scene
    from mpsim.features.capsules import distance  # noqa: PLC0415

    assert scene.count == 61
    assert not len(overlapping_pairs(scene.position[1:], 0.5)[0])
    assert np.hypot(*(scene.position[1:] - scene.position[0]).T).min() >= 1.25
    assert distance(scene.position[:, None], scene.capsules)[1:].min() >= 0.25
    assert scene.velocity[0].tolist() == [0, 0]


@pytest.mark.parametrize(("kind", "count"), [("square", 12), ("hexagonal", 30)])
def test_a_lattice_fills_the_box(load, kind, count):
    scene = load(HEAD + f'[[discs]]\nplaces = "{kind}"\ncount = {count}\nradius = 0.4\n').scene
    gaps = np.hypot(*np.moveaxis(scene.position[:, None] - scene.position, 2, 0))[~np.eye(count, dtype=bool)]
    nearest = float(gaps.min())
    assert nearest >= 0.8
    assert scene.count == count
    with_spacing = load(HEAD + f'[[discs]]\nplaces = "{kind}"\nspacing = {nearest!r}\nradius = 0.4\n').scene
    assert with_spacing.count >= count
    assert (with_spacing.position.min(axis=0) == 0.4).all()


def test_a_lattice_of_pegs(load):
    pegs = 'obstacles = [{ places = "square", spacing = 2.0, region = [1, 1, 5, 3], radius = 0.5 }]\n'
    scene = load(HEAD + pegs + ONE.replace("2.0, 3.0", "8.0, 3.0")).scene
    assert [peg.position for peg in scene.obstacles] == [(x, y) for y in (1, 3) for x in (1, 3, 5)]


def test_thermal_velocities_have_the_temperature_and_no_momentum_whatever_the_masses(load):
    masses = ", ".join(str(1 + index % 3) for index in range(30))
    scene = load(
        HEAD + f'[[discs]]\nplaces = "square"\ncount = 30\nradius = 0.1\nmass = [{masses}]\ntemperature = 1.5\n'
    ).scene
    assert (scene.masses[:, None] * scene.velocity**2).mean() == pytest.approx(1.5, rel=1e-12)
    assert np.abs((scene.masses[:, None] * scene.velocity).sum(axis=0)).max() < 1e-12


def test_groups_are_joined(load):
    groups = [ONE, ONE.replace("2.0, 3.0", "6.0, 3.0")]
    scene = load(HEAD + groups[0] + groups[1]).scene
    assert (scene.count, scene.radius, scene.mass, scene.acceleration) == (2, 0.5, None, None)
    scene = load(HEAD + groups[0] + groups[1] + "mass = 2\nacceleration = [1, 2]\n").scene
    assert (scene.masses.tolist(), scene.acceleration.tolist()) == ([1, 2], [[0, 0], [1, 2]])
    scene = load(HEAD + groups[0] + groups[1].replace("0.5", "0.25")).scene
    assert scene.radii.tolist() == [0.5, 0.25]


def test_a_scene_may_begin_without_discs(load):
    assert load(HEAD).scene.count == 0
    emitter = "[[emitters]]\nposition = [5, 5]\nvelocity = [1, 0]\ninterval = 0.5\n"
    assert load(HEAD + "[[discs]]\nposition = []\nradius = 0.5\n" + emitter).scene.largest_radius == 0.5
    assert load(HEAD + emitter + "radius = 0.25\nmass = 1\n").scene.largest_radius == 0.25


# --- round trip

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
    settings = mpsim.Settings(dt=1 / 3, method="grid", workers=2, unguarded=True, precision="float32")
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
    with pytest.raises(mpsim.OutputError, match=r"path must be a place where files can be written; got .*No such file"):
        scene.save(tmp_path / "none" / "x.toml")
    (tmp_path / "folder.toml").mkdir()
    with pytest.raises(mpsim.OutputError, match=r"Is a directory"):
        scene.save(tmp_path / "folder.toml")
    assert [path.name for path in tmp_path.iterdir()] == ["folder.toml"]


# --- arrays in files


def test_arrays_of_other_kinds_of_numbers_are_fine(load, tmp_path):
    for kind in ("<f4", ">f8", "i2", "u8"):
        np.save(tmp_path / "a.npy", np.array([[1, 2], [3, 4]], dtype=kind))
        scene = load(HEAD + "[[discs]]\nposition = 'a.npy'\nradius = 0.5\n").scene
        assert scene.position.tolist() == [[1, 2], [3, 4]]


def test_what_is_read_is_logged(load, tmp_path, caplog):
    (tmp_path / "sub").mkdir()
    np.save(tmp_path / "sub" / "a.npy", np.ones((1, 2)))
    with caplog.at_level(logging.INFO, logger="mpsim"):
        load(HEAD + "[[discs]]\nposition = 'sub/a.npy'\nradius = 0.5\n")
    assert [Path(record.args[0]).name for record in caplog.records] == ["scene.toml", "a.npy"]


# --- names and paths


def test_an_unknown_name_is_answered_with_the_names():
    with pytest.raises(
        mpsim.InputError, match=r"scene must be a path that ends in \.toml or one of brownian, .*cradle"
    ):
        mpsim.Scene.load("nonsense")
    with pytest.raises(mpsim.InputError, match=r"got 'hoper'\. Did you mean 'hopper'\?"):
        mpsim.Scene.load("hoper")


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(mpsim.InputError, match=r"scene must be a file that can be read; got .*No such file"):
        mpsim.Scene.load(tmp_path / "none.toml")
    (tmp_path / "folder.toml").mkdir()
    with pytest.raises(mpsim.InputError, match=r"scene must be a file that can be read; got .*Is a directory"):
        mpsim.Scene.load(str(tmp_path / "folder.toml"))
    with pytest.raises(mpsim.InputError, match=r"scene must be a name or a path to a \.toml file; got int\."):
        mpsim.Scene.load(3)  # type: ignore[arg-type]
    with pytest.raises(mpsim.InputError, match="scene must be a file that can be read; got"):
        mpsim.Scene.load("a\0.toml")
    (tmp_path / "latin.toml").write_bytes(b"schema = 1 # \xe9")
    with pytest.raises(mpsim.SceneFileError, match=r"the file must be text in UTF-8; got byte 13"):
        mpsim.Scene.load(tmp_path / "latin.toml")


def test_the_error_survives_a_pickle():
    error = mpsim.SceneFileError("a.toml", ["one", "two"])
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.problems) == ("2 problems in a scene file:\na.toml: one\na.toml: two", ("one", "two"))


def test_the_settings_of_a_file_are_those_of_python():
    assert schema.keys_of(schema.SettingsTable) == list(mpsim.Settings.__dataclass_fields__)


def test_the_keys_of_a_file_are_the_arguments_of_python():
    arguments = set(mpsim.Scene.__init__.__annotations__) - {"return"}
    keys = set(schema.keys_of(schema.SceneTable)) | set(schema.keys_of(schema.Discs))
    assert not arguments - keys, f"a scene file lacks {arguments - keys}"
    for table, kind in ((schema.LEVELS["emitters"][0], mpsim.Emitter), (schema.LEVELS["piston"][0], mpsim.Piston)):
        assert schema.keys_of(table) == list(kind.__dataclass_fields__)


def test_the_checker_is_loaded_only_where_a_file_is_read():
    code = (
        "import sys, mpsim; assert 'pydantic' not in sys.modules; "
        "mpsim.Scene.load('cradle'); assert 'pydantic' in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
