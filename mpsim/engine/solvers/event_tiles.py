"""Tiles of the exact solver, and windows of time that its workers run on them: also the program of these workers."""

import functools
import math
import pickle
from collections.abc import Callable
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mpsim.core.deferred_signals import interrupts_held_back
from mpsim.engine.workers.pool import WorkerPool
from mpsim.engine.workers.shared import SharedBlock, Specs
from mpsim.engine.workers.worker import LINGER, Program
from mpsim.kernels import records as stepped
from mpsim.kernels.events import cells, records
from mpsim.kernels.events.features.hooks import BARE, COLUMNS
from mpsim.kernels.events.windows import (
    FEWEST_ROOM,
    MOST_FRAMES,
    SLACK,
    Own,
    Shared,
    link,
    order_by_tiles,
    run_windows,
)
from mpsim.kernels.features.collisions import log_of, work_of
from mpsim.kernels.records import ABORT, RUNNING

# --- The program of workers

WAITING = "waiting."
"""Before the names of the arrays in which discs wait until all tiles agree."""


class TileArguments(NamedTuple):
    """Arguments of `run_windows`, in its order: those that stay."""

    whole: Any
    features: Any
    box: Any
    shared: Any
    own: Any


def arguments_of(arrays: dict[str, Any], features: Any, box: Any, worker: int = 0) -> TileArguments:
    """Arguments for one worker, with memory of its own, of which the system gives what is written to.

    Args:
        arrays: of the block.
        features, box: of the whole box.
        worker: whose log of collisions and sums of work these are, if there are any.
    """
    features = features._replace(log=log_of(arrays, worker), work=work_of(arrays, worker))
    store = cells.store_of(arrays)
    waiting = features._replace(**{name: arrays[WAITING + name] for name in COLUMNS if name in arrays})
    names = ("tiles", "plan", "plan_times", "counted", "counts", "latest", "busy", "control", "team")
    shared = Shared(arrays[f"{WAITING}disc"], arrays[f"{WAITING}event"], waiting, *(arrays[name] for name in names))
    return TileArguments(store, features, box, shared, _own_of(store, features))


def _own_of(store: Any, features: Any) -> Any:
    """Memory for the largest tile that there can be: all discs."""
    fields = {
        name: np.empty(array.shape, array.dtype) if array.shape else np.zeros((), array.dtype)[()]
        for name, array in store._asdict().items()
        if array is not None
    }
    columns = {name: np.empty_like(value) for name in COLUMNS if (value := getattr(features, name)) is not None}
    bits = fields["disc"].view(np.int64).reshape(len(fields["disc"]), -1)
    store = cells.Store(**fields, region=np.zeros((), records.REGION)[()])
    return Own(store, features._replace(**columns), bits, np.zeros(len(store.disc), np.int32))


def _arguments_in(arrays: dict[str, Any], worker: int) -> TileArguments:
    """`arguments_of` in a worker, which knows the block alone."""
    box, numbers = pickle.loads(arrays["laws"].tobytes())
    features = BARE._replace(**numbers, **{name: arrays[name] for name in COLUMNS if name in arrays})
    return arguments_of(arrays, features, box, worker)


def _idle_call(arguments: TileArguments, worker: int, linger: int) -> tuple[Any, ...]:
    """A call that plays no frame, or, of a worker, waits for commands."""
    progress: Any = np.zeros((), records.PROGRESS)[()]
    seen: Any = np.zeros((), records.TOTALS)[()]
    times, totals = np.zeros((1, 0), np.int64), np.zeros(0, records.TOTALS)
    command: Any = np.array((0, 0, math.inf), records.COMMAND)[()]
    return (*arguments, command, progress, seen, times, totals, worker, linger)


def _load(block: SharedBlock) -> None:
    arguments = _arguments_in(block.arrays, 0)
    shared = arguments.shared
    control, plan = shared.control.copy(), shared.plan.copy()
    control.workers = 1
    private = shared._replace(control=control, plan=plan, team=np.zeros_like(shared.team))
    run_windows(*_idle_call(arguments._replace(shared=private), 0, 0))


def _call(block: SharedBlock, worker: int) -> Callable[[], int]:
    call = _idle_call(_arguments_in(block.arrays, worker), worker, LINGER)
    return lambda: run_windows(*call)[1]  # what it has heard instead of a command


