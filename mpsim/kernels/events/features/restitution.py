"""Restitution: impacts that lose energy, and the guard that ends inelastic collapse (the TC model).

An impact loses no energy if one of its discs had its last contact less than the contact time ago (Luding and
McNamara, Granular Matter 1, 113, 1998). `counter.guarded` counts how often.
"""

from typing import Any

from mpsim.kernels.compiling import inlined
from mpsim.kernels.events.features.gravity import component
from mpsim.kernels.events.records import counts


def restitution_of(scene: Any) -> float | None:
    """Of two discs."""
    return scene.restitution if scene.restitution < 1 else None


def wall_restitution_of(scene: Any) -> float | None:
    """Of a disc and a wall."""
    return scene.wall_restitution if scene.wall_restitution < 1 else None


FIELDS = {"restitution": restitution_of, "wall_restitution": wall_restitution_of, "contact_time": None}
"""contact_time [time]: of the guard, > 0 where there is gravity or any restitution is below 1."""


@inlined
def effective_restitution(restitution, last_contact, now, contact_time, store):
    """The restitution of one impact, 1 if the guard acts."""
    if restitution is None:
        return 1.0
    if now - last_contact < contact_time and restitution < 1.0:
        store.counter.guarded += counts(store.region)
        return 1.0
    return restitution


@inlined
def speed_off_wall(gravity, speed, axis, inward, contact_time, store):
    """Speed inward after a bounce: never so small that gravity brings the disc back in less than `contact_time`.

    A disc at rest on a wall makes small bounces of that duration, at most g contact_time^2/8 high, and the guard counts
    them. Without this it would hit the wall infinitely often in a finite time.
    """
    if gravity is None:
        return speed
    return fast_enough(speed, inward * component(gravity, axis), contact_time, store)


@inlined
def speed_off(speed, nx, ny, last_contact, now, features, store):
    """Speed at which a disc leaves a fixed surface after it hit it at such a speed, along the unit vector n from it."""
    e = effective_restitution(features.wall_restitution, last_contact, now, features.contact_time, store)
    if features.gravity is None:
        return e * speed
    pull = nx * component(features.gravity, 0) + ny * component(features.gravity, 1)
    return fast_enough(e * speed, pull, features.contact_time, store)


@inlined
def fast_enough(speed, pull, contact_time, store):
    """A speed, but at least that of a bounce of duration `contact_time` under an acceleration `pull` outward."""
    least = -0.5 * pull * contact_time
    if speed < least:
        store.counter.guarded += counts(store.region)
        return least
    return speed
