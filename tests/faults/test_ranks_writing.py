"""Ranks write one checkpoint together: what fails on one is an error on all and loses nothing; where they do not share
the file, those that do write it."""

import json
import subprocess

import pytest
from support.checkpoints import frame_in
from support.ranks import on_ranks, told_by_script

import mpsim

pytestmark = pytest.mark.slow

LATTICE = {"count": 140_000, "packing": 0.4, "radius": 0.5, "seed": 3}
"""Of three pieces."""

TOGETHER = """
import contextlib, errno, hashlib, json, os, resource, secrets, shutil, sys, mpsim
from pathlib import Path
from mpi4py import MPI
from mpsim.core import joint_file
from mpsim.core.joint_file import JointFile

comm, path, lattice = MPI.COMM_WORLD, Path(sys.argv[1]), json.loads(sys.argv[2])
folder, begun, write, token_at = path.parent, joint_file.begun, JointFile.write, joint_file._token_at
cases, noted = sys.argv[3:], {}

class Patched:
    # os, of which some calls do something else
    def __init__(self, **calls):
        self.__dict__.update(calls)

    def __getattr__(self, name):
        return getattr(os, name)

def failing(number, call, when=lambda: True):
    def fail(*given):
        if when():
            raise OSError(number, os.strerror(number))
        return call(*given)
    return fail

def missing(*given):
    raise FileNotFoundError(errno.ENOENT, "No such file or directory")

def copied(file, flags):
    # A layer of its own: what the first has written is read through it, and what is written stays there.
    copy = folder / f"layer{secrets.token_hex(4)}"
    shutil.copyfile(file, copy)
    return os.open(copy, flags)

def fooled(descriptor, offset):
    return b"x" * 32 if offset else token_at(descriptor, offset)

def noted_begun(*given):
    file = begun(*given)
    noted["writers"] = file.writers
    return file

def noted_write(self, content, offset):
    noted["bytes"] += len(content)
    write(self, content, offset)

@contextlib.contextmanager
def disturbed(case):
    # What a case says, to the second rank or the first.
    limits, calls = resource.getrlimit(resource.RLIMIT_FSIZE), {}
    own = case if comm.rank == 1 else ""
    if own == "no such file":
        calls["open"] = missing
    elif own in ("a layer", "control"):
        calls["open"] = copied
    elif own == "full":
        calls["pwrite"] = failing(errno.ENOSPC, os.pwrite, lambda: noted["writers"])
    elif own == "fsync":
        calls["fsync"] = failing(errno.EIO, os.fsync, lambda: noted["writers"])
    elif own == "too large":
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, limits[1]))
    if case == "control":
        joint_file._token_at = fooled
    if own == "control":
        secrets.token_bytes = lambda length: b"x" * length
    if case == "full of the first" and comm.rank == 0:
        calls["pwrite"] = failing(errno.ENOSPC, os.pwrite, lambda: noted["writers"])
    joint_file.os = Patched(**calls)
    replace = Path.replace
    if case == "rename" and comm.rank == 0:
        Path.replace = failing(errno.EACCES, replace)
    try:
        yield
    finally:
        joint_file.os, joint_file._token_at, Path.replace = os, token_at, replace
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)

joint_file.begun, JointFile.write, told = noted_begun, noted_write, {}
scene, settings = mpsim.Scene.lattice(**lattice), mpsim.Settings(dt=0.02, method="mpi", precision="float32")
with mpsim.Simulation(scene, settings) as sim:
    for case in cases:
        sim.run(frames=1)
        digest = sim.digest()
        noted.update(writers=[], bytes=0)
        with disturbed(case):
            try:
                sim.save(path)
                outcome = "saved"
            except mpsim.MpsimError as error:
                outcome = " ".join([type(error).__name__, str(error), *getattr(error, "__notes__", [])])
        content = hashlib.sha256(path.read_bytes()).hexdigest() if comm.rank == 0 else ""
        left = sorted(each.name for each in folder.iterdir() if "layer" not in each.name)
        told[case] = comm.gather((outcome, noted["writers"], noted["bytes"])), digest, content, left
        if comm.rank == 0:
            shutil.copyfile(path, folder.parent / case)
        comm.barrier()
if comm.rank == 0:
    print(json.dumps(told))
"""


def together(number, tmp_path, *cases):
    (tmp_path / "files").mkdir()
    told = told_by_script(number, str(tmp_path / "files" / "run"), json.dumps(LATTICE), *cases, script=TOGETHER)
    assert list(told) == list(cases)
    return told


def digest_in(path):
    with mpsim.Simulation.resume(path, method="grid") as sim:
        return sim.digest()


