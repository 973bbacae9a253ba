"""Whatever writes a file: nobody's file is lost through a link, files are whole at any moment, and rights stay."""

import json
import os
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from matplotlib.figure import Figure
from support.checkpoints import frame_in, saved
from support.processes import assert_clean, run_script
from support.scenes import gas, lattice, simulate

import mpsim
from mpsim.cli.runfolder import RunFolder
from mpsim.core import atomic, table_files
from mpsim.output.drawing import save_figure
from mpsim.output.recorder import Recorder
from mpsim.studies.saved_results import SavedResults

STATE = mpsim.State(np.zeros((3, 2)), np.ones((3, 2)))


def scene_file(path):
    gas(9, 0.1).save(path)


def arrays_of_a_scene(path):
    gas(70, 0.1).save(path.with_name("gas.toml"))


def table_of_times(path):
    with simulate(lattice(3, 3), method="grid") as sim:
        sim.run(frames=2).to_csv(path)


def table_of_measures(path):
    with simulate(lattice(3, 3), method="grid") as sim, Recorder(path, 1, sim) as recorder:
        sim.run(frames=2, observe=recorder)


def kept_results(path):
    kept = SavedResults(path, "gas")
    kept.open("plan", "reference")
    kept.put("a", {"b": 1})
    kept.save()


def picture(path):
    figure = Figure((1, 1))
    figure.add_subplot().plot([1, 2])
    save_figure(figure, path)


def animation(path):
    mpsim.animate(lattice(3, 3), mpsim.Settings(method="grid"), path, 2, pixels=100, progress=False)


def trajectory(path):
    with (
        simulate(lattice(3, 3), method="grid") as sim,
        mpsim.Trajectory.write(path, mode="w") as out,
    ):
        sim.run(frames=2, observe=out)


WRITERS = {
    "scene.toml": scene_file,
    "gas.position.npy": arrays_of_a_scene,
    "state.npz": STATE.save,
    "times.csv": table_of_times,
    "measures.csv": table_of_measures,
    "kept.part": kept_results,
    "trade.csv": lambda path: table_files.written("a,b\n", path, "the table of a trade-off study", ".csv"),
    "run.json": lambda path: RunFolder(path.parent, {"a": 1}).save(),
    "picture.png": picture,
    "animation.gif": animation,
    "frames.xyz": trajectory,
    "frames.gsd": trajectory,
}
"""Everything that writes a file, but for checkpoints, by the name of one."""

PREDICTABLE = (".{name}.{pid}", ".{name}.{pid}.tmp", "{name}.{pid}.tmp", ".{name}.tmp", "{name}.part", "{name}.tmp")
"""Names that drafts have had, here and elsewhere."""


def written(name, path):
    if name.endswith(".gsd"):
        pytest.importorskip("gsd", reason="this format needs the package gsd")
    WRITERS[name](path)


@pytest.fixture
def victim(tmp_path):
    (tmp_path / "home").mkdir()
    path = tmp_path / "home" / "thesis.tex"
    path.write_text("a year of work")
    yield path
    assert path.read_text() == "a year of work", "it was overwritten through a link"


@pytest.mark.parametrize("name", WRITERS)
def test_a_link_at_the_name_of_a_draft_is_not_followed(name, tmp_path, victim):
    for pattern in PREDICTABLE:
        (tmp_path / pattern.format(name=name, pid=os.getpid())).symlink_to(victim)
    before = {path.name for path in tmp_path.iterdir()}
    written(name, tmp_path / name)
    assert (tmp_path / name).stat().st_size > 0
    assert not (tmp_path / name).is_symlink()
    new = {path.name for path in tmp_path.iterdir()} - before
    assert new <= {name, "gas.toml", "gas.position.npy", "gas.velocity.npy"}, f"left behind: {new}"


@pytest.mark.parametrize("name", WRITERS)
def test_a_link_at_the_name_itself_is_refused_and_kept(name, tmp_path, victim):
    (tmp_path / name).symlink_to(victim)
    with pytest.raises((mpsim.MpsimError, OSError), match="symbolic link"):
        written(name, tmp_path / name)
    assert (tmp_path / name).readlink() == victim
    assert {path.name for path in tmp_path.iterdir()} <= {name, "home"}


