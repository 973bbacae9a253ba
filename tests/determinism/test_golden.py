"""Pinned digests: the same bits as when they were written, on every machine with IEEE arithmetic.

The scene is built by integer arithmetic and a frame uses + - * / and square roots only, so neither the mathematical
library nor the random numbers of NumPy can change a digest. Only an intended change of the dynamics may; then renew:

    python -m pytest tests/determinism/test_golden.py --renew

and say in the changelog that runs of the new version do not continue those of the old one.
"""

import json
from pathlib import Path

import pytest
from support.scenes import digest_after, lattice

FILE = Path(__file__).parent / "golden.json"
FRAMES = 200

CASES = {
    f"{method} {law} {precision}": {"method": method, "law": law, "precision": precision}
    for method in ("naive", "grid")
    for law in ("elastic", "reflect")
    for precision in ("float32", "float64")
}


@pytest.mark.parametrize("case", CASES)
def test_the_digest_is_the_pinned_one(case, request):
    found = digest_after(lattice(24, 20), FRAMES, dt=1 / 32, **CASES[case])
    pinned = json.loads(FILE.read_text()) if FILE.exists() else {}
    if request.config.getoption("--renew"):
        FILE.write_text(json.dumps(dict(sorted((pinned | {case: found}).items())), indent=2) + "\n")
        pytest.skip(f"pinned {found}")
    assert found == pinned[case], f"{case}: digest {found}, pinned {pinned[case]}; intended? see the top of this file"


def test_no_two_cases_are_pinned_to_the_same_digest():
    pinned = json.loads(FILE.read_text())
    assert pinned.keys() == CASES.keys()
    assert len(set(pinned.values())) == len(CASES)
