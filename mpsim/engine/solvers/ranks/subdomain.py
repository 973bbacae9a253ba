"""The subdomain of one rank, the columns of each, and discs of all ranks by number."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mpsim.core import columns
from mpsim.core.deferred_signals import interrupts_held_back
from mpsim.engine.feature_arrays import feature_specs, fill_features, giant_radius
from mpsim.engine.solvers.base import NewDiscs, work_specs
from mpsim.engine.solvers.stepped import Grid, block_arrays
from mpsim.engine.workers.shared import SharedBlock, remove_stale_blocks
from mpsim.engine.workers.worker import GridArguments, call_of, kernel_arguments
from mpsim.errors import InputError
from mpsim.features.properties import has_radii
from mpsim.kernels import records
from mpsim.kernels.frame import rank as kernels
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings

# --- Distribution of the columns of the grid to ranks, and the borders between ranks


class Range(NamedTuple):
    """The columns of a rank: from `first` to before `last`."""

    first: int
    last: int

    @property
    def before(self) -> int:
        """Columns that are not in the rank's own grid: an even number, so that a column keeps its parity."""
        return self.first - self.first % 2


class Border(NamedTuple):
    """Where the columns of a rank meet those of another.

    Attributes:
        other: the rank beyond.
        column: the own column there, in the rank's own grid.
        is_left: whether that is the left one of the two, as the last column is of the first one beyond a periodic
            border.
        is_periodic: whether they meet there.
    """

    other: int
    column: int
    is_left: bool
    is_periodic: bool = False

    @property
    def is_odd(self) -> bool:
        """Whether the odd pass has the bracket of the two, which is that of the left one."""
        return (self.column - (not self.is_left)) % 2 == 1


def dealt(counts: NDArray[np.int64], ranks: int) -> NDArray[np.int64]:
    """First column of each rank, and the end: whole columns, at least one each, in nearly equal numbers of discs.

    counts: discs in each column.
    """
    discs_before = np.concatenate([[0], np.cumsum(counts)])
    middles = (discs_before[:-1] + discs_before[1:]) / 2  # so that the border of columns is taken that is nearest
    firsts = np.searchsorted(middles, np.arange(ranks + 1) * (discs_before[-1] / ranks))
    firsts[0], firsts[-1] = 0, len(counts)
    most = len(counts) - ranks + np.arange(ranks + 1)
    return np.minimum(np.maximum.accumulate(firsts - np.arange(ranks + 1)) + np.arange(ranks + 1), most)


def borders_of(own: Range, rank: int, ranks: int, periodic: bool) -> list[Border]:
    """Where the columns of a rank meet those of others; periodic: whether the last meet the first."""
    first, last = own.first - own.before, own.last - own.before
    meets = periodic and ranks > 1
    left = [Border((rank - 1) % ranks, first, is_left=False, is_periodic=rank == 0)] if rank > 0 or meets else []
    at_end = rank == ranks - 1
    right = [Border((rank + 1) % ranks, last - 1, is_left=True, is_periodic=at_end)] if not at_end or meets else []
    return left + right


def in_turns(borders: list[Border], own: Range) -> list[list[Border]]:
    """The borders at which columns go at a time, in the order of the passes.

    All at once, as no bracket of a pass is at two of them: of two own columns at borders, one that the odd pass needs
    meets no other border's before. Only a single own column is at both: the even pass comes first.
    """
    if own.last - own.first > 1:
        return [borders] if borders else []
    return [turn for odd in (False, True) if (turn := [border for border in borders if border.is_odd == odd])]


# --- The subdomain of one rank: the discs of its columns, and the calls that make up a step

Rows = dict[str, NDArray[Any]]  # a row for each disc, by name of what it is


class Question(NamedTuple):
    """Which discs are asked for, from `first` to before `last`, and by what name one of their rows; None: all rows."""

    first: int
    last: int
    name: str | None = None


SPARE, FEWEST = 1.25, 256
"""Discs for which there is room: so many times those of the start, and at least so many more."""


