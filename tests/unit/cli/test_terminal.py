"""What commands share: progress, warnings, completion of names."""

import re
import sys
import warnings

import click
from support.commands import mpsim_command

import mpsim
from mpsim.cli import terminal
from mpsim.cli.app import main


def test_scenes_are_completed():
    from click.shell_completion import ShellComplete  # noqa: PLC0415

    words = [item.value for item in ShellComplete(main, {}, "mpsim", "_MPSIM_COMPLETE").get_completions(["run"], "ga")]
    assert {"galton", "gas"} <= set(words)
    assert "pi" not in words


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
