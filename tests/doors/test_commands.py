"""The command `mpsim`: exit codes 0 done, 1 failed, 2 wrong usage or input; what it prints; help."""

import json
import re
import runpy
import sys
import warnings

import click
import pytest
from click.shell_completion import ShellComplete
from support.commands import mpsim_command

import mpsim
from mpsim.cli.app import main

pytestmark = pytest.mark.plain

NAMES = main.list_commands(click.Context(main))


# --- wrong usage and input

LONG = "must be at most 1,000,000,000,000 frames of"
REFUSED = [
    ("run gas --frames 3 --until 2", "Give --frames or --until, not both."),
    ("resume gas --frames 3 --until 2", "Give --frames or --until, not both."),
    ("run gas --every 3", "--every needs --out, the folder to write to."),
    ("run gas --dt 0", "'--dt': 0.0 is not in the range x>0."),
    ("view ?", "for the address SCENE: a link must have a scene, as in ?scene=gas&dt=0.005; got none. Add scene=NAME."),
    ("view gass", "got 'gass'. Did you mean 'gas'?"),
    ("view gas --port -1", "'--port'"),
    ("view gas --method mpi", "A command runs in one process"),
    ("view gas --box 8,6", "--box can be given only with the file of a trajectory."),
    ("view ?scene=gas --box 8,6", "--box can be given only with the file of a trajectory."),
    ("view http://127.0.0.1:8000/a-token/", "a link must have a scene, as in ?scene=gas"),
    ("view ?scene=gas&dt=foo", "dt must be a finite number > 0 [time]; got 'foo'."),
    ("view ?scene=gas&passes=0", "passes must be a whole number from 1 to 1000; got 0."),
    ("view gas --beside foo", "for --beside: beside must be a method, or dt, "),
    ("view gas --beside foo", "; got 'foo'. Use dt=0.001,passes=2."),
    ("run gas --until nan", "'--until': 'nan' must be a finite number."),
    ("run gas --start inf", "'--start': 'inf' must be a finite number."),
    ("animate gas a.gif --until inf", "'--until': 'inf' must be a finite number."),
    ("run gas --frames 5.5", "'--frames': '5.5' is not a valid integer range."),
    ("run gas --workers 1025", "1025 is not in the range 1<=x<=1024."),
    ("run gas --method mpi", "method 'mpi' is for programs on the ranks of MPI. Give --method grid"),
    ("run gas --frames 30 --start 0.3", "start must lie before the end of the run, at time 0.3; got 0.3"),
    ("run gsa", "got 'gsa'. Did you mean 'gas'?"),
    ("run none.toml", "scene must be a file that can be read; got 'none.toml' (No such file or directory)."),
    ("run gas --method gird", "'--method': 'gird' is not one of"),
    (
        "run gas --method naive --dt 1 --frames 1 --on-fast error",
        "Use dt=0.079, substeps=13 or on_fast='substep'; on_fast='warn' runs it anyway.",
    ),
    (
        "run gas --method event --precision float32",
        "method='event' cannot do precision='float32'. Leave it out, or use method='grid'.",
    ),
    ("animate gas a.gif --until 1e308", f"until {LONG} 0.01; got 1e+308."),
    ("animate gas a.gif --dt 1e-300", f"the scene's duration {LONG} 1e-300; got 100."),
    (
        "animate gas a.gif --until 1e9 --every 2",
        "until must be at most 1999.98 with every=2, 100,000 pictures; got 1e+09.",
    ),
    ("animate gas a.pdf", "Use a.gif. One picture is made by mpsim.draw or `mpsim plot`."),
    ("shwo", "No such command 'shwo'"),
    ("tune", "Missing argument 'SCENE'."),
    ("tune cradle", "Give at least one budget: --pressure, --collision-rate, "),
    ("tune cradle --pressure nan", "'--pressure': 'nan' must be a number > 0 and less than 100%, such as 0.05 or 5%."),
    ("tune gas --pressure 200%", "'200%' must be a number > 0 and less than 100%, such as 0.05 or 5%."),
    ("tune cradle --pressure 1% --replicas 65", "65 is not in the range 2<=x<=64."),
    ("tradeoff cradle --csv --json", "Choose one of --csv and --json."),
]


