"""The file of a sweep: what is in it is not run again; other sweeps and damage are refused; interruptions and kills."""

import functools
import json
import math
import os
import signal
import time

import pytest
from support.processes import Script, assert_clean, run_script, wait_until
from support.swept import double, noted

import mpsim
from mpsim import InputError, sweep
from mpsim.errors import OutputError, SweepWarning

pytestmark = pytest.mark.plain


@pytest.fixture
def kept(tmp_path):
    return tmp_path / "kept.jsonl"


@pytest.fixture
def noting(tmp_path):
    return functools.partial(noted, folder=str(tmp_path))


def calls_in(folder):
    path = folder / "calls"
    found = [int(line) for line in path.read_text().split()] if path.exists() else []
    path.unlink(missing_ok=True)
    return sorted(found)


def test_what_is_there_is_not_run_again_whatever_else_the_grid_has_now(noting, kept, tmp_path):
    first = sweep(noting, {"x": [1, 2]}, path=kept)
    assert calls_in(tmp_path) == [1, 2]
    assert sweep(noting, {"x": [2, 1]}, path=kept).rows == first.rows[::-1]
    assert calls_in(tmp_path) == []
    more = sweep(noting, {"x": [3, 2.0]}, path=str(kept))
    assert calls_in(tmp_path) == [3]
    assert [row.values["y"] for row in more.rows] == [6, 4]
    sweep(noting, {"x": [1, 2, 3]}, path=kept)
    assert calls_in(tmp_path) == [], "rows of values that were left out for a while are still there"


def test_values_come_back_as_they_were(kept):
    given = {"infinite": -math.inf, "tiny": 5e-324, "third": 1 / 3, "large": 2**70, "none": None, "truth": True,
             "text": "\u00e9\n", "empty": ""}  # fmt: skip
    first, found = (sweep(lambda x: given | {"nan": math.nan}, {"x": [1]}, path=kept).rows[0].values for _ in range(2))
    assert str(found.pop("nan")) == str(first.pop("nan")) == "nan"
    assert found == first == given
    assert [type(value) for value in found.values()] == [type(value) for value in given.values()]


def odd(x):
    if x == 0:
        return {"name": "a\udcff"}
    raise ValueError("z" * 10_000_000 if x == 1 else "no file \udcff")


def test_lone_surrogates_and_long_errors_are_written_out_in_all_files(kept, tmp_path):
    table = sweep(odd, {"x": [0, 1, 2]}, path=kept)
    assert kept.stat().st_size < 20_000, "an error of 10 MB is cut"
    table.to_json(tmp_path / "t.json")
    table.to_csv(tmp_path / "t.csv")
    assert "a\\udcff" in (tmp_path / "t.csv").read_text()
    assert sweep(odd, {"x": [0]}, path=kept).rows == table.rows[:1]


def test_failed_runs_are_run_again_unless_they_shall_be_kept(kept, tmp_path):
    def once(x):
        if not (tmp_path / "well").exists():
            raise ValueError(f"not yet {x}")
        return {"y": x}

    (failed,) = sweep(once, {"x": [1]}, path=kept).rows
    (tmp_path / "well").touch()
    (still,) = sweep(once, {"x": [1]}, path=kept, retry_failed=False).rows
    assert still == failed
    assert (failed.failure, "not yet 1" in failed.traceback) == ("ValueError: not yet 1", True)
    assert sweep(once, {"x": [1]}, path=kept).rows[0].values == {"y": 1}
    assert sweep(once, {"x": [1]}, path=kept, retry_failed=False).rows[0].values == {"y": 1}, "the later row counts"


def other(x):
    return {"y": x}


def pair(x, z=0, seed=0):
    return {"y": x}


@pytest.mark.parametrize(
    ("arguments", "options", "text"),
    [
        ((other, {"x": [1]}), {}, r'has function ".*\.pair", and this sweep function ".*\.other"'),
        ((functools.partial(pair, z=2), {"x": [1]}), {}, r"has function .*this sweep function .*'z': 2"),
        ((pair, {"x": [1], "z": [2]}), {}, r'has parameters \["x"\], and this sweep parameters \["x", "z"\]'),
        ((pair, {"x": [1]}, 2), {}, "has seeded false, and this sweep seeded true"),
        ((pair, {"x": [1]}), {"until": 2.0}, "has runs null, and this sweep runs"),
    ],
)
def test_the_file_of_another_sweep_is_refused_by_name_and_left_alone(arguments, options, text, kept):
    sweep(pair, {"x": [1]}, path=kept)
    before = kept.read_bytes()
    with pytest.raises(InputError, match=rf"^path must be a file of the same sweep, or none yet; .*kept.jsonl {text}"):
        sweep(*arguments, path=kept, **options)
    assert kept.read_bytes() == before


