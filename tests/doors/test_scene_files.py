"""Scene files: they say the same as Python, keep every bit, name all that is wrong in them, and can do no harm."""

import logging
from pathlib import Path

import numpy as np
import pytest
from support.commands import mpsim_command
from support.compare import overlapping_pairs
from support.scenes import zoo
from support.selection import long_but

import mpsim
from mpsim import Emitter, FixedDisc, InputError, Piston, Polyline, Scene, Settings

pytestmark = pytest.mark.plain

HEAD = "schema = 1\nwidth = 10.0\nheight = 8.0\n"
ONE = "[[discs]]\nposition = [[2.0, 3.0]]\nradius = 0.5\n"


@pytest.fixture
def load(tmp_path):
    """Load a scene file of this text."""

    def load_text(text):
        (tmp_path / "scene.toml").write_text(text)
        return Scene.load(tmp_path / "scene.toml")

    return load_text


@pytest.fixture
def problems(load):
    """All that is wrong in a scene file of this text."""

    def problems_of(text):
        with pytest.raises(mpsim.errors.SceneFileError) as caught:
            load(text)
        assert caught.value.file.endswith("scene.toml")
        for problem in caught.value.problems:
            assert f"{caught.value.file}: {problem}" in str(caught.value)
        return list(caught.value.problems)

    return problems_of


# --- what a file says


def test_a_byte_order_mark_before_a_scene_or_a_session_is_no_part_of_it(load, tmp_path):
    assert load("\ufeff" + HEAD + ONE).position.tolist() == [[2, 3]]
    with mpsim.Simulation(load(HEAD + ONE), Settings(method="naive")) as sim:
        sim.journal.save(tmp_path / "session.toml")
    for each in tmp_path.glob("session*.toml"):
        each.write_bytes(b"\xef\xbb\xbf" + each.read_bytes())
    with mpsim.Simulation.replay(tmp_path / "session.toml") as again:
        assert again.count == 1


