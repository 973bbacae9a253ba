"""Baths: a thermostat, and walls at a temperature."""

# pyright: reportPrivateUsage=false
# Names of Scene that begin with an underscore are for all of mpsim.

from __future__ import annotations

import math
from dataclasses import dataclass
from decimal import Decimal, localcontext
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.errors import InputError
from mpsim.features.edges import EDGES, demand_wall
from mpsim.features.feature import Feature, Invalidation, mean_mass
from mpsim.kernels.records import THERMAL_WALLS, THERMOSTAT

if TYPE_CHECKING:
    from mpsim.scene.scene import Scene

# --- A thermostat: discs get new velocities at random, drawn from the Maxwell distribution at a temperature

MOST_SEED = 2**63 - 1

DRIFTS = ("energy_drift", "momentum_drift")
CONSTANT = "Measure 'temperature' or 'kinetic_energy', which should be constant on average."


@dataclass(frozen=True)
class Thermostat:
    """The thermostat of Andersen (J. Chem. Phys. 72, 2384, 1980): discs exchange energy with a heat bath.

    Between two frames each disc gets, with probability 1 - exp(-rate dt), a new velocity from the Maxwell distribution
    at the temperature: each component is normally distributed with variance temperature / mass. So the mean energy of
    an elastic gas relaxes to that of the temperature as exp(-rate t), and momentum is not conserved. Spins stay. Where
    collisions take energy, results depend on dt also with method `event`: take dt well below 1/rate.

    Args:
        temperature: kT of the bath, the mean of m v_x^2 [mass length^2/time^2], > 0.
        rate: new velocities per disc and time [1/time], > 0.
        seed: of the random numbers, >= 0. They depend only on the seed, the number of the disc and that of the frame:
            runs of other starts need other seeds to be independent, such as those of `Scene.redrawn`.

    Raises:
        InputError: naming the argument, its rule and the value received.

    >>> Thermostat(temperature=2, rate=0.5)
    Thermostat(temperature=2.0, rate=0.5, seed=0)
    """

    temperature: float
    rate: float
    seed: int = 0

    def __post_init__(self) -> None:
        checks.keep_fields(self, temperature="[mass length^2/time^2]", rate="[1/time]", seed=check_seed)


def check_seed(name: str, seed: Any) -> int:
    """A seed of random numbers; None, as in a file without one, is 0."""
    return checks.whole(name, 0 if seed is None else seed, 0, MOST_SEED, "Any whole number will do.")


def probability_of(thermostat: Thermostat, dt: float) -> float:
    """Of a new velocity in a frame of length dt [time], 1 - exp(-rate dt), to the same bits on every machine."""
    with localcontext(prec=40):
        number = Decimal(thermostat.rate) * Decimal(dt)
        return float(1 - (-number).exp() if number > Decimal("1e-20") else number)


class ThermostatFeature(Feature):
    """The argument `thermostat`."""

    argument = "thermostat"
    kinds: ClassVar[tuple[type[Any], ...]] = (Thermostat,)
    several: ClassVar[bool | None] = False
    examples: ClassVar[tuple[Any, ...]] = (Thermostat(temperature=1.0, rate=1.0),)
    drives = "a thermostat"
    draws = True
    heats = True
    on_tiles = False
    invalidates: ClassVar[tuple[Invalidation, ...]] = (
        Invalidation(DRIFTS, "a thermostat, which changes energy and momentum", CONSTANT),
        Invalidation(
            ("pressure_virial",),
            "a thermostat, as the virial takes the kinetic energy for constant",
            "Use 'pressure_xx' and 'pressure_yy', which sample it.",
        ),
    )

    def works(self, scene: Scene) -> tuple[int | str, ...]:
        return ("thermostat",)

    def arrays(self, scene: Scene, real: np.dtype) -> dict[str, NDArray[Any]]:
        return {"thermostat": np.zeros((), THERMOSTAT)}

    def begin(self, scene: Scene, arrays: dict[str, Any], dt: float, origin: tuple[int, float]) -> None:
        thermostat, record = self.of(scene), arrays["thermostat"]
        record.probability, record.temperature = probability_of(thermostat, dt), thermostat.temperature
        record.seed, record.first_frame = thermostat.seed, origin[0]

    def thermal_speed(self, scene: Scene) -> float:
        return math.sqrt(self.of(scene).temperature / mean_mass(scene))

    def exchange_rate(self, scene: Scene, temperature: float) -> float:
        return float(self.of(scene).rate)

    def description(self, scene: Scene) -> str:
        thermostat: Thermostat = self.of(scene)
        return f"temperature {thermostat.temperature:g}, rate {thermostat.rate:g}, seed {thermostat.seed}"


# --- Thermal walls: edges of the box at a temperature, which discs leave with new velocities. Checked when made


