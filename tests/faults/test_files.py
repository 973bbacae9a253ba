"""Whatever writes a file: nobody's file is lost through a link, files are whole at any moment, and rights stay."""

import concurrent.futures
import errno
import json
import os
import resource
import subprocess
import sys
import time

import numpy as np
import pytest
from support.commands import mpsim_command
from support.processes import assert_clean, limited, refusing, run_script
from support.scenes import gas, lattice, simulate
from support.selection import slow_but

import mpsim

pytestmark = pytest.mark.plain

STATE = mpsim.State(np.zeros((3, 2)), np.ones((3, 2)))
SCENE = gas(70, 0.2, seed=1)
with simulate(SCENE, method="naive") as once:
    REPORT = once.run(frames=12)


def animation(path, progress=False):
    mpsim.animate(lattice(3, 3), mpsim.Settings(method="grid"), path, 3, pixels=100, progress=progress)


def trajectory(path):
    with simulate(lattice(3, 3), method="grid") as sim, mpsim.Trajectory.write(path, mode="w") as out:
        sim.run(frames=2, observe=out)


def picture(path):
    """Of a run that is made once."""
    run = path.parent.parent / f"run of {path.parent.name}"
    if not run.exists():
        lattice(3, 3).save(run.with_suffix(".toml"))
        words = ("--method", "grid", "--frames", 4, "--every", 2, "--quiet", "--out", run)
        assert mpsim_command("run", run.with_suffix(".toml"), *words).exit_code == 0
    done = mpsim_command("plot", run, "--out", path, "--force")
    if done.exit_code:
        raise mpsim.errors.OutputError(done.stderr)


WRITERS = {
    "scene.toml": SCENE.save,
    "gas.position.npy": lambda path: SCENE.save(path.with_name("gas.toml")),
    "state.npz": STATE.save,
    "times.csv": REPORT.to_csv,
    "picture.png": picture,
    "animation.gif": animation,
    "frames.xyz": trajectory,
    "frames.gsd": trajectory,
}
"""What writes a file, but for checkpoints, by the name of one."""

PREDICTABLE = (".{name}.{pid}", ".{name}.{pid}.tmp", "{name}.{pid}.tmp", ".{name}.tmp", "{name}.part", "{name}.tmp")
"""Names that temporary files have had, here and elsewhere."""


# --- links, and what is no file


@pytest.fixture
def victim(tmp_path):
    (tmp_path / "home").mkdir()
    path = tmp_path / "home" / "thesis.tex"
    path.write_text("a year of work")
    yield path
    assert path.read_text() == "a year of work", "it was overwritten through a link"


SLOW = {"times.parquet", "sweep.parquet", "picture.png", "animation.gif"}
"""Which import packages, or draw, for seconds."""


def writers(*without):
    names = [name for name in WRITERS if name not in without]
    return slow_but(names, *(name for name in names if name not in SLOW))


@pytest.mark.parametrize("name", writers())
def test_no_link_is_followed_neither_at_the_name_nor_at_that_of_a_draft(name, tmp_path, victim):
    path = tmp_path / name
    for pattern in PREDICTABLE:
        (tmp_path / pattern.format(name=name, pid=os.getpid())).symlink_to(victim)
    before = {each.name for each in tmp_path.iterdir()}
    WRITERS[name](path)
    assert path.stat().st_size > 0
    assert not path.is_symlink()
    beside = {"gas.toml", "gas.position.npy", "gas.velocity.npy", "scene.position.npy", "scene.velocity.npy"}
    assert {each.name for each in tmp_path.iterdir()} - before <= {name, *beside}, "left behind"
    path.unlink()
    path.symlink_to(victim)
    with pytest.raises((mpsim.MpsimError, OSError), match="symbolic link"):
        WRITERS[name](path)
    assert path.readlink() == victim


def test_what_is_no_regular_file_stays_what_it_is(tmp_path):
    path = tmp_path / "times.csv"
    for make in (path.mkdir, lambda: os.mkfifo(path), lambda: path.symlink_to("/dev/null")):
        make()
        with pytest.raises(mpsim.errors.OutputError, match=r"directory|not a regular file|symbolic link"):
            REPORT.to_csv(path)
        assert [each.name for each in tmp_path.iterdir()] == ["times.csv"]
        assert not path.is_file()
        path.rmdir() if path.is_dir() else path.unlink()


# --- no room


