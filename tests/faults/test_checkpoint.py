"""Whatever happens to the writer of a checkpoint: a whole one is found, and nothing else is lost."""

import json
import os
import resource
import subprocess
from pathlib import Path

import numpy as np
import pytest
from support.checkpoints import WORDS, frame_in, saved, two
from support.processes import assert_clean, run_script
from support.scenes import lattice, simulate, zoo
from support.selection import long_but

import mpsim
from mpsim.engine import checkpoint

KILLED = """
import json, os, resource, shutil, signal, sys, tempfile, warnings
from pathlib import Path
import mpsim
from mpsim.engine import checkpoint
from support.checkpoints import frame_in
from support.scenes import simulate, zoo

FILES = {{"checkpoint.py", "archive.py", "atomic.py", "archive_layout.py", "joint_archive.py", "joint_file.py"}}
STEP, DEEP, NAIVE = {step}, {deep}, {naive}
base, folder = Path(tempfile.mkdtemp()), Path(tempfile.mkdtemp())
sim = simulate(zoo("", count=5), method="grid")
for _ in range(2):
    sim.run(frames=1)
    sim.save(base / "run")
sim.run(frames=1)

def killing_at_line(limit):
    # Every line of our own files; DEEP: of all that they call as well.
    lines = 0
    def trace(frame, event, argument):
        nonlocal lines
        if not DEEP and Path(frame.f_code.co_filename).name not in FILES:
            return None
        lines += event == "line"
        if lines == limit:
            os.kill(os.getpid(), signal.SIGKILL)
        return trace
    sys.settrace(trace)

def killing_at_byte(limit):
    signal.signal(signal.SIGXFSZ, signal.SIG_DFL)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

run = {{"frame": sim.frame, "emission": sim._coordinator.emission.progress}}
parts = sim.scene, sim.settings, run, sim._solver.snapshot()  # a fork may not use the simulation itself
whole = checkpoint.write(base / "written", *parts).read_bytes()
(base / "written").unlink()

def write():
    if not NAIVE:
        checkpoint.write(folder / "run", *parts)
        return
    with (folder / "run").open("wb", buffering=0) as file:
        for first in range(0, len(whole), 100):
            file.write(whole[first : first + 100])

def attempt(kill, limit):
    # The frame that is found after a kill, 0 for none; or None where the writer came to its end.
    shutil.rmtree(folder)
    shutil.copytree(base, folder)
    if NAIVE:
        (folder / "run.previous").unlink()
    pid = os.fork()
    if pid == 0:
        try:
            kill(limit)
            write()
        finally:
            sys.settrace(None)
            os._exit(0)
    _, status = os.waitpid(pid, 0)
    try:
        found = frame_in(folder / "run")
    except mpsim.CheckpointError:
        found = 0
    leftovers = len(list(folder.glob(".*.tmp")))
    return (found if os.WIFSIGNALED(status) else None), found, leftovers

warnings.simplefilter("error")
warnings.simplefilter("ignore", DeprecationWarning)  # 3.12: fork in a process with threads
results = {{}}
for name, kill in (("line", killing_at_line), ("byte", killing_at_byte)):
    limit, frames, littered = 1, [], 0
    while True:
        killed, found, leftovers = attempt(kill, limit)
        if killed is None:
            break
        frames.append(killed)
        littered += leftovers
        limit += STEP[name]
    results[name] = [frames, found, littered]
with simulate(zoo("", count=5), method="grid") as again:  # what the killed have left is cleared by the next writer
    again.save(folder / "run")
results["left"] = [path.name for path in folder.iterdir() if path.name.endswith(".tmp")]
print(json.dumps(results))
"""


def kill_writers(steps, deep=False, naive=False, bound=170):
    """Frames found after each kill, by what the killer counts."""
    outcome = run_script(KILLED.format(step=steps, deep=deep, naive=naive), bound=bound, warm=True)
    assert_clean(outcome)
    return json.loads(outcome.out)


def assert_always_whole(results, figures, what):
    for name in ("line", "byte"):
        frames, end, littered = results[name]
        assert len(frames) > 10, f"only {len(frames)} kills by {name}: that tests little"
        assert set(frames) <= {2, 3}, f"frames found after kills by {name}: {frames}"
        assert end == 3
        assert littered > 0, "no kill came between the beginning of the file and its renaming"
        figures.note(
            "R4",
            "grid",
            f"kill -9 {what[name]} of a write",
            "a complete checkpoint, no warning",
            f"{len(frames)} of {len(frames)}",
        )
    assert set(results["line"][0]) == {2, 3}, "no kill came after the renaming"
    assert results["left"] == []


@pytest.mark.slow
def test_a_writer_killed_at_any_line_or_byte_leaves_a_whole_checkpoint(figures):
    what = {"line": "at every fourth line of our own code", "byte": "after every 240 bytes"}
    assert_always_whole(kill_writers({"line": 4, "byte": 240}), figures, what)


