"""on_fast="substep": the same bits however a run is cut, saved, restored or shared out."""

import pytest
from support.scenes import gas, simulate, struck

import mpsim

pytestmark = pytest.mark.plain

FRAMES = 67
"""More than four looks, and no multiple of the frames between two."""


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
        sim.run(frames=FRAMES)
        return sim.digest()


def test_how_a_run_is_cut_and_measured_changes_no_bit(whole):
    with substepped(cooling()) as sim:
        seen = {sim.substeps}
        for frames in (1, 7, 16, 3, 20, 0, 20):
            sim.run(frames=frames, measures=["collision_rate"] if frames == 3 else [])
            seen.add(sim.substeps)
        assert sim.digest() == whole
    assert len(seen) > 1, "the number of sub-steps has changed on the way"
    with simulate(cooling(), dt=0.3, method="grid", contact="impact") as sim:
        sim.run(frames=FRAMES)
        assert sim.digest() != whole, "the control: without sub-steps the result is another"


@pytest.mark.parametrize("at", [16, 33])
def test_a_resumed_run_goes_on_with_its_sub_steps(at, whole, tmp_path):
    with substepped(cooling()) as sim:
        sim.run(frames=at)
        substeps = sim.substeps
        path = sim.save(tmp_path / "run")
    with mpsim.Simulation.resume(path) as sim:
        assert sim.substeps == substeps
        sim.run(frames=FRAMES - at)
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
