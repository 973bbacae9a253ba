"""The same bits on any number of ranks as in one process, with whatever they can do; and files between the two."""

import hashlib
import json
import re
from functools import cache

import pytest
from support.pages import ROOT
from support.ranks import CASES, content_of, found, on_ranks, told_by
from support.scenes import gas, simulate
from support.selection import long_but

import mpsim

pytestmark = pytest.mark.slow

DEFAULT = ("bare", "doors")


@cache
def alone(name):
    """What one process finds."""
    return found(name, method="grid")


@pytest.mark.parametrize("name", long_but((*DEFAULT, "everything"), "bare"))
@pytest.mark.parametrize("number", long_but((1, 2, 3, 4, 8), 2))
def test_ranks_find_what_one_process_finds(number, name):
    assert told_by(number, name)[name] == alone(name)


@pytest.mark.long
@pytest.mark.parametrize("name", [name for name in CASES if name not in DEFAULT])
def test_any_number_of_ranks_finds_it_in_other_scenes(name):
    for number in (2, 3, 4, 8):
        assert told_by(number, name)[name] == alone(name), f"{number} ranks"


WRONG = """
from mpsim.engine.solvers.ranks.subdomain import Subdomain
from support.ranks import found, report

right, before = Subdomain.column_at, {{}}

def wrong(part, border):
    sent = right(part, border).copy()
    return {wrong}

Subdomain.column_at = wrong
report(found("bare", method="mpi"))
"""
LATE = "[before.get('it', sent), before.update(it=sent)][0]"


@pytest.mark.parametrize("wrong", long_but(["sent[:0]", LATE], LATE), ids=["left out", "late"])
def test_a_column_that_is_left_out_or_late_changes_the_digest(wrong):
    """The control: no column in any step, or that of the step before."""
    assert told_by(2, script=WRONG.format(wrong=wrong))["digest"] != alone("bare")["digest"]


SAVED = """
import sys, warnings, mpsim
from mpi4py import MPI
from support.ranks import CASES

warnings.simplefilter("ignore")
path, what, name = sys.argv[1:]
case = CASES[name]()
if what == "save":
    with mpsim.Simulation(case.scene, mpsim.Settings(**case.settings, method="mpi")) as sim:
        sim.run(frames=20)
        sim.save(path)
else:
    with mpsim.Simulation.resume(path, method="mpi") as sim:
        sim.run(frames=case.frames - 20)
        digest = sim.digest()
        if MPI.COMM_WORLD.rank == 0:
            print(digest)
"""


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", long_but(["bare", "everything", "rough torus", "doors"], "bare"))
def test_a_checkpoint_goes_from_ranks_to_workers_and_back(name, tmp_path):
    case, whole = CASES[name](), alone(name)["digest"]
    of_ranks, of_one = tmp_path / "ranks.mpsim", tmp_path / "one.mpsim"
    saved = on_ranks(2, str(of_ranks), "save", name, script=SAVED)
    assert saved.code == 0, saved.err
    for method in ({"method": "grid"}, {"method": "parallel", "workers": 2}):
        with mpsim.Simulation.resume(of_ranks, **method) as sim:
            sim.run(frames=case.frames - 20)
            assert sim.digest() == whole
    with mpsim.Simulation(case.scene, mpsim.Settings(**case.settings, method="grid")) as sim:
        sim.run(frames=20)
        sim.save(of_one)
    assert content_of(of_ranks) == content_of(of_one)
    resumed = on_ranks(2, str(of_one), "resume", name, script=SAVED)
    assert resumed.code == 0, resumed.err
    assert resumed.out.split()[-1] == whole


@pytest.mark.long
def test_the_program_of_the_page_stops_and_goes_on(tmp_path):
    page = (ROOT / "docs" / "howto" / "cluster.md").read_text()
    program = re.search(r"```python\n(# gas\.py\n.*?)```", page, re.DOTALL)[1].replace("5_000", "500")

    def printed(number, frames, name):
        """What the program prints on so many ranks, with a number of frames and a checkpoint of its own."""
        changed = program.replace('200, Path("gas.mpsim")', f"{frames}, Path({str(tmp_path / name)!r})")
        assert changed != program
        done = on_ranks(number, script=changed)
        assert done.code == 0, done.err
        return done.out.split()

    whole = printed(2, 200, "whole")
    stopped = printed(2, 70, "parts")
    continued = printed(1, 200, "parts")
    assert (whole[0], stopped[0], continued[0]) == ("200", "70", "200")
    assert whole[-1] == continued[-1] != stopped[-1], "digests"
    assert printed(2, 200, "parts")[-1] == whole[-1], "all is done"