def test_scenes_that_are_run_otherwise_are_another_sweep(kept):
    scene = mpsim.Scene.random(count=5, packing=0.1, radius=0.5, seed=1)
    settings = mpsim.Settings(method="naive", passes=2)
    how = {"grid": {"dt": [0.5]}, "until": 1.0, "settings": settings, "path": kept}
    sweep(scene, **how)
    sweep(scene, **how | {"settings": mpsim.Settings(method="naive", passes=2, workers=1, dt=3)})
    others = ({"until": 2.0}, {"settings": None}, {"measures": ["overlap"]}, {"function": scene.redrawn(3)})
    for other in others:
        with pytest.raises(InputError, match="must be a file of the same sweep"):
            sweep(**{"function": scene} | how | other)


def test_a_function_whose_source_has_changed_is_warned_of(kept, tmp_path):
    script = tmp_path / "changing.py"
    program = f"import mpsim, changing; mpsim.sweep(changing.f, {{'x': [1]}}, path={str(kept)!r})"
    script.write_text("def f(x):\n    return {'y': x}\n")
    assert_clean(run_script(f"import sys; sys.path.insert(0, {str(tmp_path)!r}); {program}", warm=True))
    script.write_text("def f(x):\n    return {'y': x + 1}\n")
    changed = run_script(f"import sys; sys.path.insert(0, {str(tmp_path)!r}); {program}", warm=True)
    assert "SweepWarning: the source of changing.f has changed since" in changed.err


@pytest.mark.parametrize("cut", [1, 150])
def test_a_last_line_that_was_cut_off_is_dropped_with_a_warning(cut, noting, kept, tmp_path):
    sweep(noting, {"x": [1, 2, 3]}, path=kept)
    whole = kept.read_bytes()
    calls_in(tmp_path)
    kept.write_bytes(whole[:-cut])
    with pytest.warns(SweepWarning, match=r"the last line of .*kept.jsonl was cut off") as warned:
        table = sweep(noting, {"x": [1, 2, 3]}, path=kept)
    assert warned[0].filename == __file__
    assert [row.values["y"] for row in table.rows] == [2, 4, 6]
    assert len(calls_in(tmp_path)) == 1
    sweep(noting, {"x": [1, 2, 3]}, path=kept)
    assert kept.read_bytes().count(b"\n") == 4


@pytest.mark.parametrize("text", ["notes\n", '{"format": "mpsim sweep 2"}\n', "\n"])
def test_a_file_that_is_no_sweep_is_refused_and_left_alone(text, kept):
    kept.write_text(text)
    with pytest.raises(
        InputError, match=r"^path must be a file of (an earlier|the same) sweep, or none yet; .*kept.jsonl "
    ):
        sweep(double, {"x": [1]}, path=kept)
    assert kept.read_text() == text


@pytest.mark.parametrize("line", ["{", "{}", '{"point": {}, "run": "a"}', "\x00\x00"])
def test_damage_in_the_middle_is_refused_with_its_line(line, kept):
    sweep(double, {"x": [1, 2]}, path=kept)
    head, _, second = kept.read_text().splitlines()
    kept.write_text(f"{head}\n{line}\n{second}\n")
    with pytest.raises(InputError, match=r"cannot be read as one \(line 2"):
        sweep(double, {"x": [1, 2]}, path=kept)


def test_paths_that_are_no_files_are_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for name in ("pipe", ""):
        with pytest.raises(InputError, match=r"^path must be a file"):
            sweep(double, {"x": [1]}, path=tmp_path / name)


def test_two_sweeps_on_one_file_at_once_are_refused_in_one_process_and_in_two(kept):
    def inner(x):
        with pytest.raises(
            InputError, match=r"^path must be a file that no other sweep has; .*is being written"
        ) as found:
            sweep(double, {"x": [1]}, path=kept)
        done = run_script(
            f"import mpsim; from support.swept import double; mpsim.sweep(double, {{'x': [1]}}, path={str(kept)!r})",
            warm=True,
        )
        assert "InputError: path must be a file that no other sweep has" in done.err
        return {"text": str(found.value)}

    (row,) = sweep(inner, {"x": [1]}, path=kept).rows
    assert row.failure is None, row.traceback
    sweep(inner, {"x": [1]}, path=kept)


