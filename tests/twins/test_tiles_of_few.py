"""The exact solver on tiles, in plain Python, has the bits, counts and collisions of the box as a whole.

The boxes are strips of some hundred discs: so long that each tile has a middle, so short that most discs are near a
border. In the tests of contracts are thousands, compiled, and on any number of workers.
"""

import math

import numpy as np
import pytest
from support.scenes import simulate
from support.tiles import always_tiled, on_tiles, tallies, windows_of

import mpsim

pytestmark = [pytest.mark.plain, pytest.mark.filterwarnings("ignore:overflow encountered in scalar")]  # of hashes

COUNT = 140
INDEX = np.arange(COUNT)

SCENES = {
    "walls": {},
    "periodic": {"boundary": "periodic", "mass": np.where(INDEX % 3, 1.0, 3.0)},
    "everything": {
        "gravity": (0.25, -1.0),
        "friction": 0.5,
        "spin": (INDEX % 5 - 2) / 2,
        "restitution": 0.9,
        "absorbing": "top",
        "obstacles": mpsim.FixedDisc((0.5 * COUNT * math.pi / 4 / 0.3 / 5, 2.5), 0.25),
        "piston": mpsim.Piston("right", -0.25, 0.9 * COUNT * math.pi / 4 / 0.3 / 5),
    },
}


def strip(name):
    width = COUNT * math.pi / 4 / 0.3 / 5
    return mpsim.Scene.random(count=COUNT, width=width, height=5.0, radius=0.5, seed=2, **SCENES[name])


def played(name, tiling, pieces=(3, 1), dt=0.1, halo=10):
    """State, contacts, rows of collisions and pressure; and what the windows came to."""
    seen, contacts = mpsim.Collisions(), 0
    with always_tiled(*tiling, halo=halo), simulate(strip(name), method="event", dt=dt, contact_time=1e-3) as sim:
        for frames in pieces:
            report = sim.run(frames=frames, observe=seen, measures=["pressure"] if name == "walls" else [])
            contacts += report.collisions
        found = sim.digest(), contacts, seen.table.tobytes(), report.measures
        return found, windows_of(sim) if tiling != (1, 1) else None


@pytest.mark.filterwarnings("ignore::mpsim.errors.GuardWarning")
@pytest.mark.parametrize(("name", "tiling"), [("periodic", (3, 1)), ("everything", (2, 1))])
def test_tiles_have_the_bits_and_counts_of_the_whole(name, tiling):
    expected, _ = played(name, (1, 1))
    found, windows = played(name, tiling)
    assert found == expected
    assert windows["windows"] > windows["as_one"] + windows["again"], "tiles that agree are taken over"
    assert expected[1] > 40


def test_a_window_of_several_frames_counts_each_of_them():
    counted = {}
    for tiling in ((1, 1), (2, 1)):
        with on_tiles(strip("walls"), tiling, halo=10, dt=0.01) as sim:
            counted[tiling] = tallies(sim, 12)
            if tiling != (1, 1):
                windows = windows_of(sim)
                assert 0 < windows["windows"] - windows["as_one"] < 6, "each of several frames"
    assert counted[2, 1].tobytes() == counted[1, 1].tobytes()
    assert (counted[1, 1]["collisions"] > 0).sum() > 6


def test_a_halo_that_is_too_thin_is_noticed_and_played_again():
    """The control of the comparison: discs from outside the halo come to bear within a window."""
    found, windows = played("walls", (2, 1), pieces=(1,), dt=1.0, halo=3)
    assert found == played("walls", (1, 1), pieces=(1,), dt=1.0)[0]
    assert windows["again"] > 0
