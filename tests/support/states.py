"""Scenes and states of a few discs whose measures are known."""

import numpy as np

import mpsim
from mpsim.core.state import State
from mpsim.scene.scene import Scene
from support.scenes import simulate


def scene_of(position, velocity=None, width=20.0, height=20.0, radius=0.5, **features):
    velocity = np.zeros((len(position), 2)) if velocity is None else velocity
    return Scene(width=width, height=height, position=position, velocity=velocity, radius=radius, **features)


def state_of(scene, precision="float64"):
    return State(scene.position.astype(precision), scene.velocity.astype(precision))


def drop(count, side, seed, radius=0.5):
    """An ideal gas: centres anywhere, overlapping or not."""
    places = radius + np.random.default_rng(seed).random((count, 2)) * (side - 2 * radius)
    return scene_of(places, None, side, side, radius)


def box_of(**features):
    """Discs of radius 1/2 in a box of 10 x 8."""
    return mpsim.Scene(**{"width": 10, "height": 8, "radius": 0.5, **features})


def after(scene, until, **settings):
    with simulate(scene, **{"method": "naive", "contact": "impact", "dt": 0.01, **settings}) as sim:
        sim.run(until=until)
        return sim.state
