"""A run that was saved and resumed has the bits of one that never stopped."""

import dataclasses

import numpy as np
import pytest
from support.compare import assert_same_bits
from support.scenes import EXACT, ZOO, crowd, exact_scene, lattice, simulate, state_after, zoo
from support.selection import long_but

import mpsim
from mpsim.engine import checkpoint

FRAMES = 24
SETTINGS = {"dt": 0.02, "substeps": 2}

pytestmark = [
    pytest.mark.plain,
    pytest.mark.filterwarnings("ignore::mpsim.errors.EmitterWarning"),
    pytest.mark.filterwarnings("ignore::mpsim.FastWarning"),  # of discs that are dropped on each other
]


def in_parts(scene, path, parts, **settings):
    """State after runs of so many frames, each but the first by a simulation of its own that is resumed."""
    with simulate(scene, **settings) as sim:
        sim.run(frames=parts[0])
        sim.save(path)
    for frames in parts[1:]:
        with mpsim.Simulation.resume(path) as sim:
            sim.run(frames=frames)
            sim.save(path)
            state = sim.state
    assert sim.frame == sum(parts)
    return state


@pytest.mark.parametrize("method", ["naive", "grid", "event"])
def test_checkpoints_on_the_way_change_no_bit(method, tmp_path):
    scene, frames = lattice(6, 6) if method == "event" else crowd(40, 0.8, seed=1), 13
    with simulate(scene, method=method, **SETTINGS) as sim:
        sim.run(frames=frames, checkpoint=tmp_path / "run", checkpoint_every=5)
        state = sim.state
    assert_same_bits(state, state_after(scene, frames, method=method, **SETTINGS), "with checkpoints")
    with mpsim.Simulation.resume(tmp_path / "run") as sim:
        assert sim.frame == frames
        assert_same_bits(sim.state, state, "the last checkpoint")


@pytest.mark.parametrize("name", long_but(ZOO, "everything rough", "periodic", "emitters", "absorbing and gravity"))
def test_a_resumed_run_with_features_has_the_bits_of_one_that_never_stopped(name, tmp_path):
    precision = ("float64", "float32")[list(ZOO).index(name) % 2]
    with simulate(zoo(ZOO[name], 24), method="grid", precision=precision) as sim:
        sim.run(frames=FRAMES)
        expected, gone = sim.state, sim.absorbed.tolist()
    with simulate(zoo(ZOO[name], 24), method="grid", precision=precision) as sim:
        sim.run(frames=11)
        path = sim.save(tmp_path / "run")
        left = sim.absorbed.tolist()
    with mpsim.Simulation.resume(path) as sim:
        assert sim.absorbed.tolist() == left, "what has left stays away"
        sim.run(frames=FRAMES - 11)
        assert_same_bits(sim.state, expected, name)
        assert sim.absorbed.tolist() == gone


def grown(sim, frames=9):
    """Add discs of two sizes, run; the same every time."""
    radius, mass = ([0.5, 1.5], [2.0, 7.0]) if np.ndim(sim.scene.radius) else (None, None)
    sim.add([[3.0, 3.0], [5.0, 4.0]], [[1.0, 0.0], [0.0, -1.0]], radius=radius, mass=mass)
    sim.run(frames=frames)


@pytest.mark.parametrize(("words", "method"), [("", "naive"), ("giants masses", "grid")])
def test_discs_that_were_added_are_resumed(words, method, tmp_path):
    with simulate(zoo(words, 24), method=method) as sim:
        for _ in range(2):
            grown(sim)
        sim.save(tmp_path / "run")
        for _ in range(2):
            grown(sim)
        expected, radii = sim.state, sim.radii
    with mpsim.Simulation.resume(tmp_path / "run") as sim:
        assert sim.count == 28
        for _ in range(2):
            grown(sim)
        assert_same_bits(sim.state, expected, "with added discs")
        assert np.array_equal(sim.radii, radii)


# --- the exact solver


@pytest.mark.parametrize("name", long_but(EXACT, "periodic x, sizes, masses, losses"))
def test_an_exact_run_is_resumed_with_the_same_bits(name, tmp_path):
    with simulate(exact_scene(name), method="event", dt=0.2) as sim:
        box_rests = sim.scene._moving_wall is None
        whole = sim.run(frames=7, measures=[*(["pressure"] * box_rests), "collision_rate"])
        expected = sim.state
    with simulate(exact_scene(name), method="event", dt=0.2) as sim:
        first = sim.run(frames=3)
        sim.save(tmp_path / "run")
    with mpsim.Simulation.resume(tmp_path / "run") as sim:
        assert (sim.frame, sim.time) == (3, 3 * 0.2)
        second = sim.run(frames=4)
        assert_same_bits(sim.state, expected, name)
    assert first.collisions + second.collisions == whole.collisions > 40


def test_an_exact_run_is_resumed_at_every_frame_of_a_lattice(tmp_path):
    """A lattice with velocities of few bits is full of events at the same time."""
    base = lattice(4, 4)
    scene = mpsim.Scene(
        width=base.width, height=base.height, position=base.position, velocity=np.round(base.velocity), radius=0.5
    )
    expected = state_after(scene, 8, method="event", dt=0.3)
    assert_same_bits(in_parts(scene, tmp_path / "run", [1] * 8, method="event", dt=0.3), expected, "every frame")


def test_an_exact_run_that_is_saved_when_a_lap_of_the_calendar_has_just_begun_goes_on(tmp_path):
    """No event has happened in this lap yet, so the last one lies before it. Where that is, no user can see."""
    scene = mpsim.Scene.random(count=20, packing=0.2, radius=0.5, seed=3)
    with simulate(scene, method="event", dt=0.002) as sim:
        while sim._solver._system.store.clock.now >= 0:
            sim.run(frames=1)
        sim.save(tmp_path / "run")
        sim.run(frames=400)
        expected = sim.state
    with mpsim.Simulation.resume(tmp_path / "run") as sim:
        sim.run(frames=400)
        assert_same_bits(sim.state, expected, "from a lap that has just begun")


# --- what must fail


def forget_emitters(arrays, run):
    run["emission"] = {name: [0] * len(values) for name, values in run["emission"].items()}


def forget_the_last_digits(arrays, run):
    arrays["velocity"][:] = arrays["velocity"].astype(np.float32)


def forget_the_next_cell_borders(arrays, run):
    arrays["disc"][:, 6] += 1e-3


@pytest.mark.parametrize(
    ("words", "forget"),
    [("emitters", forget_emitters), ("", forget_the_last_digits), ("exact", forget_the_next_cell_borders)],
)
def test_whatever_a_checkpoint_forgets_changes_the_bits(words, forget, tmp_path, monkeypatch):
    """The control, which only a changed reader can be: a resume that is nearly right would be noticed."""
    exact = words == "exact"
    scene = exact_scene("gravity") if exact else zoo(words, count=6 if words == "emitters" else 40)
    settings = {"method": "event" if exact else "grid", "dt": 0.1 if words == "emitters" else 0.02}
    expected = state_after(scene, 30, **settings)
    read = checkpoint.read

    def read_and_forget(path):
        found = read(path)
        arrays = {name: array.copy() for name, array in found.arrays.items()}
        forget(arrays, found.run)
        return dataclasses.replace(found, arrays=arrays)

    monkeypatch.setattr(checkpoint, "read", read_and_forget)
    assert in_parts(scene, tmp_path / "run", (15, 15), **settings).digest() != expected.digest()
