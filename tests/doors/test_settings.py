"""Settings, units and progress; names that are not known, errors that travel, and how many cores may be used."""

import dataclasses
import io
import math
import os
import pickle
import re
import sys
import threading
import time
from fractions import Fraction
from pathlib import Path

import numpy as np
import psutil
import pytest
from support.commands import mpsim_command
from support.refusals import assert_refused
from support.scenes import At, gas, simulate

import mpsim
from mpsim import InputError, Settings, Units

pytestmark = pytest.mark.plain

# --- settings


def test_settings_are_immutable_equal_by_value_and_have_the_documented_defaults():
    settings = Settings(dt=0.02)
    with pytest.raises(dataclasses.FrozenInstanceError):
        settings.dt = 1
    assert (settings, hash(settings)) == (Settings(0.02), hash(Settings(dt=0.02)))
    names = ("method", "law", "contact", "precision", "workers", "substeps")
    assert [getattr(settings, name) for name in names] == ["auto", "elastic", "impact", "float64", None, 1]
    for number in (Fraction(1, 100), np.float32(0.01), np.float64(0.01)):
        assert Settings(dt=number).dt == pytest.approx(0.01)


def test_a_value_without_its_name_and_a_setting_in_the_wrong_place_are_refused():
    for call, what, got in (
        (lambda: mpsim.Scene(10, 10), "Scene ", "width=...; got 10 alone"),
        (lambda: mpsim.Scene.random(0.5, count=9), "Scene.random ", "radius=...; got 0.5 alone"),
        (lambda: Units(1), "Units ", "length=...; got 1 alone"),
    ):
        assert_refused([f"an argument of {what}must be given with its name, such as {got}."], call)
    with pytest.raises(mpsim.errors.UnknownArgumentError, match=r"got 'dt'\. Use Settings\(dt=\.\.\.\)\."):
        mpsim.Simulation(gas(3, 0.1), dt=0.01)
    with pytest.raises(mpsim.errors.UnknownArgumentError, match=r"^((?!Settings).)*$"):
        mpsim.Simulation(gas(3, 0.1), colour="red")


def test_an_error_arrives_in_another_process_as_it_was_sent():
    for error in (
        mpsim.errors.SceneFileError("a.toml", ["width must be positive", "radius must be positive"]),
        mpsim.DivergedError(3, 7, (1.0, float("inf")), (0.0, 2.0)),
        mpsim.WorkerDiedError(1, 4711, -9, "signal 9 (SIGKILL)", 12, "move"),
    ):
        arrived = pickle.loads(pickle.dumps(error))
        assert (type(arrived), str(arrived), vars(arrived)) == (type(error), str(error), vars(error))


# --- units

CHOSEN = {"length": 0.03, "mass": 0.2, "time": 0.7}
BOLTZMANN = 1.380649e-23


def test_units_multiply_as_the_quantities_do():
    """Laws between quantities hold for their units: each from another two."""
    units = Units(**CHOSEN)
    one = {}
    for name in """length mass time area rate velocity acceleration momentum force energy temperature pressure diffusion
                   viscosity wave_number number_density""".split():  # noqa: SIM905
        one[name] = units.in_si(name)
    assert one == pytest.approx({
        **CHOSEN, "area": one["length"] ** 2, "rate": 1 / one["time"], "velocity": one["length"] / one["time"],
        "acceleration": one["velocity"] ** 2 / one["length"], "momentum": one["mass"] * one["velocity"],
        "force": one["mass"] * one["acceleration"], "energy": one["force"] * one["length"],
        "temperature": one["energy"] / BOLTZMANN, "pressure": one["energy"] / one["area"],
        "diffusion": one["length"] * one["velocity"], "viscosity": one["pressure"] / one["rate"],
        "wave_number": 1 / one["length"], "number_density": 1 / one["area"],
    }, rel=1e-14)  # fmt: skip
    for name in ("time", "velocity", "acceleration", "energy", "temperature"):
        assert Units(length=0.03, mass=0.2, **{name: one[name]}).time == pytest.approx(0.7, rel=1e-14)
    argon = Units(length=3.4e-10, mass=6.634e-26, temperature=300.0)
    assert argon.in_si("velocity") == pytest.approx(249.9, abs=0.1), "sqrt(kT/m) of argon at 300 K"
    assert units == Units(**CHOSEN) != Units(**CHOSEN | {"time": 1})