TILES = Program(_load, _call)


# --- Runs windows of time on the tiles of the exact solver, with its workers

BRIEF = 0.12
"""Collisions of a disc in a command of one worker, below which it takes longer to load tiles than they save."""

PATIENCE = 100_000_000
"""Nanoseconds after which a command ends with the window in hand: several tiles, as workers wait for the last one."""


class Windows:
    """Plays frames on the tiles of a block, by this process and the workers in it.

    Args:
        pool: of these workers.
        block: with the arrays of tiles, and a store whose discs have been placed.
        system: the store, its box and features.

    Attribute fewest_contacts: fewer collisions in a command had better be played as a whole, after `link`.
    """

    def __init__(self, pool: WorkerPool, block: SharedBlock, system: Any):
        self._pool = pool
        self.fewest_contacts: float = BRIEF * len(system.store.disc) / len(block.arrays["team"])
        self._command: Any = np.zeros((), records.COMMAND)[()]
        self._arguments: Any = arguments_of(block.arrays, system.features, system.box)
        self._is_linked = True

    @property
    def failed(self) -> bool:
        """Whether a window was left in the middle, as a worker has died or has not come."""
        shared = self._arguments.shared
        return bool(shared.plan.running and shared.control.signals[ABORT] != RUNNING)

    def close(self) -> None:
        """Let go of the block: in a fork that returns into a call of `play`, no kernel may be called."""
        self._arguments = None

    def play(
        self, times: NDArray[np.int64], totals: NDArray[Any], stop: float, present: float, progress: Any, seen: Any
    ) -> tuple[int, int, int]:
        """Play as many frames as `times` has room for, or fewer: as `play_frames`; times: as of `run_windows`.

        present: the time that has been reached.

        Raises:
            WorkerDiedError, WorkerStalledError: if a worker has ended, or has not come.
        """
        self._order(present)
        self._arguments.shared.control.done = progress.frame
        self._command.frames, self._command.stop, self._command.patience = times.shape[1], stop, PATIENCE
        given = self._command, progress, seen, times, totals, 0, 0
        outcome = self._pool.run(lambda: run_windows(*self._arguments, *given))
        if outcome[1] == records.ABORTED:
            raise self._pool.failure()
        return outcome

    def link(self) -> None:
        """Make the store of the whole box one that can be played as a whole, and copied."""
        if not self._is_linked:
            with interrupts_held_back():  # between what is done and the word that it is
                link(self._arguments.whole, self._arguments.box, self._arguments.features, self._arguments.own.places)
                self._is_linked = True

    def _order(self, present: float) -> None:
        if self._is_linked:
            whole, features, box, shared, _ = self._arguments
            with interrupts_held_back():
                order_by_tiles(whole, box, features, shared.tiles, shared.plan)
                shared.times.reached = present
                self._is_linked = False


# --- Division of the box into tiles for the exact solver, and the arrays in which workers simulate them

HALO = 10
"""Cells around a tile that are played with it. What is missing beyond spreads inward by two or three diameters for each
collision that a disc has; see docs/exact.md."""

CACHED = 16_000
"""Discs that fit the cache with all that is known of them."""

PARTS = 16
"""Windows in a lap to begin with: rather too short, as tiles that do not agree are played again."""


class Tiling(NamedTuple):
    """Tiles along each axis; (1, 1): the box is played as a whole."""

    columns: int
    rows: int

    @property
    def number(self) -> int:
        """Of tiles."""
        return self.columns * self.rows


WHOLE = Tiling(1, 1)


@functools.lru_cache(maxsize=4)  # as it is asked for again and again
def tiling_of(count: int, cells: tuple[int, int], periodic: tuple[bool, bool], workers: int) -> Tiling:
    """The tiles into which to divide a box of so many cells along each axis, WHOLE where that does not pay.

    A tile is at least as wide as its halo, so that only tiles side by side need each other's discs.
    """
    best, least = WHOLE, _cost(count, cells, periodic, workers, WHOLE)
    for each in product(*(_numbers_along(cells[axis], periodic[axis]) for axis in range(2))):
        tiling = Tiling(*each)
        if tiling != WHOLE and (cost := _cost(count, cells, periodic, workers, tiling)) < least:
            best, least = tiling, cost
    return best


