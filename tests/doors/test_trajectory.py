"""Trajectories: written along a run without changing it, read back to the bit, continued only by their own run."""

import gc
import os
import re
import shutil
import signal
import sys
import time
import tracemalloc
from types import SimpleNamespace

import gsd.hoomd
import numpy as np
import pytest
from support.processes import refusing
from support.scenes import gas, scene_of, simulate
from support.selection import FORKS
from support.trajectories import DT, ENDINGS, PLACES, SCENES, SPEEDS, content, killed_and_resumed, pair, written

import mpsim
from mpsim.errors import OutputError, TrajectoryError, TrajectoryWarning

pytestmark = [
    pytest.mark.plain,
    pytest.mark.filterwarnings("ignore::mpsim.errors.EmitterWarning", "ignore::mpsim.FastWarning"),
]


@pytest.fixture(params=ENDINGS)
def path(request, tmp_path):
    return tmp_path / f"run.{request.param}"


class Album:
    """An observer that keeps all that a simulation says of itself and of its present discs."""

    def __init__(self, every):
        self.every, self.pages = every, {}

    def observe(self, sim, collisions):
        here, state = sim.state.present, sim.state
        self.pages.setdefault(
            sim.frame,
            SimpleNamespace(
                frame=sim.frame, time=sim.time, position=state.position[here], velocity=state.velocity[here],
                radius=sim.radii[here], mass=sim.masses[here], ids=np.flatnonzero(here), origin=state.box[::2],
                box=(state.box[1] - state.box[0], state.box[3] - state.box[2]), unwrapped=state.unwrapped[here],
                image=np.zeros((here.sum(), 2), np.int64) if state.image is None else state.image[here],
                periodic=sim.scene.periodic,
            ),
        )  # fmt: skip


def watched(folder, name):
    """Files of one run in both formats, and what the simulation said of itself at their frames."""
    album, method = Album(7), "grid" if name == "everything" else "naive"
    with (
        simulate(SCENES[name](), method=method, dt=DT) as sim,
        mpsim.Trajectory.write(folder / "a.xyz", 7) as text,
        mpsim.Trajectory.write(folder / "a.gsd", 7) as binary,
    ):
        sim.run(frames=21, observe=[text, binary, album])
        if name == "grown":
            sim.add([[2, 1], [2, 5]], [[0, 1], [1, 0]], radius=[0.45, 0.11], mass=[2.2, 0.9])
        sim.run(frames=42, observe=[text, binary, album])
    pages = list(album.pages.values())
    assert len(pages) == 10
    assert all(not (page.mass == 1).all() for page in pages), "default masses would show nothing"
    assert (len({page.box for page in pages}) > 3) == ("piston" in name or name == "everything")
    assert (len({len(page.ids) for page in pages}) > 2) == (name in ("grown", "everything"))
    assert (name == "periodic") <= pages[-1].image.any()
    return pages


def words_of(text):
    """The words of each line of the discs of a file, frame by frame."""
    lines = text.splitlines()
    while lines:
        count = int(lines[0])
        yield [line.split() for line in lines[2 : 2 + count]]
        lines = lines[2 + count :]


@pytest.mark.parametrize("name", SCENES)
def test_every_quantity_is_read_back_to_the_bit_and_is_where_the_formats_say(name, tmp_path):
    pages = watched(tmp_path, name)
    for ending in ENDINGS:
        with mpsim.Trajectory(tmp_path / f"a.{ending}") as trajectory:
            for frame, page in zip(trajectory, pages, strict=True):
                for each in ("position", "velocity", "radius", "mass", "ids", "image", "unwrapped"):
                    ours, theirs = getattr(frame, each), getattr(page, each)
                    assert (ours.dtype, ours.tolist()) == (theirs.dtype, theirs.tolist()), each
                for each in ("frame", "time", "periodic", "box", "origin"):
                    assert getattr(frame, each) == getattr(page, each), each
                assert frame.state.unwrapped.tolist() == page.unwrapped.tolist()
    for lines, page in zip(words_of((tmp_path / "a.xyz").read_text()), pages, strict=True):
        for k, words in enumerate(lines):
            (x, y), (vx, vy), mass = page.position[k], page.velocity[k], page.mass[k]
            numbers = [x, y, 0.0, page.radius[k], mass, mass, vx, vy, 0.0, mass * vx, mass * vy, 0.0]
            assert [words[0], *map(float, words[1:13]), words[13]] == ["X", *numbers, str(page.ids[k])]
    with gsd.hoomd.open(str(tmp_path / "a.gsd")) as frames:
        for theirs, page in zip(frames, pages, strict=True):
            discs, centre = theirs.particles, np.array(page.origin) + np.array(page.box) / 2
            assert (theirs.configuration.step, theirs.configuration.dimensions) == (page.frame, 2)
            assert theirs.configuration.box == pytest.approx([*page.box, 0, 0, 0, 0], rel=1e-6)
            assert discs.position == pytest.approx(np.pad(page.position - centre, ((0, 0), (0, 1))), abs=2e-6)
            assert discs.velocity == pytest.approx(np.pad(page.velocity, ((0, 0), (0, 1))), rel=1e-6)
            assert discs.mass == pytest.approx(page.mass, rel=1e-6)
            assert discs.diameter == pytest.approx(2 * page.radius, rel=1e-6)
            assert discs.image[:, :2].tolist() == page.image.tolist()
            for each, value in {"position": page.position, "velocity": page.velocity, "mass": page.mass}.items():
                assert np.array_equal(theirs.log[f"particles/mpsim/{each}"], value)
            assert theirs.log["mpsim/time"] == [page.time]


