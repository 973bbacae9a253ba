"""Pinned digests: the same bits as when they were written, on every machine with IEEE arithmetic.

The scenes are built by integer arithmetic and a frame uses + - * / and square roots only, so neither the mathematical
library nor the random numbers of NumPy can change a digest. Only an intended change of the dynamics may; then renew:

    python -m pytest tests/contracts/test_golden.py --renew

and say in the changelog that runs of the new version do not continue those of the old one.

Every feature alone runs as plain Python here, which has the bits of the machine code (test_without_compilation): each
set of features is a compilation of its own, some seconds: by `event`, `naive` and `grid`, in contacts and precisions
that change from one to the next, by all with --long or --renew. Compiled, and on one, two and three workers, run those
that share a kernel; with --long all.
"""

import dataclasses
import inspect
import itertools
import json
from pathlib import Path

import numpy as np
import pytest
from support.goldens import FRAMES, KINDS, SCENES, Pinned, few, methods, outcome
from support.processes import run_script
from support.scenes import digest_after, lattice

import mpsim
from mpsim.scene.recommended import NAMES

FILE = Path(__file__).parent / "golden.json"

LARGE = {
    f"{method} {law} {contact} {precision}": {"method": method, "law": law, "contact": contact, "precision": precision}
    for method, law, (contact, precision) in itertools.product(("naive", "grid"), ("elastic", "reflect"), KINDS)
} | {"event": {"method": "event"}}
"""Cases of a lattice of 480 discs without features, compiled."""

ONE_KERNEL = [
    name for name, pinned in SCENES.items()
    if pinned.features.keys() <= {"restitution", "wall_restitution", "emitters", "width"}
]  # fmt: skip
"""Scenes of which none needs an array that the bare scene lacks, so that they share its machine code."""

WITHOUT_MEANING = {
    "event": {"passes", "sub-steps", "sub-steps where fast"},  # it has no steps, and every frame may be cut anywhere
    "naive": {"unguarded"},  # it has no columns
}
"""Settings that change no bit of a method. A longer dt is the same scene at another time, and differs."""


pytestmark = pytest.mark.timeout(700)  # ten seconds of plain Python before the first test, minutes on a busy machine


@pytest.fixture(scope="module")
def found(request):
    """What each scene comes to today in plain Python, and the large lattice compiled."""
    whole = request.config.getoption("--long") or request.config.getoption("--renew")
    script = f"import sys; from support import goldens; sys.argv += {[] if whole else ['--few']}; goldens.main()"
    ran = run_script(script, env={"NUMBA_DISABLE_JIT": "1"}, flags=(), bound=600)
    assert ran.code == 0, ran.err
    large = {case: digest_after(lattice(24, 20), 200, dt=1 / 32, **LARGE[case]) for case in LARGE}
    return {"lattice": large, **json.loads(ran.out)}


@pytest.fixture(scope="module")
def pinned(request):
    """What is in the file; with --renew it is written first."""
    if request.config.getoption("--renew"):
        FILE.write_text(json.dumps(request.getfixturevalue("found"), indent=2) + "\n")
    return json.loads(FILE.read_text())


@pytest.mark.parametrize("case", LARGE)
def test_the_digest_of_a_lattice_is_the_pinned_one(case, found, pinned):
    assert found["lattice"][case] == pinned["lattice"][case], "intended? see the top of this file"


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


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2, 3])
def test_any_number_of_workers_has_the_pinned_digests(workers, pinned):
    """Each scene that shares the bare scene's kernel in one way, the kernel with everything in both contacts."""
    kinds = [(name, KINDS[index % 4]) for index, name in enumerate(ONE_KERNEL)] if workers == 2 else []
    kinds += [("everything", (contact, "float64")) for contact in ("push", "impact")]
    check_parallel(kinds, workers, pinned)


def check_parallel(kinds, workers, pinned):
    for name, (contact, precision) in kinds:
        if name == "unguarded" and workers > 1:  # wrong on purpose, and different at every run
            continue
        got = outcome(name, method="parallel", workers=workers, contact=contact, precision=precision)
        expected = pinned["digests"][name][f"grid {contact} {precision}"]
        assert got == expected, f"{name}, {contact}, {precision}, {workers} workers"


@pytest.mark.long
@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", SCENES)
def test_each_feature_has_the_pinned_digests_compiled_and_on_any_number_of_workers(name, pinned):
    assert {words: outcome(name, **how) for words, how in methods().items()} == pinned["digests"][name]
    for workers in (1, 2, 3):
        check_parallel([(name, kind) for kind in KINDS], workers, pinned)


# --- what makes this a test


def test_every_method_contact_and_precision_has_its_share_of_the_features():
    """In the default suite."""
    runs = [words for name in SCENES for words in few(name)]
    assert min(runs.count(words) for words in methods()) >= len(SCENES) // 4


def test_each_feature_acts(found, pinned):
    """Its digest is not that of the bare scene, and what it is for has happened."""
    assert found["idle"] == []
    bare = pinned["digests"]["bare"]
    for name, outcomes in pinned["digests"].items():
        for words, text in outcomes.items():
            without = name == "bare" or name in WITHOUT_MEANING.get(words.split()[0], ())
            assert text != bare[words] or without, f"{name} by {words} is the bare scene"


def test_a_precision_a_contact_and_a_method_each_have_their_own_digests(found, pinned):
    assert len(set(found["lattice"].values())) == len(LARGE)
    for name, outcomes in pinned["digests"].items():
        digests = {text.split()[0] for text in outcomes.values()}
        assert len(digests) >= len(KINDS), f"{name}: {outcomes}"


def test_one_bit_of_one_velocity_changes_the_digest(pinned):
    """The control: the last bit of one velocity, and of a restitution."""
    velocity = SCENES["bare"].scene().velocity.copy()
    fastest = np.unravel_index(np.abs(velocity).argmax(), velocity.shape)
    velocity[fastest] = np.nextafter(velocity[fastest], 0)
    text = str(Pinned({"velocity": velocity}).run(method="grid", contact="impact", precision="float64"))
    assert text.split(maxsplit=1)[0] != pinned["digests"]["bare"]["grid impact float64"].split()[0]
    restitution = SCENES["restitution"].features["restitution"] + np.finfo(float).eps
    text = str(Pinned({"restitution": restitution}).run(method="grid", contact="impact", precision="float64"))
    assert text.split()[0] != pinned["digests"]["restitution"]["grid impact float64"].split()[0]


def test_every_feature_of_a_scene_and_every_setting_is_pinned():
    """Whatever a scene or its settings may have that changes a bit is in one of the scenes."""
    features = {name for pinned in SCENES.values() for name in pinned.features}
    assert inspect.signature(mpsim.Scene).parameters.keys() - features == {"height", "position", "velocity", *NAMES}
    settings = {name for pinned in SCENES.values() for name in pinned.settings} | {"method", "contact", "precision"}
    names = {field.name for field in dataclasses.fields(mpsim.Settings)}
    assert names - settings == {"workers"}, "which changes no bit"
    everything = SCENES["everything rough"].features
    assert features - everything.keys() == {"width", "thermostat", "thermal_walls"}


def test_no_pin_is_left_over_and_none_is_missing(pinned):
    assert pinned.keys() == {"lattice", "digests", "measures", "idle"}
    assert pinned["lattice"].keys() == LARGE.keys()
    assert pinned["digests"].keys() == SCENES.keys()
    assert all(outcomes.keys() == methods().keys() for outcomes in pinned["digests"].values())
    assert FRAMES >= 20
