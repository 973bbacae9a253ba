"""The command `mpsim`: what it prints, where, and its exit codes: 0 done, 1 failed, 2 wrong usage or input."""

import json
import logging
import re
import subprocess
import sys
import warnings

import click
import pytest
from click.testing import CliRunner, Result

import mpsim
from mpsim.cli import terminal, trade
from mpsim.cli.app import main
from mpsim.scene import scenefile
from mpsim.studies.cost import Cost
from mpsim.studies.deviations import Deviation
from mpsim.studies.replicas import MEASURES
from mpsim.studies.tradeoff import Row, Tradeoff
from mpsim.studies.tuned import Trial, Tuned

SETTINGS = mpsim.Settings(dt=0.05, contact="push")
ROW = Row(SETTINGS, Cost(10.0, 9.0, 11.0, 100.0, "grid", 1), {"pressure": Deviation(0.004, float("inf"))})


def mpsim_command(*arguments: str) -> Result:
    """Run the command in this process."""
    return CliRunner().invoke(main, arguments)


@pytest.fixture
def asked(monkeypatch) -> dict:
    """What the library was asked for by the commands, in place of hours of work."""
    calls: dict = {}

    def tune(scene, budgets, **options):
        calls.update(scene=scene, budgets=budgets, **options)
        if options["progress"]:
            options["progress"](1, 2, "accuracy")
        if budgets.get("overlap", 1) < 1e-9:
            raise mpsim.BudgetError("max_error must be within reach: ...")
        return Tuned(SETTINGS, ROW.cost, ROW.errors, {"pressure": 0.01}, "event", (Trial(ROW, "inside", True),), 1.5)

    def tradeoff(scene, candidates, until, measures, **options):
        calls.update(scene=scene, candidates=candidates, until=until, measures=measures, **options)
        return Tradeoff("a scene", "event", 5.0, 1.0, ("pressure",), (ROW,))

    monkeypatch.setattr(trade.tuning, "tune", tune)
    monkeypatch.setattr(trade.trades, "tradeoff", tradeoff)
    return calls


# --- show, scenes


def test_scenes_are_listed_one_line_each():
    result = mpsim_command("scenes")
    assert result.exit_code == 0
    assert [line.split()[0] for line in result.stdout.splitlines()] == list(scenefile.names())
    assert "galton    Galton's board\n" in result.stdout
    titles = json.loads(mpsim_command("scenes", "--json").stdout)
    assert titles["cradle"] == "Newton's cradle"


@pytest.mark.parametrize("name", scenefile.names())
def test_every_named_scene_can_be_shown(name):
    result = mpsim_command("show", name)
    file = scenefile.load(name)
    assert result.exit_code == 0
    assert result.stdout.startswith(f"{name}: {file.title}\n")
    assert "\nLook for: " in result.stdout
    assert "Settings(dt=" in result.stdout
    shown = json.loads(mpsim_command("show", name, "--json").stdout)
    assert (shown["digest"], shown["count"]) == (file.scene.digest(), file.scene.count)
    assert shown["settings"]["dt"] == file.settings.dt


def test_show_names_every_feature(tmp_path):
    (tmp_path / "a.toml").write_text("""
        schema = 1
        width = 10
        height = 8
        boundary = ["periodic", "walls"]
        gravity = [0, -1]
        restitution = 0.5
        absorbing = ["bottom"]
        duration = 5
        obstacles = [{ position = [5, 5], radius = 1 }]
        discs = [{ position = [[1, 2], [9, 3]], radius = [0.5, 0.25], mass = [1, 2], acceleration = [1, 0] }]
        emitters = [
            { position = [2, 2], velocity = [1, 1], every = 7, limit = 3, radius = 1, mass = 1 },
            { position = [3, 2], velocity = [1, 1], interval = 0.25, radius = 1, mass = 1 },
        ]
        piston = { wall = "top", speed = -1, stop = 6 }
    """)
    result = mpsim_command("show", str(tmp_path / "a.toml"))
    assert result.stdout == (
        "a\n\n"
        "box          10 x 8, periodic along x, walls along y\n"
        "discs        2, radius 0.25 to 0.5, mass 1 to 2, packing 0.0123\n"
        "speed        0 (root mean square)\n"
        "gravity      (0, -1)\n"
        "acceleration one per disc\n"
        "restitution  0.5 of discs, 1 of walls\n"
        "obstacles    1\n"
        "emitters     one disc every 7 frames, 3 in all; one disc every 0.25 of time, no end\n"
        "absorbing    bottom\n"
        "piston       the top wall, speed -1, to 6\n"
        "duration     5\n"
        "settings     none recommended\n"
        f"read from    {tmp_path}/a.toml\n"
    )