@pytest.mark.parametrize(("words", "rule"), REFUSED, ids=[words for words, _ in REFUSED])
def test_wrong_usage_and_input_are_exit_code_2_and_write_nothing(words, rule, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = mpsim_command(*words.split())
    assert (result.exit_code, result.stdout) == (2, "")
    assert rule in " ".join(result.stderr.split())
    assert not list(tmp_path.iterdir())


def test_a_mistyped_option_is_answered_with_the_right_one():
    result = mpsim_command("tune", "cradle", "--presure", "1%")
    assert (result.exit_code, result.stdout) == (2, "")
    # The marks between these words differ from version to version of click.
    assert re.search(r"No such option:? '?--presure'?\.? Did you mean '?--pressure'?\?", result.stderr)


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (mpsim.errors.ClosedError("gone"), "gone"),
        (MemoryError("too much"), "too much"),
        (PermissionError(13, "no", "a.txt"), "'a.txt' must be a file or folder that can be used; it cannot (no)."),
    ],
)
def test_an_error_is_a_sentence_and_exit_code_1(error, text, monkeypatch):
    def fail(*arguments, **named):
        raise error

    monkeypatch.setattr(mpsim.Simulation, "run", fail)
    monkeypatch.setattr("mpsim.studies.tune.tune", fail)  # as where no settings are inside the budget
    for words in (("run", "gas", "--frames", 3), ("tune", "cradle", "--pressure", "1%")):
        result = mpsim_command(*words)
        assert (result.exit_code, result.stdout) == (1, "")
        assert result.stderr == f"Error: {text}\n"