def test_numbers_of_all_sizes_are_kept(tmp_path):
    """Zeros of both signs in one column, too."""
    velocity = [[0.0, -0.0], [-0.0, -0.0], [1e-300, 2e150], [1e10, -1e10], [0.1, 1 / 3]]
    scene = scene_of([[2 + 3 * k, 2] for k in range(5)], velocity, 20, 4, mass=[1.0, 1.0, 0.3, 1e140, 1.0])
    with simulate(scene, method="naive") as sim, mpsim.Trajectory.write(tmp_path / "a.xyz") as out:
        sim.run(frames=0, observe=out)
    (lines,) = words_of((tmp_path / "a.xyz").read_text())
    assert [line[7:9] for line in lines[:2]] == [["0.0", "-0.0"], ["-0.0", "-0.0"]]
    assert [float(word) for word in lines[3][10:12]] == [1e140 * 1e10, -1e140 * 1e10]
    (frame,) = mpsim.Trajectory(tmp_path / "a.xyz")
    assert repr(frame.velocity.tolist()) == repr(velocity), "with the signs of zeros"


@pytest.mark.long
def test_frames_of_very_many_discs_are_written_in_parts(tmp_path):
    """More than 20,000 lines at a time."""
    path = tmp_path / "a.xyz"
    start = mpsim.Scene.lattice(count=20_001, packing=0.4, radius=0.5, temperature=1.0, seed=1)
    mass = np.random.default_rng(1).uniform(1, 2, 20_001)
    scene = scene_of(start.position, start.velocity, start.width, start.height, mass=mass)
    digest = written(path, scene, frames=0, every=1, method="naive")
    (frame,) = mpsim.Trajectory(path)
    assert frame.state.digest() == digest
    assert (frame.velocity.tolist(), frame.mass.tolist()) == (scene.velocity.tolist(), mass.tolist())


# --- along a run


@pytest.mark.parametrize("method", ["grid", "event"])
def test_writing_changes_no_bit_and_runs_in_parts_write_the_file_of_one(method, tmp_path):
    scene, one = gas(20, 0.4), tmp_path / "one.xyz"
    alone = written(one, scene, 24, 4, method=method)
    with simulate(scene, dt=0.02, method=method) as sim, mpsim.Trajectory.write(tmp_path / "b.xyz", every=4) as out:
        for frames in (4, 3, 5, 0, 12):
            sim.run(frames=frames, observe=out)
        assert sim.digest() == alone
    assert (tmp_path / "b.xyz").read_bytes() == one.read_bytes()
    with simulate(scene, dt=0.02, method=method) as sim:
        sim.run(frames=23)
        assert sim.digest() != alone, "the control"
        sim.run(frames=1)
        assert sim.digest() == alone


def test_the_time_of_writing_is_in_the_report_and_in_no_frame(tmp_path):
    looks = []
    slow = SimpleNamespace(every=5, observe=lambda sim, collisions: looks.append((sim.frame, collisions)))
    with simulate(gas(20, 0.4), method="grid") as sim, mpsim.Trajectory.write(tmp_path / "a.xyz") as out:
        report = sim.run(frames=20, observe=[out, slow])
        assert sim.run(frames=1).observing_seconds < out.seconds <= report.observing_seconds
    assert [frame for frame, _ in looks] == [0, 5, 10, 15, 20]
    assert looks[-1][1] == report.collisions


