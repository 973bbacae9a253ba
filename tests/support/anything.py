"""Random scenes with any features, and gases that the exact solver plays, too, from one number each."""

from typing import Any

import numpy as np

import mpsim
from mpsim.engine.solvers.speeds import speeds_of
from mpsim.engine.step_limits import StepLimits
from support.transforms import features_of

NUMBERS = [0.0, -0.0, 1.0, -1.0, 0.25, -3.0, 1e-30, 50.0, -1e5]


def anything(seed: int, *, twin: bool = True) -> tuple[mpsim.Scene, dict[str, Any]]:
    """A scene of up to 14 discs in a small box, and settings.

    Args:
        seed: of the scene.
        twin: leave out what the slow twin does not know: sub-steps that are chosen on the way, and emitters together
            with a piston, which may pass them.
    """
    rng = np.random.default_rng(seed)
    chance = lambda part=0.4: rng.random() < part  # noqa: E731
    count = int(rng.choice([0, 1, 2, 5, 14]))
    periodic = [bool(chance()), bool(chance())]
    radius: Any = float(rng.choice([0.5, 0.1, 3.0]))
    if chance():
        radius = radius * rng.choice([1.0, 0.5, 0.3, 0.2], count) if chance() else np.full(count, radius * 0.1)
        radius[:1] *= 5
    largest = float(np.max(radius, initial=0)) or 0.5
    size = [2 * largest * (2 if wrap else 1) * float(rng.choice([1, 1.001, 1.5, 2, 3.7])) for wrap in periodic]
    features = dict(zip(("width", "height"), size, strict=True))
    features |= _forces(rng, chance, count)
    if chance():
        features["obstacles"] = _obstacles(rng, size, largest)
    dt = float(rng.choice([0.01, 0.1, 0.3, 5.0]))
    features |= _edges(rng, chance, periodic, size, largest, dt, twin)
    margin = np.multiply.outer(np.broadcast_to(radius, count), [not wrap for wrap in periodic])
    parts = rng.integers(0, 17, (count, 2)) / 16 if chance() else rng.random((count, 2))
    position = margin + parts * (size - 2 * margin)
    velocity = rng.choice(NUMBERS, (count, 2)) if chance() else rng.normal(size=(count, 2)) * largest
    boundary = ["periodic" if wrap else "walls" for wrap in periodic]
    parts_of_scene = {"position": position, "velocity": velocity, "radius": radius, "boundary": boundary}
    parts_of_scene |= any_friction(np.random.default_rng([seed, 79]), count)
    try:
        scene = mpsim.Scene(**parts_of_scene, **features)
    except mpsim.InputError:  # an emitter in an obstacle, or too many discs where the piston stops: without them
        kept = {name: value for name, value in features.items() if name not in ("emitters", "piston")}
        scene = mpsim.Scene(**parts_of_scene, **kept)
    smooth = not (scene.friction or scene.wall_friction or scene.spin is not None)
    settings = {
        "method": rng.choice(["naive", "grid"]).item(),
        "precision": rng.choice(["float64", "float32"]).item(),
        "contact": rng.choice(["impact", "push"]).item(),
        "law": rng.choice(["elastic", "elastic", "reflect"] if smooth else ["elastic"]).item(),
        "dt": dt,
        "substeps": int(rng.integers(1, 3)),
        "passes": int(rng.integers(1, 3)),
    }
    if not twin:
        settings |= _chosen_substeps(rng, scene, settings)
    return scene, settings


def _chosen_substeps(rng: Any, scene: mpsim.Scene, settings: dict[str, Any]) -> dict[str, Any]:
    """on_fast="substep" for half of the scenes, with a dt that makes a few sub-steps of a frame, not thousands."""
    chosen = settings | {"on_fast": rng.choice(["warn", "substep"]).item()}
    if chosen["on_fast"] == "warn":
        return chosen
    try:
        limits = StepLimits(scene, mpsim.Settings(**chosen))
        needed = limits.substeps_for(speeds_of(scene.velocity, scene.radii, scene), 0)
    except mpsim.TooFastError:
        return settings | {"on_fast": "warn"}
    return chosen | {"dt": settings["dt"] * min(1.0, 4 / needed)}


def _forces(rng: Any, chance: Any, count: int) -> dict[str, Any]:
    features: dict[str, Any] = {}
    if chance():
        features["gravity"] = rng.choice([0.0, -1.0, 3.0], 2)
    if chance(0.2):
        features["acceleration"] = rng.normal(size=(count, 2))
    if chance():
        features["mass"] = rng.choice([1e-3, 1.0, 2.0, 1e6], count)
    if chance():
        features |= {"restitution": rng.choice([0.0, 0.5, 0.9]), "wall_restitution": rng.choice([0.0, 0.5, 0.9])}
    return features