class Subdomain:
    """The block of one rank: arrays of its discs, and columns by id of all discs.

    Attributes:
        block: empty before `fill` and after `close`.
        failure: why this rank cannot go on, as for lack of memory; None: it can. Else parts of a step do nothing.
    """

    def __init__(self, scene: Scene, settings: Settings):
        self._scene, self._settings = scene, settings
        names = [column.name for column in scene._columns]
        has_spins, has_images = columns.SPIN.name in names, columns.IMAGE.name in names
        self._record = records.message_in(settings.precision, has_radii(scene), has_spins, has_images)
        self._travelling = [columns.SPIN.name] * has_spins + [columns.IMAGE.name] * has_images
        self._outgoing = [np.zeros(FEWEST, self._record) for _ in range(3)]
        self._pair = self._room_for_pair(2 * FEWEST)
        self._arguments: dict[int, GridArguments] = {}  # by the buffer that holds the state
        self._sorted: tuple[NDArray[np.int64], NDArray[np.int64]] | None = None  # numbers, and their places
        self.block: SharedBlock = SharedBlock({})
        self.failure: Exception | None = None

    @property
    def arrays(self) -> dict[str, Any]:
        """Arrays and records of the block by name."""
        return self.block.arrays

    @property
    def team(self) -> Any:
        """The record of this rank, shape (1,); that behind it in the block stands for all others."""
        return self.arrays["team"][:1]

    @property
    def count(self) -> int:
        """Number of own discs."""
        return int(self.team[-1].high)

    @property
    def live(self) -> records.Discs:
        """Own discs, `count` of them, and what lies behind them."""
        return self.arguments().a

    def numbers(self) -> NDArray[np.int64]:
        """Numbers of own discs, in the order of the grid, and of those that are known to be absorbed."""
        return np.concatenate([self.live.id[: self.count], self._absorbed()])

    def _absorbed(self) -> NDArray[np.int64]:
        exits = self.arrays.get(columns.EXITS.name)
        return np.zeros(0, np.int64) if exits is None else np.flatnonzero(exits[0])

    def answer(self, question: Question) -> tuple[NDArray[np.int64], Rows]:
        """The numbers that this rank has of a range, and a row for each, by name."""
        first, last, name = question
        if (first, last) == (0, self._count_of_all):  # of all, none has to be looked for
            return self._rows_of(np.arange(len(self.numbers())), name)
        if self._sorted is None:  # kept until discs move, as who asks for one range asks for the next
            numbers = self.numbers()
            order = np.argsort(numbers)
            self._sorted = numbers[order], order
        numbers, places = self._sorted
        low, high = np.searchsorted(numbers, (first, last))
        return self._rows_of(places[low:high], name)

    def own(self) -> tuple[NDArray[np.int64], Rows]:
        """Numbers, rising, of the discs that this rank moves, and a row for each, by name."""
        return self._rows_of(np.argsort(self.live.id[: self.count]))

    def _rows_of(self, places: NDArray[np.int64], name: str | None = None) -> tuple[NDArray[np.int64], Rows]:
        """Numbers of some discs, and a row for each, by name.

        Args:
            places: of the discs, among those of `numbers`.
            name: of the rows that are wanted; None: all that steps change.
        """
        live, gone = self.live, self._absorbed()
        slots, absorbed = places[places < self.count], gone[places[places >= self.count] - self.count]
        numbers = np.concatenate([live.id[slots], absorbed])
        exits = self.arrays.get(columns.EXITS.name, np.zeros((3, 0)))
        of_absorbed = {"position": exits[1:, absorbed], "velocity": np.zeros((2, len(absorbed)))}

        def rows(which: str) -> NDArray[Any]:
            if which not in of_absorbed:
                return self.arrays[which][..., numbers].T
            x, y = (live.x, live.y) if which == "position" else (live.vx, live.vy)
            return np.concatenate([np.stack([x[slots], y[slots]], axis=1), of_absorbed[which].T.astype(x.dtype)])

        of_scene = self._scene._columns  # true of own discs alone, and of those absorbed here
        changing = [each.name for each in of_scene if each.in_state or (each.kept and not each.given)]
        return numbers, {each: rows(each) for each in ([*of_absorbed, *changing] if name is None else [name])}

    def records_of(self, discs: NewDiscs, first: int, grid: Grid) -> NDArray[Any]:
        """Discs that enter as records, numbers from `first` on, cells in their columns of a grid of the scene.

        Those that have been absorbed are left out.
        """
        found = np.zeros(len(discs.position), self._record)
        found["x"], found["y"] = discs.position.T
        found["vx"], found["vy"] = discs.velocity.T
        found["id"] = np.arange(first, first + len(found))
        (image_x, image_y), spin = discs.of(columns.IMAGE).T, discs.of(columns.SPIN)
        further = {"spin": spin, "radius": discs.radius, "image_x": image_x, "image_y": image_y}
        for name in further.keys() & (self._record.names or ()):
            found[name] = further[name]
        return self.in_grid(found[discs.of(columns.EXITS)[:, 0] == 0], grid)

    def in_grid(self, records: NDArray[Any], grid: Grid) -> NDArray[Any]:
        """Records with cells in their columns of a grid of the scene."""
        real = np.dtype(self._settings.precision).type
        column = (records["x"].astype(real) * real(grid.columns / self._scene.width)).astype(np.int64)
        records["cell"] = np.clip(column, 0, grid.columns - 1) * (grid.rows + 2)
        return records

    def fill(self, records: NDArray[Any], own: Range, grid: Grid, count: int, brought: NewDiscs, first: int) -> None:
        """Take the discs of this rank, and its columns of the grid of the whole scene.

        Args:
            records: its discs.
            own: its columns.
            grid: of the scene.
            count: number of all discs.
            brought: discs of which all ranks are to know what no record has: columns that stay as they are, and all
                of those that have been absorbed.
            first: number of the first of these.
        """
        self._own, self._count_of_all, self._grid, self._stride = own, count, grid, grid.rows + 2
        self._pair_start = np.zeros(3 * self._stride + 1, np.int32)
        self._renew(len(records), with_discs=False)
        fill_features(self.arrays, self._scene)
        absorbed = np.flatnonzero(brought.of(columns.EXITS)[:, 0])  # of which there is no record
        for column in columns.COLUMNS:
            if column.name in self.arrays and column.name in brought.columns:
                array, values = self.arrays[column.name][..., first:], brought.of(column).T
                which = absorbed if column.name in self._travelling else slice(values.shape[-1])
                array[..., which] = values[..., which]
        self._begin(records)

    def start(self) -> None:
        """Compile or load the kernels."""
        remove_stale_blocks()  # which a job that was ended leaves behind: its trackers are ended with it
        with interrupts_held_back():
            call_of(self.block, kernels.run_part)

    def close(self) -> None:
        """Remove the block. May be called again."""
        self._arguments = {}
        self.block.close()

    def move_to(self, own: Range, discs: NDArray[Any]) -> None:
        """Take other columns, and all discs in them."""
        self._own = own
        self._renew(len(discs), with_discs=False)
        self._begin(discs)

    def _begin(self, discs: NDArray[Any]) -> None:
        control, own, team, now = self.arrays["control"], self._own, self.arrays["team"], self.arguments()
        kernels.unpack_own(discs, len(discs), now.a, now.features)
        self._sorted = None
        control.in_order = 0
        control.workers, control.members = 1, 2
        team["bad_slot"] = -1
        team["low"], team["high"] = (0, len(discs)), len(discs)
        last = own.last - own.before
        team["first_column"], team["last_column"] = (own.first - own.before, last), last

    def stop_at(self, open_end: bool) -> None:
        """Say where the contacts of own columns end; open_end: whether those of the last one are those of a border."""
        self.team["stop"] = self._own.last - self._own.before - open_end

    def discs(self) -> NDArray[Any]:
        """All own discs, cells as in the grid of the scene."""
        now = self.arguments()
        found = np.zeros(self.count, self._record)
        kernels.pack_own(now.a, now.features, now.control, now.team, found)
        return found

    def discs_in_columns(self) -> NDArray[np.int64]:
        """Number of discs in each own column, once a step has sorted them."""
        first, last = self._own.first - self._own.before, self._own.last - self._own.before
        return np.diff(self.arrays["start"][np.arange(first, last + 1) * self._stride].astype(np.int64))

    def configure(self) -> None:
        """Write into the record `control` which columns of the scene are its own."""
        control = self.arrays["control"]
        control.columns_before = self._own.before
        control.cells = len(self.arrays["start"]) - 1

    def _renew(self, count: int, with_discs: bool = True) -> None:
        """Move to a block with room for so many own discs, and with all that the present one has.

        with_discs: whether own discs, and what is known of their order, come along too; else the block is to be filled.
        """
        capacity = int(SPARE * count) + FEWEST
        features = feature_specs(self._scene, max(capacity, self._count_of_all), self._settings.precision)
        grid = Grid(self._own.last - self._own.before, self._grid.rows)
        specs = block_arrays(capacity, grid, 2, self._settings.precision, features | work_specs(self._scene, 1))
        old, new = self.block, SharedBlock(specs, alone=True)
        with new.closed_on_error():
            new.create()
            for name, values in old.arrays.items():
                if name in new.arrays and (with_discs or not _is_of_discs(name)):
                    _copy(values, new.arrays[name])
        new.arrays["team"]["signals"] = 0
        if not with_discs:
            new.arrays["control"].live = 0
        self.block, self._arguments, self._capacity = new, {}, capacity
        old.close()

    def _room_for_pair(self, count: int) -> records.Discs:
        """A buffer for the discs of two columns."""
        real, length = np.dtype(self._settings.precision), count + records.PADDING
        radius = np.zeros(length, real) if has_radii(self._scene) else None
        x, y, vx, vy = (np.zeros(length, real) for _ in range(4))
        return records.Discs(x, y, vx, vy, np.zeros(length, np.int32), np.zeros(length, np.int32), radius)

    # --- a step

    def arguments(self) -> GridArguments:
        """What kernels are called with: the state in `a`."""
        if not self._arguments:  # kept, as a step asks often
            given = kernel_arguments(self.block)
            self._arguments = {0: given, 1: given._replace(a=given.b, b=given.a)}
        return self._arguments[int(self.arrays["control"].live)]

    def run(self, part: int, ahead: int = records.NO_FRAME) -> None:
        """A part of a step, MOVE, SORT, EVEN or ODD: all of it that lies away from borders.

        SORT has the first even pass in it.

        Args:
            part: which.
            ahead: frame of the step that is to begin after ODD; NO_FRAME: none.
        """
        if self.failure is None:
            self._sorted = None
            self.arrays["control"].part, self.arrays["control"].ahead = part, ahead
            call_of(self.block, kernels.run_part)()

    @property
    def is_finite(self) -> bool:
        """Whether all discs have been finite so far."""
        return not self.arrays["control"].signals[records.BAD]

    def emigrants(self) -> NDArray[Any]:
        """The discs that have left the columns of this rank, cells as in the grid of the scene."""
        if self.failure is not None or not self.is_finite:
            return self._outgoing[2][:0]
        now, leaving = self.arguments(), int(self.team["outbox"].sum())
        if not leaving:
            return self._outgoing[2][:0]
        self._outgoing[2] = self._with_room(self._outgoing[2], leaving)
        count = kernels.pack_emigrants(now.a, now.changes, now.features, now.control, now.team, self._outgoing[2])
        return self._outgoing[2][:count]

    def columns_of(self, discs: NDArray[Any]) -> NDArray[np.int64]:
        """Columns of emigrants, in the grid of the scene."""
        return discs["cell"] // self._stride

    def take_in(self, immigrants: NDArray[Any]) -> None:
        """Discs that have come, to be sorted with the others."""
        if not len(immigrants) and not self.arrays["team"][-1].outbox:
            return
        if self.count + len(immigrants) > self._capacity:
            try:
                self._renew(self.count + len(immigrants))
            except Exception as error:  # of this rank: the others learn of it when they next agree
                self.failure = error
                return
        now = self.arguments()
        kernels.unpack_immigrants(
            immigrants, len(immigrants), now.a, now.changes, now.features, now.control, now.team, now.sent
        )

    def column_at(self, border: Border) -> NDArray[Any]:
        """The discs of the own column at a border, for the rank beyond."""
        place = int(border.is_left)
        if self.failure is not None:
            return self._outgoing[place][:0]
        now = self.arguments()
        cells = border.column * self._stride, (border.column + 1) * self._stride
        count = int(now.start[cells[1]] - now.start[cells[0]])
        self._outgoing[place] = self._with_room(self._outgoing[place], count)
        kernels.pack_column(now.a, now.start, border.column, now.features, now.control, self._outgoing[place])
        return self._outgoing[place][:count]

    def resolve_at(self, phase: int, border: Border, own: int, beyond: NDArray[Any]) -> None:
        """The bracket at a border.

        Args:
            phase: EVEN or ODD.
            border: where.
            own: discs of the own column there.
            beyond: those of the other one.
        """
        if self.failure is not None:
            return
        if own + len(beyond) > len(self._pair.x) - records.PADDING:
            self._pair = self._room_for_pair(2 * (own + len(beyond)))
        now, own_place = self.arguments(), int(not border.is_left)
        member = int(not border.is_left)
        tally, control = self.arrays["tally"][member], now.control
        if border.is_periodic:  # as if the two were all columns: the bracket of the last one with the first
            own_place, control = 1 - own_place, now.control.copy()
            control.columns = 2
        rest = now.features, now.parameters, control, now.team[member], tally, self.arrays["times"][member]
        place = now.a, now.start, border.column, own_place, int(border.is_periodic)
        kernels.resolve_border(phase, *place, beyond, len(beyond), self._pair, self._pair_start, *rest)

    def _with_room(self, outgoing: NDArray[Any], count: int) -> NDArray[Any]:
        """A message with room for so many discs."""
        return outgoing if count <= len(outgoing) else np.zeros(2 * count, self._record)


def refuse_giants(scene: Scene, radii: NDArray[np.float64]) -> None:
    """Raise InputError for discs too large for the columns; radii: of all discs."""
    if has_radii(scene) and giant_radius(radii) is not None:
        raise InputError(
            "method='mpi' cannot do scenes in which a few discs are far larger than all others. "
            "Leave them out, or use method='parallel' on one machine."
        )


def _is_of_discs(name: str) -> bool:
    """Whether an array holds discs in the order of the grid, or what that order is."""
    return name in ("start", *records.Changes._fields) or name.startswith(("a.", "b."))


def _copy(old: Any, new: Any) -> None:
    """Copy an array, or a record, into one that may be larger or smaller."""
    if not old.shape:
        for name in old.dtype.names:
            new[name] = old[name]
        return
    part = tuple(slice(min(a, b)) for a, b in zip(old.shape, new.shape, strict=True))
    new[part] = old[part]
