"""Any scene has the same bits, whoever computes it and however the run is cut: workers, pieces, resumes, observers.

Scenes run as plain Python, in a process of their own, where no combination of features is compiled: any features,
settings and precision, by naive, grid and parallel on 1, 2 or 3 workers, and by event. The slow twin says what the
bits of naive and grid are. A few combinations run compiled. One execution: a scene, run in all these ways.
Executions: 51 by default, 4,680 with --long.
"""

import tempfile
import warnings

import numpy as np
import pytest
from support.anything import anything
from support.compare import assert_same_bits
from support.gases import any_gas, typical_time
from support.processes import assert_clean, run_script
from support.scenes import ZOO, crowd, simulate, zoo
from support.selection import long_but
from support.twins import Twin

import mpsim
from mpsim.measure import run_averages

FRAMES = 12


class Looker:
    """Who looks at every third frame, and takes copies of everything."""

    every = 3

    def look(self, sim, collisions):
        self.seen = sim.state, sim.absorbed, sim.radii, sim.masses, sim.digest()


def assert_same(sim, reference, note):
    """Fail unless two simulations have come to the same, in every array that they show."""
    assert_same_bits(sim.state, reference.state, note)
    assert sim.digest() == reference.digest(), f"{note}: another digest"
    for name in ("absorbed", "radii", "masses"):
        got, expected = getattr(sim, name).tolist(), getattr(reference, name).tolist()
        assert got == expected, f"{note}: {name} are {got}, expected {expected}"
    got, expected = (sim.frame, sim.time, sim.count), (reference.frame, reference.time, reference.count)
    assert got == expected, f"{note}: frame, time and count are {got}, expected {expected}"


def in_pieces(scene, settings, pieces, reference, note):
    """Frame counts one after the other, looked at; then half of them, saved and resumed, with measures."""
    with simulate(scene, **settings) as sim:
        for frames in pieces:
            sim.run(frames=frames, observe=Looker())
        assert_same(sim, reference, f"{note}, in pieces {pieces}")
    names = [name for name in run_averages.NAMES if run_averages.refusal(name, scene) is None]
    with tempfile.TemporaryDirectory() as folder:
        with simulate(scene, **settings) as sim:
            sim.run(frames=sum(pieces[:2]), measures=names)
            path = sim.save(f"{folder}/run.mpsim")
        with mpsim.Simulation.resume(path, workers=settings.get("workers")) as sim:
            sim.run(frames=sum(pieces[2:]), measures=resumable(scene, sim, names))
            assert_same(sim, reference, f"{note}, resumed after frame {sum(pieces[:2])}")


def resumable(scene, sim, names):
    """The measures that the scene still allows, with the discs that have entered."""
    return [name for name in names if run_averages.refusal(name, scene, sim.count) is None]


def drawn_pieces(rng):
    """Four numbers of frames, some 0, whose sum is FRAMES."""
    cuts = np.sort(rng.integers(0, FRAMES + 1, 3))
    return np.diff(np.concatenate([[0], cuts, [FRAMES]])).tolist()


def check_stepped(seed):
    """Any scene, by the method drawn, its twin, and workers. Returns contacts."""
    scene, settings = anything(seed)
    twin = Twin(scene, **settings)
    twin.run(FRAMES)
    contacts = check_ways(seed, scene, settings, twin)
    return contacts + (check_free(seed) if seed % 3 == 0 else 0)


def check_free(seed):
    """A scene that the twin does not know: emitters with a piston, sub-steps chosen on the way. Returns contacts."""
    scene, settings = anything(seed, twin=False)
    try:
        return check_ways(seed, scene, settings)
    except mpsim.TooFastError:  # of speeds for which no number of sub-steps is enough
        return 0