def _numbers_along(cells: int, periodic: bool) -> list[int]:
    """Numbers of tiles that an axis may have: all small ones, and then ever fewer."""
    most = max(cells // HALO, 1)
    numbers = sorted({min(round(1.15**power), most) for power in range(60)})
    return [each for each in numbers if not (periodic and each == 2 and cells < 4 * HALO)]


def _cost(count: int, cells: tuple[int, int], periodic: tuple[bool, bool], workers: int, tiling: Tiling) -> float:
    """What a division costs, against one worker that plays all from the cache."""
    work = 1.0
    for length, number, around in zip(cells, tiling, periodic, strict=True):
        borders = 0 if number == 1 else 2 if around else 2 - 2 / number
        work *= 1 + borders * HALO * number / length
    in_one = count * work / tiling.number
    misses = 1 + CACHE_MISS * max(math.log2(max(in_one, 1) / CACHED), 0.0)
    shared = math.ceil(tiling.number / workers) / tiling.number
    return (
        work * misses * shared
        + (WINDOW if tiling != WHOLE else 0.0) * shared
        + (BARRIERS / max(count, 1)) * (tiling != WHOLE)
    )


CACHE_MISS = 0.5
"""What discs cost more for each doubling beyond those that fit the cache: measured 1.5 times as much as in the cache at
40,000 discs, 2.4 to 2.7 at 100,000 and 3.6 to 3.9 at a million, on machines of two makers."""

WINDOW = 0.35
"""What it costs to load tiles and to put them back, against playing them."""

BARRIERS = 300.0
"""What the waiting of a window costs, in discs."""


def specs_of(count: int, tiling: Tiling, workers: int, arrays: Specs, laws: bytes) -> Specs:
    """The arrays beside those of the whole box that tiles need, in the shared block.

    Args:
        count, tiling, workers: of the simulation.
        arrays: dtype and shape of those of the whole box, by name.
        laws: as of `packed`.
    """
    room = count + count // SLACK + tiling.number * FEWEST_ROOM
    waiting: Specs = {
        f"{WAITING}{name}": (dtype, (room, *shape[1:]))
        for name, (dtype, shape) in arrays.items()
        if name in ("disc", "event", *COLUMNS)
    }
    return waiting | {
        "tiles": (records.TILE, (tiling.number,)),
        "plan": (records.PLAN, ()),
        "plan_times": (records.PLAN_TIMES, ()),
        "counted": (records.TOTALS, (workers, MOST_FRAMES + 1)),
        "counts": (records.COUNTER, (workers,)),
        "latest": (np.float64, (workers,)),
        "busy": (np.int64, (workers,)),
        "control": (stepped.CONTROL, ()),
        "team": (stepped.MEMBER, (workers,)),
        "laws": (np.uint8, (len(laws),)),
    }


def packed(box: Any, features: Any) -> bytes:
    """What workers must know of a scene besides the arrays of the block."""
    numbers = {name: value for name, value in features._asdict().items() if name not in (*COLUMNS, "log", "work")}
    return pickle.dumps((box, numbers))


def lay_out(arrays: dict[str, Any], tiling: Tiling, box: Any, dt: float, workers: int, laws: bytes) -> None:
    """Write the tiles and the plan into a new block; box: with its cells."""
    cells, periodic = (box.columns, box.rows), (box.periodic_x, box.periodic_y)
    edges = [np.arange(number + 1) * length // number for number, length in zip(tiling, cells, strict=True)]
    places = np.array(list(product(range(tiling.columns), range(tiling.rows))))
    for axis in range(2):
        place = places[:, axis]
        arrays["tiles"]["own_first"][:, axis] = edges[axis][place]
        own = edges[axis][place + 1] - edges[axis][place]
        once = tiling[axis] == 1 or not periodic[axis] or own.max() + 2 * HALO <= cells[axis]
        assert once, "no cell may be in a region twice: the arrays of a tile have no room for that"
        arrays["tiles"]["own"][:, axis] = own
    arrays["plan"].tiles[:] = tiling
    arrays["plan"].halo, arrays["plan"].parts = HALO, PARTS
    arrays["plan_times"].dt = dt
    arrays["control"].workers = arrays["control"].members = workers
    arrays["laws"][:] = np.frombuffer(laws, np.uint8)