def test_problems_of_a_file_are_told_without_a_traceback(tmp_path):
    (tmp_path / "bad.toml").write_text("schema = 1\nwidth = -1\nheight = 'x'\n")
    result = mpsim_command("show", str(tmp_path / "bad.toml"))
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr == (
        "Error: 2 problems in a scene file:\n"
        f"{tmp_path}/bad.toml: width must be a finite number > 0 [length]; got -1.\n"
        f"{tmp_path}/bad.toml: height must be a number > 0 [length]; got 'x'.\n"
    )


def test_an_unknown_scene_is_refused_with_a_suggestion():
    result = mpsim_command("show", "glaton")
    assert result.exit_code == 2
    assert result.stderr.endswith("got 'glaton'. Did you mean 'galton'?\n")


# --- tune


def test_budgets_are_options_for_every_measure(asked):
    options = [word for name in MEASURES for word in (f"--{name.replace('_', '-')}", "5%")]
    result = mpsim_command("tune", "cradle", *options, "--until", "12.5", "--replicas", "3", "--quiet")
    assert result.exit_code == 0
    assert asked["budgets"] == dict.fromkeys(MEASURES, 0.05)
    assert (asked["until"], asked["replicas"], asked["progress"]) == (12.5, 3, None)
    assert asked["scene"].digest() == mpsim.Scene.load("cradle").digest()


@pytest.mark.parametrize(
    ("text", "value"), [("1%", 0.01), ("7%", 0.07), ("0.05", 0.05), (" 2.5 %", 0.025), ("1e-3", 0.001)]
)
def test_a_budget_may_be_per_cent(asked, text, value):
    assert mpsim_command("tune", "cradle", "--pressure", text).exit_code == 0
    assert asked["budgets"] == {"pressure": value}


def test_tune_prints_the_answer_and_how_to_use_it(asked):
    result = mpsim_command("tune", "cradle", "--pressure", "1%")
    assert result.stdout.endswith("in Python: Settings(dt=0.05, contact='push')\n")
    assert result.stdout.startswith("auto push dt=0.05: 10 ns per disc and unit of time (grid)\n")


def test_tune_as_json(asked):
    found = json.loads(mpsim_command("tune", "cradle", "--pressure", "1%", "--json").stdout)
    assert found["settings"]["dt"] == 0.05
    error = found["errors"]["pressure"]
    assert (error["value"], error["error"]) == (0.004, None)  # infinite, which JSON lacks
    assert found["tried"][0]["verdict"] == "inside"


def test_budgets_out_of_reach_are_exit_code_1(asked):
    result = mpsim_command("tune", "cradle", "--overlap", "1e-12")
    assert (result.exit_code, result.stdout) == (1, "")
    assert result.stderr == "Error: max_error must be within reach: ...\n"


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["tune", "cradle"], "Give at least one budget: --pressure, --collision-rate, "),
        (["tune", "cradle", "--pressure", "x"], "'--pressure': 'x' must be a number > 0, such as 0.05 or 5%."),
        (["tune", "cradle", "--pressure", "-1"], "'--pressure': '-1' must be a number > 0, such as 0.05 or 5%."),
        (["tune", "cradle", "--pressure", "nan"], "'--pressure': 'nan' must be a number > 0, such as 0.05 or 5%."),
        (["tune", "cradle", "--pressure", "1%", "--until", "0"], "'--until': '0' must be a number > 0, such as 0.05."),
        (
            ["tune", "cradle", "--pressure", "1%", "--until", "5%"],
            "'--until': '5%' must be a number > 0, such as 0.05.",
        ),
        (
            ["tune", "cradle", "--pressure", "1%", "--replicas", "1"],
            "'--replicas': 1 is not in the range 2<=x<=100000.",
        ),
        (["tune"], "Missing argument 'SCENE'."),
        (["tradeoff", "cradle", "--csv", "--json"], "Choose one of --csv and --json."),
        (["tradeoff", "cradle", "--measure", "colour"], "'--measure': 'colour' is not one of 'pressure',"),
        (["shwo"], "No such command 'shwo'"),
    ],
)
def test_wrong_usage_is_exit_code_2(arguments, text):
    result = mpsim_command(*arguments)
    assert (result.exit_code, result.stdout) == (2, "")
    assert text in result.stderr


