"""The bits depend neither on the processor that kernels are compiled for nor on how hard the compiler works.

Here a processor without AVX and fused products, and an optimization that turns no loop into vectors.
"""

import json
from pathlib import Path

import pytest
from support.goldens import pins
from support.processes import assert_clean, run_script

pytestmark = [pytest.mark.compiled, pytest.mark.long, pytest.mark.timeout(2500)]

SCRIPT = """
import json
from numba import config
from numba.core.registry import cpu_target
from support.goldens import few, outcome

names = "bare", "everything", "everything rough", "stream exact", "thermostat", "thermal walls"
found = {name: {words: outcome(name, **how) for words, how in few(name).items()} for name in names}
print(json.dumps([cpu_target.target_context.codegen().magic_tuple()[1], int(config.OPT), found]))
"""

FUSED = """
import functools
import numba, numba.extending
numba.njit = functools.partial(numba.njit, fastmath={"contract"})
numba.extending.register_jitable = functools.partial(numba.extending.register_jitable, fastmath={"contract"})
"""
"""What no kernel is compiled with: a product and a sum may become one operation with one rounding."""


def compiled_with(environment, folder, before=""):
    """Processor, optimization and digests, of kernels that were compiled under variables of the environment."""
    outcome = run_script(before + SCRIPT, env=environment | {"NUMBA_CACHE_DIR": str(folder)}, bound=2400)
    assert_clean(outcome)
    assert any(folder.rglob("*.nbc")), "nothing was compiled for it"
    return json.loads(outcome.out)


@pytest.mark.parametrize(
    "environment",
    [{"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}, {"NUMBA_OPT": "1"}],
    ids=["generic", "lazy"],
)
def test_the_compiler_has_no_say_in_the_bits_of_any_features(environment, tmp_path):
    processor, optimization, found = compiled_with(environment, tmp_path)
    assert (processor == "generic") == ("NUMBA_CPU_NAME" in environment), processor
    assert optimization == int(environment.get("NUMBA_OPT", 3))
    pinned = pins()["digests"]
    assert found == {name: {words: pinned[name][words] for words in outcomes} for name, outcomes in found.items()}


def test_fused_products_are_seen(tmp_path):
    """The control: kernels that may fuse have other bits, where the processor can."""
    found = compiled_with({}, tmp_path, before=FUSED)[2]
    fuses = " fma " in Path("/proc/cpuinfo").read_text()
    assert (found["bare"] != {words: pins()["digests"]["bare"][words] for words in found["bare"]}) == fuses
