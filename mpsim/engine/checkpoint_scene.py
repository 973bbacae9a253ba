"""The scene of a checkpoint: plain values in its header, and arrays."""

import dataclasses
from typing import Any

import numpy as np

from mpsim.core.archive import Arrays
from mpsim.features import FEATURES, NUMBERS, PER_DISC, VECTORS
from mpsim.scene.scene import Scene
from mpsim.scene.settings import settings_from

OF_LATTICE = ("count", "temperature", "seed")
"""Numbers of a lattice that are written beside what other scenes have too."""

ARRAYS = ("position", "velocity", *PER_DISC, *VECTORS)
"""Arrays that a scene may have."""


def scene_parts(scene: Scene) -> tuple[dict[str, Any], Arrays]:
    """A scene as plain values and arrays, exact to the bit; a lattice as the numbers that it is made of."""
    plain: dict[str, Any] = {
        name: getattr(scene, name) for name in ("width", "height", "restitution", "wall_restitution", "boundary")
    }
    lattice = scene.on_lattice
    names = ARRAYS if lattice is None else (*PER_DISC, *VECTORS)
    arrays = {name: np.asarray(value) for name in names if (value := getattr(scene, name)) is not None}
    given = [each for each in FEATURES if not each.is_numeric and each.argument in vars(scene)]
    plain |= {feature.argument: feature.to_plain(scene) for feature in given}
    plain |= {name: value for name, (default, _) in NUMBERS.items() if (value := getattr(scene, name)) != default}
    if scene.duration is not None:
        plain["duration"] = scene.duration
    if scene.settings is not None:
        plain["settings"] = dataclasses.asdict(scene.settings)
    plain |= {name: value for name in ("picture_interval", "measures") if (value := getattr(scene, name))}
    if lattice is not None:
        plain["lattice"] = {name: getattr(lattice, name) for name in OF_LATTICE} | {"digest": lattice.digest_of_some()}
    return plain, arrays


def scene_from(plain: dict[str, Any], arrays: Arrays) -> Scene:
    """The scene from its plain values and arrays, as `scene_parts` returns them.

    Raises:
        ValueError, or what else a scene raises that is given other values than those.
    """
    values: dict[str, Any] = {
        **plain,
        **{name: value if value.ndim else value.item() for name, value in arrays.items()},
    }
    given = [each for each in FEATURES if not each.is_numeric and each.argument in plain]
    values |= {each.argument: each.from_plain(plain[each.argument]) for each in given}
    if "settings" in values:
        values["settings"] = settings_from(values["settings"])
    lattice = values.pop("lattice", None)
    return Scene(**values) if lattice is None else _on_lattice(lattice, values)


def _on_lattice(lattice: dict[str, Any], values: dict[str, Any]) -> Scene:
    """The scene whose discs start on a lattice, of which OF_LATTICE and a digest are given, with its other values."""
    if not isinstance(lattice, dict) or lattice.keys() != {*OF_LATTICE, "digest"}:
        raise ValueError(f"its lattice must have {', '.join(OF_LATTICE)} and digest; got {lattice!r:.60}")
    scene = Scene.lattice(**{name: lattice[name] for name in OF_LATTICE}, **values)
    start = scene.on_lattice
    if start is None or start.digest_of_some() != lattice["digest"]:
        raise ValueError("its lattice has other discs here: another version of NumPy has drawn other random numbers")
    return scene
