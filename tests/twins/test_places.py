"""Where a piston is, is a function of the time alone, in float64; and nothing acts on discs that have left."""

import numpy as np
import pytest
from support.scenes import scene_of

import mpsim

pytestmark = [pytest.mark.plain, pytest.mark.filterwarnings("ignore::UserWarning")]

START, SPEED, SLOWER, STOP = 10.0, -0.7, -0.3, 3.3


def place(time, changed=None):
    if changed is None or time <= changed:
        return max(START + SPEED * time, STOP)
    return max(place(changed) + SLOWER * (time - changed), STOP)


def check(sim, path, changed=None):
    expected = place(sim.time, changed)
    assert sim.state.box == (0, expected, 0, 10), (sim.state.box, expected)
    assert sim.scene.walls_at(sim.time)[1].tolist() == [expected, 10], sim.scene.walls_at(sim.time)
    sim.save(path)
    with mpsim.Simulation.resume(path) as again, mpsim.Simulation.replay(sim.journal) as replayed:
        assert again.state.box == replayed.state.box == sim.state.box
        assert again.digest() == replayed.digest() == sim.digest()
        if sim.settings.method != "event":
            assert again.scene.piston == replayed.scene.piston == sim.scene.piston


@pytest.mark.parametrize(("method", "precision"), [("grid", "float32"), ("event", "float64")])
def test_a_piston_is_where_its_time_says_after_every_change(method, precision, tmp_path):
    scene = mpsim.Scene(width=10, height=10, radius=0.5, position=[[2, 2], [6, 2], [9.3, 7]],
                        velocity=[[0, 0], [1, 0.3], [0, 0]], piston=mpsim.Piston("right", SPEED, STOP))  # fmt: skip
    path = tmp_path / "run.mpsim"
    with mpsim.Simulation(scene, mpsim.Settings(method=method, precision=precision, dt=0.02)) as sim:
        sim.run(frames=21)
        check(sim, path)
        sim.change(dt=0.026, **({} if method == "event" else {"substeps": 3}))
        sim.run(frames=15)
        check(sim, path)
        assert sim.scene.piston == scene.piston  # which goes on as it was
        slower = sim.time
        sim.change(piston_speed=SLOWER)
        sim.run(frames=16)
        check(sim, path, slower)
        sim.change(dt=0.07)
        sim.run(frames=9)
        check(sim, path, slower)
        sim.set(2, position=(sim.state.box[1] - 0.501, 7), velocity=(0, 0))  # discs feel it there, after every change
        sim.run(frames=2)
        assert np.isclose(sim.state.velocity[2, 0], 2 * SLOWER), sim.state.velocity
        assert sim.state.position[2, 0] <= np.dtype(precision).type(place(sim.time, slower) - 0.5)
        onward = sim.scene.starting_from(sim.state)
        assert onward.box == sim.state.box
        assert onward.walls_at(1.0)[1][0] == place(sim.time, slower) + SLOWER
        sim.change(dt=0.5)
        sim.run(until=40)
        check(sim, path, slower)
        assert sim.state.box[1] == STOP


@pytest.mark.parametrize(("method", "substeps", "dt"), [("grid", 7, 0.3), ("grid", 7, 1.3), ("event", 1, 0.7)])
def test_frames_of_other_lengths_end_at_the_same_place(method, substeps, dt):
    """Where a piston stops inside a frame, too."""
    scene = scene_of([[1, 2]], width=10, height=10, radius=0.1, piston=mpsim.Piston("right", SPEED, STOP))
    with mpsim.Simulation(scene, mpsim.Settings(method=method, dt=dt, substeps=substeps)) as sim:
        while sim.time < 10.5:
            sim.run(frames=1)
            assert sim.state.box[1] == place(sim.time), sim.frame


ROUGH = {"gravity": (0, -0.125), "wall_restitution": 0.5, "friction": 0.25, "wall_friction": 0.25}


@pytest.mark.parametrize(("method", "more"), [("naive", {}), ("grid", ROUGH), ("event", {}), ("event", ROUGH)])
def test_a_piston_passes_over_discs_that_have_left_and_every_file_has_them_where_they_left(method, more, tmp_path):
    where = np.array([[1.0, 8.0], [6.0, 8.0], [3.0, 2.0], [8.0, 8.25]])  # absorbed, removed, and two that stay
    velocity = [[-1, 0], [0, 0], [0, 0], [0, -0.125]]
    scene = scene_of(where, velocity, 10, 10, absorbing="left", piston=mpsim.Piston("top", -1.0, 4.0), **more)
    with mpsim.Simulation(scene, mpsim.Settings(method=method, dt=1 / 32)) as sim:
        sim.remove(1)
        sim.run(until=0.75)
        left = sim.state.position[0].tolist()
        assert 7.9 < left[1] <= 8
        assert abs(left[0] - 0.5) <= 1 / 32
        sim.run(until=4.5)
        sim.kick(2, (0, 0.125))
        state, gone = sim.state, [left, [6.0, 8.0]]
        assert state.present.tolist() == [False, False, True, True]
        assert state.box[3] == 5.5
        assert state.position[:2].tolist() == gone
        assert not state.velocity[:2].any()
        assert state.position[3, 1] <= 5, "the control: the piston has taken along a disc that is there"
        path = sim.save(tmp_path / "run.mpsim")
        with mpsim.Simulation.resume(path) as again, mpsim.Simulation.replay(sim.journal) as replayed:
            assert again.digest() == replayed.digest() == sim.digest()
            for each in (sim, again):
                each.change(piston_speed=-0.5)
                each.add((6.0, 4.5), (0, 0))  # above it the removed disc, which takes no room
                each.run(until=5)
                assert each.state.position[:2].tolist() == gone, each.state.position
            assert again.digest() == sim.digest()
        assert len(mpsim.draw(sim).axes[0].collections[0].get_offsets()) == 3
        assert sim.scene.starting_from(state).count == 2