def test_a_mistyped_option_is_answered_with_the_right_one():
    result = mpsim_command("tune", "cradle", "--presure", "1%")
    assert (result.exit_code, result.stdout) == (2, "")
    # The marks between these words differ from version to version of click.
    assert re.search(r"No such option:? '?--presure'?\.? Did you mean '?--pressure'?\?", result.stderr)


# --- tradeoff


def test_tradeoff_prints_a_table_csv_or_json(asked):
    table = mpsim_command("tradeoff", "cradle")
    assert "auto push dt=0.05" in table.stdout
    assert asked["measures"] is None
    assert mpsim_command("tradeoff", "cradle", "--csv").stdout.startswith("method,contact,law,")
    assert json.loads(mpsim_command("tradeoff", "cradle", "--json").stdout)["reference"] == "event"
    mpsim_command(
        "tradeoff", "cradle", "--measure", "overlap", "--measure", "pressure", "--keep", "kept", "--until", "3"
    )
    assert (asked["measures"], str(asked["path"]), asked["until"]) == (("overlap", "pressure"), "kept", 3.0)


def test_tradeoff_writes_a_file_as_its_name_says(asked, tmp_path):
    result = mpsim_command("tradeoff", "cradle", "--out", str(tmp_path / "a.csv"))
    assert (result.exit_code, result.stdout) == (0, "")
    assert result.stderr == f"1 candidates written to {tmp_path}/a.csv\n"
    assert (tmp_path / "a.csv").read_text().startswith("method,contact,law,")
    mpsim_command("tradeoff", "cradle", "--out", str(tmp_path / "a.json"))
    assert json.loads((tmp_path / "a.json").read_text())["reference"] == "event"
    mpsim_command("tradeoff", "cradle", "--json", "--out", str(tmp_path / "a.txt"))
    assert (tmp_path / "a.txt").read_text().startswith("{")


def test_a_table_that_is_there_is_not_overwritten_unasked(asked, tmp_path):
    (tmp_path / "a.csv").write_text("weeks of work")
    result = mpsim_command("tradeoff", "cradle", "--out", str(tmp_path / "a.csv"))
    assert result.exit_code == 2
    assert (
        f"'{tmp_path}/a.csv' is there already, and is not overwritten. Give another name, or --force." in result.stderr
    )
    assert ((tmp_path / "a.csv").read_text(), asked) == ("weeks of work", {})
    assert mpsim_command("tradeoff", "cradle", "--out", str(tmp_path / "a.csv"), "--force").exit_code == 0
    assert (tmp_path / "a.csv").read_text().startswith("method,")


def test_a_file_that_cannot_be_written_is_refused_before_the_work(asked, tmp_path):
    result = mpsim_command("tradeoff", "cradle", "--out", str(tmp_path / "none" / "a.csv"))
    assert result.exit_code == 1
    assert result.stderr == (
        f"Error: --out must be a file that can be written; got '{tmp_path}/none/a.csv' (No such file or directory). "
        "Choose another place.\n"
    )
    assert not asked
    mpsim_command("tradeoff", "nonsense", "--out", str(tmp_path / "b.csv"))
    assert not (tmp_path / "b.csv").exists()


# --- progress, warnings, the log, help


