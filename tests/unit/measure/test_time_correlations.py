"""The observer of correlations: what it takes, what it refuses, and that its averages survive what runs survive."""

import contextlib
import os

import numpy as np
import pytest
from support.scenes import gas, simulate

import mpsim
from mpsim import Correlations
from mpsim.measure import time_correlations as module

TORUS = {"boundary": "periodic"}


def gathered(correlations):
    """All that was gathered, to the bit."""
    functions = [correlations.msd, correlations.velocity, *map(correlations.scattering, correlations.wave_numbers)]
    return [each.tobytes() for one in functions for each in (one.lag, one.value, one.error)]


def after(scene, frames, correlations, **settings):
    with simulate(scene, **settings) as sim:
        for each in frames:
            sim.run(frames=each, observe=correlations)
    return gathered(correlations)


def correlations(**given):
    return Correlations(every=2, wave_numbers=[1.0], **given)


SCENE = gas(60, 0.3, seed=2, **TORUS)
SETTINGS = {"dt": 0.05, "method": "grid"}


def test_a_run_in_parts_gives_the_bits_of_one_run():
    assert after(SCENE, [200], correlations(), **SETTINGS) == after(SCENE, [31, 0, 100, 69], correlations(), **SETTINGS)


def test_looking_changes_no_bit_of_the_run():
    digests = []
    for observer in (None, correlations()):
        with simulate(SCENE, **SETTINGS) as sim:
            sim.run(frames=50, observe=observer)
            digests.append(sim.digest())
    assert digests[0] == digests[1]


def test_nothing_is_gathered_before_the_start():
    late, with_other = correlations(start=2.0), correlations()
    with simulate(SCENE, **SETTINGS) as sim:
        sim.run(frames=38, observe=late)
        assert repr(late) == "<Correlations: nothing gathered yet>"
        with pytest.raises(mpsim.errors.NotRecordedError, match="let the run pass start = 2"):
            late.msd  # noqa: B018
        sim.run(frames=2, observe=late)
        sim.run(frames=60, observe=[late, with_other])
    assert gathered(late) == gathered(with_other)
    assert repr(late) == "<Correlations: 31 samples of 60 discs, lags up to 2.8>"


def test_no_lag_reaches_across_a_pause_or_a_change():
    """Origins are those of two stretches; a kick at a frame that was seen makes a new sample of it."""
    found = correlations()
    with simulate(SCENE, **SETTINGS) as sim:
        sim.run(frames=20, observe=found)
        sim.run(frames=10)
        sim.run(frames=20, observe=found)
    origins = [each.samples for each in found.velocity.measures]
    assert origins[:4] == [22, 20, 18, 16]
    kicked = correlations()
    with simulate(SCENE, **SETTINGS) as sim:
        sim.run(frames=20, observe=kicked)
        sim.kick(3, impulse=(5, 0))
        sim.run(frames=20, observe=kicked)
    assert [each.samples for each in kicked.velocity.measures][:4] == [22, 20, 18, 16]


