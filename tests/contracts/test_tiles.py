"""The exact solver finds the same bits in whatever tiles it plays the box, on any number of workers."""

import contextlib
import functools
import itertools
import math

import numpy as np
import pytest
from support.compare import assert_same_bits
from support.scenes import simulate
from support.selection import long_but
from support.tiles import (
    assert_played_on_tiles,
    begin_with_long_windows,
    everything,
    has_lost_discs,
    on_tiles,
    play_without_comparing,
    tallies,
    tallies_of_a_command,
    windows_of,
)

import mpsim
from mpsim.core.cores import usable_cores
from mpsim.engine.solvers import event_windows

pytestmark = pytest.mark.slow

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
def test_every_tiling_finds_the_same_bits(name, figures):
    for tiling in TILINGS:
        with on_tiles(scene_of(name), tiling, dt=DT) as sim:
            assert_as_a_whole(sim, name, f"{name} in {tiling}")
            assert_played_on_tiles(sim)
    figures.note("R1", "event in tiles", f"{name}: {len(TILINGS)} tilings", "state and counts of one tile", "the same")


@pytest.mark.parametrize("name", long_but(SCENES, "walls", "everything"))
def test_every_number_of_workers_finds_the_same_bits(name, figures):
    for workers in (2, 3, 5) if name in ("walls", "periodic") else (3,):
        with on_tiles(scene_of(name), (3, 2), workers, dt=DT) as sim:
            assert len(sim.pids) == workers - 1
            assert_as_a_whole(sim, name, f"{name} on {workers} workers")
            assert_played_on_tiles(sim)
    figures.note("R1", f"event on up to {workers}", name, "state and counts of one process", "the same")


@pytest.mark.long
@pytest.mark.parametrize("name", SCENES)
def test_sixteen_tiles_have_the_same_bits_on_all_cores_of_the_machine(name):
    for workers in {5, 7, min(usable_cores(), 16)}:
        with on_tiles(scene_of(name), (4, 4), workers, dt=DT) as sim:
            assert_as_a_whole(sim, name, f"{name} on {workers} workers")
            assert_played_on_tiles(sim)


@pytest.mark.long
def test_discs_that_leave_in_tiles_are_out_of_the_way_and_never_forgotten():
    with on_tiles(scene_of("absorbing"), (3, 2), dt=DT) as sim:
        gone = []
        for _ in range(FRAMES):
            sim.run(frames=1)
            gone.append(np.flatnonzero(~sim.state.present))
            assert len(sim.state.position) == COUNT
            assert not has_lost_discs(sim)
    assert len(gone[0]) > 0
    assert len(gone[-1]) > len(gone[0]) + 50, "too few have left to tell anything"
    assert all(set(before) <= set(after) for before, after in itertools.pairwise(gone))


@pytest.mark.parametrize("dt", [0.001, 3.0])
def test_frames_far_shorter_and_far_longer_than_a_window_have_the_same_bits(dt):
    frames = 2000 if dt < 1 else 3
    with on_tiles(scene_of("walls"), (2, 2), 2, dt=dt) as sim:
        assert_as_a_whole(sim, "walls", f"frames of {dt}", frames, dt)
        played = windows_of(sim)["windows"]
        assert played < frames / 10 if dt < 1 else played > 2 * frames


def test_measures_are_the_same_on_any_number_of_workers():
    names, found = ["pressure", "pressure_xx", "collision_rate", "kinetic_energy"], []
    for tiling, workers in (((1, 1), 1), ((2, 2), 1), ((2, 2), 3)):
        with on_tiles(scene_of("walls"), tiling, workers, dt=DT) as sim:
            report = sim.run(frames=FRAMES, measures=names)
            found.append((report.collisions, {name: repr(each) for name, each in report.measures.items()}))
    assert found[0] == found[1] == found[2]


def test_many_commands_of_one_frame_have_the_same_bits():
    """Between two commands workers must neither miss one nor play one twice."""
    frames = 400
    expected, _ = as_a_whole("walls", frames, 0.01)
    with on_tiles(scene_of("walls"), (3, 2), 3, dt=0.01) as sim:
        for _ in range(frames):
            sim.run(frames=1)
        assert_same_bits(sim.state, expected, "a command a frame")
        assert windows_of(sim)["windows"] >= frames


def test_laps_and_windows_are_cut_by_commands_without_a_trace():
    expected, _ = as_a_whole("walls", 60, 0.05)
    for parts in ([60], [1, 59], [7, 11, 42], [20, 20, 20]):
        with on_tiles(scene_of("walls"), (2, 2), dt=0.05) as sim:
            for frames in parts:
                sim.run(frames=frames)
                sim.digest()
            assert_same_bits(sim.state, expected, f"commands of {parts} frames")


