"""`mpsim run`, `resume`, `plot`, `animate`: what a folder of a run holds, and how a run that was stopped goes on."""

import csv
import json
import re
import shutil

import numpy as np
import pytest
from PIL import Image
from support.commands import SHORT, library_digest, mpsim_command

import mpsim

pytestmark = pytest.mark.compiled  # a gas by default settings


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The folder of a run of 30 frames."""
    out = tmp_path_factory.mktemp("runs") / "whole"
    result = mpsim_command("run", "gas", *SHORT, "--out", out, "--measure", "pressure")
    assert (result.exit_code, result.stderr) == (0, "")
    assert f"written to {out}/: trajectory.xyz, measures.csv, timings.csv, final.npz, " in result.stdout
    assert "writing" in times_in(result.stdout)
    return out


def times_in(text):
    """Where the time went, in words and seconds of the summary, which add up."""
    (times,) = re.findall(r"discs; ([\d.]+) s: (.+)\n", text)
    parts = {name: float(seconds) for name, seconds in re.findall(r"(\w+) ([\d.]+)", times[1])}
    rounding = 0.0004 + sum(0.05 if each >= 1 else 0.05 * each for each in (float(times[0]), *parts.values()))
    assert sum(parts.values()) == pytest.approx(float(times[0]), abs=rounding)
    return parts


def record_of(out):
    return json.loads((out / "run.json").read_text())


def table_of(out):
    with (out / "measures.csv").open() as file:
        return list(csv.DictReader(file))


def stopped_at(frame, monkeypatch, *words):
    """The result of a command to which Ctrl-C comes when so many frames are done."""
    run = mpsim.Simulation.run

    def pressed(sim, *given, progress=None, **named):
        def show(done, of):
            if done >= frame:
                raise KeyboardInterrupt

        return run(sim, *given, progress=show, **named)

    with monkeypatch.context() as patch:
        patch.setattr(mpsim.Simulation, "run", pressed)
        return mpsim_command(*words)


# --- run


def test_run_tells_what_it_did_and_writes_nothing_unasked(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = mpsim_command("run", "gas", "--method", "grid", "--frames", 30, "--measure", "kinetic_energy")
    assert result.exit_code == 0
    lines = result.stdout.splitlines()
    assert {"other"} <= times_in(result.stdout).keys() <= {"compiling", "simulating", "other"}  # told from 0.1 ms on
    assert lines[0].startswith("30 frames by grid, median ")
    assert lines[1].startswith("frame 30, time 0.3, 100 discs; ")
    assert lines[2:4] == ["kinetic_energy: 100(0)", f"digest {library_digest(30)}"]
    assert not list(tmp_path.iterdir())
    words = ("--dt", 0.02, "--passes", 2, "--measure", "temperature", "--json")
    found = json.loads(mpsim_command("run", "gas", *SHORT[:4], *words).stdout)
    assert (found["settings"]["dt"], found["settings"]["contact"]) == (0.02, "impact"), "those of the scene but for two"
    assert found["digest"] == library_digest(30, dt=0.02, passes=2)
    assert (found["from_frame"], found["to_frame"], found["method"]) == (0, 30, "grid")


@pytest.mark.parametrize(("until", "frames"), [(0.07, 7), (0.301, 31), (1e-9, 1)])
def test_until_is_the_first_frame_that_reaches_it(until, frames):
    words = ("--method", "naive", "--until", until, "--json", "--quiet")
    assert json.loads(mpsim_command("run", "cradle", *words).stdout)["to_frame"] == frames
    with mpsim.Simulation(mpsim.Scene.load("cradle"), mpsim.Settings(method="naive", dt=0.01)) as sim:
        sim.run(until=until)
        assert sim.frame == frames, "as the library does, whatever rounding says of 0.07 / 0.01"
        assert sim.run(until=sim.time).frames == 0


def test_measures_are_taken_from_a_start_on_also_where_the_run_is_continued(whole, tmp_path, monkeypatch):
    measured, out = ("--measure", "pressure", "--start", 0.2), tmp_path / "run"
    with mpsim.Simulation(mpsim.Scene.load("gas"), mpsim.Settings(method="grid")) as sim:
        expected = sim.run(frames=30, measures="pressure", start=0.2).measures["pressure"].value
    told = json.loads(mpsim_command("run", "gas", *SHORT[:4], *measured, "--json").stdout)
    assert told["measures"]["pressure"]["value"] == expected
    stopped_at(3, monkeypatch, "run", "gas", *SHORT, *measured, "--out", out)
    assert mpsim_command("resume", out, "--frames", 2, "--quiet").exit_code == 0
    assert f"digest {record_of(whole)['digest']}\n" in mpsim_command("resume", out, "--quiet").stdout
    parts = record_of(out)["parts"]
    assert parts[-2]["measures"] == {}, "a part that ends before the start"
    assert parts[-1]["measures"]["pressure"]["value"] == expected
    assert record_of(whole)["parts"][0]["measures"]["pressure"]["value"] != expected, "the control"


@pytest.mark.parametrize(
    ("frames", "says"),
    [
        (3, r"\S+ \(too few samples for an error\)"),
        (30, r"\S+ \(error at (least|most) \S+, not settled: run longer or start later\)"),
    ],
)
def test_a_measure_of_too_few_samples_or_that_is_not_settled_says_so(frames, says):
    done = mpsim_command("run", "gas", "--frames", frames, "--method", "grid", "--measure", "pressure", "--quiet")
    assert re.search(rf"(?m)^pressure: {says}$", done.stdout), done.stdout
    assert "nan" not in done.stdout


def test_a_folder_holds_all_of_a_run(whole):
    record = record_of(whole)
    assert record["scene_digest"] == mpsim.Scene.load("gas").digest()
    assert record["settings"]["method"] == "grid"
    assert (record["status"], record["frame"], record["digest"]) == ("done", 30, library_digest(30))
    assert record["versions"].keys() == {"python", "mpsim", "numpy", "numba"}
    pressure = record["parts"][0]["measures"]["pressure"]
    assert pressure["value"] > 0
    assert pressure["settled"] is False
    assert mpsim.State(**np.load(whole / "final.npz")).digest() == record["digest"]
    frames = [0, 4, 8, 12, 16, 20, 24, 28]
    assert [frame.frame for frame in mpsim.Trajectory(whole / "trajectory.xyz")] == frames
    with (whole / "timings.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["frame"]) for row in rows] == list(range(1, 31))
    assert all(float(row["seconds"]) > 0 for row in rows)
    table = table_of(whole)
    assert [int(row["frame"]) for row in table] == frames
    assert [float(row["kinetic_energy"]) for row in table] == pytest.approx([100.0] * 8)
    assert {row["discs"] for row in table} == {"100"}
    rate = np.array([float(row["collision_rate"]) for row in table[1:]]) * 100 * 4 * 0.01 / 2
    assert rate == pytest.approx(rate.round()), "a whole number of collisions in each row"
    assert 0 < rate.sum() <= record["parts"][0]["collisions"]
    with Image.open(whole / "final.png") as picture:
        assert min(picture.size) > 300


def test_a_folder_is_not_overwritten_unasked_and_one_of_something_else_never(tmp_path):
    out = tmp_path / "run"
    assert mpsim_command("run", "gas", *SHORT, "--out", out, "--format", "gsd").exit_code == 0
    assert len(mpsim.Trajectory(out / "trajectory.gsd")) == 8
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    refused = mpsim_command("run", "gas", *SHORT, "--out", out)
    assert (refused.exit_code, refused.stderr) == (
        2,
        f"Error: --out already holds a run: '{out}' is not overwritten. Give another name, --force to replace it, or "
        f"continue it: mpsim resume {out}\n",
    )
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before
    kept = [out / name for name in ("final.tex", "timings_of_all.csv", "checkpoint.mpsim.mine")]
    for path in kept:
        path.write_text("mine")
    (out / "timings-2.csv").touch()
    assert mpsim_command("run", "gas", *SHORT, "--dt", "0.02", "--out", out, "--force").exit_code == 0
    assert [path.read_text() for path in kept] == ["mine"] * 3
    assert not (out / "timings-2.csv").exists()
    assert record_of(out)["settings"]["dt"] == 0.02
    assert mpsim.Trajectory(out / "trajectory.xyz")[1].time == 0.08
    (tmp_path / "thesis.tex").write_text("years")
    (tmp_path / "run.json").write_text('{"format": 1}')  # of another program
    for place, code, rule in (
        (tmp_path, 2, "holds other files, which are not overwritten. Give another name."),
        (tmp_path / "thesis.tex", 2, "--out must be a folder; "),
        (tmp_path / "thesis.tex" / "run", 1, "--out must be a folder that can be written to, with room on its disk"),
    ):
        refused = mpsim_command("run", "gas", *SHORT, "--out", place, "--force")
        assert (refused.exit_code, rule in refused.stderr) == (code, True), refused.stderr
    assert (tmp_path / "thesis.tex").read_text() == "years"


# --- resume


def test_ctrl_c_is_one_line_and_the_run_goes_on_to_the_same_bits(whole, tmp_path, monkeypatch):
    out = tmp_path / "run"
    stopped = stopped_at(3, monkeypatch, "run", "gas", *SHORT, "--out", out, "--measure", "pressure")
    frame = record_of(out)["frame"]
    assert 3 <= frame < 30
    assert (stopped.exit_code, stopped.stdout) == (130, "")
    assert stopped.stderr == f"Interrupted at frame {frame} of 30. Continue with: mpsim resume {out}\n"
    assert record_of(out)["status"] == "interrupted"
    assert not (out / "final.npz").exists()
    assert mpsim_command("plot", out).exit_code == 0, "what there is so far"
    assert mpsim_command("resume", out, "--frames", 2, "--quiet").exit_code == 0
    assert (record_of(out)["status"], record_of(out)["target"]) == ("paused", 30)
    record = json.loads(mpsim_command("resume", out, "--quiet", "--json").stdout)
    assert (record["status"], record["frame"], record["digest"]) == ("done", 30, record_of(whole)["digest"])
    for name in ("trajectory.xyz", "final.npz", "final.png"):
        assert (out / name).read_bytes() == (whole / name).read_bytes(), name
    for here, there in zip(table_of(out), table_of(whole), strict=True):
        del here["collision_rate"], there["collision_rate"]  # which after a resume is of fewer frames
        assert here == there
    stopped = stopped_at(1, monkeypatch, "run", "gas", "--frames", 5000, "--method", "grid")
    assert (stopped.exit_code, stopped.stdout) == (130, "")
    assert stopped.stderr.endswith(" of 5000. Nothing is kept without --out FOLDER.\n")


def test_a_run_that_has_ended_goes_on_where_it_is_told_to_and_by_another_method_that_has_its_bits(tmp_path):
    out = tmp_path / "run"
    mpsim_command("run", "gas", *SHORT, "--out", out)
    for words, rule in (
        ((), "is at frame 30, time 0.3; it was to go to frame 30. Say how far it is to continue: --frames or"),
        (("--until", 0.1), "is at frame 30, time 0.3; --until 0.1 is frame 10. Say how far it is to continue"),
        (("--frames", 5, "--method", "naive"), "'naive' is not one of 'grid', 'parallel'"),
    ):
        refused = mpsim_command("resume", out, *words)
        assert (refused.exit_code, rule in refused.stderr) == (2, True), refused.stderr
    assert mpsim_command("resume", out, "--frames", 10, "--quiet").exit_code == 0
    last = mpsim_command("resume", out, "--until", 0.5, "--method", "parallel", "--workers", 1, "--quiet")
    assert f"digest {library_digest(50)}\n" in last.stdout
    assert "13 frames in the trajectory" in last.stdout
    record = record_of(out)
    assert (record["settings"]["method"], record["parts"][-1]["method"]) == ("parallel", "parallel")
    for name, frames in {"timings": range(1, 31), "timings-2": range(31, 41), "timings-3": range(41, 51)}.items():
        lines = (out / f"{name}.csv").read_text().splitlines()
        assert [int(line.split(",")[0]) for line in lines[1:]] == list(frames)
    mpsim_command("run", "cradle", "--method", "naive", *SHORT[2:], "--out", out, "--force")
    refused = mpsim_command("resume", out, "--frames", 5, "--method", "grid")
    assert refused.exit_code == 2
    assert "method must be that of the checkpoint, 'naive', or both must be among 'grid', 'p" in refused.stderr


def test_a_run_that_fails_says_so_in_its_record_and_goes_on(tmp_path, monkeypatch):
    def fail(sim, *given, **named):
        if named.get("observe"):
            raise mpsim.errors.WorkerStalledError("worker 1 was not ready")
        return run(sim, *given, **named)

    run = mpsim.Simulation.run
    with monkeypatch.context() as patch:
        patch.setattr(mpsim.Simulation, "run", fail)
        result = mpsim_command("run", "gas", *SHORT, "--out", tmp_path / "run")
    assert (result.exit_code, result.stderr) == (1, "Error: worker 1 was not ready\n")
    assert record_of(tmp_path / "run")["status"] == "ended early"
    assert f"digest {library_digest(30)}\n" in mpsim_command("resume", tmp_path / "run", "--quiet").stdout


def test_only_one_process_writes_to_a_folder(whole, tmp_path, monkeypatch):
    """While a run goes on, others are refused, and may look."""
    out, run, refused = shutil.copytree(whole, tmp_path / "run"), mpsim.Simulation.run, []

    def meanwhile(sim, *given, **named):
        if named.get("observe") and not refused:
            for words in (("resume", out, "--frames", 5), ("run", "gas", *SHORT, "--out", out, "--force")):
                refused.append(mpsim_command(*words))
            assert mpsim_command("plot", out).exit_code == 0, "looking is free"
        return run(sim, *given, **named)

    with monkeypatch.context() as patch:
        patch.setattr(mpsim.Simulation, "run", meanwhile)
        assert mpsim_command("resume", out, "--frames", 5, "--quiet").exit_code == 0
    for result in refused:
        assert result.exit_code == 1
        assert (
            f"'{out}' must be written by one command at a time; got a folder that another one is writing to"
            in result.stderr
        )
    assert len(refused) == 2
    assert record_of(out)["digest"] == library_digest(35)


@pytest.mark.parametrize("damage", [b"\0" * 5000 + b"\n", b"1,2\n", b"\xff\xfe,\n"])
def test_a_damaged_table_is_one_short_error(damage, whole):
    table = whole / "measures.csv"
    before = table.read_bytes()
    table.write_bytes(before + damage)
    try:
        for command in (("resume", whole, "--frames", 5, "--quiet"), ("plot", whole)):
            refused = mpsim_command(*command)
            assert refused.exit_code == 2
            assert f"line 10 of '{table}' must be a row of 7 numbers that a run has written" in refused.stderr
            assert len(refused.stderr) < 700
    finally:
        table.write_bytes(before)


@pytest.mark.parametrize("command", ["resume", "plot"])
def test_a_folder_that_is_no_run_is_refused(command, tmp_path):
    result = mpsim_command(command, tmp_path)
    assert result.exit_code == 2
    assert "Error: the folder of a run must hold run.json; " in result.stderr
    assert "Give a folder that `mpsim run --out` has made." in result.stderr
    for text, rule in (
        ('{"format": 99}', "it is of format 99, of a newer version. Use a newer mpsim."),
        ('{"format": 0}', "it is of format 0, from a development version. Run the scene again."),
        (
            '{"format": 1, "scene": "gas", "every": 1, "trajectory": "a", "parts": [], "settings": {}}',
            "run.json must hold measures, status, target; that in ",
        ),
    ):
        (tmp_path / "run.json").write_text(text)
        assert rule in mpsim_command(command, tmp_path).stderr


# --- plot, animate


def test_plot_draws_what_a_run_recorded(whole, tmp_path):
    picture = whole / "plot.png"
    assert mpsim_command("plot", whole).stdout == f"written: {picture}\n"
    with Image.open(picture) as found:
        assert found.size == (1200, 768)
    picture.unlink()
    other = tmp_path / "other.PDF"
    assert mpsim_command("plot", whole, "-o", other).stdout == f"written: {other}\n"
    assert other.read_bytes().startswith(b"%PDF")
    for name, code, rule in (
        ("other.PDF", 2, f"'{other}' exists already, and is not overwritten. Give another name, or --force."),
        ("none/a.png", 1, "a picture must be a file that can be written, such as a .png; got "),
        *((name, 2, f"'{tmp_path}/{name}'. Use a.png, or a.pdf for print.") for name in ("a.xls", "a")),
    ):
        refused = mpsim_command("plot", whole, "--out", tmp_path / name)
        assert (refused.exit_code, rule in refused.stderr) == (code, True), refused.stderr
    assert [each.name for each in tmp_path.iterdir()] == ["other.PDF"]


def test_animate_writes_an_animation_once(tmp_path, monkeypatch):
    path, few = tmp_path / "a.gif", ("--pixels", 100, "--method", "grid")
    words = ("--frames", 3, "--until", 0.3, "--fps", 5, "--theme", "dark")
    result = mpsim_command("animate", "gas", path, *words, *few, "--quiet")
    assert result.stdout == f"written: {path}, 3 pictures, 0.6 s, {path.stat().st_size / 1000:.0f} kB\n"
    with Image.open(path) as film:
        assert film.n_frames == 3
    before = path.read_bytes()
    refused = mpsim_command("animate", "gas", path, *few)
    assert refused.exit_code == 2
    assert f"'{path}' exists already, and is not overwritten" in refused.stderr
    assert path.read_bytes() == before
    found = mpsim_command(
        "animate", "gas", path, "--frames", 2, "--every", 5, *few, "--scale", "log", "--quiet", "--force"
    )
    assert found.stdout.startswith(f"written: {path}, 2 pictures, 0.08 s, ")
    result = stopped_at(0, monkeypatch, "animate", "gas", tmp_path / "b.gif", "--method", "naive")
    assert (result.exit_code, result.stderr) == (130, f"Interrupted; '{tmp_path}/b.gif' was not written.\n")
    assert [each.name for each in tmp_path.iterdir()] == ["a.gif"]
