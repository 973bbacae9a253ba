"""With NUMBA_DISABLE_JIT=1 the kernels run as plain Python, where an index out of bounds is an error: same bits.

This ties all files that run there to the machine code, as do the pinned digests of contracts/test_golden.py.
"""

import warnings

import pytest
from support.processes import assert_clean, run_script
from support.scenes import ZOO, crowd, digest_after, exact_scene, gas, zoo

import mpsim

pytestmark = pytest.mark.compiled

CASES = {
    "bare": [(crowd(24, 0.85, seed=31), ("grid", "naive")), (exact_scene("nothing"), ("event",))],
    "everything": [
        (zoo(ZOO["everything rough"], 24), ("grid",)), (exact_scene("obstacles, gravity"), ("event",)),
    ],
}  # fmt: skip


def digests(name, precisions):
    """Digests of some frames by each method, contact and precision, after that of a random start."""
    start = gas(20, 0.6, seed=32)
    found = [mpsim.State(start.position, start.velocity).digest()]
    for scene, methods in CASES[name]:
        for method in methods:
            for precision in precisions[: 2 - (method == "event")]:
                for contact in ("impact", "push")[: 2 - (method == "event")]:
                    with warnings.catch_warnings():
                        warnings.simplefilter("ignore")
                        found.append(
                            digest_after(scene, 10, method=method, contact=contact, precision=precision, dt=0.05)
                        )
    return found


@pytest.mark.parametrize(
    ("name", "precisions"),
    [("bare", ["float64"]), pytest.param("everything", ["float64", "float32"], marks=pytest.mark.long)],
)
@pytest.mark.timeout(400)
def test_plain_python_has_the_bits_of_machine_code(name, precisions):
    text = f"from twins.test_plain_python import digests; print(*digests({name!r}, {precisions}))"
    outcome = run_script(text, env={"NUMBA_DISABLE_JIT": "1"}, bound=180)
    assert_clean(outcome)
    found = digests(name, precisions)
    assert outcome.out.split() == found
    assert len(set(found)) == len(found) > 2, "the cases hardly differ: they test little"