@pytest.mark.long
def test_ranks_that_do_not_share_the_file_leave_it_to_those_that_do(tmp_path):
    """The control: a rank that writes to a layer of its own, as nobody has looked whether that is seen."""
    told = together(2, tmp_path, "shared", "no such file", "a layer", "control")
    whole = LATTICE["count"] * 16
    for case, writers in (("shared", [1, 0]), ("no such file", [0]), ("a layer", [0])):
        found, digest, _, left = told[case]
        assert [each[0] for each in found] == ["saved"] * 2
        assert [each[1] for each in found] == [writers] * 2
        first, second = (each[2] for each in found)
        assert first + second == whole + 8 * 5, "discs, two numbers of all of them, a radius, and what is done"
        assert (second > 0) == (1 in writers)
        assert left == ["run", "run.previous"][: 1 + (case != "shared")]
        assert digest_in(tmp_path / case) == digest
    assert [each[1] for each in told["control"][0]] == [[1, 0]] * 2
    with pytest.raises(mpsim.CheckpointError, match="its content does not match its digest"):
        mpsim.Simulation.resume(tmp_path / "control")


FAILURES = {
    "full": "No space left on device",
    "too large": "File too large",
    "fsync": "Input/output error",
    "full of the first": "No space left on device",
    "rename": "Permission denied",
}


def test_what_fails_on_one_rank_is_an_error_on_all_and_what_was_there_is_untouched(tmp_path):
    """The control: the same ranks save before and after."""
    told = together(2, tmp_path, "before", "once more", *FAILURES, "after")
    kept, previous = told["once more"], told["before"]
    assert [each[0] for each in kept[0]] == ["saved"] * 2
    assert previous[2] != kept[2]
    for case, reason in FAILURES.items():
        (one, *_), (other, *_) = told[case][0]
        assert one == other, "all are told the same"
        assert one.startswith("OutputError the checkpoint "), one
        assert f"got {reason}. What was there before is untouched" in one
        if case in ("full", "too large", "fsync"):
            assert one.endswith(" on rank 1"), one
        assert told[case][2] == kept[2], case
        assert told[case][3] == ["run", "run.previous"], case
    assert [each[0] for each in told["after"][0]] == ["saved"] * 2
    assert digest_in(tmp_path / "after") == told["after"][1]
    assert digest_in(tmp_path / "files" / "run.previous") == kept[1]


KILLED = """
import json, os, signal, sys, mpsim
from pathlib import Path
from mpi4py import MPI
from mpsim.core.joint_file import JointFile

comm, path, write = MPI.COMM_WORLD, Path(sys.argv[1]), JointFile.write
with mpsim.Simulation(mpsim.Scene.lattice(**json.loads(sys.argv[2])), mpsim.Settings(dt=0.02, method="mpi")) as sim:
    for _ in range(2):
        sim.run(frames=1)
        sim.save(path)
    sim.run(frames=1)

    def killed(self, content, offset):
        write(self, content[: len(content) // 2], offset)
        if comm.rank == 1 and len(content) > 10_000:
            os.kill(os.getpid(), signal.SIGKILL)

    JointFile.write = killed
    sim.save(path)
"""


def test_a_rank_killed_while_it_writes_leaves_the_checkpoint_of_before(tmp_path):
    """What it leaves behind the next writer removes."""
    path = tmp_path / "run"
    done = on_ranks(2, str(path), json.dumps(LATTICE), script=KILLED, bound=120)
    assert done.code != 0
    drafts = [each for each in tmp_path.iterdir() if each.name.endswith(".tmp") or ".tmp" in each.name]
    assert drafts, "the kill came while the file was written"
    assert (frame_in(path), frame_in(tmp_path / "run.previous")) == (2, 1)
    with mpsim.Simulation.resume(path, method="grid") as sim:
        sim.save(path)
    assert sorted(each.name for each in tmp_path.iterdir()) == ["run", "run.previous"]


FULL = """
import json, os, sys, mpsim
from mpi4py import MPI
from support.ranks import tell

scene = mpsim.Scene.lattice(**json.loads(sys.argv[1]))
with mpsim.Simulation(scene, mpsim.Settings(dt=0.02, method="mpi", precision="float32")) as sim:
    for save in range(2):
        try:
            sim.run(frames=1)
            sim.save("/mnt/run")
            tell("saved", sim.frame)
        except mpsim.errors.OutputError as error:
            tell(error)
        if MPI.COMM_WORLD.rank == 0:
            print(sorted(os.listdir("/mnt")), flush=True)
    if MPI.COMM_WORLD.rank == 0:
        print("kept", mpsim.engine.checkpoint.read("/mnt/run", lambda found: None).run["frame"])
"""


