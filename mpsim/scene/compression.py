"""Compression of a scene to a higher packing fraction.

As Lubachevsky and Stillinger do it (J. Stat. Phys. 60, 561, 1990): the exact solver moves the discs while their radii
grow in proportion to time. The growth heats them, so their speeds are scaled back from time to time. In the end the box
and all places are scaled down, so that each disc has the radius that it had.
"""

import copy
import math
from typing import Any

import numpy as np

from mpsim.core import checks
from mpsim.core.checks import Floats
from mpsim.errors import InputError
from mpsim.features.edges import BOUNDARIES
from mpsim.features.properties import densest_packing
from mpsim.kernels.events import cells as stores
from mpsim.kernels.events import records, solver
from mpsim.kernels.events.cells import Box, plan_cells
from mpsim.kernels.events.features.hooks import BARE
from mpsim.scene import starts
from mpsim.scene.scene import FASTEST, SLOWEST, Scene

EVENTS = 20  # events for each disc after which speeds are scaled back, about: a few collisions each
EVENTS_AT_ONCE = 100_000  # events between two looks at Ctrl-C, some 0.1 s
OUTGROWN = 1.05  # growth of radii for which cells are wide enough; then they are made anew

JAMMED = 1e6
"""Pressure p A/(N kT) above which discs count as jammed: near jamming at a packing f it is about 2/(1 - packing/f)."""

GAP = 64 * float(np.finfo(np.float64).eps)
"""Gap left between discs, as a fraction of the box, so that no rounding makes them overlap."""


def compressed(scene: Scene, packing: float, rate: float) -> Scene:
    """The body of `Scene.compressed`."""
    packing = starts.fraction_of_the_area(packing)
    rate = checks.between("rate", rate, SLOWEST, FASTEST)
    if not scene.count:
        raise InputError("compressed needs discs; got 0 discs. Make a scene with some.")
    densest = densest_packing(scene.smallest_radius, scene.largest_radius)
    if not scene.packing < packing < densest:
        raise InputError(
            f"packing must be above that of the scene, {scene.packing:.6g}, and below {densest:.6g}, the densest that "
            f"discs of such radii can have; got {packing:g}. Choose one between, or compress a scene of lower packing."
        )
    _demand_free_flight(scene)
    shrink = math.sqrt(packing / scene.packing)
    width, height = scene.width / shrink, scene.height / shrink
    for length, kind in zip((width, height), (BOUNDARIES[word] for word in scene.boundary), strict=True):
        if length < 2 * kind.least_diameters * scene.largest_radius:
            raise InputError(
                f"packing must leave the largest disc room, {kind.least_diameters} of them along each axis here; at "
                f"{packing:g} the box would be {width:.6g} x {height:.6g}. Use a lower one or more discs."
            )
    grown, velocity = _grown(scene, shrink, rate)
    made = copy.copy(scene)
    vars(made).update(width=width, height=height)
    low, high = made.limits(made.radius)
    made._start_anew(np.clip(grown / shrink, low, high), velocity)
    if scene._redraw is not None:
        made._redraw = lambda seed: scene.redrawn(seed).compressed(packing, rate=rate)
    return made


def _demand_free_flight(scene: Any) -> None:
    """Refuse a scene whose discs do not just fly between walls, or overlap."""
    there = {
        "obstacles": scene.obstacles,
        "emitters": scene.emitters,
        "a piston": scene._moving_walls,
        "absorbing edges or removed discs": scene._loses_discs,
    }
    if found := [name for name, present in there.items() if present]:
        raise InputError(
            f"compressed cannot do a scene with {' and '.join(found)}, as its box shrinks. Compress the discs without, "
            "and make a Scene of their positions and velocities."
        )
    starts.area_of_discs(scene.radius, scene.count)  # which refuses extreme radii
    if overlaps := scene.overlaps_at_start():
        raise InputError(f"compressed needs discs that do not overlap; {overlaps}. Move them apart.")


def _power_of_two(value: float) -> float:
    return math.ldexp(1.0, math.frexp(value)[1])