@pytest.mark.parametrize(
    ("act", "parts"),
    [
        (lambda: Settings(dt=10**400), ["dt must be a finite number > 0", "finite", "of 401 digits"]),
        (lambda: Settings(method=None), ["method must be one of", "got None"]),
        (lambda: Settings(law="elastisch"), ["law must be one of 'reflect', 'elastic'", "Did you mean 'elastic'?"]),
        (lambda: Settings(workers=10**6), ["workers must be a whole number from 1 to 1024", "got 1000000"]),
        (lambda: Units(length=1, mass=1), ["must follow from one of time, velocity", "got none of them"]),
        (lambda: Units(**CHOSEN, energy=1.0), ["must follow from one of", "got time and energy"]),
        (lambda: Units(**CHOSEN | {"length": 1e-200}), ["fit float64", "one unit of area is 0 in SI", "length=1e-200"]),
        (lambda: Units(**CHOSEN).in_si("presure"), ["quantity must be one of 'length'", "Did you mean 'pressure'?"]),
    ],
)  # fmt: skip
def test_wrong_settings_units_and_values_are_refused(act, parts):
    assert_refused(parts, act)


# --- progress


class Terminal(io.StringIO):
    def isatty(self):
        return True


Notebook = type("OutStream", (io.StringIO,), {"__module__": "ipykernel.iostream"})


def on_screen(text):
    """What a terminal shows in the end: a line is cleared, or the one above, before anything is written anew."""
    text = re.sub(r"\x1b\[[\d;?]*[hlm]", "", text)
    text = re.sub(r"[^\n]*\n\r\x1b\[1A\x1b\[2K", "", text)
    return [re.split(r"\r\x1b\[2K", line)[-1].rstrip() for line in text.split("\n")]


@pytest.fixture
def shown(monkeypatch):
    """The last line of a stream at each frame of a run of 25 of them, one a second, and all lines at its end."""

    def show(stream, step=1.0):
        now, seen = [0.0], []

        class Clock:
            every = 1

            def observe(self, sim, collisions):
                seen.append(on_screen(stream.getvalue())[-1])
                now[0] += step

        with simulate(gas(3, 0.1), method="naive") as sim, monkeypatch.context() as patch:
            patch.setattr(sys, "stderr", stream)
            patch.setattr(time, "monotonic", lambda: now[0])
            sim.run(frames=25, progress=True, observe=Clock())
        return seen, on_screen(stream.getvalue())

    return show


