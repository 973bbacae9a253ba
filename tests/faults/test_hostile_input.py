"""Files and values made to do harm, or by mistake: each is refused at once, by an error of mpsim that says why.

No more than LONGEST of processor time and SPARE of memory for any of them, and no message that fills a screen. What
must fail is how each was read before: the memory of a device without end, the time of a pipe that nobody writes to.
"""

import io
import itertools
import json
import os
import pickle
import resource
import time
import traceback

import numpy as np
import psutil
import pytest
from click.testing import CliRunner
from support.checkpoints import rewrite_members, saved
from support.processes import limited

import mpsim
from mpsim.cli.app import main
from mpsim.cli.run import RunFolder
from mpsim.output.history import COLUMNS, read_table
from mpsim.scene import scenefile
from mpsim.scene.scenefile import MOST_BYTES, MOST_PROBLEMS, MOST_TABLES
from mpsim.studies.ensemble import FILE
from mpsim.studies.runner import RunFile

LONGEST = 2.0  # seconds of processor time to refuse anything
USUAL = 0.17  # those of `some_work` on the machines for which the bound is given, when calm
SPARE = 2**30  # bytes of address space beyond what the process has already
LONGEST_MESSAGE = 40_000  # characters of a message with as many problems as are named

HEAD = "schema = 1\nwidth = 10.0\nheight = 8.0\n"


@pytest.fixture(autouse=True)
def little_memory():
    """What would fill the memory fails early instead."""
    with limited(resource.RLIMIT_AS, psutil.Process().memory_info().vms + SPARE):
        yield


def seconds_of(call):
    """Seconds of processor time that a call takes."""
    before = time.process_time()
    call()
    return time.process_time() - before


def in_time(call):
    """Call what refuses something, which must take a bounded time in one of three tries.

    Other programs take caches and halves of cores away; on a machine that is slower now than USUAL, time counts less.
    """
    for _ in range(3):
        seconds = seconds_of(call)
        if seconds < LONGEST or seconds < LONGEST * seconds_of(some_work) / USUAL:
            return
    raise AssertionError(f"it took {seconds:.1f} s of processor time")


def some_work():
    found = 0
    for number in range(2_000_000):
        found += number * number % 7


def refused(call, *arguments, match, kind=mpsim.InputError):
    """The error with which a call ends, soon and in words."""
    errors = []

    def attempt():
        for error in errors:  # of tries before, whose frames hold what was read
            for each in filter(None, (error, error.__context__)):
                traceback.clear_frames(each.__traceback__)
        with pytest.raises(kind, match=match) as caught:
            call(*arguments)
        errors.append(caught.value)

    in_time(attempt)
    assert len(str(errors[-1])) < LONGEST_MESSAGE
    return errors[-1]


def many(line, count):
    """A list in one line."""
    return f"[{line * count}]\n"


