"""Scenes for the exact solver: which are unsupported, and the units and times derived from a scene."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.errors import InputError, StalledError
from mpsim.features import FEATURES
from mpsim.features.edges import kinds_of
from mpsim.features.obstacles import OBSTACLES
from mpsim.kernels import layout as shared
from mpsim.kernels.events.boundary import COARSE
from mpsim.kernels.events.solver import worst_overlap
from mpsim.measure.driving import gravity_strength, is_inelastic, thermal_speed
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings

GUARD = 1e-6
"""The contact-time guard, as a fraction of the time in which a typical disc moves the smallest radius: an impact so
soon after the last one loses no energy. Small against any time between collisions of a gas, large against rounding."""

AT_REST = 0.02
"""A contact time for scenes that come to rest, likewise: most then reach the end of a run, and a disc that hovers in
such bounces rises by less than a ten-thousandth of its radius."""

CRUSHING = 1e4
"""So many times as fast as any disc at the start is one to which a wall that moves leaves no room: the gap in which it
bounces is then a ten-thousandth of what it was."""

LONGEST = 1e100
"""Frame that is taken at most [time], and one over the slowest scene [length/time]."""

MOST_CROSSINGS = 1e10
"""Crossings of the box by a disc in one frame: some minutes of them, in the smallest scene."""


ROUNDING = 1e-12
"""Depth of an overlap, in diameters of the largest disc, up to which a start counts as touching."""


def refuse_what_is_not_exact(scene: Scene, settings: Settings) -> None:
    """Raise InputError for what the exact solver cannot do exactly, by name."""
    refusals = {
        **{law.not_exact: word == settings.law for word, law in shared.LAWS.items() if law.not_exact},
        "precision='float32'": settings.precision != "float64",
        **{kind.not_exact: True for kind in kinds_of(scene.boundary) if kind.not_exact},
        **{feature.not_exact: feature.is_in(scene) for feature in FEATURES if feature.not_exact},
        **{f"a {kind.__name__}": True for kind in {*map(type, scene.obstacles)} - {*OBSTACLES.exact}},
    }
    for what, present in refusals.items():
        if present:
            raise InputError(f"method='event' cannot do {what}. Leave it out, or use method='grid'.")
    refuse_extremes(scene, scene.velocity, settings.dt)
    _refuse_long_contacts(scene, settings.contact_time)


def _refuse_long_contacts(scene: Scene, contact_time: float | None) -> None:
    """Raise InputError for a contact time above `longest_contact_time` [time]."""
    longest = longest_contact_time(scene)
    if contact_time is not None and contact_time > longest:
        raise InputError(
            f"contact_time must be at most {longest:.3g} in this scene: with a longer one, discs that should rest "
            f"under gravity of {gravity_strength(scene):.3g} bounce higher than their radius, "
            f"{scene.smallest_radius:.3g}; got {contact_time:.3g}. Give a shorter one, such as "
            f"{contact_time_at_rest(scene):.1g}."
        )


def refuse_extremes(scene: Scene, velocity: NDArray[np.floating], dt: float) -> None:
    """Raise InputError for speeds whose squares vanish, and frames so long that no run would reach their end.

    velocity: of all discs, shape (N, 2) [length/time].
    """
    if dt > LONGEST:
        raise InputError(f"dt must be at most {LONGEST:g} for method='event'; got {dt:g}. Choose other units of time.")
    fastest = float(np.abs(velocity).max(initial=0.0))
    if 0 < fastest < 1 / LONGEST:
        raise InputError(
            f"velocity must be at least {1 / LONGEST:g} for method='event', or all zero, so that squares do not "
            f"vanish; the fastest is {fastest:g}. Choose other units of time."
        )
    fall = math.sqrt(gravity_strength(scene) * scene.height)
    push = 0.0 if scene.moving_wall is None else 2 * abs(scene.moving_wall.speed)
    crossings = (fastest + fall + push) * dt / max(scene.width, scene.height)
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
    return GUARD * _time_of_a_radius(scene, dt)


def contact_time_at_rest(scene: Scene, dt: float = 1.0) -> float:
    """A contact time with which most scenes that come to rest reach the end of a run [time]."""
    return AT_REST * _time_of_a_radius(scene, dt)


def longest_contact_time(scene: Scene) -> float:
    """A contact time in which a bounce under gravity is as high as the smallest radius; inf without gravity [time]."""
    gravity, radius = gravity_strength(scene), scene.smallest_radius
    return math.sqrt(8 * radius / gravity) if gravity and radius else math.inf


def crushing_speed_of(scene: Scene, velocity: NDArray[np.floating], least: float | None = None) -> float | None:
    """Speed of a disc that a wall crushes [length/time]; None without a wall that moves.

    velocity: of discs that are there or come in [length/time]. least: the speed so far.
    """
    if scene.moving_wall is None:
        return None
    fall = math.sqrt(2 * gravity_strength(scene) * (scene.width + scene.height))
    fastest = max(_typical_speed(scene), float(np.abs(velocity).max(initial=0.0)), fall)
    return max(CRUSHING * fastest, least or 0.0)


def crushed(scene: Scene, time: float, disc: int, frame: int, speed: float) -> StalledError:
    """The error for a disc that a wall has made so fast [length/time] by a time [time]."""
    wall = scene.moving_wall
    assert wall is not None
    return StalledError(
        f"disc {disc} is crushed in frame {frame}: the {wall.name}, now at {wall.place(time):.6g} and on its way to "
        f"{wall.stop:g}, leaves it no room before an obstacle, a wall or other discs, and has driven it to a speed of "
        f"{speed:.3g}, more than {CRUSHING:g} times any at the start. Let the {wall.name} stop earlier, or make room "
        "for the discs before it."
    )


def stalled(scene: Scene, dt: float, disc: int, frame: int, contact_time: float) -> StalledError:
    """The error for a disc that collides without end at one instant."""
    what = f"disc {disc} collided without end at one instant of frame {frame}. Time must pass between collisions"
    moving = "" if scene.moving_wall is None else f", let the {scene.moving_wall.name} stop earlier"
    if not is_inelastic(scene) and scene.gravity is None:
        return StalledError(
            f"{what}, but the disc touches others or walls on all sides, as in a crystal without gaps, and no "
            f"collision takes energy. Give the discs more room (a larger box or a smaller radius){moving}, or use "
            "method='grid'."
        )
    longer = min(max(contact_time_at_rest(scene, dt), 10 * contact_time), longest_contact_time(scene))
    sticky = ", a restitution above 0" if min(scene.restitution, scene.wall_restitution) == 0 else ""
    return StalledError(
        f"{what}; the contact time of the guard is {contact_time:.3g}. Give a longer one, such as "
        f"contact_time={longer:.1g}{sticky} or the discs more room{moving}, or use method='grid'."
    )


def _time_of_a_radius(scene: Scene, dt: float) -> float:
    """Time in which a typical disc moves the smallest radius; dt where nothing moves by itself [time]."""
    speed = _typical_speed(scene)
    return scene.smallest_radius / speed if speed > 0 else dt


def _typical_speed(scene: Scene) -> float:
    """Speed of a typical disc, or of one that has fallen its radius, is emitted, or is in a heat bath [length/time]."""
    squares = float((scene.velocity**2).sum(axis=1).mean()) if scene.count else 0.0
    smallest = scene.smallest_radius
    speeds = [
        math.sqrt(squares + gravity_strength(scene) * smallest),
        *(math.hypot(*np.array(each.velocity)) for each in scene.emitters),
        0.0 if scene.moving_wall is None else abs(scene.moving_wall.speed),
        thermal_speed(scene),
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
