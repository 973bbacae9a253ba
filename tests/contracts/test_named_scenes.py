"""Every scene that comes with mpsim gives the same bits by grid and by parallel on 1, 2 and 3 workers."""

import dataclasses
import warnings

import pytest
from support.selection import long_but

import mpsim
from mpsim.scene import scenefile

FRAMES = 300

DEFAULT = ("galton",)
"""Scenes of a default run; each is a compilation of its own."""


def digest(file: scenefile.SceneFile, method: str, workers: int | None = None) -> str:
    settings = dataclasses.replace(file.settings, method=method, workers=workers)
    with warnings.catch_warnings():
        for kind in (mpsim.errors.EmitterWarning, mpsim.FastWarning):  # pi is for the exact solver
            warnings.simplefilter("ignore", kind)
        with mpsim.Simulation(file.scene, settings) as sim:
            sim.run(frames=FRAMES)
            return sim.digest()


@pytest.mark.slow
@pytest.mark.parametrize("name", long_but(scenefile.names(), *DEFAULT))
def test_a_named_scene_gives_the_same_bits_on_any_number_of_workers(name):
    file = scenefile.load(name)
    digests = {workers: digest(file, "parallel", workers) for workers in (1, 2, 3)}
    assert set(digests.values()) == {digest(file, "grid")}, digests
