"""Gravity: one acceleration for all discs, so that their relative motion stays uniform."""

from typing import Any

from mpsim.kernels.compiling import inlined


def gravity_of(scene: Any) -> tuple[float, float] | None:
    """(gx, gy) [length/time^2]."""
    return None if scene.gravity is None else tuple(scene.gravity.tolist())


FIELDS = {"gravity": gravity_of}


@inlined
def component(gravity, axis):
    """One component of the acceleration [length/time^2]."""
    if gravity is None:
        return 0.0
    return gravity[axis]
