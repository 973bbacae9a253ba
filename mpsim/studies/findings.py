"""What named scenes should show in their recommended runs: expected and found numbers."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.engine.observers import Collisions
from mpsim.engine.simulation import Simulation
from mpsim.features.feature import gravity_strength
from mpsim.measure.reference import compressibility, enskog_rate
from mpsim.scene.scene import Scene, frames_between_pictures, settings_for
from mpsim.scene.settings import Settings


@dataclass(frozen=True)
class Finding:
    """One number that a scene shows: expected and found.

    Attributes:
        what: the number, with its dimensions.
        expected: from theory or from what enters the scene.
        found: in the run.
        within: largest difference that is consistent, in the unit of the number.
        source: where the expected number comes from.

    >>> Finding("collisions [1]", 314, 314, 0, "digits of pi").consistent
    True
    """

    what: str
    expected: float
    found: float
    within: float
    source: str

    @property
    def consistent(self) -> bool:
        """Whether the two agree."""
        return bool(abs(self.found - self.expected) <= self.within)


class Promise:
    """What one scene shows. An observer of a run that begins at frame 0 and lasts as long as the scene recommends."""

    def __init__(self, scene: Scene, settings: Settings):
        self.scene: Scene = scene
        self.every: int = frames_between_pictures(scene, settings) or 1
        self.observers: list[Any] = [self]
        self._times: list[float] = []
        self._values: list[Any] = []

    def observe(self, sim: Simulation, collisions: int) -> None:
        """Keep one value of the simulation; collisions: since the last look, not used."""
        self._times.append(sim.time)
        self._values.append(self.value(sim))

    @property
    def series(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Times, shape (n,) [time], and the values recorded at them, shape (n,) or (n, 2)."""
        return np.array(self._times), np.array(self._values, np.float64)

    def value(self, sim: Simulation) -> Any:
        """The value to record at each sample."""
        return sim.time

    def findings(self, sim: Simulation) -> list[Finding]:
        """The findings at the end of the run."""
        raise NotImplementedError


class Pi(Promise):
    """The collisions of the scene `pi`, counted."""

    def __init__(self, scene: Scene, settings: Settings):
        super().__init__(scene, settings)
        self._bounces = Collisions(every=10**9)
        self.observers: list[Any] = [self._bounces]

    def findings(self, sim: Simulation) -> list[Finding]:
        light, heavy = self.scene.masses
        digits = math.floor(math.pi * math.sqrt(heavy / light))
        found = float(len(self._bounces.table))
        return [Finding("collisions of discs and with the wall [1]", digits, found, 0, "digits of pi: Galperin 2003")]