def test_frames_that_are_written_meanwhile_are_found(path):
    with simulate(gas(5, 0.1), method="naive", dt=0.02) as sim, mpsim.Trajectory.write(path) as out:
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
    path.unlink()
    written(path, gas(7, 0.1), frames=10, every=1, method="naive")
    assert trajectory.refresh() == 11, "a file in the place of another is read anew"
    assert [len(frame.position) for frame in trajectory] == [7] * 11
    path.unlink()
    with pytest.raises(TrajectoryError, match="run"):
        trajectory.refresh()


def test_a_trajectory_is_a_sequence(path, tmp_path):
    written(path, gas(5, 0.1), frames=10, every=1, method="naive")
    trajectory, side = mpsim.Trajectory(path), gas(5, 0.1).width
    assert (len(trajectory), trajectory[-1].frame, trajectory[3].frame) == (11, 10, 3)
    part = trajectory[2:9:3]
    assert [frame.frame for frame in part] == [2, 5, 8]
    assert (len(part), part[-1].frame, len(part[1:])) == (3, 8, 2)
    assert repr(trajectory) == f"<Trajectory: 11 frames in '{path}'>"
    assert repr(trajectory[2]) == f"<Frame 2: 5 discs in {side:g} x {side:g}, time 0.04>"
    with pytest.raises(IndexError, match=re.escape("the trajectory has 11 frames; got index 11.")):
        trajectory[11]
    with pytest.raises(TypeError, match="an index of a trajectory must be a whole number or a slice; got 'a'"):
        trajectory["a"]
    assert content(shutil.copy(path, tmp_path / f"copy{path.suffix}")) == content(path)


@pytest.mark.parametrize("ending", ENDINGS)
def test_frames_without_discs_are_frames_also_between_others(tmp_path, ending):
    """Readers of GSD fall back to the first frame for what a frame lacks."""
    emitter, none = mpsim.Emitter((1.0, 2.0), (5.0, 0.0), every=1, limit=1), np.zeros((0, 2))
    box = {"width": 4, "height": 4, "position": none, "velocity": none, "radius": 0.5}
    written(tmp_path / f"a.{ending}", mpsim.Scene(**box), frames=2, every=2, method="naive")
    assert [frame.position.shape for frame in mpsim.Trajectory(tmp_path / f"a.{ending}")] == [(0, 2)] * 2
    passing, counts = mpsim.Scene(absorbing=["right"], emitters=[emitter], **box), [0, 1, 1, 0, 0]
    written(tmp_path / f"b.{ending}", passing, frames=48, every=12, method="naive")
    assert [len(frame.mass) for frame in mpsim.Trajectory(tmp_path / f"b.{ending}")] == counts
    if ending == "gsd":
        with gsd.hoomd.open(str(tmp_path / "b.gsd")) as frames:
            for frame, count in zip(frames, counts, strict=True):
                assert frame.particles.position.shape == (count, 3)
                assert frame.log["particles/mpsim/id"].shape == (count,)


def test_other_frames_can_be_read_where_one_is_damaged_and_no_file_is_held_in_memory(tmp_path):
    written(tmp_path / "a.xyz", gas(5, 0.1), 4, 1, method="naive")
    lines = (tmp_path / "a.xyz").read_text().splitlines(keepends=True)
    lines[2 * 7 + 3] = " ".join(["X damaged", *lines[2 * 7 + 3].split()[2:]]) + "\n"
    (tmp_path / "a.xyz").write_text("".join(lines) * 400)
    tracemalloc.start()
    trajectory = mpsim.Trajectory(tmp_path / "a.xyz")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(trajectory) == 2000
    assert peak < 0.2 * (tmp_path / "a.xyz").stat().st_size
    assert [trajectory[index].frame for index in (0, 1, 3, 1999)] == [0, 1, 3, 4]
    with pytest.raises(TrajectoryError, match=r"frame 2 of .*, its line 4, must hold numbers in its column p"):
        trajectory[2]


# --- continued


THREE = {"position": [*PLACES, [5, 2]], "velocity": [*SPEEDS, [0, 0]]}

