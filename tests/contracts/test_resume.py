"""A run that was saved and resumed has the bits of one that never stopped."""

import dataclasses
import functools
import threading
import warnings

import numpy as np
import pytest
from support.compare import assert_same_bits
from support.processes import assert_clean, run_script
from support.scenes import EXACT, ZOO, crowd, exact_scene, gas, lattice, simulate, state_after, zoo
from support.selection import long_but

import mpsim
from mpsim.engine import checkpoint

FRAMES = 24
SETTINGS = {"dt": 0.02, "substeps": 2}
STEPPED = [("naive", 1), ("grid", 1), ("parallel", 1), ("parallel", 2), ("parallel", 3)]


@pytest.fixture(autouse=True)
def without_words_about_emitters():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", mpsim.errors.EmitterWarning)
        yield


def in_parts(scene, path, parts, workers=1, resumed_on=(1,), **settings):
    """State after runs of so many frames, each but the first by a simulation of its own that is resumed."""
    with simulate(scene, workers=workers, **settings) as sim:
        sim.run(frames=parts[0])
        sim.save(path)
    for index, frames in enumerate(parts[1:]):
        with mpsim.Simulation.resume(path, workers=resumed_on[index % len(resumed_on)]) as sim:
            sim.run(frames=frames)
            sim.save(path)
            state = sim.state
    assert sim.frame == sum(parts)
    return state


@functools.cache
def dense(method):
    return state_after(crowd(400, 0.8, seed=1), FRAMES, method=method, **SETTINGS)


@pytest.mark.slow
@pytest.mark.parametrize(("method", "workers"), STEPPED)
def test_a_resumed_run_has_the_bits_of_one_that_never_stopped(method, workers, tmp_path, figures):
    resumed_on = (1, 2, 3)
    state = in_parts(
        crowd(400, 0.8, seed=1), tmp_path / "run", (7, 5, 1, 11), workers, resumed_on, method=method, **SETTINGS
    )
    assert_same_bits(state, dense("naive" if method == "naive" else "grid"), f"resumed by {method}")
    figures.note(
        "R1",
        f"{method} on {workers}",
        "digest after 3 resumes, on 1, 2 and 3 workers",
        "that of an uninterrupted run",
        "the same",
    )


@pytest.mark.slow
def test_auto_goes_on_with_the_method_it_had(tmp_path):
    for scene in (gas(100, 0.5, seed=2), gas(300, 0.5, seed=2), gas(900, 0.5, seed=2)):
        expected = state_after(scene, FRAMES, method="auto", workers=2)
        state = in_parts(scene, tmp_path / "run", (10, 14), 2, (3,), method="auto")
        assert_same_bits(state, expected, f"auto with {scene.count} discs")


@pytest.mark.slow
@pytest.mark.parametrize("every", long_but([None, 1, 5, 24], None, 1))
@pytest.mark.parametrize(("method", "workers"), [("grid", 1), ("parallel", 2), ("event", 1)])
def test_checkpoints_on_the_way_change_no_bit(method, workers, every, tmp_path):
    scene = lattice(20, 20) if method == "event" else crowd(400, 0.8, seed=1)
    options = {} if every is None else {"checkpoint": tmp_path / "run", "checkpoint_every": every}
    with simulate(scene, method=method, workers=workers, **SETTINGS) as sim:
        sim.run(frames=FRAMES, **options)
        state = sim.state
    assert_same_bits(state, state_after(scene, FRAMES, method=method, **SETTINGS), f"a checkpoint every {every} frames")
    if every is not None:
        with mpsim.Simulation.resume(tmp_path / "run") as sim:
            assert sim.frame == FRAMES
            assert_same_bits(sim.state, state, "the last checkpoint")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:discs are pressed:mpsim.FastWarning")  # they are dropped on each other
@pytest.mark.parametrize("name", long_but(ZOO, "everything"))
def test_a_resumed_run_with_features_has_the_bits_of_one_that_never_stopped(name, tmp_path):
    expected = state_after(zoo(ZOO[name]), FRAMES, method="grid")
    state = in_parts(zoo(ZOO[name]), tmp_path / "run", (11, 4, 9), 1, (2, 1), method="parallel")
    assert_same_bits(state, expected, name)


def test_float32_is_resumed_with_the_same_bits(tmp_path):
    scene, settings = zoo(""), {"method": "grid", "precision": "float32"}
    expected = state_after(scene, FRAMES, **settings)
    assert_same_bits(in_parts(scene, tmp_path / "run", (11, 13), **settings), expected, "float32")


