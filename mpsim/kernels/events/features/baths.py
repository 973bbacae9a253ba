"""Baths: a thermostat, and walls at a temperature."""

import math

from mpsim.kernels.compiling import inlined, linked
from mpsim.kernels.events.features.edges import is_absent
from mpsim.kernels.events.features.properties import mass_of
from mpsim.kernels.events.flight import advance_to
from mpsim.kernels.random_numbers import normal_pair, pair, wall_velocity

# --- A thermostat: at the end of a frame, random discs get new velocities, the same as those of the stepped solvers


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


# --- Thermal walls: a disc leaves one with a velocity drawn from those that cross it in equilibrium
#
# As `kernels/features/thermal_walls.py`, with the numbers of discs in the store, which are the same in tiles.


@linked
def redraw(thermal_walls, i, side, leaving, store, features):
    """Draw the velocity of disc i after its impact on `side`. Returns its speed inward, its change along the wall."""
    temperatures, seed = thermal_walls
    velocity, position, axis = store.disc[i].velocity, store.disc[i].position, side >> 1
    if temperatures[side] <= 0.0:
        return leaving, 0.0
    speed = math.sqrt(temperatures[side] / mass_of(i, features))
    normal, across = wall_velocity(seed, store.event[i].number, position[1 - axis], velocity[axis], velocity[1 - axis])
    sliding = speed * across - velocity[1 - axis]
    velocity[1 - axis] = speed * across
    return speed * normal, sliding


@inlined
def speed_off_wall(thermal_walls, i, side, leaving, store, features):
    """`redraw`, if there are such walls."""
    if thermal_walls is None:
        return leaving, 0.0
    return redraw(thermal_walls, i, side, leaving, store, features)


FIELDS = ("thermostat", "thermal_walls")
"""thermal_walls: kT of each edge (LEFT, ...), 0 where it is not thermal [mass length^2/time^2], and the seed."""
