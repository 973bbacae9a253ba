"""The protocol of all solvers, and their results: counts, snapshots, collisions, discs in place."""

import contextlib
import math
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import chain
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.core.columns import COLUMNS, EXITS, IN_STATE, MASS, Column, kept_sizes
from mpsim.core.state import Box, Discs, State, StateInChunks, digest_of
from mpsim.engine.feature_arrays import unit_of_work
from mpsim.engine.solvers.speeds import SpeedLimit, Speeds
from mpsim.engine.workers.shared import SharedBlock, Specs, resident_bytes
from mpsim.errors import InputError
from mpsim.features.edges import EDGES
from mpsim.kernels.features import collisions as log
from mpsim.scene.scene import Scene
from mpsim.scene.settings import MethodName, Settings

if TYPE_CHECKING:
    from mpsim.engine.workers.pool import Team

# --- Number of frames until a given time

MOST_FRAMES_OF_A_RUN = 10**12


def frames_until(until: float, dt: float, name: str = "until", origin: float = 0.0) -> int:
    """Frames from the start, or from a time `origin`, to the first that reaches a time, to within its rounding.

    >>> frames_until(2.1, 0.3), frames_until(2.2, 0.3)  # 2.1 / 0.3 is 7.000000000000001
    (7, 8)

    Raises:
        InputError: for more than MOST_FRAMES_OF_A_RUN.
    """
    frames = (until * (1 - 1e-12) - origin) / dt
    if frames > MOST_FRAMES_OF_A_RUN:
        raise InputError(
            f"{name} must be at most {MOST_FRAMES_OF_A_RUN:,} frames of {dt:g}; got {until:g}. Give an earlier time."
        )
    return math.ceil(frames)


# --- The result of one command of a solver

MOST_COUNTED = 2.0**61
"""The largest sum of momenta, in units of the counts: of impulses twice as large the sum fits into 63 bits."""


class BatchResult(NamedTuple):
    """The times and counts of one command of a solver.

    Attributes:
        times: int64 [ns], shape (workers, frames, phases), zero for workers at rest.
        contacts: contacts resolved.
        counters: COUNTS, shape (frames,), in the scene's units, or None if nothing was to be counted.
        guarded: losses of energy that a guard against endless collisions has suppressed.
        too_fast: whether a disc was too fast, and so ended it.
        logged: whether collisions are logged, which can be taken now.
    """

    times: NDArray[np.int64]
    contacts: int
    counters: NDArray[Any] | None
    guarded: int = 0
    too_fast: bool = False
    logged: bool = False


# --- Snapshots of solvers, and checks of those that come from a file
#
# The digest of a file tells that it is what was written. A file that was written by hand can have the right digest;
# kernels index arrays without looking, so nothing that they follow may lead out of them.

SolverState = dict[str, Any]
"""Everything that the next frame depends on, by name: what a checkpoint holds. Copies, or arrays of `core.chunks` that
are read when they are written. In each there are `radii` and `masses`, float64 of shape (N,), in the order of the
scene's discs, and `progress`, int64 of shape (2,): frames done since the start, and steps (of a solver without steps, a
count of its own)."""

MOST_STEPS = 2**60


def count_in(snapshot: SolverState) -> int:
    """Number of discs in a snapshot."""
    return len(snapshot["radii"])


def demand(condition: Any, text: str) -> None:
    """Raise ValueError with that text unless the condition is true."""
    if not condition:
        raise ValueError(text)


def check_shapes(snapshot: SolverState, own: Specs) -> None:
    """Raise ValueError unless a snapshot has a method's own arrays, those of every method, and no others."""
    each = np.float64, (count_in(snapshot),)
    shapes = own | {"radii": each, "masses": each, "progress": (np.int64, (2,))}
    if log.SUM in snapshot:
        shapes |= {log.SUM: (np.int64, (2, snapshot[log.SUM].shape[-1])), log.UNIT: (np.float64, (1,))}
    demand(snapshot.keys() == shapes.keys(), f"it holds arrays {sorted(snapshot)}; needed are {sorted(shapes)}")
    for name, array in snapshot.items():
        dtype, shape = np.dtype(shapes[name][0]), shapes[name][1]
        demand(
            array.dtype == dtype and array.shape == shape,
            f"{name} must be {dtype} of shape {shape}; got {array.dtype} of shape {array.shape}",
        )


