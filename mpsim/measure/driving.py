"""What gives the discs of a scene energy, and what takes it: fields, walls that move, discs that enter, losses."""

import numpy as np
from numpy.typing import NDArray

from mpsim.scene.scene import Scene


def _largest(field: NDArray[np.float64] | None) -> float:
    """Largest size of the rows of a field; 0 without rows, or without the field."""
    return 0.0 if field is None else float(np.hypot(*np.atleast_2d(field).T).max(initial=0.0))


def gravity_strength(scene: Scene) -> float:
    """|g|; 0 without gravity [length/time^2]."""
    return _largest(scene.gravity)


def acceleration_bound(scene: Scene) -> float:
    """What the acceleration of no disc exceeds: |g| plus the largest acceleration of a disc [length/time^2]."""
    return gravity_strength(scene) + _largest(scene.acceleration)


def strongest_field(scene: Scene) -> float:
    """The larger of |g| and the largest acceleration of a disc [length/time^2]: a scale, no bound, where both act."""
    return max(gravity_strength(scene), _largest(scene.acceleration))


def has_fields(scene: Scene) -> bool:
    """Whether discs have gravity or accelerations of their own, be they zero."""
    return scene.gravity is not None or scene.acceleration is not None


def has_losses(scene: Scene) -> bool:
    """Whether contacts lose energy, between discs or with a wall."""
    return scene.restitution < 1 or (scene.wall_restitution < 1 and not all(scene.periodic))


def conserves_energy(scene: Scene) -> bool:
    """Whether the kinetic energy changes by nothing that the scene has: a gas left to itself."""
    driven = acceleration_bound(scene) > 0 or scene.moving_wall is not None or bool(scene.emitters)
    return not driven and not has_losses(scene) and not scene.absorbing
