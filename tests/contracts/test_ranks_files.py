"""A checkpoint is the same to the byte whoever writes it: one process, or any number of ranks."""

import hashlib
import json
import zipfile

import numpy as np
import pytest
from support.ranks import CASES, told_by_script
from support.selection import long_but

import mpsim

pytestmark = pytest.mark.slow

LARGE = {"count": 200_001, "packing": 0.4, "radius": 0.5, "boundary": "periodic", "seed": 3}
"""Of four chunks, the last one of a few thousand discs; with image flags."""

WRITTEN = """
import hashlib, json, sys, warnings, mpsim
from pathlib import Path
from mpi4py import MPI
from support.ranks import CASES

warnings.simplefilter("ignore")
path, name, workers, lattice = sys.argv[1:]
comm, given = MPI.COMM_WORLD, {"method": "mpi", "workers": int(workers) or None}
if name == "large":
    scene, settings = mpsim.Scene.lattice(**json.loads(lattice)), {"dt": 0.02}
else:
    scene, settings, *_ = CASES[name]()
with mpsim.Simulation(scene, mpsim.Settings(**settings, **given)) as sim:
    sim.run(frames=4)
    sim.save(path)
    digest = sim.digest()
if comm.rank == 0:
    print(json.dumps([digest, hashlib.sha256(Path(path).read_bytes()).hexdigest()]))
"""


def written(number, path, name, workers=0):
    return told_by_script(number, str(path), name, str(workers), json.dumps(LARGE), script=WRITTEN)


def alone(path, name, lattice=LARGE):
    """The file that one process writes."""
    if name == "large":
        scene, settings = mpsim.Scene.lattice(**lattice), {"dt": 0.02}
    else:
        scene, settings, *_ = CASES[name]()
    with mpsim.Simulation(scene, mpsim.Settings(**settings, method="grid")) as sim:
        sim.run(frames=4)
        sim.save(path)
        return sim.digest()


def parts_of(path):
    """The header but for what says who has written, and all else by name, in the order of the file."""
    with zipfile.ZipFile(path) as file:
        assert file.testzip() is None
    found = np.load(path)
    members = {name: (array := found[name]).dtype.str.encode() + array.tobytes() for name in found.files}
    header = json.loads(found["mpsim_checkpoint"].tobytes())
    for name in ("method", "workers"):
        del header["settings"][name]
    del members["digest"], members["mpsim_checkpoint"]
    return header, members


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::mpsim.errors.EmitterWarning")  # whose disc waits
@pytest.mark.parametrize("name", ["large", "doors", "everything", "rough torus"])
@pytest.mark.parametrize("numbers", [[(1, 0), (2, 0)], [(3, 0), (4, 0), (2, 4)]])
def test_a_checkpoint_has_the_same_bytes_on_any_number_of_ranks(name, numbers, tmp_path):
    digest, told = alone(tmp_path / "one", name), {}
    header, members = parts_of(tmp_path / "one")
    assert len(members) > 6
    for number, workers in numbers:
        path = tmp_path / f"{number}-{workers}"
        told[number, workers] = written(number, path, name, workers)
        assert told[number, workers][0] == digest
        found, others = parts_of(path)
        assert found == header
        assert list(others) == list(members)
        assert others == members
        with mpsim.Simulation.resume(path, method="grid") as sim:
            assert sim.digest() == digest
    files = {told[each][1] for each in numbers if not each[1]}
    assert len(files) == 1, "whole files, to the byte"


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
