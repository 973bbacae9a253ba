"""Runs of the exact solver that are saved, resumed on other workers, stopped or grown have the same bits."""

import dataclasses
import itertools

import numpy as np
import pytest
from support.compare import assert_same_bits
from support.internals import solver_of
from support.scenes import simulate
from support.tiles import always_tiled, everything, first_free_place, on_tiles, windows_of

import mpsim
from mpsim.engine import checkpoint
from mpsim.engine.solvers import event_windows

COUNT, FRAMES, DT = 3000, 24, 0.125
NAMES = ["pressure", "collision_rate"]
SCENES = {
    "walls": {"radius": 0.5},
    "everything": everything(COUNT),
}
EMITTERS = (mpsim.Emitter((2.0, 2.0), (3.0, 2.0), interval=0.7), mpsim.Emitter((60.0, 2.0), (-2.0, 3.0), interval=0.45))


def scene_of(name, count=COUNT, **more):
    return mpsim.Scene.random(count=count, packing=0.4, seed=2, **SCENES[name], **more)


def beside_a_strip(**more):
    """A gas above a free strip, into which emitters send discs."""
    gas, strip = scene_of("walls"), np.array([0.0, 5.0])
    box = {"width": gas.width, "height": gas.height + strip[1], "radius": 0.5}
    return mpsim.Scene(position=gas.position + strip, velocity=gas.velocity, **box, **more)


def in_parts(scene, path, parts, workers):
    """State after runs of so many frames, each on another number of workers, and what each has counted."""
    collisions = 0
    with always_tiled(2, 2):
        for part, (frames, number) in enumerate(zip(parts, workers, strict=True)):
            begin = simulate(scene, method="event", workers=number, dt=DT) if not part else None
            with begin or mpsim.Simulation.resume(path, workers=number) as sim:
                assert len(sim.pids) == number - 1
                collisions += sim.run(frames=frames).collisions
                sim.save(path)
                state = sim.state
    return state, collisions


def whole(scene, frames=FRAMES):
    with on_tiles(scene, (1, 1), dt=DT) as sim:
        report = sim.run(frames=frames)
        return sim.state, report


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("workers", [(2, 1, 3), (1, 3, 2)])
def test_a_run_that_is_resumed_on_other_numbers_of_workers_has_the_same_bits(workers, name, tmp_path, figures):
    expected, report = whole(scene_of(name))
    state, collisions = in_parts(scene_of(name), tmp_path / "run", (7, 6, 11), workers)
    assert_same_bits(state, expected, f"{name} on {workers}")
    assert collisions == report.collisions > COUNT
    figures.note(
        "R1", f"event on {workers}", f"digest after 2 resumes: {name}", "that of an uninterrupted run", "the same"
    )


@pytest.mark.slow
def test_a_box_that_was_divided_is_resumed_as_a_whole_and_the_other_way_round(tmp_path):
    expected, _ = whole(scene_of("walls"))
    tilings, path = [(2, 2), (1, 1), (3, 1)], tmp_path / "run"
    with on_tiles(scene_of("walls"), tilings[0], dt=DT) as sim:
        sim.run(frames=8)
        sim.save(path)
    for tiling in tilings[1:]:
        with always_tiled(*tiling), mpsim.Simulation.resume(path, workers=1) as sim:
            sim.run(frames=8)
            sim.save(path)
            state = sim.state
    assert_same_bits(state, expected, f"divided into {tilings}")


@pytest.mark.slow
def test_snapshots_of_tiles_hold_what_those_of_the_whole_box_hold(tmp_path):
    """But for the order of discs in memory and for counts of work: so a checkpoint tells nothing of tiles."""
    found = []
    for tiling in ((1, 1), (2, 2)):
        with on_tiles(scene_of("walls"), tiling, dt=DT) as sim:
            sim.run(frames=FRAMES)
            arrays = sim._solver.snapshot()
            order = np.argsort(arrays["event"][:, -2])
            numbers = arrays["event"][order, -2]
            found.append((arrays["disc"][order], numbers, arrays["clock"], arrays["tally"]))
    assert (found[0][1] == np.arange(COUNT)).all()
    for one, other in zip(*found, strict=True):
        assert np.array_equal(one, other)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_discs_that_are_added_on_the_way_have_the_same_bits(name):
    scene, states = scene_of(name), []
    for tiling, workers in (((1, 1), 1), ((2, 2), 1), ((2, 2), 3)):
        with on_tiles(scene, tiling, workers, dt=DT) as sim, always_tiled(*tiling):
            sizes = {"radius": [0.375], "mass": [2.0]} if name == "everything" else {}
            for frames in (5, 1, 9):
                sim.run(frames=frames)
                sim.add([first_free_place(sim.state)], [[2.0, 1.0]], **sizes)
            sim.run(frames=9)
            assert sim.count == COUNT + 3
            states.append(sim.state)
    assert_same_bits(states[1], states[0], "added, one process")
    assert_same_bits(states[2], states[0], "added, three workers")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::mpsim.errors.EmitterWarning")