OTHERS = {
    "a box": (pair(width=11), {}, r"at frame 2 its box is \[0, 10\] x \[0, 10\] and not \[0, 11\] x \[0, 10\]"),
    "a piston": (pair(piston=mpsim.Piston("right", -1, 6)), {}, r"at frame 2 its box is .* and not \[0, 9.96\] x \["),
    "borders": (pair(boundary="periodic"), {}, r"periodic axes \(x, y\) are \(False, False\) and not \(True, True\)"),
    "dt": (pair(), {"dt": 0.2}, r"at frame 2 its time is 0.04 and not 0.4, as dt = 0.2 makes it"),
    "precision": (pair(), {"precision": "float32"}, r"at frame 2 its precision is float64 and not float32"),
    "radii": (pair(radius=0.3), {}, r"at frame 2 its radius of disc 0 is 0.5 and not 0.3"),
    "masses": (pair(mass=[1, 9.0]), {}, r"at frame 2 its mass of disc 1 is 1 and not 9"),
    "more discs": (pair(**THREE), {}, r"at frame 2 it has no disc 2, and the simulation has had it from before"),
    "fewer discs": (pair(position=[[3, 3]], velocity=[[1, 0]]), {}, r"it has a disc 1, and the simulation has only 1"),
    "places": (pair(position=[[3, 4], [7, 7]]), {}, r"its frame 0 shows another start of such a scene"),
    "velocities": (pair(velocity=[[1, 0], [0, 2]]), {}, r"its frame 0 shows another start of such a scene"),
}


@pytest.mark.parametrize("ending", ENDINGS)
def test_only_its_own_run_continues_a_file(tmp_path, ending):
    """The file ends at frame 2, and the others are at frame 3: no frame is in both."""
    path = tmp_path / f"a.{ending}"
    written(path, pair(), 2, 1, method="naive")
    before = path.read_bytes()
    for scene, settings, text in OTHERS.values():
        with simulate(scene, **{"dt": DT, "method": "naive", **settings}) as sim:
            sim.run(frames=3)
            says = rf"can be continued only by the run that wrote it; .*{text}.*mode='w"
            with mpsim.Trajectory.write(path, mode="a") as out, pytest.raises(OutputError, match=says):
                sim.run(frames=2, observe=out)
        assert path.read_bytes() == before, "nothing was written"
    other = pair(position=PLACES[::-1])
    with pytest.raises(OutputError, match="wrote it; at frame 0 its position of the discs differs"):
        written(path, other, 2, 1, mode="a", method="naive")
    with simulate(pair(), method="naive", dt=DT) as sim, mpsim.Trajectory.write(path, mode="w") as out:
        sim.run(frames=5)
        sim.run(frames=3, observe=out)
    with pytest.raises(OutputError, match="at frame 5 its mass of disc 1 is 1 and not 9"):
        written(path, pair(mass=[1, 9.0]), 2, 1, mode="a", method="naive")  # all of its frames are later
    written(path, pair(), 4, 1, mode="a", method="naive")  # its own run starts anew
    assert [row[0] for row in content(path)] == [0, 1, 2, 3, 4]


def test_missing_frames_are_told_and_a_file_is_not_overwritten_unasked(path):
    written(path, pair(), 4, 2, method="naive")
    before = path.read_bytes()
    with pytest.raises(
        OutputError, match=r"exists already, and is not overwritten. .* mode='w' to replace it, mode='a' to continue"
    ):
        mpsim.Trajectory.write(path)
    assert path.read_bytes() == before
    with simulate(pair(), method="naive", dt=DT) as sim:
        sim.run(frames=10)
        missing = r"continues at frame 10, and its last frame was 4: those"
        with (
            mpsim.Trajectory.write(path, every=2, mode="a") as out,
            pytest.warns(TrajectoryWarning, match=missing) as caught,
        ):
            sim.run(frames=2, observe=out)
        assert [each.filename for each in caught] == [__file__]
    assert [row[0] for row in content(path)] == [0, 2, 4, 10, 12]
    written(path, gas(6, 0.1), mode="w", method="naive")
    assert len(mpsim.Trajectory(path)[0].ids) == 6


OWN = {
    **{name: (SCENES[name], {"method": "naive"}) for name in ("periodic", "left piston", "grown")},
    "everything": (SCENES["everything"], {"method": "grid"}),
    "events": (lambda: gas(20, 0.3, boundary="periodic"), {"method": "event"}),
    "single precision": (
        lambda: pair(radius=[0.5, 0.25], piston=mpsim.Piston("left", 0.7, 2)),
        {"method": "naive", "precision": "float32"},
    ),
}


