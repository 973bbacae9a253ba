"""What goes wrong on ranks ends on all of them, in time, with a message that says what."""

import json

import pytest
from support.processes import run_script
from support.ranks import on_ranks, told_by
from support.scenes import gas
from support.selection import long_but

import mpsim

pytestmark = [pytest.mark.slow]

BOUND = 60  # seconds within which a job has ended, on a busy machine too; without an end it would run for hours

LONG = """
import os, signal, mpsim
from mpi4py import MPI
from support.scenes import gas

rank = MPI.COMM_WORLD.rank
with mpsim.Simulation(gas(500, 0.3), mpsim.Settings(method="mpi", dt=0.01)) as sim:
    sim.run(frames=10)
    if rank == 1:
        {act}
    sim.run(frames=10**9)
"""


KILLED, RAISED = "os.kill(os.getpid(), signal.SIGKILL)", "raise ValueError('of rank one')"


@pytest.mark.parametrize("act", long_but([KILLED, RAISED], KILLED))
def test_a_rank_that_ends_ends_the_job(act):
    done = on_ranks(2, script=LONG.format(act=act), bound=BOUND)
    assert done.code != 0
    assert "rank one" in done.err or "signal 9" in done.err + done.out or "Killed" in done.err + done.out


SIGNALLED = """
import os, signal, sys, mpsim
from mpi4py import MPI
from support.ranks import tell
from support.scenes import gas

with mpsim.Simulation(gas(500, 0.3), mpsim.Settings(method="mpi", dt=0.01)) as sim:
    def at(done, frames):
        if done > 30 and MPI.COMM_WORLD.rank == 1:
            os.kill(os.getpid(), signal.{signal})
"""
"""Within its run one rank sends itself a signal."""

SAVING = """
    try:
        sim.run(frames=10**9, checkpoint=sys.argv[1], checkpoint_every={every}, progress=at)
    except SystemExit as end:
        assert end.code == 143
        tell("ended at", sim.frame)
"""


@pytest.mark.parametrize(("signal", "every"), long_but([("SIGKILL", 10), ("SIGTERM", 10**6)], ("SIGTERM", 10**6)))
def test_a_rank_that_is_told_to_end_leaves_a_checkpoint_with_which_one_process_goes_on(signal, every, tmp_path):
    path = tmp_path / "run.mpsim"
    done = on_ranks(2, str(path), script=(SIGNALLED + SAVING).format(signal=signal, every=every), bound=BOUND)
    assert (done.code == 0) == (signal == "SIGTERM"), done.err
    assert done.out.count("ended at") == (2 if signal == "SIGTERM" else 0)
    settings = mpsim.Settings(method="grid", dt=0.01)
    with mpsim.Simulation(gas(500, 0.3), settings) as whole, mpsim.Simulation.resume(path, method="grid") as sim:
        assert sim.frame >= 30
        sim.run(frames=5)
        whole.run(frames=sim.frame)
        assert sim.digest() == whole.digest()


