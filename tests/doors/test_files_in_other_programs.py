"""Files of mpsim in ASE and freud, and files of ASE in ASE and mpsim: the same numbers."""

import numpy as np
import pytest
from support.trajectories import DT, SCENES, written

import mpsim

# ASE up to 3.29 sets the shape of an array, of which NumPy 2.5 warns.
pytestmark = [
    pytest.mark.plain,
    pytest.mark.long,
    pytest.mark.filterwarnings("ignore:Setting the shape:DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::mpsim.errors.EmitterWarning", "ignore::mpsim.FastWarning"),
]


@pytest.fixture(scope="module")
def ase():
    import ase.calculators.singlepoint  # noqa: PLC0415 - only where it is used
    import ase.constraints  # noqa: PLC0415
    import ase.io  # noqa: PLC0415
    import ase.units  # noqa: PLC0415

    return ase


@pytest.mark.parametrize("name", SCENES)
def test_ase_and_freud_read_what_mpsim_writes(name, tmp_path, ase):
    import freud  # noqa: PLC0415
    import gsd.hoomd  # noqa: PLC0415

    settings = {"method": "grid" if name == "everything" else "naive", "dt": DT}
    for ending in ("xyz", "gsd"):
        written(tmp_path / f"a.{ending}", SCENES[name](), 80, 20, **settings)
    pages = list(mpsim.Trajectory(tmp_path / "a.xyz"))
    for atoms, page in zip(ase.io.read(tmp_path / "a.xyz", index=":"), pages, strict=True):
        assert np.array_equal(atoms.positions[:, :2], page.position)
        assert np.array_equal(atoms.get_masses(), page.mass)
        assert atoms.get_velocities()[:, :2] == pytest.approx(page.velocity, rel=1e-15)
        energy = 0.5 * (page.mass[:, None] * page.velocity**2).sum()
        assert atoms.get_kinetic_energy() == pytest.approx(energy, rel=1e-14)
        for theirs, ours in {"radius": page.radius, "id": page.ids}.items():
            assert np.array_equal(atoms.arrays[theirs], ours)
        assert np.array_equal(atoms.arrays.get("map_shift", np.zeros((len(atoms), 3)))[:, :2], page.image)
        assert atoms.cell.lengths() == pytest.approx([*page.box, 1.0])
        assert atoms.info["Origin"] == pytest.approx([*page.origin, 0.0])
        assert atoms.pbc.tolist() == [*page.periodic, False]
        assert (atoms.info["Time"], atoms.info["Frame"]) == (page.time, page.frame)
    with gsd.hoomd.open(str(tmp_path / "a.gsd")) as frames:
        for theirs, page in zip(frames, pages, strict=True):
            box = freud.box.Box.from_box(theirs.configuration.box)
            assert box.is2D
            assert (box.Lx, box.Ly) == pytest.approx(page.box)
            away = box.unwrap(theirs.particles.position, theirs.particles.image)[:, :2]
            assert away + np.add(page.origin, np.divide(page.box, 2)) == pytest.approx(page.unwrapped, abs=2e-5)
            assert len(freud.locality.AABBQuery.from_system(theirs).points) == len(page.ids)
