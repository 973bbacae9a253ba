"""The bits depend neither on the processor that kernels are compiled for nor on how hard the compiler works.

Here a processor without AVX and fused products, and an optimization that turns no loop into vectors.
"""

import inspect
import json
from pathlib import Path

import pytest
from support.compilations import CASES, WORDS, digests
from support.processes import assert_clean, run_script
from support.scenes import zoo

import mpsim
from mpsim.scene.settings import NAMES

GENERIC = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
LAZY = {"NUMBA_OPT": "1"}
"""Level 1 of LLVM: no vector code of its own."""

SCRIPT = """
import json
from support.compilations import report
print(json.dumps(report({names!r})))
"""

FUSED = """
import functools
import numba, numba.extending
numba.njit = functools.partial(numba.njit, fastmath={"contract"})
numba.extending.register_jitable = functools.partial(numba.extending.register_jitable, fastmath={"contract"})
"""
"""What no kernel is compiled with: a product and a sum may become one operation with one rounding."""


def compiled_with(environment, names, folder, bound, before=""):
    """What kernels come to that were compiled under variables of the environment, after a script."""
    outcome = run_script(
        before + SCRIPT.format(names=names), env=environment | {"NUMBA_CACHE_DIR": str(folder)}, bound=bound
    )
    assert_clean(outcome)
    assert any(folder.rglob("*.nbc")), "nothing was compiled for it"
    return json.loads(outcome.out)


@pytest.mark.long
@pytest.mark.timeout(2500)
@pytest.mark.parametrize("environment", [GENERIC, LAZY], ids=["generic", "lazy"])
def test_the_compiler_has_no_say_in_the_bits_of_any_features(environment, tmp_path):
    found = compiled_with(environment, list(CASES), tmp_path, 2400)
    assert (found["processor"] == "generic") == ("NUMBA_CPU_NAME" in environment), found["processor"]
    assert found["optimization"] == int(environment.get("NUMBA_OPT", 3))
    assert found["digests"] == digests(CASES)
    assert len(set(found["digests"].values())) == len(CASES), "the control: different cases have different digests"


@pytest.mark.long
@pytest.mark.skipif(" fma " not in Path("/proc/cpuinfo").read_text(), reason="this processor fuses no products")
@pytest.mark.timeout(700)
def test_fused_products_are_seen(tmp_path):
    """The control: kernels that may fuse have other bits."""
    names = ["naive no features"]
    assert compiled_with({}, names, tmp_path, 600, before=FUSED)["digests"] != digests(names)


def test_the_cases_have_every_feature_of_a_scene():
    """A feature that a scene can have and that no case has would be compiled for nobody here."""
    plain, others_than_plain = zoo(WORDS["no features"]), [zoo(WORDS["everything rough"]), zoo(WORDS["heated"])]
    others = {"width", "height", "position", "velocity", *NAMES}
    features = inspect.signature(mpsim.Scene).parameters.keys() - others
    given = {
        name
        for name in features
        for scene in others_than_plain
        if repr(getattr(plain, name)) != repr(getattr(scene, name))
    }
    assert given == features, f"no case has {features - given}"
