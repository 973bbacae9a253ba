"""What is wrong with a scene file is said in full: key path, rule, value, remedy."""

import pytest
from support.scenefiles import HEAD

import mpsim
from mpsim.scene.scenefile import schema


def test_the_keys_of_a_file_are_the_arguments_of_python():
    arguments = set(mpsim.Scene.__init__.__annotations__) - {"return"}
    keys = set(schema.keys_of(schema.SceneTable)) | set(schema.keys_of(schema.Discs))
    assert not arguments - keys, f"a scene file lacks {arguments - keys}"
    for table, kind in ((schema.LEVELS["emitters"][0], mpsim.Emitter), (schema.LEVELS["piston"][0], mpsim.Piston)):
        assert schema.keys_of(table) == list(kind.__dataclass_fields__)


ONE = "[[discs]]\nposition = [[2.0, 3.0]]\nradius = 0.5\n"


def test_all_problems_are_told_at_once(problems):
    found = problems("""
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
        [[emitters]]
        position = [1, 1]
        every = 0
        limt = 4
        [piston]
        wall = "lef"
        speed = nan
        stop = -1
        colour = "red"
    """)
    expected = {
        "height must be a finite number > 0 [length]; got -2.",
        "boundary must be a word or a list of words; got 3.",
        "gravity[0] must be a number; got '1'.",
        "restitution must be a number from 0 to 1; got inf.",
        "absorbing must be one of 'left', 'right', 'bottom', 'top'; got 'botom'. Did you mean 'bottom'?",
        "about.title must be given; got nothing.",
        "about.titel must be a key of a scene file; this one is unknown, with the value 'x'. Did you mean 'title'?",
        "about.text must be a text in quotation marks; got 3.",
        "settings.dt must be a finite number > 0 [time]; got -1.",
        "settings.method must be one of 'naive', 'grid', 'parallel', 'event', 'mpi', 'auto'; got 'gird'. "
        "Did you mean 'grid'?",
        "settings.wrokers must be a key of a scene file; this one is unknown, with the value 3. "
        "Did you mean 'workers'?",
        "discs[0].position must be numbers of shape (N, 2); got rows of different lengths, 1 to 2.",
        "discs[0].radius must be a finite number > 0 [length]; got nan.",
        "discs[1].position must be a file in the folder of the scene file, or below; got '../x.npy', which is not. "
        "Move the file there, or make the scene in Python.",
        "discs[1].mass must be numbers or the name of a .npy or .csv file; got '/etc/passwd'.",
        "discs[2] must have either position or places; got neither.",
        "obstacles[0].radius must be a finite number > 0 [length]; got -1.",
        "obstacles[1].points must be at least two, neighbours at different places; got [[1.0, 1.0]]. "
        "Use a FixedDisc for a point.",
        "obstacles[2].position must be given; got nothing.",
        "obstacles[2].radius must be given; got nothing.",
        "obstacles[2].point must be a key of a scene file; this one is unknown, with the value [[1, 2]]. "
        "Did you mean 'points'?",
        "obstacles[3] must be a table; got 5.",
        "emitters[0].velocity must be given; got nothing.",
        "emitters[0].every must be a whole number from 1 to 1000000000000; got 0. One disc every `every` frames.",
        "emitters[0].limt must be a key of a scene file; this one is unknown, with the value 4. Did you mean 'limit'?",
        "piston.wall must be one of 'left', 'right', 'bottom', 'top'; got 'lef'. Did you mean 'left'?",
        "piston.stop must be a finite number > 0 [length]; got -1.",
        "piston.colour must be a key of a scene file; this one is unknown, with the value 'red'. "
        "Keys there: wall, speed, stop, start.",
        "widht must be a key of a scene file; this one is unknown, with the value 3. Did you mean 'width'?",
    }
    missing = expected - set(found)
    assert not missing, f"missing: {missing}\nfound: {found}"
    rest = set(found) - expected
    assert len(rest) == 2, rest  # two more, whose texts hold a path or numpy's words
    assert any(
        text.startswith("discs[1].radius must be a file that exists; got 'r.npy': no such file in") for text in rest
    )
    assert any(text.startswith("piston.speed must be finite") for text in rest)


