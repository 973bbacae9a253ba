"""Checks whether the floating-point precision is sufficient for a scene; refuses it or warns."""

import math

import numpy as np

from mpsim.core import checks
from mpsim.core.columns import given
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.errors import InputError
from mpsim.features import VECTORS
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings

COARSE = 1e-3
"""Spacing of coordinates, as a fraction of the smallest radius, from which on a warning is given: directions of
contacts are then wrong by about as much [radians]."""

TOO_COARSE = 0.125
"""The same, from which on contacts mean nothing and the scene is refused."""

TINY = 1e-6
"""Radius, as a fraction of the distance between neighbours, below which squares of both do not fit one float64."""

VANISHING = 1e7
"""Square of radius times speed, in smallest normal numbers, below which a warning is given."""

STEP_SPACINGS = 16
"""A step of typical length should be so many spacings of coordinates long: rounding then changes it by 3 % at most."""


def check_precision(scene: Scene, settings: Settings) -> None:
    """Refuse a scene whose numbers do not fit the precision of the run.

    Raises:
        InputError: naming the number, the rule and a remedy.
    """
    precision = settings.precision
    checks.fitting("the box", np.array([scene.width, scene.height]), precision)
    # Squares of lengths must not underflow either, nor the time of a step.
    tiny = float(np.finfo(precision).tiny)
    smallest = float(scene.radii.min(initial=scene.largest_radius))
    if smallest > 0:  # with radii of their own, no discs have none
        checks.not_vanishing("radius", smallest, 1e4 * math.sqrt(tiny), precision)
    checks.not_vanishing("dt / substeps", settings.dt / settings.substeps, tiny, precision)
    checks.fitting("dt", np.array([settings.dt]), precision)
    if (wall := scene.moving_wall) is not None:
        checks.fitting("speed of a wall", np.array([wall.speed]), precision)
    fastest = 0.0
    for first, velocity in scene.velocities_in_pieces():
        checks.fitting("velocity", velocity, precision, first)
        fastest = max(fastest, float(np.abs(velocity).max(initial=0.0)))
    for name in (*VECTORS, *(column.name for column in given())):
        if (values := getattr(scene, name, None)) is not None:
            checks.fitting(name, values, precision)
    product = 8 * scene.largest_radius * fastest
    most = math.sqrt(float(np.finfo(precision).max))
    if product > most and computes_contact_times(settings):
        raise InputError(
            f"radius times velocity must be at most {most / 8:.3g} in {precision}, so that its square fits; got "
            f"{product / 8:.3g}. Use other units{_or_double(precision)}."
        )
    if scene.mass is not None:
        lightest = float(scene.mass.min(initial=1.0))
        checks.not_vanishing("mass", lightest, tiny / float(np.finfo(precision).eps), precision)
    spacing = spacing_of(scene, precision)
    if smallest > 0 and spacing > TOO_COARSE * smallest:
        raise InputError(
            f"radius must be at least {spacing / TOO_COARSE:.3g} in a box of {scene.width:g} x {scene.height:g} in "
            f"{precision}, whose coordinates are {spacing:.3g} apart: smaller discs cannot be distinguished; "
            f"got {smallest:.3g}. Use {_finer(precision)}."
        )


def computes_contact_times(settings: Settings) -> bool:
    """Whether times of contacts are computed, with the square of radius times speed: `push` needs none."""
    return settings.contact == "impact" or not capabilities_of(settings).has_steps


def spacing_of(scene: Scene, precision: str) -> float:
    """Distance between two neighbouring coordinates at the far end of the box [length]."""
    return float(np.finfo(precision).eps) * max(scene.width, scene.height)


def rms_speed(scene: Scene) -> float:
    """Root mean square of the speeds at the start; 0 without discs [length/time]."""
    squares = sum(float((velocity**2).sum(axis=1).sum()) for _, velocity in scene.velocities_in_pieces())
    return math.sqrt(squares / scene.count) if scene.count else 0.0


def coarseness(scene: Scene, settings: Settings) -> str | None:
    """What the precision of the run loses of a scene: text with numbers and remedy; None if it is little."""
    precision, spacing = settings.precision, spacing_of(scene, settings.precision)
    words = []
    if scene.count and spacing > COARSE * scene.smallest_radius:
        words.append(
            f"coordinates are {spacing:.3g} apart at the far end of the box, {spacing / scene.smallest_radius:.2g} of "
            f"the smallest radius: directions of contacts are wrong by as much. Use {_finer(precision)}"
        )
    apart = math.sqrt(scene.width * scene.height / max(scene.count, 1))
    has_steps = capabilities_of(settings).has_steps
    if not has_steps and scene.count > 1 and scene.smallest_radius < TINY * apart:
        words.append(
            f"discs of radius {scene.smallest_radius:.3g} are some {apart:.3g} apart: the square of the radius is lost "
            "beside that of the distance, so that the time of a contact is wrong by up to the time in which a disc "
            "moves its radius. Use larger discs or a smaller box"
        )
    speed = rms_speed(scene)
    square = (speed * scene.smallest_radius) ** 2
    if computes_contact_times(settings) and 0 < square < VANISHING * float(np.finfo(precision).tiny):
        words.append(
            f"the square of rms speed {speed:.3g} times radius {scene.smallest_radius:.3g} is lost, so that times of "
            f"contacts cannot be computed. Use other units{_or_double(precision)}"
        )
    dt = settings.dt / settings.substeps
    displacement = speed * dt
    if has_steps and 0 < displacement < STEP_SPACINGS * spacing:
        effect = "most discs do not move at all" if displacement < spacing / 2 else "rounding changes each step"
        words.append(
            f"a disc of rms speed {speed:.3g} moves {displacement:.3g} in a step, {displacement / spacing:.2g} of the "
            f"distance {spacing:.3g} between coordinates: {effect}. Use larger steps, or {_finer(precision)}"
        )
    pull = 0.0 if scene.gravity is None else float(np.abs(scene.gravity).max())
    if has_steps and 0 < pull * dt < float(np.finfo(precision).eps) * speed:
        words.append(
            f"gravity changes a velocity by {pull * dt:.3g} in a step, which is lost to rounding beside an rms speed "
            f"of {speed:.3g}. Use larger steps{_or_double(precision)}"
        )
    return ". ".join(words) + "." if words else None


_DOUBLE = "precision='float64'"


def _or_double(precision: str) -> str:
    return "" if precision == "float64" else f" or {_DOUBLE}"


def _finer(precision: str) -> str:
    return "a smaller box or larger discs" if precision == "float64" else f"{_DOUBLE} or a smaller box"
