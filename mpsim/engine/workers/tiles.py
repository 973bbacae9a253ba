"""The program of workers of the exact solver: windows of time on the tiles of a shared block."""

import math
import pickle
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from mpsim.engine.workers.shared import SharedBlock
from mpsim.engine.workers.worker import LINGER, Program
from mpsim.kernels.events import cells, records
from mpsim.kernels.events.features.hooks import BARE, COLUMNS
from mpsim.kernels.events.windows import Own, Shared, run_windows
from mpsim.kernels.features.collisions import log_of, work_of

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
    return partial(_wait_for_windows, *_idle_call(_arguments_in(block.arrays, worker), worker, LINGER))


def _wait_for_windows(*call: Any) -> int:
    """Play windows as a worker; returns what it has heard instead of a command."""
    return run_windows(*call)[1]


TILES = Program(_load, _call)
