"""The experiments of the term-project report: fixed, growth, repeat, final states, scaling.

Every experiment checks its results in the same run. If one is wrong, it fails instead of reporting times. Frame times
are taken inside the compiled loop, after compilation and a warm-up run.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mpsim.core.state import State
from mpsim.engine.simulation import Simulation
from mpsim.errors import MpsimError
from mpsim.measure.observables import kinetic_energy
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings

METHODS = ("naive", "grid", "parallel")

REPORT_FIXED_MS = {"naive": 1.651, "grid": 0.133, "parallel": 3.898}
"""Mean frame times of the term-project report, 100 discs, 500 frames [ms]; its parallel version used threads."""

REPORT_GROWTH_MS = {"naive": 32.82, "grid": 1.204, "parallel": 4.469}
"""The same with one disc added after every frame, for 1,000 frames [ms]."""

NAIVE_UP_TO = 3_000
"""Number of discs up to which a default run tests all pairs: the time of a frame grows with the square."""

DT = 0.01
PACKING = 0.4
RADIUS = 0.5

Tick = Callable[[str], None]
"""Called with the name of what was just done, for progress."""


class WrongAnswerError(MpsimError, AssertionError):
    """A benchmark's result is wrong, so its times mean nothing."""


@dataclass
class Timing:
    """Frame times of one method on one scene; frame_seconds: of every measured frame [s]."""

    method: str
    workers: int
    discs: int
    frame_seconds: NDArray[np.float64]
    digest: str
    bytes_per_disc: float = 0.0

    @property
    def median(self) -> float:
        """Median frame time [s]."""
        return float(np.median(self.frame_seconds))

    @property
    def mean(self) -> float:
        """Mean frame time [s], the figure of the report."""
        return float(np.mean(self.frame_seconds))

    @property
    def nanoseconds_per_disc(self) -> float:
        """Median frame time per disc [ns]."""
        return self.median * 1e9 / max(self.discs, 1)


@dataclass
class Fixed:
    """Fixed number of discs: timings and final states by method, and the distances between these."""

    scene: Scene
    timings: dict[str, Timing]
    states: dict[str, State]
    distances: dict[str, float]


@dataclass
class Repeat:
    """Runs of one start: final states and digests of guarded and unguarded runs, digests by number of workers."""

    scene: Scene
    guarded: list[State]
    unguarded: list[State]
    by_workers: dict[int, str]


def gas(count: int, seed: int = 1) -> Scene:
    """The scene of all experiments: a gas of packing fraction 0.4."""
    return Scene.random(count=count, packing=PACKING, radius=RADIUS, temperature=1.0, seed=seed)


def fixed(settings: Settings, frames: int, tick: Tick, count: int = 100) -> Fixed:
    """100 discs, 500 frames, each method from a copy of the same start."""
    scene = gas(count)
    timings, states, early = {}, {}, {}
    for method in METHODS:
        chosen = replace(settings, method=method)
        with Simulation(scene, chosen) as sim:
            sim.run(frames=50)
            early[method] = sim.state.position
        with Simulation(scene, chosen) as sim:
            report = sim.run(frames=frames)
            states[method] = sim.state
            _check_state(sim, scene, settings)
            timings[method] = Timing(method, report.workers, count, report.frame_seconds, sim.digest())
        tick(f"fixed, {method}")
    _demand_equal("grid and parallel", [timings["grid"].digest, timings["parallel"].digest])
    late = {method: state.position for method, state in states.items()}
    apart = {
        "naive to grid after 50 frames, largest": _largest_distance(early["naive"], early["grid"]),
        f"naive to grid after {frames} frames, largest": _largest_distance(late["naive"], late["grid"]),
        f"grid to parallel after {frames} frames, largest": _largest_distance(late["grid"], late["parallel"]),
    }
    return Fixed(scene, timings, states, apart)


def growth(settings: Settings, frames: int, tick: Tick) -> dict[str, Timing]:
    """Timings by method while one disc is added after every frame, in a box of packing 0.4 at the end."""
    full = gas(frames + 1)
    timings = {}
    for method in METHODS:
        box = {"width": full.width, "height": full.height, "radius": full.radius}
        start = Scene(position=full.position[:1], velocity=full.velocity[:1], **box)
        with Simulation(start, replace(settings, method=method)) as sim:
            reports = []
            for disc in range(1, frames + 1):
                reports.append(sim.run(frames=1))
                sim.add(full.position[disc], full.velocity[disc])
            if sim.count != frames + 1:
                raise WrongAnswerError(f"growth by {method} ended with {sim.count} discs, not {frames + 1}.")
            seconds = np.concatenate([report.frame_seconds for report in reports])
            timings[method] = Timing(method, reports[-1].workers, frames, seconds, sim.digest())
        tick(f"growth, {method}")
    _demand_equal("grid and parallel of growth", [timings["grid"].digest, timings["parallel"].digest])
    return timings


