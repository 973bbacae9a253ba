"""Workers of the exact solver that die, and Ctrl-C while they play windows: no bit changes, and nothing is left."""

import functools
import os
import random
import signal

import pytest
from support.compare import assert_same_bits
from support.internals import solver_of
from support.killing import Killer, repeat_until_killed
from support.scenes import gas
from support.tiles import always_tiled, first_free_place, on_tiles, windows_of

import mpsim
from mpsim.engine import run_record
from mpsim.engine.solvers import event_windows
from mpsim.engine.solvers.event_windows import Windows
from mpsim.engine.workers import pool

# 3.12: fork in a process with threads
pytestmark = pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")

COUNT, FRAMES, DT = 3000, 400, 0.125
NAMES = ("pressure", "collision_rate", "kinetic_energy")


def scene():
    return gas(COUNT, 0.4, seed=2)


def tiled(workers=3, dt=DT, **settings):
    """A simulation on workers; by fork, which starts them in the shortest time."""
    return on_tiles(scene(), (2, 2), workers, dt=dt, start_method="fork", **settings)


@functools.cache
def undisturbed(frames=FRAMES, dt=DT):
    """State, measures and collisions of the run of one process in which nobody dies."""
    with on_tiles(scene(), (1, 1), dt=dt) as sim:
        report = sim.run(frames=frames, measures=NAMES)
        return sim.state, values(report), report.collisions


def values(report):
    return {name: repr(each) for name, each in report.measures.items()}


# --- deaths


def test_a_worker_that_dies_in_a_window_ends_the_run_by_default():
    with tiled() as sim, Killer(sim, lambda: 0.1, most=1) as killer:
        with pytest.raises(mpsim.WorkerDiedError, match="SIGKILL"):
            sim.run(frames=10**9)
        with pytest.raises(mpsim.errors.ClosedError):
            sim.run(frames=1)
    assert killer.deaths == 1


def test_a_worker_that_dies_between_runs_is_noticed():
    with tiled() as sim:
        sim.run(frames=3)
        os.kill(sim.pids[1], signal.SIGKILL)
        with pytest.raises(mpsim.WorkerDiedError):
            sim.run(frames=FRAMES)


@pytest.mark.slow
def test_workers_that_die_at_random_moments_are_replaced_and_change_nothing(figures):
    expected, measures, collisions = undisturbed()

    def experiment(killing):
        with tiled(on_worker_death="restart") as sim, killing(sim), always_tiled(2, 2):
            report = sim.run(frames=FRAMES, measures=NAMES)
            assert_same_bits(sim.state, expected, "healed")
            assert len(sim.pids) == 2
            assert (values(report), report.collisions, sim.frame) == (measures, collisions, FRAMES)

    deaths = repeat_until_killed(experiment, lambda: random.uniform(0.02, 0.15), least=2, most=4)
    figures.note(
        "R9", "event on 3", "workers killed at random moments", "state and measures of 1", f"the same after {deaths}"
    )


@pytest.mark.slow
def test_a_run_that_forgot_to_rewind_would_be_noticed(monkeypatch):
    """The control."""
    expected, measures, _ = undisturbed()
    monkeypatch.setattr(run_record.RunRecord, "rewind", lambda self, mark: setattr(self, "done", mark.done))
    found = []

    def experiment(killing):
        with tiled(on_worker_death="restart") as sim, killing(sim), always_tiled(2, 2):
            report = sim.run(frames=FRAMES, measures=NAMES)
            assert_same_bits(sim.state, expected, "healed")
            found.append(values(report))

    repeat_until_killed(experiment, lambda: 0.1, most=2)
    assert found[-1] != measures


def test_workers_stay_the_same_when_discs_are_added_or_changed():
    """Starting others takes a second or two, and an emitter adds discs in frame after frame."""
    with on_tiles(scene(), (2, 1), 2, dt=DT) as sim:
        sim.run(frames=2)
        pids = sim.pids
        sim.add([first_free_place(sim.state)], [[1.0, 2.0]])
        sim.run(frames=2)
        sim.kick(0, (1.0, 0.0))
        sim.run(frames=2)
        assert sim.pids == pids
        assert len(pids) == 1


