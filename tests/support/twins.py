"""Slow obvious twins of the stepped methods: NumPy scalars of the run's precision, one operation at a time.

They share nothing with the kernels but the size of the grid, which is part of the definition of the order of contacts.
"""

from typing import Any

import numpy as np

import mpsim
from mpsim.state import grid_for


class Twin:
    """A scene simulated by `naive` or `grid`, disc by disc, in the order in which the discs were given."""

    def __init__(self, scene: mpsim.Scene, **settings: Any):
        self.settings = mpsim.Settings(**settings)
        self.scene = scene
        self.real = np.float32 if self.settings.precision == "float32" else np.float64
        self.p = scene.position.astype(self.real)
        self.v = scene.velocity.astype(self.real)
        self.low = self.real(scene.radius)
        self.high = [self.real(scene.width - scene.radius), self.real(scene.height - scene.radius)]
        self.diameter = self.real(2 * scene.radius)
        self.dt = self.real(self.settings.dt / self.settings.substeps)
        self.contacts = 0

    @property
    def state(self) -> mpsim.State:
        return mpsim.State(self.p.copy(), self.v.copy())

    def run(self, frames: int) -> None:
        for _ in range(frames * self.settings.substeps):
            for i in range(len(self.p)):
                self.move(i)
            for i, j in self.pairs():
                self.meet(i, j)

    def move(self, i: int) -> None:
        """v += a dt, p += v dt, and the wall rule."""
        for axis in range(2):
            if self.scene.gravity is not None:
                self.v[i, axis] += self.real(self.scene.gravity[axis]) * self.dt
            if self.scene.acceleration is not None:
                self.v[i, axis] += self.real(self.scene.acceleration[i, axis]) * self.dt
            self.p[i, axis] += self.v[i, axis] * self.dt
            if self.p[i, axis] < self.low:
                self.p[i, axis] = self.low
                if self.v[i, axis] < 0:
                    self.v[i, axis] *= -1
            if self.p[i, axis] > self.high[axis]:
                self.p[i, axis] = self.high[axis]
                if self.v[i, axis] > 0:
                    self.v[i, axis] *= -1

    def pairs(self):
        """Pairs of discs in the order in which the method visits them."""
        if self.settings.method == "naive":
            for i in range(len(self.p)):
                for j in range(i + 1, len(self.p)):
                    yield i, j
            return
        cells, columns, rows = self.cells()
        for parity in range(2):
            for column in range(parity, columns, 2):
                for row in range(rows):
                    yield from self.pairs_of_cell(cells, column, row)

    def cells(self) -> tuple[dict[tuple[int, int], list[int]], int, int]:
        """Discs of each cell (column, row) by rising index, and the numbers of columns and rows."""
        scene = self.scene
        grid = grid_for(len(self.p), scene.width, scene.height, 2 * scene.radius, self.settings.precision)
        per_length = [self.real(grid.columns / scene.width), self.real(grid.rows / scene.height)]
        cells: dict[tuple[int, int], list[int]] = {}
        for i, (x, y) in enumerate(self.p):
            column = min(int(x * per_length[0]), grid.columns - 1)
            row = min(int(y * per_length[1]), grid.rows - 1)
            cells.setdefault((column, row), []).append(i)
        return cells, grid.columns, grid.rows

    @staticmethod
    def pairs_of_cell(cells: dict[tuple[int, int], list[int]], column: int, row: int):
        """Each disc with the later ones of its cell, the cell above, and three cells of the next column."""
        own = cells.get((column, row), [])
        neighbours = [(column, row + 1), (column + 1, row - 1), (column + 1, row), (column + 1, row + 1)]
        for place, i in enumerate(own):
            for j in own[place + 1 :]:
                yield i, j
            for cell in neighbours:
                for j in cells.get(cell, []):
                    yield i, j

    def meet(self, i: int, j: int) -> None:
        """Contact, if the discs overlap now."""
        nx, ny = self.p[j] - self.p[i]
        squared = nx * nx + ny * ny
        if not squared < self.diameter * self.diameter:
            return
        self.contacts += 1
        distance = np.sqrt(squared)
        nx, ny = (nx / distance, ny / distance) if distance > 0 else (self.real(1), self.real(0))
        shift = (self.diameter - distance) / self.real(2)
        self.push(i, -nx * shift, -ny * shift)
        self.push(j, nx * shift, ny * shift)
        along_i = self.v[i, 0] * nx + self.v[i, 1] * ny
        along_j = self.v[j, 0] * nx + self.v[j, 1] * ny
        if self.settings.law == "elastic":
            exchanged = along_j - along_i if along_j < along_i else self.real(0)
            self.kick(i, exchanged, nx, ny)
            self.kick(j, -exchanged, nx, ny)
        else:
            self.kick(i, self.real(-2) * along_i, nx, ny)
            self.kick(j, self.real(-2) * along_j, nx, ny)

    def push(self, i: int, dx: Any, dy: Any) -> None:
        """Move a disc, but not through a wall."""
        for axis, shift in enumerate((dx, dy)):
            self.p[i, axis] = min(max(self.p[i, axis] + shift, self.low), self.high[axis])

    def kick(self, i: int, change: Any, nx: Any, ny: Any) -> None:
        self.v[i, 0] += change * nx
        self.v[i, 1] += change * ny
