"""The sort: discs in the order (column, row, id) for any number of workers, made anew or repaired, to the same bits."""

import itertools

import numpy as np
import pytest
from support.arrays import changes_of, control_of, discs_of, parameters_of, team_of

from mpsim.engine.workers.arrays import grid_for
from mpsim.kernels import layout
from mpsim.kernels.features.hooks import BARE
from mpsim.kernels.frame import sharing
from mpsim.kernels.frame.incremental_sort import first_cursor, merge_up_to
from mpsim.kernels.frame.sharing import list_emigrants
from mpsim.kernels.frame.sorting import begin_sort, move_and_bin


class Sorting:
    """The arrays of a frame's sort, done for all workers one after the other in this process."""

    def __init__(self, real, count, size, workers, seed, radii=False):
        self.rng = rng = np.random.default_rng(seed)
        grid = grid_for(count, *size, 1.0, np.dtype(real).name)
        self.grid, self.count, self.workers = grid, count, workers
        places = 0.5 + rng.random((2, count)) * (np.array(size)[:, None] - 1)
        radius = rng.random(count) / 2 if radii else None
        self.front = discs_of(real, *places, np.zeros(count), np.zeros(count), rng.permutation(count), radius)
        self.back = discs_of(real, *np.zeros((2, count)), radius=np.zeros(count) if radii else None)
        self.start = np.full(grid.table_size, -7, np.int32)
        self.start[0] = 0  # as in a new block; no worker writes the start of the first ghost cell
        self.changes = changes_of(count, grid.table_size, workers)
        self.parameters = parameters_of(real, *size, dt=1.0, columns=grid.columns, rows=grid.rows)
        self.control = control_of(count, grid.columns, grid.rows, workers)
        self.team, self.sent = team_of(workers), np.zeros((workers, workers), np.int64)
        self.deal(rng)

    def deal(self, rng):
        """Give the workers random ranges of columns and of slots, some of them empty."""
        for first, last, most in (
            ("first_column", "last_column", self.grid.columns),
            ("low", "high", self.count),
        ):
            cuts = np.sort(rng.integers(0, most + 1, self.workers - 1))
            self.team[first], self.team[last] = [0, *cuts], [*cuts, most]

    def run(self, columns_at_once=10**6):
        """Move and bin on each worker, then sort on each. Notes who merged; returns each worker's new slice."""
        for worker in range(self.workers):
            mine = self.team[worker]
            rest = self.changes, BARE, self.parameters, self.control, mine, None
            assert move_and_bin(self.front, self.back, *rest)
        for worker in range(self.workers):
            list_emigrants(self.front, self.changes, self.sent[worker], self.team, worker, self.control)
        common = self.front, self.back, self.start, self.changes, self.team
        slices = [begin_sort(*common, self.sent, worker, self.control) for worker in range(self.workers)]
        self.merged = [merging for _, _, merging in slices]
        for worker, (slot, end, merging) in enumerate(slices):
            if merging:
                cursor, last = first_cursor(self.team, worker, self.control, slot), self.team[worker].last_column
                for stop in (*range(self.team[worker].first_column + columns_at_once, last, columns_at_once), last):
                    cursor = merge_up_to(stop, cursor, *common, worker, self.control, end)
        return [(slot, end) for slot, end, _ in slices]

    def next_frame(self, slices, speed, share=1.0):
        """What is sorted becomes the front; a share of the discs get velocities, the others rest."""
        self.front, self.back = self.back, self.front
        self.team["low"], self.team["high"] = np.transpose(slices)
        self.control.in_order = 1
        for velocity in (self.front.vx, self.front.vy):
            velocity[: self.count] = self.rng.normal(size=self.count) * speed * (self.rng.random(self.count) < share)

    def cell_of(self, disc):
        """Column and row of a disc of the front buffer, by the rule in words."""
        column = min(int(self.front.x[disc] * self.parameters.cells_per_x), self.grid.columns - 1)
        row = min(int(self.front.y[disc] * self.parameters.cells_per_y), self.grid.rows - 1)
        return column, row

    def check(self, slices):
        """The order, every array, the slices and the table of starts are what they are by definition."""
        order = sorted(range(self.count), key=lambda disc: (*self.cell_of(disc), self.front.id[disc]))
        for name, front, back in zip(layout.Discs._fields, self.front, self.back, strict=True):
            assert front is None or back[: self.count].tolist() == front[order].tolist(), f"{name} is not in order"
        assert slices[0][0] == 0
        assert slices[-1][1] == self.count
        assert [low for low, _ in slices[1:]] == [high for _, high in slices[:-1]], "slices must join"
        stride = self.grid.rows + 2
        cells = sorted(column * stride + row + 1 for column, row in map(self.cell_of, range(self.count)))
        assert self.start.tolist() == np.searchsorted(cells, np.arange(self.grid.table_size)).tolist()


