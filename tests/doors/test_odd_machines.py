"""Machines that lack or forbid something: a sentence that says what, nothing lost, or no need of it."""

import contextlib
import errno
import json
import os
import re
import resource
import subprocess
import sys

import numba
import numpy as np
import pytest
from support.processes import assert_clean, run_script
from support.scenes import gas, simulate

import mpsim

pytestmark = pytest.mark.compiled  # workers

SCENE = gas(20, 0.2, seed=1)


@pytest.fixture
def saved(tmp_path):
    """A simulation at frame 30 and its path, where checkpoints of frames 20 and 10 lie."""
    path = tmp_path / "run.mpsim"
    with simulate(SCENE, method="naive") as sim:
        for _ in range(2):
            sim.run(frames=10)
            sim.save(path)
        sim.run(frames=10)
        yield sim, path


def frames(path):
    return [mpsim.Simulation.resume(each).frame for each in (path, f"{path}.previous")]


def test_a_checkpoint_asks_no_installed_package_for_its_version(saved, tmp_path, monkeypatch):
    sim, path = saved
    other = tmp_path / "numpy-9.9.9.dist-info"
    other.mkdir()
    (other / "METADATA").write_text("Metadata-Version: 2.1\nName: numpy\nVersion: 9.9.9\n")
    for search in ([str(tmp_path), *sys.path], []):  # upgraded while it runs; uninstalled, or frozen
        monkeypatch.setattr(sys, "path", search)
        sim.save(path)
        with np.load(path) as file:
            versions = json.loads(file["mpsim_checkpoint"].tobytes())["versions"]
        assert (versions["numpy"], versions["numba"]) == (np.__version__, numba.__version__)


@pytest.mark.parametrize(
    ("call", "number"),
    [("open", errno.EROFS), *((call, errno.EIO) for call in ("link", "replace", "fsync"))],
)
def test_whatever_a_disk_answers_while_a_checkpoint_is_saved_the_words_are_true(call, number, saved, monkeypatch):
    sim, path = saved
    real, old = getattr(os, call), {each: each.read_bytes() for each in path.parent.iterdir()}
    failures = 0
    for failing in range(9):  # the first call, then the second ...
        calls = iter(range(100))

        def fail(*arguments, failing=failing, calls=calls, **options):
            if next(calls) == failing:
                raise OSError(number, os.strerror(number))
            return real(*arguments, **options)

        with monkeypatch.context() as patch:
            patch.setattr(os, call, fail)
            try:
                sim.save(path)
                expected = [[30, 20]]
            except mpsim.errors.OutputError as error:
                untouched, failures = "untouched" in str(error), failures + 1
                expected = [[20, 10]] if untouched else [[30, 20], [30, 10]] if "it is written" in str(error) else []
        assert frames(path) in expected
        for each, content in old.items():
            each.write_bytes(content)
        assert set(path.parent.iterdir()) == set(old), "a draft is left"
    assert failures > 0


def test_odd_mounts_keep_nobody_from_counting_cores_and_a_mounted_file_is_refused_by_name(tmp_path):
    """Mounts without a source, or whose name is not UTF-8; and a file that a renaming cannot replace."""
    script = """
import mpsim
scene = mpsim.Scene.random(count=9, packing=.2, radius=.5)
with mpsim.Simulation(scene, mpsim.Settings(method="parallel")) as sim:
    acts = lambda: sim.save("m.mpsim"), lambda: sim.run(frames=9, checkpoint="m.mpsim"), lambda: scene.save("m.toml")
    for act in acts:
        try:
            act()
        except mpsim.errors.OutputError as error:
            print(sim.frame, error)
    print(sim.run(frames=1).frames)
"""
    for name in ("m.mpsim", "m.toml", "other"):
        (tmp_path / name).touch()
    mounts = 'mkdir a b && mount -t tmpfs "" a && mount -t tmpfs - b && c=$(printf "\\351") && mkdir $c && '
    mounts += "mount -t tmpfs x $c && mount --bind other m.mpsim && mount --bind other m.toml"
    command = ["unshare", "--mount", "sh", "-c", f'{mounts} && exec "$0" "$@"', sys.executable, "-c", script]
    env = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    ran = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True, check=False)
    if "unshare" in ran.stderr or "mount:" in ran.stderr:
        pytest.skip(f"no private mount can be made here: {ran.stderr}")
    *refusals, frames = ran.stdout.splitlines()
    assert (len(refusals), frames, ran.stderr) == (3, "1", "")
    for line in refusals:
        assert line.startswith("0 ")
        assert "it is a mounted file, which cannot be replaced: mount its folder" in line
    assert (tmp_path / "m.mpsim").read_bytes() == b""


