"""The bits do not depend on the processor that the kernels are compiled for: here one without AVX or fused products.

One execution: a scene in a process whose kernels are compiled for a generic processor. Executions: 1 by default (whose
kernel, `naive`, is compiled in seconds), 12 more with --long.
"""

import itertools

import pytest
from support.processes import assert_clean, run_script
from support.scenes import ZOO, digest_after, gas, zoo

NAIVE = {"plain": ("naive", "float64", "impact", "")}
"""Method, precision, contact and features of the scenes, by name."""

CASES = NAIVE | {
    f"{name} {precision} {contact}": ("grid", precision, contact, words)
    for (name, words), precision, contact in itertools.product(
        (("no features", ""), ("gravity", "gravity"), ("everything", ZOO["everything"])),
        ("float32", "float64"),
        ("push", "impact"),
    )
}  # fmt: skip


def digest(name):
    """Digest of a case, or of a gas by the exact solver."""
    if name == "event":
        return digest_after(gas(60, 0.5, seed=5, gravity=(0.5, -1.0), restitution=0.9), 20, method="event", dt=0.05)
    method, precision, contact, words = CASES[name]
    scene = zoo(words, 80, seed=6, side=10.0)
    return digest_after(scene, 20, method=method, precision=precision, contact=contact, dt=0.03)


SCRIPT = """
import warnings
warnings.simplefilter("ignore")
from adversary.test_machine_code import digest
for name in {names!r}:
    print(digest(name))
"""


def compiled_for(processor, names, folder, bound):
    """Digests by kernels compiled anew for a processor."""
    env = {"NUMBA_CPU_NAME": processor, "NUMBA_CPU_FEATURES": "", "NUMBA_CACHE_DIR": str(folder)}
    outcome = run_script(SCRIPT.format(names=list(names)), env=env, bound=bound)
    assert_clean(outcome)
    assert any(folder.rglob("*.nbc")), "nothing was compiled for this processor"
    return dict(zip(names, outcome.out.split(), strict=True))


def test_a_generic_processor_has_the_same_bits(tmp_path):
    assert compiled_for("generic", NAIVE, tmp_path, 120) == {name: digest(name) for name in NAIVE}


@pytest.mark.long
@pytest.mark.timeout(1300)
@pytest.mark.filterwarnings("ignore::mpsim.EmitterWarning")
def test_a_generic_processor_has_the_same_bits_with_any_features(tmp_path):
    names = [*CASES, "event"]
    found = compiled_for("generic", names, tmp_path, 1200)
    assert found == {name: digest(name) for name in names}
    assert len(set(found.values())) == len(names), "the control: different cases have different digests"
