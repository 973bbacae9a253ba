"""What is in the file of a checkpoint."""

import numpy as np
import pytest
from support.checkpoints import rewrite
from support.scenes import gas, simulate
from support.selection import long_but

import mpsim

MASSES, RADII = [1.0, 2.0, 3.0, 1.0], [0.5, 0.4, 0.5, 0.3]
PLACES = [[1, 1], [3, 1], [1, 3], [3, 3]]


def scene_of(**sizes):
    """Four discs at rest."""
    return mpsim.Scene(width=4, height=4, position=PLACES, velocity=np.zeros((4, 2)), **sizes)


@pytest.mark.slow
@pytest.mark.usefixtures("compiled_when_run")
@pytest.mark.parametrize("method", long_but(["grid", "event"], "grid"))
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


def test_a_lattice_is_a_few_numbers_in_the_file_and_a_lattice_again_when_read(tmp_path):
    scene = mpsim.Scene.lattice(count=5000, packing=0.4, radius=0.5, seed=2, duration=3.0)
    with simulate(scene, method="grid", precision="float32") as sim:
        sim.run(frames=3)
        path, digest = sim.save(tmp_path / "run.mpsim"), sim.digest()
    with np.load(path) as file:
        assert [name for name in file.files if name.startswith("scene.")] == ["scene.radius"]
    assert path.stat().st_size < 17 * scene.count, "the positions and velocities of now, in float32"
    with mpsim.Simulation.resume(path) as sim:
        assert sim.scene.on_lattice == scene.on_lattice
        assert sim.scene.digest() == scene.digest()
        assert (sim.scene.duration, sim.digest()) == (3.0, digest)


def change_lattice(**changed):
    return lambda header, arrays: header["scene"]["lattice"].update(changed)


BAD_LATTICES = {
    "another seed": (change_lattice(seed=3), "its lattice has other discs here"),
    "another digest": (change_lattice(digest="00"), "its lattice has other discs here"),
    "a digest that is none": (change_lattice(digest=None), "its lattice has other discs here"),
    "fewer discs": (change_lattice(count=49), "its lattice has other discs here"),
    "far too many": (change_lattice(count=10**15), "count must be a whole number from 0 to 100000000"),
    "too many for the box": (change_lattice(count=5000), "count must leave room for a hexagonal lattice"),
    "a negative temperature": (change_lattice(temperature=-1.0), "temperature must be"),
    "a temperature in words": (change_lattice(temperature="hot"), "temperature must be"),
    "another key": (change_lattice(packing=0.4), "its lattice must have count, temperature, seed and digest"),
    "no table": (lambda header, arrays: header["scene"].update(lattice=[1]), "its lattice must have"),
    "places beside it": (
        lambda header, arrays: arrays.update({"scene.position": np.ones((50, 2)), "scene.velocity": np.ones((50, 2))}),
        "position",
    ),
    "masses": (lambda header, arrays: arrays.update({"scene.mass": np.full(50, 2.0)}), "mass must be left out"),
    "radii": (
        lambda header, arrays: arrays.update({"scene.radius": np.linspace(0.4, 0.5, 50)}),
        "radius of discs on a lattice must be one number",
    ),
}


@pytest.mark.parametrize("case", BAD_LATTICES)
def test_a_lattice_that_was_changed_in_the_file_is_damage(case, tmp_path):
    change, text = BAD_LATTICES[case]
    scene = mpsim.Scene.lattice(count=50, packing=0.3, radius=0.5, seed=2)
    with simulate(scene, method="naive") as sim:
        path = sim.save(tmp_path / "run.mpsim")
    mpsim.Simulation.resume(path).close()
    rewrite(path, change)
    with pytest.raises(mpsim.CheckpointError, match=text):
        mpsim.Simulation.resume(path)


def test_places_and_speeds_are_what_fills_the_file(tmp_path):
    count = 10_000
    with simulate(gas(count, 0.3), method="grid", precision="float32") as sim:
        size = sim.save(tmp_path / "run.mpsim").stat().st_size
    assert 48 * count < size < 49 * count, "those of the start in float64, those of now in float32"