ERRORS = """
import numpy as np, mpsim
from mpi4py import MPI
from support.ranks import report
from support.scenes import gas, split

world, start = MPI.COMM_WORLD, gas(200, 0.2)

def other(**features):
    given = dict(width=start.width, height=start.height, position=start.position, velocity=start.velocity, radius=0.5)
    return mpsim.Scene(**given | features)

def runs(scene, **given):
    with mpsim.Simulation(scene, **split({"method": "mpi"} | given)) as sim:
        sim.run(frames=1)

def added(rank=0):
    with mpsim.Simulation(start, mpsim.Settings(method="mpi")) as sim:
        sim.add([1, 1], [rank, 0])
        assert sim.count == 201

def with_trajectory():
    with mpsim.Simulation(start, mpsim.Settings(method="mpi")) as sim:
        sim.run(frames=1, observe=mpsim.Trajectory.write(f"frames-{world.rank}.xyz"))

def unwritable():
    with mpsim.Simulation(start, mpsim.Settings(method="mpi")) as sim:
        sim.save("no/such/folder/file.mpsim")

def diverging():
    with mpsim.Simulation(start, mpsim.Settings(method="mpi")) as sim:
        sim.run(frames=3)
        part = sim._solver._part
        discs, count = part.arguments().a, part.count
        discs.x[:count][discs.id[:count] == 7] = np.nan
        sim.run(frames=3)

giants = other(radius=np.where(np.arange(200) == 7, 5.0, 0.5), position=start.position * 2 + 4, width=99, height=99)
few = mpsim.Scene(width=3, height=30, position=[[1.5, 5], [1.5, 20]], velocity=np.zeros((2, 2)), radius=1.4)
acts = {
    "giants": lambda: runs(giants),
    "unguarded": lambda: runs(start, unguarded=True),
    "restart": lambda: runs(start, on_worker_death="restart"),
    "workers": lambda: runs(start, workers=2),
    "no communicator": lambda: runs(start, comm=5),
    "communicator of grid": lambda: runs(start, comm=world, method="grid"),
    "different scenes": lambda: runs(gas(200, 0.2, seed=world.rank)),
    "different gravity": lambda: runs(other(gravity=(0.0, -float(world.rank)))),
    "refused on one rank": lambda: runs(start, unguarded=world.rank == 1),
    "too fast on one rank": lambda: runs(other(velocity=start.velocity * 1e3**world.rank), on_fast="error"),
    "different settings": lambda: runs(start, dt=0.01 * (1 + world.rank)),
    "too many ranks": lambda: runs(few),
    "added": added,
    "added otherwise": lambda: added(world.rank),
    "trajectory": with_trajectory,
    "unwritable": unwritable,
    "diverging": diverging,
}
told = {}
for name, act in acts.items():
    try:
        act()
        told[name] = ["none", ""]
    except mpsim.MpsimError as error:
        told[name] = [type(error).__name__, str(error)]
    except Exception as error:
        told[name] = ["?" + type(error).__name__, str(error)]
report(world.allgather(told))
"""

WORDS = {
    "giants": ("InputError", "a few discs are far larger than all others"),
    "unguarded": ("InputError", "unguarded=True"),
    "restart": ("InputError", "on_worker_death must be 'raise' with method='mpi'; got 'restart'"),
    "workers": ("InputError", "workers must be 1 with method='mpi', where each rank is one process; got 2"),
    "no communicator": ("InputError", "comm must be a communicator of mpi4py"),
    "communicator of grid": ("InputError", "comm may be given only with method='mpi'"),
    "different scenes": ("InputError", "those of rank 1 differ from those of rank 0"),
    "different gravity": ("InputError", "those of rank 1 differ from those of rank 0"),
    "refused on one rank": ("InputError", "unguarded=True"),
    "too fast on one rank": ("TooFastError", "on_fast='warn'"),
    "different settings": ("InputError", "those of rank 1 differ from those of rank 0"),
    "too many ranks": ("InputError", "ranks must be at most as many as the grid has columns, 1 "),
    "added": ("none", ""),
    "added otherwise": ("InputError", "arguments of add must be the same on all ranks; those of rank 1"),
    "trajectory": ("InputError", "must be given comm, the communicator of the simulation"),
    "unwritable": ("OutputError", "no/such/folder"),
    "diverging": ("DivergedError", "disc 7 is not finite in frame 3: position (nan,"),
}


def test_what_ranks_cannot_do_is_one_error_on_all():
    done = on_ranks(2, script=ERRORS, bound=170)
    assert done.code == 0, done.err
    told = json.loads(done.out.splitlines()[-1])
    for each in told:
        each["trajectory"][1] = each["trajectory"][1].replace("frames-1", "frames-0")  # a file each
    assert told[0] == told[1], "one exception on all"
    assert set(told[0]) == set(WORDS)
    for name, (kind, words) in WORDS.items():
        assert told[0][name][0] == kind, (name, told[0][name])
        assert words in told[0][name][1], name


def test_without_mpi_the_error_says_what_to_install():
    text = """
        import sys
        sys.modules["mpi4py"] = None
        import mpsim
        try:
            mpsim.Simulation(mpsim.Scene.random(count=5, packing=0.1, radius=0.5), mpsim.Settings(method="mpi"))
        except mpsim.InputError as error:
            print(error)
    """
    assert "pip install 'mpsim[mpi]'" in run_script(text).out


