"""Correlations in time have the same bits on any number of workers and ranks, and when a worker has died."""

import hashlib
import os
import signal

import pytest
from support.ranks import told_by_script
from support.scenes import crowd, gas, simulate

import mpsim

pytestmark = [pytest.mark.compiled, pytest.mark.long]

SCENE = gas(60, 0.3, seed=2, boundary="periodic")


def correlations():
    return mpsim.Correlations(every=2, wave_numbers=[1.0])


def digest_of(found):
    """A digest over all that was gathered."""
    functions = (found.msd, found.velocity, found.scattering(1.0))
    return hashlib.sha256(b"".join(each.value.tobytes() + each.error.tobytes() for each in functions)).hexdigest()


def after(scene, frames, **settings):
    found = correlations()
    with simulate(scene, **settings) as sim:
        sim.run(frames=frames, observe=found)
    return digest_of(found)


@pytest.mark.parametrize(("method", "alone"), [("parallel", "grid"), ("event", "event")])
def test_the_bits_are_the_same_on_any_number_of_workers(method, alone):
    expected = after(SCENE, 40, dt=0.05, method=alone)
    for workers in (2, 3):
        assert after(SCENE, 40, dt=0.05, method=method, workers=workers) == expected
    assert after(SCENE, 42, dt=0.05, method=alone) != expected


class Killing:
    """An observer that kills a worker once, and notes the processes that it sees."""

    every = 1

    def __init__(self):
        self.seen = []

    def observe(self, sim, collisions):
        if sim.frame == 31 and not any(frame == 31 for frame, _ in self.seen):
            os.kill(sim.pids[0], signal.SIGKILL)
        self.seen.append((sim.frame, tuple(sim.pids)))


def test_frames_that_are_done_again_after_a_death_are_not_taken_twice():
    scene, found, killing = crowd(200, 0.3, seed=4, boundary="periodic"), correlations(), Killing()
    settings = {"dt": 0.02, "method": "parallel", "workers": 2}
    with simulate(scene, **settings, on_worker_death="restart") as sim:
        sim.run(frames=60, observe=[found, killing])
    assert digest_of(found) == after(scene, 60, dt=0.02, method="grid")
    assert len({pids for _, pids in killing.seen}) == 2, "no worker was replaced"


RANKS = """
import hashlib, json, sys, mpsim
from mpi4py import MPI
from support.scenes import gas

folder, comm = sys.argv[1], MPI.COMM_WORLD
scene = gas(60, 0.3, seed=2, boundary="periodic")
found = mpsim.Correlations(every=2, wave_numbers=[1.0], path=f"{folder}/c.npz")
with mpsim.Simulation(scene, mpsim.Settings(dt=0.05, method="mpi", contact="push"), comm=comm) as sim:
    sim.run(frames=40, observe=found, checkpoint=f"{folder}/run")
functions = (found.msd, found.velocity, found.scattering(1.0))
digest = hashlib.sha256(b"".join(each.value.tobytes() + each.error.tobytes() for each in functions)).hexdigest()
digests = comm.gather(digest)
if comm.rank == 0:
    print(json.dumps(digests))
"""


def test_each_rank_has_the_averages_of_one_process_and_one_of_them_writes_the_file(tmp_path):
    digests = told_by_script(2, str(tmp_path), script=RANKS)
    assert digests == [after(SCENE, 40, dt=0.05, method="grid")] * 2
    assert digest_of(mpsim.Correlations.load(tmp_path / "c.npz")) == digests[0]
