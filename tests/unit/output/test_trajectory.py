"""Trajectories: written along a run without changing it, read back to the bit, by other programs too."""

import re
import shutil
import sys
import warnings

import ase.io
import gsd.hoomd
import numpy as np
import pytest
from support.scenes import gas, simulate, zoo
from support.trajectories import SETTINGS, content, written

import mpsim
from mpsim.output.xyz import XyzReader

ENDINGS = ["xyz", "gsd"]
MOVING = "absorbing emitters acceleration"


@pytest.fixture(params=ENDINGS)
def path(request, tmp_path):
    return tmp_path / f"run.{request.param}"


# --- written and read back


@pytest.mark.parametrize(("precision", "boundary"), [("float64", "periodic"), ("float32", "walls")])
def test_a_trajectory_is_read_back_to_the_bit(path, precision, boundary):
    scene = gas(60, 0.4, seed=3, boundary=boundary)
    with simulate(scene, method="grid", dt=0.02, precision=precision) as sim:
        states = []
        with mpsim.Trajectory.write(path, every=2) as out:
            for _ in range(5):
                states.append(sim.state)
                sim.run(frames=2, observe=out)
            states.append(sim.state)
        radii = sim.radii
    trajectory = mpsim.Trajectory(path)
    assert len(trajectory) == out.frames == 6
    assert out.seconds > 0
    for index, (frame, state) in enumerate(zip(trajectory, states, strict=True)):
        assert frame.frame == 2 * index
        assert frame.time == 2 * index * 0.02
        assert frame.position.dtype == frame.velocity.dtype == precision
        assert frame.state.digest() == state.digest()
        assert frame.radius.tolist() == radii.tolist()
        assert frame.ids.tolist() == list(range(60))
        assert frame.box == (scene.width, scene.height)
        assert frame.periodic == (boundary == "periodic",) * 2


def test_frames_that_are_written_meanwhile_are_found(path):
    scene = gas(5, 0.1)
    with simulate(scene, method="grid", dt=0.02) as sim, mpsim.Trajectory.write(path) as out:
        sim.run(frames=3, observe=out)
        trajectory = mpsim.Trajectory(path)
        part = trajectory[1:3]
        sim.run(frames=4, observe=out)
        assert len(trajectory) == 4, "not before it is asked for"
        assert part.refresh() == 2
        assert (len(trajectory), trajectory.refresh(), trajectory.refresh()) == (4, 8, 8)
        assert trajectory[-1].state.digest() == sim.digest()
    assert [frame.frame for frame in trajectory] == list(range(8))
    assert [frame.frame for frame in part] == [1, 2]
    trajectory.close()