@pytest.mark.parametrize(("packing", "boundary"), long_but([(0.3, "walls"), (0.65, "periodic")], (0.3, "walls")))
def test_a_scene_that_the_solver_divides_by_itself_has_the_same_bits(packing, boundary, figures):
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
    figures.note("R1", "event on 2 and 3", f"20,000 discs, packing {packing}, {boundary}", "digest of 1", "the same")


def in_a_corner(count=900):
    """All discs in one tile of a box that is empty elsewhere; they spread into the others."""
    side = int(count**0.5)
    places = 1.25 * np.array(list(itertools.product(range(side), range(side)))) + 0.75
    velocity = np.random.default_rng(5).normal(size=(count, 2)) + 3.0
    return mpsim.Scene(width=90, height=90, position=places, velocity=velocity, radius=0.5)


@pytest.mark.parametrize("tiling", [(2, 2), (2, 1)])
def test_discs_that_all_begin_in_one_tile_outgrow_the_room_of_others(tiling):
    scene = in_a_corner()
    with on_tiles(scene, (1, 1), dt=0.25) as sim:
        report = sim.run(frames=80)
        expected = sim.state
    assert ((expected.position > 45).sum(axis=0) > 300).all(), "too few have come to the other tiles"
    with on_tiles(scene, tiling, 2, dt=0.25) as sim:
        found = sim.run(frames=80)
        assert_same_bits(sim.state, expected, "from one tile")
        assert found.collisions == report.collisions
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


@pytest.mark.parametrize("boundary", long_but(["walls", "periodic"], "walls"))
def test_equal_times_across_borders_have_the_same_bits(boundary):
    """A lattice whose rows collide in step: each instant has events in every tile."""
    grid = 2.0 * np.arange(44) + 1.5
    places = np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2)
    velocity = np.where((np.indices((44, 44)).sum(0) % 2).reshape(-1, 1) == 0, [1.0, 0.0], [-1.0, 0.0])
    scene = mpsim.Scene(width=88, height=88, position=places, velocity=velocity, radius=0.5, boundary=boundary)
    with on_tiles(scene, (1, 1), dt=0.25) as sim:
        collisions = sim.run(frames=60).collisions
        expected = sim.state
    assert collisions > 5 * scene.count
    for tiling, workers in (((2, 2), 1), ((4, 1), 1), ((3, 3), 2)):
        with on_tiles(scene, tiling, workers, dt=0.25) as sim:
            sim.run(frames=60)
            assert_same_bits(sim.state, expected, f"{boundary} in {tiling}")
            assert_played_on_tiles(sim)


def triples():
    """In each of many places two discs hit a third one, from the left and the right, at the same instant."""
    middles = np.stack(np.meshgrid(6.0 * np.arange(11) + 3, 3.0 * np.arange(16) + 1.5), -1).reshape(-1, 1, 2)
    places = (middles + np.array([[-2, 0], [0, 0], [2, 0]])).reshape(-1, 2)
    velocity = np.tile([[1.0, 0.0], [0.0, 0.0], [-1.0, 0.0]], (len(middles), 1))
    masses = np.tile([1.0, 2.0, 1.0], len(middles))
    return mpsim.Scene(width=66, height=48, position=places, velocity=velocity, mass=masses, radius=0.5)


@pytest.mark.long
def test_ties_that_matter_are_broken_alike_in_all_tiles():
    """Who of two is first at an instant changes what becomes of all three; a row of such threes is on a border."""
    scene = triples()
    with on_tiles(scene, (1, 1), dt=0.25) as sim:
        sim.run(frames=6)
        first = sim.state.velocity[:3, 0]
        assert not np.allclose(first, -first[::-1]), "the scene is its mirror image; its future must not be"
        sim.run(frames=42)
        expected = sim.state
    for tiling, workers in (((2, 1), 1), ((3, 1), 1), ((2, 2), 2)):
        with on_tiles(scene, tiling, workers, dt=0.25) as sim:
            sim.run(frames=48)
            assert_same_bits(sim.state, expected, f"ties in {tiling}")
            assert_played_on_tiles(sim)


# --- what must fail


@pytest.mark.parametrize("tiling", [(2, 2), (4, 1)])
def test_a_halo_too_thin_is_noticed_by_the_comparison_and_by_nothing_else(tiling):
    """The control: without a comparison along the borders, or with a thin halo, the bits are wrong."""
    expected, _ = as_a_whole("walls")
    with on_tiles(scene_of("walls"), tiling, dt=DT, halo=4) as sim:
        begin_with_long_windows(sim)
        sim.run(frames=FRAMES)
        found = windows_of(sim)
        assert_same_bits(sim.state, expected, "a halo of 4 cells")
    assert found["again"] + found["as_one"] > 0
    with on_tiles(scene_of("walls"), tiling, dt=DT, halo=4) as sim:
        play_without_comparing(sim, FRAMES, parts=1)
        assert has_lost_discs(sim) or sim.digest() != expected.digest()


