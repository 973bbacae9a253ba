"""Correlations in time along a run, and their file."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mpsim.core import checks, files
from mpsim.core.archive import DAMAGE, ArrayFile
from mpsim.errors import InputError, NotRecordedError, OutputError, reason_of
from mpsim.features.baths import mean_mass
from mpsim.measure.moments import adds_discs, conserves_energy, is_heated, memory_of_baths, removes_discs
from mpsim.measure.motion import (
    MOST_PARTS,
    MOST_WAVE_NUMBERS,
    SQUARES,
    VELOCITIES,
    WAVES,
    Motion,
    Route,
    TimeCorrelation,
    correlator,
    lags_of,
    levels_for,
)
from mpsim.measure.series import OneSimulation
from mpsim.measure.statistics import Measure

if TYPE_CHECKING:
    from mpsim.engine.simulation import Simulation

# --- The file of time correlations: all the data of a run so far, so that a resumed run gives the same bits

Floats = NDArray[np.float64]

FORMAT = 2
"""Version of the file."""

_NUMBERS = ("format", "every", "points", "frame", "levels", "samples", "span", "count", "constant")
_REALS = ("start", "dt", "interval", "memory")

MOST_LEVELS = 40
"""Levels at most: the longest lag is then beyond any run."""


class Contents(NamedTuple):
    """Contents of a file: the accumulated data, and the arguments by name."""

    motion: Motion
    numbers: dict[str, int]
    reals: dict[str, float]
    wave_numbers: Floats


def new_place(path: str | os.PathLike[str]) -> Path:
    """The path of a file that does not exist yet.

    Raises:
        InputError: for another ending, or if the file exists.
    """
    target = place(path)
    if target.exists():
        raise InputError(
            f"path of Correlations must be that of a new file; {str(target)!r} is there already. Continue it by "
            "mpsim.Correlations.load(path), or give another name."
        )
    return target


def place(path: Any) -> Path:
    """The path, which must end in .npz."""
    text: Any = os.fsdecode(path) if isinstance(path, str | os.PathLike) else ""  # pyright: ignore[reportUnknownArgumentType]
    if Path(text).suffix != ".npz":
        raise InputError(f"the path of Correlations must end in .npz; got {path!r}. Use 'run.npz'.")
    return Path(text)


def write(
    path: str | os.PathLike[str],
    motion: Motion,
    numbers: Mapping[str, int],
    reals: Mapping[str, float],
    wave_numbers: Floats,
) -> Path:
    """Write a file as a whole. Returns its path.

    Raises:
        InputError: for another ending.
        OutputError: if it cannot be written.
    """
    target, blocks = place(path), motion.correlator.blocks
    used, levels = -(-blocks.samples // blocks.span), int(np.log2(motion.correlator.width[-1])) + 1
    own = {"format": FORMAT, "levels": levels, "samples": blocks.samples, "span": blocks.span}
    all_numbers = {**numbers, **own, "constant": int(motion.constant)}
    all_reals = {**reals, "interval": motion.interval, "memory": motion.memory}
    arrays: dict[str, Any] = {
        "numbers": np.array([all_numbers[name] for name in _NUMBERS], np.int64),
        "reals": np.array([all_reals[name] for name in _REALS]),
        "wave_numbers": wave_numbers,
        "discs": motion.discs,
        "latest": motion.latest,
        "sums": blocks.sums[:used],
        "counts": blocks.counts[:used],
        "received": np.array(motion.correlator.received, np.int64),
        "recent": np.array(motion.correlator.recent),
    }
    try:
        with files.atomic_write(target) as file:
            np.savez(file, **arrays)
    except OSError as error:
        raise OutputError(
            f"a file of Correlations must be in a folder that can be written to; got {str(target)!r} "
            f"({error.strerror}). Choose another place."
        ) from error
    return target


def read(path: str | os.PathLike[str]) -> Contents:
    """Read what `write` wrote, bit for bit. Nothing in the file is executed.

    Raises:
        InputError: if it is not such a file.
    """
    source = place(path)
    try:
        with files.opened(source) as file, ArrayFile(file) as arrays:
            return _contents({name: arrays.read(name) for name in arrays.names})
    except (OSError, *DAMAGE) as error:
        raise InputError(
            f"a file of Correlations must be one that mpsim has written; {str(source)!r}: {reason_of(error):.200}."
        ) from None


def _contents(arrays: Mapping[str, NDArray[Any]]) -> Contents:
    """The contents of the arrays of a file, checked."""
    numbers = _named(arrays["numbers"], np.int64, _NUMBERS)
    reals = _named(arrays["reals"], np.float64, _REALS)
    _demand(numbers["format"] == FORMAT, f"it is of version {numbers['format']}, and {FORMAT} is read")
    points, levels, span, samples = (numbers[name] for name in ("points", "levels", "span", "samples"))
    _demand(4 <= points <= 256 and points % 2 == 0 and 1 <= levels <= MOST_LEVELS, "its points or levels are wrong")
    _demand(span >= 1 and 1 <= samples <= span * MOST_PARTS, "its number of samples is wrong")
    _demand(numbers["every"] >= 1 and numbers["frame"] >= 0 and reals["start"] >= 0, "its times are wrong")
    _demand(0 <= reals["memory"] < np.inf, "its memory is wrong")
    _demand(0 < reals["dt"] < np.inf and 0 < reals["interval"] < np.inf, "its intervals are wrong")
    waves, discs, received = arrays["wave_numbers"], arrays["discs"], arrays["received"]
    _demand(waves.dtype == np.float64 and waves.ndim == 1 and len(waves) <= MOST_WAVE_NUMBERS, "its waves are wrong")
    _demand(((waves > 0) & (waves < np.inf)).all(), "its waves are wrong")
    _demand(discs.dtype == np.int64 and discs.ndim == 1 and len(np.unique(discs)) == len(discs) > 0, "it has no discs")
    _demand(discs.min() >= 0 and discs.max() < numbers["count"], "its discs are not there")
    _demand(received.dtype == np.int64 and received.ndim == 1 and len(received) <= levels, "its levels are wrong")
    _demand(len(received) > 0 and received.min() >= 0 and received.max() <= samples, "its levels are wrong")
    shape = (2, len(discs), 2)
    latest = _shaped(arrays, "latest", np.float64, shape)
    recent = _shaped(arrays, "recent", np.float64, (len(received), points, *shape))
    found, used = correlator(waves, points, levels), -(-samples // span)
    sums = _shaped(arrays, "sums", np.float64, (used, len(found.lags), WAVES + len(waves)))
    counts = _shaped(arrays, "counts", np.int64, (used, len(found.lags)))
    _demand(counts.min() >= 0 and counts.max() <= span, "its counts are wrong")
    found.blocks.samples, found.blocks.span = samples, span
    found.blocks.sums[:used], found.blocks.counts[:used] = sums, counts
    found.received, found.recent = received.tolist(), [each.copy() for each in recent]
    fixed = reals["interval"], bool(numbers["constant"]), reals["memory"], numbers["count"]
    motion = Motion(found, discs.copy(), latest.copy(), *fixed)
    return Contents(motion, numbers, reals, waves.copy())


def _named(array: NDArray[Any], dtype: Any, names: tuple[str, ...]) -> dict[str, Any]:
    _demand(array.dtype == dtype and array.shape == (len(names),) and not np.isnan(array).any(), "its head is wrong")
    return dict(zip(names, array.tolist(), strict=True))


def _shaped(arrays: Mapping[str, NDArray[Any]], name: str, dtype: Any, shape: tuple[int, ...]) -> NDArray[Any]:
    array = arrays[name]
    _demand(array.dtype == dtype and array.shape == shape and bool(np.isfinite(array).all()), f"its {name} are wrong")
    return array


def _demand(holds: bool | np.bool_, otherwise: str) -> None:
    if not holds:
        raise ValueError(otherwise)


# --- Correlations in time along a run: displacements, velocities and scattering, averaged over discs and time origins

# pyright: reportUnnecessaryIsInstance=false
# Arguments are checked when the program runs as well, for callers without a type checker.


LEVELS = 20
"""Levels of the correlator without `longest`: with 16 points the longest lag is 7.8 million samples."""

MOST_BYTES = 2**30
"""Memory for recent positions and velocities at most: 20 levels of 16 points for 100,000 discs."""

MOST_LOOKS = 10**12
"""Looks in the longest lag at most."""


class Correlations:
    """An observer for `Simulation.run(observe=...)` that averages correlations in time over discs and time origins.

    Displacements are exact in a periodic box too: the solver counts every crossing of a border (`State.unwrapped`), so
    a disc may cross the box any number of times between two samples. A motion common to all discs counts as
    displacement; `Scene.random` starts without one.

    Lags are 0, 1, ..., points - 1 sampling intervals, and then points/2 lags in each doubling (multiple-tau scheme).
    Positions are compared exactly at the given lag, using every sample, every second sample, every fourth, and so on.
    At longer lags, velocities are first averaged over 2, 4, ... samples, so that all samples are used; the value is
    then an average over lags within `TimeCorrelation.width`, at most 2/points of the lag.

    Errors are standard errors of the average over this run, at its energy, or at that of a heat bath. They are computed
    by `block_average` from up to 256 parts of the run, which includes correlations in time and between discs. If a run
    is too short for a lag, or for the memory of a bath, `settled` is False. After a pause between two samples, or a
    change of discs between two runs, averages continue, but no lag spans the interruption.

    Args:
        every: frames between two samples, >= 1. A tenth of the mean free time resolves the decay of velocities.
        start: simulated time at which sampling starts, >= 0 [time], for example after equilibration.
        discs: numbers of the discs to follow, shape (D,), each once; None: all.
        wave_numbers: shape (K,), > 0, for `scattering` [1/length].
        longest: longest lag, > 0 [time]; None: 7.8 million sampling intervals.
        points: samples kept at each level, even, from 4 to 256.
        path: name of a file (.npz) that is written with each checkpoint of the run, for `load`; None: no file.

    Raises:
        InputError: naming the argument, its rule and the value received; in the run, if the discs followed would need
            more than 1 GiB, are not there, or do not stay; if dt has changed, or the simulation is another one.

    Source: Ramirez et al., J. Chem. Phys. 133, 154103 (2010); Frenkel & Smit, Understanding Molecular Simulation
    (2002), sect. 4.4.

    >>> import mpsim
    >>> scene = mpsim.Scene.random(count=50, packing=0.2, radius=0.5, seed=1, boundary="periodic")
    >>> correlations = mpsim.Correlations(every=2, wave_numbers=[1.0])
    >>> with mpsim.Simulation(scene, mpsim.Settings(dt=0.05, method="grid")) as sim:
    ...     report = sim.run(until=200, observe=correlations)
    >>> correlations.msd.lag[:4].round(9).tolist(), round(correlations.velocity[0].value, 9)
    ([0.0, 0.1, 0.2, 0.3], 2.0)
    >>> bool(abs(correlations.diffusion().value - correlations.diffusion(route="velocity").value) < 0.1)
    True
    """

    def __init__(
        self,
        every: int = 1,
        *,
        start: float = 0.0,
        discs: ArrayLike | None = None,
        wave_numbers: ArrayLike = (),
        longest: float | None = None,
        points: int = 16,
        path: str | os.PathLike[str] | None = None,
    ):
        self.every: int = checks.whole("every", every, 1, 10**12, "1 samples every frame.")
        self.start: float = checks.non_negative("start", start, "[time]")
        self.wave_numbers: Floats = _wave_numbers(wave_numbers)
        self._discs = None if discs is None else _numbers(discs)
        self._longest = None if longest is None else checks.positive("longest", longest, "[time]")
        self._points = checks.whole("points", points, 4, 256, "16 is usual.")
        if points % 2:
            raise InputError(f"points must be even, as half of them are kept for each doubling; got {points}. Use 16.")
        self.path: Path | None = None if path is None else new_place(path)
        self._motion: Motion | None = None
        self._bound: tuple[float, int] | None = None  # dt and number of discs at the first sample
        self._owner = OneSimulation("Correlations")
        self._frame: int = -1  # of the last sample that counted
        self._continuing = False  # whether samples up to that one are those of a run that is done again

    def observe(self, sim: Simulation, collisions: int) -> None:
        """Take a sample of the present frame, unless it has one already.

        Args:
            sim: the simulation, always the same.
            collisions: not used.
        """
        del collisions
        self._bind_or_check(sim)
        if sim.frame < self._frame or sim.time < self.start - 1e-6 * sim.settings.dt:
            return
        motion = self._motion or self._begin(sim)
        sample = self._sample(sim, motion)
        if sim.frame == self._frame:
            if checks.equal(sample, motion.latest):
                self._continuing = False
                return
            if self._continuing:
                raise InputError(
                    f"Correlations can be continued only with the simulation they belong to; at frame {sim.frame} "
                    "they contain other positions or velocities. Use the file that was written with its checkpoint."
                )
            motion.correlator.restart()  # discs were changed between two runs
        elif sim.frame != self._frame + self.every:
            motion.correlator.restart()
        motion.correlator.add(sample)
        motion.latest, self._frame, self._continuing = sample, sim.frame, False

    @staticmethod
    def _sample(sim: Simulation, motion: Motion) -> Floats:
        """Positions and velocities of the discs that are followed, shape (2, D, 2)."""
        state = sim.state
        if not (here := state.present[motion.discs]).all():
            gone = int(motion.discs[int((~here).argmax())])
            raise InputError(
                f"discs of Correlations must stay in the box; disc {gone} has left it by frame {sim.frame}. Follow "
                "discs that stay, by discs=..."
            )
        return np.stack([state.unwrapped[motion.discs], np.asarray(state.velocity[motion.discs], np.float64)])

    def _bind_or_check(self, sim: Simulation) -> None:
        """Bind to a simulation the first time; afterwards make sure that it is the same, and has not changed."""
        self._owner.bind_or_check(sim)
        now = sim.settings.dt, sim.count
        self._bound = self._bound or now
        if self._bound != now:
            raise InputError(
                f"Correlations need the same dt and number of discs throughout, {self._bound}; got {now} at frame "
                f"{sim.frame}. Use new ones from here on."
            )

    def _begin(self, sim: Simulation) -> Motion:
        """Data at the first sample."""
        if self._discs is None and (adds_discs(sim.scene) or removes_discs(sim.scene)):
            raise InputError(
                "discs of Correlations must be given for a scene in which discs enter or leave; got None. Give the "
                "numbers of those that stay."
            )
        discs = np.arange(sim.count) if self._discs is None else self._discs
        if not len(discs) or discs.max() >= sim.count:
            raise InputError(
                f"discs of Correlations must be at least one, below {sim.count}, the number of discs; got "
                f"{checks.brief(discs.tolist())}. Give numbers of discs that are there."
            )
        interval = self.every * sim.settings.dt
        levels = self._levels(interval)
        sums = MOST_PARTS * len(lags_of(self._points, levels)) * (3 + len(self.wave_numbers)) * 8
        needed = levels * self._points * len(discs) * 4 * 8 + sums
        if needed > MOST_BYTES:
            raise InputError(
                f"Correlations may keep {MOST_BYTES:,} bytes at most; {len(discs):,} discs at lags up to "
                f"{2 ** (levels - 1) * (self._points - 1) * interval:g} need {needed:,}. Follow fewer by discs=..., or "
                "give longest=..."
            )
        constant = len(discs) == sim.count and sim.scene.mass is None and conserves_energy(sim.scene)
        found = correlator(self.wave_numbers, self._points, levels)
        square = float(np.square(sim.state.velocity, dtype=np.float64).mean())
        heated = is_heated(sim.scene) and square > 0
        memory = memory_of_baths(sim.scene, square * mean_mass(sim.scene)) if heated else 0.0
        self._motion = Motion(found, discs, np.zeros((2, len(discs), 2)), interval, constant, memory, sim.count)
        return self._motion

    def _levels(self, interval: float) -> int:
        """Levels of the correlator whose samples have this interval."""
        if self._longest is None:
            return LEVELS
        if (intervals := self._longest / interval) > MOST_LOOKS:
            raise InputError(
                f"longest must be at most {MOST_LOOKS:g} sampling intervals of {interval:g}; got {self._longest:g}. "
                "Give a shorter lag, or sample less often."
            )
        return levels_for(math.ceil(intervals), self._points)

    @property
    def msd(self) -> TimeCorrelation:
        """Mean squared displacement, <|r(t) - r(0)|^2> [length^2]; <v^2> t^2 at short times, 4 D t at long ones.

        Raises:
            NotRecordedError: before the first sample.
        """
        return self._gathered().function(SQUARES)

    @property
    def velocity(self) -> TimeCorrelation:
        """Velocity autocorrelation, <v(t).v(0)> [length^2/time^2]; 2 kT/m at lag 0 in equilibrium.

        Raises:
            NotRecordedError: before the first sample.
        """
        return self._gathered().function(VELOCITIES)

    def scattering(self, wave_number: float) -> TimeCorrelation:
        """Self intermediate scattering function, <cos(k (x(t) - x(0)))> averaged over x and y [1].

        It tends to exp(-k^2 D t) at long times.

        Args:
            wave_number: k, one of those given at the start [1/length].

        Raises:
            InputError: if it is not one of these.
            NotRecordedError: before the first sample.
        """
        k = checks.positive("wave_number", wave_number, "[1/length]")
        at = np.flatnonzero(np.isclose(self.wave_numbers, k, rtol=1e-12, atol=0.0))
        if not len(at):
            raise InputError(
                f"wave_number must be one of those that were gathered, {self.wave_numbers.tolist()}; got {k!r}. Give "
                f"Correlations(wave_numbers=[{k!r}])."
            )
        return self._gathered().function(WAVES + int(at[0]))

    def diffusion(
        self, start: float | None = None, end: float | None = None, *, route: Route = "displacement"
    ) -> Measure:
        """Diffusion constant D from lags between start and end [length^2/time].

        From displacements, it is (MSD(end) - MSD(start)) / (4 (end - start)). From velocities, it is half the integral
        of their autocorrelation from 0 to t, averaged over t from start to end. In a stationary state both are the same
        number, from different samples; the second has an error of the trapezoidal rule of order (sampling interval /
        mean free time)^2 / 12.

        In two dimensions D(t) grows slowly, like log t, in an infinite fluid (Alder & Wainwright 1970). In a periodic
        box it approaches a value that depends on the number of discs. So state the lags and the number of discs with
        the result.

        Args:
            start, end: lags [time]; the nearest recorded lags are used. None: end is 1/40 of the sampled time, start is
                half of end.
            route: "displacement" or "velocity".

        Returns:
            D with its error. Not settled if the run is too short, or if the motion at `start` is not yet diffusive: the
            velocity autocorrelation there still exceeds its error and the fraction DECAYED of its value at lag 0.

        Raises:
            InputError: for lags that were not recorded, or start >= end.
            NotRecordedError: if there were too few samples.

        Source: Einstein (1905); Green (1954), Kubo (1957).
        """
        checks.choice("route", route, ("displacement", "velocity"))
        return self._gathered().diffusion(start, end, route)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write everything recorded so far to a file, for `load`; an existing file is replaced.

        Args:
            path: ends in .npz.

        Raises:
            InputError: for another ending.
            NotRecordedError: before the first sample.
            OutputError: if it cannot be written.
        """
        motion = self._gathered()
        assert self._bound is not None  # since the first look
        numbers = {"every": self.every, "points": self._points, "frame": self._frame, "count": self._bound[1]}
        reals = {"start": self.start, "dt": self._bound[0]}
        return write(path, motion, numbers, reals, self.wave_numbers)

    def keep(self) -> None:
        """Write the file at `path`, if there is one: a run does so before it writes a checkpoint."""
        if self.path is not None and self._motion is not None:
            self.save(self.path)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Correlations:
        """Read what `save` or a run with checkpoints has written, for reading, or to observe the resumed simulation.

        The simulation may resume at an earlier frame: samples that are in the file are not taken again. The averages
        then have the same bits as those of an uninterrupted run. The file is written with each further checkpoint.

        Args:
            path: of the file.

        Raises:
            InputError: if it is not such a file.

        >>> import tempfile, mpsim
        >>> scene = mpsim.Scene.random(count=50, packing=0.2, radius=0.5, seed=1)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     first = mpsim.Correlations(path=f"{folder}/run.npz")
        ...     with mpsim.Simulation(scene) as sim:
        ...         report = sim.run(frames=50, observe=first, checkpoint=f"{folder}/run.mpsim")
        ...     again = mpsim.Correlations.load(f"{folder}/run.npz")
        ...     with mpsim.Simulation.resume(f"{folder}/run.mpsim") as sim:
        ...         report = sim.run(frames=50, observe=again)
        >>> again.msd[0].samples
        101
        """
        motion, numbers, reals, wave_numbers = read(path)
        again = cls(
            numbers["every"],
            start=reals["start"],
            discs=motion.discs,
            wave_numbers=wave_numbers,
            points=numbers["points"],
        )
        again.path, again._motion, again._bound = Path(path), motion, (reals["dt"], numbers["count"])
        again._frame, again._continuing = numbers["frame"], True
        return again

    def __repr__(self) -> str:
        if self._motion is None:
            return "<Correlations: nothing gathered yet>"
        samples, discs = self._motion.correlator.blocks.samples, len(self._motion.discs)
        return f"<Correlations: {samples} samples of {discs} discs, lags up to {self._motion.lags[-1]:g}>"

    def _gathered(self) -> Motion:
        if self._motion is None:
            raise NotRecordedError(
                "Correlations have gathered nothing yet. Give them to sim.run(..., observe=correlations), and let the "
                f"run pass start = {self.start:g}."
            )
        return self._motion


def _wave_numbers(values: ArrayLike) -> Floats:
    found = checks.finite_array("wave_numbers", values, (None,), "(K,)")
    if len(found) > MOST_WAVE_NUMBERS or (found <= 0).any():
        raise InputError(
            f"wave_numbers must be at most {MOST_WAVE_NUMBERS} numbers > 0 [1/length]; got "
            f"{checks.brief(found.tolist())}. Leave out the others."
        )
    return found


def _numbers(values: ArrayLike | Iterable[int]) -> NDArray[np.int64]:
    """Numbers of discs, each once, in the order given."""
    try:
        found = np.asarray(values)
    except ValueError:  # rows of several lengths
        found = np.zeros(0)
    whole = found.ndim == 1 and found.dtype.kind in "iu"
    if not whole or ((found < 0) | (found >= 2**62)).any() or len(np.unique(found)) != len(found):
        raise InputError(
            f"discs must be numbers of discs, shape (D,), whole, >= 0, each once; got {checks.brief(values)}. "
            "Use discs=range(100), for instance."
        )
    return found.astype(np.int64)
