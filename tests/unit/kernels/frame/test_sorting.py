"""The counting sort: discs in the order (column, row, id) for any number of workers, from any order in memory."""

import numpy as np
import pytest
from support.arrays import control_of, discs_of, parameters_of, team_of

from mpsim.engine.workers.arrays import grid_for
from mpsim.kernels import layout
from mpsim.kernels.frame.sorting import bin_discs, count_cells, sort


def test_radii_go_along_when_discs_are_sorted():
    assert "radius" in layout.Discs._fields
    discs = discs_of(np.float64, [3.0, 1.0], [1.0, 1.0], radius=[0.3, 0.1])
    back = discs_of(np.float64, [0.0, 0.0], [0.0, 0.0], radius=[0.0, 0.0])
    control, team = control_of(2, 4, 4), team_of(1)
    control.cells = 30
    team[0].last_column, team[0].high = 4, 2
    start, outbox, sent = np.zeros(31, np.int32), np.zeros(18, np.int32), np.zeros((1, 1), np.int64)
    discs.cell[:2] = 20, 8
    start[21], start[9] = 1, 1
    team[0].kept = 2
    assert sort(discs, back, start, outbox, team, sent, 0, control) == (0, 2)
    assert back.radius[:2].tolist() == [0.1, 0.3]
    assert back.id[:2].tolist() == [1, 0]


class Sorting:
    """The arrays of a frame's sort, done for all workers one after the other in this process."""

    def __init__(self, real, count, size, workers, seed):
        rng = np.random.default_rng(seed)
        grid = grid_for(count, *size, 1.0, np.dtype(real).name)
        self.grid, self.count, self.workers = grid, count, workers
        places = 0.5 + rng.random((2, count)) * (np.array(size)[:, None] - 1)
        self.front = discs_of(real, *places, *rng.normal(size=(2, count)), rng.permutation(count))
        self.back = discs_of(real, np.zeros(count), np.zeros(count))
        self.start = np.full(grid.table_size, -7, np.int32)
        self.start[0] = 0  # as in a new block; no worker writes the start of the first ghost cell
        self.outbox = np.zeros(count + layout.PADDING, np.int32)
        self.parameters = parameters_of(real, *size, columns=grid.columns, rows=grid.rows)
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

    def run(self):
        """Bin and count on each worker, then sort on each; returns each worker's new slice."""
        for worker in range(self.workers):
            mine = self.team[worker]
            bin_discs(self.front, mine.low, mine.high, self.parameters, self.control)
        for worker in range(self.workers):
            sent = self.sent[worker]
            count_cells(self.front, self.start, self.outbox, sent, self.team, worker, self.control)
        return [
            sort(self.front, self.back, self.start, self.outbox, self.team, self.sent, worker, self.control)
            for worker in range(self.workers)
        ]

    def cell_of(self, disc):
        """Column and row of a disc of the front buffer, by the rule in words."""
        column = min(int(self.front.x[disc] * self.parameters.cells_per_x), self.grid.columns - 1)
        row = min(int(self.front.y[disc] * self.parameters.cells_per_y), self.grid.rows - 1)
        return column, row


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
        order = sorted(range(count), key=lambda disc: (*sorting.cell_of(disc), sorting.front.id[disc]))
        for name, front, back in zip(layout.Discs._fields, sorting.front, sorting.back, strict=True):
            in_order = front is None or back[:count].tolist() == front[order].tolist()
            assert in_order, f"seed {seed}: {name} is not in order"
        assert slices[0][0] == 0
        assert slices[-1][1] == count
        assert [low for low, _ in slices[1:]] == [high for _, high in slices[:-1]], "slices must join"


@pytest.mark.parametrize("workers", [1, 3])
def test_the_table_of_starts_is_right_for_every_cell_and_ghost(workers):
    sorting = Sorting(np.float64, 300, (12, 9), workers, seed=5)
    sorting.run()
    grid, stride = sorting.grid, sorting.grid.rows + 2
    cells = [sorting.cell_of(disc) for disc in range(300)]
    slot = 0
    for column in range(grid.columns + 1):
        for row in range(-1, grid.rows + 1):
            cell = column * stride + row + 1
            inside = cells.count((column, row))
            assert sorting.start[cell] == slot, f"column {column}, row {row}"
            slot += inside
    assert slot == 300


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
