"""on_fast="substep": the same bits however a run is cut, saved, restored or shared out."""

import numpy as np
import pytest
from support.checkpoints import rewrite
from support.scenes import gas, simulate, struck, zoo

import mpsim
from mpsim.engine import step_limits
from mpsim.kernels.layout import TOP

pytestmark = pytest.mark.slow

FRAMES = 75
"""More than four looks, and no multiple of the frames between two."""


def cooling():
    """A gas that loses energy, so that it needs fewer and fewer sub-steps."""
    return gas(300, 0.4, restitution=0.6, wall_restitution=0.6)


def substepped(scene, **settings):
    usual = {"dt": 0.3, "method": "grid", "contact": "impact"}
    return simulate(scene, on_fast="substep", **{**usual, **settings})


def in_pieces(scene, pieces, **settings):
    with substepped(scene, **settings) as sim:
        seen = {sim.substeps}
        for frames in pieces:
            sim.run(frames=frames)
            seen.add(sim.substeps)
        return sim.digest(), seen


def test_how_a_run_is_cut_changes_no_bit():
    whole, _ = in_pieces(cooling(), [FRAMES])
    cut, seen = in_pieces(cooling(), [1, 7, 16, 3, 20, 0, 28])
    assert cut == whole
    assert len(seen) > 2, "the number of sub-steps has changed on the way"
    with simulate(cooling(), dt=0.3, method="grid", contact="impact") as sim:
        sim.run(frames=FRAMES)
        assert sim.digest() != whole, "the control: without sub-steps the result is another"


def test_workers_and_measures_change_no_bit():
    whole, _ = in_pieces(cooling(), [FRAMES])
    with substepped(cooling(), method="parallel", workers=2) as sim:
        sim.run(frames=40)
        sim.run(frames=FRAMES - 40, measures=["collision_rate"])
        assert sim.digest() == whole


def resumed_after_a_change(tmp_path):
    """Digests of a run in which dt becomes longer, resumed there and not."""
    digests = []
    with substepped(cooling(), dt=0.02) as sim:
        sim.run(frames=10)  # no frame at which speeds are looked at anyway
        sim.change(dt=0.3)
        path = sim.save(tmp_path / "run")
        sim.run(frames=30)
        digests.append(sim.digest())
        journal = sim.journal
        assert sim.substeps > 1
    with mpsim.Simulation.resume(path) as sim:
        sim.run(frames=30)
        digests.append(sim.digest())
    with mpsim.Simulation.replay(journal) as sim:
        digests.append(sim.digest())
    return digests


def test_a_run_that_is_resumed_where_dt_was_changed_has_the_same_sub_steps(tmp_path):
    assert len(set(resumed_after_a_change(tmp_path))) == 1


def test_without_a_look_where_dt_was_changed_they_would_be_others(tmp_path, monkeypatch):
    """The control."""
    looks = step_limits.StepLimits.is_due
    monkeypatch.setattr(
        step_limits.StepLimits,
        "is_due",
        lambda self, frame, count: not (frame == self._origin.frame > 0) and looks(self, frame, count),
    )
    uncut, resumed, replayed = resumed_after_a_change(tmp_path)
    assert uncut == replayed != resumed


@pytest.mark.parametrize("at", [0, 5, 16, 33])
def test_a_resumed_run_goes_on_with_its_sub_steps(at, tmp_path):
    whole, _ = in_pieces(cooling(), [FRAMES])
    with substepped(cooling()) as sim:
        sim.run(frames=at)
        substeps = sim.substeps
        path = sim.save(tmp_path / "run")
    with mpsim.Simulation.resume(path) as sim:
        assert sim.substeps == substeps
        sim.run(frames=FRAMES - at)
        assert sim.digest() == whole


def test_going_back_to_a_snapshot_goes_back_to_its_sub_steps():
    with substepped(cooling()) as sim:
        sim.run(frames=5)
        kept, substeps = sim._coordinator.snapshot(), sim.substeps
        sim.run(frames=FRAMES - 5)
        digest = sim.digest()
        assert sim.substeps != substeps
        sim._coordinator.restore(kept)
        assert sim.substeps == substeps
        sim.run(frames=FRAMES - 5)
        assert sim.digest() == digest


def test_a_disc_that_is_added_counts_at_once_and_after_a_resume(tmp_path):
    def add(sim):
        before = sim.substeps
        sim.add((1.0, 1.0), (60.0, 3.0))
        assert sim.substeps > 2 * before

    with substepped(cooling()) as sim:
        sim.run(frames=21)
        add(sim)
        path = sim.save(tmp_path / "run")
        sim.run(frames=30)
        digest = sim.digest()
    with mpsim.Simulation.resume(path) as sim:
        sim.run(frames=30)
        assert sim.digest() == digest


JUMPS = {"dt": 0.05, "contact": "impact", "on_fast": "substep"}


@pytest.fixture(scope="module")
def leaps():
    """Frames at which the number of sub-steps has changed, and the digest at the end, of the run frame by frame."""
    with simulate(struck(), method="grid", **JUMPS) as sim:
        found, before = [], sim.substeps
        for _ in range(FRAMES):
            sim.run(frames=1)
            if sim.substeps != before:
                found.append((sim.frame, sim.substeps / before))
            before = sim.substeps
        return found, sim.digest()


