"""A scene in one line, for its repr."""

from typing import Any

import numpy as np

from mpsim.features import FEATURES
from mpsim.features.restitution import Restitution


def brief(scene: Any) -> str:
    """Number of discs, their sizes, the box, and what else the scene has."""
    discs = f"{scene.count} disc{'s' * (scene.count != 1)}"
    if not np.ndim(scene.radius):
        discs += f" of radius {scene.largest_radius:g}"
    elif scene.count:
        discs += f" of radii {scene.radii.min():g} to {scene.radii.max():g}"
    extras = [each.brief(scene) for each in sorted(FEATURES, key=lambda each: each.several)]
    extras += [f"{name} {getattr(scene, name):g}" for name in Restitution.numbers if getattr(scene, name) < 1]
    axes = "".join(axis for axis, wraps in zip("xy", scene.periodic, strict=True) if wraps)
    extras += [f"periodic {axes}"] if axes else []
    low, high = scene.walls_at(0.0)
    size = " x ".join(f"{side:g}" for side in high - low)
    if (high - low).tolist() != [scene.width, scene.height]:
        size += f" of {scene.width:g} x {scene.height:g}"
    return f"<Scene: {discs} in {size}, packing {scene.packing:.3g}{''.join(', ' + text for text in extras if text)}>"
