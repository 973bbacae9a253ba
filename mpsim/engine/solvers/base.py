"""The protocol of all solvers, and what they hand over: slices, snapshots, collisions, discs in place."""

import contextlib
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.core.columns import COLUMNS, EXITS, MASS, Column, kept_sizes
from mpsim.core.state import Box, State, part_of
from mpsim.engine.solvers.speeds import SpeedLimit, Speeds
from mpsim.engine.workers.shared import ArraySpec
from mpsim.errors import InputError
from mpsim.features.obstacles import OBSTACLES
from mpsim.kernels import records
from mpsim.kernels.features import collisions as log
from mpsim.scene.scene import Scene
from mpsim.scene.settings import MethodName, Settings

# --- Times and counts of one command of a solver

MOST_COUNTED = 2.0**61
"""The largest sum of momenta, in units of the counts: of impulses twice as large the sum fits into 63 bits."""


@dataclass(frozen=True)
class Slice:
    """What one command of a solver took and counted.

    Attributes:
        times: int64 [ns], shape (workers, frames, phases), zero for workers at rest.
        contacts: contacts resolved.
        tally: COUNTS, shape (frames,), in the scene's units, or None if nothing was to be counted.
    """

    times: NDArray[np.int64]
    contacts: int
    tally: NDArray[Any] | None


def totals(tally: NDArray[Any], scale: float, diameter: float) -> NDArray[Any]:
    """What all workers counted in each frame, in the scene's units: COUNTS, shape (frames,).

    Args:
        tally: TALLY, shape (workers, frames), in units of the kernels.
        scale: by which impulses were multiplied.
        diameter: of the largest disc [length].
    """
    found = np.zeros(tally.shape[1], records.COUNTS)
    for name in records.COUNTS.names or ():
        found[name] = tally[name].sum(axis=0)
    found["deepest"] = tally["deepest"].max(axis=0)
    for name in records.IMPULSES:
        found[name] /= scale
    for name in records.DEPTHS:
        found[name] *= diameter / records.DEPTH_SCALE
    return found


# --- Snapshots of solvers, and checks of those that come from a file
#
# The digest of a file tells that it is what was written. A file that was written by hand can have the right digest;
# kernels index arrays without looking, so nothing that they follow may lead out of them.

SolverState = dict[str, Any]
"""Everything that the next frame depends on, by name: what a checkpoint holds. Copies, or arrays of `core.chunks` that
are read when they are written. In each there are `radii` and `masses`, float64 of shape (N,), in the order of the
scene's discs, and `progress`, int64 of shape (2,): frames done since the start, and steps (of a solver without steps, a
count of its own)."""

Shapes = dict[str, tuple[np.dtype[Any], tuple[int, ...]]]
"""dtype and shape of arrays, by name."""

MOST_STEPS = 2**60

INTEGER, REAL = np.dtype(np.int64), np.dtype(np.float64)


def count_in(snapshot: SolverState) -> int:
    """Number of discs in a snapshot."""
    return len(snapshot["radii"])


def shapes_in_each(count: int) -> Shapes:
    """dtype and shape of what every snapshot has."""
    return {"radii": (REAL, (count,)), "masses": (REAL, (count,)), "progress": (INTEGER, (2,))}


def demand(condition: Any, text: str) -> None:
    """Raise ValueError with that text unless the condition is true."""
    if not condition:
        raise ValueError(text)


def check_periods(scene: Scene, image: NDArray[np.int64]) -> None:
    """Raise ValueError unless counts of periods, shape (N, 2), are 0 along axes with walls."""
    demand((image[:, ~np.array(scene.periodic)] == 0).all(), "no disc can have moved through a wall")


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

ROOM, ROOM_OF_A_DISC = 4096, 2
"""Rows of all logs together: so many, and so many more for each disc."""


