"""Pinned digests: the same bits as when they were written, on every machine with IEEE arithmetic.

The scenes are built by integer arithmetic and a frame uses + - * / and square roots only, so neither the mathematical
library nor the random numbers of NumPy can change a digest. Only an intended change of the dynamics may; then renew:

    python -m pytest -n 0 tests/contracts/test_golden.py tests/contracts/test_golden_compiled.py --renew

and say in the changelog that runs of the new version do not continue those of the old one.

Every feature alone runs as plain Python here, where an index out of bounds is an error; test_golden_compiled.py has the
same digests by machine code. Each set of features is a compilation of its own, some seconds.
"""

import dataclasses
import inspect
import json

import numba
import pytest
from support.goldens import FRAMES, KINDS, SCENES, few, methods, pins, renew, report
from support.processes import run_script

import mpsim
from mpsim.scene.settings import NAMES

WITHOUT_MEANING = {
    "event": {"passes", "sub-steps", "sub-steps where fast"},  # it has no steps, and every frame may be cut anywhere
    "naive": {"unguarded"},  # it has no columns
}
"""Settings that change no bit of a method. A longer dt is the same scene at another time, and differs."""

pytestmark = [pytest.mark.plain, pytest.mark.timeout(700)]  # minutes with --renew on a busy machine


@pytest.fixture(scope="module")
def found(request):
    """What each scene comes to today in plain Python."""
    whole = request.config.getoption("--long") or request.config.getoption("--renew")
    if numba.config.DISABLE_JIT:
        return report((lambda name: methods()) if whole else few)
    script = f"import sys; from support import goldens; sys.argv += {[] if whole else ['--few']}; goldens.main()"
    ran = run_script(script, env={"NUMBA_DISABLE_JIT": "1"}, flags=(), bound=600)
    assert ran.code == 0, ran.err
    return json.loads(ran.out)


@pytest.fixture(scope="module")
def pinned(request):
    """What is in the file; with --renew it is written first."""
    if request.config.getoption("--renew"):
        renew(request.getfixturevalue("found"))
    return pins()


@pytest.mark.parametrize("name", SCENES)
def test_every_method_has_the_pinned_digest_of_each_feature(name, found, pinned):
    got = found["digests"][name]
    assert got.keys() >= few(name).keys()
    assert got == {words: pinned["digests"][name][words] for words in got}, "intended? see the top of this file"


def test_measures_are_the_pinned_ones_and_change_no_bit(found, pinned):
    assert found["measures"] == pinned["measures"], "intended? see the top of this file"
    for case, measured in found["measures"].items():
        name, _, method = case.rpartition(" by ")
        words = "event" if method == "event" else f"{method} impact float64"
        assert measured["outcome"] == pinned["digests"][name][words], f"{case}: a measure has changed the run"


# --- what makes this a test


def test_each_feature_acts(found, pinned):
    """Its digest is not that of the bare scene, and what it is for has happened."""
    assert found["idle"] == []
    bare = pinned["digests"]["bare"]
    for name, outcomes in pinned["digests"].items():
        for words, text in outcomes.items():
            without = name == "bare" or name in WITHOUT_MEANING.get(words.split()[0], ())
            assert text != bare[words] or without, f"{name} by {words} is the bare scene"
        digests = {text.split()[0] for text in outcomes.values()}
        assert len(digests) >= len(KINDS), f"{name}: a precision, a contact, a method make no difference: {outcomes}"


def test_every_feature_of_a_scene_and_every_setting_is_pinned():
    """Whatever a scene or its settings may have that changes a bit is in one of the scenes."""
    features = {name for pinned in SCENES.values() for name in pinned.features}
    assert inspect.signature(mpsim.Scene).parameters.keys() - features == {"height", "position", "velocity", *NAMES}
    settings = {name for pinned in SCENES.values() for name in pinned.settings} | {"method", "contact", "precision"}
    names = {field.name for field in dataclasses.fields(mpsim.Settings)}
    assert names - settings == {"workers"}, "which changes no bit"
    assert features - SCENES["everything rough"].features.keys() == {"width", "thermostat", "thermal_walls"}


def test_no_pin_is_left_over_none_is_missing_and_each_kind_has_its_share(pinned):
    assert pinned.keys() == {"lattice", "digests", "measures", "idle"}
    assert pinned["digests"].keys() == SCENES.keys()
    assert all(outcomes.keys() == methods().keys() for outcomes in pinned["digests"].values())
    runs = [words for name in SCENES for words in few(name)]
    assert min(runs.count(words) for words in methods(["grid"])) >= len(SCENES) // 4
    assert min(runs.count(words) for words in methods(["naive"])) >= 1
    assert FRAMES >= 20
