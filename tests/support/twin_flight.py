"""The twins' flight of a disc that entered inside a frame: looked at step by step up to what it meets."""

import itertools
import math
from typing import Any

import numpy as np

import mpsim

LOOKS_PER_RADIUS, MOST_LOOKS = 4, 10_000
"""Places along a flight at which it is looked for what is in the way."""


def landing(
    scene: mpsim.Scene, emitter: mpsim.Emitter, capsules: Any, radius: float, elapsed: float, now: float
) -> tuple[Any, Any, Any]:
    """Place, velocity and periods of a disc that left an emitter some time ago, where its free flight has ended."""
    gravity = np.zeros(2) if scene.gravity is None else scene.gravity
    start, velocity = np.array(emitter.position), np.array(emitter.velocity)

    def place_at(time: float) -> Any:
        return start + time * (velocity + 0.5 * time * gravity)

    def meets(time: float) -> bool:
        return is_blocked(scene, capsules, radius, place_at(time), now)

    length = elapsed * (math.hypot(*velocity) + math.hypot(*gravity) * elapsed)
    looks = int(min(max(LOOKS_PER_RADIUS * length / radius, 1), MOST_LOOKS))
    times = np.linspace(0, elapsed, looks + 1)[1:]
    beyond = next((float(time) for time in times if meets(time)), None)
    flown = elapsed if beyond is None else last_free(meets, beyond - float(times[0]), beyond, elapsed)
    place, image = place_at(flown), np.zeros(2, np.int64)
    for axis, (size, word) in enumerate(zip((scene.width, scene.height), scene.boundary, strict=True)):
        if word == "periodic":
            end = place[axis]
            place[axis] %= size
            image[axis] = round((end - place[axis]) / size)
    return place, velocity + flown * gravity, image


def last_free(meets: Any, free: float, beyond: float, elapsed: float) -> float:
    """By halving: a time at which nothing is in the way, no more than a rounding before one at which something is."""
    while beyond - free > elapsed * np.finfo(float).eps:
        middle = 0.5 * (free + beyond)
        if not free < middle < beyond:
            break
        free, beyond = (free, middle) if meets(middle) else (middle, beyond)
    return free


def is_blocked(scene: mpsim.Scene, capsules: Any, radius: float, place: Any, now: float) -> bool:
    """Whether a disc would lie beyond a wall or the piston, or in an obstacle or an image of one."""
    size, steps, inside = (scene.width, scene.height), [], place.copy()
    for axis, length in enumerate(size):
        if scene.boundary[axis] == "periodic":
            inside[axis] %= length
            steps.append((0.0, length, -length))
            continue
        steps.append((0.0,))
        low, high = 0.0, length
        if scene.piston is not None and scene.piston.wall in (("left", "right"), ("bottom", "top"))[axis]:
            low, high = walls_by_piston(scene.piston, length, now)
        if not low + radius <= place[axis] <= high - radius:
            return True
    return any(
        radius > gap_to(inside - np.array(shift), capsule)
        for capsule, shift in itertools.product(capsules, itertools.product(*steps))
    )


def walls_by_piston(piston: mpsim.Piston, length: float, now: float) -> tuple[float, float]:
    """Lower and upper wall of the piston's axis."""
    upper = piston.wall in ("right", "top")
    start = piston.start if piston.start is not None else length if upper else 0.0
    place = start + piston.speed * now
    return (0.0, max(place, piston.stop)) if upper else (min(place, piston.stop), length)


def gap_to(place: Any, capsule: Any) -> float:
    """Distance from a place to the surface of a segment with a radius."""
    a, along = capsule[:2], capsule[2:4] - capsule[:2]
    r, squared = place - a, along[0] ** 2 + along[1] ** 2
    part = min(max((r[0] * along[0] + r[1] * along[1]) / squared, 0), 1) if squared > 0 else 0.0
    return float(np.hypot(*(r - part * along))) - capsule[4]