def specs_of(count: int, workers: int, least: int = 0) -> dict[str, ArraySpec]:
    """The arrays of the logs in a block, with room for at least so many rows in each."""
    room = max((ROOM + ROOM_OF_A_DISC * count) // workers, least, 1)
    return {
        log.ROWS: ArraySpec(log.COLLISION, (workers, room)),
        log.STATE: ArraySpec(np.dtype(np.int64), (workers, log.STATE_SIZE)),
    }


def longest(arrays: Mapping[str, Any]) -> int:
    """Rows of the longest log, those that did not fit included."""
    return int(arrays[log.STATE][:, log.COUNT].max())


def fit(arrays: Mapping[str, Any]) -> bool:
    """Whether all rows have fitted the logs."""
    return longest(arrays) <= arrays[log.ROWS].shape[1]


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
    _name_obstacles(table, scene)
    _put_lower_disc_first(table)
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


def _name_obstacles(table: NDArray[Any], scene: Scene) -> None:
    met = table["kind"] == log.OBSTACLE
    if met.any():
        table["j"][met] = OBSTACLES.owners(scene)[table["j"][met]]


def _put_lower_disc_first(table: NDArray[Any]) -> None:
    swapped = (table["kind"] == log.DISC) & (table["i"] > table["j"])
    table["i"][swapped], table["j"][swapped] = table["j"][swapped], table["i"][swapped]
    table["impulse"][swapped] *= -1
    table["tangential_impulse"][swapped] *= -1


def no_collisions() -> NDArray[Any]:
    """An empty table."""
    return np.zeros(0, TABLE)


def joined(tables: list[NDArray[Any]]) -> NDArray[Any]:
    """Several tables as one."""
    return np.concatenate([no_collisions(), *tables])


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


# --- The protocol of all solvers, which the rest of the engine uses
#
# A new method is one file with a class that derives from `Solver`, a line in `methods.METHODS`, and its name in
# `METHODS` of `scene/settings.py`. Callers ask for `capabilities` (`methods.capabilities_of`), never for a class or a
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


class Columns(NamedTuple):
    """Who is where in the grid.

    Attributes:
        of_disc: column of each disc, shape (N,).
        owner: the worker to whom the next frame gives that column, shape (N,).
        number: of columns, of equal width.
    """

    of_disc: NDArray[np.int64]
    owner: NDArray[np.int64]
    number: int


class Origin(NamedTuple):
    """When the length of frames in force began to act: `frame`, frames done, and `time` [time], since the start.

    A solver counts its frames from there.
    """

    frame: int = 0
    time: float = 0.0


class Terms(NamedTuple):
    """What is in force: scene and settings, with all changes made so far, and when their frames began."""

    scene: Scene
    settings: Settings
    origin: Origin


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


@dataclass(frozen=True)
class Capabilities:
    """What can be known of a method before there is a solver.

    Attributes:
        has_steps: frames are made of steps, so that a disc can be too fast for one. Without steps `dt` only says when
            frames end, and `contact`, `passes` and `substeps` change nothing.
        is_exact: its only error is rounding, so that other methods are compared with it.
        on_ranks: several processes make the same calls, each with a simulation of its own.
    """

    has_steps: bool
    is_exact: bool = False
    on_ranks: bool = False


class Group:
    """The processes that share a simulation, who all make the same calls: one alone, unless a subclass says more."""

    def demand_alike(self, what: str, given: object) -> None:
        """Refuse what is given if it differs in any of them; all of them ask.

        Raises:
            InputError: naming what.
        """

    def together(self) -> contextlib.AbstractContextManager[None]:
        """A block in which what one of them raises, all raise. Before `start`."""
        return contextlib.nullcontext()

    def any_of(self, said: bool) -> bool:
        """Whether something is so in any of them; all ask in the same order."""
        return said

    def once(self, act: Callable[[], Result]) -> Result:
        """Act on the first of them alone, and return the result on all.

        The act may read the discs of all of them; what it raises, all raise.
        """
        return act()

    @property
    def is_first(self) -> bool:
        """Whether this process is the first of them."""
        return True


ALONE = Group()


class Solver(ABC):
    """Runs the frames of a scene by one method.

    It holds nothing that would have to be given back until `start`: so its owner knows of it before. Unless something
    else is said, members may be used between `start` and `close`, and change nothing if they raise. Discs are in the
    order of the scene's, added ones follow; N is their number.

    Args:
        scene, settings: of the simulation.
        choice: what runs. Its method is one for which `methods.METHODS` names this class.

    Raises:
        InputError: for a scene or settings that the method cannot do, naming them.

    Attributes:
        capabilities: of the method.
        count: number of discs, N.
        choice: what runs.
        substeps: steps of a frame now; 1 without steps.
        origin: when the scene and settings in force began to act.
        tallied: whether what measures need is counted, and put into Slice.tally; may be set between two commands.
        logging: whether collisions are logged, for `take_collisions`; may be set before `start`, and changed by
            `log_collisions`.
        too_fast: whether a disc was too fast in the last command, and so ended it.
    """

    capabilities: ClassVar[Capabilities]
    count: int
    choice: Choice
    substeps: int = 1
    origin: Origin = Origin()
    tallied: bool = False
    logging: bool = False
    too_fast: bool = False

    @abstractmethod
    def __init__(self, scene: Scene, settings: Settings, choice: Choice):
        """Check that the method can do the scene, and plan."""
        self._scene = scene
        self._settings = settings
        self.count = scene.count
        self.choice = choice
        self._radii: NDArray[np.float64] = kept_sizes(scene.radii)
        self._masses: NDArray[np.float64] = kept_sizes(scene.masses)

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
    def advance(self, frames: int, workers: int, stop: float = math.inf) -> Slice:
        """Run up to so many frames on so many workers, and return what they took and counted.

        Fewer where they take longer than expected, so that no call lasts much longer than a tenth of a second.

        Args:
            frames: >= 1, at most workers.arrays.MOST_FRAMES.
            workers: one of choice.workers.
            stop: where to end, if it comes first [time]: with the frame that reaches it, or at it, inside the frame.

        Raises:
            DivergedError, StalledError, WorkerDiedError, WorkerStalledError: it can then only be closed, or restored.
        """

    def log_collisions(self, wanted: bool) -> None:
        """Have collisions logged from now on, or not; see `logging`.

        Raises:
            InputError: if they are wanted, and the method does not log them.
            ResourceError, WorkerDiedError, WorkerStalledError: as `start`.
        """
        if wanted:
            raise InputError(
                f"method={self.choice.method!r} does not log collisions, for which observe asks. Use method='event', "
                "'parallel', 'grid' or 'naive'."
            )

    def take_collisions(self) -> NDArray[Any]:
        """The collisions since the last call, those of a frame in hand included, in order: TABLE (`collisions.py`)."""
        return no_collisions()

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

    def time_of(self, frame: int) -> float:
        """The time at the end of a frame that is done under the parameters in force, or is to come [time]."""
        return self.origin.time + (frame - self.origin.frame) * self._settings.dt

    @property
    def half_done(self) -> bool:
        """Whether the last command was left in the middle, so that there is no whole state. Also after `close`."""
        return False

    # --- discs

    @abstractmethod
    def state(self) -> State:
        """Copies of positions and velocities now, (N, 2), with what else a state has. Taking them changes nothing."""

    def state_between(self, first: int, last: int) -> State:
        """The same of the discs of these numbers, from `first` to before `last`."""
        return part_of(self.state(), first, last)

    def read_in_place(self, read: Callable[[InPlace], Result]) -> Result:
        """What a function gives that reads the discs where they lie. It must keep no view, and write nothing."""
        return read(in_place(self.state(), self._scene.box, self.frame, self.time, self.radii))

    def local_state(self) -> tuple[NDArray[np.int64], State]:
        """Numbers, rising, of the discs that this process has, and their state."""
        return np.arange(self.count), self.state()

    def digest(self) -> str:
        """Hex digest of the state: `State.digest`."""
        return self.state().digest()

    @property
    def radii(self) -> NDArray[np.float64]:
        """Radius of each disc, shape (N,), read-only [length]."""
        return self._radii

    @property
    def masses(self) -> NDArray[np.float64]:
        """Mass of each disc, shape (N,), read-only [mass]."""
        return self._masses

    @property
    def absorbed(self) -> NDArray[np.bool_]:
        """Which discs have left, through an absorbing edge or removed, shape (N,)."""
        return np.zeros(self.count, bool)

    @abstractmethod
    def add(self, new: NewDiscs, choice: Choice) -> None:
        """Append discs that have been checked, and continue as `choice` says, whose method is one of this class.

        One that leaves, through an absorbing edge or removed, keeps its number.

        Raises:
            InputError: for discs that the method cannot do.
            ResourceError, WorkerDiedError, WorkerStalledError: as `start`; `half_done` says whether the state is lost.
        """

    # --- changes between two frames

    def discs(self, numbers: NDArray[np.int64] | None = None) -> NewDiscs:
        """Copies of discs now, with all that they have, for `replace`.

        numbers: of them, shape (K,), each once; None: all.

        Raises:
            InputError: if the method cannot change discs between two frames.
        """
        raise self._cannot_change()

    def replace(self, discs: NewDiscs, numbers: NDArray[np.int64] | None = None) -> None:
        """Continue from here with these discs in place of those that are there, as many, of the same radii.

        numbers: of those that they replace, shape (K,), each once; None: all.

        Raises:
            InputError: for discs that the method cannot do.
            ResourceError, WorkerDiedError, WorkerStalledError: as `add`.
        """
        raise self._cannot_change()

    @property
    def terms(self) -> Terms:
        """Scene and settings in force."""
        return Terms(self._scene, self._settings, self.origin)

    def _assume(self, terms: Terms) -> None:
        """Take these terms for those in force; they differ as `adopt` says.

        Raises:
            InputError: for a scene or settings that the method cannot do, naming them; then nothing has changed.
        """
        self._scene, self._settings, self.origin = terms

    def adopt(self, terms: Terms, choice: Choice) -> None:
        """Continue from here under another scene and settings, with the same discs.

        Other may be numbers of the scene, what moves its wall and its emitters, its obstacles, and whether discs can be
        absent; dt, contact, passes, substeps, workers of the settings. Where dt is another, the origin is now.

        Raises:
            InputError: for a scene or settings that the method cannot do, naming them; then nothing has changed.
            ResourceError, WorkerDiedError, WorkerStalledError: as `add`.
        """
        raise self._cannot_change()

    def _cannot_change(self) -> InputError:
        return InputError(
            f"method={self.choice.method!r} cannot change what it simulates between two frames. Use another method."
        )

    # --- snapshots

    @abstractmethod
    def snapshot(self) -> SolverState:
        """Copies of everything that the next frame depends on, with which `restore` gives the same bits."""

    @abstractmethod
    def restore(
        self,
        snapshot: SolverState,
        choice: Choice,
        room: int = 0,
        terms: Terms | None = None,
        new_workers: bool = True,
    ) -> None:
        """Go back, or on, to a snapshot of this method, or of one that `auto` may have taken before.

        May stand in place of `start`.

        Args:
            snapshot: what `snapshot` has returned, or a checkpoint that has been checked.
            choice: what then runs, by a method of this class.
            room: discs for which there is then room without another move, if it needs one for them.
            terms: then in force, which differ as `adopt` says; None: those that are.
            new_workers: whether workers, if any, are new ones, as those that were there may be dead.

        Raises:
            InputError: as `adopt`.
            ResourceError, WorkerDiedError, WorkerStalledError: as `start`.
        """

    @staticmethod
    @abstractmethod
    def snapshot_shapes(scene: Scene, settings: Settings, count: int) -> Shapes:
        """dtype and shape of every array of a snapshot of so many discs."""

    @staticmethod
    @abstractmethod
    def check_snapshot(scene: Scene, settings: Settings, snapshot: SolverState) -> None:
        """Raise ValueError for a snapshot from a file in which no solver can have been, saying why.

        Its arrays have the right shapes, and radii, masses and `progress` have been looked at.
        """

    @property
    def group(self) -> Group:
        """The processes that share the simulation, this one among them."""
        return ALONE

    # --- what a report says

    @property
    def guarded(self) -> int:
        """Losses of energy that a guard against endless collisions has suppressed so far; 0 without one."""
        return 0

    @property
    def contact_time(self) -> float:
        """Time between two contacts of a disc within which that guard acts [time]; 0 without one."""
        return 0.0

    @property
    def most_momentum(self) -> float:
        """Momenta whose sum is larger make impulses that its counts cannot hold [mass length/time]."""
        return math.inf

    @property
    @abstractmethod
    def array_names(self) -> tuple[str, ...]:
        """Names of the arrays in the block."""

    @abstractmethod
    def resources(self) -> tuple[tuple[int, ...], int]:
        """Resident bytes of each process, this one first, and the size of the block [bytes]."""

    @property
    def pids(self) -> list[int]:
        """Process numbers of the workers other than this process, at any moment; none where all is done in it."""
        return []

    def columns(self) -> Columns | None:
        """Column of the grid and owner of each disc; None where discs are not sorted into columns."""
        return None

    # --- steps: without them no disc is too fast for one

    def disc_too_fast(self) -> Speeds | None:
        """The disc that was too fast in the last command, reported once; None where there was none."""
        return None

    def speeds(self, new: NewDiscs | None = None, numbers: NDArray[np.int64] | None = None) -> Speeds:
        """How fast the discs are, those that are about to be added included.

        numbers: of discs, if others need not be looked at.
        """
        return Speeds()

    def set_speed_limit(self, limit: SpeedLimit) -> None:  # noqa: B027 - not abstract: a method may have no steps
        """From now on end a command with the frame in which a disc is so fast."""

    def divide(self, substeps: int) -> None:  # noqa: B027
        """Divide the frames that follow into so many steps, >= 1."""