@pytest.mark.long
@pytest.mark.timeout(1500)
def test_a_writer_killed_at_any_line_of_all_python_leaves_a_whole_checkpoint(figures):
    what = {"line": "at every 7th line of Python in it", "byte": "after every byte"}
    assert_always_whole(kill_writers({"line": 7, "byte": 1}, deep=True, bound=1400), figures, what)


def test_a_writer_without_these_precautions_leaves_none(figures):
    """The control: the same killer, and a writer that writes in place."""
    frames, end, _ = kill_writers({"line": 1000, "byte": 500}, naive=True)["byte"]
    assert end == 3
    assert set(frames) == {0}
    figures.note(
        "R4",
        "grid",
        "control: the same kills, a writer that writes in place",
        "no checkpoint left",
        f"{len(frames)} of {len(frames)}",
    )


# --- no room, no right

FULL = """
import json, os
from pathlib import Path
import mpsim
from support.checkpoints import frame_in
from support.scenes import lattice, simulate

os.chdir("/mnt")
with simulate(lattice(20, 20), method="grid") as sim:
    sim.run(frames=1)
    sim.save("run")
    Path("ballast").write_bytes(bytes({ballast}))
    try:
        while True:
            sim.run(frames=1)
            sim.save("run")
            assert sim.frame < 5, "the disk is never full, which tests nothing"
    except mpsim.errors.OutputError as error:
        print(error)
    print(frame_in("run") >= sim.frame - 1, sorted(os.listdir()))
    os.unlink("ballast")
    sim.run(frames=1)
    sim.save("run")
    print(frame_in("run") == sim.frame)
"""


@pytest.mark.slow
@pytest.mark.parametrize("free", long_but([500, 9_000, 30_000], 500, 30_000))
def test_a_full_disk_is_an_error_and_the_checkpoint_of_before_is_kept(free, figures):
    size = 128 * 1024
    prefix = ["unshare", "--mount", "sh", "-c", f'mount -t tmpfs -o size={size} tmpfs /mnt && exec "$@"', "sh"]
    try:
        subprocess.run([*prefix, "true"], check=True, capture_output=True, timeout=20)
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"no private mount can be made here: {error}")
    outcome = run_script(FULL.format(ballast=size - 4096 * (9 + free // 4096)), prefix=prefix)
    assert_clean(outcome)
    error, kept, later = outcome.out.splitlines()
    assert "No space left on device" in error
    assert "'/mnt/run'" in error
    assert kept.startswith("True ['ballast', 'run'"), kept
    assert ".tmp" not in kept
    assert later == "True"
    figures.note(
        "R5",
        "grid",
        f"a disk of 128 KiB of which {9 + free // 4096} pages are free",
        "an error; the previous one is kept",
        "as expected",
    )


@pytest.mark.slow
@pytest.mark.parametrize("limit", range(0, 5000, 500))
def test_a_file_that_cannot_grow_is_an_error_at_any_size(limit, tmp_path):
    path = two(tmp_path / "run")
    before = path.read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    with simulate(zoo(WORDS, count=5), method="grid") as sim:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limits[1]))
        try:
            with pytest.raises(mpsim.errors.OutputError, match="What was there before is untouched"):
                sim.save(path)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        assert sim.run(frames=1).frames == 1
    assert path.read_bytes() == before
    assert sorted(each.name for each in tmp_path.iterdir()) == ["run", "run.previous"]


@pytest.mark.slow
@pytest.mark.parametrize("call", ["fsync", "link", "rename"])
def test_an_error_of_the_system_at_any_call_leaves_what_was_there(call, tmp_path, monkeypatch):
    path = two(tmp_path / "run")

    def fail(*arguments, **options):
        raise OSError(28, "No space left on device")

    with simulate(zoo(WORDS, count=5), method="grid") as sim:
        monkeypatch.setattr(*((Path, "replace") if call == "rename" else (os, call)), fail)
        with pytest.raises(mpsim.errors.OutputError, match="No space left on device"):
            sim.save(path)
        monkeypatch.undo()
    assert frame_in(path) == 3
    assert sorted(each.name for each in tmp_path.iterdir()) == ["run", "run.previous"]


@pytest.mark.slow
def test_no_checkpoint_is_written_that_could_not_be_read_again(tmp_path, monkeypatch):
    """A million obstacles and emitters may be in a scene, and not all of them in a header."""
    path = saved(tmp_path / "run", zoo("obstacles", count=5))
    before = path.read_bytes()
    monkeypatch.setattr(checkpoint, "MOST_HEADER", 200)
    with pytest.raises(mpsim.errors.OutputError, match="must take at most 200 bytes of a checkpoint's header"):
        saved(path, zoo("obstacles", count=6))
    assert [each.name for each in tmp_path.iterdir()] == ["run"]
    assert path.read_bytes() == before


@pytest.mark.slow
def test_a_file_system_without_links_gets_a_copy(tmp_path, monkeypatch):
    def refuse(*arguments, **options):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "link", refuse)
    path = two(tmp_path / "run")
    assert (frame_in(path), frame_in(tmp_path / "run.previous")) == (3, 2)


