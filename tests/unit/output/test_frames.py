"""What files hold, quantity by quantity: read back by mpsim, gsd, freud and ASE, and compared with the simulation."""

import dataclasses
import warnings
from types import SimpleNamespace

import ase.io
import freud
import gsd.hoomd
import numpy as np
import pytest
from support.scenes import gas, simulate
from support.trajectories import DT, ENDINGS, SCENES, gas_of_several, written

import mpsim
from mpsim.output.frames import differs, frame_of
from mpsim.output.gsd import GsdWriter
from mpsim.output.xyz import XyzWriter


class Album:
    """An observer that keeps all that a simulation says of itself, of the discs that are there."""

    def __init__(self, every):
        self.every = every
        self.pages = {}

    def look(self, sim, collisions):
        if sim.frame in self.pages:  # at the end of one run and the start of the next, perhaps with discs added
            return
        here, state = sim.state.present, sim.state
        self.pages[sim.frame] = SimpleNamespace(
            frame=sim.frame,
            time=sim.time,
            position=state.position[here],
            velocity=state.velocity[here],
            radius=sim.radii[here],
            mass=sim.masses[here],
            ids=np.flatnonzero(here),
            origin=state.box[::2],
            box=(state.box[1] - state.box[0], state.box[3] - state.box[2]),
            image=np.zeros((here.sum(), 2), np.int64) if state.image is None else state.image[here],
            unwrapped=state.unwrapped[here],
            walls=walls(sim.scene, sim.frame),
            periodic=sim.scene.periodic,
        )


def walls(scene, frame):
    """Coordinates of the left, right, lower and upper wall."""
    found = [0.0, scene.width, 0.0, scene.height]
    if scene.piston is not None:
        edge = ("left", "right", "bottom", "top").index(scene.piston.wall)
        bound = np.minimum if scene.piston.speed > 0 else np.maximum
        found[edge] = bound(found[edge] + scene.piston.speed * DT * frame, scene.piston.stop)
    return found


@pytest.fixture(scope="module", params=SCENES)
def run(request, tmp_path_factory):
    """Files of one run in both formats, and what the simulation said of itself at their frames."""
    folder, album, scene = tmp_path_factory.mktemp("run"), Album(7), SCENES[request.param]()
    method = "grid" if request.param == "everything" else "naive"
    with warnings.catch_warnings(), simulate(scene, method=method, dt=DT) as sim:
        warnings.simplefilter("ignore", mpsim.errors.EmitterWarning)
        warnings.simplefilter("ignore", mpsim.FastWarning)
        with (
            mpsim.Trajectory.write(folder / "run.xyz", 7) as text,
            mpsim.Trajectory.write(folder / "run.gsd", 7) as binary,
        ):
            sim.run(frames=35, observe=[text, binary, album])
            if request.param == "grown":
                sim.add([[2, 1], [2, 5]], [[0, 1], [1, 0]], radius=[0.45, 0.11], mass=[2.2, 0.9])
            sim.run(frames=49, observe=[text, binary, album])
    return SimpleNamespace(folder=folder, pages=list(album.pages.values()), name=request.param)


@pytest.mark.slow
def test_the_scenes_are_what_they_are_for(run):
    """Negative control: default masses, one radius, a box at rest or a constant number of discs would show nothing."""
    assert len(run.pages) == 13
    for page in run.pages:
        assert len(set(page.mass)) > 1 or run.name == "grown"
        assert not (page.mass == 1).all()
        assert page.box == pytest.approx(np.diff(page.walls)[::2])
        assert page.origin == pytest.approx(page.walls[::2])
        assert (run.name == "periodic" and page.frame > 50) <= page.image.any()
    assert (len({page.box for page in run.pages}) > 3) == ("piston" in run.name or run.name == "everything")
    assert (len({len(page.ids) for page in run.pages}) > 2) == (run.name in ("grown", "everything"))


@pytest.mark.slow
@pytest.mark.parametrize("ending", ENDINGS)
def test_mpsim_reads_every_quantity_to_the_bit(run, ending):
    with mpsim.Trajectory(run.folder / f"run.{ending}") as trajectory:
        assert len(trajectory) == len(run.pages)
        for frame, page in zip(trajectory, run.pages, strict=True):
            for name in ("position", "velocity", "radius", "mass", "ids", "image", "unwrapped"):
                ours, theirs = getattr(frame, name), getattr(page, name)
                assert ours.dtype == theirs.dtype
                assert np.array_equal(ours, theirs), name
            assert (frame.frame, frame.time, frame.periodic) == (page.frame, page.time, page.periodic)
            assert (frame.box, frame.origin) == (page.box, page.origin)
            assert np.array_equal(frame.state.unwrapped, page.unwrapped)