GROWING = """
from mpsim.engine.solvers.ranks import subdomain
from support.ranks import found, report

subdomain.SPARE, subdomain.FEWEST = 1.0, 4
report(found("corner", method="mpi"))
"""


def test_ranks_make_room_in_the_middle_of_a_step():
    """Discs that spread from a corner: the other rank begins with few, and has half of them in the end."""
    assert told_by(2, script=GROWING) == alone("corner")


BALANCED = """
import sys, mpsim
from mpi4py import MPI
from mpsim.engine.solvers.ranks import solver
from support import ranks

name, finer, uneven, method = sys.argv[1:]
solver.UNEVEN, case, finer = float(uneven), ranks.CASES[name](), int(finer)
scene = getattr(ranks, name)(case.scene.count * finer**2)
agree, most = solver.MpiRanks.agree, [0]

def noted(*given):
    agreed = agree(*given)
    most.append(agreed.discs)
    return agreed

solver.MpiRanks.agree = noted
with mpsim.Simulation(scene, mpsim.Settings(**case.settings, method=method)) as sim:
    sim.run(frames=case.frames * finer)
    digest = sim.digest()
ranks.report([max(most) * MPI.COMM_WORLD.size / scene.count, digest])
"""


@pytest.mark.long
@pytest.mark.parametrize(("number", "finer"), [(2, 1), (4, 2)])
@pytest.mark.parametrize("name", ["corner", "wandering"])
def test_ranks_share_a_crowd_evenly_in_every_step_and_with_the_same_bits(name, number, finer):
    """A crowd that spreads from a corner, and one that wanders. The control: columns that are never dealt anew.

    In one call of `run`, whose commands are as long as they will be. Four ranks have a crowd of twice as many columns:
    with the columns of two, a single one would be a third of a rank's share.
    """
    told = [(number, "1.1", "mpi"), (number, "inf", "mpi"), (1, "inf", "grid")]
    (shifting, digest), (static, other), (_, whole) = (
        told_by(ranks, name, str(finer), *how, script=BALANCED) for ranks, *how in told
    )
    assert digest == other == whole
    assert shifting < 1.3 < static


SESSION = """
import warnings, mpsim
from support.ranks import report
from support.sessions import play, stage

warnings.simplefilter("ignore")

def played(**settings):
    with mpsim.Simulation(stage(), mpsim.Settings(dt=0.025, **settings)) as sim:
        play(sim)
        journal = sim.journal
        with mpsim.Simulation.replay(journal) as again:
            replayed = again.digest()
        return [sim.digest(), sim.count, sim.time, int(sim.state.present.sum()), len(journal), replayed]

report([played(method="mpi"), played(method="grid")])
"""


@pytest.mark.long
def test_a_session_with_every_change_has_the_bits_of_one_process():
    on_two, alone_there = told_by(2, script=SESSION)
    assert on_two == alone_there
    assert on_two[0] == on_two[5]


CORRELATIONS = """
import sys, mpsim
from mpi4py import MPI
from support.ranks import report
from support.scenes import gas

folder, comm = sys.argv[1], MPI.COMM_WORLD
scene = gas(60, 0.3, seed=2, boundary="periodic")
found = mpsim.Correlations(every=2, wave_numbers=[1.0], path=f"{folder}/c.npz")
with mpsim.Simulation(scene, mpsim.Settings(dt=0.05, method="mpi", contact="push"), comm=comm) as sim:
    sim.run(frames=40, observe=found, checkpoint=f"{folder}/run")
report(comm.gather([function.value.tolist() for function in (found.msd, found.velocity, found.scattering(1.0))]))
"""


@pytest.mark.long
def test_each_rank_has_the_correlations_of_one_process_and_one_of_them_writes_the_file(tmp_path):
    """As JSON: what the ranks gathered, and what is in the file of the first one."""
    alone = mpsim.Correlations(every=2, wave_numbers=[1.0])
    with simulate(gas(60, 0.3, seed=2, boundary="periodic"), dt=0.05, method="grid") as sim:
        sim.run(frames=40, observe=alone)
    expected = [function.value.tolist() for function in (alone.msd, alone.velocity, alone.scattering(1.0))]
    assert told_by(2, str(tmp_path), script=CORRELATIONS) == [expected] * 2
    assert mpsim.Correlations.load(tmp_path / "c.npz").msd.value.tolist() == expected[0]


# --- no rank needs all discs: starts, frames, digests, measures, files and ranges take a share

