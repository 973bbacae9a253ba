"""Closed forms and published values, of equilibrium, each with its source.

Discs have mass 1 and restitution 1. kT is the mean square of one velocity component
[length^2/time^2], packing the fraction of the area covered by discs, sigma = 2 radius their diameter. The collision
rate of a gas is per disc and time (a collision counts for both discs); that of two discs alone is per pair and time.
All functions raise an InputError that names the argument and its rule.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.errors import InputError

VIRIAL = (
    1.0,
    4 / 3 - math.sqrt(3) / math.pi,
    2 - 9 * math.sqrt(3) / (2 * math.pi) + 10 / math.pi**2,
    0.33355604,
    0.1988425,
    0.1148728,
    0.0649930,
    0.0362193,
    0.0199537,
)
"""B_k / B_2^(k-1) for k = 2 to 10 [1]. B_2 to B_4 are exact; the others have standard errors of 1e-8, 4.2e-6, 4.3e-6,
3.4e-6, 3.5e-6 and 8.0e-6 (Clisby & McCoy, J. Stat. Phys. 122, 15, 2006, Table 1)."""

LARGEST_PACKING = 0.62
"""The Pade approximant is not used above this packing: the virial series does not show the freezing that begins at
0.70."""


def compressibility(packing: float) -> float:
    """Compressibility factor Z = P A / (N kT) of the bulk fluid [1], accurate to five digits.

    Args:
        packing: 0 <= packing <= LARGEST_PACKING [1].

    Source: [4/5] Pade approximant in the packing of the virial series Z = 1 + sum of VIRIAL_k (2 packing)^(k-1).

    >>> [round(compressibility(packing), 5) for packing in (0.01, 0.1, 0.3, 0.5)]
    [1.02032, 1.23614, 2.06326, 4.10624]
    """
    packing = _packing(packing)
    return 1 + 2 * packing * _at_contact(packing)


def finite_size(packing: float, count: int) -> float:
    """Z of a periodic box of N discs minus that of the bulk fluid, -(packing / 2N) p''/p' with p = packing Z [1].

    To order 1/N, at a fixed number of discs. In a dilute gas it expresses that a disc can meet N - 1 others, not N.

    Args:
        packing: 0 <= packing <= LARGEST_PACKING [1].
        count: number of discs, >= 2.

    Source: Lebowitz & Percus, Phys. Rev. 124, 1673 (1961); derivatives of `compressibility` by differences.

    >>> round(finite_size(0.3, 1024), 6)
    -0.000756
    """
    packing, count = _packing(packing), checks.whole("count", count, 2, 10**9, "Count the discs.")
    step = 1e-3
    places = (packing - step, packing, packing + step)
    low, middle, high = (eta * (1 + 2 * eta * _at_contact(eta)) for eta in places)
    return -packing / (2 * count) * (high - 2 * middle + low) / step**2 / ((high - low) / (2 * step))


def pade(virial: Sequence[float], top: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Numerator and denominator of the [top / K - top] Pade approximant of Z, lowest power of x = 2 packing first [1].

    Args:
        virial: coefficients of x to x^K in the series of Z [1].
        top: degree of the numerator, 0 to K - 1.

    Source: Z = P/Q agrees with the series through x^K, which is a linear system for Q.

    >>> [each.tolist() for each in pade((1.0, 1.0), 1)]  # 1 + x + x^2 is 1 / (1 - x) to this order
    [[1.0, 0.0], [1.0, -1.0]]
    """
    series, order = np.array([1.0, *virial]), len(virial)
    checks.whole("top", top, 0, order - 1, "Half the number of coefficients works well.")
    powers, rows = range(1, order - top + 1), range(top + 1, order + 1)
    matrix = [[series[k - j] if k >= j else 0.0 for j in powers] for k in rows]
    below = np.concatenate([[1.0], np.linalg.solve(np.array(matrix), -series[top + 1 :])])
    return np.convolve(series, below)[: top + 1], below


def enskog_rate(packing: float, radius: float = 0.5, temperature: float = 1.0) -> float:
    """Collisions per disc and time in the bulk, 2 sqrt(pi) n sigma g(sigma) sqrt(kT) [1/time].

    Args:
        packing: 0 <= packing <= LARGEST_PACKING [1].
        radius: > 0 [length].
        temperature: kT >= 0 [length^2/time^2].

    Source: Chapman & Cowling, The Mathematical Theory of Non-uniform Gases (1970), ch. 16, in two dimensions. Exact in
    equilibrium up to terms of order 1/N, since positions and velocities are independent.

    >>> [round(enskog_rate(packing), 5) for packing in (0.01, 0.1, 0.3, 0.5)]
    [0.04585, 0.53292, 2.39952, 7.01004]
    """
    packing, radius = _packing(packing), checks.positive("radius", radius, "[length]")
    temperature = checks.non_negative("temperature", temperature, "[length^2/time^2]")
    density = packing / (math.pi * radius**2)
    return 4 * math.sqrt(math.pi * temperature) * density * radius * _at_contact(packing)


