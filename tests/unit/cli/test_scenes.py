"""`mpsim scenes` and `mpsim show`: what there is, and what is wrong with a file."""

import json
import re

import pytest
from support.commands import mpsim_command

from mpsim.scene import scenefile


def test_scenes_are_listed_one_line_each():
    result = mpsim_command("scenes")
    assert result.exit_code == 0
    assert [line.split()[0] for line in result.stdout.splitlines()] == list(scenefile.names())
    assert re.search("^galton +Galton's board$", result.stdout, re.MULTILINE)
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
        "piston       the top wall, speed -1, to 6\n"
        "absorbing    bottom\n"
        "emitters     one disc every 7 frames, 3 in all; one disc every 0.25 of time, no end\n"
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