def test_a_checkpoint_through_a_link_replaces_no_file_of_another_kind_and_keeps_the_one_before(tmp_path, victim):
    """Links to checkpoints are followed: a user puts them on a larger disk like this."""
    (tmp_path / "run").symlink_to(victim)
    with pytest.raises(mpsim.errors.OutputError, match="may replace only a checkpoint"):
        saved(tmp_path / "run")
    other = saved(victim.parent / "other", frames=1)
    (tmp_path / "run").unlink()
    (tmp_path / "run").symlink_to(other)
    (victim.parent / "other.previous").symlink_to(victim)
    with pytest.raises(mpsim.errors.OutputError, match="may replace only a checkpoint"):
        saved(tmp_path / "run")
    (victim.parent / "other.previous").unlink()
    saved(tmp_path / "run", frames=3)
    assert (frame_in(tmp_path / "run"), frame_in(victim.parent / "other.previous")) == (3, 1)


def overwriting(path, content):
    """The control: a draft under a name that can be foreseen, as scene files were written."""
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        draft.write_bytes(content)
        draft.replace(path)
    except OSError:
        draft.unlink(missing_ok=True)
        raise


def test_the_control_overwrites_the_victim(tmp_path):
    victim = tmp_path / "thesis.tex"
    victim.write_text("a year of work")
    (tmp_path / f".scene.toml.{os.getpid()}").symlink_to(victim)
    overwriting(tmp_path / "scene.toml", b"width = 1\n")
    assert victim.read_text() == "width = 1\n"


@pytest.mark.parametrize("kind", ["folder", "pipe", "device"])
def test_what_is_no_regular_file_stays_what_it_is(kind, tmp_path):
    path = tmp_path / "times.csv"
    {"folder": path.mkdir, "pipe": lambda: os.mkfifo(path), "device": lambda: path.symlink_to("/dev/null")}[kind]()
    with pytest.raises(mpsim.errors.OutputError, match=r"directory|not a regular file|symbolic link"):
        table_of_times(path)
    with pytest.raises(OSError, match=r"directory|not a regular file|symbolic link"), atomic.atomic_write(path):
        pass
    assert [each.name for each in tmp_path.iterdir()] == ["times.csv"]
    assert not path.is_file()


# --- many at once


def rounds_that_fail(write, scenes, path, rounds=60):
    """Rounds of four threads that save one file at once in which one raises, or what is there is none of theirs."""
    failed, together = 0, threading.Barrier(len(scenes))

    def one(scene, errors):
        together.wait()
        try:
            write(path, scene)
        except Exception as error:
            errors.append(error)

    for _ in range(rounds):
        errors: list[Exception] = []
        threads = [threading.Thread(target=one, args=(scene, errors)) for scene in scenes]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        try:
            whole = mpsim.Scene.load(path).digest() in {scene.digest() for scene in scenes}
        except mpsim.InputError:
            whole = False
        failed += bool(errors) or not whole
    return failed