def test_progress_is_a_line_now_and_then_where_nobody_watches(capsys, monkeypatch):
    now = [0.0]
    monkeypatch.setattr(terminal.time, "monotonic", lambda: now[0])
    with terminal.progress(quiet=False) as progress:
        for step in range(100):
            now[0] = float(step)
            progress(step, 100, "accuracy")
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.splitlines() == [
        f"{step} of 100: accuracy, 1/s, {100 - step} s left" for step in range(10, 100, 10)
    ]


def test_progress_is_nothing_under_quiet(capsys):
    with terminal.progress(quiet=True) as progress:
        assert progress is None
    assert capsys.readouterr() == ("", "")


def test_progress_is_a_bar_on_a_terminal(monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("TERM", "xterm")
    with terminal.progress(quiet=False) as progress:
        progress(1, 2, "accuracy [of a kind]")
        progress(2, 2, "accuracy [of a kind]")
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "2/2" in captured.err
    plain = re.sub(r"\x1b\[[\d;?]*[A-Za-z]", "", captured.err)
    assert re.search(r"accuracy \[of a kind\] +━+ 2/2 [\d.,]+/s left 0:00:00", plain), "rate and time left"


def test_warnings_are_a_line_without_source(monkeypatch):
    @click.command()
    def warn() -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            warnings.warn("discs overlap", mpsim.OverlapWarning, stacklevel=1)

    monkeypatch.setitem(main.commands, "warn", warn)
    result = mpsim_command("warn")
    assert (result.exit_code, result.stderr) == (0, "Warning: discs overlap\n")


@pytest.mark.parametrize(
    "error", [mpsim.ClosedError("gone"), MemoryError("too much"), PermissionError(13, "no", "a.txt")]
)
def test_an_error_is_a_sentence(monkeypatch, error):
    @click.command()
    def fail() -> None:
        raise error

    monkeypatch.setitem(main.commands, "fail", fail)
    result = mpsim_command("fail")
    assert (result.exit_code, result.stderr) == (1, f"Error: {error}\n")


def test_verbose_tells_what_is_read():
    before = list(logging.getLogger("mpsim").handlers)
    result = mpsim_command("--verbose", "show", "cradle")
    assert "cradle.toml" in result.stderr
    assert mpsim_command("show", "cradle").stderr == ""
    assert logging.getLogger("mpsim").handlers == before


@pytest.mark.parametrize("command", [[], ["scenes"], ["show"], ["tune"], ["tradeoff"]])
def test_help_has_examples(command):
    result = mpsim_command(*command, "--help")
    assert result.exit_code == 0
    assert f"Examples:\n    mpsim {' '.join(command)}".rstrip() in result.stdout


def test_the_module_is_the_command():
    run = [sys.executable, "-m", "mpsim"]
    shown = subprocess.run([*run, "show", "cradle"], capture_output=True, text=True, timeout=60, check=True)
    assert shown.stdout.startswith("cradle: Newton's cradle\n")
    refused = subprocess.run([*run, "show", "none"], capture_output=True, text=True, timeout=60, check=False)
    assert (refused.returncode, refused.stdout) == (2, "")
    assert refused.stderr.startswith("Error: scene must be a path that ends in .toml or one of ")
    version = subprocess.run([*run, "--version"], capture_output=True, text=True, timeout=60, check=True)
    assert version.stdout == f"mpsim, version {mpsim.__version__}\n"


@pytest.mark.long
def test_tune_and_tradeoff_do_what_they_say(tmp_path):
    path = tmp_path / "small.toml"
    mpsim.Scene.random(count=20, packing=0.2, radius=0.5).save(path)
    short = ["--until", "5", "--replicas", "2", "--quiet"]
    tuned = mpsim_command("tune", str(path), "--overlap", "0.2", "--json", *short)
    assert json.loads(tuned.stdout)["errors"]["overlap"]["value"] <= 0.2
    table = mpsim_command("tradeoff", str(path), "--measure", "overlap", "--json", *short)
    assert len(json.loads(table.stdout)["rows"]) > 5