CASES = [
    (count, size, workers)
    for count, size in ((0, (5, 5)), (1, (5, 5)), (200, (12, 9)), (60, (1.2, 50)), (60, (50, 1.2)), (900, (10, 10)))
    for workers in (1, 2, 5)
]


@pytest.mark.parametrize("real", [np.float32, np.float64])
@pytest.mark.parametrize(("count", "size", "workers"), CASES)
def test_discs_are_sorted_by_column_row_and_id(count, size, workers, real):
    for seed in range(3):
        sorting = Sorting(real, count, size, workers, seed)
        slices = sorting.run()
        sorting.check(slices)
        assert not any(sorting.merged), "discs that are in no order yet"


@pytest.mark.slow
@pytest.mark.parametrize("radii", [False, True])
@pytest.mark.parametrize("workers", [1, 2, 5])
@pytest.mark.parametrize("size", [(60, 50), (300, 10), (10, 300)])
def test_a_repaired_order_is_the_same(size, workers, radii):
    """Frame after frame with few discs moving, near and far, so that their order is repaired; and then with many."""
    sorting = Sorting(np.float64, 1500, size, workers, seed=workers, radii=radii)
    slices = sorting.run()
    merged = []
    for speed, share in ((0.3, 0.03), (40.0, 0.03), (0.01, 1.0), (0.0, 1.0), (3.0, 1.0)):
        sorting.next_frame(slices, speed, share)
        slices = sorting.run(columns_at_once=3)
        sorting.check(slices)
        merged.append(all(sorting.merged) if speed == 3.0 else any(sorting.merged))
    assert merged == [True, True, True, True, False]


def test_more_arrivals_than_a_list_holds_are_sorted_anew():
    """All that leave one worker's columns crowd into a neighbour's, whose slice, and so whose list, is small."""
    sorting = Sorting(np.float64, 800, (80, 8), 2, seed=3)
    sorting.team["first_column"], sorting.team["last_column"] = (0, 70), (70, sorting.grid.columns)
    sorting.front.x[:800] = np.where(np.arange(800) < 790, 69.4 + sorting.rng.random(800) / 2, 75)
    slices = sorting.run()
    sorting.next_frame(slices, 0.0)
    sorting.front.vx[:80] = 2.0
    slices = sorting.run()
    sorting.check(slices)
    assert sorting.merged == [True, False]


def test_a_slice_that_changes_hands_is_repaired_all_the_same():
    """Between two commands other workers may get other columns, with the discs that lie in them."""
    sorting = Sorting(np.float64, 1000, (40, 40), 3, seed=4)
    sorting.run()
    starts = sorting.start[: sorting.grid.table_size : sorting.grid.rows + 2]
    columns = [0, 5, 30, sorting.grid.columns]
    sorting.team["first_column"], sorting.team["last_column"] = columns[:-1], columns[1:]
    sorting.next_frame([(starts[a], starts[b]) for a, b in itertools.pairwise(columns)], 0.05)
    slices = sorting.run()
    sorting.check(slices)
    assert all(sorting.merged)


def test_a_list_that_is_full_stays_inside_its_section():
    """A worker's section of the lists ends where the next one's begins; what would not fit is only counted."""
    sorting = Sorting(np.float64, 400, (20, 20), 2, seed=5)
    sorting.team["first_column"], sorting.team["last_column"] = (0, 9), (9, sorting.grid.columns)
    slices = sorting.run()
    sorting.next_frame(slices, 5.0)
    for entries in sorting.changes[:5]:
        entries[:] = -9
    mine = sorting.team[0]
    first, room = sharing.section_of(mine)
    rest = sorting.changes, BARE, sorting.parameters, sorting.control, mine, None
    assert move_and_bin(sorting.front, sorting.back, *rest)
    assert mine.listed == 0
    assert (sorting.changes.slot[first : first + room] >= 0).all()
    assert (sorting.changes.slot[first + room :] == -9).all()


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("size", [(30.0, 20.0), (5000.3, 3.1), (3.3, 5000.7), (77.7, 77.7)])
def test_discs_that_overlap_are_never_more_than_one_cell_apart(size, precision):
    """Or a contact would be missed. Discs are put just on either side of where a cell ends."""
    real = np.dtype(precision).type
    grid = grid_for(10**7, *size, 1.0, precision)
    for length, cells in zip(size, (grid.columns, grid.rows), strict=True):
        per_length = real(cells / length)
        edges = (np.arange(1, cells) * (length / cells)).astype(real)
        for shift in (-3, -1, 0, 1, 3):
            left = edges + shift * np.spacing(edges)
            right = left + real(1)
            right = np.where(right - left < real(1), right, np.nextafter(right, real(0)))
            first, second = (np.minimum((place * per_length).astype(int), cells - 1) for place in (left, right))
            assert (second - first <= 1).all(), f"{precision}, box {size}: a cell was skipped"
