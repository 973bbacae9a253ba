"""The scenes that come with mpsim: each is readable, complete, and does what its text says."""

import math
import tomllib

import numpy as np
import pytest
from support.selection import long_but

import mpsim
from mpsim.measure.run_averages import refusal
from mpsim.scene import scenefile
from mpsim.scene.scenefile.reading import PACKAGED
from mpsim.studies import benchmark

NAMES = (
    "brownian",
    "channel",
    "cooling",
    "cradle",
    "dense",
    "galton",
    "gas",
    "growth",
    "hopper",
    "mixture",
    "pi",
    "piston",
    "rough-hopper",
    "rough-sediment",
    "sediment",
)


def started(name: str) -> tuple[mpsim.Simulation, mpsim.Scene]:
    """A named scene under its recommended settings."""
    file = scenefile.load(name)
    return mpsim.Simulation(file.scene, file.settings), file.scene


def kinetic_energies(state: mpsim.State, masses) -> np.ndarray:
    return masses * (state.velocity**2).sum(axis=1) / 2


def test_these_are_the_scenes():
    assert scenefile.names() == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_a_named_scene_is_complete(name):
    file = scenefile.load(name)
    assert file.settings is not None
    assert file.scene.duration is not None
    assert file.scene.picture_interval is not None
    assert file.scene.measures
    assert [refusal(each, file.scene) for each in file.scene.measures] == [None] * len(file.scene.measures)
    assert 100 <= file.scene.duration / file.scene.picture_interval <= 500
    assert file.scene.count or file.scene.emitters
    assert 10 <= len(file.title) <= 60
    assert file.text.endswith(".")
    assert file.look_for.endswith(".")
    assert file.read == (PACKAGED / f"{name}.toml",)


@pytest.mark.parametrize("name", NAMES)
def test_the_file_of_a_named_scene_is_small_and_begins_with_what_it_is(name):
    text = (PACKAGED / f"{name}.toml").read_text()
    assert text.startswith("# ")
    assert len(text.splitlines()) < 70
    assert max(map(len, text.splitlines())) <= 120
    assert "settings" in tomllib.loads(text)


@pytest.mark.parametrize("name", NAMES)
def test_no_discs_overlap_at_the_start(name):
    """Neither each other nor an obstacle."""
    assert mpsim.Scene.load(name).overlaps_at_start() == ""


def test_gas_is_the_scene_of_the_benchmarks():
    assert mpsim.Scene.load("gas").digest() == benchmark.gas(100).digest()


def passed_by(name: str, begin: float, end: float) -> int:
    """Grains that pass the gap of a hopper between two times: each comes back at the top, through the border."""
    file = scenefile.load(name)
    with mpsim.Simulation(file.scene, file.settings) as sim:
        sim.run(frames=round(begin / file.settings.dt))
        before = sim.state.image[:, 1].sum()
        sim.run(frames=round((end - begin) / file.settings.dt))
        return int(before - sim.state.image[:, 1].sum())


@pytest.mark.long
def test_rough_grains_pass_a_gap_more_slowly():
    rough, smooth = passed_by("rough-hopper", 2, 7), passed_by("hopper", 2, 7)
    assert 150 < rough < 250
    assert 280 < smooth < 400, "the control"


@pytest.mark.long
@pytest.mark.parametrize("friction", [0.5, 0.0])
def test_rough_grains_stand_higher_against_a_wall(friction, tmp_path):
    text = (PACKAGED / "rough-sediment.toml").read_text()
    assert text.count("friction = 0.5") == 2
    (tmp_path / "scene.toml").write_text(text.replace("friction = 0.5", f"friction = {friction}"))
    file = scenefile.load(tmp_path / "scene.toml")
    with mpsim.Simulation(file.scene, file.settings) as sim:
        sim.run(frames=round(16 / file.settings.dt))
        x, y = sim.state.position.T
    height = y[x < 2].max()
    assert (height > 9.2) if friction else (height < 8.8), height


def test_the_cradle_hands_one_push_through_the_row():
    sim, _ = started("cradle")
    with sim:
        for _ in range(40):
            sim.run(frames=97)
            speeds = np.sort(np.abs(sim.state.velocity[:, 0]))
            # While the push runs through the row, in 0.06 of the time, a frame may show it between two discs.
            np.testing.assert_allclose(speeds, [0, 0, 0, 0, 1], atol=1e-9)


@pytest.mark.parametrize("method", long_but(["grid", "event"], "event"))
def test_pi_counts_314_collisions(method):
    """At a step short enough for the grid there are 420,000 frames."""
    scene = mpsim.Scene.load("pi")
    settings = scene.settings if method == "event" else mpsim.Settings(dt=0.0001, method=method)
    with mpsim.Simulation(scene, settings) as sim:
        report = sim.run(until=scene.duration)
        state = sim.state
    assert report.collisions == 157  # with each other; the others are with the wall:
    # every one of them but the last turns the light disc back to the heavy one, and after the last it is too slow
    light, heavy = state.velocity[:, 0]
    assert heavy > light > 0
    assert (scene.masses * state.velocity[:, 0] ** 2).sum() == pytest.approx(1e4, rel=1e-9)


@pytest.mark.slow
def test_the_mixture_shares_its_energy_out():
    sim, scene = started("mixture")
    large, means = scene.radii > 0.75, []
    with sim:
        sim.run(frames=2000)
        for _ in range(40):
            sim.run(frames=100)
            means.append([kinetic_energies(sim.state, scene.masses)[kind].mean() for kind in (large, ~large)])
    np.testing.assert_allclose(np.mean(means, axis=0), 1.6, rtol=0.1)


@pytest.mark.long  # its features are a compilation of their own, half a minute
def test_sediment_comes_to_rest():
    sim, scene = started("sediment")
    with sim:
        sim.run(frames=3000)
        before = sim.state.position
        report = sim.run(frames=200, measures=["largest_overlap"])
        state = sim.state
    assert np.abs(state.position - before).max() < 0.1
    assert report.measures["largest_overlap"].value < 0.05 * 2 * scene.largest_radius
    assert state.position[:, 1].max() < 11


def test_brownian_motion_wanders():
    sim, scene = started("brownian")
    with sim:
        sim.run(frames=4000)
        state = sim.state
    assert 0.01 < math.dist(state.position[0], scene.position[0]) < 10
    assert kinetic_energies(state, scene.masses).sum() == pytest.approx(1500, rel=1e-9)


@pytest.mark.long  # its features are a compilation of their own, half a minute
def test_the_stream_gains_speed_and_leaves_a_wake():
    sim, scene = started("channel")
    bow = wake = 0
    with sim:
        sim.run(frames=1000)
        for _ in range(20):
            sim.run(frames=100)
            x, y = sim.state.position.T
            before, behind = ((np.abs(x - 15 - side) < 1.5) & (np.abs(y - 7) < 1.5) for side in (-4, 4))
            bow, wake = bow + before.sum(), wake + behind.sum()
        state = sim.state
    assert bow > 2 * wake, (bow, wake)
    assert state.velocity[:, 0].mean() > 1
    assert scene.boundary == ("periodic", "walls")