def check_periods(scene: Scene, image: NDArray[np.int64]) -> None:
    """Raise ValueError unless counts of periods, shape (N, 2), are 0 along axes with walls."""
    demand((image[:, ~np.array(scene.periodic)] == 0).all(), "no disc can have moved through a wall")


# --- The work of surfaces that move, and of baths, as counted in a block, and as snapshots hold it

NO_WORK: NDArray[np.int64] = np.zeros((2, 2, log.FIRST_OBSTACLE), np.int64)
"""Sums of nothing, as a worker has them."""


def work_specs(scene: Scene, workers: int) -> Specs:
    """The arrays of a block in which workers count work; {} for a scene in which no surface moves or heats."""
    if not scene._works:
        return {}
    owners = log.FIRST_OBSTACLE + len(scene.obstacles)
    shape = workers, 2, 2, -(-owners // 8) * 8  # no two workers write to one pair of cache lines
    return {log.SUM: (np.int64, shape), log.UNIT: (np.float64, (1,))}


def work_together(*sums: NDArray[np.int64]) -> NDArray[np.int64]:
    """Sums of whole units and parts, each of shape (..., 2, owners), added up; some may have more owners."""
    found = np.zeros((2, max(each.shape[-1] for each in sums)), np.int64)
    for each in chain.from_iterable(each.reshape(-1, 2, each.shape[-1]) for each in sums):
        found[:, : each.shape[1]] += each
        found[0] += found[1] >> log.PART_BITS
        found[1] &= log.MASK
    return found


class WorkDone(NamedTuple):
    """Work since the start: what works now, as `Simulation.work` has it, and sums, not yet added up, of this unit."""

    names: tuple[int | str, ...] = ()
    sums: tuple[NDArray[np.int64], ...] = (NO_WORK,)
    unit: float = 0.0

    @property
    def together(self) -> NDArray[np.int64]:
        """Whole units and parts of the work of each owner, shape (2, owners)."""
        return work_together(*self.sums)

    def energies(self) -> dict[int | str, float]:
        """By name, of what works, or has done so."""
        whole, parts = self.together
        energies = ((whole + parts / 2.0**log.PART_BITS) * self.unit).tolist()
        named = zip((*EDGES, "thermostat", *range(len(energies))), energies, strict=False)
        return {name: energy for name, energy in named if energy or name in self.names}


NOTHING_DONE = WorkDone()


# --- The logs of collisions of a solver, and the table made from them

TABLE = np.dtype(
    [
        ("frame", np.int64),  # the number that the simulation's `frame` has at the end of the frame in which it happens
        ("time", np.float64),  # since the start [time]
        ("kind", np.int64),  # DISC, WALL or OBSTACLE
        ("i", np.int64),  # a disc; the lower number of two
        ("j", np.int64),  # the other disc, the edge of the box (an index of EDGES), or the index of the obstacle
        ("impulse", np.float64, (2,)),  # along the normal, on disc i [mass length/time]
        ("tangential_impulse", np.float64, (2,)),  # across it, on disc i [mass length/time]
        ("place", np.float64, (2,)),  # where they touch [length]
    ]
)
"""A collision, as observers are given it."""

ROOM, ROOM_OF_A_DISC = 4096, 2  # rows of all logs together: so many, and so many more for each disc


def specs_of(count: int, workers: int, least: int = 0) -> Specs:
    """The arrays of the logs in a block, with room for at least so many rows in each."""
    room = max((ROOM + ROOM_OF_A_DISC * count) // workers, least, 1)
    return {log.ROWS: (log.COLLISION, (workers, room)), log.STATE: (np.int64, (workers, log.STATE_SIZE))}


def emptied(arrays: Mapping[str, Any]) -> NDArray[Any]:
    """The rows of all logs that are not to be taken back, which they then hold no more. Called between two commands."""
    found = []
    for rows, state in zip(arrays[log.ROWS], arrays[log.STATE], strict=True):
        agreed, count = int(state[log.AGREED]), min(int(state[log.COUNT]), len(rows))
        found.append(rows[:agreed].copy())
        rows[: count - agreed] = rows[agreed:count].copy()
        state[log.COUNT] -= agreed
        state[log.AGREED] = 0
    return np.concatenate(found)


def table_of(rows: NDArray[Any], frame: Any, time: Any, scene: Scene) -> NDArray[Any]:
    """The table of some rows, in its one order: TABLE.

    The order is that of frame, time, disc, and partner; where all of these are equal, whatever else tells two apart.

    Args:
        rows: of the logs, with numbers of discs as in the scene.
        frame, time: of each.
        scene: of the simulation.
    """
    table = np.zeros(len(rows), TABLE)
    table["frame"], table["time"] = frame, time
    for name in ("kind", "i", "j", "impulse", "tangential_impulse", "place"):
        table[name] = rows[name]
    swapped = (table["kind"] == log.DISC) & (table["i"] > table["j"])
    table["i"][swapped], table["j"][swapped] = table["j"][swapped], table["i"][swapped]
    for name in ("impulse", "tangential_impulse"):
        table[name][swapped] *= -1
    for axis, length in enumerate((scene.width, scene.height)):
        if scene.periodic[axis]:
            place = np.mod(table["place"][:, axis], length)
            table["place"][:, axis] = np.where(place == length, 0.0, place)
    return in_order(table)


def in_order(table: NDArray[Any]) -> NDArray[Any]:
    """A table in the order of `table_of`; itself, if it is in order."""
    before, after = table[:-1], table[1:]
    late = (before["frame"] > after["frame"]) | ((before["frame"] == after["frame"]) & (before["time"] > after["time"]))
    if late.any():
        table = table[np.lexsort((table["time"], table["frame"]))]
    same = (table["frame"][1:] == table["frame"][:-1]) & (table["time"][1:] == table["time"][:-1])
    if same.any():
        tied = np.append(same, False) | np.append(False, same)
        table, ties = table.copy(), table[tied]
        vectors = [ties[name][:, axis] for name in ("impulse", "place") for axis in (1, 0)]
        table[tied] = ties[np.lexsort((*vectors, ties["kind"], ties["j"], ties["i"], ties["time"], ties["frame"]))]
    return table


def joined(tables: list[NDArray[Any]]) -> NDArray[Any]:
    """Several tables, or none, as one."""
    return np.concatenate([np.zeros(0, TABLE), *tables])


# --- Reads discs where a solver stores them, without copies in the order of their numbers


class InPlace(NamedTuple):
    """N discs where they lie, in any order. Views: they may be read until the solver does something else, not kept.

    Attributes:
        x, y: shape (N,) [length]; along a periodic axis up to a period beyond the border.
        vx, vy: shape (N,) [length/time].
        number: of each disc, int32, shape (N,).
        absent: which discs have left, by number, shape (N,); None: none can.
        box: where the walls are now [length].
        frame, time: frames done, and time [time], since the start.
        radii: radius of each disc, by number, shape (N,) [length].
    """

    x: NDArray[np.floating]
    y: NDArray[np.floating]
    vx: NDArray[np.floating]
    vy: NDArray[np.floating]
    number: NDArray[np.int32]
    absent: NDArray[np.bool_] | None
    box: Box
    frame: int
    time: float
    radii: NDArray[np.float64]


def in_place(state: State, box: Box, frame: int, time: float, radii: NDArray[np.float64]) -> InPlace:
    """The discs of a state, where that has them.

    Args:
        state: of N discs.
        box: where the walls are if the state does not say [length].
        frame, time, radii: as above.

    >>> state = State(np.array([[1.0, 2.0], [3.0, 4.0]]), np.zeros((2, 2)))
    >>> found = in_place(state, (0.0, 5.0, 0.0, 5.0), 0, 0.0, np.full(2, 0.5))
    >>> found.y.tolist(), found.number.tolist(), found.absent
    ([2.0, 4.0], [0, 1], None)
    """
    (x, y), (vx, vy), absent = state.position.T, state.velocity.T, None if state.present.all() else ~state.present
    number = np.arange(len(x), dtype=np.int32)
    return InPlace(x, y, vx, vy, number, absent, box if state.box is None else state.box, frame, time, radii)


def absorbed_in(found: Mapping[str, NDArray[Any]], count: int) -> NDArray[np.bool_]:
    """Which of n discs have been absorbed, shape (n,), by their columns."""
    return found[EXITS.name][:, 0] != 0 if EXITS.name in found else np.zeros(count, bool)


def state_of(found: dict[str, NDArray[Any]], absorbed: NDArray[np.bool_], box: Box) -> State:
    """The state of N discs; it takes over their arrays, and absent ones have nothing that does not rest.

    Args:
        found: positions, velocities and columns by name, of shape (N, *components).
        absorbed: which discs have left, shape (N,).
        box: where the walls are [length].
    """
    for column in IN_STATE:
        if column.name in found and not column.rests:
            found[column.name][absorbed] = 0
    return State._taken_over(found["position"], found["velocity"], ~absorbed, box, found)


# --- The protocol of all solvers, which the rest of the engine uses
#
# A new method is one file with a class that derives from `Solver`, a line in `methods.METHODS`, and its name in
# `METHODS` of `scene/settings.py`. Callers ask for its capabilities (`methods.capabilities_of`), never for a class or a
# name.

Result = TypeVar("Result")
OnWorkerDeath = Literal["raise", "restart"]
StartMethod = Literal["fork", "spawn", "forkserver"]

DEATHS: tuple[OnWorkerDeath, ...] = get_args(OnWorkerDeath)
START_METHODS: tuple[StartMethod, ...] = get_args(StartMethod)


@dataclass(frozen=True)
class Processes:
    """How a simulation uses processes. But for `unguarded`, no bit depends on it.

    Args:
        comm: communicator of mpi4py, of a method that runs on ranks; None: all ranks.
        start_method, on_worker_death, unguarded: as of a `Simulation`.

    Raises:
        InputError: naming the argument.
    """

    comm: Any = None
    start_method: StartMethod | None = None
    on_worker_death: OnWorkerDeath = "raise"
    unguarded: bool = False

    def __post_init__(self) -> None:
        if self.start_method is not None:
            checks.choice("start_method", self.start_method, START_METHODS)
        checks.choice("on_worker_death", self.on_worker_death, DEATHS)
        checks.truth("unguarded", self.unguarded)


@dataclass(frozen=True)
class Choice:
    """What runs.

    Attributes:
        method: a name of `methods.METHODS`.
        workers: numbers of workers to choose from while running, the likely best first.
        remark: why there is one worker where there could be more; empty: there is nothing to say.
        processes: how it uses processes.
    """

    method: MethodName
    workers: tuple[int, ...]
    remark: str = ""
    processes: Processes = Processes()


class Origin(NamedTuple):
    """When the length of frames in force began to act: `frame`, frames done, and `time` [time], since the start.

    A solver counts its frames from there.
    """

    frame: int = 0
    time: float = 0.0


class Terms(NamedTuple):
    """Scene and settings in force, with all changes made so far, and when their frames began."""

    scene: Scene
    settings: Settings
    origin: Origin = Origin()

    def frame_at(self, time: float, name: str = "until") -> int:
        """The first frame that reaches a time [time]; name: of that argument, for the error of `frames_until`."""
        return self.origin.frame + frames_until(time, self.settings.dt, name, self.origin.time)

    def time_of(self, frame: int) -> float:
        """The time at the end of a frame that is done under these terms, or is to come [time]."""
        return self.origin.time + (frame - self.origin.frame) * self.settings.dt


class NewDiscs(NamedTuple):
    """Discs that enter, or all that there are, K of them.

    Attributes:
        position, velocity: shape (K, 2) [length], [length/time].
        radius: shape (K,), that of all discs in a scene without own ones [length].
        columns: what they bring of columns by id, by name, shape (K, *components): masses always.
    """

    position: NDArray[np.floating]
    velocity: NDArray[np.floating]
    radius: NDArray[np.float64]
    columns: Mapping[str, NDArray[Any]]

    @property
    def mass(self) -> NDArray[np.float64]:
        """Shape (K,), 1 each in a scene without own ones [mass]."""
        return self.columns[MASS.name]

    def of(self, column: Column) -> NDArray[Any]:
        """What they bring of a column, shape (K, *components): zeros of what they do not bring."""
        brought = self.columns.get(column.name)
        return np.zeros(column.rows(len(self.position))) if brought is None else brought

    @property
    def absent(self) -> NDArray[np.bool_]:
        """Which of them have left, shape (K,)."""
        return self.of(EXITS)[:, 0] != 0

    def rows(self, numbers: NDArray[np.int64]) -> "NewDiscs":
        """Those of these numbers, in this order."""
        columns = {name: values[numbers] for name, values in self.columns.items()}
        return NewDiscs(self.position[numbers], self.velocity[numbers], self.radius[numbers], columns)

    def with_rows(self, discs: "NewDiscs", numbers: NDArray[np.int64]) -> "NewDiscs":
        """Copies, in which these discs, of the same radii, take the place of those of these numbers."""
        position, velocity, columns = self.position.copy(), self.velocity.copy(), dict(self.columns)
        position[numbers], velocity[numbers] = discs.position, discs.velocity
        for column in COLUMNS:
            if column.name in discs.columns:
                columns[column.name] = self.of(column).copy()
                columns[column.name][numbers] = discs.of(column)
        return NewDiscs(position, velocity, self.radius, columns)


class Ranks:
    """The processes that share something and make the same calls: this one alone, unless a subclass says more.

    Attribute is_root: whether this process is the first of them.
    """

    is_root: bool = True

    def close(self) -> None:
        """Release the communicator. May be called again."""

    def assert_same_on_ranks(self, what: str, value: object) -> None:
        """Refuse a value that differs on any of them.

        Raises:
            InputError: naming what, on all.
        """

    def collective(self) -> contextlib.AbstractContextManager[None]:
        """A block in which an error of one of them is raised on all."""
        return contextlib.nullcontext()

    def any_rank(self, flag: bool) -> bool:
        """Whether a flag is set on any of them."""
        return flag

    def all_of(self, value: Any) -> list[Any]:
        """The values of all of them, in their order."""
        return [value]

    def on_root(self, act: Callable[[], Result]) -> Result:
        """Act on the first of them alone, and return the result, or raise the error, on all.

        The act may read the discs of all of them.
        """
        return act()


ALONE = Ranks()


class Steps:
    """The part of a solver that only methods with steps have: speeds, at which a disc is too fast for a step.

    Attributes:
        substeps: steps of a frame now.
        too_fast: whether a disc was too fast in the last command, and so ended it; until `speeds` has told which.
    """

    substeps: int = 1
    too_fast: bool = False

    def speeds(self, new: NewDiscs | None = None, numbers: NDArray[np.int64] | None = None) -> Speeds:
        """How fast the discs are, or one was that ended the last command.

        Args:
            new: discs that are about to be added; None: none are.
            numbers: of discs, if others need not be looked at.
        """
        raise NotImplementedError

    def set_speed_limit(self, limit: SpeedLimit) -> None:
        """End each command with the frame in which a disc is so fast."""
        raise NotImplementedError

    def set_substeps(self, substeps: int) -> None:
        """Divide the following frames into so many steps, >= 1."""
        raise NotImplementedError


def set_substeps(solver: "Solver", substeps: int) -> None:
    """Divide the following frames of a solver into so many steps, if it has any."""
    if isinstance(solver, Steps):
        solver.set_substeps(substeps)


class Solver(ABC):
    """Runs the frames of a scene by one method.

    It holds nothing that would have to be given back until `start`: so its owner knows of it before. Unless something
    else is said, members may be used between `start` and `close`, and change nothing if they raise. Discs are in the
    order of the scene's, added ones follow; N is their number. What only some methods have is in `Steps` and
    `CollisionLog`, from which their solvers derive as well.

    Args:
        scene, settings: of the simulation.
        choice: what runs. Its method is one for which `methods.METHODS` names this class.

    Raises:
        InputError: for a scene or settings that the method cannot do, naming them.

    Attributes:
        count: number of discs, N.
        radii, masses: of each disc, shape (N,), read-only [length], [mass].
        choice: what runs.
        terms: scene and settings in force.
    """

    _team: "Team"

    @abstractmethod
    def __init__(self, scene: Scene, settings: Settings, choice: Choice):
        """Check that the method can do the scene, and plan."""
        self._scene: Scene = scene
        self._settings: Settings = settings
        self._origin: Origin = Origin()
        self.count: int = scene.count
        self.choice: Choice = choice
        self.radii: NDArray[np.float64] = kept_sizes(scene.radii)
        self.masses: NDArray[np.float64] = kept_sizes(scene.masses)
        self._work_before: NDArray[np.int64] = NO_WORK  # what was done before the present block was filled
        self.work_unit: float = 0.0  # 0: none has been done

    @property
    def terms(self) -> Terms:
        return Terms(self._scene, self._settings, self._origin)

    def _set_terms(self, terms: Terms) -> None:
        """Take these terms for those in force; they differ as `change_scene` says."""
        self._scene, self._settings, self._origin = terms

    @property
    def ranks(self) -> Ranks:
        """The processes that share the simulation, this one among them."""
        return ALONE

    @abstractmethod
    def start(self) -> None:
        """Make the block, with the scene's discs in it, load the kernels, and start workers if there are any.

        Whatever stops this, `close` then gives back what there is.

        Raises:
            InputError: for a start that the method cannot do.
            ResourceError, WorkerDiedError, WorkerStalledError: if the block or the workers cannot be had.
        """

    @abstractmethod
    def close(self) -> None:
        """Stop the workers and remove the block. At any moment, and again: it copes with any part of them."""

    # --- frames

    @abstractmethod
    def advance(self, frames: int, workers: int, stop: float = math.inf, count_enabled: bool = False) -> BatchResult:
        """Run up to so many frames on so many workers.

        Fewer where they take longer than expected, so that no call lasts much longer than a tenth of a second.

        Args:
            frames: >= 1, at most workers.arrays.MOST_FRAMES.
            workers: one of choice.workers.
            stop: where to end, if it comes first [time]: with the frame that reaches it, or at it, inside the frame.
            count_enabled: whether what measures need is counted.

        Raises:
            DivergedError, StalledError, WorkerDiedError, WorkerStalledError: it can then only be closed, or restored.
        """

    @property
    @abstractmethod
    def frame(self) -> int:
        """Frames finished since the start."""

    @property
    @abstractmethod
    def time(self) -> float:
        """Time that has been reached since the start [time]: frame * dt, or later if a stop came inside a frame."""

    @abstractmethod
    def reached(self, time: float) -> bool:
        """Whether a time [time] has been reached, but for rounding."""

    @property
    @abstractmethod
    def half_done(self) -> bool:
        """Whether the last command was left in the middle, so that there is no whole state. Also after `close`."""

    # --- discs

    @abstractmethod
    def state(self, first: int = 0, last: int | None = None) -> State:
        """Copies of positions and velocities, (K, 2), with what else a state has. Taking them changes nothing.

        first, last: numbers of the discs, from `first` to before `last`; None: to the end.
        """

    def in_place(self) -> InPlace:
        """The discs where they lie, as views, which must not outlive the next call of this solver."""
        return in_place(self.state(), self._scene.box, self.frame, self.time, self.radii)

    def local_state(self) -> tuple[NDArray[np.int64], State]:
        """Numbers, rising, of the discs that this process has, and their state."""
        return np.arange(self.count), self.state()

    @property
    def absorbed(self) -> NDArray[np.bool_]:
        """Which discs have left, through an absorbing edge or removed, shape (N,)."""
        return ~self.state().present if self._scene._loses_discs else np.zeros(self.count, bool)

    @abstractmethod
    def add(self, new: NewDiscs, choice: Choice) -> None:
        """Append discs that have been checked, and continue as `choice` says, whose method is one of this class.

        One that leaves, through an absorbing edge or removed, keeps its number.

        Raises:
            InputError: for discs that the method cannot do.
            ResourceError, WorkerDiedError, WorkerStalledError: as `start`; `half_done` says whether the state is lost.
        """

    # --- changes between two frames

    @abstractmethod
    def discs(self, numbers: NDArray[np.int64] | None = None) -> NewDiscs:
        """Copies of discs now, with all that they have, for `set_discs`.

        numbers: of them, shape (K,), each once; None: all.
        """

    @abstractmethod
    def set_discs(self, discs: NewDiscs, numbers: NDArray[np.int64] | None = None) -> None:
        """Continue with these discs in place of the present ones, as many, of the same radii.

        numbers: of those that they replace, shape (K,), each once; None: all.

        Raises:
            InputError: for discs that the method cannot do.
            ResourceError, WorkerDiedError, WorkerStalledError: as `add`.
        """

    @abstractmethod
    def change_scene(self, terms: Terms, choice: Choice) -> None:
        """Continue under another scene and settings, with the same discs.

        Other may be numbers of the scene, what moves its wall and its emitters, its obstacles, and whether discs can be
        absent; dt, contact, passes, substeps, workers of the settings. Where dt is another, the origin is now.

        Raises:
            InputError: for a scene or settings that the method cannot do, naming them; then nothing has changed.
            ResourceError, WorkerDiedError, WorkerStalledError: as `add`.
        """

    # --- the work of surfaces and baths

    @property
    def work(self) -> WorkDone:
        """Energy given to discs since the start. Nothing is added up yet: every run asks for it, few want to know."""
        return WorkDone(self._scene._works, (self._work_before, self._work_counted()), self.work_unit)

    def _work_counted(self) -> NDArray[np.int64]:
        """Sums in the present block, shape (..., 2, owners)."""
        return self.block.arrays.get(log.SUM, NO_WORK).copy()

    def _count_work_from(self, before: NDArray[np.int64], unit: float) -> None:
        """Count from 0 in the present block, after this was done; unit: of it, 0 if it is none."""
        arrays = self.block.arrays
        if not unit and log.SUM in arrays:
            unit = unit_of_work(self._scene, self._settings.dt)
        self._work_before, self.work_unit = before, unit
        if log.SUM in arrays:
            arrays[log.SUM][:], arrays[log.UNIT][0] = 0, unit

    def _saved_work(self) -> SolverState:
        """What a snapshot holds of it."""
        return {log.SUM: self.work.together, log.UNIT: np.array([self.work_unit])} if self.work_unit else {}

    def _restore_work(self, snapshot: SolverState) -> None:
        self._count_work_from(snapshot.get(log.SUM, NO_WORK), float(snapshot.get(log.UNIT, np.zeros(1))[0]))

    # --- snapshots

    @abstractmethod
    def snapshot(self) -> SolverState:
        """Copies of everything that the next frame depends on, with which `restore` gives the same bits."""

    @abstractmethod
    def restore(self, snapshot: SolverState, choice: Choice, terms: Terms, new_workers: bool = True) -> None:
        """Go back, or on, to a snapshot of this method, or of one that `auto` may have taken before.

        May stand in place of `start`.

        Args:
            snapshot: what `snapshot` has returned, or a checkpoint that has been checked.
            choice: what then runs, by a method of this class.
            terms: then in force, which differ as `change_scene` says.
            new_workers: whether workers, if any, are new ones, as those that were there may be dead.

        Raises:
            InputError: as `change_scene`.
            ResourceError, WorkerDiedError, WorkerStalledError: as `start`.
        """

    @staticmethod
    @abstractmethod
    def check_snapshot(scene: Scene, settings: Settings, snapshot: SolverState) -> None:
        """Raise ValueError for a snapshot from a file in which no solver can have been, saying why."""

    # --- what a report says

    @property
    def contact_time(self) -> float:
        """Time between two contacts of a disc within which a guard keeps its energy [time]; 0 without one."""
        return 0.0

    @property
    @abstractmethod
    def most_momentum(self) -> float:
        """Momenta whose sum is larger make impulses that its counts cannot hold [mass length/time]."""

    @property
    def block(self) -> SharedBlock:
        """The block of this process."""
        return self._team.block

    def wake_workers(self) -> None:
        """Have the workers that sleep, if any, come: their way overlaps with what is done before the next command."""
        self._team.pool.wake()

    @property
    def pids(self) -> list[int]:
        """Process numbers of the workers other than this process, at any moment; none where all is done in it."""
        return [*self._team.pool.pids]


def is_between_frames(solver: Solver) -> bool:
    """Whether no frame is in hand: Ctrl-C may leave the exact solver inside one."""
    return solver.time == solver.terms.time_of(solver.frame)


class CollisionLog(Solver):
    """A solver that logs collisions. Attribute logging: whether it does now."""

    logging: bool = False

    def log_collisions(self, enabled: bool) -> None:
        """Log collisions from now on, or not.

        Raises:
            ResourceError, WorkerDiedError, WorkerStalledError: as `start`.
        """
        if enabled != self.logging:
            self.logging = enabled
            try:
                self.restore(self.snapshot(), self.choice, self.terms, new_workers=False)
            except BaseException:
                self.logging = not enabled
                raise

    @abstractmethod
    def take_collisions(self) -> NDArray[Any]:
        """The collisions since the last call, those of a frame in hand included, in order: TABLE."""


def log_collisions(solver: Solver, enabled: bool) -> None:
    """Have a solver log collisions from now on, or not.

    Raises:
        InputError: if they are wanted, and the method does not log them.
    """
    if isinstance(solver, CollisionLog):
        solver.log_collisions(enabled)
    elif enabled:
        raise InputError(
            f"method={solver.choice.method!r} does not log collisions, for which observe asks. Use method='event', "
            "'parallel', 'grid' or 'naive'."
        )


def over_all_discs(solver: Solver, function: Callable[[Discs], Result]) -> Result:
    """The result of a function of the present state; on ranks the first one reads it in chunks, as none has it all."""
    if solver.ranks is ALONE:
        return function(solver.state())
    return solver.ranks.on_root(lambda: function(StateInChunks(solver.state, solver.count)))


def digest_of_state(solver: Solver) -> str:
    """`State.digest` of the present state."""

    def digest(discs: Discs) -> str:
        values = discs._held()
        if not solver.terms.scene._loses_discs:
            del values["present"]  # which all of them are
        return digest_of(values)

    return over_all_discs(solver, digest)


def resources_of(solver: Solver) -> tuple[tuple[int, ...], int]:
    """Resident bytes of each process, this one first, and the size of the blocks [bytes]; on ranks of all of them."""
    own = [resident_bytes(pid) for pid in (os.getpid(), *solver.pids)]
    resident, blocks = zip(*solver.ranks.all_of((own, solver.block.nbytes)), strict=True)
    return tuple(chain.from_iterable(resident)), sum(blocks)
