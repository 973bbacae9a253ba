"""A real Ctrl-C, to the whole process group as a terminal sends it, while `mpsim run` is at work."""

import json
import math
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from click.testing import CliRunner
from support.processes import run_script

from mpsim.cli.app import main


def command(*words: str, at: float = math.inf) -> str:
    """A script that is a command of mpsim, and sends Ctrl-C to its own group after so many frames."""
    return f"""
        import contextlib, os, signal
        from mpsim.cli.app import main
        from mpsim.cli import terminal

        @contextlib.contextmanager
        def progress(quiet):
            sent = []
            def show(done, of, what):
                if done >= float({str(at)!r}) and not sent:
                    sent.append(done)
                    os.killpg(0, signal.SIGINT)
            yield show

        terminal.progress = progress
        main({words!r}, prog_name="mpsim")
    """


@pytest.mark.slow
def test_ctrl_c_stops_all_workers_and_leaves_a_run_that_goes_on(tmp_path):
    whole, out = tmp_path / "whole", tmp_path / "run"
    settings = ("run", "gas", "--frames", "400", "--every", "50", "--quiet", "--method")
    outcome = run_script(command(*settings, "parallel", "--workers", "2", "--out", str(out), at=50), warm=True)
    assert outcome.code == 130, outcome.err
    frame = json.loads((out / "run.json").read_text())["frame"]
    assert outcome.out == ""
    assert outcome.err == f"Interrupted at frame {frame} of 400. Continue with: mpsim resume {out}\n"
    assert 50 <= frame < 400
    for words in ((*settings, "grid", "--out", str(whole)), ("resume", str(out), "--workers", "1", "--quiet")):
        done = CliRunner().invoke(main, words)
        assert done.exit_code == 0, done.stderr
    assert (out / "trajectory.xyz").read_bytes() == (whole / "trajectory.xyz").read_bytes()
    assert (out / "final.npz").read_bytes() == (whole / "final.npz").read_bytes()


@pytest.mark.parametrize("delay", [0.15, 0.4])
def test_ctrl_c_while_the_command_is_imported_is_no_traceback(delay):
    """The import takes a second or more. The control: a program of one's own that imports mpsim keeps its handler."""
    program = Path(sys.executable).with_name("mpsim")
    with subprocess.Popen([program, "show", "gas"], stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as run:
        time.sleep(delay)
        run.send_signal(signal.SIGINT)
        errors = run.communicate(timeout=60)[1]
    assert run.returncode in (-signal.SIGINT, 130)
    assert "Traceback" not in errors
    handler = "import signal, mpsim.cli.app; print(signal.getsignal(signal.SIGINT) is signal.default_int_handler)"
    assert run_script(handler).out == "True\n"