def test_a_disc_that_is_struck_divides_the_next_frame_not_the_sixteenth(leaps):
    found, _ = leaps
    assert any(frame % 16 != 1 and factor > 1 for frame, factor in found), found


@pytest.mark.parametrize("workers", [1, 2, 3])
def test_frames_divided_at_once_are_the_same_on_any_number_of_workers_and_in_pieces(leaps, workers):
    with simulate(struck(), method="parallel", workers=workers, **JUMPS) as sim:
        for frames in (FRAMES,) if workers == 2 else (2, 9, 1, 30, 33):
            sim.run(frames=frames)
        assert (sim.frame, sim.digest()) == (FRAMES, leaps[1])


def test_frames_divided_at_once_are_the_same_after_a_resume(leaps, tmp_path):
    frame = next(frame for frame, factor in leaps[0] if frame % 16 != 1 and factor > 1)
    for stop in (frame - 1, frame, frame + 1):
        with simulate(struck(), method="grid", **JUMPS) as sim:
            sim.run(frames=stop)
            path = sim.save(tmp_path / "run")
        with mpsim.Simulation.resume(path) as sim:
            sim.run(frames=FRAMES - stop)
            assert sim.digest() == leaps[1]


def test_without_the_alert_the_bits_are_others(leaps, monkeypatch):
    """The control: what is compared above depends on where frames are divided."""
    monkeypatch.setattr("mpsim.engine.step_limits.SUBSTEP_LIMIT", 1e9)
    with simulate(struck(), method="grid", **JUMPS) as sim:
        sim.run(frames=FRAMES)
        assert sim.digest() != leaps[1]


@pytest.mark.long
def test_a_piston_stands_where_its_time_says_whatever_the_sub_steps():
    with substepped(zoo("piston lossy"), dt=0.05) as sim:
        seen = set()
        for frame in range(1, 60):
            sim.run(frames=1)
            seen.add(sim.substeps)
            wall = float(sim._solver._block.arrays["parameters"].limit[TOP])
            ahead = 0.05 / sim.substeps  # the wall is where the next step will meet it
            assert wall == pytest.approx(max(8 - 1.5 * (frame * 0.05 + ahead), 6.4) - 0.5, abs=1e-9)
    assert len(seen) > 1


def wild(seed):
    """A scene in which speeds change, and settings for it: a field, a piston, an emitter or a fast disc."""
    rng = np.random.default_rng(seed)
    start, kind = gas(20, float(rng.choice([0.1, 0.3])), seed=seed), seed % 4
    width, height, velocity = start.width, start.height + 3, start.velocity.copy()
    features = [
        {"gravity": (0.0, -float(rng.choice([1, 40, 400])))},
        {"piston": mpsim.Piston("right", speed=-float(rng.choice([0.5, 3, 20])), stop=0.7 * width)},
        {"emitters": mpsim.Emitter((1.0, height - 1), (float(rng.choice([4, 30])), 0.0), interval=0.2, limit=5)},
        {},
    ][kind]
    velocity[0] *= rng.choice([10, 50]) if kind == 3 else 1
    scene = mpsim.Scene(width=width, height=height, position=start.position, velocity=velocity, radius=0.5, **features)
    contact = str(rng.choice(["push", "impact"]))
    return scene, {"dt": float(rng.choice([0.02, 0.05, 0.1, 0.3])), "contact": contact}, int(rng.integers(1, 60))


def resumed_differently(seed, path, monkeypatch, every):
    """Whether the run of `wild(seed)` ends elsewhere if it is saved at a frame and resumed with looks so far apart."""
    scene, settings, at = wild(seed)
    with substepped(scene, **settings) as sim:
        sim.run(frames=at)
        sim.save(path)
        sim.run(frames=60 - at)
        whole = sim.digest()
    with monkeypatch.context() as patch:
        patch.setattr(step_limits, "ADAPT_EVERY", every)
        with mpsim.Simulation.resume(path) as sim:
            sim.run(frames=60 - at)
            return sim.digest() != whole


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:.* occupied at time:mpsim.errors.EmitterWarning")
def test_any_run_is_resumed_at_any_frame_with_the_same_bits(tmp_path, monkeypatch):
    def differ(seeds, every):
        return [seed for seed in seeds if resumed_differently(seed, tmp_path / "run", monkeypatch, every)]

    assert not differ(range(400), step_limits.ADAPT_EVERY)
    assert len(differ(range(40), 7)) > 4, "the control: looks at other frames"


def test_a_checkpoint_with_steps_that_cannot_be_is_refused(tmp_path):
    with substepped(cooling()) as sim:
        sim.run(frames=5)
        path = sim.save(tmp_path / "run")
    for steps in (0, 4, 11, 5 * 20_000):
        good = path.read_bytes()
        rewrite(path, lambda header, arrays, steps=steps: arrays.update({"solver.progress": np.array([5, steps])}))
        with pytest.raises(mpsim.CheckpointError, match="5 frames cannot have"):
            mpsim.Simulation.resume(path)
        path.write_bytes(good)
