"""Measures gathered along a run: what each needs, and how its value and error come from the frames.

Two kinds. *Counted* measures are sums that the kernels keep for each frame when asked to (impulses on walls and between
discs, pairs met). *Sampled* measures are functions of a state, taken at fixed frames, so that neither the number of
workers nor the length of a slice can change them.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mpsim import checks
from mpsim.errors import NotRecordedError
from mpsim.kernels import layout
from mpsim.measure import observables
from mpsim.measure.statistics import Measure, block_average
from mpsim.scene import Scene
from mpsim.state import State

SAMPLES = 200
"""States sampled in a run, about: each costs a copy of all positions and velocities."""

BLOCKS = 32
"""Blocks into which a run is cut for the error of a ratio of two sums."""


@dataclass(frozen=True)
class Run:
    """What a measure may know besides the counts: the scene, the discs in it, time of a frame, and the energy."""

    scene: Scene
    count: int
    dt: float
    kinetic_energy: float

    @property
    def perimeter(self) -> float:
        """Length of all walls [length]."""
        return 2 * (self.scene.width + self.scene.height)


Counts = NDArray[np.float64]


def pressure(counts: Counts, run: Run) -> Measure:
    """Impulse on all walls / (time x perimeter) [mass/time^2]: what a gauge in the wall shows."""
    return block_average((counts[:, layout.WALL_X] + counts[:, layout.WALL_Y]) / (run.dt * run.perimeter))


def pressure_virial(counts: Counts, run: Run) -> Measure:
    """Pressure from the collisions of the discs [mass/time^2], mean over both directions.

    The virial of a box with hard walls, exact for any number of discs (Clausius 1870):
    (W - s) F_x + (H - s) F_y = 2 E + sum s |dp| / time, with s the diameter and F the mean force on one wall; here
    F_x = P H and F_y = P W. Without gravity only.
    """
    scene, diameter = run.scene, 2 * run.scene.radius
    area = (scene.width - diameter) * scene.height + (scene.height - diameter) * scene.width
    return block_average((2 * run.kinetic_energy + diameter * counts[:, layout.VIRIAL] / run.dt) / area)


def collision_rate(counts: Counts, run: Run) -> Measure:
    """Collisions per disc and time [1/time], a pair counting for both."""
    return block_average(2 * counts[:, layout.COLLISION] / (run.dt * max(run.count, 1)))


def overlap(counts: Counts, run: Run) -> Measure:
    """Mean depth at which overlapping pairs are met [length]."""
    met, depth = (
        np.array([block.sum() for block in np.array_split(counts[:, index], BLOCKS)])
        for index in (layout.MET, layout.DEPTH)
    )
    means = depth[met > 0] / met[met > 0]
    value = float(depth.sum() / met.sum()) if met.sum() else 0.0
    error = float(means.std(ddof=1) / np.sqrt(len(means))) if len(means) > 1 else float("nan")
    return Measure(value, error, int(met.sum()))


def largest_overlap(counts: Counts, run: Run) -> Measure:
    """Largest depth at which a pair was met in the whole run [length]; an extreme, so without an error."""
    return Measure(float(counts[:, layout.DEEPEST].max(initial=0.0)), float("nan"), len(counts))


COUNTED: dict[str, Callable[[Counts, Run], Measure]] = {
    "pressure": pressure,
    "pressure_virial": pressure_virial,
    "collision_rate": collision_rate,
    "overlap": overlap,
    "largest_overlap": largest_overlap,
}

SAMPLED: dict[str, Callable[[State, Scene], float]] = {
    "kinetic_energy": observables.kinetic_energy,
    "temperature": observables.temperature,
    "speed_kurtosis": lambda state, scene: observables.speed_kurtosis(state),
}

NAMES = (*COUNTED, *SAMPLED)


def checked(names: Iterable[str] | None) -> tuple[str, ...]:
    """The names of measures, each checked."""
    if names is None:
        return ()
    if isinstance(names, str):
        names = [names]
    return tuple(checks.choice("measures", name, NAMES) for name in names)


class Measures(dict[str, Measure]):
    """Measures of one run by name. One that was not asked for says how to ask for it."""

    def __missing__(self, name: str) -> Measure:
        """Explain instead of a bare KeyError."""
        checks.choice("the name of a measure", name, NAMES)
        raise NotRecordedError(
            f"{name} was not recorded in this run (recorded: {', '.join(self) or 'nothing'}). Measures are gathered "
            f"only when asked for. Use sim.run(..., measures=[{name!r}])."
        )


class Gathering:
    """Collects what the asked-for measures need, slice by slice.

    Args:
        names: of measures, checked.
        frames: of the run; states are sampled about every frames / SAMPLES frames.
    """

    def __init__(self, names: tuple[str, ...], frames: int):
        self._names = names
        self._counts: list[Counts] = []
        self._samples: dict[str, list[float]] = {name: [] for name in names if name in SAMPLED}
        self._every = max(frames // SAMPLES, 1)

    @property
    def counting(self) -> bool:
        """Whether the kernels must count."""
        return any(name in COUNTED for name in self._names)

    def frames_to_sample(self, done: int) -> int:
        """Frames until a state is wanted; a very large number where none is."""
        return self._every - done % self._every if self._samples else 2**62

    def take(self, counts: Counts | None, done: int, state: Callable[[], State], scene: Scene) -> None:
        """Take in a slice, and a state if it is time for one."""
        if counts is not None:
            self._counts.append(counts)
        if self._samples and done % self._every == 0:
            now = state()
            for name, values in self._samples.items():
                values.append(SAMPLED[name](now, scene))

    def measures(self, run: Run) -> Measures:
        """The measures, when the run is over."""
        counts = np.concatenate(self._counts) if self._counts else np.zeros((0, layout.TALLIES))
        results = Measures()
        for name in self._names:
            results[name] = COUNTED[name](counts, run) if name in COUNTED else block_average(self._samples[name])
        return results
