"""A thermostat: between two frames, random discs get new velocities (Andersen, J. Chem. Phys. 72, 2384, 1980)."""

import math

import numpy as np

from mpsim.kernels.compiling import inlined, linked, value_or
from mpsim.kernels.features.absorption import is_absent
from mpsim.kernels.random_numbers import normal_pair, pair

FIELDS = {"thermostat": "thermostat"}
"""thermostat: the record THERMOSTAT."""


@linked
def heat(thermostat, discs, low, high, features, control):
    """Give discs of a slice new velocities, in the first step of each frame except the first.

    The number of the frame follows from that of the step, so it is the same in any slice and after a resume.
    """
    frame = thermostat.first_frame + control.steps // control.substeps
    if frame > 0 and control.steps % control.substeps == 0:
        for i in range(low, high):
            disc = discs.id[i]
            chance, _ = pair(thermostat.seed, disc, frame, 0)
            if chance < thermostat.probability and not is_absent(features.exits, disc):
                speed = math.sqrt(thermostat.temperature / np.float64(value_or(features.mass, disc, 1.0)))
                x, y = normal_pair(thermostat.seed, disc, frame, 1)
                discs.vx[i], discs.vy[i] = speed * x, speed * y


@inlined
def begin_step(thermostat, discs, low, high, features, control):
    """`heat`, if there is a thermostat."""
    if thermostat is not None:
        heat(thermostat, discs, low, high, features, control)