def test_only_the_discs_that_are_named_are_followed():
    found, of_all = Correlations(discs=[5, 2]), Correlations()
    with simulate(SCENE, **SETTINGS) as sim:
        before = sim.state
        sim.run(frames=4, observe=[found, of_all])
        state = sim.state
    moved = (state.unwrapped - before.unwrapped)[[5, 2]]
    assert found.msd.lag[4] == pytest.approx(0.2)
    assert found.msd[4].value == pytest.approx((moved**2).sum(axis=1).mean(), rel=1e-12)
    assert of_all.msd[4].value != found.msd[4].value


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"every": 0}, "every must be a whole number from 1"),
        ({"start": -1.0}, "start must be a finite number >= 0"),
        ({"start": float("nan")}, "start must be a finite number >= 0"),
        ({"discs": [1, 1]}, "discs must be numbers of discs, shape (D,), whole, >= 0, each once; got [1, 1]"),
        ({"discs": [-1]}, "discs must be numbers of discs"),
        ({"discs": [0.5]}, "discs must be numbers of discs"),
        ({"discs": 3}, "discs must be numbers of discs"),
        ({"discs": [[1, 2], [3]]}, "discs must be numbers of discs"),
        ({"discs": "all"}, "discs must be numbers of discs"),
        ({"discs": [2**63]}, "discs must be numbers of discs"),
        ({"wave_numbers": [1.0, 0.0]}, "wave_numbers must be at most 64 numbers > 0"),
        ({"wave_numbers": [np.inf]}, "wave_numbers must be finite"),
        ({"wave_numbers": 1.0}, "wave_numbers must have shape (K,)"),
        ({"wave_numbers": np.ones(65)}, "wave_numbers must be at most 64 numbers > 0"),
        ({"longest": 0}, "longest must be a finite number > 0"),
        ({"points": 7}, "points must be even"),
        ({"points": 2}, "points must be a whole number from 4 to 256"),
        ({"points": "16"}, "points must be a whole number from 4 to 256"),
        ({"path": "run.txt"}, "the path of Correlations must end in .npz; got 'run.txt'"),
        ({"path": 3}, "the path of Correlations must end in .npz; got 3"),
    ],
)
def test_bad_arguments_are_refused(given, words):
    with pytest.raises(mpsim.InputError) as caught:
        Correlations(**given)
    assert words in str(caught.value)


def test_bad_questions_are_refused():
    found = correlations()
    after(SCENE, [20], found, **SETTINGS)
    for ask, words in (
        (lambda: found.scattering(2.0), "wave_number must be one of those that were gathered, [1.0]; got 2.0"),
        (lambda: found.scattering(0), "wave_number must be a finite number > 0"),
        (lambda: found.diffusion(route="velocities"), "Did you mean 'velocity'?"),
        (lambda: found.save("there.txt"), "must end in .npz"),
    ):
        with pytest.raises(mpsim.InputError) as caught:
            ask()
        assert words in str(caught.value)
    for ask in (found.diffusion, lambda: correlations().diffusion(), lambda: correlations().save("a.npz")):
        with pytest.raises(mpsim.errors.NotRecordedError):
            ask()


def test_discs_that_are_not_there_are_refused_and_the_run_can_go_on():
    with simulate(SCENE, **SETTINGS) as sim:
        for discs in ([60], []):
            with pytest.raises(mpsim.InputError, match="must be at least one, below 60, the number of discs"):
                sim.run(frames=2, observe=Correlations(discs=np.array(discs, int)))
        sim.run(frames=2)
        assert sim.frame == 2


def test_discs_that_leave_are_refused():
    start = gas(20, 0.2, seed=3)
    leaky = mpsim.Scene(
        width=start.width,
        height=start.height,
        position=start.position,
        velocity=start.velocity + np.array([2.0, 0.0]),
        radius=0.5,
        absorbing="right",
    )
    with simulate(leaky, dt=0.05, method="grid") as sim:
        with pytest.raises(mpsim.InputError, match="must be given for a scene in which discs enter or leave; got None"):
            sim.run(frames=1, observe=Correlations())
        with pytest.raises(mpsim.InputError, match=r"disc \d+ has left it by frame \d+"):
            sim.run(frames=2000, observe=Correlations(discs=range(20)))


def test_discs_that_are_added_or_another_dt_are_refused():
    found = correlations()
    with simulate(gas(20, 0.1, seed=3), **SETTINGS) as sim:
        sim.run(frames=4, observe=found)
        sim.change(dt=0.02)
        with pytest.raises(
            mpsim.InputError, match=r"same dt and number of discs throughout, \(0.05, 20\); got \(0.02, 20"
        ):
            sim.run(frames=4, observe=found)


def test_another_simulation_is_refused():
    found = correlations()
    after(SCENE, [4], found, **SETTINGS)
    with (
        simulate(SCENE, **SETTINGS) as sim,
        pytest.raises(mpsim.InputError, match="Correlations must observe one simulation"),
    ):
        sim.run(frames=4, observe=found)


