"""Averages during a run: what each measure needs, and how its value and error are computed.

The measures and their kinds are listed in `registry`. States are sampled at fixed frames, so that neither the number of
workers nor the length of a slice can change an average.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from mpsim.core import checks
from mpsim.core.state import Discs, count_of
from mpsim.errors import InputError, NotRecordedError
from mpsim.features import FEATURES
from mpsim.kernels import records
from mpsim.measure import moments, observables
from mpsim.measure.moments import adds_discs, has_body_force, has_losses, is_heated, is_inelastic, memory_of_baths
from mpsim.measure.registry import COMPONENTS, COUNTED, DRIFTS, NAMES, OBSERVABLES, SAMPLED, Counts, Run
from mpsim.measure.statistics import FEWEST_BLOCKS, Measure, SlowVariable, average_beside, energy_in_bath
from mpsim.scene.scene import Scene

OfDiscs = Callable[[Callable[[Discs], Any]], Any]
"""Calls a function with the present state, or what reads it in chunks, and returns what it gives."""

SAMPLES = 200
"""Approximate number of states sampled in a run: each costs a copy of all positions and velocities, chunk by chunk on
ranks."""

FLOW_SAMPLES = 1000
"""The same for the flow of momentum, the kinetic part of a pressure, which fluctuates more."""


def _fills(scene: Scene, axis: int) -> bool:
    """Whether the largest disc fills the box along an axis with walls."""
    return not scene.periodic[axis] and (scene.width, scene.height)[axis] <= 2 * scene.largest_radius


class _Refusal(NamedTuple):
    """Measures that are wrong in scenes that have something: its name in words, and what to do instead."""

    measures: tuple[str, ...]
    is_in: Callable[[Scene], bool]
    what: str
    remedy: str


_VIRIALS = ("pressure_virial", *COMPONENTS)


def _names_of(measures: tuple[str, ...]) -> tuple[str, ...]:
    """Names of measures, with "virial" expanded to all that are derived from it."""
    return tuple(chain.from_iterable(_VIRIALS if name == "virial" else (name,) for name in measures))


_REFUSALS: tuple[_Refusal, ...] = (
    _Refusal(
        _VIRIALS,
        has_body_force,
        "gravity and acceleration, which the virial leaves out",
        "Use 'pressure', the impulses on the walls.",
    ),
    _Refusal(
        _VIRIALS,
        is_inelastic,
        "losses (a restitution below 1), as the virial takes the kinetic energy for constant",
        "Use 'pressure', the impulses on the walls.",
    ),
    _Refusal(
        _VIRIALS,
        lambda scene: scene.smallest_radius < scene.largest_radius and not all(scene.periodic),
        "discs of several sizes between walls, which each keep the centres at a distance of their own",
        "Use 'pressure', the impulses on the walls.",
    ),
    _Refusal(
        ("pressure_virial",),
        lambda scene: _fills(scene, 0) and _fills(scene, 1),
        "discs as wide and high as the box, which have no room to move",
        "Use 'pressure', the impulses on the walls.",
    ),
    _Refusal(
        ("pressure_xx",),
        lambda scene: _fills(scene, 0),
        "discs as wide as the box, which have no room to move along x",
        "Use 'pressure_yy', along which they have.",
    ),
    _Refusal(
        ("pressure_yy",),
        lambda scene: _fills(scene, 1),
        "discs as high as the box, which have no room to move along y",
        "Use 'pressure_xx', along which they have.",
    ),
    *(
        _Refusal(_names_of(each.measures), feature.is_in, each.what, each.remedy)
        for feature in FEATURES
        for each in feature.invalidates
    ),
    _Refusal(
        (*_VIRIALS, "collision_rate", "contact_rate"),
        lambda scene: scene.loses_discs and not scene.absorbing,
        "removed discs, which its number of discs counts",
        "Measure in a scene without them, scene.starting_from(sim.state).",
    ),
    _Refusal(
        ("pressure_xy",),
        lambda scene: not all(scene.periodic),
        "walls, which are smooth and take up no such momentum",
        "Use 'pressure_xx' and 'pressure_yy', or a box with boundary='periodic'.",
    ),
    _Refusal(
        ("collision_rate", "missed_collisions"),
        lambda scene: has_losses(scene) and has_body_force(scene),
        "losses under gravity or acceleration, where discs come to rest on each other and are in contact all the time",
        "Use 'overlap'; or in a run 'contact_rate', which counts a resting contact once per step.",
    ),
    _Refusal(
        ("momentum_drift",),
        lambda scene: scene.wall_friction > 0 and not all(scene.periodic),
        "rough walls, whose tangential impulses are not counted",
        "Measure 'pressure' or 'energy_drift', or give the walls wall_friction=0.",
    ),
    _Refusal(
        ("energy_drift",),
        observables.has_periodic_field,
        "fields along periodic axes, along which discs fall without end",
        "Give such an axis walls.",
    ),
    _Refusal(
        ("pressure",),
        lambda scene: not all(scene.periodic) and not Run(scene, 0, 1.0).walls,
        "absorbing edges all round, which leave no wall",
        "Give the scene a wall.",
    ),
)


def refusal(name: str, scene: Scene, count: int | None = None) -> str | None:
    """Why a measure would be wrong in a scene, or None.

    Args:
        name: of the measure, or of an error of a trade-off study (`registry.ERRORS`).
        scene: the scene.
        count: number of discs now; None: that of the scene.

    >>> refusal("pressure", Scene.random(count=3, packing=0.1, radius=0.5)) is None
    True
    """
    virial = name == "pressure" and all(scene.periodic)
    for each in _REFUSALS:
        if ("pressure_virial" if virial else name) in each.measures and each.is_in(scene):
            hint = "Without walls it is the virial: give the scene walls." if virial else each.remedy
            return f"measures may hold {name!r} only without {each.what}; this scene has them. {hint}"
    grown = count not in (None, scene.count) or adds_discs(scene)
    weighed = name in ("kinetic_energy", "temperature", *_VIRIALS, *DRIFTS) or virial
    accelerated = name in DRIFTS and scene.acceleration is not None
    if grown and (accelerated or (weighed and (scene.mass is not None or any(e.mass for e in scene.emitters)))):
        what = "acceleration" if accelerated else "mass"
        return (
            f"measures may hold {name!r} only where the scene holds the {what} of every disc; it has {scene.count} "
            f"discs, and others are added. Make a scene of all discs, and measure there."
        )
    return None


def checked(names: Iterable[str] | None, scene: Scene | None = None, count: int | None = None) -> tuple[str, ...]:
    """Names of measures, checked.

    Args:
        names: one, several, or None for none.
        scene: refuse measures that would be wrong in it.
        count: number of discs now; None: that of the scene.

    Raises:
        InputError: for an unknown name, or a measure that the scene cannot have, with the reason.
    """
    if names is None:
        return ()
    chosen = tuple(checks.choice("measures", name, NAMES) for name in ([names] if isinstance(names, str) else names))
    reasons = [] if scene is None else [refusal(name, scene, count) for name in chosen]
    for reason in filter(None, reasons):
        raise InputError(reason)
    return chosen


class Measures(dict[str, Measure]):
    """Measures of one run by name. The error for one that was not recorded says how to ask for it."""

    def __missing__(self, name: str) -> Measure:
        """Raise an error that explains, instead of a KeyError."""
        checks.choice("the name of a measure", name, NAMES)
        raise NotRecordedError(
            f"{name} was not recorded in this run (recorded: {', '.join(self) or 'nothing'}). Measures are gathered "
            f"only when asked for. Use sim.run(..., measures=[{name!r}])."
        )


class RunAverages:
    """Collects the data of the requested measures, slice by slice.

    Args:
        names: of measures, checked.
        frames: of the run; states are sampled about every frames / SAMPLES frames.
        scene: the scene of the run.
        of_discs: gives the value of a function of the present state. Where several processes share the simulation, one
            of them calls the function, and all get its value.
        whole: whether the run begins with a whole frame. After Ctrl-C inside a frame it does not; the counts then
            include all of that frame: rates are right, but drifts between two states are not.
        skipped: frames at the beginning that do not count.
    """

    def __init__(
        self,
        names: tuple[str, ...],
        frames: int,
        scene: Scene,
        of_discs: OfDiscs,
        whole: bool = True,
        skipped: int = 0,
    ):
        self._names = names
        self._skipped = skipped
        self._scene = scene
        self._of_discs = of_discs
        self._drifts = {name: DRIFTS[name] for name in names if name in DRIFTS and (whole or skipped)}
        self._before = self._conserved()
        self._lost: set[str] = set()
        self._counts: list[Counts] = []
        self._sampled: dict[str, Callable[[Discs, Scene], Any]] = {n: SAMPLED[n] for n in names if n in SAMPLED}
        if any(name in COMPONENTS for name in names):
            self._sampled["flow"] = moments.flow_of_momentum
        known = is_heated(scene) and refusal("kinetic_energy", scene) is None
        if known and any(name in COUNTED or name in SAMPLED for name in names):
            self._sampled["bath"] = observables.kinetic_energy
        self._samples: dict[str, list[Any]] = {name: [] for name in self._sampled}
        self._every = max((frames - skipped) // (FLOW_SAMPLES if "flow" in self._sampled else SAMPLES), 1)

    def interrupted(self, scene: Scene, count: int) -> None:
        """Record that discs or parameters have been changed during the run.

        From then on these are NaN: drifts, since the change made is not a drift; the virial, which assumes a constant
        kinetic energy; and all measures that a run of the new scene could not have.

        Args:
            scene: from now on.
            count: number of discs now.
        """
        self._drifts = {}
        virials = {"pressure_virial", "pressure"} if all(scene.periodic) else {"pressure_virial"}
        self._lost |= {name for name in self._names if name in virials or refusal(name, scene, count)}
        flows = self._lost.issuperset(set(COMPONENTS) & set(self._names))
        bath = refusal("kinetic_energy", scene, count) is not None
        for name in [*self._lost, *(["flow"] if flows else []), *(["bath"] if bath else [])]:
            self._sampled.pop(name, None)
            self._samples.pop(name, None)

    @property
    def counting(self) -> bool:
        """Whether the kernels must count."""
        return any(name in COUNTED or name in DRIFTS for name in self._names)

    def frames_to_sample(self, done: int) -> int:
        """Number of frames until the next sample, or until frames count; very large if neither is needed."""
        if done < self._skipped:
            return self._skipped - done
        return self._every - (done - self._skipped) % self._every if self._samples else 2**62

    def take(self, counts: Counts | None, done: int) -> None:
        """Add the counts of a slice, and sample the state if it is due."""
        if done <= self._skipped:
            if done == self._skipped:
                self._before = self._conserved()
            return
        if counts is not None:
            self._counts.append(counts)
        if self._samples and (done - self._skipped) % self._every == 0:
            found = self._of_all(self._sampled)
            for name, values in self._samples.items():
                values.append(found[name])

    def mark(self) -> tuple[int, dict[str, int]]:
        """The amount of data collected so far, for `rewind`."""
        return len(self._counts), {name: len(values) for name, values in self._samples.items()}

    def rewind(self, mark: tuple[int, dict[str, int]]) -> None:
        """Discard the data collected after a mark."""
        counts, samples = mark
        del self._counts[counts:]
        for name, length in samples.items():
            del self._samples[name][length:]

    def measures(self, run: Run) -> Measures:
        """The measures at the end of the run."""
        counts = np.concatenate(self._counts) if self._counts else np.zeros(0, records.COUNTS)
        run = replace(self._with_what_is_needed(run), slow=self._slow(run))
        after = self._conserved() if len(counts) else {}
        results = Measures()
        unknown = {name for name, values in self._samples.items() if not values or np.isnan(values).any()}
        unknown |= self._lost if len(counts) else set(COUNTED) | self._lost
        for name in self._names:
            if name in unknown:  # without frames, a mean over no discs, or of a scene that cannot have it
                results[name] = Measure(float("nan"), float("nan"), 0, settled=False)
            elif name in COUNTED:
                results[name] = COUNTED[name](counts, run)
            elif name in SAMPLED:
                constant = OBSERVABLES[name].constant(run)
                results[name] = average_beside(run.slow, np.array(self._samples[name]), constant=constant)
            else:
                rate = DRIFTS[name].rate
                value = rate(counts, run, self._before[name], after[name]) if name in after else float("nan")
                results[name] = Measure(value, float("nan"), 1, settled=False)
        return results

    def _slow(self, run: Run) -> SlowVariable | None:
        """The energy along the run, which a bath changes slowly; None without one."""
        energy = np.array(self._samples.get("bath", ()))
        if len(energy) < FEWEST_BLOCKS or not energy.mean() > 0:
            return None
        memory = memory_of_baths(self._scene, energy.mean() / run.count)
        return energy_in_bath(energy, memory / (len(energy) * self._every * run.dt), run.count)

    def _of_all(self, functions: Mapping[str, Callable[[Discs, Scene], Any]]) -> dict[str, Any]:
        """What each of some functions gives of the present state, by name."""
        if not functions:
            return {}
        return self._of_discs(lambda now: {name: each(now, self._scene) for name, each in functions.items()})

    def _conserved(self) -> dict[str, Any]:
        """What the drifts take of the present state, by name."""
        return self._of_all({name: drift.of for name, drift in self._drifts.items()})

    def _with_what_is_needed(self, run: Run) -> Run:
        """The run with the quantities that the requested measures take from states."""
        names = set(self._names) - self._lost
        walls = "pressure" in names and not all(run.scene.periodic)
        if walls or "pressure_virial" in names or "pressure" in names:
            if walls:
                count, speed = self._of_discs(moments.number_and_speed)
                run = replace(run, speed=speed, count=count)
            if "pressure_virial" in names or not walls:
                energy = self._of_discs(lambda now: _energy_without_drift(now, self._scene))
                run = replace(run, kinetic_energy=energy)
        if self._samples.get("flow"):
            run = replace(run, flow=np.array(self._samples["flow"]), every=self._every)
        return run


def _energy_without_drift(discs: Discs, scene: Scene) -> float:
    """Kinetic energy without that of the mean flow along periodic axes, which no collision changes."""
    energy = observables.kinetic_energy(discs, scene)
    mass = float(scene.masses.sum()) if scene.mass is not None else count_of(discs)
    flow = observables.momentum(discs, scene)[list(scene.periodic)]
    return energy - float((flow**2).sum()) / (2 * mass) if mass else energy
