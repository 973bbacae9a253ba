"""Speeds that discs will reach: after a fall, in equilibrium, from emitters, at a moving wall, in a heat bath."""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from mpsim.engine.solvers.speeds import Speeds, estimated_collision_rate, sides_at
from mpsim.measure.driving import acceleration_bound, thermal_speed
from mpsim.scene.scene import Scene


def speeds_after_fall(speeds: Speeds, scene: Scene) -> Speeds:
    """Speed of the fastest disc after a fall through the box; in a scene without discs, of one from an emitter."""
    fall = math.sqrt(2 * acceleration_bound(scene) * max(sides_at(scene, 0.0)))
    if not fall:
        return speeds
    speeds = speeds if scene.count else speeds_of_emitters(scene)
    return replace(speeds, speed=math.hypot(speeds.speed, fall), when="after a fall through the box")


def speeds_in_equilibrium(speeds: Speeds, scene: Scene) -> Speeds:
    """Speeds of discs of different masses in equilibrium: each has the same mean energy, so light ones are fast.

    With E = <m v^2> the mean square of a disc's speed is E / m, and the fastest of N is sqrt(ln N) times faster:
    speeds in two dimensions exceed s with probability exp(-s^2 m / E).
    """
    if scene.mass is None or scene.count < 2:
        return speeds
    squares = (scene.velocity**2).sum(axis=1)
    energy = float((scene.mass * squares).mean())
    speed = np.sqrt(energy / scene.mass * max(math.log(scene.count), 1.0))
    worst = int((speed / scene.radii).argmax())
    mean_speed = math.sqrt(energy * float((1 / scene.mass).mean()))
    return replace(
        speeds,
        disc=worst,
        speed=float(speed[worst]),
        limit=float(scene.radii[worst]),
        between="",
        collision_rate=estimated_collision_rate(scene.radii, mean_speed, sides_at(scene, 0.0), list(scene.pieces())),
        mean_speed=mean_speed,
        when="once collisions have shared the energy out",
    )


def speeds_of_emitters(scene: Scene) -> Speeds:
    """Speed of the disc from an emitter that moves the largest fraction of its radius in a step."""
    if not scene.emitters:
        return Speeds()
    common = scene.largest_radius
    limits = [common if emitter.radius is None else emitter.radius for emitter in scene.emitters]
    velocities: Any = [emitter.velocity for emitter in scene.emitters]
    speeds = [math.hypot(*velocity) for velocity in velocities]
    index = int((np.array(speeds) / limits).argmax())
    return Speeds(speed=speeds[index], limit=limits[index], when=f"from emitters[{index}]")


def speeds_of_pushed(speeds: Speeds, scene: Scene) -> Speeds:
    """Speed of the smallest disc after a moving wall has hit it at rest: without loss twice that of the wall."""
    wall = scene.moving_wall
    if wall is None or not scene.count:
        return Speeds()
    speed = (1 + scene.wall_restitution) * abs(wall.speed)
    return Speeds(speed=speed, limit=speeds.smallest, when=f"pushed by the {wall.name}")


def speeds_in_bath(speeds: Speeds, scene: Scene) -> Speeds:
    """Speed of the fastest of so many discs of the mean mass in equilibrium with a thermostat: sqrt(2 ln(N) kT / m)."""
    speed = thermal_speed(scene) * math.sqrt(2 * max(math.log(max(scene.count, 1)), 1.0))
    return Speeds(speed=speed, limit=speeds.smallest, when="at the temperature of the heat bath")
