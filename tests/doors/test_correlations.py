"""Correlations along a run: each lag against a slow twin, errors that hold, pauses and checkpoints, files, refusals.

Most of them look at motions that are made up: an observer reads nothing of a simulation but its public names.
"""

import contextlib

import numpy as np
import pytest
from support.scenes import At, gas, simulate

import mpsim
from mpsim import Correlations

pytestmark = pytest.mark.plain

SCENE = gas(9, 0.1, seed=2)


class Moving:
    """What looks like a simulation of discs that have these velocities, shape (frames, D, 2), each for one step."""

    def __init__(self, velocities, dt=1.0, scene=SCENE, change=None):
        self.velocities, self.settings, self.scene = np.asarray(velocities, float), mpsim.Settings(dt=dt), scene
        self.places = np.concatenate([np.zeros_like(self.velocities[:1]), np.cumsum(self.velocities * dt, axis=0)])
        self.frame, self.count, self.change = 0, self.velocities.shape[1], change

    time = property(lambda self: self.frame * self.settings.dt)
    state = property(lambda self: mpsim.State(self.places[self.frame], self.velocities[self.frame]))

    def run(self, observer, first=0, last=None):
        for frame in range(first, len(self.velocities) if last is None else last):
            self.frame = frame
            if frame % observer.every == 0:
                observer.observe(self, 0)
        return observer


def random(*shape, seed=1):
    return np.random.default_rng(seed).normal(size=shape)