# --- places


def test_a_checkpoint_replaces_no_file_of_another_kind(tmp_path):
    path = tmp_path / "thesis.tex"
    for text in ("a year of work", "PK\x03\x04" + 60 * "x"):
        path.write_text(text)
        with simulate(lattice(4, 4), method="grid") as sim:
            for deed in (lambda sim=sim: sim.save(path), lambda sim=sim: sim.run(frames=1, checkpoint=path)):
                with pytest.raises(
                    mpsim.errors.OutputError,
                    match=r"may replace only a checkpoint; .*thesis\.tex.* Choose another name",
                ):
                    deed()
            assert sim.frame == 0, "the run must be refused before it begins"
        assert path.read_text() == text
    np.savez(tmp_path / "mine.npz", header=np.zeros(3))
    with simulate(lattice(4, 4), method="grid") as sim, pytest.raises(mpsim.errors.OutputError, match="another kind"):
        sim.save(tmp_path / "mine.npz")


def test_the_name_of_the_one_before_is_protected_too(tmp_path):
    (tmp_path / "run.previous").write_text("mine")
    with simulate(lattice(4, 4), method="grid") as sim, pytest.raises(mpsim.errors.OutputError, match=r"run\.previous"):
        sim.save(tmp_path / "run")
    assert (tmp_path / "run.previous").read_text() == "mine"


@pytest.mark.slow
@pytest.mark.parametrize("damage", ["", "PK\x03\x04"])
def test_an_empty_or_damaged_checkpoint_may_be_replaced_and_pushes_out_none_that_is_whole(damage, tmp_path):
    path = two(tmp_path / "run")
    path.write_bytes(path.read_bytes()[:200] if damage else b"")
    saved(path, frames=5)
    assert (frame_in(path), frame_in(tmp_path / "run.previous")) == (5, 2)


def test_a_folder_or_a_pipe_is_no_place_for_a_checkpoint(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    with simulate(lattice(4, 4), method="grid") as sim:
        for name in ("pipe", "folder"):
            with pytest.raises(mpsim.errors.OutputError, match=f"must be a file; .*{name}"):
                sim.save(tmp_path / name)
            with pytest.raises(mpsim.CheckpointError, match="must be a file"):
                mpsim.Simulation.resume(tmp_path / name)
        with pytest.raises(mpsim.errors.OutputError, match="needs a folder that exists"):
            sim.run(frames=1, checkpoint=tmp_path / "nowhere" / "run")
        assert sim.frame == 0
        for nonsense in (None, 3, "", "a\0b"):
            with pytest.raises(mpsim.InputError, match="must be a file name"):
                sim.save(nonsense)


def test_a_folder_without_the_right_to_write_is_an_error_with_its_name(tmp_path):
    """/proc refuses new files even to the superuser."""
    with simulate(lattice(4, 4), method="grid") as sim, pytest.raises(mpsim.errors.OutputError, match="'/proc/run'"):
        sim.save("/proc/run")


def test_a_relative_path_means_where_the_run_began(tmp_path, monkeypatch):
    (tmp_path / "other").mkdir()
    monkeypatch.chdir(tmp_path)
    with simulate(lattice(4, 4), method="grid") as sim:
        sim.run(frames=9, checkpoint="run", checkpoint_every=3, progress=lambda done, of: os.chdir(tmp_path / "other"))
    assert sorted(each.name for each in tmp_path.iterdir()) == ["other", "run", "run.previous"]
    monkeypatch.chdir(tmp_path)
    with mpsim.Simulation.resume("run") as sim:
        assert sim.frame == 9


def test_a_link_leads_to_the_file_that_is_replaced(tmp_path):
    (tmp_path / "disk").mkdir()
    (tmp_path / "run").symlink_to(tmp_path / "disk" / "run")
    for frames in (2, 3):
        saved(tmp_path / "run", frames=frames)
    assert (tmp_path / "run").is_symlink()
    assert sorted(each.name for each in (tmp_path / "disk").iterdir()) == ["run", "run.previous"]
    assert frame_in(tmp_path / "run") == 3


def test_a_run_that_has_nothing_to_do_writes_its_checkpoint_all_the_same(tmp_path):
    with simulate(lattice(4, 4), method="grid") as sim:
        sim.run(frames=0, checkpoint=tmp_path / "run")
    assert frame_in(tmp_path / "run") == 0
