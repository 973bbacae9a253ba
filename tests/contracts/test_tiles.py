"""The exact solver finds the same bits in whatever tiles it plays the box, on any number of workers."""

import functools
import math
import os
import signal

import numpy as np
import pytest
from support.checkpoints import assert_goes_on_inside_a_frame
from support.compare import assert_same_bits
from support.internals import solver_of
from support.scenes import simulate
from support.selection import long_but
from support.tiles import (
    always_tiled,
    assert_played_on_tiles,
    everything,
    first_free_place,
    on_tiles,
    tallies,
    windows_of,
)

import mpsim
from mpsim.engine import run
from mpsim.engine.solvers import event_tiles

pytestmark = [pytest.mark.compiled, pytest.mark.slow, pytest.mark.timeout(300)]

COUNT = 3000
INDEX = np.arange(COUNT)
SIZES = np.where(INDEX % 3 == 0, 0.5, 0.375)
MASSES = np.where(INDEX % 3 == 0, 2.0, 0.5)
ROUGH = {"friction": 0.5, "wall_friction": 0.25, "tangential_restitution": 0.5, "restitution": 0.9}

SCENES = {
    "walls": {},
    "periodic x": {"boundary": ("periodic", "walls")},
    "periodic y": {"boundary": ("walls", "periodic")},
    "periodic": {"boundary": "periodic"},
    "gravity": {"gravity": (0.25, -1.0)},
    "sizes and masses": {"radius": SIZES, "mass": MASSES, "boundary": ("periodic", "walls")},
    "losses": {"restitution": 0.9, "wall_restitution": 0.8, "boundary": "periodic"},
    "rough": {**ROUGH, "spin": (INDEX % 5 - 2) / 2},
    "absorbing": {"absorbing": ("left", "top"), "gravity": (0.25, -1.0)},
    "thermal walls": {"thermal_walls": mpsim.ThermalWalls(left=4.0, right=4.0, bottom=4.0, top=4.0, seed=5)},
    "everything": everything(COUNT),
}  # fmt: skip
TILINGS = [(2, 1), (1, 2), (2, 2), (3, 2), (4, 1)]
FRAMES, DT = 24, 0.125


@functools.cache
def scene_of(name, packing=0.4):
    return mpsim.Scene.random(count=COUNT, packing=packing, seed=2, **{"radius": 0.5, **SCENES[name]})


@functools.cache
def as_a_whole(name, frames=FRAMES, dt=DT):
    """State, and what was counted in each frame, of a box that is played as a whole."""
    with on_tiles(scene_of(name), (1, 1), dt=dt) as sim:
        counted = tallies(sim, frames)
        return sim.state, counted


def assert_as_a_whole(sim, name, note, frames=FRAMES, dt=DT):
    """Run, and fail unless the state, and the counts of every frame, are those of a box that is played as a whole."""
    expected, counted = as_a_whole(name, frames, dt)
    assert counted["collisions"].sum() > COUNT, "too few collisions to tell anything"
    found = tallies(sim, frames)
    assert_same_bits(sim.state, expected, note)
    assert found.tobytes() == counted.tobytes(), f"{note}: other counts"


@pytest.mark.parametrize("name", long_but(SCENES, "walls"))
def test_every_tiling_and_number_of_workers_finds_the_same_bits(name):
    for tiling, workers in [*((each, 1) for each in TILINGS), ((3, 2), 2), ((3, 2), 3), ((3, 2), 5)]:
        with on_tiles(scene_of(name), tiling, workers, dt=DT) as sim:
            assert len(sim.pids) == workers - 1
            assert_as_a_whole(sim, name, f"{name} in {tiling} on {workers}")
            assert_played_on_tiles(sim)


@pytest.mark.parametrize("dt", long_but([0.001, 3.0], 3.0))
def test_frames_far_shorter_and_far_longer_than_a_window_have_the_same_bits(dt):
    frames = 2000 if dt < 1 else 3
    with on_tiles(scene_of("walls"), (2, 2), 2, dt=dt) as sim:
        assert_as_a_whole(sim, "walls", f"frames of {dt}", frames, dt)
        played = windows_of(sim)["windows"]
        assert played < frames / 10 if dt < 1 else played > 2 * frames