def repeat(settings: Settings, frames: int, tick: Tick, count: int = 1000, runs: int = 4) -> Repeat:
    """Parallel runs of one start: equal for 1, 2 and 4 workers if columns are guarded, different if not."""
    scene = gas(count)
    chosen = replace(settings, method="parallel", workers=max(settings.workers or 2, 2))

    def final(settings: Settings, unguarded: bool = False) -> State:
        with Simulation(scene, settings, unguarded=unguarded) as sim:
            sim.run(frames=frames)
            return sim.state

    guarded = [final(chosen) for _ in range(runs)]
    tick("repeat, guarded")
    by_workers = {workers: final(replace(chosen, workers=workers)).digest() for workers in (1, 2, 4)}
    tick("repeat, 1, 2 and 4 workers")
    unguarded = [final(chosen, unguarded=True) for _ in range(runs)]
    tick("repeat, unguarded")
    _demand_equal("repeated runs", [state.digest() for state in guarded] + list(by_workers.values()))
    return Repeat(scene, guarded, unguarded, by_workers)


def scaling(settings: Settings, sizes: Sequence[int], seconds: float, tick: Tick) -> list[Timing]:
    """Timings of each method that is feasible at a size, and of `auto`: packing 0.4, about `seconds` of frames each."""
    timings = []
    for count in sizes:
        scene = gas(count)
        digests = {}
        for method in (*METHODS, "auto"):
            if method == "naive" and count > NAIVE_UP_TO:
                continue
            with Simulation(scene, replace(settings, method=method)) as sim:
                sim.run(frames=3)
                frame_time = float(np.median(sim.run(frames=5).frame_seconds))
                warm_up = min(max(int(0.1 * seconds / frame_time), 2), 2000)
                sim.run(frames=warm_up)
                report = sim.run(frames=min(max(int(seconds / frame_time), 5), 20_000))
                memory = report.block_bytes / count
                timings.append(Timing(method, report.workers, count, report.frame_seconds, sim.digest(), memory))
                _check_state(sim, scene, settings)
            with Simulation(scene, replace(settings, method=method)) as sim:
                sim.run(frames=10)
                digests[method] = sim.digest()
        _demand_equal(f"grid and parallel of {count} discs", [digests["grid"], digests["parallel"]])
        tick(f"scaling, {count:,} discs")
    return timings


def crossover(timings: Sequence[Timing]) -> int | None:
    """Smallest measured number of discs from which parallel stays faster than grid, or None."""
    by = {(timing.method, timing.discs): timing.median for timing in timings}
    answer = None
    for discs in sorted({timing.discs for timing in timings}, reverse=True):
        if by[("parallel", discs)] >= by[("grid", discs)]:
            break
        answer = discs
    return answer


def _check_state(sim: Simulation, scene: Scene, settings: Settings) -> None:
    """Demand that all discs are finite and in the box, and that the energy is conserved, as by both laws."""
    state = sim.state
    low, high = scene.limits(scene.radius)
    rounding = np.finfo(settings.precision).eps * max(scene.width, scene.height)
    inside = (state.position >= low - rounding) & (state.position <= high + rounding)
    if not inside.all():
        raise WrongAnswerError(f"{int((~inside).any(axis=1).sum())} discs are outside the box.")
    before, after = (kinetic_energy(each, scene) for each in (State(scene.position, scene.velocity), state))
    if abs(after - before) > 1e-3 * before:
        raise WrongAnswerError(f"the kinetic energy changed from {before:.6g} to {after:.6g}.")


def _largest_distance(a: NDArray, b: NDArray) -> float:
    return float(np.hypot(*(a - b).T).max(initial=0.0))


def _demand_equal(what: str, digests: Sequence[str]) -> None:
    if len(set(digests)) != 1:
        raise WrongAnswerError(f"{what} must have equal digests; got {', '.join(digests)}.")
