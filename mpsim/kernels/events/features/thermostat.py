"""A thermostat: at the end of a frame, random discs get new velocities, the same as those of the stepped solvers."""

import math

from mpsim.kernels.compiling import linked
from mpsim.kernels.events.features.absorption import is_absent
from mpsim.kernels.events.features.properties import mass_of
from mpsim.kernels.events.flight import advance_to
from mpsim.kernels.random_numbers import normal_pair, pair

FIELDS = {"thermostat": None}
"""thermostat: probability, temperature [mass length^2/time^2], seed, and the frame from which frames are counted."""


@linked
def is_heated(thermostat, i, particle, frame, features):
    """Whether disc i, a particle of the scene, gets a new velocity after so many frames."""
    probability, _, seed, first_frame = thermostat
    chance, _ = pair(seed, particle, first_frame + frame, 0)
    return chance < probability and not is_absent(features.exits, i)


@linked
def heat(thermostat, i, particle, now, frame, store, features):
    """Give disc i a new velocity at the time `now`, after so many frames, if it is due."""
    if is_heated(thermostat, i, particle, frame, features):
        _, temperature, seed, first_frame = thermostat
        disc = store.disc[i]
        advance_to(disc, now, features.gravity)
        speed = math.sqrt(temperature / mass_of(i, features))
        x, y = normal_pair(seed, particle, first_frame + frame, 1)
        disc.velocity[0], disc.velocity[1] = speed * x, speed * y
        store.event[i].collision_count += 1