WRONG = {
    "": "schema must be given; got nothing. Write 'schema = 1' at the top.",
    "schema = 1": "the box must be given either by packing or by width and height; "
    "got packing=None, width=None, height=None.",
    "schema = 1\nwidth = 3": "the box must be given either by packing or by width and height; "
    "got packing=None, width=3.0, height=None.",
    HEAD + "packing = 0.3": "the box must be given either by packing or by width and height; "
    "got packing=0.3, width=10.0, height=8.0.",
    "schema = 1\npacking = 0.3": "packing needs discs to make a box for; got none. Give width and height.",
    "schema = 1\npacking = 0.3\n[[discs]]\nplaces = 'square'\nspacing = 1.0\nradius = 0.5": "discs[0].count must be "
    "given where packing makes the box; got none.",
    "schema = 1\npacking = 5e-324\n[[discs]]\nplaces = 'random'\nradius = 0.5\ncount = 3": "packing must leave the "
    "box finite; got 4.94066e-324. Use a larger one.",
    "schema = 2\nnonsense = 3": "schema must be 1, the version of scene files that this mpsim reads; got 2. "
    "A newer mpsim may read it.",
    "schema = true" + HEAD[10:]: "schema must be 1, the version of scene files that this mpsim reads; got True. "
    "A newer mpsim may read it.",
    "schema = '1'" + HEAD[10:]: "schema must be 1, the version of scene files that this mpsim reads; got '1'. "
    "A newer mpsim may read it.",
    HEAD.replace("10.0", "true"): "width must be a number > 0 [length]; got True.",
    HEAD.replace("10.0", "'10'"): "width must be a number > 0 [length]; got '10'.",
    HEAD.replace("10.0", "nan"): "width must be a finite number > 0 [length]; got nan.",
    HEAD.replace("10.0", "1e999"): "width must be a finite number > 0 [length]; got inf.",
    HEAD.replace("10.0", "1" + "0" * 400): "width must be a number > 0 [length], finite in float64; got "
    "a whole number of 401 digits.",
    HEAD.replace("10.0", "1979-05-27"): "width must be a number > 0 [length]; got datetime.date(1979, 5, 27).",
    HEAD + "gravity = 3": "gravity must be two numbers, along x and y; got 3. Downwards it is (0, -3), "
    "in a scene file [0.0, -3.0].",
    HEAD + "gravity = [1, 2, 3]": "gravity must have shape (2,); got shape (3,). Reshape the array.",
    HEAD + f"gravity = [1, 1{'0' * 400}]": "gravity[1] must be finite in float64; got a whole number of 401 digits.",
    HEAD + "boundary = 'wall'": "boundary must be one of 'walls', 'periodic'; got 'wall'. Did you mean 'walls'?",
    HEAD + "boundary = ['walls']": "boundary must be one word or one for x and one for y; got ['walls'].",
    HEAD + "restitution = 1.5": "restitution must be a number from 0 to 1; got 1.5.",
    HEAD + "discs = 3": "discs must be a list of tables, [[discs]] for each; got 3.",
    HEAD + "[discs]\nradius = 3": "discs must be a list of tables, [[discs]] for each; got {'radius': 3}.",
    HEAD + "about = 'x'": "about must be a table; got 'x'.",
    HEAD + "[[settings]]\ndt = 1": "settings must be a table; got [{'dt': 1}].",
    HEAD
    + "[settings]\nsubsteps = 1.5": "settings.substeps must be a whole number from 1 to 1000000; got 1.5. Give 1 or 2.",
    HEAD + ONE + "velocity = [[1, 2], [3, 4]]": "discs[0].velocity must be one row or 1, one per disc; got 2.",
    HEAD + ONE + "acceleration = [[1, 2], [3, 4]]": "discs[0].acceleration must be one row or 1, one per disc; got 2.",
    HEAD + ONE + "mass = [1, 2]": "discs[0].mass must be one number or 1, one per disc; got 2.",
    HEAD + ONE + "mass = [0]": "discs[0].mass must be > 0 [mass]; mass[0] is 0.0.",
    HEAD + ONE + "velocity = [1, inf]": "discs[0].velocity must be finite; velocity[1] is inf (such values: 1). "
    "Correct them, or leave them out.",
    HEAD + ONE + "velocity = [1, true]": "discs[0].velocity[1] must be a number; got True.",
    HEAD
    + ONE
    + "velocity = [1, 2]\ntemperature = 1.0": "discs[0] must have velocity or temperature, not both; got both.",
    HEAD
    + ONE
    + "temperature = -1.0": "discs[0].temperature must be a finite number >= 0 [mass length^2/time^2]; got -1.0.",
    HEAD + ONE + "count = 3": "discs[0].count goes with places, but these discs have positions. Leave it out.",
    HEAD + ONE + "places = 'square'": "discs[0] must have either position or places; got both.",
    HEAD
    + ONE.replace("2.0, 3.0", "2.0, 9.0"): "discs[0].position[0] must lie in [0.5, 9.5] x [0.5, 7.5] (one radius from "
    "the walls); got (2.0, 9.0) (discs outside: 1). Move the disc or enlarge the box.",
    HEAD
    + "[[discs]]\nplaces = 'hexgonal'\nradius = 1": "discs[0].places must be one of 'random', 'square', 'hexagonal'; "
    "got 'hexgonal'. Did you mean 'hexagonal'?",
    HEAD + "[[discs]]\nplaces = 'square'\nradius = 1": "discs[0].count or spacing must be given for places = 'square'; "
    "got neither.",
    HEAD
    + "[[discs]]\nplaces = 'square'\nradius = 1\nspacing = 2.0\ncount = 99": "discs[0].count must be at most 20, the "
    "sites of a square lattice of spacing 2 in the region [1, 9] x [1, 7]; got 99. Use a smaller spacing or a larger "
    "region.",
    HEAD + "[[discs]]\nplaces = 'square'\nradius = 1\nspacing = 1e-300": "discs[0].spacing must leave at most 10000000 "
    "sites in the region [1, 9] x [1, 7]; got 1e-300. Use a larger spacing or a smaller region.",
    HEAD + "[[discs]]\nplaces = 'random'\nradius = 1": "discs[0].count must be given for places = 'random'; got none.",
    HEAD + "[[discs]]\nplaces = 'random'\nradius = 1\ncount = -1": "discs[0].count must be a whole number from 0 to "
    "100000000; got -1. Give a number in this range.",
    HEAD
    + "[[discs]]\nplaces = 'random'\nradius = 1\ncount = 1\nspacing = 1.0": "discs[0].spacing belongs to a lattice; "
    "got it for places = 'random'. Leave it out.",
    HEAD
    + "[[discs]]\nplaces = 'random'\nradius = 1\ncount = 1\nregion = [3, 3, 2, 4]": "discs[0].region must be [x_low, "
    "y_low, x_high, y_high], low before high; got [3.0, 3.0, 2.0, 4.0].",
    HEAD + "[[discs]]\nplaces = 'random'\nradius = 1\ncount = 30": "discs[0]: packing must be at most 0.8 for "
    "random places; got 1.18. Use fewer or smaller discs, a larger box or region, or a lattice; "
    "a table [compressed] shrinks the box.",
    HEAD
    + "[piston]\nwall = 'right'\nspeed = 1\nstop = 5": "piston.speed must point into the box, < 0 for the right wall; "
    "got 1. Turn its sign, or leave the piston out.",
    HEAD
    + "obstacles = [{ places = 'random', region = [0, 0, 1, 1], spacing = 1, radius = 1 }]": "obstacles[0].places must "
    "be one of 'square', 'hexagonal'; got 'random'.",
    HEAD
    + "[piston]\nwall = ['left']\nspeed = 1\nstop = 5": "piston.wall must be one of 'left', 'right', 'bottom', 'top'; "
    "got ['left'].",
    HEAD + "settings = { method = ['grid'] }": "settings.method must be one of 'naive', 'grid', 'parallel', 'event', "
    "'mpi', 'auto'; got ['grid'].",
    HEAD
    + "emitters = [{ position = [1, 1], velocity = [1, 0], radius = 1, interval = 1, every = 1 }]": "emitters[0]: an "
    "Emitter must have either interval, the time between two discs, or every, the frames between two; got "
    "both, 1.0 and 1. Give one of them.",
    HEAD + "emitters = [{ position = [1, 1], velocity = [1, 0], radius = 1 }]": "emitters[0]: an Emitter must have "
    "either interval, the time between two discs, or every, the frames between two; got neither. Give one of them.",
    HEAD + "'' = 1": "'' must be a key of a scene file; this one is unknown, with the value 1. Keys there: "
    f"{', '.join(schema.keys_of(schema.SceneTable))}.",
    HEAD + "about = { title = 'x', '' = 1 }": "about.'' must be a key of a scene file; this one is unknown, with the "
    "value 1. Keys there: title, text, look_for.",
    "schema = " + "[" * 5000: "the file must be TOML; got tables or lists nested too deeply.",
}


