"""The units of a scene in SI."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mpsim.core import checks
from mpsim.errors import InputError

BOLTZMANN = 1.380649e-23
"""Boltzmann's constant [J/K], exact by the definition of the kelvin (SI brochure, 9th edition, 2019)."""

_POWERS: dict[str, tuple[int, int, int]] = {
    "length": (1, 0, 0),
    "area": (2, 0, 0),
    "mass": (0, 1, 0),
    "time": (0, 0, 1),
    "rate": (0, 0, -1),
    "velocity": (1, 0, -1),
    "acceleration": (1, 0, -2),
    "momentum": (1, 1, -1),
    "force": (1, 1, -2),
    "energy": (2, 1, -2),
    "temperature": (2, 1, -2),
    "pressure": (0, 1, -2),
    "diffusion": (2, 0, -1),
    "viscosity": (0, 1, -1),
    "wave_number": (-1, 0, 0),
    "number_density": (-2, 0, 0),
}
"""Powers of length, mass and time in each quantity."""

_TIME_FROM: dict[str, Callable[[float, float, float], float]] = {
    "time": lambda length, mass, time: time,
    "velocity": lambda length, mass, velocity: length / velocity,
    "acceleration": lambda length, mass, acceleration: math.sqrt(length / acceleration),
    "energy": lambda length, mass, energy: length * math.sqrt(mass / energy),
    "temperature": lambda length, mass, temperature: length * math.sqrt(mass / temperature / BOLTZMANN),
}
"""The unit of time that follows from another unit."""


@dataclass(frozen=True, init=False)
class Units:
    """What the numbers of a scene are in SI: the size of one unit of length, of mass and of time. Immutable.

    mpsim has no units of its own. A scene becomes a physical one when three units are chosen; all others follow.
    Give length, mass, and one of the other five: in SI, what 1 in the scene stands for.

    | quantity | unit in the scene | in SI |
    |---|---|---|
    | length, area | [length], [length^2] | m, m^2 |
    | mass | [mass] | kg |
    | time, rate (of collisions, a spin) | [time], [1/time] | s, 1/s |
    | velocity, acceleration | [length/time], [length/time^2] | m/s, m/s^2 |
    | momentum, force | [mass length/time], [mass length/time^2] | kg m/s, N |
    | energy | [mass length^2/time^2] | J |
    | temperature, which is kT in a scene | [mass length^2/time^2] | K |
    | pressure of two dimensions | [mass/time^2] | N/m = J/m^2 |
    | diffusion (a constant of diffusion) | [length^2/time] | m^2/s |
    | viscosity of two dimensions | [mass/time] | Pa s m |
    | wave_number, number_density | [1/length], [1/length^2] | 1/m, 1/m^2 |

    Args:
        length: one unit of length [m], > 0.
        mass: one unit of mass [kg], > 0.
        time: one unit of time [s], > 0.
        velocity: or one unit of velocity [m/s], > 0.
        acceleration: or one unit of acceleration [m/s^2], > 0: 9.81 where gravity in the scene is (0, -1).
        energy: or one unit of energy [J], > 0.
        temperature: or the temperature at which kT is one unit of energy [K], > 0.

    Attributes:
        length, mass, time: the three units [m], [kg], [s].

    Raises:
        InputError: naming the argument, its rule and the value received.

    >>> grains = Units(length=0.01, mass=0.01, acceleration=9.81)  # of 1 cm and 10 g, under gravity
    >>> round(grains.time, 4), round(grains.in_si("velocity"), 3)
    (0.0319, 0.313)
    >>> argon = Units(length=3.4e-10, mass=6.634e-26, temperature=120.0)
    >>> f"{argon.time:.3g} s", f"{2.5 * argon.in_si('temperature'):.0f} K"
    ('2.15e-12 s', '300 K')
    """

    length: float
    mass: float
    time: float

    def __init__(
        self,
        *,
        length: float,
        mass: float,
        time: float | None = None,
        velocity: float | None = None,
        acceleration: float | None = None,
        energy: float | None = None,
        temperature: float | None = None,
    ):
        length, mass = checks.positive("length", length, "[m]"), checks.positive("mass", mass, "[kg]")
        values = (time, velocity, acceleration, energy, temperature)
        given = {name: value for name, value in zip(_TIME_FROM, values, strict=True) if value is not None}
        if len(given) != 1:
            rule = f"follow from one of {', '.join(_TIME_FROM)}"
            got = " and ".join(given) or "none of them"
            raise checks.refusal("the unit of time", rule, got, "Give one of them, in SI.")
        ((name, value),) = given.items()
        value = checks.positive(name, value, "in SI")
        vars(self).update(length=length, mass=mass, time=_TIME_FROM[name](length, mass, value))
        for quantity in _POWERS:
            if not 0 < (size := self.in_si(quantity)) < math.inf:
                raise InputError(
                    f"length, mass and {name} must give units that fit float64; one unit of {quantity} is {size:g} in "
                    f"SI, with length={length:g}, mass={mass:g} and {name}={value:g}. Give less extreme ones."
                )

    def in_si(self, quantity: str) -> float:
        """One unit of a quantity, in SI: multiply numbers of a scene by it, divide numbers in SI by it.

        Args:
            quantity: as in the table above, such as "velocity".

        Raises:
            InputError: for a quantity that is not in the table.

        >>> Units(length=0.01, mass=0.01, time=1.0).in_si("velocity")
        0.01
        """
        powers = _POWERS[checks.choice("quantity", quantity, _POWERS)]
        with np.errstate(all="ignore"):
            size = float(np.prod(np.array([self.length, self.mass, self.time]) ** np.array(powers, float)))
        return size / BOLTZMANN if quantity == "temperature" else size
