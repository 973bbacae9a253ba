"""Any scene has the same bits, whoever computes it and however the run is cut: pieces, resumes, observers, workers.

Any features, settings and precision, by naive, grid, parallel and event. The slow twin says what the bits of naive and
grid are. In plain Python parallel has one worker, however many are asked for.
"""

import tempfile

import numpy as np
import pytest
from support.anything import any_gas, anything, typical_time
from support.compare import assert_same_bits
from support.scenes import simulate
from support.twins import Twin

import mpsim
from mpsim.measure import registry

FRAMES = 12

pytestmark = [pytest.mark.plain, pytest.mark.filterwarnings("ignore::UserWarning")]


class Looker:
    """Who looks at every third frame, and takes copies of everything."""

    every = 3

    def observe(self, sim, collisions):
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
    with tempfile.TemporaryDirectory() as folder:
        with simulate(scene, **settings) as sim:
            sim.run(frames=sum(pieces[:2]), measures=allowed(scene, scene.count))
            path = sim.save(f"{folder}/run.mpsim")
        with mpsim.Simulation.resume(path, workers=settings.get("workers")) as sim:
            sim.run(frames=sum(pieces[2:]), measures=allowed(scene, sim.count))
            assert_same(sim, reference, f"{note}, resumed after frame {sum(pieces[:2])}")


def allowed(scene, count):
    """The measures that the scene allows, with the discs that have entered."""
    return [name for name in registry.NAMES if registry.refusal(name, scene, count) is None]


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
    if seed % 3:
        return contacts
    settings["method"] = "grid"
    with simulate(scene, **settings) as reference:
        reference.run(frames=FRAMES)
        shared = settings | {"method": "parallel", "workers": 1 + seed // 3 % 3}
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


@pytest.mark.parametrize("check", [check_stepped, check_exact])
def test_any_scene_has_the_same_bits_however_it_is_run(check):
    assert sum(map(check, range(3))) > 10
