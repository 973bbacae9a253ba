"""Discs make room for a disc or a wall that is put among them, and are moved no farther than needed."""

import numpy as np
import pytest
from support.scenes import gas

import mpsim
from mpsim.engine.room import make_room
from mpsim.features.capsules import of_discs
from mpsim.features.obstacles import capsules_of

CROWDED = {
    "gas": lambda: gas(48, 0.4),
    "dense": lambda: gas(200, 0.7),
    "dense, periodic": lambda: gas(48, 0.7, boundary="periodic"),
    "two sizes": lambda: mpsim.Scene.random(count=40, packing=0.6, radius=[0.5, 0.25] * 20, seed=3),
}


def overlap(sim):
    """The deepest overlap of two discs, or of a disc and an obstacle [length]."""
    state, scene = sim.state, sim.scene
    apart = state.position[:, None] - state.position
    apart -= np.round(apart / (scene.width, scene.height)) * (scene.width, scene.height) * np.array(scene.periodic)
    depth = sim.radii[:, None] + sim.radii - np.hypot(*np.moveaxis(apart, -1, 0))
    found = scene._deepest(state.position, sim.radii, sim.time)
    return max(depth[~np.eye(sim.count, dtype=bool)].max(), 0.0 if found is None else found.depth)


@pytest.mark.slow
@pytest.mark.parametrize(("words", "method"), [(words, "grid") for words in CROWDED] + [("dense", "event")])
def test_there_is_room_for_a_disc_and_for_a_wall_in_20_of_20_places(words, method):
    scene, rng = CROWDED[words](), np.random.default_rng(4)
    radius, size = scene.largest_radius, np.array([scene.width, scene.height])
    with mpsim.Simulation(scene, mpsim.Settings(method=method)) as sim:
        sim.run(frames=2)
        start, before, least = sim.snapshot(), sim.state.position, max(overlap(sim), 1e-12)
        for _ in range(20):
            x, y = radius + rng.random(2) * (size - 2 * radius)
            pushed = make_room(sim, of_discs(np.array([[x, y]]), np.array([radius])))
            assert pushed == ("set" in [each.what for each in sim.journal])
            moved = sim.state.position - before
            moved -= np.round(moved / size) * size * np.array(scene.periodic)
            far = np.hypot(*moved.T) / radius
            assert far.max() < (2 if words == "gas" else 4)
            assert (far > 0).sum() <= (8 if words == "gas" else 100)
            sim.add((x, y), (0.0, 0.0), **({"radius": radius} if words == "two sizes" else {}))
            assert overlap(sim) <= least
            sim.restore(start)
        for _ in range(20):
            ends = rng.random((2, 2)) * size
            make_room(sim, capsules_of((mpsim.Polyline(ends, radius / 2),)))
            sim.add_wall(ends, radius / 2)
            assert overlap(sim) <= least
            sim.restore(start)