READING = """
import sys, threading, warnings, numpy as np, mpsim
from mpi4py import MPI
from support.ranks import CASES, report

warnings.simplefilter("ignore")
case, comm = CASES[sys.argv[1]](), MPI.COMM_WORLD
with mpsim.Simulation(case.scene, mpsim.Settings(**case.settings, method="mpi")) as sim:
    sim.run(frames=30)
    whole, (numbers, own) = sim.state, sim.local_state()
    assert (own.position == whole.position[numbers]).all()
    assert (own.velocity == whole.velocity[numbers]).all()
    assert (np.diff(numbers) > 0).all()
    here = np.sort(np.concatenate(comm.allgather(numbers)))
    assert (here == np.flatnonzero(whole.present)).all(), "each disc is with one rank"
    part = sim.state_between(50, 170)
    assert (part.position == whole.position[50:170]).all()
    told = sim.once(lambda: [comm.rank, sim.digest(), sim.state_between(7, 9).position.tolist(), sim.state.digest()])
    assert told == [0, sim.digest(), whole.position[7:9].tolist(), whole.digest()]
    try:
        sim.once(lambda: 1 / (comm.rank * 0))
    except ZeroDivisionError:
        told = "raised"
    try:
        sim.once(lambda: lambda: 0)
    except TypeError as error:
        assert "sendable" in str(error)
    class Odd(Exception):
        def __init__(self, one, other):
            super().__init__(f"{one} {other}")

    def fail():
        raise Odd("an odd", "error")

    def refused(act):
        try:
            act()
        except Exception as error:
            return f"{type(error).__name__}: {error}"

    assert "Odd: an odd error" in refused(lambda: sim.once(fail))
    assert refused(lambda: sim.once(lambda: sim.run(3))).startswith("BusyError: what `once` calls may only read")
    assert refused(lambda: sim.once(lambda: sim.add([3, 3], [0, 0]))).startswith("BusyError")
    assert "must be the same on all ranks; got (0, 10), (1, 10)" in refused(lambda: sim.state_between(comm.rank, 10))
    assert refused(lambda: sim.run(3, checkpoint=f"{comm.rank}.mpsim")).startswith("InputError: arguments of run must")
    assert refused(lambda: sim.save(f"{comm.rank}.mpsim")).startswith("InputError: paths of checkpoints must")
    all_raised, read = comm.allgather(told), []

    def read_elsewhere(done, frames):
        thread = threading.Thread(target=lambda: read.append(refused(lambda: sim.state)))
        thread.start()
        thread.join()

    sim.run(1, progress=read_elsewhere)
    assert read[0].startswith("BusyError"), read
report([all_raised, whole.digest()])
"""


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", ["rough torus", "doors"])
def test_ranks_read_ranges_of_discs_and_what_the_first_one_does_once(name):
    raised, digest = told_by(2, name, script=READING)
    assert raised == ["raised", "raised"]
    case = CASES[name]()
    with mpsim.Simulation(case.scene, mpsim.Settings(**case.settings, method="grid")) as sim:
        sim.run(frames=30)
        assert sim.digest() == digest
        part = {name: value[50:170] for name, value in vars(sim.state).items() if hasattr(value, "shape")}
        assert sim.state_between(50, 170).digest() == mpsim.State(**part, box=sim.state.box).digest()


AT_A_TIME, AS_TEXT = 16e6, 32e6
"""Bytes that a rank needs beyond its share, however many discs there are, for those that it reads at a time, and of a
trajectory for their text."""
DISCS_OF_A_RANK = 600_000
MAPPED = 16
"""Bytes of a disc in a checkpoint, float32: the first rank reads the file through to verify it. Its pages are the
system's, which takes them back, but count as those of the process."""

MEMORY = """
import json, psutil, sys, mpsim
from mpi4py import MPI
from mpsim.core import columns

comm, count, path = MPI.COMM_WORLD, int(sys.argv[1]), sys.argv[2]
settings, peaks = mpsim.Settings(dt=0.02, method="mpi", precision="float32"), {}

def scene(count):
    return mpsim.Scene.lattice(count=count, packing=0.4, radius=0.5, seed=3)

def forget():
    with open("/proc/self/clear_refs", "w") as file:
        file.write("5")

def note(what):
    with open("/proc/self/status") as file:
        peak = next(int(line.split()[1]) * 1024 for line in file if line.startswith("VmHWM"))
    peaks[what] = max(comm.allgather((peak - before) / count))
    forget()

def life(count, note=lambda what: None):
    with mpsim.Simulation(scene(count), settings) as sim:
        note("start")
        sim.run(frames=3)
        note("frames")
        sim.digest()
        note("digest")
        sim.save(path)
        note("save")
        with mpsim.Trajectory.write(path + ".xyz", mode="w", comm=comm) as out:
            sim.run(frames=1, observe=out)
        note("trajectory")
        digest = sim.digest()
    forget()
    with mpsim.Simulation.resume(path, method="mpi") as sim:
        note("resume")
        sim.run(frames=1)
        assert sim.digest() == digest
        forget()
        columns.CHUNK = count
        sim.digest()
        note("digest at once")
    return digest

CHUNK = columns.CHUNK
life(3000)
columns.CHUNK = CHUNK
before = psutil.Process().memory_info().rss
forget()
digest = life(count, note)
if comm.rank == 0:
    print(json.dumps([digest, peaks]))
"""


