"""Which run may continue the file of a trajectory: the one that it is of."""

from pathlib import Path

import gsd.hoomd
import numpy as np
import pytest
from support.scenes import gas, simulate
from support.selection import long_but
from support.trajectories import DT, ENDINGS, PLACES, SCENES, SPEEDS, content, killed_and_resumed, pair, written

import mpsim
from mpsim.output.recorder import Recorder

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
@pytest.mark.parametrize("other", OTHERS)
def test_a_simulation_that_has_come_later_cannot_continue_the_file_of_another(tmp_path, ending, other):
    """The file ends at frame 2, and the simulation is at frame 3: no frame is in both."""
    path, (scene, settings, text) = tmp_path / f"a.{ending}", OTHERS[other]
    written(path, pair(), 2, 1, method="naive")
    before = path.read_bytes()
    with simulate(scene, **{"dt": 0.02, "method": "naive", **settings}) as sim:
        sim.run(frames=3)
        with (
            mpsim.Trajectory.write(path, mode="a") as out,
            pytest.raises(
                mpsim.errors.OutputError, match=rf"can be continued only by the run that wrote it; .*{text}.*mode='w"
            ),
        ):
            sim.run(frames=2, observe=out)
    assert path.read_bytes() == before


@pytest.mark.parametrize("ending", ENDINGS)
def test_later_frames_of_another_are_not_dropped(tmp_path, ending):
    """All frames of the file are later than the simulation: they would have been cut off, and nothing compared."""
    path = tmp_path / f"a.{ending}"
    with simulate(pair(), method="naive", dt=0.02) as sim:
        sim.run(frames=5)
        with mpsim.Trajectory.write(path) as out:
            sim.run(frames=3, observe=out)
    before = path.read_bytes()
    with pytest.raises(mpsim.errors.OutputError, match=r"at frame 5 its mass of disc 1 is 1 and not 9"):
        written(path, pair(mass=[1, 9.0]), 2, 1, mode="a", method="naive")
    assert path.read_bytes() == before
    written(path, pair(), 2, 1, mode="a", method="naive")  # its own run starts anew
    assert [row[0] for row in content(path)] == [0, 1, 2]