class Galton(Promise):
    """The heap of the scene `galton`."""

    def findings(self, sim: Simulation) -> list[Finding]:
        limit = sum(emitter.limit or 0 for emitter in self.scene.emitters)
        x = self.binned(sim)
        counts, curve = self.heap(x)
        off = float(np.abs(counts - curve).sum() / 2 / len(x))
        fastest = float(np.abs(sim.state.velocity).max())
        return [
            Finding("balls in the bins [1]", limit, float(len(x)), 0, "what the emitters let in"),
            Finding("speed of the fastest ball [length/time]", 0.0, fastest, 1.0, "almost all have come to rest"),
            Finding("middle of the heap [length]", self.scene.width / 2, float(x.mean()), 0.7, "symmetry"),
            Finding("balls beside the binomial curve [fraction]", 0.0, off, 0.15, "binomial of the same width"),
        ]

    @staticmethod
    def binned(sim: Simulation) -> NDArray[np.floating]:
        """Positions of the balls in the bins, shape (n,) [length]."""
        x, y = sim.state.position[~sim.absorbed].T
        return x[y < 6]

    def heap(self, x: NDArray[np.floating]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Balls in each bin, one wide, and an even binomial distribution with the same spread; shape (width,) each."""
        counts, _ = np.histogram(x, np.arange(0, self.scene.width + 1))
        spread = float(x.std())
        steps = round(4 * spread**2)
        places = np.arange(steps + 1)
        logs = np.array([math.lgamma(steps + 1) - math.lgamma(k + 1) - math.lgamma(steps - k + 1) for k in places])
        binomial = np.exp(logs - steps * math.log(2))
        cells = np.floor(places - steps / 2 + self.scene.width / 2).astype(int)
        curve = np.bincount(np.clip(cells, 0, len(counts) - 1), binomial, len(counts)) * float(len(x))
        return counts, np.asarray(curve, np.float64)


class Growth(Promise):
    """The discs that the scene `growth` lets in."""

    def findings(self, sim: Simulation) -> list[Finding]:
        let_in = sum(emitter.limit or 0 for emitter in self.scene.emitters)
        squares = float((self.scene.velocity**2).sum())
        squares += sum((each.limit or 0) * float(np.sum(np.square(each.velocity))) for each in self.scene.emitters)
        energy, found = squares / 2, float((sim.state.velocity**2).sum()) / 2
        name = "kinetic energy at the end [mass length^2/time^2]"
        return [
            Finding("discs [1]", let_in + self.scene.count, sim.count, 0, "the first one and the emitters' limits"),
            Finding(name, energy, found, 1e-6 * energy, "that of what came in"),
        ]


class Hopper(Promise):
    """The steady flow of the hoppers."""

    STEADY = 2.0

    def value(self, sim: Simulation) -> float:
        image = sim.state.image
        assert image is not None
        return -float(image[:, 1].sum())

    def findings(self, sim: Simulation) -> list[Finding]:
        times, passed = self.series
        times, passed = times[times >= self.STEADY], passed[times >= self.STEADY]
        middle = len(times) // 2
        early = float((passed[middle] - passed[0]) / (times[middle] - times[0]))
        late = float((passed[-1] - passed[middle]) / (times[-1] - times[middle]))
        flow, law = (early + late) / 2, self.beverloo()
        steady = Finding("flow, second half of the run [1/time]", early, late, 0.15 * early, "the first half")
        what = "grains per time [1/time]"
        if self.scene.friction > 0:
            return [Finding(what, law, flow, 0.35 * law, "Beverloo's law of a slot"), steady]
        most = self.torricelli()
        source = f"middle of {law:.4g}, Beverloo's law for rough grains, and {most:.4g}, Torricelli's for a fluid"
        return [Finding(what, (law + most) / 2, flow, (most - law) / 2, source), steady]

    @property
    def _funnel(self) -> tuple[float, float, float, float]:
        """Gap of the funnel, its depth from the rim to the gap, diameter of grains, and their number to the area."""
        capsules = self.scene.capsules_at(0.0)
        left, right = capsules[0, [0, 2]].max(), capsules[-1, [0, 2]].min()
        heights = capsules[0, [1, 3]]
        diameter = 2 * self.scene.largest_radius
        packed = 0.8 / (math.pi * diameter**2 / 4)
        return right - left - 2 * float(capsules[0, 4]), float(np.ptp(heights)), diameter, packed

    def beverloo(self) -> float:
        """1.03 n sqrt(g) (D - 1.4 d)^(3/2) for a gap D and grains d wide, n to the area (Nedderman 1992) [1/time]."""
        gap, _, diameter, packed = self._funnel
        return 1.03 * packed * math.sqrt(gravity_strength(self.scene)) * (gap - 1.4 * diameter) ** 1.5

    def torricelli(self) -> float:
        """n (D - d) sqrt(2 g h): all centres that fit fall through from the top of the heap, without loss [1/time].

        h is the height over the gap to which all grains fill the funnel, and the box above it.
        """
        gap, depth, diameter, packed = self._funnel
        above = self.scene.count / packed - depth * (gap + self.scene.width) / 2
        height = depth + above / self.scene.width
        return packed * (gap - diameter) * math.sqrt(2 * gravity_strength(self.scene) * height)


class Brownian(Promise):
    """The path of the large disc of the scene `brownian`: `series`, shape (n, 2) [length]."""

    LAG = 10.0

    def value(self, sim: Simulation) -> NDArray[np.floating]:
        return sim.state.position[0]

    def diffusion(self) -> float:
        """Of one large disc among small ones at temperature 1, Enskog's theory in first order [length^2/time]."""
        radii, masses = self.scene.radii, self.scene.masses
        room = self.scene.width * self.scene.height - math.pi * float(radii[0]) ** 2
        number = (self.scene.count - 1) / room
        packing = number * math.pi * float(radii[1]) ** 2
        apart = float(radii[0] + radii[1])
        contact = 1 / (1 - packing) + 9 / 16 * packing / (1 - packing) ** 2 * 2 * float(radii[0]) / apart
        reduced = float(masses[0] * masses[1] / (masses[0] + masses[1]))
        return math.sqrt(1 / (2 * math.pi * reduced)) / (2 * number * apart * contact)

    def findings(self, sim: Simulation) -> list[Finding]:
        times, path = self.series
        stride = max(round(self.LAG / (times[1] - times[0])), 1)
        moved = path[::stride][1:] - path[::stride][:-1]
        constant, memory = self.diffusion(), float(self.scene.masses[0]) * self.diffusion()
        lasting = self.LAG - memory * (1 - math.exp(-self.LAG / memory))
        found = float((moved**2).mean()) / 2 / lasting
        error = constant * math.sqrt(2 / moved.size)
        what = "diffusion constant of the large disc [length^2/time]"
        return [Finding(what, constant, found, 3 * error, "Enskog's theory; three standard errors")]


class Heat(Promise):
    """The temperature of a scene whose masses are 1."""

    def value(self, sim: Simulation) -> float:
        return float((sim.state.velocity**2).mean())


class Cooling(Heat):
    """The temperature of the scene `cooling`."""

    EARLY = 5.0

    def findings(self, sim: Simulation) -> list[Finding]:
        """t0 of Haff's law, T = T0 / (1 + t/t0)^2, fitted to times up to EARLY, before neighbours move alike.

        The law takes velocities before collisions for independent. In this dense gas they are not: from the first
        collisions on each takes 3 % less energy (12 starts: t0 = 9.13(4), of one start +- 0.14).
        """
        times, temperatures = self.series
        early = times <= self.EARLY
        slope = float(np.polyfit(times[early], 1 / np.sqrt(temperatures[early]), 1)[0])
        expected = self.haff_time
        source = "Haff 1983, rate of Enskog, kurtosis of van Noije and Ernst 1998; correlations add some 4 %"
        return [Finding("t0 of Haff's law [time]", expected, 1 / slope, 0.07 * expected, source)]

    @property
    def haff_time(self) -> float:
        """t0 of Haff's law [time]."""
        scene = self.scene
        rate = enskog_rate(scene.packing, scene.largest_radius, float((scene.velocity**2).mean()))
        return 1 / haff_rate(rate, scene.restitution)


def haff_rate(collisions: float, restitution: float) -> float:
    """1/t0 of Haff's law [1/time] at a rate of collisions of a disc [1/time].

    With the kurtosis a_2 of the cooling gas in two dimensions: van Noije & Ernst, Granular Matter 1, 57 (1998).
    """
    e = restitution
    kurtosis = 16 * (1 - e) * (1 - 2 * e**2) / (57 - 25 * e + 30 * (1 - e) * e**2)
    return (1 - e**2) / 4 * collisions * (1 + 3 / 16 * kurtosis)


class Compression(Heat):
    """The temperature of the scene `piston`."""

    def adiabat(self, time: float) -> float:
        """Temperature of a slow compression up to a time, d ln T = -Z d ln A [mass length^2/time^2]."""
        radius, count = self.scene.largest_radius, self.scene.count
        low, high = np.transpose([self.scene.walls_at(each) for each in (0.0, time)], (1, 0, 2))
        areas = np.prod(high - low - 2 * radius, axis=1)
        area = np.geomspace(areas[1], areas[0], 101)
        factors = [compressibility(count * math.pi * radius**2 / each) for each in area]
        heated = math.exp(float(np.mean(factors)) * math.log(areas[0] / areas[1]))
        return heated * float((self.scene.velocity**2).mean())

    def findings(self, sim: Simulation) -> list[Finding]:
        expected, found = self.adiabat(sim.time), self.value(sim)
        name = "temperature at the end [mass length^2/time^2]"
        return [Finding(name, expected, found, 0.06 * expected, "the adiabat")]


PROMISES: dict[str, type[Promise]] = {
    "brownian": Brownian,
    "cooling": Cooling,
    "galton": Galton,
    "growth": Growth,
    "hopper": Hopper,
    "pi": Pi,
    "piston": Compression,
    "rough-hopper": Hopper,
}
"""By the name of the scene; of others no number is expected."""


@dataclass(frozen=True)
class Findings:
    """The results of a run of a named scene. Prints one line for each number.

    Attributes:
        scene: its name.
        numbers: a `Finding` each, with `what`, `expected`, `found`, `within`, `source` and `consistent`.
        times, seen: times [time], and what was recorded at them: for `brownian` the path of the large disc, shape (n,
            2) [length]; for `cooling` temperatures, and for the hoppers the number of grains that have passed, shape
            (n,). Other scenes have times only, or nothing.

    >>> shown = findings("pi")
    >>> shown.consistent, shown.numbers[0].found
    (True, 314.0)
    """

    scene: str
    numbers: tuple[Finding, ...]
    times: tuple[float, ...]
    seen: tuple[object, ...]

    @property
    def consistent(self) -> bool:
        """Whether all found numbers agree with the expected ones."""
        return all(each.consistent for each in self.numbers)

    def __str__(self) -> str:
        return "\n".join(self.lines())

    def record(self) -> list[dict[str, float | str]]:
        """The numbers as plain values."""
        return [dataclasses.asdict(each) for each in self.numbers]

    def lines(self) -> list[str]:
        """A line for each number, with the largest difference that is consistent."""
        return [
            f"{each.what}: {each.found:.4g} found, {each.expected:.4g}"
            f"{f' ± {each.within:.2g}' if each.within else ''} expected ({each.source})"
            f"{'' if each.consistent else f': they differ by more than {each.within:.2g}'}"
            for each in self.numbers
        ]


def found_by(name: str, promise: Promise, sim: Simulation) -> Findings:
    """Results of a run from the start to the recommended duration."""
    times, seen = promise.series
    return Findings(name, tuple(promise.findings(sim)), tuple(times.tolist()), tuple(seen.tolist()))


def findings(name: str, settings: Settings | None = None) -> Findings:
    """Run a scene that comes with mpsim for its recommended duration, and compare the results with the expected ones.

    Args:
        name: of the scene: "brownian" (diffusion constant of the large disc [length^2/time]), "cooling" (Haff's law),
            "galton" (balls in the bins, binomial curve), "growth" (1,000 discs that enter), "hopper" and
            "rough-hopper" (grains per time, Beverloo's law), "pi" (314 collisions), or "piston" (the adiabat).
        settings: how to simulate it; None: those that the scene recommends.

    Raises:
        InputError: for a scene that has no expected numbers.

    Source: each number names its own.

    >>> print(findings("pi"))
    collisions of discs and with the wall [1]: 314 found, 314 expected (digits of pi: Galperin 2003)
    """
    name = checks.choice("name", name, sorted(PROMISES))
    scene = Scene.load(name)
    settings = settings_for(scene, settings)
    promise = PROMISES[name](scene, settings)
    with Simulation(scene, settings) as sim:
        sim.run(until=scene.duration, observe=promise.observers)
        return found_by(name, promise, sim)
