"""Nothing acts on discs that have left: a piston passes over them, and every file has them where they left.

In plain Python, which has the same bits, so that nothing is compiled for it.
"""

from support.processes import assert_clean, run_script

SCRIPT = """
import itertools, numpy, mpsim
from pathlib import Path
ROUGH = dict(gravity=(0, -0.125), wall_restitution=0.5, friction=0.25, wall_friction=0.25)
for method, more in itertools.product(("naive", "grid", "event"), ({}, ROUGH)):
    where = numpy.array([[1.0, 8.0], [6.0, 8.0], [3.0, 2.0], [8.0, 8.25]])  # absorbed, removed, and two that stay
    velocity = [[-1, 0], [0, 0], [0, 0], [0, -0.125]]
    scene = mpsim.Scene(width=10, height=10, radius=0.5, position=where, velocity=velocity, absorbing="left",
                        piston=mpsim.Piston("top", -1.0, 4.0), **more)
    with mpsim.Simulation(scene, mpsim.Settings(method=method, dt=1 / 64, workers=1)) as sim:
        sim.remove(1)
        sim.run(until=0.75)
        left = sim.state.position[0].tolist()
        assert 7.9 < left[1] <= 8 and abs(left[0] - 0.5) <= 1 / 64, left
        sim.run(until=4.5)
        sim.kick(2, (0, 0.125))
        state, gone = sim.state, [left, [6.0, 8.0]]
        assert state.present.tolist() == [False, False, True, True] and state.box[3] == 5.5
        assert state.position[:2].tolist() == gone and not state.velocity[:2].any()
        assert state.position[3, 1] <= 5  # the control: the piston has taken along a disc that is there
        path = Path(__file__).with_name("run.mpsim")
        sim.save(path)
        with mpsim.Simulation.resume(path) as again, mpsim.Simulation.replay(sim.journal) as replayed:
            assert again.digest() == replayed.digest() == sim.digest()
            for each in (sim, again):
                each.change(piston_speed=-0.5)
                each.add((6.0, 4.5), (0, 0))  # above it the removed disc, which takes no room
                each.run(until=5)
                assert each.state.position[:2].tolist() == gone, each.state.position
            assert again.digest() == sim.digest()
        shown = mpsim.draw(sim).axes[0].collections[0]
        assert len(shown.get_offsets()) == 3
        left_over = sim.scene.starting_from(state)
        assert left_over.count == 2
"""


def test_a_piston_passes_over_discs_that_have_left():
    assert_clean(run_script(SCRIPT, env={"NUMBA_DISABLE_JIT": "1", "PYTHONWARNINGS": "ignore"}, flags=(), bound=120))
