"""The first rank writes the files of all: what fails there is an error on all and loses nothing."""

import json

import pytest
from support.ranks import told_by_script

import mpsim

pytestmark = pytest.mark.slow

LATTICE = {"count": 140_000, "packing": 0.4, "radius": 0.5, "seed": 3}
"""Of three chunks."""

HEAD = """
import contextlib, errno, hashlib, json, os, resource, signal, sys, time, mpsim
from pathlib import Path
from mpi4py import MPI
from support.ranks import tell

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
if comm.rank == 0:
    print(json.dumps(told))
"""
)

FAILURES = {
    "too large": "File too large",
    "fsync": "Input/output error",
    "rename": "Permission denied",
}


def digest_in(path):
    with mpsim.Simulation.resume(path, method="grid") as sim:
        return sim.digest()


def test_what_fails_on_one_rank_is_an_error_on_all_and_what_was_there_is_untouched(tmp_path):
    """The control: the same ranks save before and after."""
    path, cases = tmp_path / "run", ("before", "once more", *FAILURES, "after")
    told = told_by_script(2, str(path), json.dumps(LATTICE), *cases, script=TOGETHER)
    kept, previous = told["once more"], told["before"]
    assert kept[0] == ["saved"] * 2
    assert previous[2] != kept[2]
    for case, reason in FAILURES.items():
        one, other = told[case][0]
        assert one == other, "all are told the same"
        assert one.startswith("OutputError the checkpoint "), (case, one)
        assert f"got {reason}. What was there before is untouched" in one
        assert told[case][2] == kept[2], case
        assert told[case][3] == ["run", "run.previous"], case
    assert told["after"][0] == ["saved"] * 2
    assert digest_in(path) == told["after"][1]
    assert digest_in(tmp_path / "run.previous") == kept[1]
