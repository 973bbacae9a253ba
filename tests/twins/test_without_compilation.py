"""With NUMBA_DISABLE_JIT=1 the kernels run as plain Python, where an index out of bounds is an error: same bits."""

import numpy as np
import pytest
from support.processes import assert_clean, run_script
from support.scenes import crowd, digest_after, features_of

COUNT, FRAMES = 24, 8

CASES = [
    {"method": method, "law": law, "precision": precision, "features": features, "contact": contact}
    for method in ("grid", "naive")
    for contact in ("push", "impact")
    for law, precision, features in (
        ("elastic", "float64", ""),
        ("reflect", "float32", ""),
        ("elastic", "float64", "gravity and acceleration"),
    )
]

SCRIPT = """
from twins.test_without_compilation import CASES, digests
from mpsim.kernels.compiling import compiled_kernels

print(*digests(CASES))
print(compiled_kernels())
"""


def digests(cases):
    """Digests after a few crowded frames."""
    result = []
    for case in cases:
        settings = {name: value for name, value in case.items() if name != "features"}
        scene = crowd(COUNT, 0.85, seed=31, **features_of(case["features"], COUNT))
        result.append(digest_after(scene, FRAMES, dt=0.05, substeps=2, **settings))
    return result


@pytest.mark.slow
def test_plain_python_gives_the_bits_of_the_compiled_kernels():
    outcome = run_script(SCRIPT, env={"NUMBA_DISABLE_JIT": "1"}, bound=90)
    assert_clean(outcome)
    got, kernels = outcome.out.splitlines()
    assert kernels == "0", "something was compiled in spite of NUMBA_DISABLE_JIT=1"
    for case, plain, compiled in zip(CASES, got.split(), digests(CASES), strict=True):
        assert plain == compiled, f"{case}: {plain} in plain Python, {compiled} compiled"


@pytest.mark.slow
def test_a_random_scene_is_the_same_without_compilation():
    text = """
    import mpsim
    for packing in (0.2, 0.6):
        scene = mpsim.Scene.random(count=20, packing=packing, radius=0.5, seed=32)
        print(mpsim.State(scene.position, scene.velocity).digest())
    """
    outcomes = [run_script(text, env={"NUMBA_DISABLE_JIT": flag}) for flag in ("0", "1")]
    for outcome in outcomes:
        assert_clean(outcome)
    assert outcomes[0].out == outcomes[1].out


@pytest.mark.slow
def test_the_case_list_has_no_two_equal_results():
    found = digests(CASES)
    assert len(np.unique(found)) > len(found) / 2, "the cases hardly differ: they test little"


def test_parallel_runs_on_one_worker_without_compilation():
    """The atomic operations of plain Python are not atomic, so more workers would wait for each other for ever."""
    outcome = run_script(
        """
        from support.scenes import crowd, digest_after, simulate
        with simulate(crowd(24, 0.85, seed=33), method="parallel", workers=3, dt=0.05) as sim:
            report = sim.run(frames=8)
            print(report.workers, sim.digest())
        """,
        env={"NUMBA_DISABLE_JIT": "1"},
        bound=30,
    )
    assert outcome.code == 0, outcome.err
    assert outcome.out.split() == ["1", digest_after(crowd(24, 0.85, seed=33), 8, method="grid", dt=0.05)]


@pytest.mark.slow
def test_an_exact_run_that_begins_without_discs_is_the_same_without_compilation():
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
    outcomes = [run_script(text, env={"NUMBA_DISABLE_JIT": flag}) for flag in ("0", "1")]
    for outcome in outcomes:
        assert_clean(outcome)
    assert outcomes[0].out == outcomes[1].out
    assert outcomes[0].out.startswith("3 ")
