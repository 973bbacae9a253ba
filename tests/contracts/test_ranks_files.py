"""A checkpoint is the same to the byte whoever writes it: one process, or any number of ranks."""

import hashlib
import json

import pytest
from support.ranks import content_of, told_by_script
from support.selection import long_but

import mpsim

pytestmark = pytest.mark.slow

LARGE = {"count": 200_001, "packing": 0.4, "radius": 0.5, "boundary": "periodic", "seed": 3}
"""Of four chunks, the last one of a few thousand discs; with image flags."""

WRITTEN = """
import hashlib, json, sys, mpsim
from pathlib import Path
from mpi4py import MPI

path, workers, lattice = sys.argv[1:]
settings = mpsim.Settings(dt=0.02, method="mpi", workers=int(workers) or None)
with mpsim.Simulation(mpsim.Scene.lattice(**json.loads(lattice)), settings) as sim:
    sim.run(frames=4)
    sim.save(path)
    digest = sim.digest()
if MPI.COMM_WORLD.rank == 0:
    print(json.dumps([digest, hashlib.sha256(Path(path).read_bytes()).hexdigest()]))
"""


@pytest.mark.long
@pytest.mark.parametrize("numbers", [[(1, 0), (2, 0)], [(3, 0), (4, 0), (2, 4)]])
def test_a_checkpoint_in_chunks_has_the_same_bytes_on_any_number_of_ranks(numbers, tmp_path):
    with mpsim.Simulation(mpsim.Scene.lattice(**LARGE), mpsim.Settings(dt=0.02, method="grid")) as sim:
        sim.run(frames=4)
        expected, digest = content_of(sim.save(tmp_path / "one")), sim.digest()
    files = {}
    for number, workers in numbers:
        path = tmp_path / f"{number}-{workers}"
        told = told_by_script(number, str(path), str(workers), json.dumps(LARGE), script=WRITTEN)
        assert told[0] == digest
        assert content_of(path) == expected
        files.setdefault(workers, set()).add(told[1])
        with mpsim.Simulation.resume(path, method="grid") as sim:
            assert sim.digest() == digest
    assert len(files[0]) == 1, "whole files, to the byte"


FRAMES = """
import hashlib, json, sys, mpsim
from pathlib import Path
from mpi4py import MPI
from mpsim.output import xyz

path, lattice = sys.argv[1:]
comm, lengths, text = MPI.COMM_WORLD, [], xyz.text_of

def noted(frame):
    for part in text(frame):
        lengths.append(len(part))
        yield part

xyz.text_of = noted
scene, settings = mpsim.Scene.lattice(**json.loads(lattice)), mpsim.Settings(dt=0.02, method="mpi")
with mpsim.Simulation(scene, settings) as sim:
    with mpsim.Trajectory.write(path, 2, comm=comm) as out:
        sim.run(frames=4, observe=out)
    assert out.frames == 3
    with mpsim.Trajectory.write(path, 2, mode="a", comm=comm) as out:
        sim.run(frames=2, observe=out)
told = comm.gather([sum(lengths), max(lengths, default=0)])
if comm.rank == 0:
    print(json.dumps([told, hashlib.sha256(Path(path).read_bytes()).hexdigest()]))
"""


@pytest.mark.parametrize("number", long_but([1, 2, 4], 2))
@pytest.mark.parametrize("boundary", long_but(["walls", "periodic"], "walls"))
def test_frames_of_extended_xyz_have_the_same_bytes_on_any_number_of_ranks(number, boundary, tmp_path):
    """Of five parts; the first rank, which writes them, holds the text of one."""
    some = LARGE | {"count": 90_001, "boundary": boundary}
    told, digest = told_by_script(number, str(tmp_path / "ranks.xyz"), json.dumps(some), script=FRAMES)
    settings = mpsim.Settings(dt=0.02, method="grid")
    with (
        mpsim.Simulation(mpsim.Scene.lattice(**some), settings) as sim,
        mpsim.Trajectory.write(tmp_path / "one.xyz", 2) as out,
    ):
        sim.run(frames=6, observe=out)
    whole = (tmp_path / "one.xyz").read_bytes()
    assert hashlib.sha256(whole).hexdigest() == digest
    (total, most), *others = told
    assert (total, others) == (len(whole), [[0, 0]] * (number - 1))
    assert most < 0.3 * len(whole) / 4