def test_a_death_before_discs_are_added_is_healed():
    states = []
    for workers in (1, 3):
        with tiled(workers, on_worker_death="restart") as sim, always_tiled(2, 2):
            sim.run(frames=20)
            free = first_free_place(sim.state)
            if workers > 1:
                os.kill(sim.pids[0], signal.SIGKILL)
            sim.add([free], [[1.0, 2.0]])
            sim.run(frames=20)
            states.append(sim.state)
    assert_same_bits(states[1], states[0], "grown after a death")
    assert len(states[0].position) == COUNT + 1


# --- Ctrl-C


@pytest.mark.parametrize("dt", [0.01, 20.0])
def test_an_interrupted_run_goes_on_with_the_same_bits(dt, alarm):
    """Ctrl-C comes between short frames, or inside long ones."""
    with tiled(2, dt) as sim:
        pids = sim.pids
        for attempt in range(4):
            with pytest.raises(KeyboardInterrupt), alarm(0.03 + attempt * 0.0137):
                sim.run(frames=10**9)
            frames = sim.frame
            assert frames * dt <= sim.time <= (frames + 1) * dt
            assert sim.state.position.shape == (COUNT, 2)
        sim.run(frames=2)
        assert sim.pids == pids
        assert windows_of(sim)["windows"] > 4
        state = sim.state
    assert_same_bits(state, undisturbed(frames + 2, dt)[0], f"interrupted four times, last in frame {frames}")


@pytest.mark.parametrize("name", ["order_by_tiles", "link", "run_windows"])
def test_an_interrupt_as_a_kernel_returns_leaves_the_state_whole(name, monkeypatch, tmp_path):
    kernel, pressed = getattr(event_windows, name), []

    def interrupted(*arguments):
        outcome = kernel(*arguments)
        pressed.append(1)
        if len(pressed) == 1:
            signal.raise_signal(signal.SIGINT)
        return outcome

    monkeypatch.setattr(event_windows, name, interrupted)
    with tiled(2) as sim:
        with pytest.raises(KeyboardInterrupt):
            run_and_copy(sim, 40, tmp_path)
        while sim.frame < 40:
            run_and_copy(sim, 40 - sim.frame, tmp_path)
        assert_same_bits(sim.state, undisturbed(40)[0], f"interrupted as {name} returned")
    assert pressed


def run_and_copy(sim, frames, folder):
    """Frames in two halves; what is saved in between links the store, and what follows orders it again."""
    sim.run(frames=frames // 2)
    sim.save(folder / "run")
    sim.run(frames=frames - frames // 2)


def test_ctrl_c_between_a_death_and_its_report_closes_a_state_that_is_no_state(monkeypatch):
    """The window was given up half-way. What lies in the block must not pass for a result."""
    settle = pool.WorkerPool.settle

    def settle_and_interrupt(self):
        settle(self)
        if self._lost is not None:
            raise KeyboardInterrupt

    monkeypatch.setattr(pool.WorkerPool, "settle", settle_and_interrupt)
    half = 0
    for attempt in range(10):
        with tiled(2) as sim, Killer(sim, lambda pause=0.05 + 0.01 * attempt: pause, most=1):
            with pytest.raises(KeyboardInterrupt):
                sim.run(frames=10**6)
            try:
                frame, state = sim.frame, sim.state
            except mpsim.errors.ClosedError:
                half += 1
                break
            assert_same_bits(state, undisturbed(frame)[0], "a death behind the last window")
    assert half, "no worker has died inside a window, which tests nothing"


def test_windows_may_be_closed_again():
    with tiled(2) as sim:
        windows = solver_of(sim)._windows
        assert isinstance(windows, Windows)
        windows.close()
        windows.close()
        assert windows.pids == []