@pytest.mark.parametrize("samples", [1, 7, 300])
def test_each_lag_is_the_mean_over_all_its_time_origins(samples):
    """By hand from the whole series: the last place of each block of 2^level samples, its mean velocity, k 2^level."""
    velocities = random(samples, 3, 2) + np.sin(np.arange(samples) / 9)[:, None, None]
    sim = Moving(velocities)
    found = sim.run(Correlations(points=8, wave_numbers=[0.7], longest=8 * 2**5 - 40))
    lags = [(level, k) for level in range(6) for k in range(4 if level else 0, 8) if samples // 2**level > k]
    functions = found.msd, found.velocity, found.scattering(0.7)
    assert functions[0].lag.tolist() == [k * 2**level for level, k in lags]
    for index, (level, k) in enumerate(lags):
        size, blocks = 2**level, samples // 2**level
        places = sim.places[size - 1 :: size][:blocks]
        means = velocities[: size * blocks].reshape(blocks, size, 3, 2).mean(axis=1)
        moved, origins = places[k:] - places[: blocks - k], blocks - k
        expected = (moved**2).sum(axis=2).mean(), (means[k:] * means[:origins]).sum(axis=2).mean()
        measures = [each[index] for each in functions]
        assert [each.value for each in measures] == pytest.approx([*expected, np.cos(0.7 * moved).mean()], abs=1e-12)
        assert measures[1].samples == origins
    assert functions[1].width.tolist() == [2**level - 1 for level, _ in lags]
    assert not functions[0].width.any()


def test_no_lag_reaches_across_a_pause_or_a_change_of_discs():
    sim, velocities = Moving(random(60, 3, 2)), random(41, 3, 2)
    paused = sim.run(sim.run(Correlations(every=2), 0, 21), 30, 51)
    assert [each.samples for each in paused.velocity.measures][:4] == [22, 20, 18, 16]
    kicked = Moving(velocities)
    found = kicked.run(Correlations(every=2), 0, 21)
    kicked.velocities[20] += 5  # between two runs: a new sample of the same frame
    kicked.run(found, 20)
    assert [each.samples for each in found.velocity.measures][:4] == [22, 20, 18, 16]
    again = Moving(velocities)
    assert again.run(again.run(Correlations(every=2), 0, 21), 20).velocity[0].samples == 21, "the control"


def test_only_named_discs_are_followed_from_the_start_on():
    sim = Moving(random(40, 6, 2), dt=0.5)
    found = sim.run(Correlations(discs=[5, 2], start=3.0))
    moved = sim.places[10:40, [5, 2]] - sim.places[6:36, [5, 2]]
    assert found.msd.lag[4] == 2.0
    assert found.msd[4].value == pytest.approx((moved**2).sum(axis=2).mean())
    assert repr(found) == "<Correlations: 34 samples of 2 discs, lags up to 15>"
    early = Correlations(start=30.0)
    assert repr(sim.run(early)) == "<Correlations: nothing gathered yet>"
    with pytest.raises(mpsim.errors.NotRecordedError, match="let the run pass start = 30"):
        early.msd  # noqa: B018


# --- discs that drift, discs that walk at random


@pytest.fixture(scope="module")
def walk():
    """Steps that are all independent: D = dt <v^2>/4 = 0.25 from the first lag on."""
    return Moving(random(1500, 20, 2), dt=0.5).run(Correlations(wave_numbers=[0.5], longest=500))


def test_a_random_walk_has_its_diffusion_constant_by_both_routes(walk):
    """The trapezoidal rule gives the sample at lag 0 half its weight: for a walk all of the integral."""
    for route in ("displacement", "velocity"):
        found = walk.diffusion(route=route)
        assert found.settled
        assert found.error < 0.04
        assert abs(found.deviation(0.25)) < 3
    assert walk.diffusion(0.0, 0.5).value == pytest.approx(walk.msd[1].value / 2)
    scattering = walk.scattering(0.5)
    for index in (1, 4, 12):
        expected = np.exp(-(0.5**2) * 0.25 * scattering.lag[index])
        assert abs(scattering[index].deviation(expected)) < 3 < abs(scattering[index].deviation(expected**1.1))


def test_errors_of_displacements_are_unknown_where_time_origins_overlap(walk):
    squares = walk.msd
    long = squares.lag * 25 > 750
    assert 0 < long.sum() < len(long)
    assert not squares.settled[long].any()
    assert squares.settled[~long].mean() > 0.9
    assert walk.velocity.settled[long].mean() > 0.8
    assert not walk.diffusion(50.0, 100.0).settled


def test_discs_that_drift_never_diffuse():
    steady = Moving(np.tile([[1.0, 0.0], [0.0, -2.0]], (200, 1, 1)), dt=0.5).run(Correlations())
    assert steady.msd.value == pytest.approx(2.5 * steady.msd.lag**2)
    assert (steady.msd[0].value, steady.msd[0].error) == (0, 0)
    assert steady.velocity.value == pytest.approx(np.full(len(steady.velocity), 2.5))
    assert (steady.velocity[0].error, np.isnan(steady.velocity.error[1])) == (0, True), "the energy is kept"
    assert not steady.diffusion(route="velocity").settled


@pytest.mark.parametrize(("rate", "settled"), [(0.5, True), (0.002, False)])
def test_in_a_heat_bath_the_energy_is_known_after_many_memories_of_it(rate, settled):
    """Its error at least that of a canonical energy that the bath exchanges in 1/(2 rate)."""
    bath = gas(9, 0.1, seed=2, thermostat=mpsim.Thermostat(1.0, rate))
    measure = Moving(random(500, 9, 2), scene=bath).run(Correlations()).velocity[0]
    assert measure.settled is settled
    canonical = measure.value / 3  # of nine discs
    assert (measure.error > 0.3 * canonical) is not settled


# --- real runs: parts, checkpoints, files


def gathered(correlations):
    """All that was gathered, to the bit."""
    functions = [correlations.msd, correlations.velocity, *map(correlations.scattering, correlations.wave_numbers)]
    return [each.tobytes() for one in functions for each in (one.lag, one.value, one.error)]


def correlations(**given):
    return Correlations(every=2, wave_numbers=[1.0], **given)


SETTINGS = {"dt": 0.05, "method": "naive"}
TORUS = gas(8, 0.2, seed=2, boundary="periodic")


@pytest.fixture(scope="module")
def whole():
    found = correlations()
    with simulate(TORUS, **SETTINGS) as sim:
        sim.run(frames=80, observe=found)
        return gathered(found), sim.digest()


def end(sim):
    raise ZeroDivisionError


def test_a_run_in_parts_gives_the_bits_of_one_and_looking_changes_none(whole):
    found = correlations()
    with simulate(TORUS, **SETTINGS) as sim, simulate(TORUS, **SETTINGS) as plain:
        for frames in (31, 0, 40, 9):
            sim.run(frames=frames, observe=found)
        plain.run(frames=80)
        assert (gathered(found), sim.digest()) == whole
        assert plain.digest() == whole[1]


def test_averages_survive_a_run_that_ends_between_two_checkpoints(tmp_path, whole):
    first, files = correlations(path=tmp_path / "c.npz"), {"checkpoint": tmp_path / "run", "checkpoint_every": 25}
    with simulate(TORUS, **SETTINGS) as sim, pytest.raises(ZeroDivisionError):
        sim.run(frames=80, observe=[first, At(57, end)], **files)
    again = Correlations.load(tmp_path / "c.npz")
    with mpsim.Simulation.resume(tmp_path / "run") as sim:
        assert sim.frame == 50
        sim.run(frames=80 - sim.frame, observe=again, **files)
    assert gathered(again) == gathered(Correlations.load(tmp_path / "c.npz")) == whole[0]


def test_averages_that_are_ahead_of_the_checkpoint_take_no_look_twice_and_know_their_simulation(tmp_path, whole):
    """As where the process died after the file of averages was written, and before the checkpoint was."""
    first = correlations()
    with simulate(TORUS, **SETTINGS) as sim:
        sim.run(frames=30, observe=first)
        sim.save(tmp_path / "run")
        sim.run(frames=30, observe=first)
        first.save(tmp_path / "c.npz")
    again, other = (Correlations.load(tmp_path / "c.npz") for _ in range(2))
    with mpsim.Simulation.resume(tmp_path / "run") as sim:
        sim.run(frames=50, observe=again)
    assert gathered(again) == whole[0]
    with (
        simulate(gas(8, 0.2, seed=9, boundary="periodic"), **SETTINGS) as sim,
        pytest.raises(mpsim.InputError, match="at frame 60 they contain other"),
    ):
        sim.run(frames=70, observe=other)
    with simulate(TORUS, **SETTINGS) as sim, pytest.raises(mpsim.InputError, match="belongs to one simulation"):
        sim.run(frames=4, observe=again)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A file, what is in it having come back to the bit."""
    path = tmp_path_factory.mktemp("correlations") / "c.npz"
    found = Correlations(every=3, start=0.1, discs=[4, 1, 2], wave_numbers=[0.5, 2.0], points=8)
    Moving(random(400, 6, 2), dt=0.05).run(found).save(path)
    again = Correlations.load(path)
    assert (again.every, again.start, again.path, repr(again)) == (3, 0.1, path, repr(found))
    assert gathered(again) == gathered(found)
    return path


def test_a_file_of_another_version_is_refused(written, tmp_path):
    with np.load(written) as file:
        arrays = {key: file[key] for key in file.files}
    for change, words in ({}, None), ({"format": arrays["format"] + 1}, "it is of version 4, and 3 is read"):
        np.savez(tmp_path / "c.npz", **arrays | change)
        with pytest.raises(mpsim.InputError, match=words) if words else contextlib.nullcontext():
            Correlations.load(tmp_path / "c.npz")


def test_files_that_are_cut_off_missing_or_in_the_way_are_refused(written, tmp_path):
    whole = written.read_bytes()
    for damaged in (b"", whole[:10], whole[:1000], whole[:-1], whole[:3000] + b"\xff" * 9 + whole[3009:]):
        (tmp_path / "cut.npz").write_bytes(damaged)
        with pytest.raises(mpsim.InputError, match="must be one that mpsim has written"):
            Correlations.load(tmp_path / "cut.npz")
    (tmp_path / "folder.npz").mkdir()
    for path, words in (("none.npz", "No such file"), ("folder.npz", "directory"), ("c.txt", r"must end in \.npz")):
        with pytest.raises(mpsim.InputError, match=words):
            Correlations.load(tmp_path / path)
    with pytest.raises(mpsim.InputError, match=r"is there already\. Continue it by"):
        Correlations(path=tmp_path / "cut.npz")
    with pytest.raises(mpsim.errors.OutputError, match="must be in a folder that can be written to"):
        Correlations.load(written).save(tmp_path / "none" / "c.npz")


# --- refusals


def test_wrong_arguments_and_questions_are_refused(walk):
    for ask, words in (
        (lambda: Correlations(discs=[1, 1]), r"discs must be .*, whole, >= 0, each once; got \[1, 1\]"),
        (lambda: Correlations(discs=[2**63]), "discs must be numbers of discs"),
        (lambda: Correlations(wave_numbers=[1.0, 0.0]), "wave_numbers must be at most 64 numbers > 0"),
        (lambda: Correlations(points=7), "points must be even"),
        (lambda: Correlations(path="run.txt"), "the path of Correlations must end in .npz; got 'run.txt'"),
        (lambda: walk.scattering(2.0), r"wave_number must be one of those that were gathered, \[0.5\]; got 2.0"),
        (lambda: walk.diffusion(route="velocities"), "Did you mean 'velocity'?"),
        (lambda: walk.diffusion(None, 1e9), "end must be a lag that the run has reached, at most"),
        (lambda: walk.diffusion(2.0, 2.0), "start must be before end, by one gathered lag at least; got start = 2.0"),
    ):
        with pytest.raises(mpsim.InputError, match=words):
            ask()
    short = Moving(random(39, 5, 2)).run(Correlations())
    for ask in (short.diffusion, lambda: short.diffusion(None, 0.0), Correlations().diffusion):
        with pytest.raises(mpsim.errors.NotRecordedError):
            ask()
    assert not short.diffusion(1.0, 5.0).settled


def test_runs_that_cannot_be_gathered_are_refused_and_can_go_on():
    leaky = gas(8, 0.2, seed=3, absorbing=("right", "left", "bottom", "top"))
    cases = (
        (TORUS, Correlations(discs=[8]), "must be at least one, below 8, the number of discs"),
        (TORUS, Correlations(longest=1e13), r"longest must be at most 1e\+12 sampling intervals"),
        (leaky, Correlations(), "must be given where discs enter or leave; got None"),
        (leaky, Correlations(discs=range(8)), r"disc \d+ has left it by frame \d+"),
    )
    for scene, observer, words in cases:
        with simulate(scene, **SETTINGS) as sim:
            with pytest.raises(mpsim.InputError, match=words):
                sim.run(frames=400, observe=observer)
            sim.run(frames=1)
    sim = Moving(random(9, 6, 2))
    found = sim.run(Correlations(), 0, 4)
    sim.settings = mpsim.Settings(dt=0.02)
    with pytest.raises(mpsim.InputError, match=r"same dt and number of discs throughout, \(1.0, 6\); got \(0.02, 6"):
        sim.run(found, 4)
    sim.count = 3_000_000
    with pytest.raises(mpsim.InputError, match="may keep 1,073,741,824 bytes at most; 3,000,000 discs at lags up to"):
        sim.run(Correlations())