@pytest.mark.parametrize("text", WRONG, ids=lambda text: text[-40:])
def test_what_is_wrong_is_said(problems, text):
    assert problems(text) == [WRONG[text]]


@pytest.mark.parametrize(
    ("level", "key", "near"),
    [
        ("", "gravty", "gravity"),
        ("[about]\ntitle = 'x'\n", "lookfor", "look_for"),
        ("[settings]\n", "pases", "passes"),
        (ONE, "temprature", "temperature"),
        ("[[obstacles]]\nposition = [1, 1]\nradius = 1\n", "spacin", "spacing"),
        ("[[obstacles]]\npoints = [[1, 1], [2, 2]]\n", "thicknes", "thickness"),
        ("[[emitters]]\nposition = [1, 1]\nvelocity = [1, 1]\nradius = 0.1\n", "evry", "every"),
        ("[piston]\nwall = 'top'\nspeed = -1\nstop = 5\n", "stopp", "stop"),
    ],
)
def test_an_unknown_key_is_refused_at_every_level_with_a_suggestion(problems, level, key, near):
    (text,) = problems(f"{HEAD}{level}{key} = 1\n")
    assert text.split(".")[-2].endswith("with the value 1")
    assert text.endswith(
        f"{key} must be a key of a scene file; this one is unknown, with the value 1. Did you mean {near!r}?"
    )