IN_NO_FOLDER = """
import os, tempfile
folder = tempfile.mkdtemp()
os.chdir(folder)
os.rmdir(folder)
import mpsim
scene = mpsim.Scene.random(count=50, packing=.2, radius=.5)
with mpsim.Simulation(scene, mpsim.Settings(method="naive")) as sim:
    report = sim.run(frames=2)
    acts = {
        "save": lambda: sim.save("x.mpsim"),
        "resume": lambda: mpsim.Simulation.resume("x.mpsim"),
        "run": lambda: sim.run(frames=1, checkpoint="x.mpsim"),
        "journal": lambda: sim.journal.save("x.toml"),
        "state": lambda: sim.state.save("x.npz"),
        "scene": lambda: scene.save("x.toml"),
        "load": lambda: mpsim.Scene.load("./x.toml"),
        "csv": lambda: report.to_csv("x.csv"),
        "write": lambda: mpsim.Trajectory.write("x.xyz", 1).__enter__(),
        "read": lambda: mpsim.Trajectory("x.xyz"),
        "sweep": lambda: mpsim.sweep(lambda x: {"y": x}, {"x": [1]}, path="x.jsonl"),
        "tradeoff": lambda: mpsim.tradeoff(scene, [sim.settings], until=0.1, path="x.json"),
    }
    for name, act in acts.items():
        try:
            act()
            print(name, "done")
        except mpsim.MpsimError as error:
            print(name, error)
"""


def test_a_removed_current_folder_is_named_at_every_door():
    outcome = run_script(IN_NO_FOLDER, warm=True)
    assert_clean(outcome)
    found = dict(line.split(" ", 1) for line in outcome.out.splitlines())
    assert len(found) == 12, outcome
    assert "done" not in found.values()
    assert all("'x." in text for text in found.values())
    for name in ("save", "resume", "run"):
        assert "needs the current folder, which has been removed. Give an absolute path, or " in found[name]


STARTED = """
import os, signal, sys
import psutil
import mpsim
{before}
scene, settings = mpsim.Scene.lattice(count=100, packing=.2, radius=.5), mpsim.Settings(method="parallel", workers=2)
for _ in range(2):
    try:
        with mpsim.Simulation(scene, settings) as sim:
            print(sim.run(frames=2).workers)
    except mpsim.errors.ResourceError as error:
        print(error)
    {between}
print([each.status() for each in psutil.Process().children() if each.status() == "zombie"])
"""
"""Two simulations with a worker."""

KILLED = """
    for server in [each for each in psutil.Process().children() if "forkserver" in " ".join(each.cmdline())]:
        server.kill()
"""


@pytest.mark.slow
def test_a_fork_server_that_was_killed_is_started_again():
    outcome = run_script(STARTED.format(before="", between=KILLED.strip()), bound=170)
    assert_clean(outcome)
    assert outcome.out.splitlines()[:2] == ["2", "2"]


@pytest.mark.long
@pytest.mark.parametrize(
    ("before", "says"),
    [
        ("", r"Python's fork server, .*ended.* (ulimit -u)"),
        ("import tempfile; os.chdir(f := tempfile.mkdtemp()); os.rmdir(f)", "The current folder, "),
        ("import tempfile; tempfile.tempdir = '/nowhere'", "(TMPDIR"),
    ],
    ids=["a limit in the fork server", "no current folder", "no temporary folder"],
)
def test_what_keeps_a_worker_from_starting_is_named(before, says, tmp_path):
    (tmp_path / "sitecustomize.py").write_text(
        "import os, sys\nif 'forkserver' in ' '.join(sys.orig_argv):\n"
        "    def fork():\n        raise BlockingIOError(11, 'no')\n    os.fork = fork\n"
    )
    env = {"PYTHONPATH": os.pathsep.join([*([] if before else [str(tmp_path)]), os.environ.get("PYTHONPATH", "")])}
    outcome = run_script(STARTED.format(before=before, between="pass"), env=env, bound=150)
    assert outcome.code == 0, outcome
    refusals = outcome.out.splitlines()[:2]
    for text in refusals:
        assert text.startswith("worker 1 could not be started: "), outcome
        assert all(part in text for part in says.split(".*")), text
        assert ("ulimit -u" in text) == (not before)


FULL = ["unshare", "--mount", "sh", "-c", 'mount -t tmpfs -o size=32k tmpfs "$0" && exec "$@"']

COMPILED = """
import logging, mpsim
logging.basicConfig()
for _ in range(2):
    print(mpsim.Scene.random(count=30, packing=0.5, radius=0.5, seed=1).digest())
"""