def grown(sim, frames=9):
    """Add discs of two sizes, run; the same every time."""
    radius, mass = ([0.5, 1.5], [2.0, 7.0]) if np.ndim(sim.scene.radius) else (None, None)
    sim.add([[3.0, 3.0], [5.0, 4.0]], [[1.0, 0.0], [0.0, -1.0]], radius=radius, mass=mass)
    sim.run(frames=frames)


@pytest.mark.filterwarnings("ignore::mpsim.FastWarning")  # of a box that is too full in the end
@pytest.mark.parametrize("words", long_but(["", "giants masses"], ""))
@pytest.mark.parametrize("method", ["naive", "grid", "parallel"])
def test_discs_that_were_added_are_resumed(words, method, tmp_path):
    with simulate(zoo(words), method=method, workers=2) as sim:
        for _ in range(2):
            grown(sim)
        sim.save(tmp_path / "run")
        for _ in range(2):
            grown(sim)
        expected, radii = sim.state, sim.radii
    with mpsim.Simulation.resume(tmp_path / "run", workers=2) as sim:
        assert sim.count == 44
        for _ in range(2):
            grown(sim)
        assert_same_bits(sim.state, expected, "with added discs")
        assert np.array_equal(sim.radii, radii)


@pytest.mark.slow
def test_what_has_left_stays_away(tmp_path):
    with simulate(zoo("radii absorbing"), method="grid") as sim:
        sim.run(frames=30)
        sim.save(tmp_path / "run")
        gone = sim.absorbed
        assert gone.any()
    with mpsim.Simulation.resume(tmp_path / "run") as sim:
        assert np.array_equal(sim.absorbed, gone)


# --- the exact solver


@pytest.mark.slow
@pytest.mark.parametrize("name", long_but(EXACT, "nothing", "periodic x, sizes, masses, losses"))
def test_an_exact_run_is_resumed_with_the_same_bits(name, tmp_path, figures):
    with simulate(exact_scene(name), method="event", dt=0.4) as sim:
        box_rests = sim.scene.moving_wall is None
        whole = sim.run(frames=15, measures=[*(["pressure"] * box_rests), "collision_rate"])
        expected = sim.state
    with simulate(exact_scene(name), method="event", dt=0.4) as sim:
        first = sim.run(frames=6)
        sim.save(tmp_path / "run")
    with mpsim.Simulation.resume(tmp_path / "run") as sim:
        assert (sim.frame, sim.time) == (6, 6 * 0.4)
        second = sim.run(frames=9)
        assert_same_bits(sim.state, expected, name)
    assert first.collisions + second.collisions == whole.collisions > 200
    figures.note(
        "R2",
        "event",
        f"digest after a resume: {name}",
        "that of an uninterrupted run",
        f"the same, {whole.collisions} collisions",
    )


def test_an_exact_run_is_resumed_at_every_frame_of_a_lattice(tmp_path):
    """A lattice with velocities of few bits is full of events at the same time."""
    base = lattice(6, 6)
    scene = mpsim.Scene(
        width=base.width, height=base.height, position=base.position, velocity=np.round(base.velocity), radius=0.5
    )
    expected = state_after(scene, 40, method="event", dt=0.3)
    assert_same_bits(in_parts(scene, tmp_path / "run", [1] * 40, method="event", dt=0.3), expected, "every frame")


def test_an_exact_run_that_was_stopped_inside_a_frame_is_resumed_there(tmp_path):
    def interrupt(done, of):
        raise KeyboardInterrupt

    scene, names = lattice(9, 9), ["pressure", "collision_rate"]
    with simulate(scene, method="event", dt=50.0) as sim:
        whole = sim.run(frames=2, measures=names)
        expected = sim.state
    with simulate(scene, method="event", dt=50.0) as sim:
        with pytest.raises(KeyboardInterrupt):
            sim.run(frames=2, progress=interrupt)
        assert sim.frame == 0 < sim.time
        stopped = sim.time, sim.digest()
        sim.save(tmp_path / "run")
    with mpsim.Simulation.resume(tmp_path / "run") as sim:
        assert (sim.time, sim.digest()) == stopped
        report = sim.run(frames=2, measures=names)
        assert_same_bits(sim.state, expected, "stopped inside a frame")
    for name in names:
        assert report.measures[name].value == whole.measures[name].value, "what the frame had counted is lost"


def test_an_exact_run_with_added_discs_is_resumed(tmp_path):
    with simulate(gas(40, 0.2, seed=4), method="event", dt=0.3) as sim:
        sim.run(frames=5)
        state, middle = sim.state, sim.scene.width / 2
        free = [
            (x, y)
            for x in np.linspace(0.6, 2 * middle - 0.6, 9)
            for y in np.linspace(0.6, 2 * middle - 0.6, 9)
            if np.hypot(*(state.position - (x, y)).T).min() > 1
        ][:1]
        sim.add(free, [[1.0, 0.5]])
        sim.run(frames=5)
        sim.save(tmp_path / "run")
        sim.run(frames=20)
        expected = sim.state
    with mpsim.Simulation.resume(tmp_path / "run") as sim:
        sim.run(frames=20)
        assert_same_bits(sim.state, expected, "exact, with a disc that was added")