def test_laps_and_windows_are_cut_by_commands_without_a_trace():
    expected, _ = as_a_whole("walls", 60, 0.05)
    for workers, parts in ((1, [60]), (1, [7, 11, 42]), (3, [1] * 60)):
        with on_tiles(scene_of("walls"), (2, 2), workers, dt=0.05) as sim:
            for frames in parts:
                sim.run(frames=frames)
                sim.digest()
            assert_same_bits(sim.state, expected, f"commands of {parts} frames")


@pytest.mark.long
@pytest.mark.parametrize(("packing", "boundary"), [(0.3, "walls"), (0.65, "periodic")])
def test_a_scene_that_the_solver_divides_by_itself_has_the_same_bits(packing, boundary):
    scene = mpsim.Scene.random(count=20_000, packing=packing, radius=0.5, seed=4, boundary=boundary)
    with on_tiles(scene, (1, 1), dt=0.1) as sim:
        report = sim.run(frames=15)
        expected = sim.state
    for workers in (2, 3):
        with simulate(scene, method="event", workers=workers, dt=0.1) as sim:
            assert len(sim.pids) == workers - 1, "the box is not divided"
            assert sim.run(frames=15).collisions == report.collisions
            assert_same_bits(sim.state, expected, f"20,000 discs on {workers} workers")
            assert_played_on_tiles(sim)


def cradle(count=60, side=61.0):
    """A row of discs that touch, across the box, hit at one end; others keep the calendar busy."""
    row = [[1.5 + i, side / 2] for i in range(1, count - 1)]
    places = [[1.0, side / 2], *row]
    velocity = [[4.0, 0.0]] + [[0.0, 0.0]] * len(row)
    grid = [[x, y] for x in np.arange(2, side - 1, 2.0) for y in np.arange(2, side - 1, 2.0) if abs(y - side / 2) > 3]
    around = np.random.default_rng(7).normal(size=(len(grid), 2)) * 0.1
    return mpsim.Scene(
        width=side, height=side, position=places + grid, velocity=np.concatenate([velocity, around]), radius=0.5
    )


def test_a_blow_that_crosses_all_tiles_at_once_is_noticed_and_played_by_one():
    scene = cradle()
    with on_tiles(scene, (1, 1), dt=0.05) as sim:
        sim.run(frames=4)
        assert sim.state.velocity[58].tolist() == [4.0, 0.0], "the blow has come to the other end"
        sim.run(frames=36)
        expected = sim.state
    with on_tiles(scene, (3, 1), 2, dt=0.05) as sim:
        sim.run(frames=40)
        found = windows_of(sim)
        assert_same_bits(sim.state, expected, "a cradle")
    assert found["again"] >= 1
    assert found["as_one"] >= 1
    assert found["windows"] > found["again"] + found["as_one"]


# --- random scenes, and physics that must not notice tiles


def any_scene(seed, open_box):
    """Hundreds of discs with all that discs can have, and obstacles; in an open box, an edge that lets discs out."""
    rng = np.random.default_rng(seed)
    walls = [mpsim.Polyline(points, thickness=0.3) for points in rng.uniform(7.5, 42.5, (3, 2, 2)).tolist()]
    opening = {"obstacles": walls, "absorbing": "right", "boundary": "walls"} if open_box else {}
    count, temperature, gravity = int(rng.integers(300, 700)), float(rng.uniform(0.5, 4.0)), rng.normal(size=2)
    features = everything(count) | {"gravity": tuple(gravity.tolist()), **opening}
    return mpsim.Scene.random(count=count, width=50.0, height=50.0, seed=int(seed), temperature=temperature, **features)


