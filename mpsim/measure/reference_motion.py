"""Closed forms for motion: single discs, discs in line, cooling and relaxing gases, errors of stepped methods.

Each with its source. Discs are equal, of mass 1; kT is the mean square of one velocity component [length^2/time^2].
Equilibrium is in `reference`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mpsim.core import checks
from mpsim.errors import InputError

EQUAL_SPEEDS_EXCESS = -0.5
"""Kurtosis excess a_2 = <v^4>/(2 <v^2>^2) - 1 of discs of equal speeds [1]: <v^4> = <v^2>^2."""

EQUAL_SPEEDS_SLOPE = 32 / 225
"""First growth of a_2 per collision of each disc, from equal speeds, dilute [1]: one collision at angle theta between
the velocities adds 2 v^4 sin^2(theta) sin^2(2 alpha) to the sum of v^4, alpha being the angle of impact; both factors
average 8/15 over collisions, and there is half a collision per disc and unit (Boltzmann's equation, first order)."""


EQUAL_SPEEDS_AFTER_ONE = -0.368
"""a_2 from equal speeds after one collision per disc, dilute [1], by simulation, to 0.001."""

PI_DIGITS = 314159265358979323846264338327950288
"""pi times 10^35, rounded down."""


def line_gas(
    position: ArrayLike, velocity: ArrayLike, time: float, length: float, radius: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Positions and velocities, at any later time, of discs that move along one line between two walls.

    Equal discs exchange velocities, so without their diameters they move like free points on a line of length
    length - N sigma: the k-th disc from the left is always at the k-th of these points, plus sigma (k - 1/2).

    Args:
        position: shape (N,), N >= 1, at the start, in any order, without overlap [length].
        velocity: shape (N,) [length/time].
        time: >= 0 [time].
        length: between the walls, >= 2 radius N [length].
        radius: > 0 [length].

    Returns:
        Positions [length] and velocities [length/time], shape (N,) each, in the order given. Exact to rounding of
        velocity x time.

    Raises:
        InputError: naming the argument and its rule; if discs overlap each other or a wall.

    Source: Jepsen, J. Math. Phys. 6, 405 (1965); finite diameter and walls: Tonks, Phys. Rev. 50, 955 (1936).

    >>> places, velocities = line_gas([1.0, 3.0], [1.0, 0.0], time=2.5, length=5.0, radius=0.5)
    >>> places.tolist(), velocities.tolist()
    ([2.0, 4.5], [0.0, 1.0])
    """
    places = checks.finite_array("position", position, (None,), "(N,)")
    velocities = checks.finite_array("velocity", velocity, (len(places),), f"({len(places)},), one per position")
    time = checks.non_negative("time", time, "[time]")
    length, radius = checks.positive("length", length, "[length]"), checks.positive("radius", radius, "[length]")
    order = np.argsort(places, kind="stable")
    shifts = 2 * radius * (np.arange(len(places)) + 0.5)
    free = length - 2 * radius * len(places)
    points = places[order] - shifts
    rounding = 8 * np.finfo(np.float64).eps * length
    gaps = np.diff(points, prepend=0.0, append=free)
    least = float(gaps.min()) if len(places) else math.nan
    if not least >= -rounding:
        raise InputError(
            f"position must hold one disc or more, without overlap among them and with the walls at 0 and {length:g}; "
            f"got {len(places)} discs of radius {radius:g}, least gap {least:g}. Move them apart."
        )
    unfolded = points + velocities[order] * time
    period = 2 * free
    folded = np.mod(unfolded, period) if free > 0 else np.zeros_like(unfolded)
    returning = folded > free
    points = np.where(returning, period - folded, folded)
    moving = np.where(returning, -velocities[order], velocities[order])
    rank = np.argsort(points, kind="stable")
    found, speeds = np.empty_like(places), np.empty_like(places)
    found[order], speeds[order] = points[rank] + shifts, moving[rank]
    return found, speeds


def line_gas_force(energy: float, count: int, length: float, radius: float) -> float:
    """Mean force on either end wall of the gas on a line, 2 E / (length - N sigma) [length/time^2].

    Args:
        energy: kinetic, of all discs, >= 0 [length^2/time^2].
        count: N >= 1.
        length: between the walls, > 2 radius N [length].
        radius: > 0 [length].

    Raises:
        InputError: naming the argument and its rule.

    Source: each free point brings the momentum 2 |v| every 2 (length - N sigma)/|v|; Tonks, Phys. Rev. 50, 955 (1936).

    >>> line_gas_force(energy=0.5, count=2, length=5.0, radius=0.5)
    0.3333333333333333
    """
    energy = checks.non_negative("energy", energy, "[length^2/time^2]")
    count = checks.whole("count", count, 1, 10**9, "Count the discs.")
    length, radius = checks.positive("length", length, "[length]"), checks.positive("radius", radius, "[length]")
    free = length - 2 * radius * count
    if free <= 0:
        raise InputError(
            f"length must be more than that of {count} discs in line, {2 * radius * count:g}; got {length!r}. "
            "Use fewer discs or a longer line."
        )
    return 2 * energy / free


def galperin_collisions(power: int) -> int:
    """Collisions of a heavy disc of mass 100^power, a light one of mass 1 at rest, and a wall: digits of pi.

    The heavy disc comes from afar, drives the light one against the wall, and leaves. Collisions of the two discs and
    of the light one with the wall are counted together: floor(pi 10^power).

    Args:
        power: 0 to 35.

    Raises:
        InputError: if power is not a whole number in this range.

    Source: Galperin, Regul. Chaotic Dyn. 8, 375 (2003).

    >>> [galperin_collisions(power) for power in range(5)]
    [3, 31, 314, 3141, 31415]
    """
    power = checks.whole("power", power, 0, 35, "More digits of pi than this are not stored.")
    return PI_DIGITS // 10 ** (35 - power)


def end_of_bouncing(height: float, gravity: float, restitution: float) -> float:
    """Time at which a disc dropped at rest has made all its bounces, sqrt(2 h/g) (1 + e)/(1 - e) [time].

    Args:
        height: h, of its lowest point above the floor, >= 0 [length].
        gravity: g, magnitude, > 0 [length/time^2].
        restitution: e, 0 <= e < 1 [1].

    Raises:
        InputError: naming the argument and its rule.

    Source: geometric series of flights 2 e^k sqrt(2 h/g), k = 1, 2, ..., after the first fall [D].

    >>> end_of_bouncing(height=5.0, gravity=10.0, restitution=0.5)
    3.0
    """
    height = checks.non_negative("height", height, "[length]")
    gravity = checks.positive("gravity", gravity, "[length/time^2]")
    restitution = _restitution(restitution)
    if restitution == 1:
        raise InputError("restitution must be below 1 for the bouncing to end; got 1. Give a smaller one.")
    return math.sqrt(2 * height / gravity) * (1 + restitution) / (1 - restitution)


def haff_by_collisions(collisions: float, restitution: float) -> float:
    """Temperature of a cooling granular gas over that at the start, exp(-(1 - e^2) tau / 2) [1].

    Args:
        collisions: tau, collisions per disc so far (a collision counts for both), >= 0 [1].
        restitution: e, 0 <= e <= 1 [1].

    Raises:
        InputError: naming the argument and its rule.

    Source: a collision takes (1 - e^2) (v_12.n)^2 / 4 from the energy N kT, and (v_12.n)^2 averages 4 kT over the
    collisions of a Maxwell gas; Haff, J. Fluid Mech. 134, 401 (1983). Within 2 % for e >= 0.9 and tau <= 16, while
    the gas stays uniform and nearly Maxwellian.

    >>> round(haff_by_collisions(16, 0.9), 6)
    0.218712
    """
    collisions = checks.non_negative("collisions", collisions, "(per disc)")
    return math.exp(-(1 - _restitution(restitution) ** 2) * collisions / 2)


def haff_in_time(time: float, restitution: float, rate: float) -> float:
    """Temperature of a cooling granular gas over that at the start, 1/(1 + t/t_H)^2, 1/t_H = (1 - e^2) rate/4 [1].

    Args:
        time: t >= 0 [time].
        restitution: e, 0 <= e <= 1 [1].
        rate: collisions per disc and time at the start, >= 0, such as `reference.enskog_rate` [1/time].

    Raises:
        InputError: naming the argument and its rule.

    Source: `haff_by_collisions` with a rate proportional to the root of the temperature; Haff 1983.

    >>> haff_in_time(time=16.0, restitution=0.5, rate=1.0)
    0.0625
    """
    time = checks.non_negative("time", time, "[time]")
    rate = checks.non_negative("rate", rate, "[1/time]")
    return (1 + (1 - _restitution(restitution) ** 2) * rate * time / 4) ** -2


def excess_from_equal_speeds(collisions: float) -> float:
    """Kurtosis excess a_2 after the first few collisions from equal speeds, -1/2 + 32/225 tau [1].

    a_2 = <v^4>/(2 <v^2>^2) - 1. The relaxation is not one exponential: at tau = 1 this line is 0.01 above the value
    EQUAL_SPEEDS_AFTER_ONE.

    Args:
        collisions: tau, collisions per disc so far, 0 <= tau <= 1; exact as tau goes to 0 [1].

    Raises:
        InputError: outside this range.

    Source: see EQUAL_SPEEDS_SLOPE.

    >>> excess_from_equal_speeds(0.0), round(excess_from_equal_speeds(0.1), 6)
    (-0.5, -0.485778)
    """
    collisions = checks.non_negative("collisions", collisions, "(per disc)")
    if collisions > 1:
        raise InputError(f"collisions must be at most 1 for this formula to hold; got {collisions!r}. Give fewer.")
    return EQUAL_SPEEDS_EXCESS + EQUAL_SPEEDS_SLOPE * collisions


def mean_push_overlap(dt: float, temperature: float = 1.0) -> float:
    """Mean depth of the overlaps that `contact="push"` finds at the end of a frame, sqrt(pi)/2 sqrt(kT) dt [length].

    Args:
        dt: of a frame, >= 0, so short that the depth is a small fraction of a diameter [time].
        temperature: kT >= 0 [length^2/time^2].

    Raises:
        InputError: naming the argument and its rule.

    Source: contacts begin at any time of the frame, on average dt/2 before its end, and colliding pairs of a Maxwell
    gas approach at sqrt(pi kT) on average [D]. To first order in dt; 0.886 dt at kT = 1.

    >>> round(mean_push_overlap(0.01), 6)
    0.008862
    """
    dt = checks.non_negative("dt", dt, "[time]")
    return math.sqrt(math.pi * checks.non_negative("temperature", temperature, "[length^2/time^2]")) / 2 * dt


def largest_speed(count: int, frames: int, temperature: float = 1.0) -> float:
    """Expected largest speed of any disc in any frame of a run, sqrt(2 kT ln(N frames)) [length/time].

    Args:
        count: N >= 1.
        frames: >= 1.
        temperature: kT >= 0 [length^2/time^2].

    Raises:
        InputError: naming the argument and its rule.

    Source: a Maxwell speed in 2-D exceeds v with probability exp(-v^2/(2 kT)) [D]; frames taken as independent, which
    overestimates a little.

    >>> round(largest_speed(10_000, 1000), 3)
    5.678
    """
    count = checks.whole("count", count, 1, 10**9, "Count the discs.")
    frames = checks.whole("frames", frames, 1, 10**15, "Count the frames.")
    temperature = checks.non_negative("temperature", temperature, "[length^2/time^2]")
    return math.sqrt(2 * temperature * math.log(count * frames))


def tunnelling_dt(radius: float, speed: float) -> float:
    """Longest frame in which two discs cannot pass through each other undetected, radius / speed [time].

    In this time two discs of this speed approach each other by 2 speed dt, which is one diameter.

    Args:
        radius: > 0 [length].
        speed: of the fastest disc, > 0, such as `largest_speed` [length/time].

    Raises:
        InputError: naming the argument and its rule.

    Source: geometry [D].

    >>> round(tunnelling_dt(0.5, largest_speed(10_000, 1000)), 4)
    0.0881
    """
    return checks.positive("radius", radius, "[length]") / checks.positive("speed", speed, "[length/time]")


def _restitution(value: float) -> float:
    restitution = checks.non_negative("restitution", value, "[1]")
    if restitution > 1:
        raise InputError(f"restitution must be a number from 0 to 1; got {value!r}. Above 1, energy would be created.")
    return restitution


def __dir__() -> list[str]:
    """What is public: constants, functions and classes of this module."""
    own = (name for name, value in globals().items() if getattr(value, "__module__", None) == __name__)
    return sorted({*(name for name in own if name[0] != "_"), *filter(str.isupper, globals()), "__doc__", "__name__"})
