"""The flight of an emitted disc in its first frame, up to the end of the frame or the first obstacle."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mpsim.features.emitters import Emitter
from mpsim.scene.scene import Scene

Floats = NDArray[np.float64]

LOOKS_PER_RADIUS = 4
"""Places along a flight that are tested for walls and capsules, per radius of its length."""

MOST_LOOKS = 10_000

HALVINGS = 5
"""Steps of a bisection that are looked at together."""

MOST_PERIODS = 2.0**53
"""Periods of one flight that are counted at most, as in the kernels."""


class FlightEnd(NamedTuple):
    """Where a flight ends: position, velocity, and image flags, all of shape (2,)."""

    position: Floats
    velocity: Floats
    image: NDArray[np.int64]


def end_of_flight(scene: Scene, emitter: Emitter, radius: float, elapsed: float, time: float) -> FlightEnd:
    """Position and velocity of a disc that left an emitter some time ago [length], [length/time].

    It has flown freely: position + v s + g s^2/2 and v + g s. A flight that meets a wall or a capsule
    ends there with the velocity it then has, and the next frame begins with that contact; other discs are left out of
    account.

    Args:
        scene: whose gravity pulls.
        emitter: where the flight began.
        radius: of the disc [length].
        elapsed: time since then, s [time], >= 0.
        time: now, which tells where the walls are [time].
    """
    start, velocity = np.array(emitter.position), np.array(emitter.velocity)
    image = np.zeros(2, np.int64)
    if elapsed == 0:
        return FlightEnd(start, velocity, image)
    gravity = np.zeros(2) if scene.gravity is None else scene.gravity

    def places(times: Floats) -> Floats:
        return start + times[:, None] * (velocity + 0.5 * times[:, None] * gravity)

    length = elapsed * (math.hypot(*velocity) + math.hypot(*gravity) * elapsed)
    looks = int(np.clip(LOOKS_PER_RADIUS * length / radius, 1, MOST_LOOKS))
    times = np.linspace(0, elapsed, looks + 1)[1:]
    clear = _clear(scene, radius, places(times), time)
    flown = elapsed
    if not clear.all():
        blocked = int(np.argmin(clear))
        rounding = elapsed * float(np.finfo(float).eps)  # below it a flight that ends at its start would halve on to 0
        flown = _last_clear(
            lambda times: _clear(scene, radius, places(times), time),
            float(times[blocked] - times[0]),
            float(times[blocked]),
            rounding,
        )
    place = places(np.array([flown]))[0]
    for axis, length in enumerate((scene.width, scene.height)):
        if scene.periodic[axis]:
            end = place[axis]
            place[axis] %= length
            periods = np.rint((end - place[axis]) / length)
            image[axis] = periods if abs(periods) < MOST_PERIODS else 0
    return FlightEnd(place, velocity + flown * gravity, image)


def _last_clear(clear: Callable[[Floats], NDArray[np.bool_]], flown: float, beyond: float, rounding: float) -> float:
    """The end of the clear part of a flight, by bisection: clear at `flown`, not at `beyond` [time].

    Asking about one time costs as much as about thirty, so each look is at all that the next HALVINGS can lead to.
    """
    while True:
        times = np.array([flown, beyond])
        for _ in range(HALVINGS):
            middles = 0.5 * (times[:-1] + times[1:])
            times = np.append(np.stack([times[:-1], middles], axis=1).ravel(), times[-1])
        free, low, high = clear(times), 0, len(times) - 1
        while high - low > 1:
            middle = (low + high) // 2
            flown, beyond = float(times[low]), float(times[high])
            if beyond - flown <= rounding or not flown < times[middle] < beyond:
                return flown
            low, high = (middle, high) if free[middle] else (low, middle)
        flown, beyond = float(times[low]), float(times[high])


def _clear(scene: Scene, radius: float, places: Floats, time: float) -> NDArray[np.bool_]:
    """Which centres are inside the walls and outside capsules, shape (K,); through periodic borders too."""
    size, periodic = np.array([scene.width, scene.height]), np.array(scene.periodic)
    low, high = scene.limits(radius, time)
    low, high = np.where(periodic, -np.inf, low), np.where(periodic, np.inf, high)
    clear: NDArray[np.bool_] = np.all((places >= low) & (places <= high), axis=1)
    if len(scene.capsules):
        wrapped = np.where(periodic, places % size, places)
        clear &= scene.capsule_index.depths(wrapped, np.full(len(places), radius)) == 0
    return clear