def _obstacles(rng: Any, size: Any, largest: float) -> list[Any]:
    place = lambda: tuple(rng.random(2) * size)  # noqa: E731
    found: list[Any] = []
    for _ in range(rng.integers(1, 4)):
        thickness = float(rng.choice([0.0, 0.1, 1.0])) * largest
        found.append(
            mpsim.FixedDisc(place(), thickness + 0.1 * largest)
            if rng.random() < 0.5
            else mpsim.Polyline([place() for _ in range(rng.integers(2, 4))], thickness)
        )
    return found


def _edges(
    rng: Any, chance: Any, periodic: list[bool], size: Any, largest: float, dt: float, twin: bool
) -> dict[str, Any]:
    """Absorbing edges and a piston where there are walls, and an emitter."""
    features: dict[str, Any] = {}
    walls = [edge for k, edge in enumerate(("left", "right", "bottom", "top")) if not periodic[k // 2]]
    rng.shuffle(walls)
    if walls and chance(0.3):
        features["absorbing"] = [walls.pop()]
    if walls and chance(0.3 if twin else 0.6):
        wall = walls.pop()
        length = size[wall in ("bottom", "top")]
        room = 2 * largest + rng.random() * 0.9 * (length - 2 * largest)
        inward = -1 if wall in ("right", "top") else 1
        stop = room * 1.000001 if inward < 0 else length - room * 1.000001
        if 0 < stop < length:
            features["piston"] = mpsim.Piston(wall, inward * rng.choice([0.1, 1.0, 30.0]), stop)
    if chance(0.3 if twin else 0.6) and not (twin and "piston" in features):
        middle = tuple(length / 2 for length in size)
        kind = {"radius": largest / 2, "mass": 2.0}
        clock = {"every": 2} if chance(0.5) else {"interval": dt * float(rng.choice([0.4, 1.0, 2.5]))}
        features["emitters"] = mpsim.Emitter(middle, tuple(rng.normal(size=2)), limit=3, **clock, **kind)
    return features


# --- gases that the exact solver plays, too


def any_gas(seed: int, *, friction: bool = True, wrap: float = 0.3) -> mpsim.Scene:
    """Up to 24 discs without overlap, dilute to dense, some with radii, masses, fields, losses, friction, borders.

    With the probability `wrap` an axis is periodic. Coordinates are multiples of 2^-20.
    """
    rng = np.random.default_rng([seed, 77])
    chance = lambda part=0.4: rng.random() < part  # noqa: E731
    count = int(rng.choice([1, 2, 6, 15, 24]))
    radius: Any = rng.choice([0.5, 0.34375, 0.1875], count) if chance() else 0.5
    features: dict[str, Any] = {}
    if chance():
        features["mass"] = rng.choice([0.25, 1.0, 4.0], count)
    if chance():
        features["gravity"] = rng.choice([0.0, -1.0, 0.5], 2)
    if chance():
        # Not much under gravity, under which discs would come to rest on one another: millions of events.
        falls = "gravity" in features
        features["restitution"] = 0.95 if falls else rng.choice([0.5, 0.9])
        features["wall_restitution"] = 1.0 if falls else rng.choice([0.5, 0.9, 1.0])
    if friction:
        features |= any_friction(np.random.default_rng([seed, 80]), count)
    boundary = ["periodic" if wrap and chance(wrap) else "walls" for _ in "xy"]
    area = np.pi * float((np.broadcast_to(radius, count) ** 2).sum())
    side = max(float(np.sqrt(area / rng.choice([0.02, 0.15, 0.4, 0.6]))), 2.5)
    width, height = (np.ceil(side * stretch * 64) / 64 for stretch in rng.choice([(1, 1), (2, 0.5), (1.25, 0.8)]))
    width, height = max(width, 2.5), max(height, 2.5)
    roomy = np.multiply(radius, 1 + 1e-4)  # so that rounding lets none overlap
    seeded = mpsim.Scene.random(
        count=count, width=width, height=height, radius=roomy, seed=seed, boundary=boundary, **features
    )
    places = np.round(seeded.position * 2**20) / 2**20
    return mpsim.Scene(**features_of(seeded) | {"radius": radius, "position": places})


def any_friction(rng: Any, count: int) -> dict[str, Any]:
    """Rough discs, rough walls or both, in a third of the scenes."""
    if rng.random() > 1 / 3:
        return {}
    features: dict[str, Any] = {"tangential_restitution": rng.choice([-1.0, -0.5, 0.0, 0.5, 1.0])}
    for name in ("friction", "wall_friction"):
        features[name] = rng.choice([0.0, 0.25, 3.0, np.inf])
    if rng.random() < 0.7:
        features["spin"] = rng.normal(size=count)
    return features


def typical_time(scene: mpsim.Scene) -> float:
    """A time in which a disc of thermal speed moves one mean distance between discs [time]."""
    speed = float(np.sqrt((scene.velocity**2).sum(axis=1).mean())) or 1.0
    return float(np.sqrt(scene.width * scene.height / scene.count)) / speed