@pytest.mark.parametrize("dt", [0.05, 1.7])
def test_emitters_that_stop_inside_frames_have_the_same_bits(dt, tmp_path):
    """A disc enters at its time, which lies inside a frame; also of a run that is resumed in between."""
    scene, frames = beside_a_strip(emitters=EMITTERS), round(5.1 / dt)
    with on_tiles(scene, (1, 1), dt=dt) as sim:
        report = sim.run(frames=frames, measures=["pressure"])
        expected, count = sim.state, sim.count
    assert count > COUNT + 10
    for workers in (1, 2):
        with on_tiles(scene, (2, 2), workers, dt=dt) as sim, always_tiled(2, 2):
            found = sim.run(frames=frames, measures=["pressure"])
            assert_same_bits(sim.state, expected, f"emitters on {workers} workers")
            assert windows_of(sim)["windows"] > 0
        assert repr(found.measures) == repr(report.measures)
        assert found.collisions == report.collisions
    with always_tiled(2, 2):
        with simulate(scene, method="event", workers=2, dt=dt) as sim:
            sim.run(frames=frames // 2)
            sim.save(tmp_path / "run")
        with mpsim.Simulation.resume(tmp_path / "run", workers=3) as sim:
            sim.run(frames=frames - frames // 2)
            assert_same_bits(sim.state, expected, "emitters, resumed")


@pytest.mark.slow
def test_a_run_that_is_saved_inside_a_frame_goes_on_there(tmp_path, monkeypatch):
    """A frame far longer than a command is left by Ctrl-C, and goes on elsewhere."""
    monkeypatch.setattr(event_windows, "PATIENCE", 0)  # a tile of each worker a command
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
    for workers, tiling in ((3, (3, 1)), (1, (1, 1))):
        with always_tiled(*tiling), mpsim.Simulation.resume(tmp_path / "run", workers=workers) as sim:
            assert (sim.time, sim.digest()) == stopped
            found = sim.run(frames=2, measures=NAMES)
            assert_same_bits(sim.state, expected, f"from inside a frame, on {workers}")
        for name in NAMES:
            assert found.measures[name].value == report.measures[name].value, "what the frame had counted is lost"


# --- what must fail


def forget_the_next_borders(arrays):
    arrays["disc"][:, 6] += 1e-3


def forget_who_is_to_collide(arrays):
    arrays["event"][:, 0] = np.roll(arrays["event"][:, 0], 1)


def forget_the_last_digits(arrays):
    arrays["disc"][:, :4] = arrays["disc"][:, :4].astype(np.float32)


@pytest.mark.slow
@pytest.mark.parametrize("forget", [forget_the_next_borders, forget_who_is_to_collide, forget_the_last_digits])
def test_whatever_a_checkpoint_forgets_changes_the_bits(forget, tmp_path, monkeypatch):
    """The control: these tests would notice a resume that is nearly right."""
    expected, _ = whole(scene_of("walls"))
    read = checkpoint.read

    def read_and_forget(path, check):
        found = read(path, check)
        arrays = {name: array.copy() for name, array in found.arrays.items()}
        forget(arrays)
        return dataclasses.replace(found, arrays=arrays)

    monkeypatch.setattr(checkpoint, "read", read_and_forget)
    state, _ = in_parts(scene_of("walls"), tmp_path / "run", (12, 12), (2, 2))
    assert state.digest() != expected.digest()


@pytest.mark.parametrize("seed", range(6))
def test_a_run_that_is_saved_when_a_lap_of_the_calendar_has_just_begun_goes_on_to_the_same_bits(seed, tmp_path):
    """No event has happened in this lap yet, so the last one lies before it."""
    scene = mpsim.Scene.random(count=30, packing=0.2, radius=0.5, seed=seed)
    with simulate(scene, method="event", dt=0.002) as sim:
        while solver_of(sim)._system.store.clock.now >= 0:
            sim.run(frames=1)
        sim.save(tmp_path / "run")
        sim.run(frames=4000)
        expected = sim.state
    with mpsim.Simulation.resume(tmp_path / "run") as sim:
        sim.run(frames=4000)
        assert_same_bits(sim.state, expected, f"seed {seed}")