def test_four_threads_save_one_scene_file_at_once(tmp_path, monkeypatch, figures):
    monkeypatch.setattr(
        os, "fsync", lambda descriptor: time.sleep(1e-4)
    )  # another thread's turn, without a disk's time
    scenes = [gas(20, 0.1, seed=seed) for seed in range(4)]
    texts = {}
    for scene in scenes:
        scene.save(tmp_path / "source.toml")
        texts[scene] = (tmp_path / "source.toml").read_bytes()
    found = rounds_that_fail(lambda path, scene: scene.save(path), scenes, tmp_path / "gas.toml")
    control = rounds_that_fail(lambda path, scene: overwriting(path, texts[scene]), scenes, tmp_path / "other.toml")
    figures.note(
        "R18", "-", "four threads save one scene file, 60 rounds", "no error, a complete file", f"{60 - found}"
    )
    figures.note("R18", "-", "control: temporary files under one name", "errors", f"{control} rounds fail")
    assert (found, control > 0) == (0, True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["gas.toml", "other.toml", "source.toml"]


PROCESSES = """
import os, time, warnings
from pathlib import Path
from mpsim.core import atomic

warnings.simplefilter("ignore", DeprecationWarning)  # 3.12: fork in a process with threads
os.fsync = lambda descriptor: None  # which tells nothing here
path, children = Path("shared.bin"), []
for number in range(4):
    pid = os.fork()
    if not pid:
        for turn in range(60):
            with atomic.atomic_write(path) as file:
                for _ in range(8):
                    file.write(bytes([number]) * 4096)
                    file.flush()
        os._exit(0)
    children.append(pid)
seen, reads = set(), 0
while children:
    pid, status = os.waitpid(-1, os.WNOHANG)
    if pid:
        assert status == 0, status
        children.remove(pid)
    if path.exists():
        content = path.read_bytes()
        assert len(content) == 8 * 4096 and len(set(content)) == 1, "half a file"
        seen.add(content[0])
        reads += 1
    time.sleep(1e-3)
assert reads > 10
print(os.listdir())
"""


def test_four_processes_save_one_file_at_once_and_a_reader_sees_whole_ones():
    outcome = run_script(PROCESSES, warm=True)
    assert_clean(outcome)
    assert sorted(json.loads(outcome.out.replace("'", '"'))) == ["script.py", "shared.bin"]


# --- the end at any moment

MORTAL = """
import json, os, shutil, signal, sys, tempfile, warnings
from pathlib import Path
import numpy as np
import mpsim
from support.scenes import gas

warnings.simplefilter("ignore", DeprecationWarning)  # 3.12: fork in a process with threads
warnings.simplefilter("ignore", ResourceWarning)  # of what an interrupt leaves to the collector
os.fsync = lambda descriptor: None  # a kill loses nothing that the system has; so this takes seconds
FILES = {"atomic.py", "writing.py", "state.py"}
scenes = [gas(70, 0.1, seed=seed) for seed in range(2)]
small = [gas(9, 0.1, seed=seed) for seed in range(2)]
states = [mpsim.State(np.full((9, 2), float(k)), np.ones((9, 2))) for k in range(2)]
writers = {
    "small.toml": lambda path, k: small[k].save(path),
    "large.toml": lambda path, k: scenes[k].save(path),
    "state.npz": lambda path, k: states[k].save(path),
}

def tracing(limit, act):
    lines = 0
    def trace(frame, event, argument):
        nonlocal lines
        if Path(frame.f_code.co_filename).name not in FILES:
            return None
        lines += event == "line"
        if lines == limit:
            lines += 1
            act()
        return trace
    sys.settrace(trace)

def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if ".tmp" not in path.name}

def drafts(folder):
    return [path for path in folder.iterdir() if ".tmp" in path.name]

def killed(write, limit):
    pid = os.fork()
    if pid == 0:
        tracing(limit, lambda: os.kill(os.getpid(), signal.SIGKILL))
        write()
        os._exit(0)
    return os.WIFSIGNALED(os.waitpid(pid, 0)[1])

def interrupted(write, limit):
    def act():
        raise KeyboardInterrupt
    tracing(limit, act)
    try:
        write()
    except KeyboardInterrupt:
        return True
    finally:
        sys.settrace(None)
    return False

results = {}
for name, writer in writers.items():
    whole = []
    for k in range(2):
        with tempfile.TemporaryDirectory() as folder:
            writer(Path(folder, name), k)
            whole.append(contents(Path(folder)))
    for end in (killed, interrupted):
        limit, count, olds, left, mixed = 1, 0, 0, 0, 0
        while True:
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder, name)
                writer(path, 0)
                if not end(lambda: writer(path, 1), limit):
                    break
                count += 1
                found = contents(path.parent)
                assert all(found[each] in (whole[0][each], whole[1][each]) for each in found), (end, limit)
                assert found.keys() == whole[0].keys()
                mixed += found not in whole
                assert found[name] == whole[0][name] or found == whole[1], "a new scene file with old arrays"
                olds += found == whole[0]
                left += bool(drafts(path.parent))
                writer(path, 1)
                assert contents(path.parent) == whole[1]
                assert not drafts(path.parent), f"{name}, {end.__name__} at line {limit}: leftovers stay"
            limit += STEP
        results[f"{name} {end.__name__}"] = [count, olds, left, mixed]
print(json.dumps(results))
"""


@pytest.mark.slow
def test_a_kill_or_an_interrupt_at_any_line_leaves_the_old_file_or_the_new_one(figures, request):
    """At every third line, and with --long at each."""
    step = "1" if request.config.getoption("--long") else "3"
    outcome = run_script(MORTAL.replace("STEP", step), bound=170, warm=True)
    assert_clean(outcome)
    results = json.loads(outcome.out)
    for name, (count, olds, left, mixed) in results.items():
        assert count > 15, f"{name}: only {count} lines, which tests little"
        assert 0 < olds < count, f"{name}: always the same end, which tests nothing"
        if name.endswith("killed"):
            assert left > 0, f"{name}: no kill came while there was a draft"
        else:
            assert left == 0, f"{name}: {left} drafts left behind"
        if not name.startswith("large"):
            assert mixed == 0
        figures.note("R18", "-", f"{name} at any line", "the old file or the new one", f"{count} of {count}")


# --- rights


def mode_of(path):
    return path.stat().st_mode & 0o777


@pytest.fixture
def umask():
    before = os.umask(0o027)
    yield
    os.umask(before)


@pytest.mark.parametrize("name", [name for name in WRITERS if not name.startswith("frames")])
def test_a_new_file_has_the_rights_that_the_umask_leaves_and_a_replaced_one_keeps_its_own(name, tmp_path, umask):
    path = tmp_path / name
    written(name, path)
    assert mode_of(path) == 0o640
    for mode in (0o600, 0o664):
        path.chmod(mode)
        written(name, path)
        assert mode_of(path) == mode


PROTECTED = """
import os, tempfile
from pathlib import Path
import numpy as np
import mpsim

folder = Path(tempfile.mkdtemp(dir="/tmp"))
folder.chmod(0o777)
path = folder / "state.npz"
path.write_text("mine")
path.chmod(0o444)
if os.geteuid() == 0:
    os.setuid(65534)  # root may write anything
state = mpsim.State(np.zeros((3, 2)), np.ones((3, 2)))
try:
    state.save(path)
except mpsim.errors.OutputError as error:
    print(error)
print(path.read_text(), len(list(folder.iterdir())))
folder.chmod(0o777) if os.geteuid() != 65534 else None
other = folder / "dropbox"
other.mkdir()
other.chmod(0o333)
state.save(other / "state.npz")
print((other / "state.npz").stat().st_size > 0)
"""


def test_a_protected_file_is_not_replaced_and_a_folder_that_cannot_be_listed_takes_files():
    outcome = run_script(PROTECTED, warm=True)
    assert_clean(outcome)
    error, kept, dropped = outcome.out.splitlines()
    assert "protected from writing" in error
    assert (kept, dropped) == ("mine 1", "True")


def test_the_name_of_a_file_may_be_as_long_as_the_system_allows(tmp_path):
    path = tmp_path / f"{'x' * 251}.npz"
    assert STATE.save(path).stat().st_size > 0


@pytest.fixture
def dead_pid():
    """Number of a process that has ended."""
    process = subprocess.Popen([sys.executable, "-c", "pass"])
    process.wait()
    return process.pid


def test_drafts_of_the_dead_are_removed_and_those_of_the_living_and_of_other_machines_stay(tmp_path, dead_pid):
    host, token = os.uname().nodename, "0" * 32
    names = {
        f".mpsim-{dead_pid}-{host}-{token}.tmp": False,
        f".mpsim-{dead_pid}-{host}-{token}.tmp.gif": False,
        f".mpsim-{os.getpid()}-{host}-{token}.tmp": True,
        f".mpsim-{dead_pid}-{host}-1-{token}.tmp": True,
        f".mpsim-{dead_pid}-elsewhere-{token}.tmp": True,
        f".mpsim-{dead_pid}-{host}-{token}.tmpx": True,
    }
    for name in names:
        (tmp_path / name).write_text("")
    STATE.save(tmp_path / "state.npz")
    assert {path.name for path in tmp_path.iterdir()} == {name for name, stays in names.items() if stays} | {
        "state.npz"
    }


# --- animations and pictures


def test_an_animation_that_breaks_off_leaves_the_one_of_before(tmp_path):
    path = tmp_path / "gas.gif"
    animation(path)
    before = path.read_bytes()

    def broken(done, of):
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        mpsim.animate(lattice(3, 3), mpsim.Settings(method="grid"), path, 4, pixels=100, progress=broken)
    assert path.read_bytes() == before
    assert [each.name for each in tmp_path.iterdir()] == ["gas.gif"]


@pytest.mark.parametrize("ending", ["png", "pdf", "svg", "eps", "jpg", "PNG"])
def test_a_picture_has_the_format_of_its_ending(ending, tmp_path):
    path = tmp_path / f"a.{ending}"
    picture(path)
    starts = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml", "eps": b"%!PS", "jpg": b"\xff\xd8"}
    assert path.read_bytes().startswith(starts[ending.lower()])
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize("name", ["a", "a.unknown"])
def test_a_picture_without_a_format_is_refused(name, tmp_path):
    with pytest.raises(mpsim.InputError, match=r"a picture's path must end in one of .png, .pdf, "):
        picture(tmp_path / name)
    assert not list(tmp_path.iterdir())
