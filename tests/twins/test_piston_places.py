"""Where a piston is, is a function of the time alone, in float64: in every method and precision, whatever was changed.

In plain Python, which has the same bits, so that nothing is compiled for it.
"""

from support.processes import assert_clean, run_script

SCRIPT = """
import itertools, numpy, mpsim
from pathlib import Path

START, SPEED, SLOWER, STOP, PATH = 10.0, -0.7, -0.3, 3.3, Path(__file__).with_name("run.mpsim")

def place(time, changed=None):
    if changed is None or time <= changed:
        return max(START + SPEED * time, STOP)
    return max(place(changed) + SLOWER * (time - changed), STOP)

def check(sim, changed=None):
    expected = place(sim.time, changed)
    assert sim.state.box == (0, expected, 0, 10), (sim.state.box, expected)
    assert sim.scene.walls_at(sim.time)[1].tolist() == [expected, 10], sim.scene.walls_at(sim.time)
    sim.save(PATH)
    with mpsim.Simulation.resume(PATH) as again, mpsim.Simulation.replay(sim.journal) as replayed:
        assert again.state.box == replayed.state.box == sim.state.box
        assert again.digest() == replayed.digest() == sim.digest()
        if sim.settings.method != "event":
            assert again.scene.piston == replayed.scene.piston == sim.scene.piston

for method, precision in itertools.product(("naive", "grid", "event"), ("float64", "float32")):
    if (method, precision) == ("event", "float32"):
        continue
    scene = mpsim.Scene(width=10, height=10, radius=0.5, position=[[2, 2], [6, 2], [9.3, 7]],
                        velocity=[[0, 0], [1, 0.3], [0, 0]], piston=mpsim.Piston("right", SPEED, STOP))
    settings = mpsim.Settings(method=method, precision=precision, dt=0.01, workers=1)
    with mpsim.Simulation(scene, settings) as sim:
        for _ in range(3):
            sim.run(frames=21)
            check(sim)
        sim.change(dt=0.013)
        if method != "event":
            sim.change(substeps=3)
        sim.run(frames=29)
        check(sim)
        assert sim.scene.piston == scene.piston  # which goes on as it was
        slower = sim.time
        sim.change(piston_speed=SLOWER)
        check(sim, slower)
        sim.run(frames=31)
        check(sim, slower)
        sim.change(dt=0.07)
        sim.run(frames=9)
        check(sim, slower)
        sim.set(2, position=(sim.state.box[1] - 0.501, 7), velocity=(0, 0))  # discs feel it there, after every change
        sim.run(frames=2)
        assert numpy.isclose(sim.state.velocity[2, 0], 2 * SLOWER), sim.state.velocity
        assert sim.state.position[2, 0] <= numpy.dtype(precision).type(place(sim.time, slower) - 0.5)
        onward = sim.scene.starting_from(sim.state)
        assert onward.box == sim.state.box and onward.walls_at(1.0)[1][0] == place(sim.time, slower) + SLOWER
        sim.run(until=40)
        check(sim, slower)
        assert sim.state.box[1] == STOP

# Frames of other lengths end at the same place, where a piston stops inside a frame too.
for dt in (0.1, 0.3, 0.7, 1.3):
    scene = mpsim.Scene(width=10, height=10, radius=0.1, position=[[1, 2]], velocity=[[0, 0]],
                        piston=mpsim.Piston("right", SPEED, STOP))
    for method, substeps in (("grid", 1), ("grid", 7), ("event", 1)):
        with mpsim.Simulation(scene, mpsim.Settings(method=method, dt=dt, substeps=substeps, workers=1)) as sim:
            for _ in range(40):
                sim.run(frames=1)
                assert sim.state.box[1] == place(sim.time), (dt, method, substeps, sim.frame)
"""


def test_a_piston_is_where_its_time_says_in_every_method_and_after_every_change():
    assert_clean(run_script(SCRIPT, env={"NUMBA_DISABLE_JIT": "1", "PYTHONWARNINGS": "ignore"}, flags=(), bound=120))
