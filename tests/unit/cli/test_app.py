"""The command `mpsim`: exit codes 0 done, 1 failed, 2 wrong usage or input; errors in a sentence; help."""

import logging
import re
import subprocess
import sys

import click
import pytest
from support.commands import mpsim_command

import mpsim
from mpsim.cli.app import ELSEWHERE, main


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["run", "gas", "--frames", 3, "--until", 2], "Give --frames or --until, not both."),
        (["resume", "gas", "--frames", 3, "--until", 2], "Give --frames or --until, not both."),
        (["run", "gas", "--every", 3], "--every needs --out, the folder to write to."),
        (["run", "gas", "--force"], "--force needs --out"),
        (["run", "gas", "--format", "gsd"], "--format needs --out"),
        (["run", "gas", "--dt", "0"], "'--dt': '0' must be a number > 0, such as 0.05."),
        (["run", "gas", "--frames", "0"], "'0' must be a whole number >= 1."),
        (["run", "gsa"], "got 'gsa'. Did you mean 'gas'?"),
        (["run", "none.toml"], "scene must be a file that can be read; got 'none.toml' (No such file or directory)."),
        (["animate", "gsa", "a.gif"], "got 'gsa'. Did you mean 'gas'?"),
        (["run", "gas", "--method", "gird"], "'--method': 'gird' is not one of"),
        (["completion", "tcsh"], "'tcsh' is not one of 'bash', 'zsh', 'fish'."),
    ],
)
def test_wrong_usage_and_input_are_exit_code_2(arguments, text, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = mpsim_command(*arguments)
    assert (result.exit_code, result.stdout) == (2, "")
    assert text in result.stderr
    assert not list(tmp_path.iterdir())


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
            "'--replicas': '1' must be a whole number from 2 to 64.",
        ),
        (["tune"], "Missing argument 'SCENE'."),
        (["tradeoff", "cradle", "--csv", "--json"], "Choose one of --csv and --json."),
        (["tradeoff", "cradle", "--measure", "colour"], "'--measure': 'colour' is not one of 'pressure',"),
        (["shwo"], "No such command 'shwo'"),
        *(([name], f"No such command '{name}'. {where}") for name, where in ELSEWHERE.items()),
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


@pytest.mark.parametrize("option", ["-v", "--verbose", "--version"])
def test_an_option_of_all_commands_is_sent_before_the_command(option):
    result = mpsim_command("run", "gas", option)
    assert (result.exit_code, result.stdout) == (2, "")
    rest = "" if option == "--version" else " ..."
    assert result.stderr.endswith(f"Error: {option} stands before the command: mpsim {option}{rest}\n")


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (mpsim.errors.ClosedError("gone"), "gone"),
        (MemoryError("too much"), "too much"),
        (PermissionError(13, "no", "a.txt"), "'a.txt' must be a file or folder that can be used; it cannot (no)."),
    ],
)
def test_an_error_is_a_sentence(monkeypatch, error, text):
    @click.command()
    def fail() -> None:
        raise error

    monkeypatch.setitem(main.commands, "fail", fail)
    result = mpsim_command("fail")
    assert (result.exit_code, result.stderr) == (1, f"Error: {text}\n")


def test_verbose_tells_what_is_read():
    before = list(logging.getLogger("mpsim").handlers)
    result = mpsim_command("--verbose", "show", "cradle")
    assert "cradle.toml" in result.stderr
    assert mpsim_command("show", "cradle").stderr == ""
    assert logging.getLogger("mpsim").handlers == before


@pytest.mark.parametrize("command", [[], *([name] for name in main.commands)], ids=" ".join)
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
    assert mpsim_command("--version").stdout == f"mpsim, version {mpsim.__version__}\n"
