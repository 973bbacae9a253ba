"""What the named scenes promise, held; and that a run which does not show it is found out."""

import json
import math
import re
import warnings
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from support.commands import mpsim_command
from support.selection import long_but

import mpsim
from mpsim.scene import scenefile
from mpsim.studies.findings import found_by
from mpsim.studies.promises import PROMISES, Finding

DEFAULT = ("galton", "growth", "hopper", "pi", "piston")
"""Scenes of a default run: the others are compilations of their own, or run longer."""

PAGE = Path(__file__).parents[3] / "docs" / "scenes.md"


@pytest.mark.slow
@pytest.mark.parametrize("name", long_but(tuple(PROMISES), *DEFAULT))
def test_a_named_scene_shows_what_it_promises(name):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", mpsim.errors.EmitterWarning)  # a box that fills lets discs wait
        found = mpsim.findings(name)
    assert found.scene == name
    assert found.consistent, str(found)
    (expected,) = re.findall(rf"(?m)^\| `{name}` \|[^|]*\| ([^|]*) \|[^|]*\|$", PAGE.read_text())
    assert expected == f"{found.numbers[0].expected:.4g}", "the page says it"
    for each in found.numbers:
        within = f" ± {each.within:.2g}" if each.within else ""
        assert f"{each.what}: {each.found:.4g} found, {each.expected:.4g}{within} expected" in str(found)


@pytest.mark.parametrize("name", ["pi", "growth", "piston"])
def test_a_run_that_ends_too_early_does_not_show_it(name):
    scene = mpsim.Scene.load(name)
    promise = PROMISES[name](scene, scene.settings)
    with mpsim.Simulation(scene) as sim, warnings.catch_warnings():
        warnings.simplefilter("ignore", mpsim.errors.EmitterWarning)
        sim.run(until=0.1 * scene.duration, observe=promise.observers)
        found = found_by(name, promise, sim)
    if name == "piston":  # whose adiabat is that of the place where the piston is
        assert found.numbers[0].expected < 1.2
    else:
        assert not found.consistent
        assert "they differ by more than 0" in str(found)


@pytest.mark.parametrize(
    ("name", "flow", "consistent"),
    [
        ("hopper", 30.0, False),
        ("hopper", 66.8, True),
        ("hopper", 145.0, False),
        ("rough-hopper", 20.0, False),
        ("rough-hopper", 39.5, True),
        ("rough-hopper", 66.8, False),
    ],
)
def test_a_flow_beyond_the_laws_of_hoppers_is_not_what_they_promise(name, flow, consistent):
    """Smooth grains pass faster than rough ones, and more slowly than a fluid without friction."""
    scene = mpsim.Scene.load(name)
    promise = PROMISES[name](scene, scene.settings)
    watched = SimpleNamespace(time=0.0, state=SimpleNamespace(image=None))
    for watched.time in np.linspace(0.0, scene.duration, 301):
        watched.state.image = np.array([[0.0, -flow * watched.time]])
        promise.look(watched, 0)
    rate, steady = promise.findings(watched)
    assert rate.found == pytest.approx(flow)
    assert steady.consistent
    assert rate.consistent is consistent, str(rate)


def test_numbers_agree_within_a_difference():
    assert Finding("x [1]", 2.0, 2.5, 0.5, "").consistent
    assert not Finding("x [1]", 2.0, 2.6, 0.5, "").consistent
    assert not Finding("x [1]", 2.0, math.nan, 0.5, "").consistent


def test_a_scene_that_promises_nothing_is_refused():
    with pytest.raises(
        mpsim.InputError, match=r"name must be one of 'brownian'.* got 'hoper'. Did you mean 'hopper'\?"
    ):
        mpsim.findings("hoper")


def test_the_command_prints_them_after_a_run_as_recommended(tmp_path):
    line = "collisions of discs and with the wall [1]: 314 found, 314 expected (digits of pi: Galperin 2003)\n"
    assert mpsim_command("run", "pi", "--quiet").stdout.endswith(line)
    assert line in mpsim_command("run", "pi", "--quiet", "--out", tmp_path / "run").stdout
    (number,) = json.loads(mpsim_command("run", "pi", "--quiet", "--json").stdout)["findings"]
    assert (number["expected"], number["found"]) == (314, 314)
    assert "expected" not in mpsim_command("run", "pi", "--quiet", "--until", 30).stdout, "not as long"
    scenefile.save(mpsim.Scene.load("pi"), tmp_path / "pi.toml")
    assert "expected" not in mpsim_command("run", tmp_path / "pi.toml", "--quiet").stdout, "of another scene"