OWN = {
    "events": (pair(boundary="periodic"), {"method": "event"}),
    "piston in single precision": (
        pair(radius=[0.5, 0.25], piston=mpsim.Piston("left", 0.7, 2)),
        {"precision": "float32"},
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", OWN)
def test_a_run_resumed_between_two_frames_of_its_file_continues_it(tmp_path, name):
    scene, settings = OWN[name]
    written(tmp_path / "whole.xyz", scene, 40, 3, **{"method": "naive", **settings})
    killed_and_resumed(tmp_path / "a.xyz", scene, **{"method": "naive", **settings})
    assert (tmp_path / "a.xyz").read_bytes() == (tmp_path / "whole.xyz").read_bytes()


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_file_of_another_program_is_not_continued(tmp_path, ending):
    """It was, by frames that hold more than its own."""
    path = tmp_path / f"a.{ending}"
    written(path, pair(), 1, 1, method="naive")
    if ending == "gsd":
        hoomd = pytest.importorskip("gsd.hoomd")
        with hoomd.open(str(path), "r") as file:
            frame = file[0]
        frame.log = {}
        with hoomd.open(str(path), "w") as file:
            file.append(frame)
        text = "times, radii, masses, numbers of discs"  # diameters and masses of 1 are not written
    else:
        path.write_text(path.read_text().replace("id:I:1", "tag:I:1").replace("velo:R:3:momenta", "speed:R:3:push"))
        text = "velocities, numbers of discs"
    with simulate(pair(), method="naive", dt=0.02) as sim:
        sim.run(frames=3)
        with (
            mpsim.Trajectory.write(path, mode="a") as out,
            pytest.raises(mpsim.errors.OutputError, match=f"must hold {text} to be continued, so that"),
        ):
            sim.run(frames=1, observe=out)


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_closed_writer_says_that_it_was_closed_and_how_to_go_on(tmp_path, ending):
    path = tmp_path / f"a.{ending}"
    with simulate(pair(), method="naive", dt=0.02) as sim:
        with mpsim.Trajectory.write(path) as out:
            sim.run(frames=1, observe=out)
            sim.run(frames=1, observe=out)
        with pytest.raises(
            mpsim.errors.OutputError,
            match=r"the trajectory '.*' must be open to be written to, and was closed, as by the end of its `with` "
            r"block; got <Simulation: 2 .*frame 2.* mpsim.Trajectory.write\('.*', mode='a'\)",
        ):
            sim.run(frames=2, observe=out)
        assert sim.frame == 2, "refused before any frame was run"
        with mpsim.Trajectory.write(path, mode="a") as out:
            sim.run(frames=2, observe=out)
    assert [row[0] for row in content(path)] == [0, 1, 2, 3, 4]


def test_a_closed_table_says_that_it_was_closed(tmp_path):
    with simulate(pair(), method="naive") as sim:
        with Recorder(tmp_path / "a.csv", 1, sim) as table:
            sim.run(frames=1, observe=table)
        with pytest.raises(
            mpsim.errors.OutputError, match=r"the table '.*' must be open to be written to, and was closed"
        ):
            sim.run(frames=1, observe=table)


def old_text(path: Path) -> None:
    """A frame as mpsim wrote it before masses."""
    path.write_text(
        '1\nLattice="8.0 0.0 0.0 0.0 6.0 0.0 0.0 0.0 1.0" Properties=species:S:1:pos:R:3:radius:R:1:velo:R:3:id:I:1 '
        'Time=0.0 pbc="F F F" Frame=0 precision=float64\nX 1.5 2.0 0.0 0.5 3.0 4.0 0.0 0\n'
    )


def old_gsd(path: Path) -> None:
    """As `old_text`, and the first frame that had no disc."""
    frames = []
    for step, count in ((0, 0), (0, 1)):
        made = gsd.hoomd.Frame()
        made.configuration.step, made.particles.N = step, count
        place, velocity, radius, ids = np.array([[1.5, 2.0]]), np.array([[3.0, 4.0]]), np.array([0.5]), np.array([0])
        arrays = {"position": place, "velocity": velocity, "radius": radius, "id": ids} if count else {}
        made.log = {f"particles/mpsim/{name}": array for name, array in arrays.items()}
        made.log |= {"mpsim/time": np.zeros(1), "mpsim/box": np.array([8.0, 6.0])}
        made.log |= {"mpsim/periodic": np.zeros(2, np.uint8), "mpsim/single": np.zeros(1, np.uint8)}
        frames.append(made)
    with gsd.hoomd.open(str(path), "w") as file:
        file.extend(frames)


@pytest.mark.parametrize(("ending", "make"), [("xyz", old_text), ("gsd", old_gsd)])
def test_a_file_without_masses_is_read_and_not_continued(tmp_path, ending, make):
    path = tmp_path / f"old.{ending}"
    make(path)
    frame = mpsim.Trajectory(path)[-1]
    assert (frame.position.tolist(), frame.velocity.tolist(), frame.radius.tolist()) == ([[1.5, 2]], [[3, 4]], [0.5])
    assert (frame.box, frame.origin, frame.time, frame.ids.tolist()) == ((8, 6), (0, 0), 0, [0])
    assert mpsim.Trajectory(path)[0].position.shape == (int(ending == "xyz"), 2)
    with pytest.raises(
        mpsim.errors.TrajectoryError, match=r"mass must be in a trajectory to be read from it; .* masses:R:1"
    ):
        frame.mass  # noqa: B018
    before = path.read_bytes()
    scene = mpsim.Scene(width=8, height=6, position=[[1.5, 2]], velocity=[[3, 4]], radius=0.5)
    with pytest.raises(
        mpsim.errors.OutputError, match=r"must hold masses to be continued, .* by an earlier version of mpsim"
    ):
        written(path, scene, mode="a")
    assert path.read_bytes() == before


@pytest.mark.parametrize("ending", ENDINGS)
def test_after_discs_were_added_a_trajectory_is_continued_by_its_own_run(tmp_path, ending):
    """The last frame of the file was written before they were added; they are in the next one."""
    path = tmp_path / f"a.{ending}"
    with simulate(gas(5, 0.1), method="naive", dt=DT) as sim:
        with mpsim.Trajectory.write(path, 5) as out:
            sim.run(frames=10, observe=out)
        sim.add([1.5, 1.5], [0, 0])
        with mpsim.Trajectory.write(path, 5, mode="a") as out:
            sim.run(frames=5, observe=out)
    assert [(frame.frame, len(frame.ids)) for frame in mpsim.Trajectory(path)] == [(0, 5), (5, 5), (10, 5), (15, 6)]


@pytest.mark.slow
@pytest.mark.parametrize("ending", ENDINGS)
def test_behind_a_piston_a_trajectory_is_continued_by_its_own_run(tmp_path, ending):
    """The box of the last frame of the file and that of the simulation differ, and rightly so."""
    path, scene = tmp_path / f"a.{ending}", SCENES["left piston"]()
    with simulate(scene, method="naive", dt=DT) as sim:
        with mpsim.Trajectory.write(path, 5) as out:
            sim.run(frames=17, observe=out)
        with mpsim.Trajectory.write(path, 5, mode="a") as out:
            sim.run(frames=8, observe=out)
    assert [frame.frame for frame in mpsim.Trajectory(path)] == [0, 5, 10, 15, 20, 25]


@pytest.mark.slow
@pytest.mark.parametrize("name", long_but(SCENES, "everything"))
def test_a_killed_and_resumed_run_continues_its_file_in_every_kind_of_scene(tmp_path, name):
    """Whatever moves, leaves and enters: it becomes the file of one run."""
    settings = {"method": "grid" if name == "everything" else "naive", "dt": DT}
    written(tmp_path / "whole.xyz", SCENES[name](), 40, 3, **settings)
    killed_and_resumed(tmp_path / "a.xyz", SCENES[name](), **settings)
    assert (tmp_path / "a.xyz").read_bytes() == (tmp_path / "whole.xyz").read_bytes()
