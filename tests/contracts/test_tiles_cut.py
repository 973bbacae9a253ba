"""Runs on tiles that are saved, resumed, stopped, grown or left inside a window have the same bits."""

import itertools

import pytest
from support.compare import assert_same_bits
from support.internals import solver_of
from support.scenes import simulate
from support.selection import long_but
from support.tiles import always_tiled, everything, first_free_place, on_tiles, tallies, windows_of

import mpsim
from mpsim.engine import run
from mpsim.engine.solvers import event_tiles

pytestmark = [pytest.mark.compiled, pytest.mark.slow, pytest.mark.timeout(300)]

COUNT, FRAMES, DT = 3000, 24, 0.125
NAMES = ["pressure", "collision_rate"]
SCENES = {"walls": {"radius": 0.5}, "everything": everything(COUNT)}
TILING = (3, 2)


def scene_of(name):
    return mpsim.Scene.random(count=COUNT, packing=0.4, seed=2, **SCENES[name])


@pytest.fixture(scope="module")
def as_a_whole():
    """State, and what was counted in each frame, of the box that is played as a whole."""
    with on_tiles(scene_of("walls"), (1, 1), dt=DT) as sim:
        counted = tallies(sim, FRAMES)
        return sim.state, counted


@pytest.mark.parametrize("name", long_but(SCENES, "walls"))
def test_a_run_that_is_resumed_in_other_tiles_on_other_workers_has_the_same_bits(name, tmp_path):
    with on_tiles(scene_of(name), (1, 1), dt=DT) as sim:
        report = sim.run(frames=FRAMES)
        expected = sim.state
    path, collisions = tmp_path / "run", 0
    for part, (workers, tiling) in enumerate(((2, (2, 2)), (1, (1, 1)), (3, (2, 2)), (1, (3, 1)))):
        with always_tiled(*tiling):
            begun = None if part else simulate(scene_of(name), method="event", workers=workers, dt=DT)
            with begun or mpsim.Simulation.resume(path, workers=workers) as sim:
                assert len(sim.pids) == workers - 1
                collisions += sim.run(frames=FRAMES // 4).collisions
                sim.save(path)
                state = sim.state
    assert_same_bits(state, expected, name)
    assert collisions == report.collisions > COUNT


# --- commands whose time is over


@pytest.fixture
def no_time(monkeypatch):
    """Every command of a simulation on tiles then plays one tile for each worker; else it takes a slow machine."""
    monkeypatch.setattr(event_tiles, "PATIENCE", 0)


def test_a_run_that_is_saved_inside_a_frame_goes_on_there(tmp_path, no_time):
    """A frame far longer than a command is left by Ctrl-C, and goes on elsewhere."""
    calls = itertools.count()

    def interrupt(done, of):
        if next(calls) == 25:
            raise KeyboardInterrupt

    scene, dt = scene_of("walls"), 30.0
    with on_tiles(scene, (1, 1), dt=dt) as sim:
        report = sim.run(frames=2, measures=NAMES)
        expected = sim.state
    with on_tiles(scene, (2, 2), 2, dt=dt) as sim:
        with pytest.raises(KeyboardInterrupt):
            sim.run(frames=2, progress=interrupt)
        assert sim.frame == 0 < sim.time
        stopped = sim.time, sim.digest()
        sim.save(tmp_path / "run")
    with always_tiled(3, 1), mpsim.Simulation.resume(tmp_path / "run", workers=3) as sim:
        assert (sim.time, sim.digest()) == stopped
        found = sim.run(frames=2, measures=NAMES)
        assert_same_bits(sim.state, expected, "from inside a frame, on 3")
    for name in NAMES:
        assert found.measures[name].value == report.measures[name].value, "what the frame had counted is lost"


def plan_of(sim):
    return solver_of(sim)._block.arrays["plan"]


def leave_a_window(sim):
    """One command: it leaves the window in hand after its first tiles, and the state is the one before it."""
    windows, before = windows_of(sim)["windows"], sim.state
    assert len(solver_of(sim).advance(FRAMES, sim.settings.workers).times[0]) == 0
    assert plan_of(sim)["paused"] == 1
    assert windows_of(sim)["windows"] == windows
    assert_same_bits(sim.state, before, "inside a window")


@pytest.mark.parametrize("workers", long_but([1, 3], 3))
def test_a_window_that_is_played_in_many_commands_has_the_same_bits_and_counts(workers, as_a_whole, no_time):
    expected, counted = as_a_whole
    with on_tiles(scene_of("walls"), TILING, workers, dt=DT) as sim:
        leave_a_window(sim)
        found = tallies(sim, FRAMES)
        assert_same_bits(sim.state, expected, f"{workers} workers")
        assert found.tobytes() == counted.tobytes(), "other counts"
        assert windows_of(sim)["as_one"] == 0, "one worker has found them"


def test_a_checkpoint_of_a_window_that_was_left_goes_on_with_the_same_bits(tmp_path, as_a_whole, no_time):
    with on_tiles(scene_of("walls"), TILING, 2, dt=DT) as sim:
        sim.run(frames=3)
        leave_a_window(sim)
        path = sim.save(tmp_path / "run")
        sim.run(frames=FRAMES - 3)
        assert_same_bits(sim.state, as_a_whole[0], "after it was saved")
    with mpsim.Simulation.resume(path) as again:
        again.run(frames=FRAMES - 3)
        assert_same_bits(again.state, as_a_whole[0], "resumed")


def test_checkpoints_by_the_clock_let_a_window_end_that_takes_longer_than_they_wait(tmp_path, as_a_whole, no_time):
    """Each of them drops the window in hand: were there one after every command, no window would ever end."""
    path = tmp_path / "run"
    with on_tiles(scene_of("walls"), TILING, dt=DT) as sim:
        sim.run(frames=FRAMES, checkpoint=path, checkpoint_seconds=1e-9)
        assert_same_bits(sim.state, as_a_whole[0], "with a checkpoint after each window")
    with mpsim.Simulation.resume(path) as sim:
        assert_same_bits(sim.state, as_a_whole[0], "the last checkpoint")


def test_windows_do_not_end_with_frames_that_nobody_watches(tmp_path, as_a_whole, monkeypatch):
    """However slow the machine: it counted as one on which a frame takes longer than a command."""
    monkeypatch.setattr(run, "MOST_SECONDS", 0.0)
    played = []
    with mpsim.Trajectory.write(tmp_path / "watched.xyz", every=1) as watcher:
        for observer in (None, watcher):
            with on_tiles(scene_of("walls"), TILING, dt=DT / 8) as sim:
                sim.run(frames=8 * FRAMES, observe=observer)
                played.append(windows_of(sim)["windows"])
                assert_same_bits(sim.state, as_a_whole[0], f"watched: {observer}")
    assert played[1] >= 8 * FRAMES > 4 * played[0]


def test_a_window_that_was_left_is_forgotten_as_a_disc_enters(no_time):
    states = []
    for tiling in (TILING, (1, 1)):
        with on_tiles(scene_of("walls"), tiling, dt=DT) as sim:
            sim.run(frames=2)
            if tiling == TILING:
                leave_a_window(sim)
            sim.add(position=[first_free_place(sim.state)], velocity=[[1.0, 2.0]])
            sim.run(frames=4)
            states.append(sim.state)
    assert_same_bits(*states, "a disc more")


def test_a_window_without_a_tile_that_was_played_is_noticed(no_time):
    """The control. What goes on is the window that was left: one tile too few is missed."""
    with on_tiles(scene_of("walls"), TILING, dt=DT) as sim:
        leave_a_window(sim)
        plan_of(sim)["next"][...] += 1
        sim.run(frames=1)
        assert windows_of(sim)["again"] > 0
