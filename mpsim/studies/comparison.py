"""Runs of one scene side by side: how fast they diverge, and how wrong a setting is before chaos dominates."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from mpsim.core import checks
from mpsim.core.state import State
from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.errors import InputError
from mpsim.features.energy import acceleration_bound
from mpsim.measure.observables import TrajectoryDeviation, trajectory_error
from mpsim.measure.predictability import Predictability, predictability, require_predictable
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


@dataclass(frozen=True)
class ShortRun:
    """A short run beside an exact one from the same start.

    Attributes:
        time: at which both were compared [time].
        error: deviation of the positions.
        collisions: contacts resolved, in the run and in the exact one; a stepped run resolves contacts at rest again in
            each step.
    """

    time: float
    error: TrajectoryDeviation
    collisions: tuple[int, int]


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


def short_run(
    scene: Scene,
    settings: Settings,
    until: float,
    *,
    rate: float | None = None,
    reference: Settings | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> ShortRun:
    """Run a scene with the given settings and exactly, and compare the positions of the discs.

    Args:
        scene: that `method="event"` can run.
        settings: of the run.
        until: time of the comparison, rounded to whole frames, at least one [time], > 0.
        rate: Lyapunov exponent of the scene, if known [1/time]; else it is estimated by `divergence`.
        reference: settings to compare with if `event` cannot run the scene; its dt is rounded to fit the time.
        progress: as for `Simulation.run`, for both runs.

    Raises:
        InputError: if two correct solvers do not agree for that long, or the scene cannot be run exactly.

    >>> scene = Scene.random(count=64, packing=0.3, radius=0.5, seed=1)
    >>> coarse, fine = (short_run(scene, Settings(dt=dt, method="grid"), until=0.5, rate=3.0) for dt in (0.05, 0.005))
    >>> fine.error.rms < coarse.error.rms < 0.5
    True
    >>> short_run(scene, Settings(dt=0.05, method="grid"), until=5, rate=3.0)
    Traceback (most recent call last):
    ...
    mpsim.InputError: time of a comparison of trajectories must be at most 3.33333 (half of 20 Lyapunov times \
of 1/3); got 5.0. Beyond that two correct solvers differ: compare averages such as pressure, or an earlier time.
    """
    frames = max(round(checks.positive("until", until, "[time]") / settings.dt), 1)
    time = frames * settings.dt
    require_predictable(time, divergence(scene).rate.value if rate is None else rate)
    with Simulation(scene, settings) as run:
        collisions = run.run(frames=frames, progress=progress).collisions
        state = run.state
    reference = Settings(method="event", dt=time) if reference is None else reference
    steps = max(round(time / reference.dt), 1) if capabilities_of(reference).has_steps else 1
    if scene.thermostat is None:
        reference, frames = replace(reference, dt=time / steps), steps
    else:  # which acts once a frame: on both alike
        reference = replace(reference, dt=settings.dt, substeps=-(-steps // frames))
    with Simulation(scene, reference) as exact:
        report = exact.run(frames=frames, progress=progress)
        error = trajectory_error(state, exact.state, scene)
    return ShortRun(time, error, (collisions, report.collisions))
