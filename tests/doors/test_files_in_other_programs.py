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
]

NOTES = ['a "quoted" word', "it's one", "Lattice=9 9", "pbc='F F F'", "a=b {c} [d]", "back\\slash", "Time=7", "{}", "T"]


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


def some_atoms(rng, ase):
    """Atoms in a plane, with columns and keys of all kinds."""
    count = int(rng.integers(1, 7))
    place = np.column_stack([rng.normal(size=(count, 2)) * 10.0 ** rng.integers(-2, 3), np.full(count, rng.normal())])
    atoms = ase.Atoms(f"Ar{count}", place, cell=[*rng.uniform(1, 99, 2), rng.choice([1, 20])])
    atoms.pbc = [(1, 1, 0), (0, 0, 0), (1, 0, 0)][rng.integers(3)]
    if rng.random() < 0.7:
        atoms.set_masses(rng.uniform(0.5, 9, count))
        if rng.random() < 0.7:
            atoms.set_velocities(np.column_stack([rng.normal(size=(count, 2)), np.zeros(count)]))
    if rng.random() < 0.5:
        atoms.arrays["radius"] = rng.uniform(0.1, 1, count)
    if rng.random() < 0.5:
        atoms.arrays["id"] = 1 + np.arange(count)
    if rng.random() < 0.3:
        atoms.arrays["velo"] = np.column_stack([rng.normal(size=(count, 2)), np.zeros(count)])
    for name, values in (("note", rng.choice(["a", "b"], count)), ("heavy", rng.random(count) < 0.5)):
        if rng.random() < 0.3:
            atoms.arrays[name] = values
    for key in rng.choice(["note", "run_id", "stress_free", "Time", "energy_a"], 2, replace=False):
        atoms.info[str(key)] = float(rng.normal()) if key == "Time" else str(rng.choice(NOTES))
    if rng.random() < 0.3:
        atoms.set_constraint(ase.constraints.FixAtoms([0]))
    if rng.random() < 0.3:
        forces = rng.normal(size=(count, 3))
        atoms.calc = ase.calculators.singlepoint.SinglePointCalculator(atoms, energy=1.5, forces=forces)
    return atoms


def test_extended_xyz_that_ase_reads_is_the_same_in_mpsim(tmp_path, ase):
    path = tmp_path / "a.xyz"
    for seed in range(28):
        rng = np.random.default_rng(seed)
        ase.io.write(path, [some_atoms(rng, ase) for _ in range(3)], format="extxyz")
        for frame, atoms in zip(mpsim.Trajectory(path), ase.io.read(path, index=":"), strict=True):
            assert frame.position.tolist() == atoms.positions[:, :2].tolist()
            assert frame.box == tuple(atoms.cell.lengths()[:2])
            assert frame.periodic == tuple(atoms.pbc[:2].tolist())
            assert frame.known.get("time") == (float(atoms.info["Time"]) if "Time" in atoms.info else None)
            arrays = atoms.arrays
            for name, theirs in (("mass", "masses"), ("radius", "radius"), ("ids", "id")):
                assert (name in frame.known) == (theirs in arrays)
                if theirs in arrays:
                    assert frame.known[name].tolist() == arrays[theirs].tolist()
            if "velo" in arrays:
                assert frame.velocity.tolist() == arrays["velo"][:, :2].tolist()
            elif "masses" in arrays and "momenta" in arrays:
                assert frame.velocity.tolist() == atoms.get_velocities()[:, :2].tolist()
            else:
                assert "velocity" not in frame.known
