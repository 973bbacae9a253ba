"""What ranks are said to send, beside what they send; and the model of larger machines."""

import json
import math
from pathlib import Path

import pytest
from support.ranks import on_ranks, told_by_script
from support.scripts import fixture_of

pytestmark = pytest.mark.slow

script = fixture_of("run_ranks")

SCRIPTS = Path(__file__).parents[2] / "scripts"

COUNTED = f"""
import json, sys
sys.path.insert(0, {str(SCRIPTS)!r})
import run_ranks
from mpi4py import MPI

run_ranks.FRAMES, run_ranks.RUNS = 1_000_000, 2
found = run_ranks.frame_seconds(10_000, {{"method": "mpi"}})
if MPI.COMM_WORLD.rank == 0:
    print(json.dumps(found))
"""


def test_what_ranks_send_is_what_the_formulas_say(script):
    done = on_ranks(2, script=COUNTED)
    assert done.code == 0, done.err
    seconds, sent = json.loads(done.out.splitlines()[-1])
    counted, said = script.Sent(*sent), script.expected(10_000)
    assert seconds > 0
    assert counted.border_messages == said.border_messages == 1
    assert counted.border_bytes == pytest.approx(said.border_bytes, rel=0.1)
    assert counted.migration_bytes == pytest.approx(said.migration_bytes, rel=0.4), "few discs, of 24 bytes each"
    assert counted.reductions == said.reductions == 1


def test_the_model_without_costs_is_ideal_and_with_them_ends(script):
    free = script.Model(disc=1e-8, step=0.0, network=script.Network(0.0, math.inf))
    assert free.rest(1e6, 1) == 0
    assert free.rest(1e6, 100) == pytest.approx(2 * 1e-8 * math.sqrt(4e6 * 0.4 / math.pi)), (
        "both sides resolve a border"
    )
    slow = script.Model(disc=1e-8, step=1e-3, network=script.Network())
    assert slow.efficiency(1e6, 1) == pytest.approx(0.01 / 0.011)
    assert slow.efficiency(1e6, 64) < 0.5 < slow.efficiency(1e6, 4)
    assert slow.most_ranks(1e6) == 8
    assert free.most_ranks(1e6) == 512, "a column of 1,401 for each rank at least, and what both sides do"


BETWEEN = f"""
import json, sys
sys.path.insert(0, {str(SCRIPTS)!r})
import mpsim, run_ranks
from mpi4py import MPI
from mpsim.engine.solvers.mpi_ranks import Communicator

frames, boundary, found = 100, sys.argv[1], []
exchange = Communicator.exchange

def counted(ranks, parts):
    found.extend(part.nbytes for _, _, part in parts)
    return exchange(ranks, parts)

scene = mpsim.Scene.random(count=10_000, packing=run_ranks.PACKING, radius=0.5, seed=1, boundary=boundary)
settings = mpsim.Settings(dt=run_ranks.STEP, precision="float32", method="mpi")
with mpsim.Simulation(scene, settings) as sim:
    sim.run(frames=30)
    Communicator.exchange, deal = counted, Communicator.deal
    Communicator.deal = lambda ranks, records, *others: (  # discs that go are not border columns
        setattr(Communicator, "exchange", exchange),
        deal(ranks, records, *others),
        setattr(Communicator, "exchange", counted),
    )[1]
    sim.run(frames=frames)
told = MPI.COMM_WORLD.gather([len(found) / frames, sum(found) / frames])
if MPI.COMM_WORLD.rank == 0:
    print(json.dumps(told))
"""


@pytest.mark.parametrize(
    ("boundary", "borders", "longer"),
    [("walls", [1, 2, 1], 0), pytest.param("periodic", [2, 2, 2], 16, marks=pytest.mark.long)],
)
def test_each_rank_of_three_sends_a_column_at_each_of_its_borders_as_long_as_the_formula_says(
    boundary, borders, longer, script
):
    """Whatever the number of ranks: the one in the middle has two borders, and between walls the others have one.

    longer: bytes of a disc, for the image flags of periodic axes.
    """
    told = told_by_script(3, boundary, script=BETWEEN)
    assert [messages for messages, _ in told] == borders
    column = script.expected(10_000).border_bytes * (1 + longer / script.RECORD)
    for messages, sent in told:
        assert sent == pytest.approx(messages * column, rel=0.1)