def check_ways(seed, scene, settings, twin=None):
    """In pieces, resumed, measured, and on workers. Returns contacts."""
    rng = np.random.default_rng([seed, 4])
    note = f"scene {seed}, {scene!r}, {settings}"
    with simulate(scene, **settings) as reference:
        contacts = reference.run(frames=FRAMES).collisions
        if twin is not None:
            assert_same_bits(reference.state, twin.state, f"{note}, against the twin")
            assert contacts == twin.contacts, f"{note}: {contacts} contacts, the twin has {twin.contacts}"
        in_pieces(scene, settings, drawn_pieces(rng), reference, note)
    settings["method"] = "grid"
    with simulate(scene, **settings) as reference:
        reference.run(frames=FRAMES)
        shared = settings | {"method": "parallel", "workers": 1 + seed % 3}
        in_pieces(scene, shared, drawn_pieces(rng), reference, f"{note}, {shared['workers']} workers")
    return contacts


def check_exact(seed):
    """Any gas by event. Returns collisions."""
    scene = any_gas(seed)
    settings = {"method": "event", "dt": typical_time(scene) / 4}
    with simulate(scene, **settings) as reference:
        contacts = reference.run(frames=FRAMES).collisions
        pieces = drawn_pieces(np.random.default_rng([seed, 5]))
        in_pieces(scene, settings, pieces, reference, f"gas {seed}, {scene!r}, {settings}")
    return contacts


def check_many(stepped, exact):
    """What runs as plain Python. Prints the number of contacts."""
    warnings.simplefilter("ignore")
    print(sum(map(check_stepped, range(*stepped))) + sum(map(check_exact, range(*exact))))


def plain(stepped, exact, bound):
    text = f"from twins.test_bits import check_many; check_many({stepped}, {exact})"
    outcome = run_script(text, env={"NUMBA_DISABLE_JIT": "1"}, bound=bound)
    assert_clean(outcome)
    return int(outcome.out)


@pytest.mark.slow
def test_any_scene_has_the_same_bits_however_it_is_run():
    assert plain((0, 10), (0, 10), bound=120) > 150


@pytest.mark.long
@pytest.mark.timeout(2100)
def test_thousands_of_scenes_have_the_same_bits_however_they_are_run():
    plain((1000, 4000), (1000, 1600), bound=2000)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::mpsim.errors.EmitterWarning")
@pytest.mark.filterwarnings("ignore::mpsim.FastWarning")  # of the tail of the speeds, and of discs dropped on others
@pytest.mark.parametrize("name", long_but(ZOO, "everything"))
@pytest.mark.parametrize("seed", [0, 1])
def test_compiled_scenes_have_the_same_bits_however_they_are_run(name, seed):
    scene = zoo(ZOO[name], 300, seed=100 + seed, side=20.0)
    settings = {"method": "grid", "contact": "impact", "dt": 0.03}
    with simulate(scene, **settings) as reference:
        assert reference.run(frames=FRAMES).collisions > 100
        for workers in (1, 2, 3):
            shared = settings | {"method": "parallel", "workers": workers}
            with simulate(scene, **shared) as sim:
                for frames in drawn_pieces(np.random.default_rng([seed, workers])):
                    sim.run(frames=frames, observe=Looker())
                assert_same(sim, reference, f"{name}, {seed}, {workers} workers")


@pytest.mark.slow
def test_a_nudge_and_unguarded_columns_are_seen():
    """The control: another last digit, and another order of columns, are other bits."""
    scene = crowd(500, 0.85, seed=3)
    nudged = scene.position.copy()
    nudged[0, 0] = np.nextafter(nudged[0, 0], 10)
    for other, flag in ((scene.starting_from(mpsim.State(nudged, scene.velocity)), False), (scene, True)):
        with simulate(scene, method="grid") as reference, simulate(other, method="grid", unguarded=flag) as sim:
            reference.run(frames=5)
            sim.run(frames=5)
            with pytest.raises(AssertionError, match="discs differ in position"):
                assert_same(sim, reference, "control")