@pytest.mark.parametrize("name", OWN)
def test_a_killed_and_resumed_run_continues_its_file_in_every_kind_of_scene(tmp_path, name):
    """It was killed after frames that came later than its checkpoint: they come again."""
    make, settings = OWN[name]
    written(tmp_path / "whole.xyz", make(), 20, 3, **settings)
    killed_and_resumed(tmp_path / "a.xyz", make(), **settings)
    assert (tmp_path / "a.xyz").read_bytes() == (tmp_path / "whole.xyz").read_bytes()
    if name in ("grown", "left piston"):
        killed_and_resumed(tmp_path / "a.gsd", make(), **settings)
        assert content(tmp_path / "a.gsd") == content(tmp_path / "whole.xyz")


def test_after_discs_were_added_a_file_is_continued_by_its_own_run(path):
    """The last frame of the file was written before they were added; they are in the next one."""
    with simulate(gas(5, 0.1), method="naive", dt=DT) as sim:
        with mpsim.Trajectory.write(path, 5) as out:
            sim.run(frames=10, observe=out)
        sim.add([1.5, 1.5], [0, 0])
        with mpsim.Trajectory.write(path, 5, mode="a") as out:
            sim.run(frames=5, observe=out)
    assert [(frame.frame, len(frame.ids)) for frame in mpsim.Trajectory(path)] == [(0, 5), (5, 5), (10, 5), (15, 6)]


def test_a_file_of_another_program_is_not_continued(path):
    written(path, pair(), 1, 1, method="naive")
    if path.suffix == ".gsd":
        with gsd.hoomd.open(str(path), "r") as file:
            frame = file[0]
        frame.log = {}
        with gsd.hoomd.open(str(path), "w") as file:
            file.append(frame)
        text = "times, radii, masses, numbers of discs"  # diameters and masses of 1 are not written
    else:
        path.write_text(path.read_text().replace("id:I:1", "tag:I:1").replace("velo:R:3:momenta", "speed:R:3:push"))
        text = "velocities, numbers of discs"
    with simulate(pair(), method="naive", dt=DT) as sim:
        sim.run(frames=3)
        says = f"must hold {text} to be continued, so that"
        with mpsim.Trajectory.write(path, mode="a") as out, pytest.raises(OutputError, match=says):
            sim.run(frames=1, observe=out)


# --- one writer, one simulation


def refusal(path, mode="w"):
    """The error of opening a writer, or None."""
    try:
        mpsim.Trajectory.write(path, mode=mode).close()
    except OutputError as error:
        return str(error)
    return None


def in_a_fork(act):
    """Whether something holds in a fork of this process."""
    child = os.fork()
    if not child:
        os._exit(0 if act() else 1)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore:This process:DeprecationWarning")
@pytest.mark.parametrize("mode", ["w", "a"])
def test_a_file_has_one_writer_at_a_time(path, mode):
    written(path, pair(), 2, 1, method="naive")
    with simulate(pair(), method="naive", dt=DT) as sim:
        with mpsim.Trajectory.write(path, mode=mode) as out:
            sim.run(frames=1, observe=out)  # with mode "a" the file is cut, of GSD by another in its place
            for other in ("w", "a"):
                assert "is being written by another writer, of this process or another" in refusal(path, other)
                assert in_a_fork(lambda other=other: "another writer" in (refusal(path, other) or ""))
            sim.run(frames=1, observe=out)
            assert len(mpsim.Trajectory(path)) == 3, "which readers may see"
            assert in_a_fork(lambda out=out: out.close() is None)
            assert refusal(path), "a fork leaves the file to its writer"
        assert [row[0] for row in content(path)] == [0, 1, 2]
    assert refusal(path) is None
    out = mpsim.Trajectory.write(path, mode="w")
    assert refusal(path) is not None
    del out  # as a cell of a notebook leaves it
    gc.collect()
    assert refusal(path) is None


@FORKS
def test_a_fork_that_outlives_a_killed_writer_does_not_keep_the_file(path):
    """As workers of a pool do, which wait for ever."""
    ours, theirs = os.pipe()
    owner = os.fork()
    if not owner:
        out = mpsim.Trajectory.write(path)
        if not os.fork():
            os.write(theirs, str(os.getpid()).encode())
            time.sleep(60)
            os._exit(out.frames)
        signal.pause()
    worker = int(os.read(ours, 20))
    try:
        assert refusal(path) is not None, "the control"
        os.kill(owner, signal.SIGKILL)
        os.waitpid(owner, 0)
        assert refusal(path) is None
    finally:
        os.kill(worker, signal.SIGKILL)
        os.close(ours)
        os.close(theirs)