def test_half_a_frame_is_left_for_later(tmp_path):
    written(tmp_path / "whole.xyz", gas(5, 0.1), frames=4, every=1)
    text, growing = (tmp_path / "whole.xyz").read_bytes(), tmp_path / "growing.xyz"
    growing.write_bytes(text[: len(text) // 2])
    with pytest.warns(mpsim.errors.TrajectoryWarning):
        trajectory = mpsim.Trajectory(growing)
    before = len(trajectory)
    growing.write_bytes(text[:-1])
    assert before < trajectory.refresh() == 4
    growing.write_bytes(text)
    assert trajectory.refresh() == 5


def test_a_file_in_the_place_of_another_is_read_anew(path):
    written(path, gas(5, 0.1), frames=4, every=1)
    trajectory = mpsim.Trajectory(path)
    path.unlink()
    written(path, gas(7, 0.1), frames=10, every=1)
    assert trajectory.refresh() == 11
    assert [len(frame.position) for frame in trajectory] == [7] * 11
    path.unlink()
    with pytest.raises(mpsim.errors.TrajectoryError, match="run"):
        trajectory.refresh()


def test_a_trajectory_is_a_sequence(path):
    written(path, gas(5, 0.1), frames=10, every=1)
    trajectory = mpsim.Trajectory(path)
    assert len(trajectory) == 11
    assert (trajectory[-1].frame, trajectory[3].frame) == (10, 3)
    part = trajectory[2:9:3]
    assert [frame.frame for frame in part] == [2, 5, 8]
    assert (len(part), part[-1].frame, len(part[1:])) == (3, 8, 2)
    assert repr(trajectory) == f"<Trajectory: 11 frames in '{path}'>"
    assert repr(trajectory[2]) == f"<Frame 2: 5 discs in {gas(5, 0.1).width:g} x {gas(5, 0.1).height:g}, time 0.04>"
    with pytest.raises(IndexError, match=re.escape("the trajectory has 11 frames; got index 11.")):
        trajectory[11]
    with pytest.raises(TypeError, match="an index of a trajectory must be a whole number or a slice; got 'a'"):
        trajectory["a"]


def test_discs_that_enter_and_leave_change_the_count_and_keep_their_numbers(path):
    scene = zoo(MOVING, count=5)
    with simulate(scene, method="grid") as sim, warnings.catch_warnings():
        warnings.simplefilter("ignore", mpsim.errors.EmitterWarning)
        with mpsim.Trajectory.write(path, every=20) as out:
            sim.run(frames=400, observe=out)
        here = np.flatnonzero(~sim.absorbed)
        state = sim.state
    trajectory = mpsim.Trajectory(path)
    counts = [len(frame.ids) for frame in trajectory]
    assert len(set(counts)) > 2, "the scene was chosen to have changing numbers"
    last = trajectory[-1]
    assert last.ids.tolist() == here.tolist() != list(range(len(here)))
    assert np.array_equal(last.position, state.position[here])
    assert np.array_equal(last.velocity, state.velocity[here])


def test_frames_without_discs_are_frames(path):
    scene = mpsim.Scene(width=9, height=4, position=np.zeros((0, 2)), velocity=np.zeros((0, 2)), radius=0.5)
    written(path, scene, frames=4, every=2, method="naive")
    assert [(frame.frame, frame.position.shape) for frame in mpsim.Trajectory(path)] == [
        (0, (0, 2)), (2, (0, 2)), (4, (0, 2)),
    ]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("method", "workers"), [("naive", 1), ("grid", 1), ("parallel", 2), ("event", 1)])
def test_writing_does_not_change_the_bits(method, workers, tmp_path):
    scene = gas(300, 0.4, seed=1)
    with simulate(scene, dt=0.02, method=method, workers=workers) as sim:
        sim.run(frames=40)
        alone = sim.digest()
    assert written(tmp_path / "a.xyz", scene, 40, 3, method=method, workers=workers) == alone
    assert written(tmp_path / "a.gsd", scene, 40, 7, method=method, workers=workers) == alone
    assert written(tmp_path / "b.xyz", scene, 39, 3, method=method, workers=workers) != alone  # a digest can differ


def test_a_run_in_parts_writes_the_file_of_one_run(tmp_path):
    scene = gas(30, 0.3)
    written(tmp_path / "one.xyz", scene, 24, 4)
    with simulate(scene, **SETTINGS) as sim, mpsim.Trajectory.write(tmp_path / "parts.xyz", every=4) as out:
        for frames in (4, 3, 5, 0, 12):
            sim.run(frames=frames, observe=out)
    assert (tmp_path / "parts.xyz").read_bytes() == (tmp_path / "one.xyz").read_bytes()


@pytest.mark.parametrize("method", ["grid", "event"])
def test_a_resumed_run_goes_on_with_the_trajectory_of_one_that_never_stopped(path, tmp_path, method):
    """It was killed at frame 17, after a checkpoint at frame 10: what was written since comes again."""
    scene = gas(30, 0.3)
    whole = path.with_stem("whole")
    written(whole, scene, 24, 4, method=method)
    with simulate(scene, dt=0.02, method=method) as sim, mpsim.Trajectory.write(path, every=4) as out:
        sim.run(frames=10, observe=out)
        sim.save(tmp_path / "checkpoint")
        sim.run(frames=7, observe=out)
    assert content(path)[-1][0] == 16
    again = mpsim.Simulation.resume(tmp_path / "checkpoint")
    with again, mpsim.Trajectory.write(path, every=4, mode="a") as out:
        again.run(frames=14, observe=out)
    assert content(path) == content(whole)
    if path.suffix == ".xyz":
        assert path.read_bytes() == whole.read_bytes()


def test_the_time_of_writing_is_in_the_report_and_in_no_frame(tmp_path):
    class Slow:
        every = 5

        def look(self, sim, collisions):
            looks.append((sim.frame, collisions))

    looks: list = []
    with simulate(gas(60, 0.4), method="grid") as sim, mpsim.Trajectory.write(tmp_path / "a.xyz") as out:
        report = sim.run(frames=20, observe=[out, Slow()])
        assert sim.run(frames=1).observing_seconds < out.seconds <= report.observing_seconds
    assert [frame for frame, _ in looks] == [0, 5, 10, 15, 20]
    assert looks[-1][1] == report.collisions
    assert [count for _, count in looks] == sorted(count for _, count in looks)


# --- read by others


@pytest.mark.parametrize("boundary", ["walls", "periodic"])
def test_ase_reads_extended_xyz(tmp_path, boundary):
    scene = gas(20, 0.3, seed=1, boundary=boundary)
    written(tmp_path / "a.xyz", scene, 6, 3)
    theirs, ours = ase.io.read(tmp_path / "a.xyz", index=":"), mpsim.Trajectory(tmp_path / "a.xyz")
    assert len(theirs) == 3
    for atoms, frame in zip(theirs, ours, strict=True):
        assert np.array_equal(atoms.positions[:, :2], frame.position)
        assert np.array_equal(atoms.arrays["velo"][:, :2], frame.velocity)
        assert np.array_equal(atoms.arrays["radius"], frame.radius)
        assert np.array_equal(atoms.arrays["id"], frame.ids)
        assert atoms.cell.lengths().tolist() == [scene.width, scene.height, 1.0]
        assert atoms.pbc.tolist() == [boundary == "periodic"] * 2 + [False]
        assert (atoms.info["Time"], atoms.info["Frame"]) == (frame.time, frame.frame)


def test_the_gsd_library_reads_gsd(tmp_path):
    scene = gas(20, 0.3, seed=1)
    written(tmp_path / "a.gsd", scene, 6, 3)
    ours = mpsim.Trajectory(tmp_path / "a.gsd")
    with gsd.hoomd.open(str(tmp_path / "a.gsd")) as theirs:
        assert [snapshot.configuration.step for snapshot in theirs] == [0, 3, 6]
        for snapshot, frame in zip(theirs, ours, strict=True):
            centre = np.array(frame.box) / 2
            assert snapshot.configuration.box[:3] == pytest.approx([*frame.box, 0])
            assert snapshot.configuration.dimensions == 2
            assert snapshot.particles.position[:, :2] == pytest.approx(frame.position - centre, abs=1e-5)
            assert (abs(snapshot.particles.position[:, :2]) <= centre).all(), "HOOMD's boxes are centred"
            assert snapshot.particles.velocity[:, :2] == pytest.approx(frame.velocity, rel=1e-6)
            assert (snapshot.particles.diameter == 2 * frame.radius).all()
            assert np.array_equal(snapshot.log["particles/mpsim/position"], frame.position)


# ASE up to 3.29 sets the shape of an array, of which NumPy 2.5 warns.
@pytest.mark.filterwarnings("ignore:Setting the shape on a NumPy array:DeprecationWarning:ase")
def test_trajectories_of_ase_are_read_as_far_as_they_go(tmp_path):
    atoms = ase.Atoms("H2", positions=[[1, 2, 0], [3, 4, 0]], cell=[8, 9, 5], pbc=[True, False, False])
    ase.io.write(tmp_path / "other.xyz", [atoms, atoms], format="extxyz")
    frame = mpsim.Trajectory(tmp_path / "other.xyz")[1]
    assert frame.position.tolist() == [[1, 2], [3, 4]]
    assert (frame.box, frame.periodic, frame.frame, frame.ids.tolist()) == ((8, 9), (True, False), 1, [0, 1])
    with pytest.raises(
        mpsim.errors.TrajectoryError,
        match=r"velocity must be in a trajectory to be read from it; .* holds only position. Have the program that "
        "wrote it write the column velo:R:3",
    ):
        frame.velocity  # noqa: B018
    with pytest.raises(mpsim.errors.TrajectoryError, match=r"time must be in .* write the key Time"):
        frame.time  # noqa: B018


def test_gsd_of_another_program_is_read_as_far_as_it_goes(tmp_path):
    with gsd.hoomd.open(str(tmp_path / "other.gsd"), "w") as file:
        made = gsd.hoomd.Frame()
        made.configuration.box, made.configuration.step = [8, 6, 0, 0, 0, 0], 70
        made.particles.N, made.particles.position = 1, [[-1, 2, 0]]
        made.particles.diameter = [3.0]
        file.append(made)
    frame = mpsim.Trajectory(tmp_path / "other.gsd")[0]
    assert (frame.position.tolist(), frame.radius.tolist(), frame.frame) == ([[3, 5]], [1.5], 70)
    with pytest.raises(mpsim.errors.TrajectoryError, match=r"time must be in a trajectory"):
        frame.time  # noqa: B018


# --- what is refused


@pytest.mark.parametrize(
    ("text", "error"),
    [
        (
            "hello\nworld\n",
            r"frame 0 of .*a.xyz', line 1, must give the number of discs where a frame begins; got b'hello\\n'",
        ),
        ("1\nplain xyz\nX 1 2 3\n", "line 2, must hold the box, the key Lattice of extended XYZ; it is 'plain xyz'"),
        ('1\nLattice="5 1 0 0 5 0 0 0 1"\nX 1 2 3\n', "must have an upright rectangular box"),
        ('1\nLattice="5 0 0 0 x 0 0 0 1"\nX 1 2 3\n', "must hold finite numbers under Lattice; got 'x'"),
        ('1\nLattice="5 0 0 0 5 0 0 0 1"\nX 1 2\n', r"must have 4 columns, as its Properties say; got a line with 3"),
        ('1\nLattice="5 0 0 0 5 0 0 0 1"\nX 1 2 z\n', "must hold numbers in its column pos"),
        ('1\nLattice="5 0 0 0 5 0 0 0 1" Properties=species:S:1\nX\n', "must have the column pos:R:3, the places"),
        ('1\nLattice="5 0 0 0 5 0 0 0 1" Properties=pos:R\nX\n', "must name its columns as name:type:width"),
        (
            '1\nLattice="5 0 0 0 5 0 0 0 1" Properties=pos:R:1\n1\n',
            "must have a column pos of 2 numbers or more; got 1",
        ),
    ],
)
def test_a_file_of_another_kind_is_refused_by_what_it_lacks(tmp_path, text, error):
    (tmp_path / "a.xyz").write_text(text)
    with pytest.raises(mpsim.errors.TrajectoryError, match=error):
        mpsim.Trajectory(tmp_path / "a.xyz")[0]


def test_the_smallest_extended_xyz_is_read(tmp_path):
    """Negative control of the test above."""
    for end in ("\n", "\n\n", "\n \n"):
        (tmp_path / "a.xyz").write_text('1\nLattice="5 0 0 0 5 0 0 0 1"\nX 1 2 3' + end)
        (frame,) = mpsim.Trajectory(tmp_path / "a.xyz")
        assert frame.position.tolist() == [[1, 2]]


def test_other_frames_can_be_read_where_one_is_damaged(tmp_path):
    """So each frame is read where it lies, and not the file as a whole."""
    written(tmp_path / "a.xyz", gas(5, 0.1), 4, 1)
    lines = (tmp_path / "a.xyz").read_text().splitlines(keepends=True)
    lines[2 * 7 + 3] = " ".join(["X damaged", *lines[2 * 7 + 3].split()[2:]]) + "\n"
    (tmp_path / "a.xyz").write_text("".join(lines))
    trajectory = mpsim.Trajectory(tmp_path / "a.xyz")
    assert [trajectory[index].frame for index in (0, 1, 3, 4)] == [0, 1, 3, 4]
    with pytest.raises(mpsim.errors.TrajectoryError, match=r"frame 2 of .* must hold numbers in its column pos"):
        trajectory[2]


def test_a_damaged_gsd_is_refused(tmp_path):
    (tmp_path / "a.gsd").write_bytes(b"no gsd at all" * 100)
    with pytest.raises(mpsim.errors.TrajectoryError, match=r"must be a whole GSD file; .* cannot be read"):
        mpsim.Trajectory(tmp_path / "a.gsd")


def test_a_file_that_is_there_is_not_overwritten_unasked(path):
    written(path, gas(5, 0.1))
    before = path.read_bytes()
    with pytest.raises(
        mpsim.errors.OutputError,
        match=r"exists already, and is not overwritten. .* mode='w' to replace it, mode='a' to continue",
    ):
        mpsim.Trajectory.write(path)
    assert path.read_bytes() == before
    written(path, gas(6, 0.1), mode="w")
    assert len(mpsim.Trajectory(path)[0].ids) == 6


def test_a_trajectory_is_continued_only_by_its_own_run(path):
    written(path, gas(5, 0.1), 10, 2)
    before = path.read_bytes()
    with pytest.raises(mpsim.errors.OutputError, match=r"only by the run that wrote it; at frame 0 its box is"):
        written(path, gas(6, 0.1), 10, 2, mode="a")
    first = gas(5, 0.1)
    other = mpsim.Scene(
        width=first.width, height=first.height, position=first.position[::-1], velocity=first.velocity, radius=0.5
    )
    with pytest.raises(mpsim.errors.OutputError, match=r"wrote it; at frame 0 its position of the discs differs"):
        written(path, other, 10, 2, mode="a")
    assert path.read_bytes() == before
    written(path, gas(5, 0.1), 12, 2, mode="a")  # the same run is welcome
    assert [row[0] for row in content(path)] == [0, 2, 4, 6, 8, 10, 12]


def test_missing_frames_are_told(path):
    scene = gas(5, 0.1)
    written(path, scene, 4, 2)
    with simulate(scene, **SETTINGS) as sim:
        sim.run(frames=10)
        out = mpsim.Trajectory.write(path, every=2, mode="a")
        missing = r"continues at frame 10, and its last frame was 4: those"
        with out, pytest.warns(mpsim.errors.TrajectoryWarning, match=missing) as given:
            sim.run(frames=2, observe=out)
        assert [each.filename for each in given] == [__file__]
    assert [row[0] for row in content(path)] == [0, 2, 4, 10, 12]


def test_places_that_cannot_be_written_are_told_before_the_run(tmp_path):
    (tmp_path / "file").touch()
    for place in (tmp_path / "none" / "a.xyz", tmp_path / "file" / "a.xyz", tmp_path / "none" / "a.gsd"):
        with pytest.raises(
            mpsim.errors.OutputError, match=r"must be in a folder that can be written to.* Choose another"
        ):
            mpsim.Trajectory.write(place)


@pytest.mark.parametrize(
    ("make", "error"),
    [
        (
            lambda: mpsim.Trajectory("a.h5"),
            "path must end in .xyz, .extxyz, .gsd, .lammpstrj, .dump, .xyz.gz, .extxyz.gz, .lam",
        ),
        (lambda: mpsim.Trajectory.write("a.dump"), "path must end in .xyz, .extxyz, .gsd; got 'a.dump'"),
        (lambda: mpsim.Trajectory.write(7), "path must end in .xyz, .extxyz, .gsd; got 7"),
        (lambda: mpsim.Trajectory.write("a.xyz", 0), "every must be a whole number from 1 to"),
        (lambda: mpsim.Trajectory.write("a.xyz", mode="r"), "mode must be one of 'x', 'w', 'a'; got 'r'"),
    ],
)
def test_wrong_arguments_are_refused(make, error):
    with pytest.raises(mpsim.InputError, match=re.escape(error)):
        make()


def test_the_folder_of_a_run_is_told_from_its_trajectory(tmp_path):
    (tmp_path / "trajectory.xyz").touch()
    with pytest.raises(mpsim.InputError, match=r"It is a folder; use '.*/trajectory\.xyz'\."):
        mpsim.Trajectory(tmp_path)
    with pytest.raises(mpsim.InputError, match=r"Use 'run\.xyz'\."):
        mpsim.Trajectory("x" * 5000)


def test_a_missing_file_is_told(tmp_path):
    with pytest.raises(
        mpsim.errors.TrajectoryError, match=r"must be a file that can be read; .*none\.xyz' does not exist"
    ):
        mpsim.Trajectory(tmp_path / "none.xyz")


def test_without_the_gsd_library_the_error_says_what_to_do(tmp_path, monkeypatch):
    written(tmp_path / "a.gsd", gas(5, 0.1))
    for module in [name for name in sys.modules if name.partition(".")[0] == "gsd"]:
        monkeypatch.setitem(sys.modules, module, None)
    for use in (lambda: mpsim.Trajectory(tmp_path / "a.gsd"), lambda: mpsim.Trajectory.write(tmp_path / "b.gsd")):
        with pytest.raises(
            mpsim.errors.OutputError, match=r"needs the package gsd, .* `pip install 'mpsim\[gsd\]'`, or let"
        ):
            use()
    assert not (tmp_path / "b.gsd").exists()


@pytest.mark.parametrize("observer", [7, [None], "a.xyz", [print]])
def test_what_is_no_observer_is_refused(observer):
    with simulate(gas(5, 0.1), method="naive") as sim:
        with pytest.raises(mpsim.InputError, match="observe must be one observer or several: objects with"):
            sim.run(frames=1, observe=observer)
        assert sim.run(frames=1).frames == 1


def test_a_disk_that_is_full_is_an_error_and_the_run_goes_on_without(tmp_path, monkeypatch):
    with simulate(gas(5, 0.1), method="naive") as sim, mpsim.Trajectory.write(tmp_path / "a.xyz") as out:
        sim.run(frames=2, observe=out)
        full = OSError(28, "No space left on device")
        monkeypatch.setattr(out._file._writer, "write", lambda frame: (_ for _ in ()).throw(full))
        with pytest.raises(
            mpsim.errors.OutputError, match=r"with room on its disk; got No space left on device. What was"
        ):
            sim.run(frames=2, observe=out)
        monkeypatch.undo()
        sim.run(frames=2, observe=out)
    assert [row[0] for row in content(tmp_path / "a.xyz")] == [0, 1, 2, 3, 4, 5]


def test_a_file_is_streamed_when_it_is_opened(tmp_path):
    """The index of a file of 40,000 lines must not hold it: what stays is a number per frame."""
    written(tmp_path / "a.xyz", gas(200, 0.1), 200, 1)
    reader = XyzReader(tmp_path / "a.xyz")
    assert len(reader) == 201
    assert sum(map(sys.getsizeof, vars(reader).values())) < 0.01 * (tmp_path / "a.xyz").stat().st_size


def test_a_copy_can_be_read_elsewhere(path, tmp_path):
    written(path, gas(5, 0.1))
    copy = shutil.copy(path, tmp_path / f"copy{path.suffix}")
    assert content(copy) == content(path)