def test_a_disk_without_room_is_an_error_and_leaves_whole_lines(kept, monkeypatch):
    sweep(double, {"x": [1]}, path=kept)
    before, write = kept.read_bytes(), os.write

    def full(descriptor, content):
        if content.startswith(b'{"point"'):
            return write(descriptor, content[:30])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "write", full)
    with pytest.raises(
        OutputError, match=r"^the file of a sweep must have room on its disk; .*No space left on device"
    ):
        sweep(double, {"x": [1, 2]}, path=kept)
    monkeypatch.undo()
    assert kept.read_bytes() == before


INTERRUPTED = """
import functools, sys, threading
from concurrent.futures import ThreadPoolExecutor
import mpsim
from support.swept import gated

print("ready")
executor = {executor}
try:
    mpsim.sweep(functools.partial(gated, folder={folder!r}), {{"x": list(range(6))}}, executor=executor, path={kept!r},
                progress=lambda done, of, what: print(done))
except (KeyboardInterrupt, SystemExit) as error:
    print(type(error).__name__)
"""


LONG_RUNS = """
import mpsim
scene = mpsim.Scene.random(count=200, packing=0.3, radius=0.5, seed=1)
with mpsim.Simulation(scene, mpsim.Settings(method="grid")) as sim:
    sim.run(frames=1, measures=["overlap"])  # which compiles
print("ready")
try:
    mpsim.sweep(scene, {{"dt": [0.01, 0.02, 0.03], "frames": [10**9], "method": ["grid"]}}, path={kept!r},
                measures=["overlap"], progress=lambda done, of, what: print(done))
except KeyboardInterrupt:
    print("interrupted")
"""


def test_an_interrupt_ends_runs_of_scenes_in_the_threads_of_a_sweep_soon(kept):
    with Script(LONG_RUNS.format(kept=str(kept)), warm=True) as script:
        assert [script.line() for _ in range(2)] == ["ready", "0"]
        time.sleep(0.5)
        script.send(signal.SIGINT)
        assert script.line(10) == "interrupted"
        assert_clean(script.finish())
    assert kept.read_text().count("\n") == 1, "the head alone"


def begun(folder, number):
    path = folder / "calls"
    return wait_until(lambda: path.exists() and len(path.read_text().split()) >= number, 20)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_cancels_what_has_not_begun_and_keeps_what_has(number, kept, tmp_path):
    for x in (0, 3, 4, 5):
        (tmp_path / f"go{x}").touch()
    text = INTERRUPTED.format(executor="ThreadPoolExecutor(1)", folder=str(tmp_path), kept=str(kept))
    with Script(text + "executor.shutdown()\n", warm=True) as script:
        assert [script.line() for _ in range(3)] == ["ready", "0", "1"]
        assert begun(tmp_path, 2)
        script.send(number)
        assert script.line() == ("KeyboardInterrupt" if number == signal.SIGINT else "SystemExit")
        (tmp_path / "go1").touch()
        assert_clean(script.finish())
    assert calls_in(tmp_path) == [0, 1]
    (tmp_path / "go2").touch()
    rows = kept.read_text().splitlines()
    assert [json.loads(row)["point"] for row in rows[1:]] == [{"x": 0}]


RELEASING = """
import os, pathlib, signal
def pressed(*_):
    pathlib.Path({go!r}).touch()
    raise KeyboardInterrupt

os.environ["PYTHON_CPU_COUNT"] = "1"
signal.signal(signal.SIGINT, pressed)
"""
"""Ctrl-C, upon which the run that goes on may end."""


def test_of_its_own_threads_a_sweep_waits_and_keeps_what_they_finish(kept, tmp_path):
    (tmp_path / "go0").touch()
    text = INTERRUPTED.format(executor="None", folder=str(tmp_path), kept=str(kept))
    with Script(RELEASING.format(go=str(tmp_path / "go1")) + text, warm=True) as script:
        assert [script.line() for _ in range(3)] == ["ready", "0", "1"]
        assert begun(tmp_path, 2)
        script.send(signal.SIGINT)
        assert script.line() == "KeyboardInterrupt"
        assert_clean(script.finish())
    assert calls_in(tmp_path) == [0, 1]
    assert [json.loads(row)["point"] for row in kept.read_text().splitlines()[1:]] == [{"x": 0}, {"x": 1}]
