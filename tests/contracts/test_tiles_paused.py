"""A command whose time is over leaves its window between two tiles; what the next one does changes no bit."""

import pytest
from support.compare import assert_same_bits
from support.internals import solver_of
from support.tiles import first_free_place, on_tiles, tallies, windows_of

import mpsim
from mpsim.engine.solvers import event_windows

FRAMES, DT = 12, 0.25
TILING = (3, 2)
SCENE = mpsim.Scene.random(count=3000, radius=0.5, packing=0.4, seed=2)


pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def no_time(monkeypatch):
    """Every command of a simulation on tiles then plays one tile for each worker."""
    monkeypatch.setattr(event_windows, "PATIENCE", 0)


@pytest.fixture(scope="module")
def as_a_whole():
    with on_tiles(SCENE, (1, 1), dt=DT) as sim:
        counted = tallies(sim, FRAMES)
        return sim.state, counted, sim.time


def plan_of(sim):
    return solver_of(sim)._block.arrays["plan"]


def leave_a_window(sim):
    """One command: it leaves the window in hand after its first tiles."""
    windows = windows_of(sim)["windows"]
    assert len(solver_of(sim).advance(FRAMES, sim.settings.workers).times[0]) == 0
    assert plan_of(sim)["paused"] == 1
    assert windows_of(sim)["windows"] == windows


@pytest.mark.parametrize("workers", [1, 2, 3])
def test_a_window_that_is_played_in_many_commands_has_the_same_bits_and_counts(workers, as_a_whole):
    expected, counted, _ = as_a_whole
    with on_tiles(SCENE, TILING, workers, dt=DT) as sim:
        leave_a_window(sim)
        found = tallies(sim, FRAMES)
        assert_same_bits(sim.state, expected, f"{workers} workers")
        assert found.tobytes() == counted.tobytes(), "other counts"
        assert windows_of(sim)["as_one"] == 0, "one worker has found them"


def test_the_state_inside_a_window_that_was_left_is_the_one_before_it(as_a_whole):
    with on_tiles(SCENE, TILING, dt=DT) as sim:
        before = sim.state
        leave_a_window(sim)
        assert_same_bits(sim.state, before, "inside a window")
        sim.run(frames=FRAMES)
        assert_same_bits(sim.state, as_a_whole[0], "afterwards")


@pytest.mark.parametrize("frames", [1, 2, 5])
def test_a_command_of_fewer_frames_plans_anew(frames):
    with on_tiles(SCENE, TILING, dt=DT / 128) as sim, on_tiles(SCENE, (1, 1), dt=DT / 128) as whole:
        leave_a_window(sim)
        assert plan_of(sim)["frames"] > 5, "a window of more frames"
        sim.run(frames=frames)
        whole.run(frames=frames)
        assert (sim.frame, sim.time) == (whole.frame, whole.time)
        assert_same_bits(sim.state, whole.state, f"{frames} frames")


@pytest.mark.parametrize("stop", [DT / 8, DT / 2])
def test_a_stop_inside_a_window_that_was_left_plans_anew(stop):
    with on_tiles(SCENE, TILING, dt=DT) as sim, on_tiles(SCENE, (1, 1), dt=DT) as whole:
        leave_a_window(sim)
        for each in (sim, whole):
            solver = solver_of(each)
            while not solver.reached(stop):
                solver.advance(FRAMES, 1, stop)
        assert sim.time == whole.time == stop
        assert_same_bits(sim.state, whole.state, f"at {stop}")


@pytest.mark.parametrize("workers", [1, 2])
def test_a_checkpoint_of_a_window_that_was_left_goes_on_with_the_same_bits(workers, tmp_path, as_a_whole):
    expected, _, _ = as_a_whole
    with on_tiles(SCENE, TILING, workers, dt=DT) as sim:
        sim.run(frames=3)
        leave_a_window(sim)
        path = sim.save(tmp_path / "run")
        sim.run(frames=FRAMES - 3)
        assert_same_bits(sim.state, expected, "after it was saved")
    with mpsim.Simulation.resume(path) as again:
        again.run(frames=FRAMES - 3)
        assert_same_bits(again.state, expected, "resumed")


def one_more(tiling, leave):
    with on_tiles(SCENE, tiling, dt=DT) as sim:
        sim.run(frames=2)
        if leave:
            leave_a_window(sim)
        sim.add(position=[first_free_place(sim.state)], velocity=[[1.0, 2.0]])
        sim.run(frames=4)
        return sim.state


def test_a_window_that_was_left_is_forgotten_as_a_disc_enters():
    assert_same_bits(one_more(TILING, True), one_more((1, 1), False), "a disc more")


def test_control_a_window_without_a_tile_that_was_played_is_noticed():
    """What goes on is the window that was left: a tile that was counted as played and was not, is one too few."""
    with on_tiles(SCENE, TILING, dt=DT) as sim:
        leave_a_window(sim)
        plan_of(sim)["next"][...] += 1
        sim.run(frames=1)
        assert windows_of(sim)["again"] > 0
