"""Thousands of random scenes for what the other files check of a few, in plain Python."""

import pytest
from support.processes import assert_clean, run_script

pytestmark = pytest.mark.long

CHECKS = {
    "bits": "sum(map(check_stepped, range(1000, 4000))), sum(map(check_exact, range(1000, 1600)))",
    "scaling": "[check_stepped(seed) for seed in range(1000, 5000)], [check_exact(seed) for seed in range(1000, 2600)]",
    "stepped": "check_anything(30, 8000), [check_feature(name, method=method, **kind(turn + 2))"
    " for turn, name in enumerate(ZOO) for method in METHODS]",
}
"""Calls of the functions of a file, by its name."""


@pytest.mark.timeout(2100)
@pytest.mark.parametrize("name", CHECKS)
def test_what_holds_for_a_few_scenes_holds_for_thousands(name):
    text = f"import warnings; warnings.simplefilter('ignore'); from twins.test_{name} import *; {CHECKS[name]}"
    assert_clean(run_script(text, env={"NUMBA_DISABLE_JIT": "1"}, bound=2000))
