"""Scenes for the exact solver: what it cannot do, and the units and times that follow from a scene."""

import math
from typing import Any

import numpy as np

from mpsim.core.errors import InputError
from mpsim.features import FEATURES
from mpsim.features.edges import kinds_of
from mpsim.kernels import layout
from mpsim.kernels.events.boundary import COARSE
from mpsim.kernels.events.cells import worst_overlap
from mpsim.measure.driving import gravity_strength
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings

GUARD = 1e-6
"""The contact-time guard, as a fraction of the time in which a typical disc moves the smallest radius: an impact so
soon after the last one loses no energy. Small against any time between collisions of a gas, large against rounding."""

LONGEST = 1e100
"""Frame that is taken at most [time], and one over the slowest scene [length/time]."""

MOST_CROSSINGS = 1e10
"""Crossings of the box by a disc in one frame: some minutes of them, in the smallest scene."""


ROUNDING = 1e-12
"""Depth of an overlap, in diameters of the largest disc, up to which a start counts as touching."""


def refuse_what_is_not_exact(scene: Scene, settings: Settings) -> None:
    """Raise InputError for what the exact solver cannot do exactly, by name."""
    refusals = {
        **{law.not_exact: word == settings.law for word, law in layout.LAWS.items() if law.not_exact},
        "precision='float32'": settings.precision != "float64",
        "unguarded=True": settings.unguarded,
        **{kind.not_exact: True for kind in kinds_of(scene.boundary) if kind.not_exact},
        **{feature.not_exact: feature.is_in(scene) for feature in FEATURES if feature.not_exact},
    }
    for what, present in refusals.items():
        if present:
            raise InputError(f"method='event' cannot do {what}. Leave it out, or use method='grid'.")
    _refuse_extremes(scene, settings.dt)


def _refuse_extremes(scene: Scene, dt: float) -> None:
    """Raise InputError for speeds whose squares vanish, and frames so long that no run would reach their end."""
    if dt > LONGEST:
        raise InputError(f"dt must be at most {LONGEST:g} for method='event'; got {dt:g}. Choose other units of time.")
    fastest = float(np.abs(scene.velocity).max(initial=0.0))
    if 0 < fastest < 1 / LONGEST:
        raise InputError(
            f"velocity must be at least {1 / LONGEST:g} for method='event', or all zero, so that squares do not "
            f"vanish; the fastest is {fastest:g}. Choose other units of time."
        )
    fall = math.sqrt(gravity_strength(scene) * scene.height)
    crossings = (fastest + fall) * dt / max(scene.width, scene.height)
    if crossings > MOST_CROSSINGS and fastest < LONGEST:  # which is refused with its disc
        raise InputError(
            f"dt must be short enough for method='event' to end a frame: one of {dt:g} would take the fastest disc "
            f"{crossings:.3g} times through the box; at most {MOST_CROSSINGS:g} are tried. Use a smaller dt."
        )


def units_of(scene: Scene, dt: float) -> tuple[float, float]:
    """Units of sums of impulses [mass length/time] and of virials [mass length^2/time]: powers of two."""
    diameter = 2 * scene.largest_radius or 1.0
    mass = float(scene.masses.max(initial=0.0)) or 1.0
    impulse = mass * (_typical_speed(scene) or diameter / dt)
    coarse = math.ldexp(COARSE, math.frexp(impulse)[1])
    return coarse, math.ldexp(coarse, math.frexp(diameter)[1])


def contact_time_of(scene: Scene, dt: float) -> float:
    """The contact time of the guard [time]."""
    speed = _typical_speed(scene)
    # Where nothing moves by itself, a fraction of the time of a frame: speeds are those of what is added later.
    return GUARD * (scene.smallest_radius / speed if speed > 0 else dt)


def _typical_speed(scene: Scene) -> float:
    """Speed of a typical disc, of one that has fallen its radius, or of one that is emitted [length/time]."""
    squares = float((scene.velocity**2).sum(axis=1).mean()) if scene.count else 0.0
    smallest = scene.smallest_radius
    speeds = [
        math.sqrt(squares + gravity_strength(scene) * smallest),
        *(math.hypot(*np.array(each.velocity)) for each in scene.emitters),
        0.0 if scene.moving_wall is None else abs(scene.moving_wall.speed),
    ]
    return max(speeds)


def refuse_overlap(system: tuple[Any, Any, Any], diameter: float) -> None:
    """Raise InputError for discs that overlap by more than rounding, naming the worst pair.

    Args:
        system: store, box and features of a scene just placed.
        diameter: of the largest disc [length].
    """
    first, second, depth = worst_overlap(*system)
    if depth > ROUNDING * diameter:
        raise InputError(
            "method='event' needs discs that do not overlap; discs "
            f"{min(first, second)} and {max(first, second)} overlap by {depth:.3g}, the most of all. Move them "
            "apart, or run a few frames with method='grid' and start from there."
        )