def check_any_scene(seeds, open_box=False):
    """Play each scene as a whole and in some tiling, and compare states, counts, and who has left."""
    divided = left = 0
    for seed in seeds:
        rng = np.random.default_rng([seed, 1])
        tiling, dt = TILINGS[rng.integers(len(TILINGS))], float(rng.choice([0.05, 0.3, 1.0]))
        scene = any_scene(seed, open_box)
        with on_tiles(scene, (1, 1), dt=dt) as whole, on_tiles(scene, tiling, dt=dt) as sim:
            frames = int(3.0 / dt)
            assert whole.run(frames=frames).collisions == sim.run(frames=frames).collisions
            assert_same_bits(sim.state, whole.state, f"seed {seed} in {tiling}, dt {dt}")
            found = windows_of(sim)
            divided += found["windows"] - found["as_one"]
            left += int((~sim.state.present).sum())
    return divided, left


@pytest.mark.long
@pytest.mark.timeout(900)
@pytest.mark.filterwarnings("ignore::mpsim.errors.GuardWarning")  # of grains that come to rest
def test_two_hundred_random_scenes_are_the_same_on_tiles():
    check_any_scene(range(100))
    divided, left = check_any_scene(range(100, 200), open_box=True)
    assert divided > 500
    assert left > 500


# --- runs that are saved, resumed, stopped, grown or left inside a window

NAMES = ["pressure", "collision_rate"]
TILING = (3, 2)


@pytest.mark.parametrize("name", long_but(["walls", "everything"], "walls"))
def test_a_run_that_is_resumed_in_other_tiles_on_other_workers_has_the_same_bits(name, tmp_path):
    expected, counted = as_a_whole(name)
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
    assert collisions == counted["collisions"].sum() > COUNT


# --- commands whose time is over


@pytest.fixture
def no_time(monkeypatch):
    """Every command of a simulation on tiles then plays one tile for each worker; else it takes a slow machine."""
    monkeypatch.setattr(event_tiles, "PATIENCE", 0)


def test_a_run_that_is_saved_inside_a_frame_goes_on_there(tmp_path, no_time):
    def resume(path):
        with always_tiled(3, 1):
            return mpsim.Simulation.resume(path, workers=3)

    whole, begun = (on_tiles(scene_of("walls"), *how, dt=30.0) for how in (((1, 1),), ((2, 2), 2)))
    assert_goes_on_inside_a_frame(whole, begun, resume, 25, tmp_path / "run", NAMES)


def plan_of(sim):
    return solver_of(sim).block.arrays["plan"]


def leave_a_window(sim):
    """One command: it leaves the window in hand after its first tiles, and the state is the one before it."""
    windows, before = windows_of(sim)["windows"], sim.state
    assert len(solver_of(sim).advance(FRAMES, sim.settings.workers).times[0]) == 0
    assert plan_of(sim)["paused"] == 1
    assert windows_of(sim)["windows"] == windows
    assert_same_bits(sim.state, before, "inside a window")


@pytest.mark.parametrize("workers", long_but([1, 3], 3))
def test_a_window_that_is_played_in_many_commands_has_the_same_bits_and_counts(workers, no_time):
    expected, counted = as_a_whole("walls")
    with on_tiles(scene_of("walls"), TILING, workers, dt=DT) as sim:
        leave_a_window(sim)
        found = tallies(sim, FRAMES)
        assert_same_bits(sim.state, expected, f"{workers} workers")
        assert found.tobytes() == counted.tobytes(), "other counts"
        assert windows_of(sim)["as_one"] == 0, "one worker has found them"


def test_a_checkpoint_of_a_window_that_was_left_goes_on_with_the_same_bits(tmp_path, no_time):
    with on_tiles(scene_of("walls"), TILING, 2, dt=DT) as sim:
        sim.run(frames=3)
        leave_a_window(sim)
        path = sim.save(tmp_path / "run")
        sim.run(frames=FRAMES - 3)
        assert_same_bits(sim.state, as_a_whole("walls")[0], "after it was saved")
    with mpsim.Simulation.resume(path) as again:
        again.run(frames=FRAMES - 3)
        assert_same_bits(again.state, as_a_whole("walls")[0], "resumed")


