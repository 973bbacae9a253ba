"""A million collisions: the pinned bits, as a whole and on tiles, on one worker, two and three, and no energy lost.

The start is made by integer arithmetic and the solver uses + - * / and square roots only, so the digest is that of
every machine with IEEE arithmetic. After a change of the dynamics on purpose:

    python -m pytest tests/contracts/test_million.py --renew
"""

import json
from pathlib import Path

import numpy as np
import pytest
from support.scenes import lattice
from support.tiles import on_tiles

import mpsim
from mpsim.measure import kinetic_energy

pytestmark = [pytest.mark.compiled, pytest.mark.long]

FILE = Path(__file__).parent / "million.json"
FRAMES, DT = 54, 8.0
DRIFT = 1e-12
"""Of the energy; a random walk of a million roundings would come to a tenth of it."""


def gas() -> mpsim.Scene:
    """1,000 discs at packing 0.4 that begin as a lattice, in a channel that is periodic along x."""
    start = lattice(40, 25, 1.40625)
    assert 0.39 < np.pi * 0.25 * start.count / (start.width * start.height) < 0.4
    return mpsim.Scene(width=start.width, height=start.height, position=start.position, velocity=start.velocity,
                       radius=0.5, boundary=("periodic", "walls"))  # fmt: skip


def outcome(scene: mpsim.Scene, sim: mpsim.Simulation) -> dict[str, object]:
    """What a run comes to; its energy must be that of the start."""
    collisions = sim.run(frames=FRAMES).collisions
    before = kinetic_energy(mpsim.State(scene.position, scene.velocity), scene)
    assert abs(kinetic_energy(sim.state, scene) / before - 1) < DRIFT
    return {"collisions": collisions, "digest": sim.digest()}


@pytest.fixture(scope="module")
def pinned(request):
    if request.config.getoption("--renew"):
        with on_tiles(gas(), (1, 1), dt=DT) as sim:
            FILE.write_text(json.dumps(outcome(gas(), sim)) + "\n")
    return json.loads(FILE.read_text())


def test_a_million_collisions_have_the_pinned_bits(pinned):
    assert pinned["collisions"] > 1_000_000
    with on_tiles(gas(), (1, 1), dt=DT) as sim:
        assert outcome(gas(), sim) == pinned