@pytest.mark.long
def test_a_full_disk_under_the_cache_is_logged_and_compiled_without(tmp_path):
    ran = subprocess.run([*FULL, str(tmp_path), "true"], capture_output=True, text=True, check=False)
    if ran.returncode:
        pytest.skip(f"no private mount can be made here: {ran.stderr}")
    command = [sys.executable, "-c", COMPILED]
    env = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    ran = subprocess.run([*FULL, str(tmp_path), *command], env=env, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    assert "a file of the kernel cache cannot be written ([Errno 28] No space left on device)" in ran.stderr
    digest = mpsim.Scene.random(count=30, packing=0.5, radius=0.5, seed=1).digest()
    assert ran.stdout.split() == [digest, digest]


@pytest.mark.parametrize("method", ["naive", "event"])
def test_a_run_without_a_free_descriptor_returns_its_report(method):
    """A run that began needs none; what the report says of memory is all that is lost."""
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    with simulate(SCENE, method=method) as sim, simulate(SCENE, method=method) as other, contextlib.ExitStack() as held:
        expected = other.run(frames=10, measures="kinetic_energy").measures["kinetic_energy"], other.digest()
        held.callback(resource.setrlimit, resource.RLIMIT_NOFILE, limits)
        lowest_free = os.open(os.devnull, os.O_RDONLY)
        held.callback(os.close, lowest_free)
        resource.setrlimit(resource.RLIMIT_NOFILE, (lowest_free + 1, limits[1]))
        with pytest.raises(OSError, match="Too many"):
            os.open(os.devnull, os.O_RDONLY)
        report = sim.run(frames=10, measures="kinetic_energy")
        assert (report.measures["kinetic_energy"], sim.digest()) == expected
    assert report.memory_bytes == (0,)


REAPED = """
import os, signal
import mpsim
from support.scenes import lattice, simulate

def reap(*_):
    try:
        while os.waitpid(-1, os.WNOHANG) != (0, 0):
            pass
    except ChildProcessError:
        pass

signal.signal(signal.SIGCHLD, {handler})
for kill in (False, True):
    try:
        with simulate(lattice(20, 20), method="parallel", workers=2, start_method="fork") as sim:
            if kill:
                os.kill(sim.pids[0], signal.SIGKILL)
            print(sim.run(frames=10**6 if kill else 3).workers)
    except mpsim.WorkerDiedError as death:
        print(death)
print(len([name for name in os.listdir("/dev/shm") if name.startswith(f"mpsim-{{os.getpid()}}-")]))
"""


@pytest.mark.parametrize("handler", ["signal.SIG_IGN", "reap"])
def test_workers_whose_ends_the_program_takes_for_itself_are_closed_and_named(handler):
    """A server that is process 1, or was started with SIGCHLD ignored: Python then takes dead children for alive."""
    outcome = run_script(REAPED.format(handler=handler), warm=True)
    assert_clean(outcome)
    workers, death, blocks = outcome.out.splitlines()
    assert (workers, blocks) == ("2", "0")
    assert re.match(r"worker 1 \(process \d+\) ended by (an unknown cause|signal 9)", death)


@pytest.mark.parametrize("method", ["naive", "grid", "event"])
def test_a_limit_of_file_sizes_concerns_no_method_of_one_process(method):
    """`ulimit -f`. It counts for shared memory, too."""
    with simulate(SCENE, method=method) as sim:
        sim.run(frames=3)
        digest = sim.digest()
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, before[1]))
    try:
        with simulate(SCENE, method=method) as sim:
            sim.run(frames=3)
            assert sim.digest() == digest
        with pytest.raises(
            mpsim.errors.SharedMemoryError, match=r"bytes in one file; .* files of 4,096\. .* \(ulimit -f\)"
        ):
            simulate(SCENE, method="parallel", workers=2)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_resource_tracker_that_was_killed_complains_of_no_block():
    """It was started anew without the name of the block, and printed a traceback when that was taken off its list."""
    script = """
import os, signal
from multiprocessing import resource_tracker
import mpsim
scene = mpsim.Scene.random(count=9, packing=.2, radius=.5)
with mpsim.Simulation(scene, mpsim.Settings(method="naive")) as sim:
    sim.run(frames=1)
    tracker = resource_tracker._resource_tracker._pid
    os.kill(tracker, signal.SIGKILL)
    os.waitpid(tracker, 0)
print([name for name in os.listdir("/dev/shm") if name.startswith(f"mpsim-{os.getpid()}-")])
"""
    env = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    ran = subprocess.run([sys.executable, "-c", script], env=env, capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stdout) == (0, "[]\n"), ran.stderr
    assert "process died unexpectedly" in ran.stderr, "the control: Python has started another"
    assert "Error" not in ran.stderr