@pytest.mark.parametrize("name", writers("picture.png", "animation.gif"))
def test_what_does_not_fit_is_an_error_and_leaves_no_file(name, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # of modules that are imported now: it would be cut off
    for limit in (100, 700) if name == "scene.toml" else (100,):  # of its arrays, a part fits
        too_large = pytest.raises(mpsim.errors.OutputError, match="File too large")
        with too_large as refused, limited(resource.RLIMIT_FSIZE, limit):
            WRITERS[name](tmp_path / name)
        assert str(tmp_path) in str(refused.value)
        if not name.startswith("frames"):
            assert list(tmp_path.iterdir()) == []
    WRITERS[name](tmp_path / name)
    assert (tmp_path / name).stat().st_size > 100, "with room it is written"


def test_an_animation_that_breaks_off_or_does_not_fit_leaves_the_one_of_before(tmp_path, monkeypatch):
    def broken(done, of):
        if done == 2:
            raise ZeroDivisionError

    path = tmp_path / "gas.gif"
    animation(path)
    before = path.read_bytes()
    with pytest.raises(ZeroDivisionError):
        animation(path, broken)
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", refusing(errno.ENOSPC))
        with pytest.raises(mpsim.errors.OutputError, match=r"room on its disk; got .*gas.gif' \(No space left on dev"):
            animation(path)
    assert path.read_bytes() == before
    assert [each.name for each in tmp_path.iterdir()] == ["gas.gif"]


def test_a_trajectory_whose_disk_fails_at_the_end_says_so_and_is_let_go(tmp_path, monkeypatch):
    """Network disks say only when a file is flushed or closed that there is no room."""
    path = tmp_path / "a.xyz"
    with simulate(SCENE, method="naive") as sim:
        out = mpsim.Trajectory.write(path, every=1)
        sim.run(frames=1, observe=out)
        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", refusing(errno.EDQUOT))
            with pytest.raises(mpsim.errors.OutputError, match=r"a\.xyz.*quota exceeded"):
                out.close()
        with mpsim.Trajectory.write(path, every=1, mode="a") as out:  # neither locked nor open any more
            sim.run(frames=1, observe=out)
    found = mpsim.Trajectory(path)
    assert len(found) == 3
    path.unlink()
    for read in (lambda: found[0], lambda: list(found)):
        with pytest.raises(mpsim.errors.TrajectoryError, match=r"a\.xyz' cannot \(No such file"):
            read()


# --- many at once


def test_four_threads_save_one_scene_file_at_once(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "fsync", lambda descriptor: time.sleep(1e-4))  # another thread's turn, without a disk's
    scenes, path, rounds = [gas(20, 0.1, seed=seed) for seed in range(4)], tmp_path / "gas.toml", 15
    with concurrent.futures.ThreadPoolExecutor(len(scenes)) as pool:
        for _ in range(rounds):
            list(pool.map(lambda scene: scene.save(path), scenes))
            assert mpsim.Scene.load(path).digest() in {scene.digest() for scene in scenes}
    assert sorted(each.name for each in tmp_path.iterdir()) == ["gas.toml"]


# --- the end at any moment

MORTAL = """
import json, os, shutil, signal, sys, tempfile, warnings
from multiprocessing import resource_tracker
from pathlib import Path
import numpy as np
import mpsim
from support.checkpoints import frame_in
from support.processes import SHARED_MEMORY, blocks_of
from support.scenes import gas, simulate

OURS = str(Path(mpsim.__file__).parent)
warnings.simplefilter("ignore", DeprecationWarning)  # 3.12: fork in a process with threads
warnings.simplefilter("ignore", ResourceWarning)  # of what an interrupt leaves to the collector
os.fsync = lambda descriptor: None  # a kill loses nothing that the system has; so this takes seconds

def tracing(limit, act):
    '''Act once, at the line of this number of our own code.'''
    lines = 0
    def trace(frame, event, argument):
        nonlocal lines
        if not frame.f_code.co_filename.startswith(OURS):
            return None
        lines += event == "line"
        if lines == limit:
            lines += 1
            act()
        return trace
    sys.settrace(trace)

def killed(write, limit, prepare=lambda: None):
    pid = os.fork()
    if pid == 0:
        prepare()
        tracing(limit, lambda: os.kill(os.getpid(), signal.SIGKILL))
        write()
        sys.settrace(None)
        os._exit(0)
    status = os.waitpid(pid, 0)[1]
    for name in blocks_of(pid):
        (SHARED_MEMORY / name).unlink(missing_ok=True)
    return os.WIFSIGNALED(status)

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

scenes = [gas(70, 0.1, seed=seed) for seed in range(2)]
small = [gas(9, 0.1, seed=seed) for seed in range(2)]
states = [mpsim.State(np.full((9, 2), float(k)), np.ones((9, 2))) for k in range(2)]
writers = {
    "small.toml": lambda path, k: small[k].save(path),
    "large.toml": lambda path, k: scenes[k].save(path),
    "state.npz": lambda path, k: states[k].save(path),
}

def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if ".tmp" not in path.name}

def drafts(folder):
    return [path for path in folder.iterdir() if ".tmp" in path.name]

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

with tempfile.TemporaryDirectory() as base:  # a checkpoint, beside which the one before is kept
    with simulate(gas(9, 0.1), method="grid") as sim:
        for name in ("run", "run", "new"):
            sim.run(frames=1)
            sim.save(Path(base, name))
    path, again, limit, frames, left = Path(base, "a", "run"), [], 1, [], 0
    def resume():
        again.append(mpsim.Simulation.resume(Path(base, "new")))
        for name in blocks_of(os.getpid()):  # else this program's tracker misses those that other programs clean up
            resource_tracker.unregister(f"/{name}", "shared_memory")
    while True:
        shutil.rmtree(path.parent, ignore_errors=True)
        shutil.copytree(base, path.parent)
        if not killed(lambda: again[0].save(path), limit, resume):
            break
        frames.append(frame_in(path))
        left += bool(drafts(path.parent))
        limit += 4 * STEP
    assert frame_in(path) == 3 and set(frames) <= {2, 3}, frames
    results["checkpoint killed"] = [len(frames), frames.count(2), left, 0]
print(json.dumps(results))
"""


@pytest.mark.slow
def test_a_kill_or_an_interrupt_at_any_line_leaves_the_old_file_or_the_new_one(request):
    """At every ninth line, and with --long at each."""
    step = "1" if request.config.getoption("--long") else "9"
    outcome = run_script(MORTAL.replace("STEP", step), bound=170, warm=True)
    assert_clean(outcome)
    results = json.loads(outcome.out)
    for name, (count, olds, left, mixed) in results.items():
        assert count > 5, f"{name}: only {count} lines, which tests little"
        assert olds > 0, f"{name}: never the old one, which tests nothing"
        assert (left > 0) == name.endswith("killed"), f"{name}: {left} drafts left"
        assert mixed == 0 or name.startswith("large")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A trajectory of frames 0 to 3 and where each of them ends."""
    path = tmp_path_factory.mktemp("whole") / "run.xyz"
    ends = []
    with simulate(gas(2, 0.1), method="naive", dt=0.02) as sim, mpsim.Trajectory.write(path) as out:
        for frames in (0, 1, 1, 1):
            sim.run(frames=frames, observe=out)
            ends.append(path.stat().st_size)
    return path, ends


def test_a_trajectory_cut_at_any_byte_is_continued_to_the_same_bytes(whole, tmp_path):
    """The run comes back from a checkpoint of frame 2, of which the cut may or may not have taken the frame."""
    path, ends = whole
    text, cut = path.read_bytes(), tmp_path / "cut.xyz"
    with simulate(gas(2, 0.1), method="naive", dt=0.02) as sim:
        sim.run(frames=2)
        for length in [*range(ends[1], ends[1] + 4), *range(ends[1] + 4, ends[3], 17), ends[2], ends[3]]:
            cut.write_bytes(text[:length])
            with mpsim.Trajectory.write(cut, mode="a") as out:
                sim.run(frames=0, observe=out)
            assert cut.read_bytes() == text[: ends[2]], length
        with mpsim.Trajectory.write(cut, mode="a") as out:
            sim.run(frames=1, observe=out)
    assert cut.read_bytes() == text


# --- rights and names


def mode_of(path):
    return path.stat().st_mode & 0o777


@pytest.fixture
def umask():
    before = os.umask(0o027)
    yield
    os.umask(before)


@pytest.mark.usefixtures("umask")
@pytest.mark.parametrize("name", writers("picture.png", "frames.xyz", "frames.gsd"))
def test_a_new_file_has_the_rights_that_the_umask_leaves_and_a_replaced_one_keeps_its_own(name, tmp_path):
    path = tmp_path / name
    WRITERS[name](path)
    assert mode_of(path) == 0o640
    for mode in (0o600, 0o664):
        path.chmod(mode)
        WRITERS[name](path)
        assert mode_of(path) == mode


AS_NOBODY = """
import os, tempfile
from pathlib import Path
import numpy as np
import mpsim

folder = Path(tempfile.mkdtemp(dir="/tmp"))
folder.chmod(0o777)
path = folder / "state.npz"
path.write_text("mine")
path.chmod(0o444)
"".encode("cp437")  # a module of Python that nobody else may read
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


def test_a_protected_file_stays_and_a_folder_that_cannot_be_listed_takes_files():
    outcome = run_script("import warnings\nwarnings.simplefilter('ignore')\n" + AS_NOBODY, warm=True)
    assert_clean(outcome)
    error, kept, dropped = outcome.out.splitlines()
    assert "protected from writing" in error
    assert (kept, dropped) == ("mine 1", "True")


def test_a_name_may_be_as_long_as_the_system_allows_and_drafts_of_the_dead_are_removed(tmp_path):
    """Those of the living and of other machines stay."""
    ended = subprocess.Popen(["true"])
    ended.wait()
    host, token, dead = os.uname().nodename, "0" * 32, ended.pid
    names = {
        f".mpsim-{dead}-{host}-{token}.tmp": False,
        f".mpsim-{dead}-{host}-{token}.tmp.gif": False,
        f".mpsim-{os.getpid()}-{host}-{token}.tmp": True,
        f".mpsim-{dead}-{host}-1-{token}.tmp": True,
        f".mpsim-{dead}-elsewhere-{token}.tmp": True,
        f".mpsim-{dead}-{host}-{token}.tmpx": True,
    }
    for name in names:
        (tmp_path / name).write_text("")
    written = f"{'x' * 251}.npz"
    STATE.save(tmp_path / written)
    assert {path.name for path in tmp_path.iterdir()} == {written, *(name for name, stays in names.items() if stays)}