def test_windows_that_are_not_compared_are_right_where_the_halo_is_wide():
    """The control of the control: by hand they are played as the solver plays them."""
    expected, _ = as_a_whole("walls")
    with on_tiles(scene_of("walls"), (2, 1), dt=DT, halo=20) as sim:
        play_without_comparing(sim, FRAMES, parts=32)
        assert_same_bits(sim.state, expected, "by hand")


# --- what has once been wrong


def heavy_and_fast(seed=0, ratio=1000.0, faster=10.0, packing=0.02):
    """A dilute gas, a tenth of it heavy and fast, which throws light discs far away."""
    rng, side = np.random.default_rng(seed), math.sqrt(COUNT * math.pi * 0.25 / packing)
    each = math.ceil(math.sqrt(COUNT))
    places = (np.stack(np.meshgrid(range(each), range(each)), -1).reshape(-1, 2)[:COUNT] + 0.5) * side / each
    places += rng.uniform(-0.4, 0.4, places.shape) * (side / each - 1.01)
    velocity, mass, heavy = rng.normal(size=(COUNT, 2)), np.ones(COUNT), rng.random(COUNT) < 0.1
    mass[heavy], velocity[heavy] = ratio, velocity[heavy] * faster
    return mpsim.Scene(width=side, height=side, position=places, velocity=velocity, radius=0.5, mass=mass)


def thrown_away():
    """Disc i moves towards j, which a heavy one throws far away before they meet; so i meets m instead."""
    spacing, each, (x, y) = 10.0, 30, (140.0, 150.0)
    places = (np.stack(np.meshgrid(range(each), range(each)), -1).reshape(-1, 2) + 0.5) * spacing
    i, j, m, beside, heavy = [x, y - 2.5], [x, y], [x, y + 2.5], [x, y - 3.55], [x - 11.5, y]
    velocity, mass = np.zeros((len(places) + 5, 2)), np.ones(len(places) + 5)
    velocity[-2:], mass[-1] = [[0, 1], [30, 0]], 1000
    places = np.concatenate([places, [i, j, m, beside, heavy]])
    size = each * spacing
    return mpsim.Scene(width=size, height=size, position=places, velocity=velocity, radius=0.5, mass=mass)


@pytest.mark.long
@pytest.mark.parametrize("make", [heavy_and_fast, thrown_away])
@pytest.mark.parametrize("tiling", [(2, 1), (2, 2)])
def test_a_partner_that_was_thrown_out_of_the_halo_is_found_out(make, tiling):
    frames, dt = (6, 2.0) if make is heavy_and_fast else (60, 0.1)
    with on_tiles(make(), (1, 1), dt=dt) as whole, on_tiles(make(), tiling, dt=dt, halo=4) as sim:
        assert whole.run(frames=frames).collisions == sim.run(frames=frames).collisions > 2
        assert_same_bits(sim.state, whole.state, f"{make.__name__} in {tiling}")


def before_a_crush():
    """A gas, and a disc between a wall of the box that moves and an obstacle."""
    places = np.stack(np.meshgrid(np.arange(30) * 1.2 + 2.2, np.arange(40) * 1.2 + 0.8), -1).reshape(-1, 2)
    velocity = np.random.default_rng(1).normal(size=places.shape)
    return mpsim.Scene(
        width=60, height=49, radius=0.5, position=np.append(places, [[58.5, 24.5]], axis=0),
        velocity=np.append(velocity, [[0.0, 0.0]], axis=0), piston=mpsim.Piston("right", -1.0, 50.0),
        obstacles=mpsim.Polyline([[57, 20], [57, 29]], thickness=0.2),
    )  # fmt: skip


@pytest.mark.long
def test_what_a_tile_counted_that_was_not_played_to_its_end_is_forgotten(monkeypatch):
    """Windows as long as laps: one of them comes to the disc that is crushed, and is played again in halves."""
    monkeypatch.setattr(event_windows, "PATIENCE", 0)  # so that each command plays a window, and hands out its counts
    scene, found, afterwards = before_a_crush(), [], 0
    with on_tiles(scene, (2, 1), dt=1 / 64) as sim, contextlib.suppress(mpsim.errors.StalledError):
        for _ in range(10_000):
            if windows_of(sim)["again"] == 0:
                begin_with_long_windows(sim)
            again = windows_of(sim)["again"]
            found.append(tallies_of_a_command(sim, 1000))
            afterwards += len(found[-1]) if again else 0
        raise AssertionError("nobody was crushed")
    assert afterwards > 0, "no window was played again before the end"
    counted = np.concatenate(found)
    with on_tiles(scene, (1, 1), dt=1 / 64) as sim:
        assert counted.tobytes() == tallies(sim, len(counted)).tobytes()
