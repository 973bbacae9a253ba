"""Baths: a thermostat, and walls at a temperature."""

import math

import numpy as np

from mpsim.kernels.compiling import inlined, linked, value_or
from mpsim.kernels.features.collisions import BATH, add_heat
from mpsim.kernels.features.edges import WallContact, is_absent, put_inside, wrap_disc
from mpsim.kernels.features.properties import accelerations_of
from mpsim.kernels.random_numbers import normal_pair, pair, wall_velocity
from mpsim.kernels.records import BOTTOM, IMPACT, LEFT, RIGHT, TOP, real

# --- A thermostat: between two frames, random discs get new velocities (Andersen, J. Chem. Phys. 72, 2384, 1980)


@linked
def heat(thermostat, discs, low, high, features, control):
    """Give discs of a slice new velocities, in the first step of each frame except the first.

    The number of the frame follows from that of the step, so it is the same in any slice and after a resume.
    """
    if thermostat is None:
        return
    frame = thermostat.first_frame + control.steps // control.substeps
    if frame > 0 and control.steps % control.substeps == 0:
        for i in range(low, high):
            disc = discs.id[i]
            chance, _ = pair(thermostat.seed, disc, frame, 0)
            if chance < thermostat.probability and not is_absent(features.exits, disc):
                speed = math.sqrt(thermostat.temperature / np.float64(value_or(features.mass, disc, 1.0)))
                x, y = normal_pair(thermostat.seed, disc, frame, 1)
                before = discs.vx[i], discs.vy[i]
                discs.vx[i], discs.vy[i] = speed * x, speed * y
                add_heat(features.work, BATH, disc, before, (discs.vx[i], discs.vy[i]), features.mass)


# --- Thermal walls: a disc leaves one with a velocity drawn from the distribution of those that cross it in
#     equilibrium
#
# For discs at temperature T that cross a line, the speed normal to it has the density v exp(-m v^2 / 2T), as fast ones
# cross more often; the tangential velocity is Gaussian. The wall has already reflected the disc in this step; here the
# velocity at that instant is drawn anew, and the rest of the step follows from it. The random numbers follow from the
# seed, the disc, its place and the velocity at which it arrived, so a disc may meet walls more than once in a step.


@linked
def redraw(thermal_walls, discs, i, edge, inward, met, other, features, parameters, control):
    """Draw the velocity of disc i at its contact with an edge. Returns `met` and `other` after that.

    inward: 1 at a low wall, -1 at a high one. met, other: its `WallContact` along the normal of the wall, and across.
    """
    one, two = real(parameters, 1), real(parameters, 2)
    ax, ay = accelerations_of(discs, i, features)
    across, along = (ax, ay) if edge <= RIGHT else (ay, ax)
    time = min(met.time, parameters.dt) if control.contact == IMPACT else real(parameters, 0)
    change = met.low_change if inward > 0 else met.high_change
    came, slid = met.velocity - across * time - inward * change, other.velocity - along * time
    speed = math.sqrt(thermal_walls.temperature[edge] / np.float64(value_or(features.mass, discs.id[i], one)))
    normal, tangential = wall_velocity(thermal_walls.seed, discs.id[i], other.position, came, slid)
    leaves, slides = inward * real(parameters, speed * normal), real(parameters, speed * tangential)
    add_heat(features.work, edge, discs.id[i], (came, slid), (leaves, slides), features.mass)
    place = parameters.limit[edge] + inward * value_or(discs.radius, i, real(parameters, 0))
    change = inward * (leaves - came)
    zero = real(parameters, 0)
    low_change, high_change = (change, zero) if inward > 0 else (zero, change)
    position = place + leaves * time + across * time * time / two
    shifted = other.position + (slides - slid) * time
    return (
        WallContact(position, leaves + across * time, low_change, high_change, met.time, slides - slid),
        WallContact(shifted, slides + along * time, other.low_change, other.high_change, other.time, other.sliding),
    )


@linked
def leave_walls(thermal_walls, discs, i, x, y, in_flight, features, parameters, control):
    """Draw the velocity of disc i for each wall that has reflected it, and write it back. Returns x and y then."""
    temperature, zero, one = thermal_walls.temperature, real(parameters, 0), real(parameters, 1)
    if x.low_change != zero and temperature[LEFT] > 0:
        x, y = redraw(thermal_walls, discs, i, LEFT, one, x, y, features, parameters, control)
    if x.high_change != zero and temperature[RIGHT] > 0:
        x, y = redraw(thermal_walls, discs, i, RIGHT, -one, x, y, features, parameters, control)
    if y.low_change != zero and temperature[BOTTOM] > 0:
        y, x = redraw(thermal_walls, discs, i, BOTTOM, one, y, x, features, parameters, control)
    if y.high_change != zero and temperature[TOP] > 0:
        y, x = redraw(thermal_walls, discs, i, TOP, -one, y, x, features, parameters, control)
    discs.vx[i], discs.vy[i] = x.velocity, y.velocity
    put_inside(discs, i, x.position, y.position, features, parameters)
    if in_flight is not None:
        wrap_disc(discs, i, features)
    return x, y


@inlined
def redraw_at_walls(thermal_walls, discs, i, x, y, in_flight, features, parameters, control):
    """`leave_walls`, if there are such walls and disc i has hit one. Returns its contacts along x and y then."""
    if thermal_walls is None:
        return x, y
    if (x.low_change == x.high_change) & (y.low_change == y.high_change):
        return x, y
    return leave_walls(thermal_walls, discs, i, x, y, in_flight, features, parameters, control)
