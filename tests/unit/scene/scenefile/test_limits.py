"""A scene of very many obstacles and emitters is saved so that its file can be read again."""

import numpy as np

import mpsim
from mpsim.scene.scenefile.limits import MOST_TABLES


def test_what_is_saved_can_be_read_however_much_it_is(tmp_path):
    rng = np.random.default_rng(1)
    pegs = [mpsim.FixedDisc(place, 0.001) for place in rng.uniform(0, 9, (MOST_TABLES + 5, 2))]
    walls = [mpsim.Polyline(rng.uniform(0, 9, (length, 2)), 0.001) for length in (2, 500, 3)]
    spouts = [mpsim.Emitter(place, (0, 1), every=3 + k) for k, place in enumerate(rng.uniform(10, 19, (100, 2)))]
    others = [mpsim.Emitter((15, 15), (1, 1e-300 * k), interval=1 + k, limit=4, mass=2) for k in range(70)]
    emitters = [*spouts, *others, mpsim.Emitter((15, 15), (1, 1), interval=1)]
    scene = mpsim.Scene(
        width=20,
        height=20,
        position=[],
        velocity=[],
        radius=0.1,
        obstacles=[*pegs, *walls, *pegs[:2]],
        emitters=emitters,
    )
    scene.save(tmp_path / "scene.toml")
    assert (tmp_path / "scene.toml").stat().st_size < 10_000
    found = mpsim.Scene.load(tmp_path / "scene.toml")
    assert (found.obstacles, found.emitters) == (scene.obstacles, scene.emitters)
    assert found.digest() == scene.digest()


def test_many_lines_are_saved_as_arrays_and_come_back(tmp_path):
    """500 circles of 61 points in the text of a scene file would be more than is read of it."""
    turn, rng = np.linspace(0, 2 * np.pi, 61), np.random.default_rng(6)
    circles = [mpsim.Polyline(20 + rng.uniform(1, 9) * np.stack([np.cos(turn), np.sin(turn)], 1)) for _ in range(500)]
    pieces = [mpsim.Polyline(rng.uniform(0, 40, (2 + k % 3, 2)), k % 2 / 8) for k in range(MOST_TABLES + 5)]
    obstacles = [*circles, mpsim.FixedDisc((1, 1), 1), *pieces]
    scene = mpsim.Scene(width=40, height=40, position=[], velocity=[], radius=0.1, obstacles=obstacles)
    scene.save(tmp_path / "scene.toml")
    assert (tmp_path / "scene.toml").stat().st_size < 1000
    found = mpsim.Scene.load(tmp_path / "scene.toml")
    assert found.obstacles == scene.obstacles
    assert found.digest() == scene.digest()
