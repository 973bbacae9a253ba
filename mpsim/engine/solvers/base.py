"""The protocol of all solvers, which the rest of the engine uses.

A new method is one file with a class that derives from `Solver`, a line in `methods.METHODS`, and its name in `METHODS`
of `scene/settings.py`. Callers ask for `capabilities` (`methods.capabilities_of`), never for a class or a name.
"""

import contextlib
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.core.columns import EXITS, MASS, Column
from mpsim.core.sizes import kept_sizes
from mpsim.core.state import State, part_of
from mpsim.core.team import Alone, Team
from mpsim.engine.solvers.collisions import no_collisions
from mpsim.engine.solvers.in_place import InPlace, in_place
from mpsim.engine.solvers.slices import Slice
from mpsim.engine.solvers.snapshots import Shapes, Snapshot
from mpsim.engine.solvers.speed_limit import SpeedLimit
from mpsim.engine.solvers.speeds import Speeds
from mpsim.errors import InputError
from mpsim.scene.scene import Scene
from mpsim.scene.settings import MethodName, Settings

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
    """

    capabilities: ClassVar[Capabilities]
    count: int
    choice: Choice
    substeps: int = 1
    origin: Origin = Origin()
    tallied: bool = False
    logging: bool = False

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

    def discs(self) -> NewDiscs:
        """Copies of all discs now, with all that they have, for `replace`.

        Raises:
            InputError: if the method cannot change discs between two frames.
        """
        raise self._cannot_change()

    def replace(self, discs: NewDiscs) -> None:
        """Continue from here with these discs in place of those that are there, as many, of the same radii.

        Raises:
            InputError: for discs that the method cannot do.
            ResourceError, WorkerDiedError, WorkerStalledError: as `add`.
        """
        raise self._cannot_change()

    def assume(self, scene: Scene, settings: Settings, origin: Origin) -> None:
        """Take another scene and settings for those in force, before `restore`; they differ as `adopt` says.

        Raises:
            InputError: for a scene or settings that the method cannot do, naming them; then nothing has changed.
        """
        self._scene, self._settings, self.origin = scene, settings, origin

    def adopt(self, scene: Scene, settings: Settings, choice: Choice, origin: Origin) -> None:
        """Continue from here under another scene and settings, with the same discs.

        Other may be numbers of the scene, what moves its wall and its emitters, its obstacles, and whether discs can be
        absent; dt, contact, passes, substeps, workers of the settings. Where dt is another, the origin is now.

        Raises:
            InputError, ResourceError, WorkerDiedError, WorkerStalledError: as `assume` and `add`.
        """
        raise self._cannot_change()

    def _cannot_change(self) -> InputError:
        return InputError(
            f"method={self.choice.method!r} cannot change what it simulates between two frames. Use another method."
        )

    # --- snapshots

    @abstractmethod
    def snapshot(self) -> Snapshot:
        """Copies of everything that the next frame depends on, with which `restore` gives the same bits."""

    @abstractmethod
    def restore(self, snapshot: Snapshot, choice: Choice, room: int = 0) -> None:
        """Go back, or on, to a snapshot of this scene, of this method or one that `auto` may have taken before.

        Workers, if any, are new ones, as those that were there may be dead. May stand in place of `start`.

        Args:
            snapshot: what `snapshot` has returned, or a checkpoint that has been checked.
            choice: what then runs, by a method of this class.
            room: discs for which there is then room without another move, if it needs one for them.

        Raises:
            ResourceError, WorkerDiedError, WorkerStalledError: as `start`.
        """

    @staticmethod
    @abstractmethod
    def snapshot_shapes(scene: Scene, settings: Settings, count: int) -> Shapes:
        """dtype and shape of every array of a snapshot of so many discs."""

    @staticmethod
    @abstractmethod
    def check_snapshot(scene: Scene, settings: Settings, snapshot: Snapshot) -> None:
        """Raise ValueError for a snapshot from a file in which no solver can have been, saying why.

        Its arrays have the right shapes, and radii, masses and `progress` have been looked at.
        """

    def demand_alike(self, what: str, given: object) -> None:  # noqa: B027 - not abstract: most are one process
        """Refuse what is given if it differs in any of the processes that share the simulation; all of them ask.

        Raises:
            InputError: naming what.
        """

    def together(self) -> contextlib.AbstractContextManager[None]:
        """A block in which what one raises of the processes that share the simulation, all raise. Before `start`."""
        return contextlib.nullcontext()

    def any_of(self, said: bool) -> bool:
        """Whether something is so in any of the processes that share the simulation; all ask in the same order."""
        return said

    def once(self, act: Callable[[], Result]) -> Result:
        """What an act gives that one process does: the first, where several share the simulation.

        It may read the discs of all of them; what it raises, all raise.
        """
        return act()

    def jointly(self, act: Callable[[Team], Result]) -> Result:
        """What an act gives that all processes do which share the simulation, and are a team.

        In it each may read discs of all of them, whenever the others read some: the same arrays of a snapshot, but each
        the rows that it wants.
        """
        return act(Alone())

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

    @property
    def too_fast(self) -> bool:
        """Whether a disc was too fast in the last command, and so ended it."""
        return False

    def disc_too_fast(self) -> Speeds | None:
        """The disc that was too fast in the last command, reported once; None where there was none."""
        return None

    def speeds(self, new: NewDiscs | None = None) -> Speeds:
        """How fast the discs are, those that are about to be added included."""
        return Speeds()

    def set_speed_limit(self, limit: SpeedLimit) -> None:  # noqa: B027 - not abstract: a method may have no steps
        """From now on end a command with the frame in which a disc is so fast."""

    def divide(self, substeps: int) -> None:  # noqa: B027
        """Divide the frames that follow into so many steps, >= 1."""