def test_checkpoints_by_the_clock_let_a_window_end_that_takes_longer_than_they_wait(tmp_path, no_time):
    """Each of them drops the window in hand: were there one after every command, no window would ever end."""
    path = tmp_path / "run"
    with on_tiles(scene_of("walls"), TILING, dt=DT) as sim:
        sim.run(frames=FRAMES, checkpoint=path, checkpoint_seconds=1e-9)
        assert_same_bits(sim.state, as_a_whole("walls")[0], "with a checkpoint after each window")
    with mpsim.Simulation.resume(path) as sim:
        assert_same_bits(sim.state, as_a_whole("walls")[0], "the last checkpoint")


def test_windows_do_not_end_with_frames_that_nobody_watches(tmp_path, monkeypatch):
    """However slow the machine: it counted as one on which a frame takes longer than a command."""
    monkeypatch.setattr(run, "MOST_SECONDS", 0.0)
    played = []
    with mpsim.Trajectory.write(tmp_path / "watched.xyz", every=1) as watcher:
        for observer in (None, watcher):
            with on_tiles(scene_of("walls"), TILING, dt=DT / 8) as sim:
                sim.run(frames=8 * FRAMES, observe=observer)
                played.append(windows_of(sim)["windows"])
                assert_same_bits(sim.state, as_a_whole("walls")[0], f"watched: {observer}")
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


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("logged", long_but([False, True], False))
def test_commands_that_are_played_as_a_whole_or_on_tiles_by_turns_leave_no_trace(logged, workers, no_time):
    """Nor in the log of collisions and the work of belts, which take back what a window that was left has recorded."""
    belts = [mpsim.Piston("left", surface_velocity=2.0), mpsim.Piston("bottom", surface_velocity=-1.0)]
    more = {**ROUGH, "piston": belts} if logged else {}
    scene = mpsim.Scene.random(count=COUNT, packing=0.4, seed=2, radius=0.5, **more)
    outcomes = []
    for tiling, of_workers in (((1, 1), 1), (TILING, workers)):
        seen = mpsim.Collisions() if logged else None
        with always_tiled(*tiling), on_tiles(scene, tiling, of_workers, dt=DT) as sim:
            for fewest in (0.0, math.inf, 0.0, math.inf, math.inf, 0.0):  # collisions of a command that is worth tiles
                if tiling == TILING:
                    solver_of(sim)._windows.fewest_contacts = 0.0
                    leave_a_window(sim)
                    before, solver_of(sim)._windows.fewest_contacts = windows_of(sim)["windows"], fewest
                sim.run(frames=2, observe=seen)
                assert tiling != TILING or (windows_of(sim)["windows"] == before) == (fewest > 0)
            assert not logged or min(abs(each) for each in sim.work.values()) > 1
            counted = int(solver_of(sim)._system.store.counter.pairs)
            outcomes.append((sim.state, counted, sim.work, seen and seen.table.tobytes()))
    assert_same_bits(outcomes[1][0], outcomes[0][0], "by turns")
    assert outcomes[1][1:] == outcomes[0][1:]
    assert counted > COUNT


def test_a_worker_that_died_is_noticed_by_commands_that_need_none():
    with on_tiles(scene_of("walls"), TILING, 2, dt=DT / 8) as sim:
        sim.run(frames=1)
        solver_of(sim)._windows.fewest_contacts = math.inf
        os.kill(sim.pids[0], signal.SIGKILL)
        with pytest.raises(mpsim.WorkerDiedError, match="SIGKILL"):
            [sim.run(frames=1) for _ in range(10**5)]  # the word of it may be late


def test_a_window_without_a_tile_that_was_played_is_noticed(no_time):
    """The control. What goes on is the window that was left: one tile too few is missed."""
    with on_tiles(scene_of("walls"), TILING, dt=DT) as sim:
        leave_a_window(sim)
        plan_of(sim)["next"][...] += 1
        sim.run(frames=1)
        assert windows_of(sim)["again"] > 0
