"""What changes the number of discs in a scene, or their energy: fields, losses, heat baths, moving surfaces."""

# pyright: reportPrivateUsage=false
# Names of Scene that begin with an underscore are for all of mpsim.

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mpsim.features.baths import mean_mass

if TYPE_CHECKING:
    from mpsim.scene.scene import Scene


def _largest(field: NDArray[np.float64] | None) -> float:
    """Largest absolute value of a field; 0 without discs, or without the field."""
    return 0.0 if field is None else float(np.hypot(*np.atleast_2d(field).T).max(initial=0.0))


def gravity_strength(scene: Scene) -> float:
    """|g|; 0 without gravity [length/time^2]."""
    return _largest(scene.gravity)


def acceleration_bound(scene: Scene) -> float:
    """An upper bound: |g| plus the largest acceleration given for a disc [length/time^2]."""
    return gravity_strength(scene) + _largest(scene.acceleration)


def strongest_field(scene: Scene) -> float:
    """The larger of |g| and the largest acceleration given for a disc: a scale, not a bound [length/time^2]."""
    return max(gravity_strength(scene), _largest(scene.acceleration))


def has_body_force(scene: Scene) -> bool:
    """Whether the scene gives gravity, or accelerations of the discs, even if they are zero."""
    return scene.gravity is not None or scene.acceleration is not None


def is_inelastic(scene: Scene) -> bool:
    """Whether a restitution below 1 takes energy, in contacts of two discs or of a disc with anything else."""
    has_surfaces = not all(scene.periodic) or any(each.excludes for each in scene._features)
    return scene.restitution < 1 or (scene.wall_restitution < 1 and has_surfaces)


def has_losses(scene: Scene) -> bool:
    """Whether contacts take energy from the motion of the discs."""
    return is_inelastic(scene) or any(feature.dissipates(scene) for feature in scene._features)


def is_heated(scene: Scene) -> bool:
    """Whether a thermostat or a thermal wall changes the energy of discs."""
    return any(each.heats for each in scene._features)


def thermal_speed(scene: Scene) -> float:
    """Speed along one axis that thermostats and thermal walls give to discs; 0 without any [length/time]."""
    return max((each.thermal_speed(scene) for each in scene._features), default=0.0)


def memory_of_baths(scene: Scene, temperature: float) -> float:
    """Time in which heat baths exchange the energy of a gas, at least; inf without any [time].

    Where contacts lose energy, a gas at T in a bath at B relaxes faster: they lose ~ T^(3/2), which balances the bath.

    Args:
        scene: the scene.
        temperature: kT of the gas, > 0 [mass length^2/time^2].
    """
    rate = sum(each.exchange_rate(scene, temperature) for each in scene._features)
    if has_losses(scene):
        rate *= max(1.5 * mean_mass(scene) * thermal_speed(scene) ** 2 / temperature - 0.5, 1.0)
    return 1 / rate if rate else float("inf")


def adds_discs(scene: Scene) -> bool:
    """Whether discs enter while the scene runs."""
    return any(each.adds_discs for each in scene._features)


def removes_discs(scene: Scene) -> bool:
    """Whether discs may leave while the scene runs."""
    return any(each.removes_discs for each in scene._features)


def conserves_energy(scene: Scene) -> bool:
    """Whether the kinetic energy is constant: no fields, moving walls, heating or losses, always the same discs."""
    driven = acceleration_bound(scene) > 0 or any(each.works(scene) for each in scene._features) or has_losses(scene)
    return not driven and not is_heated(scene) and not adds_discs(scene) and not removes_discs(scene)
