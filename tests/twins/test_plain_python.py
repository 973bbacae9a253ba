"""With NUMBA_DISABLE_JIT=1 the kernels run as plain Python, where an index out of bounds is an error: same bits.

This ties all files that run there to the machine code.
"""

import pytest
from support.processes import assert_clean, run_script
from support.scenes import crowd, digest_after

pytestmark = pytest.mark.compiled

SCRIPT = """
import warnings
import mpsim
warnings.simplefilter("ignore")
from support.scenes import ZOO, digest_after, exact_scene, crowd, zoo
scene = mpsim.Scene.random(count=20, packing=0.6, radius=0.5, seed=32)
print(mpsim.State(scene.position, scene.velocity).digest())
for scene, methods in {scenes}:
    for method in methods:
        for precision in {precisions}[: 2 - (method == "event")]:
            for contact in ("impact", "push")[: 2 - (method == "event")]:
                how = dict(method=method, contact=contact, dt=0.05)
                print(digest_after(scene, 10, precision=precision, **how))
"""


def assert_same(scenes, bound, precisions=("float64", "float32")):
    outcomes = [
        run_script(SCRIPT.format(scenes=scenes, precisions=precisions), env={"NUMBA_DISABLE_JIT": each}, bound=bound)
        for each in "01"
    ]
    for outcome in outcomes:
        assert_clean(outcome)
    compiled, plain = (outcome.out.split() for outcome in outcomes)
    assert plain == compiled
    assert len(set(compiled)) == len(compiled) > 2, "the cases hardly differ: they test little"


def test_plain_python_has_the_bits_of_the_bare_kernels():
    assert_same(
        '[(crowd(24, 0.85, seed=31), ("grid", "naive")), (exact_scene("nothing"), ("event",))]', 170, ("float64",)
    )


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_plain_python_has_the_bits_of_the_kernels_with_everything():
    assert_same('[(zoo(ZOO["everything rough"], 24), ("grid",))]', 180)
    assert_same('[(exact_scene("obstacles, gravity"), ("event",))]', 180)


def test_parallel_runs_on_one_worker_in_plain_python():
    """The atomic operations of plain Python are not atomic, so more workers would wait for each other for ever."""
    outcome = run_script(
        """
        from support.scenes import crowd, simulate
        with simulate(crowd(24, 0.85, seed=33), method="parallel", workers=3, dt=0.05) as sim:
            report = sim.run(frames=8)
            print(report.workers, sim.digest())
        """,
        env={"NUMBA_DISABLE_JIT": "1"},
        bound=30,
    )
    assert outcome.code == 0, outcome.err
    assert outcome.out.split() == ["1", digest_after(crowd(24, 0.85, seed=33), 8, method="grid", dt=0.05)]


def test_an_exact_run_that_begins_without_discs_is_the_same_in_plain_python():
    """In plain Python, it divided by their number; compiled, it went on with infinity."""
    text = """
    import mpsim
    import numpy as np
    scene = mpsim.Scene(
        width=100, height=100, position=np.zeros((0, 2)), velocity=np.zeros((0, 2)), radius=0.01,
        emitters=mpsim.Emitter((50, 50), (20, 3), interval=0.1, limit=3),
    )
    with mpsim.Simulation(scene, mpsim.Settings(method="event", dt=0.1)) as sim:
        sim.run(frames=60)
        print(sim.count, sim.state.digest())
    """
    outcomes = [run_script(text, env={"NUMBA_DISABLE_JIT": flag}) for flag in "01"]
    for outcome in outcomes:
        assert_clean(outcome)
    assert outcomes[0].out == outcomes[1].out
    assert outcomes[0].out.startswith("3 ")