def _grown(scene: Any, growth: float, rate: float) -> tuple[Floats, Floats]:
    """Places [length] in the box of a scene where its discs fit when they have grown so many times, and velocities.

    The discs fly in units of their mean radius and thermal speed, to the next power of two: no digit is lost.
    """
    mass = scene.masses / _power_of_two(float(scene.masses.max()))
    length = _power_of_two(float(scene.radii.mean()))
    fastest = float(np.abs(scene.velocity).max())
    most = starts.LARGEST_RADIUS
    if not 1 / most < fastest < most:
        raise InputError(
            f"velocity must not be 0 everywhere, and must be below {most:g}, for compressed: discs move "
            f"meanwhile; the largest is {fastest:g}. Give them a temperature."
        )
    velocity = scene.velocity / _power_of_two(fastest)
    energy = _energy(mass, velocity)
    size, radius = (scene.width / length, scene.height / length), scene.radii / length
    position = scene.position / length
    thermal = math.sqrt(energy / scene.count / float(mass.mean()))
    speed = rate * thermal / float(radius.mean()) / 2
    scale, end = 1.0, growth * (1 + GAP * max(size) / float(radius.min()))
    while scale < end:
        before = scale
        scales = scale, min(scale * OUTGROWN, end)
        position, velocity, scale = _fly(size, scene.periodic, radius, mass, position, velocity, scales, speed)
        heated = _energy(mass, velocity) / energy
        velocity /= math.sqrt(heated)
        pressure = 1 + math.log(heated) / (2 * math.log(scale / before)) if scale > before else math.inf
        if not pressure <= JAMMED and scale < end:
            reached = scene.packing * scale**2
            raise InputError(
                f"packing {scene.packing * growth**2:g} was not reached: at rate={rate:g} the discs jammed at a "
                f"packing of {math.floor(1e6 * reached) / 1e6:.6f}. Use a slower rate, such as "
                f"rate={max(rate / 10, SLOWEST):g}, or a packing below that."
            )
    return position * length, velocity * _power_of_two(fastest)


def _energy(mass: Floats, velocity: Floats) -> float:
    return 0.5 * float((mass * (velocity**2).sum(axis=1)).sum())


def _fly(
    size: tuple[float, float],
    periodic: tuple[bool, bool],
    radius: Floats,
    mass: Floats,
    position: Floats,
    velocity: Floats,
    scale: tuple[float, float],
    speed: float,
) -> tuple[Floats, Floats, float]:
    """Let discs fly and grow from one scale to another, or for some EVENTS each: places, velocities, scale reached.

    radius: at scale 1. speed: growth of the scale [1/time].
    """
    count, largest = len(position), 2 * float(radius.max()) * scale[1]
    cells = plan_cells(*size, largest, count)
    arrays = {name: np.zeros(shape, dtype)[()] for name, (dtype, shape) in stores.layout(count, cells).items()}
    store, box = stores.store_of(arrays), Box(*size, *periodic, *cells, 0.0)
    columns = {"radius": radius * scale[0], "mass": mass}
    features = BARE._replace(
        contact_time=0.0, expansion=speed / scale[0], **{name: np.empty(count) for name in columns}
    )
    stores.place(position, velocity, columns, 0.0, store, box, features)
    solver.run_task(solver.SCHEDULE, store, box, features)
    until, status = (scale[1] - scale[0]) / speed, records.PAUSED
    most = EVENTS * count
    rest = solver.nothing_to_play()[3:]
    while status == records.PAUSED and store.counter.events < most:
        most_now = min(most - int(store.counter.events), EVENTS_AT_ONCE)
        _, status, _ = solver.run_events(solver.PLAY, store, box, features, until, 1, most_now, *rest)
    reached = status == records.REACHED
    time = until if reached else float(store.clock.origin + store.clock.now)
    grown = scale[1] if reached else min(scale[0] + speed * time, scale[1])
    found = stores.read_out(store, box, features._replace(radius=features.radius * grown / scale[0]), time)
    return found["position"], found["velocity"], grown
