"""Frames as a view shows them: all numbers of discs, absent ones, boxes and edges, of mpsim and of others."""

import gsd.hoomd
import numpy as np
import pytest
from support.scenes import gas, simulate, zoo
from support.trajectories import written

import mpsim
from mpsim.viewer.recording import Recording

GAS = gas(100, 0.3)


@pytest.mark.parametrize("ending", ["xyz", "gsd"])
def test_states_are_those_of_the_run_and_grow_with_the_file(tmp_path, ending):
    path = tmp_path / f"run.{ending}"
    with simulate(GAS, method="grid", dt=0.02) as sim, mpsim.Trajectory.write(path, every=2) as out:
        sim.run(frames=4, observe=out)
        recording = Recording(path)
        assert (len(recording), recording.refresh()) == (3, False)
        moment = recording.at(2)
        assert (moment.frame, moment.time, moment.radii.tolist()) == (4, sim.time, [0.5] * 100)
        assert moment.state.digest() == sim.digest()
        assert recording.at(1).state.digest() != sim.digest(), "negative control"
        sim.run(frames=6, observe=out)
        assert (recording.refresh(), len(recording)) == (True, 6)
        assert recording.at(5).state.digest() == sim.digest()
    assert (recording.scene.width, recording.scene.periodic) == (GAS.width, (False, False))
    recording.close()


def test_discs_keep_their_numbers_where_some_enter_and_leave(tmp_path):
    scene = zoo("absorbing emitters acceleration")
    written(tmp_path / "run.xyz", scene, frames=60, every=20)
    recording, frames = Recording(tmp_path / "run.xyz", scene), mpsim.Trajectory(tmp_path / "run.xyz")
    absent = 0
    for index, frame in enumerate(frames):
        moment = recording.at(index)
        assert np.flatnonzero(moment.state.present).tolist() == frame.ids.tolist()
        assert (moment.state.position[frame.ids] == frame.position).all()
        assert (moment.radii[frame.ids] == frame.radius).all()
        assert len(moment.state.position) >= scene.count
        absent += int((~moment.state.present).sum())
    assert absent > 0
    assert recording.scene is scene


def foreign(path, position, **more):
    frame = gsd.hoomd.Frame()
    frame.configuration.box, frame.particles.N = [10, 6, 0, 0, 0, 0], len(position)
    frame.particles.position = position
    frame.particles.velocity, frame.particles.diameter = [(1, 1, 0)] * len(position), [0.9] * len(position)
    with gsd.hoomd.open(str(path), "w") as file:
        file.append(frame)


def test_files_of_other_programs_are_shown_in_their_box(tmp_path):
    path = tmp_path / "a.extxyz"
    path.write_text(
        '2\nLattice="10 0 0 0 6 0 0 0 1" Origin="-5 -3 0" pbc="T F F" Properties=id:I:1:pos:R:3:velo:R:3:radius:R:1\n'
        "7000000 -6.0 -2.0 0 1 0 0 0.5\n3 0.0 1.0 0 0 1 0 0.5\n"
    )
    recording = Recording(path)
    moment = recording.at(0)
    assert recording.scene.periodic == (True, False)
    assert moment.state.position.tolist() == [[5.0, 4.0], [9.0, 1.0]], "from the corner; inside where it is periodic"
    assert (recording.scene.width, recording.scene.height) == (10.0, 6.0)
    assert np.isnan(moment.time)
    foreign(tmp_path / "b.gsd", [[-4, 0, 0], [0, 0, 0]])
    assert Recording(tmp_path / "b.gsd").at(0).state.position.tolist() == [[1.0, 3.0], [5.0, 3.0]]


def test_what_is_missing_is_named(tmp_path):
    empty, bare = tmp_path / "empty.xyz", tmp_path / "bare.xyz"
    empty.touch()
    with pytest.raises(mpsim.InputError, match=r"a recording must hold a frame; '.*empty.xyz' holds none yet. Let the"):
        Recording(empty)
    bare.write_text('1\nLattice="10 0 0 0 6 0 0 0 1" Properties=pos:R:3:velo:R:3\n1 1 0 0 0 0\n')
    with pytest.raises(
        mpsim.errors.TrajectoryError, match=r"radius must be in a trajectory.*, or give Trajectory\(path, rad"
    ):
        Recording(bare)
    with pytest.raises(
        mpsim.errors.TrajectoryError, match=r"must be a file that can be read; '.*none.xyz' does not exist\."
    ):
        Recording(tmp_path / "none.xyz")
