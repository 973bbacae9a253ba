"""Workers of the exact solver that die, and Ctrl-C while they play windows: no bit changes, and nothing is left."""

import functools
import os
import random
import signal
import threading

import pytest
from support.compare import assert_same_bits
from support.killing import Killer, repeat_until_killed
from support.scenes import gas
from support.selection import long_but
from support.tiles import always_tiled, first_free_place, on_tiles

import mpsim

pytestmark = [
    pytest.mark.compiled,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore:This process:DeprecationWarning"),  # 3.12: fork in a process with threads
]

COUNT, FRAMES, DT = 3000, 400, 0.125
NAMES = ("pressure", "collision_rate", "kinetic_energy")


def tiled(workers=3, dt=DT, **settings):
    """A simulation on workers; by fork, which starts them in the shortest time."""
    return on_tiles(gas(COUNT, 0.4, seed=2), (2, 2), workers, dt=dt, start_method="fork", **settings)


@functools.cache
def undisturbed(frames=FRAMES, dt=DT):
    """State, measures and collisions of the run of one process in which nobody dies."""
    with on_tiles(gas(COUNT, 0.4, seed=2), (1, 1), dt=dt) as sim:
        report = sim.run(frames=frames, measures=NAMES)
        return sim.state, values(report), report.collisions


def values(report):
    return {name: repr(each) for name, each in report.measures.items()}


def test_a_worker_that_dies_in_a_window_or_between_runs_ends_the_run_by_default():
    with tiled() as sim, Killer(sim, lambda: 0.1, most=1) as killer:
        with pytest.raises(mpsim.WorkerDiedError, match="SIGKILL"):
            sim.run(frames=10**9)
        with pytest.raises(mpsim.errors.ClosedError):
            sim.run(frames=1)
    assert killer.deaths == 1
    with tiled() as sim:
        sim.run(frames=3)
        os.kill(sim.pids[1], signal.SIGKILL)
        with pytest.raises(mpsim.WorkerDiedError):
            sim.run(frames=FRAMES)


def test_workers_that_die_at_random_moments_are_replaced_and_change_nothing():
    expected, measures, collisions = undisturbed()

    def experiment(killing):
        with tiled(on_worker_death="restart") as sim, killing(sim), always_tiled(2, 2):
            report = sim.run(frames=FRAMES, measures=NAMES)
            assert_same_bits(sim.state, expected, "healed")
            assert len(sim.pids) == 2
            assert (values(report), report.collisions, sim.frame) == (measures, collisions, FRAMES)

    repeat_until_killed(experiment, lambda: random.uniform(0.02, 0.15), least=2, most=4)


def test_workers_stay_the_same_when_discs_are_added_or_changed_and_a_death_before_it_is_healed():
    """Starting others takes a second or two, and an emitter adds discs in frame after frame."""
    states = []
    for workers in (1, 3):
        with tiled(workers, on_worker_death="restart") as sim, always_tiled(2, 2):
            sim.run(frames=2)
            pids = sim.pids
            sim.add([first_free_place(sim.state)], [[1.0, 2.0]])
            sim.run(frames=2)
            sim.kick(0, (1.0, 0.0))
            sim.run(frames=2)
            assert sim.pids == pids
            free = first_free_place(sim.state)
            for pid in sim.pids[:1]:
                os.kill(pid, signal.SIGKILL)
            sim.add([free], [[1.0, 2.0]])
            sim.run(frames=20)
            states.append(sim.state)
    assert_same_bits(states[1], states[0], "grown after a death")
    assert len(states[0].position) == COUNT + 2


@pytest.mark.parametrize("dt", long_but([0.01, 20.0], 20.0))
def test_a_run_that_is_interrupted_between_short_frames_or_inside_long_ones_goes_on_with_the_same_bits(dt, tmp_path):
    with tiled(2, dt) as sim:
        pids = sim.pids
        for attempt in range(4):
            threading.Timer(0.03 + attempt * 0.0137, os.kill, (os.getpid(), signal.SIGINT)).start()
            with pytest.raises(KeyboardInterrupt):
                sim.run(frames=10**9)
            frames = sim.frame
            assert frames * dt <= sim.time <= (frames + 1) * dt
            assert sim.state.position.shape == (COUNT, 2)
            sim.save(tmp_path / "run")
        sim.run(frames=2)
        assert sim.pids == pids
        state = sim.state
    assert_same_bits(state, undisturbed(frames + 2, dt)[0], f"interrupted four times, last in frame {frames}")
