"""What commands share: progress, warnings, completion of names."""

import re
import sys
import time
import warnings

import click
import pytest
from support.commands import mpsim_command

import mpsim
from mpsim.cli import terminal
from mpsim.cli.app import main
from mpsim.kernels import compile_notice


def test_scenes_are_completed():
    from click.shell_completion import ShellComplete  # noqa: PLC0415

    words = [item.value for item in ShellComplete(main, {}, "mpsim", "_MPSIM_COMPLETE").get_completions(["run"], "ga")]
    assert {"galton", "gas"} <= set(words)
    assert "pi" not in words


def test_progress_is_nothing_under_quiet(capsys):
    with terminal.progress(quiet=True) as progress:
        assert progress is None
    assert capsys.readouterr() == ("", "")


TEXT = "compiling the loops for this scene, once; about 4 s"


def on_terminal(monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("TERM", "xterm")


def plain(text):
    return re.sub(r"\x1b\[[\d;?]*[A-Za-z]", "", text)


def test_compiling_is_a_spinner_on_a_terminal(monkeypatch, capsys):
    on_terminal(monkeypatch)
    shown = terminal.Compiling({})
    shown.begin(TEXT)
    time.sleep(0.3)
    shown.end()
    captured = capsys.readouterr()
    assert captured.out == ""
    frames = set(re.findall(rf"(\S) {TEXT}", plain(captured.err)))
    assert len(frames) > 1, "it turns"
    assert captured.err.rstrip().endswith("\x1b[2K"), "and goes"


def test_compiling_is_a_line_above_a_bar(monkeypatch, capsys):
    on_terminal(monkeypatch)
    with terminal.progress(quiet=False) as progress:
        progress(1, 2, "accuracy")
        shown = terminal.Compiling({})
        shown.begin(TEXT)
        shown.end()
        progress(2, 2, "accuracy")
    assert f"{TEXT}\n" in plain(capsys.readouterr().err)


@click.command()
@terminal.quiet_option
def compile_something(quiet: bool) -> None:
    with compile_notice.asked_for("run_naive", (), True):
        compile_notice.not_cached()
        time.sleep(0.2)


def test_compiling_is_a_line_where_nobody_watches_and_nothing_under_quiet(monkeypatch):
    monkeypatch.setattr(compile_notice, "QUIET_FOR", 0.01)
    monkeypatch.setitem(main.commands, "compile", compile_something)
    for arguments in (["compile"], ["-v", "compile"]):
        assert mpsim_command(*arguments).stderr == f"{TEXT}\n", "once, with -v too"
    quiet = mpsim_command("compile", "--quiet")
    assert (quiet.exit_code, quiet.stderr) == (0, "")


def test_after_a_command_the_log_has_it_again():
    before = compile_notice._announcer
    assert mpsim_command("scenes").exit_code == 0
    assert compile_notice._announcer is before


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
    ("arguments", "text"),
    [
        (["run", "gas", "--on-fast", "substp"], "Did you mean 'substep'?"),
        (["run", "gas", "--measure", "presure"], "Did you mean 'pressure'?"),
        (["tune", "gas", "--pressure", "200%"], "'200%' must be less than 100%. Give a smaller one, such as 5%."),
        (["run", "gas", "--frames", "5.5"], "'--frames': '5.5' must be a whole number >= 1. Give 5 or 6."),
        (["run", "gas", "--workers", "0"], "'--workers': '0' must be a whole number from 1 to 1024."),
        (["run", "gas", "--workers", "1024.5"], "'1024.5' must be a whole number from 1 to 1024. Give 1024."),
        (["run", "gas", "--frames", "many"], "'many' must be a whole number >= 1."),
        (["run", "gas", "--frames", "inf"], "'inf' must be a whole number >= 1."),
        (
            ["run", "gas", "--method", "naive", "--dt", "1", "--frames", "1", "--on-fast", "error"],
            "Use --dt 0.079, --substeps 13 or --on-fast substep; --on-fast warn runs it anyway.",
        ),
        (
            ["run", "gas", "--method", "event", "--precision", "float32"],
            "--method event cannot do --precision float32. Leave it out, or use --method grid.",
        ),
        (
            ["animate", "gas", "a.gif", "--colour", "worker", "--method", "naive", "--frames", "1"],
            "this run is by 'naive'. Use --method parallel",
        ),
        (
            ["animate", "gas", "a.gif", "--frames", "3", "--until", "2"],
            "--frames must not come with --until or --seconds",
        ),
        (["stability", "--out", "/proc/x"], "'/proc/x' must be a file or folder that can be used; it cannot (No such"),
        (["plot", "/nope"], "'/nope' does not (No such file or directory)."),
    ],
)
def test_a_mistake_is_answered_to_the_point(arguments, text):
    result = mpsim_command(*arguments)
    assert result.exit_code == (1 if arguments[0] == "stability" else 2)
    assert text in result.stderr.replace("\n", " ")
