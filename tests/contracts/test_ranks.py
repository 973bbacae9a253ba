"""The same bits on any number of ranks as in one process, with whatever they can do; and files between the two."""

import json
import re
from functools import cache

import pytest
from support.pages import ROOT
from support.ranks import CASES, content_of, found, on_ranks, told_by_script
from support.scenes import gas, simulate
from support.selection import long_but

import mpsim

pytestmark = pytest.mark.slow

DEFAULT = ("bare", "doors")


@cache
def alone(name):
    """What one process finds."""
    return found(name, method="grid")


def told_by(number, names, workers=1):
    """What so many ranks find, each with so many workers."""
    done = on_ranks(number, str(workers), *names)
    assert done.code == 0, done.err
    return json.loads(done.out.splitlines()[-1])


@pytest.mark.parametrize("name", long_but((*DEFAULT, "everything"), "bare"))  # doors by ranks with workers, below
@pytest.mark.parametrize("number", long_but((1, 2, 3, 4, 8), 2))
def test_ranks_find_what_one_process_finds(number, name):
    assert told_by(number, [name])[name] == alone(name)


OTHERS = [name for name in CASES if name not in DEFAULT]


@pytest.mark.long
@pytest.mark.parametrize(
    ("number", "workers", "names"),
    [
        *((number, 1, OTHERS) for number in (2, 3, 4, 8)),
        *((*each, ["doors"]) for each in ((2, 2), (1, 3), (3, 2), (4, 4))),
    ],
    ids=str,
)
def test_ranks_with_any_number_of_workers_find_it_in_other_scenes(number, workers, names):
    assert told_by(number, names, workers) == {name: alone(name) for name in names}


WRONG = """
import json, sys
import numpy as np
from mpi4py import MPI
from mpsim.engine.solvers.ranks.subdomain import Subdomain
from support.ranks import found

right, before = Subdomain.column_at, {{}}

def wrong(part, border):
    sent = right(part, border).copy()
    return {wrong}

Subdomain.column_at = wrong
told = found("bare", method="mpi")
if MPI.COMM_WORLD.rank == 0:
    print(json.dumps(told))
"""
LATE = "[before.get('it', sent), before.update(it=sent)][0]"


@pytest.mark.parametrize("wrong", long_but(["sent[:0]", LATE], LATE), ids=["left out", "late"])
def test_a_column_that_is_left_out_or_late_changes_the_digest(wrong):
    """The control: no column in any step, or that of the step before."""
    assert told_by_script(2, script=WRONG.format(wrong=wrong))["digest"] != alone("bare")["digest"]


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
import json, sys
import mpsim
from mpi4py import MPI
from mpsim.engine.solvers.ranks import subdomain
from support.ranks import found

subdomain.SPARE, subdomain.FEWEST = 1.0, 4
told = found("corner", method="mpi", workers=int(sys.argv[1]))
if MPI.COMM_WORLD.rank == 0:
    print(json.dumps(told))
"""


@pytest.mark.parametrize("workers", long_but([1, 2], 2))
def test_ranks_make_room_in_the_middle_of_a_step(workers):
    """Discs that spread from a corner: the other rank begins with few, and has half of them in the end."""
    assert told_by_script(2, str(workers), script=GROWING) == alone("corner")


BALANCED = """
import json, sys
import mpsim
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
if MPI.COMM_WORLD.rank == 0:
    print(json.dumps([max(most) * MPI.COMM_WORLD.size / scene.count, digest]))
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
        told_by_script(ranks, name, str(finer), *how, script=BALANCED) for ranks, *how in told
    )
    assert digest == other == whole
    assert shifting < 1.3 < static


SESSION = """
import json, sys, warnings
import mpsim
from mpi4py import MPI
from support.sessions import play, stage

warnings.simplefilter("ignore")

def played(**settings):
    with mpsim.Simulation(stage(), mpsim.Settings(dt=0.025, **settings)) as sim:
        play(sim)
        journal = sim.journal
        with mpsim.Simulation.replay(journal, workers=settings.get("workers")) as again:
            replayed = again.digest()
        return [sim.digest(), sim.count, sim.time, int(sim.state.present.sum()), len(journal), replayed]

told = [played(method="mpi", workers=int(sys.argv[1])), played(method="grid")]
if MPI.COMM_WORLD.rank == 0:
    print(json.dumps(told))
"""


@pytest.mark.long
@pytest.mark.parametrize("workers", [1, 2])
def test_a_session_with_every_change_has_the_bits_of_one_process(workers):
    on_two, alone_there = told_by_script(2, str(workers), script=SESSION)
    assert on_two == alone_there
    assert on_two[0] == on_two[5]


CORRELATIONS = """
import json, sys, mpsim
from mpi4py import MPI
from support.scenes import gas

folder, comm = sys.argv[1], MPI.COMM_WORLD
scene = gas(60, 0.3, seed=2, boundary="periodic")
found = mpsim.Correlations(every=2, wave_numbers=[1.0], path=f"{folder}/c.npz")
with mpsim.Simulation(scene, mpsim.Settings(dt=0.05, method="mpi", contact="push"), comm=comm) as sim:
    sim.run(frames=40, observe=found, checkpoint=f"{folder}/run")
told = comm.gather([function.value.tolist() for function in (found.msd, found.velocity, found.scattering(1.0))])
if comm.rank == 0:
    print(json.dumps(told))
"""


@pytest.mark.long
def test_each_rank_has_the_correlations_of_one_process_and_one_of_them_writes_the_file(tmp_path):
    """As JSON: what the ranks gathered, and what is in the file of the first one."""
    alone = mpsim.Correlations(every=2, wave_numbers=[1.0])
    with simulate(gas(60, 0.3, seed=2, boundary="periodic"), dt=0.05, method="grid") as sim:
        sim.run(frames=40, observe=alone)
    expected = [function.value.tolist() for function in (alone.msd, alone.velocity, alone.scattering(1.0))]
    assert told_by_script(2, str(tmp_path), script=CORRELATIONS) == [expected] * 2
    assert mpsim.Correlations.load(tmp_path / "c.npz").msd.value.tolist() == expected[0]