def test_a_file_says_the_same_as_python(load, tmp_path, caplog):
    np.save(tmp_path / "mass.npy", np.array([1.0, 2.5], ">f4"))
    (tmp_path / "speeds.csv").write_text("vx, vy\n1, 0\n\n-0.5, 1e-3\n")
    with caplog.at_level(logging.INFO, logger="mpsim"):
        scene = load("""
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
    same = Scene(
        width=20, height=10, boundary=("periodic", "walls"), gravity=(0, -1), restitution=0.9, wall_restitution=0.8,
        absorbing="bottom", position=[[1, 2], [9, 3]], velocity=[[1, 0], [-0.5, 1e-3]], radius=[0.5, 0.25],
        mass=[1, 2.5], acceleration=[[1, 0], [1, 0]], piston=Piston("top", -1, 6),
        obstacles=[FixedDisc((5, 5), 1), Polyline([(1, 1), (2, 1), (2, 3)], 0.1)],
        emitters=Emitter((10, 5), (1, 1), every=7, limit=3, radius=0.2, mass=2),
    )  # fmt: skip
    assert scene.digest() == same.digest()
    assert (scene.duration, scene.settings) == (12.5, Settings(dt=0.5, passes=2))
    shown = mpsim_command("show", tmp_path / "scene.toml").stdout
    assert "A test" in shown
    assert "Nothing." in shown
    assert [Path(record.args[0]).name for record in caplog.records[:3]] == ["scene.toml", "speeds.csv", "mass.npy"]


def test_random_places_are_those_of_python(load):
    text = 'schema = 1\n{}[[discs]]\nplaces = "random"\ncount = 30\nradius = 0.5\ntemperature = 2.0\nseed = 3\n'
    for head, box in (
        ("packing = 0.3\n", {"packing": 0.3}),
        ("width = 10\nheight = 20\n", {"width": 10, "height": 20}),
    ):
        same = Scene.random(count=30, radius=0.5, temperature=2.0, seed=3, **box)
        assert load(text.format(head)).digest() == same.digest()
    radii = [0.5] * 10 + [0.25] * 20
    scene = load(f"""
        {HEAD}
        boundary = ["periodic", "walls"]
        obstacles = [{{ position = [5, 4], radius = 1.0 }}]
        [[discs]]
        places = "random"
        count = 30
        radius = {radii}
        mass = 2.0
        temperature = 1.5
        seed = 9
    """)
    same = Scene.random(count=30, width=10, height=8, radius=radii, mass=2.0, temperature=1.5, seed=9,
                        boundary=("periodic", "walls"), obstacles=FixedDisc((5, 4), 1.0))  # fmt: skip
    assert scene.digest() == same.digest()


def test_random_places_lie_in_their_region_and_keep_clear_of_all_that_is_there(load):
    group = '[[discs]]\nplaces = "random"\ncount = 12\nradius = {}\nregion = [2, 3, 5, 6]\n'
    for radius in (0.25, [0.125, 0.25] * 6):
        places = load(HEAD + group.format(radius) + ONE.replace("2.0, 3.0", "9.0, 7.0")).position[:12]
        assert (places >= [2, 3]).all()
        assert (places <= [5, 6]).all()
    scene = load(
        HEAD
        + "obstacles = [{ position = [5, 4], radius = 1.5 }, { points = [[1, 1], [3, 1]], thickness = 0.2 }]\n"
        + "[[discs]]\nposition = [[2.0, 5.0]]\nradius = 1.0\n"
        + '[[discs]]\nplaces = "random"\ncount = 40\nradius = 0.25\ntemperature = 1.0\n'
    )
    assert (scene.count, scene.overlaps_at_start(), scene.velocity[0].tolist()) == (41, "", [0, 0])
    assert not len(overlapping_pairs(scene.position[1:], 0.5)[0])


@pytest.mark.parametrize(("kind", "count"), [("square", 12), ("hexagonal", 30)])
def test_a_lattice_fills_the_box_and_pegs_may_stand_on_one(load, kind, count):
    scene = load(HEAD + f'[[discs]]\nplaces = "{kind}"\ncount = {count}\nradius = 0.4\n')
    gaps = np.hypot(*np.moveaxis(scene.position[:, None] - scene.position, 2, 0))[~np.eye(count, dtype=bool)]
    nearest = float(gaps.min())
    assert (scene.count, nearest >= 0.8) == (count, True)
    spaced = load(HEAD + f'[[discs]]\nplaces = "{kind}"\nspacing = {nearest!r}\nradius = 0.4\n')
    assert spaced.count >= count
    assert (spaced.position.min(axis=0) == 0.4).all()
    pegs = 'obstacles = [{ places = "square", spacing = 2.0, region = [1, 1, 5, 3], radius = 0.5 }]\n'
    obstacles = load(HEAD + pegs + ONE.replace("2.0, 3.0", "8.0, 3.0")).obstacles
    assert [peg.position for peg in obstacles] == [(x, y) for y in (1, 3) for x in (1, 3, 5)]


def test_groups_are_joined_and_there_may_be_none(load):
    groups = ONE + ONE.replace("2.0, 3.0", "6.0, 3.0")
    scene = load(HEAD + groups)
    assert (scene.count, scene.radius, scene.mass, scene.acceleration) == (2, 0.5, None, None)
    scene = load(HEAD + groups + "mass = 2\nacceleration = [1, 2]\n")
    assert (scene.masses.tolist(), scene.acceleration.tolist()) == ([1, 2], [[0, 0], [1, 2]])
    assert load(HEAD + ONE + groups[len(ONE) :].replace("0.5", "0.25")).radii.tolist() == [0.5, 0.25]
    emitter = "[[emitters]]\nposition = [5, 5]\nvelocity = [1, 0]\ninterval = 0.5\n"
    assert load(HEAD).count == 0
    assert load(HEAD + "[[discs]]\nposition = []\nradius = 0.5\n" + emitter).largest_radius == 0.5
    masses = [1 + index % 3 for index in range(30)]
    warm = load(HEAD + f'[[discs]]\nplaces = "square"\ncount = 30\nradius = 0.1\nmass = {masses}\ntemperature = 1.5\n')
    assert (warm.masses[:, None] * warm.velocity**2).mean() == pytest.approx(1.5, rel=1e-12)
    assert np.abs((warm.masses[:, None] * warm.velocity).sum(axis=0)).max() < 1e-12


NINE = "schema = 1\nwidth = 4\nheight = 4\n"
TABLE = "[compressed]\npacking = 0.7\nrate = 1.0\n"
DISCS = "[[discs]]\nplaces = 'random'\ncount = 9\nradius = 0.5\ntemperature = 1.0\nseed = 3\n"


def test_a_compressed_start_has_the_bits_of_python_and_keeps_them(load, tmp_path, caplog):
    before = load(NINE + DISCS)
    assert "compressed to" not in mpsim_command("show", tmp_path / "scene.toml").stdout
    with caplog.at_level(logging.INFO, logger="mpsim"):
        scene = load(NINE + TABLE + DISCS)
    assert "compressing <Scene: 9 discs" in caplog.text
    same = before.compressed(0.7, rate=1.0)
    assert scene.digest() == same.digest() != before.digest()
    assert scene.redrawn(5).digest() == same.redrawn(5).digest() != same.digest()
    assert "compressed to packing 0.7 at rate 1\n" in mpsim_command("show", tmp_path / "scene.toml").stdout
    scene.save(tmp_path / "saved.toml")
    assert "compressed" not in (tmp_path / "saved.toml").read_text()
    assert Scene.load(tmp_path / "saved.toml").digest() == scene.digest()


# --- saving

EVERYTHING = "gravity acceleration giants masses lossy rough obstacles absorbing piston emitters periodic-x"
ODD = [5e-324, -1 / 3, 1e300, -0.0, np.nextafter(1, 2), -1e-310]


@pytest.mark.parametrize(
    ("words", "count"), [("", 0), ("", 70), ("obstacles emitters radii heated", 1), (EVERYTHING, 5), (EVERYTHING, 70)]
)
def test_saved_and_loaded_a_scene_has_the_same_bits(words, count, tmp_path):
    """Of discs that stand in the file, and of more than do."""
    own = {"duration": 1 / 3, "settings": Settings(dt=1 / 3, law="reflect", workers=2)} if words else {}
    scene = zoo(words, count, velocity=np.resize(ODD, (count, 2)), **own)
    scene.save(tmp_path / "saved.toml")
    again = Scene.load(tmp_path / "saved.toml")
    assert again.digest() == scene.digest()
    assert (again.duration, again.settings, repr(again)) == (scene.duration, scene.settings, repr(scene))


def test_large_arrays_lie_beside_the_file_which_may_be_moved(tmp_path, monkeypatch):
    gas = Scene.random(count=65, packing=0.2, radius=0.5)
    (tmp_path / "a").mkdir()
    gas.save(tmp_path / "a" / "gas.toml")
    Scene.load("cradle").save(tmp_path / "a" / "small.toml")
    assert sorted(path.name for path in (tmp_path / "a").iterdir()) == [
        "gas.position.npy", "gas.toml", "gas.velocity.npy", "small.toml",
    ]  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert Scene.load("a/gas.toml").digest() == gas.digest()
    (tmp_path / "a").rename(tmp_path / "b")
    assert Scene.load(Path("b") / "gas.toml").digest() == gas.digest()


def test_very_many_obstacles_and_emitters_are_saved_as_arrays_and_come_back(tmp_path):
    rng, turn = np.random.default_rng(1), np.linspace(0, 2 * np.pi, 61)
    pegs = [FixedDisc(place, 0.001) for place in rng.uniform(0, 9, (1000, 2))]
    circles = [Polyline(20 + rng.uniform(1, 9) * np.stack([np.cos(turn), np.sin(turn)], 1)) for _ in range(100)]
    lines = [Polyline(rng.uniform(0, 40, (2 + k % 3, 2)), k % 2 / 8) for k in range(300)]
    spouts = [Emitter(place, (0, 1), every=3 + k) for k, place in enumerate(rng.uniform(41, 49, (100, 2)))]
    others = [Emitter((45, 45), (1, 1e-300 * k), interval=1 + k, limit=4, mass=2) for k in range(70)]
    scene = Scene(width=50, height=50, position=[], velocity=[], radius=0.1, obstacles=[*circles, *pegs, *lines],
                  emitters=[*spouts, *others, Emitter((45, 45), (1, 1), interval=1)])  # fmt: skip
    scene.save(tmp_path / "scene.toml")
    text = (tmp_path / "scene.toml").read_text()
    assert (text.count("[[obstacles]]"), text.count("[[emitters]]")) == (401, 3), "pegs and emitters are arrays"
    found = Scene.load(tmp_path / "scene.toml")
    assert (found.obstacles, found.emitters, found.digest()) == (scene.obstacles, scene.emitters, scene.digest())


def test_files_that_cannot_be_written_or_read_are_refused(tmp_path):
    scene = Scene.load("cradle")
    (tmp_path / "folder.toml").mkdir()
    (tmp_path / "latin.toml").write_bytes(b"schema = 1 # \xe9")
    for act, kind, text in (
        (lambda: scene.save("x.txt"), InputError, r"path of a scene file must end in \.toml; got 'x\.txt'"),
        (lambda: scene.save(tmp_path / "none" / "x.toml"), mpsim.errors.OutputError, "written; got .*No such file"),
        (lambda: scene.save(tmp_path / "folder.toml"), mpsim.errors.OutputError, "Is a directory"),
        (lambda: Scene.load("nonsense"), InputError, r"a path that ends in \.toml or one of brazil-nut, .*cradle"),
        (lambda: Scene.load("hoper"), InputError, r"got 'hoper'\. Did you mean 'hopper'\?"),
        (lambda: Scene.load(tmp_path / "none.toml"), InputError, "must be a file that can be read; got .*No such file"),
        (lambda: Scene.load(str(tmp_path / "folder.toml")), InputError, "that can be read; got .*Is a directory"),
        (lambda: Scene.load(3), InputError, r"scene must be a name or a path to a \.toml file; got int\."),
        (lambda: Scene.load("a\0.toml"), InputError, "scene must be a file that can be read; got"),
        (lambda: Scene.load(tmp_path / "latin.toml"), mpsim.errors.SceneFileError, "text in UTF-8; got byte 13"),
    ):  # fmt: skip
        with pytest.raises(kind, match=text):
            act()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder.toml", "latin.toml"]


# --- what is wrong in a file

ALL = """
schema = 1
widht = 3
height = -2
gravity = ["1", 2]
boundary = 3
absorbing = ["botom"]
restitution = inf
obstacles = [{ position = [1, 2], radius = -1 }, { points = [[1, 1]] }, { point = [[1, 2]] }, 5]
[about]
titel = "x"
text = 3
[settings]
dt = -1
method = "gird"
wrokers = 3
[[discs]]
position = [[1, 2], [3]]
radius = nan
[[discs]]
position = "../x.npy"
radius = "r.npy"
mass = "/etc/passwd"
[[discs]]
count = 5
radius = 1
[[discs]]
position = [[1, 1]]
radius = 1
temprature = 1
[compressed]
rat = 1
[[emitters]]
position = [1, 1]
every = 0
limt = 4
[piston]
wall = "lef"
speed = nan
stop = -1
colour = "red"
"""


def test_all_problems_are_told_at_once_each_by_its_key(problems):
    found = problems(ALL)
    keys = """about.text about.titel about.title absorbing boundary compressed.packing compressed.rat discs[0].position
              discs[0].radius discs[1].mass discs[1].position discs[1].radius discs[2] discs[3].temprature
              emitters[0].every emitters[0].limt emitters[0].velocity
              gravity height obstacles[0].radius obstacles[1].points obstacles[2].point obstacles[2].points
              obstacles[3] piston.colour piston.speed piston.stop piston.wall restitution
              settings.dt settings.method settings.wrokers widht"""
    assert sorted(text.split(" must ")[0] for text in found) == sorted(keys.split())
    for whole in (
        "absorbing must be one of 'left', 'right', 'bottom', 'top'; got 'botom'. Did you mean 'bottom'?",
        "about.title must be given; got nothing.",
        "widht must be a key of a scene file; this one is unknown, with the value 3. Did you mean 'width'?",
        "discs[0].position must be numbers of shape (N, 2); got rows of different lengths, 1 to 2.",
        "discs[1].position must be a file in the folder of the scene file, or below; got '../x.npy', which is not. "
        "Move the file there, or make the scene in Python.",
        "discs[2] must have either position or places; got neither.",
        "emitters[0].every must be a whole number from 1 to 1000000000000; got 0. One disc every `every` frames.",
        "piston.colour must be a key of a scene file; this one is unknown, with the value 'red'. "
        "Keys there: wall, speed, stop, start, motion, surface_velocity.",
    ):
        assert whole in found
    for near in ("title", "width", "rate", "temperature", "points", "limit", "workers"):
        assert any("this one is unknown" in text and text.endswith(f"Did you mean {near!r}?") for text in found), near
    placed = HEAD + "absorbing = ['left']\nboundary = ['periodic', 'walls']\n"
    placed += "obstacles = [{ position = [11, 1], radius = 1 }]\n" + ONE
    placed += ONE.replace("[2.0, 3.0]", "[4.0, 3.0], [9.9, 9.0]") + "[piston]\nwall = 'top'\nspeed = -1\nstop = 9\n"
    assert {text.split(" must ")[0] for text in problems(placed)} == {
        "discs[1].position[1]", "obstacles[0]", "absorbing", "piston.stop",
    }  # fmt: skip


SQUARE, RANDOM = "[[discs]]\nplaces = 'square'\nradius = 1\n", "[[discs]]\nplaces = 'random'\nradius = 1\n"
EMITTER = "emitters = [{ position = [1, 1], velocity = [1, 0], radius = 1 }]"
WRONG = [
    ("", "schema must be given; got nothing. Write 'schema = 1' at the top."),
    ("schema = 1\nwidth = 3", "the box must be given either by packing or by width and height; got packing=None, wi"),
    ("schema = 1\npacking = 0.3\n" + SQUARE + "spacing = 1.0", "discs[0].count must be given where packing makes th"),
    ("schema = 2\nnonsense = 3", "schema must be 1, which this mpsim reads; got 2."),
    (HEAD.replace("10.0", "1" + "0" * 400), "width must be a finite number > 0 [length], finite in float64; got a wh"),
    (HEAD + f"gravity = [1, 1{'0' * 400}]", "gravity[1] must be finite in float64; got a whole number of 401 digits."),
    (HEAD + "[discs]\nradius = 3", "discs must be a list of tables, [[discs]] for each; got {'radius': 3}."),
    (HEAD + "settings = { method = ['grid'] }", "settings.method must be one of 'naive', 'grid', 'parallel', 'event'"),
    (HEAD + ONE + "velocity = [[1, 2], [3, 4]]", "discs[0].velocity must be one row or 1, one per disc; got 2."),
    (HEAD + ONE + "velocity = [1, 2]\ntemperature = 1.0", "discs[0] must have velocity or temperature, not both; go"),
    (HEAD + ONE + "count = 3", "discs[0].count goes with places, but these discs have positions. Leave it out."),
    (HEAD + SQUARE + "spacing = 2.0\ncount = 99", "discs[0].count must be at most 20, the sites of a square lattice"),
    (HEAD + RANDOM + "count = 1\nspacing = 1.0", "discs[0].spacing belongs to a lattice; got it for places = 'rando"),
    (HEAD + RANDOM + "count = 1\nregion = [3, 3, 2, 4]", "discs[0].region must be [x_low, y_low, x_high, y_high], l"),
    (HEAD + "[piston]\nwall = 'right'\nspeed = 1\nstop = 5", "piston.speed must point into the box, < 0 for the rig"),
    (HEAD + "obstacles = [{ places = 'random', region = [0, 0, 1, 1], spacing = 1, radius = 1 }]",
     "obstacles[0].places must be one of 'square', 'hexagonal'; got 'random'."),
    (HEAD + EMITTER, "emitters[0]: an Emitter must have either interval, the time between two discs, or every"),
    (HEAD + "'' = 1", "'' must be a key of a scene file; this one is unknown, with the value 1. Keys there: schema"),
    ("schema = " + "[" * 5000, "the file must be TOML; got tables or lists nested too deeply."),
    *[(text, "the file must be TOML; got this error: ")
      for text in ("schema = 1\nschema = 1", "schema = ", "schema = 1" + "0" * 5000, "= 3")],
    (NINE + TABLE.replace("0.7", "0.95") + DISCS, "compressed.packing must be above that of the scene, 0.441786, an"),
    (NINE + TABLE + DISCS.replace("temperature = 1.0\n", ""), "compressed: velocity must not be 0 everywhere"),
    (NINE + "obstacles = [{ position = [0.2, 0.2], radius = 0.1 }]\n" + TABLE + DISCS, "compressed cannot do a scen"),
    (NINE + DISCS.replace("random", "compressed"), "discs[0].places must be one of 'random', 'square', 'hexagonal'; "),
]  # fmt: skip


@pytest.mark.parametrize(("text", "words"), WRONG, ids=lambda each: each[-40:])
def test_what_is_wrong_is_said(text, words, problems):
    (problem,) = problems(text)
    assert problem.startswith(words)
    assert problem.endswith((".", "?"))


# --- arrays beside a file


def save(array):
    return lambda path: np.save(path, array)


def write(content):
    return lambda path: path.write_bytes(content)


NO_ROWS = "must be lines of numbers with commas between them, as many in each; {} is not: "
NOT_NUMPY = "must be real numbers as numpy.save writes them; {} is not ("
FILES = {
    "none.npy": (lambda path: None, "must be a file that exists; got 'none.npy': no such file in "),
    "text.npy": (write(b"hello"), NOT_NUMPY),
    "complex.npy": (save(np.zeros((3, 2), complex)), NOT_NUMPY + "'complex.npy' holds complex128). Save it anew."),
    "x.txt": (write(b"1,2"), "must be numbers or the name of a .npy or .csv file; got 'x.txt'."),
    "ragged.csv": (write(b"x,y\n1,2\n3,4,5\n"), NO_ROWS),
    "semicolons.csv": (write(b"-1;1\n"), NO_ROWS + "line 1 has '-1;1'"),
    "quoted spaces.csv": (write(b'"1 1"\n'), NO_ROWS + """line 1 has '"1 1"'"""),
    "bytes.csv": (write(b"\xff\xfe\x00"), NO_ROWS + "'utf-8' codec"),
}  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_a_wrong_array_is_named(problems, tmp_path, name):
    make, expected = FILES[name]
    make(tmp_path / name)
    (text,) = problems(HEAD + f"[[discs]]\nposition = '{name}'\nradius = 0.5\n")
    assert text.startswith(f"discs[0].position {expected.format(name)}")


def test_no_file_can_lead_out_of_its_folder(problems, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    outside = tmp_path.parent / f"{tmp_path.name}-outside.npy"
    np.save(outside, np.ones((1, 2)))
    Path("link.npy").symlink_to(outside)
    for name in (f"../{outside.name}", str(outside), "link.npy", "sub/../../x.npy", "~/x.npy/../../../x.csv"):
        (text,) = problems(HEAD + f"[[discs]]\nposition = '{name}'\nradius = 0.5\n")
        assert text.startswith("discs[0].position must be a file in the folder of the scene file, or below; got")
    (text,) = problems(HEAD + '[[discs]]\nposition = "a\\u0000.npy"\nradius = 0.5\n')
    assert text.startswith("discs[0].position must be a file")


# --- named scenes

NAMED = sorted(path.stem for path in (Path(mpsim.__file__).parent / "scene" / "named").glob("*.toml"))


@pytest.mark.parametrize(
    "name", long_but(NAMED, *(each for each in NAMED if each not in ("dense", "rough-sediment", "mixture")))
)
def test_a_named_scene_is_complete_and_starts_without_overlap(name):
    scene = Scene.load(name)
    assert scene.settings is not None
    assert scene.measures
    assert 100 <= scene.duration / scene.picture_interval <= 500
    assert scene.count or scene.emitters
    assert scene.overlaps_at_start() == ""