SCENES = {
    "an array name of 5,000 letters": (
        lambda: f"[[discs]]\nradius = 1\nposition = '{'a' * 5000}.npy'\n",
        r"must be a file .*; got 'a{50,56}\.\.\.",
    ),
    "a key nested 30,000 deep": (lambda: "a." * 30_000 + "a = 1\n", "at most 100 parts"),
    "a key of 50,000 parts behind a text": (
        lambda: "x = {a = '''b'''', " + "c." * 50_000 + "c = 1}\n", "at most 100 parts"
    ),
    "escaped quotation marks without an end": (lambda: 'x = "' + '\\"' * 25_000, "must be TOML"),
    "single quotation marks": (lambda: "x = " + "'''a''" * 170_000, "must be TOML"),
    "tables in tables": (lambda: "x = " + "{a = " * 30_000 + "1" + "}" * 30_000, "nested too deeply"),
    "lists in lists": (lambda: "x = " + "[" * 30_000 + "]" * 30_000, "nested too deeply"),
    "300,000 unknown keys": (lambda: "".join(f"k{i} = 1\n" for i in range(300_000)), "bytes, and at most 1,048,576"),
    "very many unknown keys": (
        lambda: "".join(f"k{i} = 1\n" for i in range(3500)), "at least 3,400 more"
    ),
    "800,000 pegs": (lambda: "[[obstacles]]\nposition=[1,1]\nradius=1\n" * 800_000, "bytes, and at most 1,048,576"),
    "10,001 pegs": (lambda: "[[obstacles]]\nposition=[1,1]\nradius=1\n" * 10_001, "at most 10,000 tables; got 10,001"),
    "bad obstacles": (lambda: "obstacles = " + many("{radius=-1},", 500), "at least 900 more"),
    "the last peg outside": (
        lambda: "obstacles = [" + "{position=[1,1],radius=1}," * 499 + "{position=[1,9],radius=1}]\n",
        r"obstacles\[499\] must lie in the box",
    ),
    "a lattice of a million pegs": (
        lambda: "[[obstacles]]\nplaces='square'\nspacing=0.008\nradius=1e-5\nregion=[0,0,9,8]\n",
        "spacing must leave at most 1,000,000 obstacles in the region; got 1,1",
    ),
    "a thousand lattices": (
        lambda: "[[obstacles]]\nplaces='square'\nspacing=0.02\nradius=1e-5\nregion=[0,0,9,8]\n" * 1000,
        "obstacles must be at most 1,000,000; got 1,.* or more",
    ),
    "a wall of one point": (
        lambda: "[[obstacles]]\npoints = " + many("[1,1],", 7500),
        "neighbours at different places",
    ),
    "a width of 6,000 digits": (lambda: "", "width must be"),
    "a place of 6,000 digits": (lambda: f"[[discs]]\nradius=1\nposition=[[0x{'f' * 6000},1]]\n", "7,22[45] digits"),
    "a word of a megabyte": (lambda: f"boundary = '{'w' * 1_000_000}'\n", r"got 'w{50,60}\.\.\."),
    "a gravity of 401 digits": (lambda: f"gravity = {10**400}\n", "gravity must be two numbers"),
    "a row too short": (lambda: "[[discs]]\nradius=1\nposition=[" + "[1,1]," * 7500 + "[1]]\n", "1 to 2"),
}  # fmt: skip


@pytest.mark.parametrize("name", SCENES)
def test_a_hostile_scene_file_is_refused(name, tmp_path):
    make, expected = SCENES[name]
    head = HEAD.replace("10.0", f"0x{'f' * 6000}") if name == "a width of 6,000 digits" else HEAD
    path = tmp_path / "scene.toml"
    path.write_text(head + make())
    refused(scenefile.load, path, match=expected)


def test_dots_in_texts_and_comments_are_no_parts_of_a_key(tmp_path):
    path = tmp_path / "scene.toml"
    for text in (
        '"""a"""""',
        "'''.'..'''",
        r'"\"......................"',
        "'.....................'",
        "'''\n''''' # ......",
    ):
        path.write_text(f"{HEAD}# {'.' * 99}\n[about]\ntitle = {text}\nlook_for = '{'a.' * 99}'\n")
        assert scenefile.load(path).title


