"""Rows of capsules, nearest images at periodic borders, and bounces along parabolas."""

import numpy as np

from mpsim.kernels.compiling import inlined
from mpsim.kernels.records import real

# --- A capsule, of which all obstacles are made: a segment with a radius
#
# One row of numbers, which the kernels of both solvers, random places, overlaps and pictures read alike. Whatever else
# an obstacle tells them of itself is one more number here, written by `features.obstacles.capsules_of`. What decides
# which discs an obstacle concerns is read by `concerns` alone, which all of them ask.

AX, AY, BX, BY = range(4)  # both ends, which are one place for a disc [length]
RADIUS = 4  # around the segment; below 0 of a container: a circle that is solid outside [length]
SURFACE = 5  # speed at which its surface runs along itself, as in `surface_speed` [length/time]
POLYGON = 6  # number of the polygon of which it is a side: > 0 if that is solid inside, < 0 outside; 0 of none
OWNER = 7  # number of its obstacle in the scene
ROW = 8  # numbers in a row

ENDS = slice(AX, RADIUS)


@inlined
def concerns(capsule, k, radius):
    """Whether a disc of this radius meets capsule k; k is `...` for arrays of discs, and of capsules (..., ROW)."""
    return True


# --- Nearest images of a disc at a periodic border, for exact impacts and for placement


@inlined
def nearest_image(difference, length, periodic):
    """One component of the relative position of the nearest image."""
    if periodic and difference > 0.5 * length:
        return difference - length
    if periodic and difference < -0.5 * length:
        return difference + length
    return difference


# --- The bounce of an accelerated disc off a wall at rest under contact `impact`: along its parabola, exact
#
# The report's v += a dt, p += v dt, with a bounce where the frame ended, loses or gains energy at each bounce. Here a
# disc that ends a step beyond a wall is taken back along its parabola to the instant of contact, reflected there, and
# then continues. With depth d beyond the wall, speed s outward now and acceleration A outward:
#
#     speed at the wall   c = sqrt(s^2 - 2 A d)             energy
#     time since then     t = 2 d / (s + c)                 mean speed (s + c) / 2 over the distance d
#     now                 e c t - A t^2 / 2 inside, moving inward at e c - A t


@inlined
def bounce_back(depth, speed, acceleration, parameters):
    """(distance inside, speed inward, time since contact) of a disc `depth` beyond a wall; speed, acceleration outward.

    A disc that moves inward, and was not carried out by its flight, is projected onto the wall, losing the
    corresponding kinetic energy. For a disc that comes to rest on the wall, which acts on it from then on, the time is
    the mean over the impulses of the wall.
    """
    zero, two = real(parameters, 0), real(parameters, 2)
    at_wall = np.sqrt(max(speed * speed - two * acceleration * depth, zero))
    if speed + at_wall <= zero:
        return zero, at_wall, zero
    time = min(two * depth / (speed + at_wall), parameters.dt + (depth - depth))  # in the type of depth, uncompiled too
    inward = parameters.wall_restitution * at_wall
    inside = (inward - acceleration * time / two) * time
    inward -= acceleration * time
    if inside < zero:  # it no longer leaves the wall: it rests there
        return zero, max(inward, zero), depth / speed
    return inside, inward, time
