"""Friction in the exact solver: the law of Walton and Braun (J. Rheol. 30, 949, 1986) at an impact.

Written for itself: it shares nothing with that of the stepped solvers. Uniform discs have the moment of inertia
m a^2 / 2, so that a tangential impulse J changes the slip of the surfaces by 3 J / m_eff.
"""

import math

from mpsim.kernels.compiling import inlined
from mpsim.kernels.events.cells import value_of
from mpsim.kernels.events.state import VX, VY


@inlined
def tangential_impulse(law, slip, mass, normal_impulse):
    """Impulse against the slip [mass length/time]; mass: the effective one."""
    sticking = (1.0 + law[1]) * mass * abs(slip) / 3.0
    return -math.copysign(min(sticking, law[0] * normal_impulse), slip)


@inlined
def rub_discs(law, i, j, rx, ry, normal_impulse, store, box):
    """Friction of discs i and j, r = r_i - r_j apart; law: (coefficient, tangential restitution) or None."""
    if law is not None:
        disc, spin = store.disc, store.spin
        distance = math.sqrt(rx * rx + ry * ry)
        tx, ty = -ry / distance, rx / distance
        mass_i, mass_j = value_of(store.mass, 1.0, i), value_of(store.mass, 1.0, j)
        radius_i, radius_j = value_of(store.radius, box.radius, i), value_of(store.radius, box.radius, j)
        slip = (disc[i, VX] - disc[j, VX]) * tx + (disc[i, VY] - disc[j, VY]) * ty
        slip -= radius_i * spin[i] + radius_j * spin[j]
        impulse = tangential_impulse(law, slip, mass_i * mass_j / (mass_i + mass_j), normal_impulse)
        disc[i, VX] += impulse / mass_i * tx
        disc[i, VY] += impulse / mass_i * ty
        disc[j, VX] -= impulse / mass_j * tx
        disc[j, VY] -= impulse / mass_j * ty
        spin[i] -= 2.0 * impulse / (mass_i * radius_i)
        spin[j] -= 2.0 * impulse / (mass_j * radius_j)


@inlined
def rub_wall(law, i, axis, inward, pressed, store, box):
    """Friction of disc i on a wall at right angles to an axis, which has changed its velocity inward by `pressed`."""
    if law is not None:
        disc, spin = store.disc, store.spin
        radius = value_of(store.radius, box.radius, i)
        along = 1 - axis
        turn = inward if axis == 0 else -inward  # the tangent, the inward normal turned left, points along turn
        slip = turn * disc[i, VX + along] - radius * spin[i]
        impulse = tangential_impulse(law, slip, 1.0, max(pressed, 0.0))
        disc[i, VX + along] += turn * impulse
        spin[i] -= 2.0 * impulse / radius