def test_many_problems_are_named_up_to_a_number(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(HEAD + "".join(f"k{i} = 1\n" for i in range(MOST_PROBLEMS)))
    error = refused(scenefile.load, path, match="k0 must be a key", kind=mpsim.errors.SceneFileError)
    assert len(error.problems) == MOST_PROBLEMS
    path.write_text(HEAD + "".join(f"k{i} = 1\n" for i in range(MOST_PROBLEMS + 7)))
    error = refused(scenefile.load, path, match="k0 must be a key", kind=mpsim.errors.SceneFileError)
    assert error.problems[MOST_PROBLEMS:] == ("and at least 7 more.",)


def pipe(path):
    os.mkfifo(path)


def endless(path):
    path.symlink_to("/dev/zero")


def folder(path):
    path.mkdir()


IRREGULAR = {pipe: "a named pipe, not a file", endless: "a device, not a file", folder: "folder|directory|is not"}

DOORS = {
    "scene.toml": (scenefile.load, mpsim.InputError),
    "run.xyz": (mpsim.Trajectory, mpsim.errors.TrajectoryError),
    "run.gsd": (mpsim.Trajectory, mpsim.errors.TrajectoryError),
    "run.mpsim": (mpsim.Simulation.resume, mpsim.CheckpointError),
    "kept.json": (lambda path: RunFile(path, *FILE), mpsim.InputError),
    "run.json": (lambda path: RunFolder.open(path.parent), mpsim.InputError),
    "measures.csv": (read_table, mpsim.InputError),
}


SAYS_LESS = {"run.xyz": "is not", "run.gsd": "is not", "run.mpsim": "not a file", "kept.json": "path must be a file"}


@pytest.mark.parametrize("door", DOORS)
def test_nothing_but_a_file_is_read(door, tmp_path):
    read, kind = DOORS[door]
    for make, rule in IRREGULAR.items():
        (tmp_path / make.__name__).mkdir()
        path = tmp_path / make.__name__ / door
        make(path)
        refused(read, path, match="|".join([rule, *filter(None, [SAYS_LESS.get(door)])]), kind=kind)


def test_an_array_of_a_scene_is_a_file(tmp_path):
    for number, (make, ending) in enumerate(itertools.product(IRREGULAR, ("npy", "csv"))):
        (tmp_path / "scene.toml").write_text(f"{HEAD}[[discs]]\nradius = 1\nposition = '{number}.{ending}'\n")
        make(tmp_path / f"{number}.{ending}")
        refused(scenefile.load, tmp_path / "scene.toml", match=f"{IRREGULAR[make]}|which is not")


def test_the_writer_of_a_trajectory_is_not_held_up_by_a_pipe(tmp_path):
    os.mkfifo(tmp_path / "run.xyz")
    refused(
        lambda: mpsim.Trajectory.write(tmp_path / "run.xyz", mode="a"), match="is not", kind=mpsim.errors.OutputError
    )


def npy(shape, content=b"", descr="<f8"):
    """A .npy that declares what it likes."""
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": descr, "fortran_order": False, "shape": shape})
    return file.getvalue() + content


class Bomb:
    """Makes a folder when it is unpickled."""

    def __reduce__(self):
        return os.mkdir, ("exploded",)


BOMB = pickle.dumps([[Bomb(), 2]])

NO_ARRAYS = {
    "more than there is": npy((10**12, 2), b"\0" * 64),
    "less than there is": npy((1, 2), b"\0" * 640),
    "a size of 4,000 digits": npy((10**4000, 2)),
    "a size below 0": npy((-1, 2), b"\0" * 16),
    "a header of brackets": b"\x93NUMPY\1\0\x10\x27" + b"(" * 10_000,
    "a header of minus signs": b"\x93NUMPY\1\0\x10\x27" + b"-" * 9_999 + b"1",
    "a type of 3 bytes": npy((1, 2), b"\0" * 6).replace(b"<f8", b"<f3"),
    "a header without its end": npy((1, 2), b"\0" * 16).replace(b"}", b" "),
    "a text in a header without its end": npy((1, 2), b"\0" * 16).replace(b"'descr'", b"'descr&"),
    "a header of lines": npy((1, 2), b"\0" * 16).replace(b"{'descr': '", b"\t\n  1\n 2   "),
    "a header of 4 GiB": b"\x93NUMPY\2\0\xff\xff\xff\xff" + b" " * 100,
    "nothing times much": npy((0, 2**62, 2**62)),
    "objects": npy((1, 2), bytes(16), "|O"),
    "objects that are code": npy((1, 2), BOMB, "|O"),
    "code": BOMB,
    "a type of no size": npy((2**50,), descr="|V0"),
    "another version": npy((1, 2), bytes(16)).replace(b"NUMPY\1", b"NUMPY\3"),
    "one byte too many": npy((1, 2), bytes(17)),
}


def test_an_array_in_a_file_holds_what_it_declares_and_nothing_is_allocated_or_executed_before(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = saved(tmp_path / "run")
    whole = run.read_bytes()
    (tmp_path / "scene.toml").write_text(f"{HEAD}[[discs]]\nradius = 1\nposition = 'a.npy'\n")
    rule = "must be real numbers as numpy.save writes them"
    for content in NO_ARRAYS.values():
        (tmp_path / "a.npy").write_bytes(content)
        refused(scenefile.load, tmp_path / "scene.toml", match=rule)
        for name in ("solver.velocity.npy", "scene.position.npy", "mpsim_checkpoint.npy", "digest.npy"):
            run.write_bytes(whole)
            rewrite_members(run, lambda members, name=name, content=content: members.update({name: content}))
            refused(mpsim.Simulation.resume, run, match="cannot be read|digest", kind=mpsim.CheckpointError)
    run.write_bytes(BOMB)
    refused(mpsim.Simulation.resume, run, match="cannot be read", kind=mpsim.CheckpointError)
    assert not (tmp_path / "exploded").exists()
    pickle.loads(BOMB)
    assert (tmp_path / "exploded").exists(), "the control does execute"


def test_more_emitters_than_a_scene_may_have_are_refused_before_they_are_made(tmp_path):
    rows = [1_000, 999_001]
    text = HEAD
    for number, count in enumerate(rows):
        with (tmp_path / f"{number}.npy").open("wb") as file:
            file.write(npy((count, 2)))
            file.truncate(file.tell() + 16 * count)  # zeros that take no room on the disk
        text += f"[[emitters]]\nposition = '{number}.npy'\nvelocity = [0, 1]\ninterval = 1\nradius = 1\n"
    (tmp_path / "scene.toml").write_text(text)
    match = "emitters must be at most 1,000,000; got 1,000,001 or more"
    refused(mpsim.Scene.load, tmp_path / "scene.toml", match=match)
    spout = mpsim.Emitter((1, 1), (0, 1), interval=1)
    box = {"width": 9, "height": 9, "position": [], "velocity": [], "radius": 1}
    refused(lambda: mpsim.Scene(**box, emitters=[spout] * sum(rows)), match="emitters must be at most 1,000,000")


def test_a_large_csv_is_refused_before_it_is_read(tmp_path):
    (tmp_path / "scene.toml").write_text(f"{HEAD}[[discs]]\nradius = 1\nposition = 'a.csv'\n")
    with (tmp_path / "a.csv").open("wb") as file:
        file.truncate(2**32)  # sparse: it takes no room
    refused(scenefile.load, tmp_path / "scene.toml", match="4,294,967,296 bytes, and at most 8,388,608 are read")
    (tmp_path / "a.csv").write_text("1,1\n" * 4000 + "1,x\n")
    refused(scenefile.load, tmp_path / "scene.toml", match="line 4001 has 'x'")


XYZ = 'Lattice="9 0 0 0 9 0 0 0 1" Properties=pos:R:3:id:I:1'
TRAJECTORIES = {
    "a count of 5,000 digits": ("9" * 5000 + "\n", "must give the number of discs"),
    "a count of 20 digits": ("9" * 20 + "\n", "must give the number of discs"),
    "a line without end": (f"2\n{'x' * (2**20 + 5)}", "line 2, must have less than 1,048,576 bytes"),
    "an id of 30 digits": (f"1\n{XYZ}\n1 1 0 {'9' * 30}\n", "must hold numbers in its column id"),
    "an id of 5,000 digits": (f"1\n{XYZ}\n1 1 0 {'9' * 5000}\n", "must hold numbers in its column id"),
    "a width of 5,000 digits": (f"1\n{XYZ.replace('I:1', 'I:' + '9' * 5000)}\n1 1 0 1\n", "must name its columns"),
    "a box of 5,000 letters": (
        f"1\n{XYZ.replace('9 0', 'x' * 5000)}\n1 1 0 1\n",
        "must hold 9 finite numbers under Lattice",
    ),
}


def test_a_hostile_trajectory_is_refused(tmp_path):
    path = tmp_path / "run.xyz"
    for text, expected in TRAJECTORIES.values():
        path.write_text(text)
        error = refused(lambda: mpsim.Trajectory(path)[0], match=expected, kind=mpsim.errors.TrajectoryError)
        assert len(str(error)) < 1000
    path.write_text(f"1\n{XYZ} Frame={'9' * 5000}\n1 1 0 1\n")
    assert mpsim.Trajectory(path)[0].frame == 0, "a frame number of 5,000 digits is none"


def test_a_damaged_gsd_is_refused(tmp_path):
    hoomd = pytest.importorskip("gsd.hoomd")
    path = tmp_path / "run.gsd"
    with hoomd.open(str(path), "w") as file:
        frame = hoomd.Frame()
        frame.configuration.box = [9, 9, 0, 0, 0, 0]
        frame.particles.N, frame.particles.position = 1, [[1, 1, 0]]
        file.append(frame)
    content, outcomes = path.read_bytes(), set()
    for at in range(256, len(content), 97):
        path.write_bytes(content[:at] + b"\xff" * 8 + content[at + 8 :])
        try:
            with mpsim.Trajectory(path) as trajectory:
                outcomes |= {type(frame.box) for frame in trajectory}
        except mpsim.errors.TrajectoryError as error:
            outcomes.add(type(error))
    assert mpsim.errors.TrajectoryError in outcomes


def test_records_that_are_none_are_refused(tmp_path):
    path = tmp_path / "run.json"
    for text in ("[" * 200_000, '{"format": 1e999}', f'{{"format": {"9" * 5000}}}', "\xff", "[]"):
        path.write_text(text, "latin-1")
        refused(RunFolder.open, tmp_path, match="the folder of a run must hold run.json")
        refused(RunFile, path, *FILE, match="path must be a file of an earlier trade")
    keys = ("target", "every", "trajectory", "measures", "parts")
    record = {"format": 1, "scene": "gas", "status": "done", "settings": {"method": "grid"}, **dict.fromkeys(keys, 1)}
    path.write_text(json.dumps(record))
    refused(RunFolder.open, tmp_path, match="run.json must hold measures, parts, trajectory")


def test_a_table_with_a_cell_of_a_megabyte_is_refused(tmp_path):
    (tmp_path / "measures.csv").write_text(f"{','.join(COLUMNS)}\n{'9' * 1_000_000}\n")
    refused(read_table, tmp_path / "measures.csv", match="line 2 of .* must be a row of 7 numbers")


def nested(depth):
    value = []
    for _ in range(depth):
        value = [value]
    return value


VALUES = [10**6000, -(10**6000), "w" * 10**6, nested(100_000), [[1.5] * 1000] * 1000, {"a" * 10**6: 1}]


@pytest.mark.parametrize("value", VALUES, ids=range(len(VALUES)))
def test_a_value_of_any_size_is_refused_in_a_short_text(value):
    for name in ("dt", "method", "workers", "substeps"):
        assert len(str(refused(lambda name=name: mpsim.Settings(**{name: value}), match=f"{name} must be"))) < 1000
    box = {"width": 9, "height": 9, "position": [[1, 1]], "velocity": [[0, 0]], "radius": 0.5}
    for name in ("width", "restitution", "duration"):
        assert len(str(refused(lambda name=name: mpsim.Scene(**{**box, name: value}), match=f"{name} must be"))) < 1000


def test_the_command_says_so_too(tmp_path):
    os.mkfifo(tmp_path / "pipe.toml")
    for argument in (tmp_path / "pipe.toml", "x" * 5000, f"{'x' * 5000}.toml"):
        outcomes, words = [], ["show", str(argument)]
        in_time(lambda words=words, outcomes=outcomes: outcomes.append(CliRunner().invoke(main, words)))
        assert outcomes[-1].exit_code == 2
        assert "must be" in outcomes[-1].output + str(outcomes[-1].exception)


def test_what_could_not_be_read_is_not_written(tmp_path):
    mixed = [mpsim.FixedDisc((1, 1), 1), mpsim.Polyline([(0, 0), (1, 0)])] * (MOST_TABLES // 2 + 1)
    box = {"width": 9, "height": 9, "position": [], "velocity": [], "radius": 1}
    scene = mpsim.Scene(**box, obstacles=mixed)
    match = "at most 1,048,576 bytes and 10,000 tables"
    refused(scene.save, tmp_path / "scene.toml", match=match, kind=mpsim.errors.OutputError)
    ordered = sorted(mixed, key=lambda each: type(each).__name__)  # discs follow discs and lines follow lines
    mpsim.Scene(**box, obstacles=ordered).save(tmp_path / "advice.toml")
    for path in tmp_path.iterdir():
        path.unlink()
    refused(scene.save, tmp_path / "scene.toml", match="follow each other", kind=mpsim.errors.OutputError)
    assert not list(tmp_path.iterdir())
    assert MOST_BYTES == 2**20
