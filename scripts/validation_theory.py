"""Expected numbers of run_validation.py: kinetic theory, corrections for few discs, chi^2.

Discs have mass 1, radius 1/2 and mean square 1 of one velocity component; periodic boxes are at rest.
"""

import math

import numpy as np
from numpy.polynomial.hermite_e import hermegauss
from numpy.polynomial.laguerre import laggauss
from numpy.typing import NDArray

from mpsim.measure import Measure, reference

Floats = NDArray[np.float64]

VIRIAL_ERRORS = (0.0, 0.0, 0.0, 1e-8, 4.2e-6, 4.3e-6, 3.4e-6, 3.5e-6, 8.0e-6)
"""Standard errors of reference.VIRIAL, from the same table."""

SONINE = 8
"""Polynomials in which distributions of velocities are expanded; the diffusion constant then has six digits."""


def compressibility(virial: Floats, packing: float, top: int) -> float:
    """Z by the [top / 9 - top] Pade approximant of a series."""
    above, below = reference.pade(virial.tolist(), top)
    return float(np.polyval(above[::-1], 2 * packing) / np.polyval(below[::-1], 2 * packing))


def bulk(packing: float) -> Measure:
    """Z of infinitely many discs from nine virial coefficients.

    Its error has a part from that of each coefficient, and the difference of the [4/5] and [5/4] approximants for the
    coefficients that are not known.
    """
    virial = np.array(reference.VIRIAL)
    value = compressibility(virial, packing, 4)
    parts = [value - compressibility(virial, packing, 5)]
    for index, error in enumerate(VIRIAL_ERRORS):
        other = virial.copy()
        other[index] += error
        parts.append(compressibility(other, packing, 4) - value)
    return Measure(value, float(np.linalg.norm(parts)), 1)


def third_moment(degrees: int) -> float:
    """Mean |u|^3 of one velocity component at fixed energy of so many degrees of freedom, over that of a Maxwellian."""
    half = degrees / 2
    return math.exp(1.5 * math.log(half) + math.lgamma(half) - math.lgamma(half + 1.5))


def transfer_rate(packing: float, count: int) -> float:
    """-d ln <v(t).v(0)> / dt at t = 0 in a periodic gas of N discs at rest [1/time].

    Enskog's collision rate, which is exact at this order; for N discs the density at contact is that of Z_N, and
    relative velocities have the third moment of a fixed energy.
    """
    temperature, bulk_part = count / (count - 1), reference.compressibility(packing) - 1
    contact = 1 + reference.finite_size(packing, count) / bulk_part
    return reference.enskog_rate(packing) * temperature**1.5 * third_moment(2 * (count - 1)) * contact


def collision_operator() -> Floats:
    """How collisions with a Maxwell gas change the velocity of one disc, in units of the collision rate.

    Matrix of the linearised Enskog operator between the functions v L_k^(1)(v^2 / 2), normalised; shape (SONINE,
    SONINE). In a collision equal discs exchange their components along the line of centres (a, b), and c is kept. With
    s = (a - b)/sqrt(2), the rate is proportional to |s|.
    """
    s2, s_weight = laggauss(2 * SONINE + 2)
    nodes, weights = hermegauss(2 * SONINE + 2)
    s = np.sqrt(2 * s2)[:, None, None]
    mean, c = nodes[None, :, None], nodes[None, None, :]
    a, b = (mean + s) / math.sqrt(2), (mean - s) / math.sqrt(2)
    weight = s_weight[:, None, None] * weights[None, :, None] * weights[None, None, :]
    weight = weight / weight.sum()
    before, after = (_sonine((x * x + c * c) / 2) for x in (a, b))
    along, across = before * a - after * b, (before - after) * c
    found = sum(np.einsum("iabc,jabc,abc->ij", part, part, weight) for part in (along, across))
    norm = np.sqrt(2.0 * np.arange(1, SONINE + 1))
    return found / 2 / np.outer(norm, norm)


def _sonine(x: Floats) -> Floats:
    """L_k^(1)(x) for k < SONINE, one more axis in front."""
    found = [np.ones_like(x), 2 - x]
    for k in range(1, SONINE - 1):
        found.append(((2 * k + 2 - x) * found[k] - (k + 1) * found[k - 1]) / (k + 1))
    return np.array(found)


def decay(collisions: float) -> float:
    """<v(t).v(0)> / <v^2> after so many collisions per disc in a dilute gas, by Boltzmann's equation."""
    rates, vectors = np.linalg.eigh(collision_operator())
    return float((vectors[0] ** 2 * np.exp(-rates * collisions)).sum())


def diffusion_factor() -> float:
    """Diffusion constant of a dilute gas over that of first Sonine order."""
    return float(np.linalg.inv(collision_operator())[0, 0])


def haff_rate(packing: float, count: int, restitution: float) -> float:
    """d(T^-1/2)/dt of a cooling gas of N discs, T the mean square of one velocity component [1/length].

    Haff's law with the collision rate of Enskog and the kurtosis a_2 of the cooling gas (van Noije & Ernst, Granular
    Matter 1, 57, 1998) in two dimensions.
    """
    e, d = restitution, 2
    kurtosis = 16 * (1 - e) * (1 - 2 * e**2) / (9 + 24 * d + (8 * d - 41) * e + 30 * (1 - e) * e**2)
    return (1 - e**2) / 4 * transfer_rate(packing, count) * (1 + 3 / 16 * kurtosis)


def chi2_probability(chi2: float, degrees: int) -> float:
    """Probability that chi^2 of so many degrees of freedom is at least as large.

    >>> round(chi2_probability(3.841, 1), 3), round(chi2_probability(18.307, 10), 3)
    (0.05, 0.05)
    """
    half, term = chi2 / 2, degrees % 2 / 2
    found = math.erfc(math.sqrt(half)) if degrees % 2 else 0.0
    while term < degrees / 2:
        found += math.exp(-half + (term * math.log(half) if term else 0.0) - math.lgamma(term + 1))
        term += 1
    return found