@dataclass(frozen=True)
class ThermalWalls:
    """Walls of the box that are heat baths: a disc that hits one gets a new velocity, independent of its old one.

    At the temperature T of a wall, the speed v along its normal has the density (m v / T) exp(-m v^2 / 2T), that of
    discs that cross a line in equilibrium; the velocity along the wall is Gaussian, of variance T / m (Lebowitz and
    Spohn, J. Stat. Phys. 19, 633, 1978). So a gas between walls at one temperature reaches that temperature, and heat
    flows between walls at different ones. Restitution and friction do not act at such walls.

    Args:
        left, right, bottom, top: kT of this wall [mass length^2/time^2], > 0; None: the wall is not thermal.
        seed: of the random numbers, >= 0. They depend only on the seed, the disc, and its position and velocity at the
            contact.

    Raises:
        InputError: naming the argument, its rule and the value received; if no temperature is given.

    >>> ThermalWalls(left=1, right=4)
    ThermalWalls(left=1.0, right=4.0, bottom=None, top=None, seed=0)
    """

    left: float | None = None
    right: float | None = None
    bottom: float | None = None
    top: float | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        checks.keep_fields(self, **dict.fromkeys(EDGES, "[mass length^2/time^2]"), seed=check_seed)
        if not self.temperatures:
            raise InputError(
                "ThermalWalls must have a temperature for left, right, bottom or top; got none. Give one, or no walls."
            )

    @property
    def temperatures(self) -> dict[str, float]:
        """Of each thermal wall, by its edge [mass length^2/time^2]."""
        return {edge: value for edge in EDGES if (value := getattr(self, edge)) is not None}

    @property
    def by_edge(self) -> tuple[float, ...]:
        """Temperature of each edge, in the order left, right, bottom, top; 0 of one that is not thermal."""
        return tuple(self.temperatures.get(edge, 0.0) for edge in EDGES)


class ThermalWallsFeature(Feature):
    """The argument `thermal_walls`."""

    argument = "thermal_walls"
    kinds: ClassVar[tuple[type[Any], ...]] = (ThermalWalls,)
    several: ClassVar[bool | None] = False
    examples: ClassVar[tuple[Any, ...]] = (ThermalWalls(left=1.0),)
    draws = True
    heats = True
    invalidates: ClassVar[tuple[Invalidation, ...]] = (
        Invalidation(DRIFTS, "thermal walls, which change energy and momentum", CONSTANT),
        Invalidation(
            ("pressure_virial",),
            "thermal walls, as the virial takes the kinetic energy for constant",
            "Use 'pressure', the impulses on the walls.",
        ),
    )

    def check(self, scene: Scene) -> None:
        walls: ThermalWalls = self.of(scene)
        moving = {EDGES[wall.edge]: wall.name for wall in scene._moving_walls}
        for edge in walls.temperatures:
            demand_wall("thermal_walls", edge, scene.boundary)
            if edge in scene.absorbing:
                raise InputError(f"thermal_walls must not be absorbing edges; got {edge!r} for both. Choose one.")
            if edge in moving:
                raise InputError(
                    f"thermal_walls must be at rest; got {edge!r}, which the {moving[edge]} moves. Choose another wall."
                )
        if scene.wall_friction > 0:
            raise InputError(
                "wall_friction must be 0 in a scene with thermal_walls, which give discs new tangential velocities; "
                f"got {scene.wall_friction:g}. Leave one of them out."
            )

    def works(self, scene: Scene) -> tuple[int | str, ...]:
        return tuple(self.of(scene).temperatures)

    def arrays(self, scene: Scene, real: np.dtype) -> dict[str, NDArray[Any]]:
        return {"thermal_walls": np.array((self.of(scene).by_edge, self.of(scene).seed), THERMAL_WALLS)}

    def thermal_speed(self, scene: Scene) -> float:
        return math.sqrt(max(self.of(scene).temperatures.values()) / mean_mass(scene))

    def exchange_rate(self, scene: Scene, temperature: float) -> float:
        """3/2 of the hits per disc, because a disc leaves the wall with 3/2 kT on average; for a uniform temperature.

        Excluded area makes hits more frequent, by some 1 / (1 - packing)^2 (scaled particle theory).
        """
        walls: ThermalWalls = self.of(scene)
        covered = float((math.pi * scene.radii**2).sum()) / (scene.width * scene.height)
        lengths = [scene.width if edge in ("left", "right") else scene.height for edge in walls.temperatures]
        hits = sum(1 / max(length - 2 * scene.largest_radius, 1e-3 * length) for length in lengths)
        return 1.5 * hits * math.sqrt(temperature / (2 * math.pi * mean_mass(scene))) / max(1 - covered, 0.1) ** 2

    def description(self, scene: Scene) -> str:
        walls: ThermalWalls = self.of(scene)
        return ", ".join([*(f"{edge} {value:g}" for edge, value in walls.temperatures.items()), f"seed {walls.seed}"])