def test_what_cannot_be_animated_or_written_is_told_before_any_work(tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setenv("PATH", str(tmp_path))  # without ffmpeg ...
        patch.setitem(sys.modules, "imageio_ffmpeg", None)  # ... of any kind
        result = mpsim_command("animate", "gas", tmp_path / "a.mp4")
    assert result.exit_code == 1
    assert "an .mp4 needs the package imageio_ffmpeg, which cannot be imported" in result.stderr
    assert f"`pip install 'mpsim[film]'`, or install ffmpeg, or write '{tmp_path}/a.gif'." in result.stderr


# --- help, version, completion


def test_help_has_examples_that_begin_with_the_command():
    assert " ".join(NAMES) == "animate clean plot resume run scenes show tradeoff tune view warmup"
    for command in [[], *([name] for name in NAMES)]:
        result = mpsim_command(*command, "--help")
        assert (result.exit_code, result.stderr) == (0, "")
        assert f"Examples:\n    mpsim {' '.join(command)}".rstrip() in result.stdout
    assert mpsim_command("--version").stdout == f"mpsim, version {mpsim.__version__}\n"


def test_the_module_is_the_command(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["mpsim", "show", "none"])
    with pytest.raises(SystemExit) as refused:
        runpy.run_module("mpsim", run_name="__main__")
    told = capsys.readouterr()
    assert (refused.value.code, told.out) == (2, "")
    assert told.err.startswith("Error: scene must be a path that ends in .toml or one of ")


def test_scenes_are_completed():
    words = [item.value for item in ShellComplete(main, {}, "mpsim", "_MPSIM_COMPLETE").get_completions(["run"], "ga")]
    assert {"galton", "gas"} <= set(words)
    assert "pi" not in words


def test_a_warning_is_a_line_without_source(monkeypatch):
    assert mpsim_command("show", "cradle").stderr == ""

    @click.command()
    def warn() -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            warnings.warn("discs overlap", mpsim.OverlapWarning, stacklevel=1)

    monkeypatch.setitem(main.commands, "warn", warn)
    result = mpsim_command("warn")
    assert (result.exit_code, result.stderr) == (0, "Warning: discs overlap\n")


# --- scenes and show


def test_scenes_are_listed_one_line_each_and_shown():
    titles = dict(line.split(maxsplit=1) for line in mpsim_command("scenes").stdout.splitlines())
    result = mpsim_command("show", "galton")
    assert (result.exit_code, result.stdout.splitlines()[0]) == (0, f"galton: {titles['galton']}")
    assert "\nLook for: " in result.stdout
    assert "Settings(dt=" in result.stdout


def test_show_names_every_feature_or_every_problem(tmp_path):
    every, interval = {"every": 7, "limit": 3}, {"interval": 0.25}
    mpsim.Scene(
        width=10, height=8, boundary=("periodic", "walls"), gravity=(0, -1), restitution=0.5, absorbing="bottom",
        position=[[1, 2], [9, 3]], velocity=[[0, 0]] * 2, radius=[0.5, 0.25], mass=[1, 2], acceleration=[[1, 0]] * 2,
        obstacles=mpsim.FixedDisc((5, 5), 1), piston=mpsim.Piston("top", -1, 6), duration=5,
        emitters=[mpsim.Emitter((x, 2), (1, 1), radius=1, mass=1, **each) for x, each in ((2, every), (3, interval))],
    ).save(tmp_path / "a.toml")  # fmt: skip
    assert mpsim_command("show", tmp_path / "a.toml").stdout == (
        "a\n\n"
        "box          10 x 8, periodic along x, walls along y\n"
        "discs        2, radius 0.25 to 0.5, mass 1 to 2, packing 0.0123\n"
        "speed        0 (root mean square)\n"
        "gravity      (0, -1)\n"
        "acceleration one per disc\n"
        "restitution  0.5 of discs, 1 of walls\n"
        "obstacles    1\n"
        "piston       the top wall, speed -1, to 6\n"
        "absorbing    bottom\n"
        "emitters     one disc every 7 frames, 3 in all; one disc every 0.25 of time, no end\n"
        "duration     5\n"
        "settings     none recommended\n"
        f"read from    {tmp_path}/a.toml\n"
    )
    (tmp_path / "bad.toml").write_text("schema = 1\nwidth = -1\nheight = 'x'\n")
    result = mpsim_command("show", tmp_path / "bad.toml")
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr.startswith(f"Error: 2 problems in a scene file:\n{tmp_path}/bad.toml: width must be")


# --- searches


@pytest.mark.slow
def test_tune_and_tradeoff_do_what_they_say(tmp_path):
    path = tmp_path / "small.toml"
    mpsim.Scene.random(count=20, packing=0.2, radius=0.5).save(path)
    short = ["--until", "2", "--replicas", "2", "--quiet"]
    tuned = mpsim_command("tune", path, "--overlap", "0.2", *short)
    assert tuned.exit_code == 0, tuned.stderr
    run, python = tuned.stdout.splitlines()[-2:]
    assert run.startswith(f"to run it: mpsim run {path} --")
    assert python.startswith("in Python: Settings(")
    table = mpsim_command("tradeoff", path, "--measure", "overlap", "--json", "--keep", tmp_path / "kept", *short)
    assert len(json.loads(table.stdout)["rows"]) > 5
    result = mpsim_command("tradeoff", path, "--measure", "overlap", "--csv", "--keep", tmp_path / "kept", *short)
    assert result.stdout.startswith("method,contact,law,")


# --- warmup


@pytest.mark.slow
def test_warmup_tells_numbers():
    result = mpsim_command("warmup", "gas", "--method", "grid", "--quiet")
    assert result.exit_code == 0
    assert result.stdout.startswith("gas ")
    assert result.stdout.endswith(" kernels compiled or loaded\n")
    assert " s, 0 kernels" in mpsim_command("warmup", "gas", "--method", "grid", "--quiet").stdout, "nothing is missing"