def test_a_disk_that_is_full_for_all_ranks_keeps_the_checkpoint_of_before(tmp_path, monkeypatch):
    """A disk with room for one checkpoint, and half another."""
    mount = f'mount -t tmpfs -o size={LATTICE["count"] * 16 * 3 // 2} tmpfs /mnt && exec "$@"'
    prefix = ["unshare", "--mount", "sh", "-c", mount, "sh"]
    try:
        subprocess.run([*prefix, "true"], check=True, capture_output=True, timeout=20)
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"no private mount can be made here: {error}")
    done = on_ranks(2, json.dumps(LATTICE), script=FULL, prefix=prefix)
    assert done.code == 0, done.err
    lines = done.out.splitlines()
    assert lines[:3] == ["saved 1", "saved 1", "['run']"]
    assert lines[3] == lines[4]
    assert "No space left on device" in lines[3]
    assert lines[5:] == ["['run']", "kept 1"]


# --- trajectories

FRAMES = """
import json, os, signal, sys, time, mpsim
from pathlib import Path
from mpi4py import MPI
from mpsim.core.joint_file import JointFile
from support.ranks import tell

comm, path, lattice, what = MPI.COMM_WORLD, Path(sys.argv[1]), json.loads(sys.argv[2]), sys.argv[3]
write, bad = JointFile.write, {}

def disturbed(self, content, offset):
    if bad and comm.rank == bad["rank"] and len(content) > 10_000:
        if what == "killed":
            time.sleep(1)  # the other one has written lines that follow
            os.kill(os.getpid(), signal.SIGKILL)
        write(self, content[:5000], offset)
        raise OSError(28, "No space left on device")
    write(self, content, offset)

JointFile.write = disturbed
scene, settings = mpsim.Scene.lattice(**lattice), mpsim.Settings(dt=0.02, method="mpi")
with mpsim.Simulation(scene, settings) as sim, mpsim.Trajectory.write(path, comm=comm) as out:
    sim.run(frames=1, observe=out)
    bad["rank"] = int(sys.argv[4])
    try:
        sim.run(frames=1, observe=out)
    except mpsim.errors.OutputError as error:
        tell(error, *getattr(error.__cause__, "__notes__", []))
    bad.clear()
    out.look(sim, 0)
    sim.run(frames=1, observe=out)
    if comm.rank == 0:
        print(out.frames)
"""


def frames_of(path):
    with mpsim.Trajectory(path) as found:
        return [(each.frame, each.state.digest()) for each in found]


@pytest.fixture
def whole(tmp_path):
    """The frames that one process writes."""
    with (
        mpsim.Simulation(mpsim.Scene.lattice(**LATTICE), mpsim.Settings(dt=0.02, method="grid")) as sim,
        mpsim.Trajectory.write(tmp_path / "whole.xyz") as out,
    ):
        sim.run(frames=3, observe=out)
    return frames_of(tmp_path / "whole.xyz")


@pytest.mark.long
@pytest.mark.parametrize("rank", [0, 1])
def test_a_frame_that_one_rank_cannot_write_is_an_error_on_all_and_is_cut_off(rank, tmp_path, whole):
    done = on_ranks(2, str(tmp_path / "run.xyz"), json.dumps(LATTICE), "full", str(rank), script=FRAMES)
    assert done.code == 0, done.err
    one, other, frames = done.out.splitlines()
    assert one == other
    assert one.startswith("the trajectory ")
    assert "got No space left on device. What was written before is complete." in one
    assert one.endswith(f" on rank {rank}")
    assert frames == "4"
    assert frames_of(tmp_path / "run.xyz") == whole, "it is written once there is room again"


@pytest.mark.long
@pytest.mark.parametrize("rank", [0, 1])
def test_a_rank_killed_while_it_writes_costs_the_frame_in_hand(rank, tmp_path, whole):
    """Lines of the other rank are behind those that are missing."""
    path = tmp_path / "run.xyz"
    done = on_ranks(2, str(path), json.dumps(LATTICE), "killed", str(rank), script=FRAMES, bound=120)
    assert done.code != 0
    content = path.read_bytes()
    assert (b"\0" in content) == (rank == 0), "a hole before what the second rank has written"
    with pytest.warns(mpsim.errors.TrajectoryWarning, match="ends in the middle of a frame"):
        assert frames_of(path) == whole[:2]
    with (
        mpsim.Simulation(mpsim.Scene.lattice(**LATTICE), mpsim.Settings(dt=0.02, method="grid")) as sim,
    ):
        sim.run(frames=1)
        with mpsim.Trajectory.write(path, mode="a") as out:
            sim.run(frames=2, observe=out)
    assert frames_of(path) == whole
