"""How fast two runs of one scene diverge that differ a little."""

import math
from collections.abc import Callable

import numpy as np

from mpsim.core.state import State
from mpsim.engine.simulation import Simulation
from mpsim.errors import InputError
from mpsim.features.energy import acceleration_bound
from mpsim.measure.observables import trajectory_error
from mpsim.measure.statistics import Predictability, predictability
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings

PERTURBATION = 1e-10
"""Initial difference of the velocities of two runs, as a fraction of a typical speed: far above rounding."""

HIGHEST = 1e-3
"""Distance, in diameters of the smallest disc, up to which two runs count as close together."""

STRAIGHT = 10.0
"""Growth of a difference, over that in straight flight, below which it shows no exponent: there was one collision at
most."""

SAMPLES = 400
"""Largest number of times at which two runs are compared."""


def typical_speed(scene: Scene) -> float:
    """Root mean square speed, including that of a fall through the largest diameter [length/time]."""
    kinetic = float((scene.velocity**2).sum(axis=1).mean()) if scene.count else 0.0
    return math.sqrt(kinetic + 2 * acceleration_bound(scene) * 2 * scene.largest_radius)


def divergence(
    scene: Scene,
    seed: int = 0,
    contact_time: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Predictability:
    """Divergence of two exact runs of the scene whose initial velocities differ by a relative 1e-10.

    Args:
        scene: that `method="event"` can run, with moving discs.
        seed: of the small difference.
        contact_time: as in `Settings` [time].
        progress: as for `Simulation.run`.

    Returns:
        The Lyapunov exponent with its error, and the time up to which trajectories can be compared. The exponent is
        that of this start; for that of a gas, average over several starts.

    Raises:
        InputError: if the scene cannot be run exactly, or the runs do not diverge, as in a scene without collisions.

    Source: see `predictability`.

    >>> found = divergence(Scene.random(count=64, packing=0.3, radius=0.5, seed=1))
    >>> 1.5 < found.rate.value < 4.5, found.comparable_until < found.horizon
    (True, True)
    """
    speed, diameter = typical_speed(scene), 2 * scene.smallest_radius
    perturbation = np.random.default_rng(seed).normal(size=(scene.count, 2)) * PERTURBATION * speed
    other = scene.starting_from(State(scene.position, scene.velocity + perturbation))
    other = other._replace(thermostat=scene.thermostat) if scene.thermostat else other  # the same kicks, by its seed
    # A sample for each twentieth of a diameter of flight: a Lyapunov time is about as long as a free path.
    settings = Settings(method="event", dt=0.05 * diameter / speed if speed else 1.0, contact_time=contact_time)
    times, distances = [], []
    with Simulation(scene, settings) as one, Simulation(other, settings) as two:
        for _ in range(SAMPLES):
            one.run(frames=1, progress=progress)
            two.run(frames=1, progress=progress)
            times.append(one.time)
            distances.append(trajectory_error(one.state, two.state, scene).rms)
            if distances[-1] > HIGHEST * diameter:
                break
    straight = PERTURBATION * speed * times[-1]
    if distances[-1] <= STRAIGHT * straight:
        raise InputError(
            f"the runs of a scene must diverge for a growth rate; a distance of {distances[-1]:.3g} in a time of "
            f"{times[-1]:.3g} is that of straight flight, {straight:.3g}. Take a scene in which discs collide."
        )
    return predictability(times, distances, highest=HIGHEST * diameter)