def enskog_diffusion(packing: float, radius: float = 0.5, temperature: float = 1.0) -> float:
    """Diffusion constant of a disc among equal ones, kT / `enskog_rate` [length^2/time], in first Sonine order.

    <v.v(0)> starts at 2 kT, and a collision reduces it by 2 kT on average, so it decays as exp(-rate t) at first. In a
    dilute gas, higher orders add some per cent. In a dense one, successive collisions are correlated, and in two
    dimensions D depends on the size of the box.

    Args:
        packing: 0 < packing <= LARGEST_PACKING [1].
        radius: > 0 [length].
        temperature: kT > 0 [length^2/time^2].

    Source: Gass, J. Chem. Phys. 54, 1898 (1971), in two dimensions.

    >>> [round(enskog_diffusion(packing), 5) for packing in (0.01, 0.1, 0.3)]
    [21.80986, 1.87646, 0.41675]
    """
    packing = checks.positive("packing", packing, "(a fraction of the area)")
    temperature = checks.positive("temperature", temperature, "[length^2/time^2]")
    return temperature / enskog_rate(packing, radius, temperature)


@dataclass(frozen=True)
class TwoDiscs:
    """Two discs in a box with hard walls.

    Attributes:
        phase_area: Omega, configuration integral of both discs [length^4].
        force_x, force_y: mean force on a wall perpendicular to x, and on one perpendicular to y [length/time^2].
        wall_rate: hits of either disc on any wall, per time [1/time].
        pair_rate: collisions of the pair, per time [1/time].
    """

    phase_area: float
    force_x: float
    force_y: float
    wall_rate: float
    pair_rate: float


def two_discs(width: float, height: float, radius: float, energy: float) -> TwoDiscs:
    """Exact averages of two discs in a closed box, kT = energy/2, from their configuration integral.

    Omega = a^2 b^2 - pi sigma^2 a b + 4/3 (a + b) sigma^3 - sigma^4/2 for a = width - sigma, b = height - sigma.

    Args:
        width, height: of the box, >= 2 sigma, so that the discs can pass each other [length].
        radius: > 0 [length].
        energy: kinetic, of both, >= 0 [length^2/time^2].

    Source: force = kT dlnOmega/da; rates from the densities at the walls and at contact, with the mean of |u| of one
    component at fixed energy, 4/(3 pi) sqrt(2 energy) [D]; averages over time equal those over configurations for
    almost all starts, since two discs in a box are ergodic (Simanyi, Ergod. Theory Dyn. Syst. 19, 741, 1999). Opposite
    velocities of equal size, those of `Scene.random(count=2)`, are an exception: the force on the walls of the box
    below is then 5.1. Draw the velocities of both discs independently, and give them to `Scene`.

    >>> found = two_discs(1, 1, 0.2, energy=2)
    >>> round(found.force_x, 6), round(found.wall_rate, 6), round(found.pair_rate, 6)
    (5.641119, 9.576661, 4.155474)
    """
    width, height = checks.positive("width", width, "[length]"), checks.positive("height", height, "[length]")
    sigma = 2 * checks.positive("radius", radius, "[length]")
    energy = checks.non_negative("energy", energy, "[length^2/time^2]")
    if min(width, height) < 2 * sigma:
        raise InputError(
            f"two_discs needs width and height of at least 2 diameters, {2 * sigma:g}; got {width:g} and {height:g}. "
            "Use smaller discs or a larger box."
        )
    a, b = width - sigma, height - sigma
    omega = a**2 * b**2 - math.pi * sigma**2 * a * b + 4 / 3 * (a + b) * sigma**3 - sigma**4 / 2
    by_a = (2 * a * b**2 - math.pi * sigma**2 * b + 4 / 3 * sigma**3) / omega
    by_b = (2 * a**2 * b - math.pi * sigma**2 * a + 4 / 3 * sigma**3) / omega
    by_sigma = (-2 * math.pi * sigma * a * b + 4 * (a + b) * sigma**2 - 2 * sigma**3) / omega
    speed = 4 / (3 * math.pi) * math.sqrt(2 * energy)
    pair_rate = -by_sigma * math.sqrt(2) * speed / 2
    return TwoDiscs(omega, energy / 2 * by_a, energy / 2 * by_b, (by_a + by_b) * speed, pair_rate)


def speed_kurtosis(count: int, *, at_rest: bool = False) -> float:
    """<v^4>/<v^2>^2 of N discs in equilibrium at fixed energy, 2 N/(N + 1) [1]; 2 for a large gas.

    Args:
        count: N >= 1, N >= 2 with `at_rest`.
        at_rest: the total momentum is 0 and conserved, as in a periodic box: 2 (N - 1)/N.

    Source: moments of two components of a vector uniform on a sphere in 2 N, or 2 (N - 1), dimensions [D].

    >>> speed_kurtosis(3), speed_kurtosis(4, at_rest=True)
    (1.5, 1.5)
    """
    count = checks.whole("count", count, 2 if at_rest else 1, 10**9, "Count the discs.")
    free = count - 1 if at_rest else count
    return 2 * free / (free + 1)


def _at_contact(packing: float) -> float:
    """g(sigma) = (Z - 1)/x = (P - Q)/(x Q) for Z = P/Q, at any packing at which the approximant has no pole."""
    above, below = _pade()
    return float(np.polyval(above[::-1], 2 * packing) / np.polyval(below[::-1], 2 * packing))


@cache
def _pade() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(P - Q)/x and Q of the [4/5] Pade approximant Z = P/Q, as polynomials in x = 2 packing."""
    above, below = pade(VIRIAL, 4)
    difference = -below
    difference[: len(above)] += above
    return difference[1:], below


def _packing(value: float) -> float:
    packing = checks.non_negative("packing", value, "(a fraction of the area)")
    if packing > LARGEST_PACKING:
        rule = f"be at most {LARGEST_PACKING} for the virial equation of state"
        instead = "Denser discs are near freezing: compare with published values."
        raise checks.refusal("packing", rule, f"{value!r}", instead)
    return packing
