"""What was saved on some workers goes on with the same bits on others, elsewhere, and from inside a frame."""

import os
import signal

import pytest
from support.checkpoints import assert_goes_on_inside_a_frame, in_parts
from support.compare import assert_same_bits
from support.scenes import crowd, gas, lattice, simulate, state_after

import mpsim

FRAMES = 24
SETTINGS = {"dt": 0.02, "substeps": 2}

pytestmark = pytest.mark.compiled


@pytest.mark.parametrize("workers", [1, 3])
def test_a_run_that_is_resumed_on_other_numbers_of_workers_has_the_same_bits(workers, tmp_path):
    scene = crowd(400, 0.8, seed=1)
    expected = state_after(scene, FRAMES, method="grid", **SETTINGS)
    state = in_parts(scene, tmp_path / "run", (7, 6, 11), 2, 1, method="parallel", workers=workers, **SETTINGS)
    assert_same_bits(state, expected, f"resumed on 2 and 1 after {workers} workers")


@pytest.mark.parametrize("method", ["parallel", "event", "auto"])
def test_after_restore_and_in_a_branch_any_number_of_workers_has_the_same_bits(method):
    with simulate(lattice(30, 30), method=method, workers=2, dt=0.02) as sim:
        sim.run(frames=5)
        snap, pids = sim.snapshot(), sim.pids
        sim.run(frames=9)
        expected = sim.state
        for change in (lambda: sim.kick(7, impulse=(3, 1)), lambda: sim.change(workers=1)):
            sim.restore(snap)
            change()
            sim.run(frames=9)
            if "workers" not in sim.journal.changes[-1].values:
                assert sim.digest() != expected.digest(), "the control: what was done matters"
        sim.restore(snap)
        assert len(sim.pids) == len(pids)
        sim.run(frames=9)
        assert_same_bits(sim.state, expected, f"{method} after restore")
    for workers in (1, 3):
        with mpsim.Simulation.from_snapshot(snap, workers=workers) as branch:
            branch.run(frames=9)
            assert_same_bits(branch.state, expected, f"a branch by {method} on {workers}")


def test_restore_keeps_the_workers_and_heals_after_the_death_of_one():
    with simulate(lattice(30, 30), method="parallel", workers=2, on_worker_death="restart") as sim:
        snap, pids = sim.snapshot(), sim.pids
        sim.run(frames=9)
        expected = sim.digest()
        sim.restore(snap)
        assert sim.pids == pids
        os.kill(pids[0], signal.SIGKILL)
        sim.run(frames=9)
        assert (sim.digest(), sim.pids != pids) == (expected, True)
        os.kill(sim.pids[0], signal.SIGKILL)
        sim.restore(snap)
        sim.run(frames=9)
        assert sim.digest() == expected


IN_A_DRUM = mpsim.Scene.random(
    count=2000, width=110, height=110, radius=0.5, temperature=4.0, seed=1, inside=mpsim.Circle((55, 55), 50),
    obstacles=mpsim.FixedDisc((55, 55), 4, motion=mpsim.Rotation((55, 55), rate=1)),
)  # fmt: skip


def played_in_a_drum(sim, folder=None, drum=True, paddle=True):
    """The last state and the work of a run in which a drum is put up, and a paddle takes the place of a peg."""
    sim.run(frames=5)
    if drum:
        sim.add_wall(mpsim.Circle((55, 55), 51.5, inside=True, motion=mpsim.Oscillation((1, 0), period=2)))
    sim.run(frames=20)
    rotor = mpsim.Polyline([(51.5, 55), (58.5, 55)], 0.25, motion=mpsim.Rotation((55, 55), rate=1))
    sim.change(obstacles=[*[rotor] * paddle, *sim.scene.obstacles[1:]])
    sim.run(frames=40)
    if folder is not None:
        sim = mpsim.Simulation.resume(sim.save(folder / "run"), workers=1)
    with sim:
        sim.run(frames=20)
        return sim.state, sim.work


@pytest.mark.slow
@pytest.mark.parametrize("method", ["parallel", "event"])
def test_obstacles_that_come_and_go_have_the_same_bits_on_other_workers_and_after_resume(method, tmp_path):
    def played(workers, *how, **without):
        with simulate(IN_A_DRUM, method=method, workers=workers, dt=0.02) as sim:
            assert len(sim.pids) == workers - 1
            return played_in_a_drum(sim, *how, **without)

    expected, work = played(1)
    assert min(abs(work[1]), abs(work[2])) > 1, "both do work"
    for workers, *how in ((2,), (3,), (1, tmp_path), (2, tmp_path)):
        state, done = played(workers, *how)
        assert_same_bits(state, expected, f"{method} on {workers}, resumed on 1: {how != []}")
        assert done == work
    for without in ("drum", "paddle"):
        assert played(1, **{without: False})[0].digest() != expected.digest(), f"the {without} is not met"


def test_auto_goes_on_with_the_method_it_had(tmp_path):
    for scene in (gas(100, 0.5, seed=2), gas(900, 0.5, seed=2)):
        expected = state_after(scene, FRAMES, method="auto", workers=2)
        state = in_parts(scene, tmp_path / "run", (10, 14), 3, method="auto", workers=2)
        assert_same_bits(state, expected, f"auto with {scene.count} discs")


def test_an_exact_run_that_was_stopped_inside_a_frame_is_resumed_there(tmp_path):
    whole, begun = (simulate(lattice(9, 9), method="event", dt=50.0) for _ in range(2))
    names = ["pressure", "collision_rate"]
    assert_goes_on_inside_a_frame(whole, begun, mpsim.Simulation.resume, 0, tmp_path / "run", names)