def test_a_terminal_has_a_line_with_rate_and_time_left_which_goes_at_the_end(shown, monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    seen, end = shown(Terminal())
    assert any(re.fullmatch(r"frames \S+\s* 15/25 1/s 0:00:10", line) for line in seen), seen
    assert end == [""]
    _, end = shown(Notebook())
    assert re.match(r"frames \S+ 25/25 1/s", end[0]), "there it stays"
    quick = Terminal()
    shown(quick, 0.01)
    assert 2 <= quick.getvalue().count("frames ") <= 6, "ten times a second"
    assert shown(io.StringIO())[1] == [""], "a file"


def test_a_run_shows_its_frames_when_asked_has_the_same_bits_and_cleans_up_when_it_fails(capsys, monkeypatch):
    digests = []
    for wanted in (None, False, True):
        with simulate(gas(6, 0.2), method="naive") as sim:
            sim.run(frames=20, progress=wanted)
            digests.append(sim.digest())
        assert capsys.readouterr() == ("", ""), "no terminal"
    assert len(set(digests)) == 1

    def end(sim):
        raise KeyError

    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    with simulate(gas(6, 0.2), method="naive") as sim:
        with pytest.raises(KeyError):
            sim.run(frames=20, progress=True, observe=At(10, end))
        with pytest.raises(
            InputError, match=r"^progress must be True, False or a function, called as progress\(done, of"
        ):
            sim.run(frames=1, progress="yes")
    assert on_screen(terminal.getvalue()) == [""]


# --- cores


def group(path):
    """What a process in a group of this path sees."""
    return {"/proc/self/cgroup": f"0::{path}\n"}


def quota(folder, text):
    return {f"/sys/fs/cgroup{folder}/cpu.max": f"{text}\n"}


JOB = group("/user/job")
CORES = {
    "no limits": ({}, 8), "affinity": ({"affinity": 3}, 3), "fewer": ({"cores": 4}, 4), "unknown": ({"cores": None}, 1),
    "quota rounded up": ({"files": JOB | quota("/user/job", "250000 100000")}, 3),
    "user": ({"user": "3"}, 3), "user 0": ({"user": "0"}, 1), "user none": ({"user": "default"}, 8),
    **{f"user {each!r:.9}": ({"user": each}, 8) for each in ("9" * 5000, "\u00b2", "-1", "x" * 5000)},
    "nonsense": ({"files": JOB | quota("/user/job", "odd")}, 8),
    "quota of half a core": ({"files": JOB | quota("/user/job", "50000 100000")}, 1),
    "quota of a parent": ({"files": JOB | quota("/user/job", "max 100000") | quota("/user", "300000 100000")}, 3),
    "own group at the top": ({"files": group("/docker/a") | quota("", "200000 100000")}, 2),
}  # fmt: skip


@pytest.mark.parametrize("case", CORES)
def test_the_least_of_machine_affinity_quota_and_wish_is_the_number_of_cores(case, monkeypatch):
    """On a pretended machine, by the threads that a sweep takes."""
    pretended, expected = CORES[case]
    files, read = pretended.get("files", {}), Path.read_text

    def pretend(path, *how, **named):
        if str(path) in files:
            return files[str(path)]
        if str(path).startswith(("/proc/self/", "/sys/fs/cgroup")):
            raise FileNotFoundError
        return read(path, *how, **named)

    monkeypatch.setattr(psutil, "cpu_count", lambda: pretended.get("cores", 8))
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(pretended.get("affinity", 8))))
    monkeypatch.setattr(Path, "read_text", pretend)
    monkeypatch.setenv("PYTHON_CPU_COUNT", pretended.get("user", "default"))
    assert threads_that_are_used(expected) == expected


def threads_that_are_used(expected):
    """The largest number of runs of a sweep at once, which wait until so many are there: it has a thread for a core."""
    inside, most, lock, there = [0], [0], threading.Lock(), threading.Barrier(expected)

    def wait(x):
        with lock:
            inside[0] += 1
            most[0] = max(most[0], inside[0])
        time.sleep(0.005)  # in which one too many would come
        there.wait(20)
        with lock:
            inside[0] -= 1
        return {}

    mpsim.sweep(wait, {"x": range(24)})  # all the numbers expected divide it
    return most[0]


# --- what the named scenes promise


@pytest.mark.long
@pytest.mark.parametrize("name", ["brownian", "cooling", "galton", "growth", "hopper", "pi", "piston", "rough-hopper"])
@pytest.mark.filterwarnings("ignore::mpsim.errors.EmitterWarning")  # a box that fills lets discs wait
def test_a_named_scene_shows_what_it_promises_and_another_number_would_not_do(name):
    found = mpsim.findings(name)
    assert (found.scene, found.consistent) == (name, True), str(found)
    page = (Path(__file__).parents[2] / "docs" / "scenes.md").read_text()
    (expected,) = re.findall(rf"(?m)^\| `{name}` \|[^|]*\| ([^|]*) \|[^|]*\|$", page)
    assert expected == f"{found.numbers[0].expected:.4g}", "the page says it"
    number = found.numbers[0]
    for off, consistent in ((0.9 * number.within, True), (1.1 * number.within + 0.5, False), (math.nan, False)):
        assert dataclasses.replace(number, found=number.expected + off).consistent is consistent


def test_the_findings_are_printed_after_a_run_as_recommended():
    line = "collisions of discs and with the wall [1]: 314 found, 314 expected (digits of pi: Galperin 2003)\n"
    assert mpsim_command("run", "pi", "--quiet").stdout.endswith(line)
    assert "expected" not in mpsim_command("run", "pi", "--quiet", "--until", 1).stdout, "not as long"
    with pytest.raises(InputError, match=r"name must be one of 'brownian'.* got 'hoper'. Did you mean 'hopper'\?"):
        mpsim.findings("hoper")