def test_ase_reads_every_quantity(run):
    frames = ase.io.read(run.folder / "run.xyz", index=":")
    for atoms, page in zip(frames, run.pages, strict=True):
        assert len(atoms) == len(page.ids)
        assert np.array_equal(atoms.positions[:, :2], page.position)
        assert np.array_equal(atoms.get_masses(), page.mass)
        assert atoms.get_velocities()[:, :2] == pytest.approx(page.velocity, rel=1e-15)
        energy = 0.5 * (page.mass[:, None] * page.velocity**2).sum()
        assert atoms.get_kinetic_energy() == pytest.approx(energy, rel=1e-14)
        assert np.array_equal(atoms.arrays["radius"], page.radius)
        assert np.array_equal(atoms.arrays["id"], page.ids)
        assert np.array_equal(atoms.arrays.get("map_shift", np.zeros((len(atoms), 3)))[:, :2], page.image)
        assert atoms.cell.lengths() == pytest.approx([*page.box, 1.0])
        assert atoms.info["Origin"] == pytest.approx([*page.origin, 0.0])
        assert atoms.pbc.tolist() == [*page.periodic, False]
        assert (atoms.info["Time"], atoms.info["Frame"]) == (page.time, page.frame)


def test_the_gsd_library_reads_every_quantity(run):
    with gsd.hoomd.open(str(run.folder / "run.gsd")) as frames:
        for theirs, page in zip(frames, run.pages, strict=True):
            discs, centre = theirs.particles, np.array(page.origin) + np.array(page.box) / 2
            assert (theirs.configuration.step, theirs.configuration.dimensions) == (page.frame, 2)
            assert theirs.configuration.box == pytest.approx([*page.box, 0, 0, 0, 0], rel=1e-6)
            assert len(page.ids) == discs.N
            assert discs.position == pytest.approx(np.pad(page.position - centre, ((0, 0), (0, 1))), abs=2e-6)
            assert discs.velocity == pytest.approx(np.pad(page.velocity, ((0, 0), (0, 1))), rel=1e-6)
            assert discs.mass == pytest.approx(page.mass, rel=1e-6)
            assert np.array_equal(discs.image[:, :2], page.image)
            assert discs.diameter == pytest.approx(2 * page.radius, rel=1e-6)
            log = {name.removeprefix("particles/mpsim/"): array for name, array in theirs.log.items()}
            for name in ("position", "velocity", "radius", "mass"):
                assert np.array_equal(log[name], getattr(page, name)), name
            assert np.array_equal(log["id"], page.ids)
            assert log["mpsim/time"] == [page.time]
            assert log["mpsim/box"] == pytest.approx(page.box)
            assert log["mpsim/origin"] == pytest.approx(page.origin)
            assert log["mpsim/periodic"].tolist() == list(page.periodic)


def test_freud_finds_the_discs_in_a_box_of_two_dimensions(run):
    with gsd.hoomd.open(str(run.folder / "run.gsd")) as frames:
        for theirs, page in zip(frames, run.pages, strict=True):
            box = freud.box.Box.from_box(theirs.configuration.box)
            assert box.is2D
            assert (box.Lx, box.Ly) == pytest.approx(page.box)
            # Of walled boxes freud thinks as of periodic ones; no disc is beyond their walls, so none is wrapped.
            inside = ((page.position >= page.origin) & (page.position <= np.add(page.origin, page.box))).all(axis=1)
            assert box.wrap(theirs.particles.position)[inside] == pytest.approx(
                theirs.particles.position[inside], abs=2e-6
            )
            away = box.unwrap(theirs.particles.position, theirs.particles.image)[:, :2]
            assert away + np.add(page.origin, np.divide(page.box, 2)) == pytest.approx(page.unwrapped, abs=2e-5)
            system = freud.locality.AABBQuery.from_system(theirs)
            assert len(system.points) == len(page.ids)


@pytest.mark.filterwarnings("ignore:Setting the shape:DeprecationWarning")  # ASE does, and NumPy 2.5 warns
def test_frames_without_discs_between_others_hold_none(tmp_path):
    """The only disc enters after the first frame and leaves before the last: readers fall back to the first frame."""
    emitter = mpsim.Emitter((1.0, 2.0), (5.0, 0.0), every=1, limit=1)
    none = np.zeros((0, 2))
    scene = mpsim.Scene(
        width=4, height=4, position=none, velocity=none, radius=0.5, absorbing=["right"], emitters=[emitter]
    )
    counts = [0, 1, 1, 0, 0]
    for ending in ENDINGS:
        written(tmp_path / f"a.{ending}", scene, frames=48, every=12)
        assert [len(frame.mass) for frame in mpsim.Trajectory(tmp_path / f"a.{ending}")] == counts
    with gsd.hoomd.open(str(tmp_path / "a.gsd")) as frames:
        for frame, count in zip(frames, counts, strict=True):
            assert frame.particles.position.shape == (count, 3)
            assert frame.log["particles/mpsim/position"].shape == (count, 2)
            assert frame.log["particles/mpsim/id"].shape == (count,)
    assert [len(atoms) for atoms in ase.io.read(tmp_path / "a.xyz", index=":")] == counts


