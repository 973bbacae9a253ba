"""Progress on standard error: a line that is rewritten where somebody watches, a line now and then elsewhere."""

import io
import re
import sys

import pytest
from support.scenes import gas, simulate

import mpsim
from mpsim.core import progress

FRAMES = 40


@pytest.fixture
def clock(monkeypatch):
    """A clock, in seconds, that stands until it is set."""
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    return now


class Terminal(io.StringIO):
    """A terminal of unknown width."""

    def isatty(self):
        return True


Notebook = type("OutStream", (io.StringIO,), {"__module__": "ipykernel.iostream"})


def on_screen(text):
    """What a terminal shows in the end: the cursor returns at \\r, and \\x1b[K erases what is behind it."""
    lines, line, at = [], "", 0
    for part in re.findall(r"\x1b\[K|[\r\n]|[^\x1b\r\n]+", text):
        if part == "\n":
            lines, line, at = [*lines, line], "", 0
        elif part == "\r":
            at = 0
        elif part == "\x1b[K":
            line = line[:at]
        else:
            line, at = line[:at] + part + line[at + len(part) :], at + len(part)
    return [*lines, line]


def test_a_terminal_has_a_line_with_rate_and_time_left_which_goes_at_the_end(clock, monkeypatch):
    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    monkeypatch.setenv("TERM", "xterm")
    seen = []
    with progress.shown(True) as show:
        for step in range(0, 101, 25):
            clock[0] = step / 10
            show(step, 100, "frames")
            seen.append(on_screen(terminal.getvalue()))
    assert seen[0] == ["frames [                    ] 0/100"]
    assert seen[2] == ["frames [##########          ] 50/100, 10/s, 5.0 s left"]
    assert seen[4] == ["frames [####################] 100/100, 10/s"]
    assert on_screen(terminal.getvalue()) == [""]


def test_a_line_is_written_ten_times_a_second_and_fits_the_terminal(clock, monkeypatch):
    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    monkeypatch.setattr(progress, "WIDTH", 30)
    with progress.shown(True) as show:
        for step in range(1000):
            clock[0] = step / 1000
            show(step, 2000, "frames")
    written = terminal.getvalue().split("\r")
    assert 10 <= len(written) <= 13
    assert max(len(line.removesuffix("\x1b[K")) for line in written) == 29


def test_other_texts_go_above_the_line(clock, monkeypatch):
    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    with progress.shown(True) as show:
        show(1, 2, "runs")
        assert progress.above("a warning")
        show(0, 1, "next: accuracy")
        assert on_screen(terminal.getvalue()) == ["a warning", "next: accuracy", "runs [##########          ] 1/2"]
    assert not progress.above("too late")


def test_a_notebook_has_a_line_that_stays(clock, monkeypatch):
    monkeypatch.setattr(sys, "stderr", notebook := Notebook())
    with progress.shown(True) as show:
        for step in (0, 5, 10):
            clock[0] = float(step)
            show(step, 10, "frames")
    assert "\x1b" not in notebook.getvalue()
    assert [line.rstrip() for line in on_screen(notebook.getvalue())] == [
        "frames [####################] 10/10, 1/s",
        "",
    ]


@pytest.mark.parametrize(("last", "end"), [(True, ["25 of 25: frames, 1/s"]), (False, [])])
def test_elsewhere_there_is_a_line_now_and_then(last, end, clock, capsys):
    with progress.shown(True, last=last) as show:
        for step in range(26):
            clock[0] = float(step)
            show(step, 25, "frames")
    lines = capsys.readouterr().err.splitlines()
    assert lines == ["10 of 25: frames, 1/s, 15 s left", "20 of 25: frames, 1/s, 5.0 s left", *end]


@pytest.mark.parametrize("wanted", [None, False])
def test_nothing_is_shown_unasked(wanted, capsys):
    with progress.shown(wanted) as show:
        show(1, 1, "frames")
    with simulate(gas(20, 0.2), method="grid") as sim:
        sim.run(frames=FRAMES, progress=wanted)
    assert capsys.readouterr() == ("", "")


def test_a_run_shows_its_frames_and_has_the_same_bits(capsys):
    with simulate(gas(20, 0.2), method="grid") as sim:
        sim.run(frames=FRAMES, progress=True)
        digest = sim.digest()
    captured = capsys.readouterr()
    assert captured.out == ""
    assert re.fullmatch(rf"{FRAMES} of {FRAMES}: frames(, [\d.,e+]+/s)?\n", captured.err)
    with simulate(gas(20, 0.2), method="grid") as sim:
        sim.run(frames=FRAMES)
        assert sim.digest() == digest


def test_a_run_that_fails_leaves_the_terminal_as_it_was(monkeypatch):
    class Ends:
        every = 1

        def look(self, sim, collisions):
            if sim.frame == FRAMES:
                raise KeyError

    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    with simulate(gas(20, 0.2), method="grid") as sim, pytest.raises(KeyError):
        sim.run(frames=2 * FRAMES, progress=True, observe=Ends())
    assert on_screen(terminal.getvalue()) == [""]
    assert not progress._lines


@pytest.mark.parametrize(
    "refused",
    [
        lambda sim: sim.run(frames=1, progress="yes"),
        lambda sim: mpsim.sweep(sim.scene, {"dt": [0.1]}, until=0.1, progress=3),
        lambda sim: mpsim.tradeoff(sim.scene, progress=3),
        lambda sim: mpsim.tune(sim.scene, {"pressure": 0.1}, progress=3),
        lambda sim: mpsim.animate(sim.scene, None, "a.gif", progress=3),
    ],
)
def test_what_is_no_progress_is_refused(refused):
    with (
        simulate(gas(20, 0.2), method="grid") as sim,
        pytest.raises(
            mpsim.InputError, match=r"^progress must be True, False or a function, called as progress\(done, of"
        ),
    ):
        refused(sim)
