"""A session with every kind of change between frames, and the methods and workers that play it."""

from typing import Any

import numpy as np

import mpsim
from support.scenes import gas
from support.tiles import first_free_place

METHODS = {
    "naive": {"method": "naive"},
    "grid": {"method": "grid"},
    "parallel on 2": {"method": "parallel", "workers": 2},
    "event as a whole": {"method": "event"},
    "event on tiles": {"method": "event", "workers": 2},
}
"""Settings of each method; the last one on the tiles of `support.tiles.always_tiled`."""


def room(count: int = 60, **more: Any) -> mpsim.Scene:
    """A gas below a free strip, 6 high."""
    below = gas(count, 0.35, seed=3)
    box = {"width": below.width, "height": below.height + 6, "radius": 0.5}
    return mpsim.Scene(position=below.position, velocity=below.velocity, **box, **more)


def stage(count: int = 60) -> mpsim.Scene:
    """The same with masses, spins, gravity, losses, a piston from the right and an emitter in the strip."""
    height = room(count).height
    return room(
        count,
        mass=np.where(np.arange(count) % 3 == 0, 2.0, 0.5),
        gravity=(0.0, -0.5),
        friction=0.5,
        restitution=0.95,
        wall_restitution=0.95,
        piston=mpsim.Piston("right", speed=-0.25, stop=0.8 * room(count).width),
        emitters=mpsim.Emitter((1.0, height - 0.75), (4.0, 0.0), interval=0.3, mass=1.0, limit=4),
    )


def two_passes(sim: mpsim.Simulation) -> dict[str, Any]:
    """Parameters that give a simulation two passes, if its method has any."""
    return {} if sim.settings.method == "event" else {"passes": 2}


STEPS = {
    "kick": lambda sim: sim.kick([1, 7], (0.5, 0.25)),
    "kick each": lambda sim: sim.kick([2, 3], [(0.5, 0.25), (-0.25, 0.5)]),
    "set": lambda sim: sim.set(5, position=first_free_place(sim.state), velocity=(0.25, 0.0), spin=1.5),
    "gravity": lambda sim: sim.change(gravity=(0.25, -0.25)),
    "remove": lambda sim: sim.remove([4, 11]),
    "add": lambda sim: sim.add(first_free_place(sim.state), (0.0, 0.5), mass=1.5, spin=0.5),
    "rates": lambda sim: sim.change(interval=0.2, piston_speed=-0.5),
    "dt": lambda sim: sim.change(dt=0.0125),
    "losses": lambda sim: sim.change(restitution=0.9, wall_restitution=0.8, **two_passes(sim)),
    "remove one more": lambda sim: sim.remove(0),
    "kick again": lambda sim: sim.kick([60], (0.0, -1.0)),
}
"""Each change by name, in order; disc 60 is the first one that enters."""


def play(sim: mpsim.Simulation, names: "list[str] | None" = None, frames: int = 9) -> mpsim.Simulation:
    """Make changes with so many frames after each."""
    sim.run(frames=frames)
    for name in STEPS if names is None else names:
        STEPS[name](sim)
        sim.run(frames=frames)
    return sim
