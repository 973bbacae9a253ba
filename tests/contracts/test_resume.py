"""A run that was saved and resumed has the bits of one that never stopped."""

import dataclasses

import numpy as np
import pytest
from support.checkpoints import in_parts
from support.compare import assert_same_bits
from support.goldens import FRAMES, SCENES, few, methods, pins
from support.scenes import crowd, lattice, simulate, state_after, zoo
from support.selection import long_but

import mpsim
from mpsim.engine import checkpoint

HALF = FRAMES // 2
SETTINGS = {"dt": 0.02, "substeps": 2}

pytestmark = [
    pytest.mark.plain,
    pytest.mark.filterwarnings("ignore::mpsim.errors.EmitterWarning"),
    pytest.mark.filterwarnings("ignore::mpsim.FastWarning"),  # of discs that are dropped on each other
]


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


RESUMED = ["discs added", "periodic", "emitter by time", "absorbing bottom", "stream exact", "everything rough"]


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", long_but(SCENES.keys() - {"unguarded"}, *RESUMED))
def test_a_run_that_is_saved_half_way_and_resumed_has_the_pinned_digest(name, tmp_path, request):
    """Of each feature alone, and of all together, with discs that were added."""
    for words, how in (methods() if request.config.getoption("--long") else few(name)).items():
        pinned = pins()["digests"][name][words]
        if pinned.startswith("refused"):
            continue
        with SCENES[name].start(**how) as sim:
            contacts = sim.run(frames=HALF).collisions
            if SCENES[name].midway is not None:
                SCENES[name].midway(sim)
            path, left = sim.save(tmp_path / "run"), sim.absorbed.tolist()
        with mpsim.Simulation.resume(path) as sim:
            assert (sim.frame, sim.absorbed.tolist()) == (HALF, left), "what has left stays away"
            contacts += sim.run(frames=FRAMES - HALF).collisions
            assert f"{sim.digest()} {contacts} contacts" == pinned, words


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
    scene = lattice(6, 6) if exact else zoo(words, count=6 if words == "emitters" else 40)
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