INTERRUPTED = """
    try:
        sim.run(frames=10**9, progress=at)
    except KeyboardInterrupt:
        tell("interrupted at", sim.frame)
    sim.save(sys.argv[1])
    sim.run(frames=5)
    tell("digest", sim.digest())
"""


def test_ctrl_c_on_one_rank_comes_to_all_at_one_frame_and_the_simulation_goes_on(tmp_path):
    done = on_ranks(2, str(tmp_path / "run"), script=SIGNALLED.format(signal="SIGINT") + INTERRUPTED, bound=BOUND)
    assert done.code == 0, done.err
    (one, other, *digests) = done.out.splitlines()
    assert one == other
    assert one.startswith("interrupted at ")
    with mpsim.Simulation.resume(tmp_path / "run", method="grid") as sim:
        assert sim.frame == int(one.split()[-1])
        sim.run(frames=5)
        assert digests == [f"digest {sim.digest()}"] * 2


# --- files

LATTICE = {"count": 140_000, "packing": 0.4, "radius": 0.5, "seed": 3}  # of three chunks

HEAD = """
import contextlib, errno, hashlib, json, os, resource, signal, sys, time, mpsim
from pathlib import Path
from mpi4py import MPI
from support.ranks import report, tell

comm, path, lattice, cases = MPI.COMM_WORLD, Path(sys.argv[1]), json.loads(sys.argv[2]), sys.argv[3:]
scene, settings = mpsim.Scene.lattice(**lattice), mpsim.Settings(dt=0.02, method="mpi", precision="float32")

def failing(number, call):
    def fail(*given):
        raise OSError(number, os.strerror(number))
    return fail

@contextlib.contextmanager
def disturbed(case):
    # What a case says, to the first rank.
    limits, kept, replace = resource.getrlimit(resource.RLIMIT_FSIZE), os.fsync, Path.replace
    if case == "fsync" and comm.rank == 0:
        os.fsync = failing(errno.EIO, os.fsync)
    elif case == "too large" and comm.rank == 0:
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, limits[1]))
    elif case == "rename" and comm.rank == 0:
        Path.replace = failing(errno.EACCES, replace)
    try:
        yield
    finally:
        os.fsync, Path.replace = kept, replace
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
"""

TOGETHER = (
    HEAD
    + """
told = {}
with mpsim.Simulation(scene, settings) as sim:
    for case in cases:
        sim.run(frames=1)
        digest = sim.digest()
        with disturbed(case):
            try:
                sim.save(path)
                outcome = "saved"
            except mpsim.MpsimError as error:
                outcome = " ".join([type(error).__name__, str(error), *getattr(error, "__notes__", [])])
        content = hashlib.sha256(path.read_bytes()).hexdigest() if comm.rank == 0 else ""
        left = sorted(each.name for each in path.parent.iterdir())
        told[case] = comm.gather(outcome), digest, content, left
        comm.barrier()
report(told)
"""
)

FAILURES = {"too large": "File too large", "fsync": "Input/output error", "rename": "Permission denied"}


def digest_in(path):
    with mpsim.Simulation.resume(path, method="grid") as sim:
        return sim.digest()


def test_what_fails_on_one_rank_is_an_error_on_all_and_what_was_there_is_untouched(tmp_path):
    """The control: the same ranks save before and after."""
    path, cases = tmp_path / "run", ("before", "once more", *FAILURES, "after")
    told = told_by(2, str(path), json.dumps(LATTICE), *cases, script=TOGETHER)
    kept, previous = told["once more"], told["before"]
    assert kept[0] == ["saved"] * 2
    assert previous[2] != kept[2]
    for case, reason in FAILURES.items():
        one, other = told[case][0]
        assert one == other, "all are told the same"
        assert one.startswith("OutputError the checkpoint "), (case, one)
        assert f"({reason}). What was there before is untouched" in one
        assert told[case][2] == kept[2], case
        assert told[case][3] == ["run", "run.previous"], case
    assert told["after"][0] == ["saved"] * 2
    assert digest_in(path) == told["after"][1]
    assert digest_in(tmp_path / "run.previous") == kept[1]