# --- what must fail


def forget_emitters(arrays, run):
    run["emission"] = {name: [0] * len(values) for name, values in run["emission"].items()}


def forget_absorbed_discs(arrays, run):
    arrays["exits"][:] = 0


def forget_the_last_digits(arrays, run):
    arrays["velocity"][:] = arrays["velocity"].astype(np.float32)


def forget_radii(arrays, run):
    arrays["radii"][arrays["radii"] < 0.5] = 0.45


def forget_the_next_cell_borders(arrays, run):
    arrays["disc"][:, 6] += 1e-3


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::mpsim.FastWarning")  # of discs that enter again where others are
@pytest.mark.parametrize(
    ("words", "forget"),
    [
        ("emitters", forget_emitters),
        ("radii absorbing", forget_absorbed_discs),
        ("", forget_the_last_digits),
        ("radii absorbing", forget_radii),
        ("exact", forget_the_next_cell_borders),
    ],
)
def test_whatever_a_checkpoint_forgets_changes_the_bits(words, forget, tmp_path, monkeypatch, figures):
    """The control: these tests would notice a resume that is nearly right."""
    exact = words == "exact"
    scene = exact_scene("gravity") if exact else zoo(words, count=6 if words == "emitters" else 40)
    settings = {"method": "event" if exact else "grid", "dt": 0.1 if words == "emitters" else 0.02}
    expected = state_after(scene, 40, **settings)
    kept = in_parts(scene, tmp_path / "run", (20, 20), **settings)
    read = checkpoint.read

    def read_and_forget(path, check):
        found = read(path, check)
        arrays = {name: array.copy() for name, array in found.arrays.items()}
        forget(arrays, found.run)
        return dataclasses.replace(found, arrays=arrays)

    monkeypatch.setattr(checkpoint, "read", read_and_forget)
    lost = in_parts(scene, tmp_path / "run", (20, 20), **settings)
    assert kept.digest() == expected.digest() != lost.digest()
    figures.note(
        "R3",
        settings["method"],
        f"control: a checkpoint without {forget.__name__.removeprefix('forget_').replace('_', ' ')}",
        "different bits",
        "different bits",
    )


ELSEWHERE = """
import mpsim
with mpsim.Simulation.resume({path!r}, workers=2) as sim:
    sim.run(frames=12)
    print(sim.digest())
"""


@pytest.mark.slow
def test_another_process_goes_on_with_the_same_bits(tmp_path):
    scene = gas(500, 0.6, seed=5)
    with simulate(scene, method="parallel", workers=3) as sim:
        sim.run(frames=12)
        path = sim.save(tmp_path / "run")
        sim.run(frames=12)
        expected = sim.digest()
    outcome = run_script(ELSEWHERE.format(path=str(path)))
    assert_clean(outcome)
    assert outcome.out.strip() == expected


def test_a_simulation_in_a_thread_is_saved_and_resumed(tmp_path):
    scene, found = gas(500, 0.6, seed=5), []

    def work():
        with simulate(scene, method="parallel", workers=2) as sim:
            sim.run(frames=12, checkpoint=tmp_path / "run")
        with mpsim.Simulation.resume(tmp_path / "run", workers=2) as sim:
            sim.run(frames=12, checkpoint=tmp_path / "run")
            found.append(sim.digest())

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert found == [state_after(scene, 24, method="grid").digest()]


@pytest.mark.long
@pytest.mark.timeout(900)
def test_a_thousand_frames_after_a_dense_checkpoint_agree_on_any_number_of_workers(tmp_path, figures):
    scene = gas(20_000, 0.7, seed=1)
    with simulate(scene, method="grid", dt=0.02) as sim:
        report = sim.run(frames=100)
        sim.save(tmp_path / "run")
        sim.run(frames=1000)
        expected = sim.state
    assert report.collisions > 100_000
    for workers in (1, 2, 3, 8):
        with mpsim.Simulation.resume(tmp_path / "run", workers=workers) as sim:
            sim.run(frames=1000, checkpoint=tmp_path / "other", checkpoint_every=73)
            assert_same_bits(sim.state, expected, f"on {workers} workers")
    figures.note(
        "R1",
        "parallel on 1, 2, 3, 8",
        "20,000 discs, 1000 frames after a resume",
        "that of an uninterrupted run",
        "the same",
    )
