"""A run that was saved and resumed has the bits of one that never stopped."""

import dataclasses

import numpy as np
import pytest
from support.checkpoints import in_parts
from support.compare import assert_same_bits
from support.goldens import FRAMES, SCENES, few, methods, pins
from support.scenes import crowd, digest_after, gas, lattice, scene_of, simulate, state_after, struck, zoo
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
@pytest.mark.parametrize("name", long_but(sorted(SCENES.keys() - {"unguarded"}), *RESUMED))
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
    scene = scene_of(base.position, np.round(base.velocity), base.width, base.height)
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


def forget_emitters(arrays, emission):
    emission |= {name: [0] * len(values) for name, values in emission.items()}


def forget_the_last_digits(arrays, emission):
    arrays["velocity"][:] = arrays["velocity"].astype(np.float32)


def forget_the_next_cell_borders(arrays, emission):
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
        moment = found.snapshot
        arrays = {name: array.copy() for name, array in moment.arrays.items()}
        forget(arrays, moment.emission)
        return found._replace(snapshot=dataclasses.replace(moment, arrays=arrays))

    monkeypatch.setattr(checkpoint, "read", read_and_forget)
    assert in_parts(scene, tmp_path / "run", (15, 15), **settings).digest() != expected.digest()


# --- on_fast="substep": the same bits however a run is cut, saved, restored or shared out

OF_COOLING = 67  # more than four looks, and no multiple of the frames between two


def cooling():
    """A gas that loses energy, so that it needs fewer and fewer sub-steps."""
    return gas(30, 0.4, restitution=0.6, wall_restitution=0.6)


def substepped(scene, **settings):
    usual = {"dt": 0.3, "method": "grid", "contact": "impact"}
    return simulate(scene, on_fast="substep", **{**usual, **settings})


@pytest.fixture(scope="module")
def whole():
    """Digest of the run in one piece, and the numbers of sub-steps at frames."""
    with substepped(cooling()) as sim:
        sim.run(frames=OF_COOLING)
        return sim.digest()


def test_how_a_run_is_cut_and_measured_changes_no_bit(whole):
    with substepped(cooling()) as sim:
        seen = {sim.substeps}
        for frames in (1, 7, 16, 3, 20, 0, 20):
            sim.run(frames=frames, measures=["collision_rate"] if frames == 3 else [])
            seen.add(sim.substeps)
        assert sim.digest() == whole
    assert len(seen) > 1, "the number of sub-steps has changed on the way"
    other = digest_after(cooling(), OF_COOLING, dt=0.3, method="grid", contact="impact")
    assert other != whole, "the control: without sub-steps the result is another"


@pytest.mark.parametrize("at", [16, 33])
def test_a_resumed_run_goes_on_with_its_sub_steps(at, whole, tmp_path):
    with substepped(cooling()) as sim:
        sim.run(frames=at)
        substeps = sim.substeps
        path = sim.save(tmp_path / "run")
    with mpsim.Simulation.resume(path) as sim:
        assert sim.substeps == substeps
        sim.run(frames=OF_COOLING - at)
        assert sim.digest() == whole


def test_a_run_that_is_resumed_where_dt_or_the_discs_were_changed_has_the_same_sub_steps(tmp_path):
    digests = []
    with substepped(cooling(), dt=0.02) as sim:
        sim.run(frames=10)  # no frame at which speeds are looked at anyway
        sim.change(dt=0.3)
        before = sim.substeps
        sim.add((1.0, 1.0), (30.0, 3.0))
        assert sim.substeps > 2 * before
        path = sim.save(tmp_path / "run")
        sim.run(frames=8)
        digests.append(sim.digest())
        journal = sim.journal
    with mpsim.Simulation.resume(path) as sim:
        sim.run(frames=8)
        digests.append(sim.digest())
    with mpsim.Simulation.replay(journal) as sim:
        digests.append(sim.digest())
    assert len(set(digests)) == 1


@pytest.mark.parametrize("method", ["naive", "grid", "event"])
def test_frames_are_counted_from_a_change_to_the_same_dt_too(method, tmp_path):
    with simulate(lattice(4, 4), method=method) as sim:
        sim.run(frames=5)
        sim.change(dt=sim.settings.dt)
        sim.run(frames=3)
        with mpsim.Simulation.resume(sim.save(tmp_path / "run")) as again:
            assert (again.frame, again.time, again.digest()) == (sim.frame, sim.time, sim.digest())
        with mpsim.Simulation.replay(sim.journal) as again:
            assert again.digest() == sim.digest()


# --- a disc that is struck divides the next frame, not the sixteenth

JUMPS = {"dt": 0.05, "contact": "impact", "on_fast": "substep"}
JUMPED = 40


@pytest.fixture(scope="module")
def leaps():
    """Frames at which the number of sub-steps has changed, and the digest at the end, of the run frame by frame."""
    with simulate(struck(), method="grid", **JUMPS) as sim:
        found, before = [], sim.substeps
        for _ in range(JUMPED):
            sim.run(frames=1)
            if sim.substeps != before:
                found.append((sim.frame, sim.substeps / before))
            before = sim.substeps
        return found, sim.digest()


@pytest.mark.long
@pytest.mark.parametrize(("method", "workers"), [("grid", 1), ("parallel", 3)])
def test_frames_divided_at_once_are_the_same_in_pieces_on_workers_and_after_a_resume(method, workers, leaps, tmp_path):
    frame = next((frame for frame, factor in leaps[0] if frame % 16 != 1 and factor > 1), None)
    assert frame, f"none is divided at once: {leaps[0]}"
    for stop in (frame - 1, frame):
        with simulate(struck(), method=method, workers=workers, **JUMPS) as sim:
            sim.run(frames=stop)
            path = sim.save(tmp_path / "run")
            sim.run(frames=JUMPED - stop)
            assert (sim.frame, sim.digest()) == (JUMPED, leaps[1])
        with mpsim.Simulation.resume(path, workers=workers) as sim:
            sim.run(frames=JUMPED - stop)
            assert sim.digest() == leaps[1]
