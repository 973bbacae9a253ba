"""The pinned digests by machine code, and on any number of workers; see test_golden.py."""

import itertools
from functools import cache

import pytest
from support.goldens import KINDS, SCENES, methods, outcome, pins, renew
from support.scenes import digest_after, lattice
from support.selection import slow_but

LARGE = {
    f"{method} {law} {contact} {precision}": {"method": method, "law": law, "contact": contact, "precision": precision}
    for method, law, (contact, precision) in itertools.product(("naive", "grid"), ("elastic", "reflect"), KINDS)
} | {"event": {"method": "event"}}
"""Cases of a lattice of 480 discs without features."""

ONE_KERNEL = [
    name for name, pinned in SCENES.items()
    if pinned.features.keys() <= {"restitution", "wall_restitution", "emitters", "width"}
]  # fmt: skip
"""Scenes of which none needs an array that the bare scene lacks, so that they share its machine code."""

pytestmark = [pytest.mark.compiled, pytest.mark.timeout(700)]


@cache
def digest_of(case):
    return digest_after(lattice(24, 20), 200, dt=1 / 32, **LARGE[case])


@pytest.fixture(scope="module")
def pinned(request):
    if request.config.getoption("--renew"):
        renew({"lattice": {case: digest_of(case) for case in LARGE}})
    return pins()


@pytest.mark.parametrize("case", slow_but(LARGE, *(each for each in LARGE if "32" not in each)))
def test_the_digest_of_a_lattice_is_the_pinned_one(case, pinned):
    """In float32 by plain Python by default: another compilation."""
    assert digest_of(case) == pinned["lattice"][case], "intended? see the top of test_golden.py"


def test_each_case_has_a_digest_of_its_own(pinned):
    assert len(set(pinned["lattice"].values())) == len(LARGE)
    assert pinned["lattice"].keys() == LARGE.keys()


@pytest.mark.parametrize("precision", slow_but(["float32", "float64"], "float64"))
@pytest.mark.parametrize("name", ONE_KERNEL)
def test_workers_have_the_pinned_digests(name, precision, pinned):
    check_parallel(name, "impact", precision, 2 if name != "unguarded" else 1, pinned)


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2, 3])
@pytest.mark.parametrize("name", ["everything", "moving, everything"])
def test_any_number_of_workers_has_the_pinned_digests_with_everything(name, workers, pinned):
    for contact in ("push", "impact"):
        check_parallel(name, contact, "float64", workers, pinned)


def check_parallel(name, contact, precision, workers, pinned):
    got = outcome(name, method="parallel", workers=workers, contact=contact, precision=precision)
    expected = pinned["digests"][name][f"grid {contact} {precision}"]
    assert got == expected, f"{name}, {contact}, {precision}, {workers} workers"


@pytest.mark.long
@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", SCENES)
def test_each_feature_has_the_pinned_digests_compiled_and_on_any_number_of_workers(name, pinned):
    assert {words: outcome(name, **how) for words, how in methods().items()} == pinned["digests"][name]
    for workers, kind in itertools.product((1, 2, 3), KINDS):
        if name != "unguarded" or workers == 1:  # wrong on purpose, and different at every run
            check_parallel(name, *kind, workers, pinned)
