"""The result of a named scene: expected and found numbers."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from mpsim.core import checks
from mpsim.engine.simulation import Simulation
from mpsim.scene.recommended import settings_for
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings
from mpsim.studies.promises import PROMISES, Finding, Promise


@checks.known_names_of_methods
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


def promise_of(name: str, scene: Scene, settings: Settings) -> Promise | None:
    """What a scene that comes with mpsim should show; None if no number is expected."""
    kind = PROMISES.get(name)
    return None if kind is None else kind(scene, settings)


def found_by(name: str, promise: Promise, sim: Simulation) -> Findings:
    """Results of a run from the start to the recommended duration."""
    times, seen = promise.series
    return Findings(name, tuple(promise.findings(sim)), tuple(times.tolist()), tuple(seen.tolist()))


@checks.known_names()
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
