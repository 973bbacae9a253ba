"""What is in the file of a checkpoint."""

import numpy as np
import pytest
from support.scenes import gas, simulate

import mpsim

MASSES, RADII = [1.0, 2.0, 3.0, 1.0], [0.5, 0.4, 0.5, 0.3]
PLACES = [[1, 1], [3, 1], [1, 3], [3, 3]]


def scene_of(**sizes):
    """Four discs at rest."""
    return mpsim.Scene(width=4, height=4, position=PLACES, velocity=np.zeros((4, 2)), **sizes)


@pytest.mark.parametrize("method", ["grid", "event"])
@pytest.mark.parametrize(
    ("sizes", "shapes"),
    [
        ({"radius": 0.5}, ((), ())),
        ({"radius": 0.5, "mass": [2.0] * 4}, ((), ())),
        ({"radius": 0.5, "mass": MASSES}, ((), (4,))),
        ({"radius": RADII}, ((4,), ())),
        ({"radius": RADII, "mass": MASSES}, ((4,), (4,))),
    ],
)
def test_equal_sizes_are_one_number_in_the_file_and_one_each_again_when_read(sizes, shapes, method, tmp_path):
    with simulate(scene_of(**sizes), method=method) as sim:
        radii, masses, path = sim.radii, sim.masses, sim.save(tmp_path / "run.mpsim")
    with np.load(path) as file:
        assert (file["solver.radii"].shape, file["solver.masses"].shape) == shapes
    with mpsim.Simulation.resume(path) as sim:
        assert (sim.radii.tolist(), sim.masses.tolist()) == (radii.tolist(), masses.tolist())
        sim.add((2.0, 2.0), (0.0, 0.0), **{name: 0.2 for name, value in sizes.items() if np.ndim(value)})
        assert len(sim.radii) == 5


def test_a_scene_without_discs_is_saved_too(tmp_path):
    with simulate(mpsim.Scene(width=4, height=4, position=[], velocity=[], radius=0.5), method="grid") as sim:
        path = sim.save(tmp_path / "run.mpsim")
    with mpsim.Simulation.resume(path) as sim:
        assert sim.count == 0


def test_places_and_speeds_are_what_fills_the_file(tmp_path):
    count = 10_000
    with simulate(gas(count, 0.3), method="grid", precision="float32") as sim:
        size = sim.save(tmp_path / "run.mpsim").stat().st_size
    assert 48 * count < size < 49 * count, "those of the start in float64, those of now in float32"
