"""Checkpoints on ranks: another file where one rank looks is an error on all, and SIGTERM to all writes one file."""

import json
import shutil

import pytest
from support.checkpoints import rewrite, saved
from support.ranks import on_ranks, told_by_script
from support.scenes import gas
from support.selection import long_but

import mpsim

pytestmark = pytest.mark.slow

RESUMED = """
import json, sys, mpsim
from pathlib import Path
from mpi4py import MPI
from mpsim.core import files
from mpsim.engine import checkpoint

comm, path, folder = MPI.COMM_WORLD, Path(sys.argv[1]), Path(sys.argv[2])
opened, digest_of, identity = files.opened, checkpoint.digest_of, checkpoint._identity
others = {"shared": path, "copied": folder / "copied", "damaged": folder / "damaged", "other": folder / "other",
          "missing": folder / "missing", "control": folder / "damaged"}
verified = []

def noted(*given):
    verified.append(comm.rank)
    return digest_of(*given)

def outcome():
    try:
        with mpsim.Simulation.resume(path, method="mpi") as sim:
            sim.run(frames=20)
            return sim.digest()
    except mpsim.CheckpointError as error:
        return " ".join([str(error), *error.__notes__])

checkpoint.digest_of, told = noted, {}
for what, other in others.items():
    verified.clear()
    if comm.rank == 1:  # which has another file under that name
        files.opened = lambda asked: opened(other if Path(asked) == path else asked)
    checkpoint._identity = (lambda file: ()) if what == "control" else identity
    told[what] = comm.allgather(outcome()), sum(comm.allgather(verified), [])
if comm.rank == 0:
    print(json.dumps(told))
"""


def test_a_copy_that_one_rank_sees_is_verified_there_and_its_damage_is_an_error_on_all(tmp_path):
    """The control: ranks that take a copy for the file that the first one has verified, and go on with other bits."""
    start, path, damaged = gas(300, 0.3), saved(tmp_path / "run", gas(300, 0.3)), tmp_path / "damaged"
    for name in ("copied", "damaged"):
        shutil.copy2(path, tmp_path / name)
    saved(tmp_path / "other", start, frames=4)

    def change(header, arrays):
        arrays["solver.velocity"][-1] *= 1.5  # a disc of the second rank's

    rewrite(damaged, change, right_digest=False)
    told = told_by_script(2, str(path), str(tmp_path), script=RESUMED)
    with mpsim.Simulation.resume(path) as sim:
        sim.run(frames=20)
        whole = sim.digest()
    assert told["shared"] == [[whole, whole], [0]], "only the first rank reads a file through that all share"
    assert told["copied"] == [[whole, whole], [0, 1]]
    for what, words in (
        ("damaged", "its content does not match its digest."),
        ("other", "it is another file."),
        ("missing", "there is no such file."),
    ):
        one, other = told[what][0]
        assert one == other, "all ranks are told the same"
        assert one.startswith(f"the checkpoint {str(path)!r} must be the same file on all ranks; on "), one
        assert words in one, one
        assert one.endswith("on rank 1"), one
    one, other = told["control"][0]
    assert one == other != whole


ENDED = """
import json, os, signal, sys, mpsim
from pathlib import Path
from mpi4py import MPI
from mpsim.engine import checkpoint
from support.scenes import gas

comm, path, when, writes = MPI.COMM_WORLD, Path(sys.argv[1]), sys.argv[2], []
pids, write = comm.allgather(os.getpid()), checkpoint.write

def end(*ranks):
    for rank in ranks:
        os.kill(pids[rank], signal.SIGTERM)

def counted(*given):
    writes.append(comm.rank)
    if when == "while it is written":
        end(0, 1)
    return write(*given)

def at(done, frames):
    if done > 30 and comm.rank == 0 and not writes:
        end(*([0, 1] if when == "at once" else [0]))

checkpoint.write = counted
with mpsim.Simulation(gas(500, 0.3), mpsim.Settings(method="mpi", dt=0.01)) as sim:
    try:
        sim.run(frames=10**9, checkpoint=path, checkpoint_every=10**8, progress=at)
    except SystemExit as end_of_job:
        told = comm.allgather((end_of_job.code, sim.frame))
    told = [told, sum(comm.allgather(writes), [])]
if comm.rank == 0:
    print(json.dumps(told))
"""


@pytest.mark.parametrize("when", long_but(["at once", "while it is written"], "at once"))
def test_sigterm_to_all_ranks_writes_one_checkpoint(when, tmp_path):
    """As batch systems send it: to each rank, which has it a little sooner or later than others."""
    path = tmp_path / "run"
    done = on_ranks(2, str(path), when, script=ENDED, bound=60)
    assert done.code == 0, done.err
    ended, writes = json.loads(done.out.splitlines()[-1])
    assert writes == [0], "by the first rank, once"
    assert [each.name for each in tmp_path.iterdir()] == ["run"], "and none before it"
    with mpsim.Simulation.resume(path, method="grid") as sim:
        assert ended == [[143, sim.frame]] * 2