def test_where_there_are_no_locks_files_are_written_all_the_same(tmp_path, monkeypatch):
    monkeypatch.setattr("fcntl.flock", refusing(95))
    with mpsim.Trajectory.write(tmp_path / "a.xyz"):
        assert refusal(tmp_path / "a.xyz", "a") is None


def test_a_trajectory_takes_frames_of_one_simulation_only_while_it_is_open(path):
    with simulate(gas(6, 0.1), method="naive") as two:
        with mpsim.Trajectory.write(path) as out:
            with simulate(gas(5, 0.1), method="naive") as one:
                one.run(frames=3, observe=out)
                with pytest.raises(
                    OutputError,
                    match=r"the trajectory '.*' belongs to one simulation, <Simulation: 5 discs by naive, frame 3, .*"
                    r">; got another, <Simulation: 6 discs by naive, frame 0, time 0>. Open one for each by mpsim.Traj",
                ):
                    two.run(frames=9, observe=out)
                one.run(frames=2, observe=out)  # whose trajectory is as it was
            del one
            gc.collect()
            with pytest.raises(OutputError, match="belongs to one simulation, which is gone by now; got"):
                two.run(frames=9, observe=out)
        with pytest.raises(
            OutputError,
            match=r"must be open to be written to, and was closed, as by the end of its `with` block; got <Simulat"
            r".* mpsim.Trajectory.write\('.*', mode='a'\)",
        ):
            two.run(frames=2, observe=out)
        assert two.frame == 0, "refused before any frame was run"
    assert [(frame.frame, len(frame.ids)) for frame in mpsim.Trajectory(path)] == [(each, 5) for each in range(6)]


# --- what is refused


def test_places_that_cannot_be_written_and_files_that_are_missing_are_told(tmp_path):
    (tmp_path / "file").touch()
    for place in (tmp_path / "none" / "a.xyz", tmp_path / "file" / "a.xyz", tmp_path / "none" / "a.gsd"):
        with pytest.raises(OutputError, match=r"must be in a folder that can be written to.* Choose another"):
            mpsim.Trajectory.write(place)
    with pytest.raises(TrajectoryError, match=r"a file that can be read; .*none\.xyz' does not exist"):
        mpsim.Trajectory(tmp_path / "none.xyz")
    (tmp_path / "a.gsd").write_bytes(b"no gsd at all" * 100)
    with pytest.raises(TrajectoryError, match=r"must be a whole GSD file; .* cannot be read"):
        mpsim.Trajectory(tmp_path / "a.gsd")
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "trajectory.xyz").touch()
    with pytest.raises(mpsim.InputError, match=r"It is a folder; use '.*/trajectory\.xyz'\."):
        mpsim.Trajectory(tmp_path / "run")
    for arguments, words in (
        ({"path": "a.dump"}, r"path must end in \.xyz, \.extxyz, \.gsd; got 'a\.dump'"),
        ({"path": "a.xyz", "every": 0}, "every must be a whole number from 1 to"),
        ({"path": "a.xyz", "mode": "r"}, "mode must be one of 'x', 'w', 'a'; got 'r'"),
    ):
        with pytest.raises(mpsim.InputError, match=words):
            mpsim.Trajectory.write(**arguments)


@pytest.mark.parametrize("observer", [[None], "a.xyz"])
def test_what_is_no_observer_is_refused(observer):
    with simulate(gas(5, 0.1), method="naive") as sim:
        with pytest.raises(mpsim.InputError, match="observe must be one observer or several: objects with"):
            sim.run(frames=1, observe=observer)
        assert sim.run(frames=1).frames == 1


def test_without_the_gsd_library_the_error_says_what_to_do(tmp_path, monkeypatch):
    written(tmp_path / "a.gsd", gas(5, 0.1), method="naive")
    for module in [name for name in sys.modules if name.partition(".")[0] == "gsd"]:
        monkeypatch.setitem(sys.modules, module, None)
    for use in (lambda: mpsim.Trajectory(tmp_path / "a.gsd"), lambda: mpsim.Trajectory.write(tmp_path / "b.gsd")):
        with pytest.raises(OutputError, match=r"needs the package gsd, .* `pip install 'mpsim\[gsd\]'`, or let"):
            use()
    assert not (tmp_path / "b.gsd").exists()