def test_memory_has_a_bound(monkeypatch):
    monkeypatch.setattr(module, "MOST_BYTES", 10**6)
    with simulate(SCENE, **SETTINGS) as sim:
        with pytest.raises(mpsim.InputError, match="may keep 1,000,000 bytes at most; 60 discs at lags up to"):
            sim.run(frames=1, observe=Correlations())
        sim.run(frames=1, observe=Correlations(longest=1.0))
        with pytest.raises(mpsim.InputError, match=r"longest must be at most 1e\+12 sampling intervals"):
            sim.run(frames=1, observe=Correlations(longest=1e13))


def test_memory_does_not_grow_with_the_run():
    """Levels beyond the longest lag are not begun."""
    found = Correlations(longest=2.0)
    after(gas(4, 0.1, **TORUS), [300], found, **SETTINGS)
    assert found.msd.lag[-1] == pytest.approx(15 * 4 * 0.05)
    assert len(found._motion.correlator.recent) == 3


class EndsError(Exception):
    """What ends a run in the middle."""


class Ending:
    """An observer that ends the run at a frame."""

    every = 1

    def __init__(self, frame):
        self._frame = frame

    def look(self, sim, collisions):
        if sim.frame == self._frame:
            raise EndsError


@pytest.mark.parametrize("every", [10, 25])
def test_averages_survive_a_run_that_ends_between_two_checkpoints(every, tmp_path):
    """It is continued from the last checkpoint, with the bits of a run that never stopped."""
    whole = after(SCENE, [200], correlations(), **SETTINGS)
    first, files = correlations(path=tmp_path / "c.npz"), {"checkpoint": tmp_path / "run", "checkpoint_every": every}
    with simulate(SCENE, **SETTINGS) as sim, pytest.raises(EndsError):
        sim.run(frames=200, observe=[first, Ending(117)], **files)
    again = Correlations.load(tmp_path / "c.npz")
    with mpsim.Simulation.resume(tmp_path / "run") as sim:
        assert sim.frame == 117 // every * every
        sim.run(frames=200 - sim.frame, observe=again, **files)
    assert gathered(again) == whole
    assert gathered(Correlations.load(tmp_path / "c.npz")) == whole


def test_averages_that_are_ahead_of_the_checkpoint_take_no_look_twice(tmp_path):
    """As where the process died after the file of averages was written, and before the checkpoint was."""
    whole, first = after(SCENE, [100], correlations(), **SETTINGS), correlations()
    with simulate(SCENE, **SETTINGS) as sim:
        sim.run(frames=30, observe=first)
        sim.save(tmp_path / "run")
        sim.run(frames=30, observe=first)
        first.save(tmp_path / "c.npz")
    again = Correlations.load(tmp_path / "c.npz")
    with mpsim.Simulation.resume(tmp_path / "run") as sim:
        sim.run(frames=70, observe=again)
    assert gathered(again) == whole


def test_averages_of_another_simulation_are_noticed_when_it_continues(tmp_path):
    """Negative control: the same scene but for its seed."""
    first = correlations()
    after(SCENE, [60], first, **SETTINGS)
    first.save(tmp_path / "c.npz")
    again, words = Correlations.load(tmp_path / "c.npz"), "at frame 60 they contain other positions or velocities"
    with simulate(gas(60, 0.3, seed=9, **TORUS), **SETTINGS) as sim, pytest.raises(mpsim.InputError, match=words):
        sim.run(frames=100, observe=again)


def test_a_file_that_is_there_is_not_written_over(tmp_path):
    (tmp_path / "c.npz").write_bytes(b"something")
    with pytest.raises(mpsim.InputError, match=r"is there already\. Continue it by"):
        Correlations(path=tmp_path / "c.npz")


def test_a_path_without_a_checkpoint_writes_nothing(tmp_path):
    after(SCENE, [4], correlations(path=tmp_path / "c.npz"), **SETTINGS)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_written_to_is_said(tmp_path):
    found = correlations()
    after(SCENE, [4], found, **SETTINGS)
    with pytest.raises(mpsim.errors.OutputError, match="must be in a folder that can be written to"):
        found.save(tmp_path / "none" / "c.npz")
    with contextlib.suppress(FileNotFoundError):
        assert not os.listdir(tmp_path / "none")