# --- images


def crossed(sim):
    """The frame of a simulation with some borders crossed."""
    now = frame_of(sim)
    image = np.arange(2 * len(now.position)).reshape(-1, 2) % 7 - 3
    return dataclasses.replace(now, known={**now.known, "image": image})


@pytest.mark.parametrize(("ending", "kind"), [("xyz", XyzWriter), ("gsd", GsdWriter)])
def test_images_are_read_back_and_unwrap_the_positions(tmp_path, ending, kind):
    path = tmp_path / f"a.{ending}"
    with simulate(gas_of_several("periodic"), method="naive") as sim:
        frame = crossed(sim)
    writer = kind(path, "x")
    writer.write(frame)
    writer.close()
    (found,) = mpsim.Trajectory(path)
    assert differs(found, frame) is None
    assert found.image.dtype == np.int64
    assert found.unwrapped.tolist() == (frame.position + frame.image * [13.0, 9.5]).tolist()
    changed = {**found.known, "image": found.image + np.eye(len(found.image), 2, dtype=np.int64)}
    assert differs(dataclasses.replace(found, known=changed), frame) == "its image of the discs differs"
    if ending == "gsd":
        with gsd.hoomd.open(str(path)) as file:
            theirs = file[0]
            box = freud.box.Box.from_box(theirs.configuration.box)
            away = box.unwrap(theirs.particles.position, theirs.particles.image)[:, :2] + np.array(frame.box) / 2
        assert away == pytest.approx(frame.unwrapped, abs=1e-5)
        assert away != pytest.approx(frame.position, abs=1)
    else:
        atoms = ase.io.read(path)
        assert np.array_equal(atoms.arrays["map_shift"], np.pad(frame.image, ((0, 0), (0, 1))))


def test_behind_walls_no_image_is_needed(tmp_path):
    written(tmp_path / "a.xyz", gas(4, 0.1))
    frame = mpsim.Trajectory(tmp_path / "a.xyz")[-1]
    assert "map_shift" not in (tmp_path / "a.xyz").read_text()
    assert (frame.image.tolist(), frame.unwrapped.tolist()) == ([[0, 0]] * 4, frame.position.tolist())


def test_an_origin_that_is_none_is_refused(tmp_path):
    for corner, error in (("1", "must have the corner of its box under Origin"), ("1 x 0", "numbers under Origin")):
        (tmp_path / "a.xyz").write_text(f'1\nLattice="5 0 0 0 5 0 0 0 1" Origin="{corner}"\nX 1 2 3\n')
        with pytest.raises(mpsim.errors.TrajectoryError, match=error):
            mpsim.Trajectory(tmp_path / "a.xyz")[0]


# --- freud measures what mpsim measures


def test_freud_finds_the_pair_correlation_that_mpsim_finds(tmp_path):
    scene, states = gas(1000, 0.3, seed=2, boundary="periodic"), []
    keep = SimpleNamespace(every=50, look=lambda sim, collisions: states.append(sim.state))
    with simulate(scene, method="grid", dt=DT) as sim, mpsim.Trajectory.write(tmp_path / "a.gsd", 50) as out:
        sim.run(frames=400, observe=[out, keep])
    ours = mpsim.measure.pair_correlation(states, scene, bins=30, r_max=4.0)
    theirs, wrong = (freud.density.RDF(bins=30, r_max=4.0, r_min=1.0) for _ in range(2))
    with gsd.hoomd.open(str(tmp_path / "a.gsd")) as frames:
        for frame in frames:
            theirs.compute(frame, reset=False)
            wider = [*(1.02 * frame.configuration.box[:2]), 0, 0, 0, 0]
            wrong.compute((wider, frame.particles.position), reset=False)
    error = np.maximum(ours.error, 0.002)  # single precision moves some pairs from one shell to the next
    assert np.abs(theirs.rdf - ours.value).max() < 0.01
    assert (np.abs(theirs.rdf - ours.value) < error).all()
    assert (np.abs(wrong.rdf - ours.value) > error).any(), "a box that is 2 % too wide must be seen"
