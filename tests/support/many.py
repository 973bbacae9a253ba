"""Scenes of very many obstacles or emitters."""

import numpy as np

import mpsim


def lattice(count, spacing=3.0):
    """Places on a square lattice, and the side of the box that it fills."""
    side = int(np.ceil(np.sqrt(count)))
    return spacing * (np.stack(np.divmod(np.arange(count), side), axis=1) + 0.5), spacing * side


def pegs(count):
    """As many pegs as discs, none of which touch."""
    places, side = lattice(count)
    made = tuple(mpsim.FixedDisc(place, 0.5) for place in places)
    return {"width": side, "height": side, "position": places + 1, "obstacles": made, "radius": 0.4}


def chain(count):
    """One wall of many short pieces, and as many discs beside it."""
    places, side = lattice(count)
    corners = np.stack([np.linspace(0, side, count + 1), np.full(count + 1, side)], axis=1)
    return {"width": side, "height": side, "position": places, "obstacles": mpsim.Polyline(corners), "radius": 0.4}


def emitters(count):
    places, side = lattice(count)
    made = tuple(mpsim.Emitter(place, (1, 0), interval=10) for place in places)  # of the common radius
    return {"width": side, "height": side, "position": places + 1, "emitters": made, "radius": 0.4}


def simulated(arguments):
    scene = mpsim.Scene(**arguments, velocity=np.zeros_like(arguments["position"]))
    return mpsim.Simulation(scene, mpsim.Settings(method="grid"))


def pegs_and_emitters(obstacles, emitters, velocity=(10.0, 0.0)):
    """Discs that enter in the first frame, each in the middle between four pegs, or in flight to one of them."""
    places, side = lattice(obstacles, 1.0)
    middles = (places[(places < side - 1).all(axis=1)] + 0.5)[:emitters]
    spouts = tuple(mpsim.Emitter(place, velocity, interval=0.006, limit=1) for place in middles)
    box = {"width": side, "height": side, "position": np.zeros((0, 2)), "radius": 0.1}
    return {**box, "obstacles": [mpsim.FixedDisc(place, 0.05) for place in places], "emitters": spouts}