@pytest.fixture
def memory_given_back(monkeypatch):
    """What is freed goes back to the system: else the C library keeps more or less of it, from one run to the next."""
    monkeypatch.setenv("MALLOC_MMAP_THRESHOLD_", str(2**17))


@pytest.mark.long
@pytest.mark.usefixtures("memory_given_back")
@pytest.mark.parametrize("number", [2, 4])
def test_memory_of_a_rank_falls_as_their_number_grows(number, tmp_path):
    """The control: a digest for which the first rank gets all discs at once."""
    count, path = DISCS_OF_A_RANK * number, str(tmp_path / "run")
    alone, shared = (told_by(each, str(count), path, script=MEMORY) for each in (1, number))
    assert alone[0] == shared[0], "digests"
    beyond = {what: (shared[1][what] - alone[1][what] / number) * count for what in alone[1]}
    assert beyond.pop("digest at once") > 1.5 * AT_A_TIME, beyond
    assert beyond.pop("trajectory") < AS_TEXT, beyond
    assert beyond.pop("resume") < AT_A_TIME + MAPPED * count, beyond
    assert max(beyond.values()) < AT_A_TIME, beyond


PATHS = """
import sys, mpsim
from mpi4py import MPI
from support.ranks import tell

path, rank = sys.argv[1], MPI.COMM_WORLD.rank
with mpsim.Simulation(mpsim.Scene.load("gas"), mpsim.Settings(method="mpi")) as sim:
    sim.save(path)
for wrong in (f"{path}{rank}", path + ".missing", 5):
    try:
        mpsim.Simulation.resume(wrong, method="mpi")
    except mpsim.MpsimError as error:
        tell(type(error).__name__, error)
"""


def test_ranks_that_are_given_other_files_or_none_are_told_so(tmp_path):
    done = on_ranks(2, str(tmp_path / "run"), script=PATHS)
    assert done.code == 0, done.err
    assert done.out.count("InputError paths of checkpoints must be the same on all ranks") == 2
    assert done.out.count("CheckpointError the checkpoint") == 2
    assert done.out.count("InputError the path of a checkpoint must be a file name; got 5") == 2


# --- files are the same to the byte whoever writes them: one process, or any number of ranks

LARGE = {"count": 200_001, "packing": 0.4, "radius": 0.5, "boundary": "periodic", "seed": 3}
"""Of four chunks, the last one of a few thousand discs; with image flags."""

WRITTEN = """
import hashlib, json, sys, mpsim
from pathlib import Path
from mpi4py import MPI

path, lattice = sys.argv[1:]
with mpsim.Simulation(mpsim.Scene.lattice(**json.loads(lattice)), mpsim.Settings(dt=0.02, method="mpi")) as sim:
    sim.run(frames=4)
    sim.save(path)
    digest = sim.digest()
if MPI.COMM_WORLD.rank == 0:
    print(json.dumps([digest, hashlib.sha256(Path(path).read_bytes()).hexdigest()]))
"""


@pytest.mark.long
@pytest.mark.parametrize("numbers", [(1, 2), (3, 4)])
def test_a_checkpoint_in_chunks_has_the_same_bytes_on_any_number_of_ranks(numbers, tmp_path):
    with mpsim.Simulation(mpsim.Scene.lattice(**LARGE), mpsim.Settings(dt=0.02, method="grid")) as sim:
        sim.run(frames=4)
        expected, digest = content_of(sim.save(tmp_path / "one")), sim.digest()
    files = set()
    for number in numbers:
        path = tmp_path / f"{number}"
        told = told_by(number, str(path), json.dumps(LARGE), script=WRITTEN)
        assert told[0] == digest
        assert content_of(path) == expected
        files.add(told[1])
        with mpsim.Simulation.resume(path, method="grid") as sim:
            assert sim.digest() == digest
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
    told, digest = told_by(number, str(tmp_path / "ranks.xyz"), json.dumps(some), script=FRAMES)
    with (
        mpsim.Simulation(mpsim.Scene.lattice(**some), mpsim.Settings(dt=0.02, method="grid")) as sim,
        mpsim.Trajectory.write(tmp_path / "one.xyz", 2) as out,
    ):
        sim.run(frames=6, observe=out)
    whole = (tmp_path / "one.xyz").read_bytes()
    assert hashlib.sha256(whole).hexdigest() == digest
    (total, most), *others = told
    assert (total, others) == (len(whole), [[0, 0]] * (number - 1))
    assert most < 0.3 * len(whole) / 4
