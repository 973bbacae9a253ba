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
        self.settings = mpsim.Settings(**{"contact": "push", **settings})  # as `simulate` has it
        self.scene = scene
        self.real = np.float32 if self.settings.precision == "float32" else np.float64
        self.p = scene.position.astype(self.real)
        self.v = scene.velocity.astype(self.real)
        self.low = self.real(scene.radius)
        self.high = [self.real(scene.width - scene.radius), self.real(scene.height - scene.radius)]
        self.diameter = self.real(2 * scene.radius)
        self.dt = self.real(self.settings.dt / self.settings.substeps)
        self.exchange = self.real((1 + scene.restitution) / 2)
        self.wall_restitution = self.real(scene.wall_restitution)
        self.contacts = 0

    @property
    def state(self) -> mpsim.State:
        return mpsim.State(self.p.copy(), self.v.copy())

    def run(self, frames: int) -> None:
        for _ in range(frames * self.settings.substeps):
            for i in range(len(self.p)):
                self.move(i)
            cells = self.cells()
            for _ in range(self.settings.passes):
                for i, j in self.pairs(*cells):
                    self.meet(i, j)

    def move(self, i: int) -> None:
        """v += a dt, p += v dt, and the wall rule."""
        for axis in range(2):
            if self.scene.gravity is not None:
                self.v[i, axis] += self.real(self.scene.gravity[axis]) * self.dt
            if self.scene.acceleration is not None:
                self.v[i, axis] += self.real(self.scene.acceleration[i, axis]) * self.dt
            self.p[i, axis] += self.v[i, axis] * self.dt
            self.bounce(i, axis, self.low, self.p[i, axis] < self.low, self.v[i, axis] < 0)
            self.bounce(i, axis, self.high[axis], self.p[i, axis] > self.high[axis], self.v[i, axis] > 0)
            self.p[i, axis] = min(max(self.p[i, axis], self.low), self.high[axis])

    def bounce(self, i: int, axis: int, limit: Any, beyond: bool, outward: bool) -> None:
        """Turn a disc round at a wall; `impact` puts it as far inside as the bounce has brought it by now."""
        if beyond:
            back = self.wall_restitution if self.settings.contact == "impact" else self.real(0)
            self.p[i, axis] = limit + back * (limit - self.p[i, axis])
            if outward:
                self.v[i, axis] = -self.v[i, axis] * self.wall_restitution

    def pairs(self, cells: dict[tuple[int, int], list[int]], columns: int, rows: int):
        """Pairs of discs in the order in which the method visits them."""
        if self.settings.method == "naive":
            for i in range(len(self.p)):
                for j in range(i + 1, len(self.p)):
                    yield i, j
            return
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
        if self.settings.contact == "impact" and self.meet_where_they_touched(i, j):
            return
        distance = np.sqrt(squared)
        nx, ny = (nx / distance, ny / distance) if distance > 0 else (self.real(1), self.real(0))
        shift = (self.diameter - distance) / self.real(2)
        self.push(i, -nx * shift, -ny * shift)
        self.push(j, nx * shift, ny * shift)
        self.apply_law(i, j, nx, ny)

    def meet_where_they_touched(self, i: int, j: int) -> bool:
        """Contact `impact`, if the discs touched within this step: back, the law, and on again."""
        r, u = self.p[j] - self.p[i], self.v[j] - self.v[i]
        b = r[0] * u[0] + r[1] * u[1]
        if not b < 0:
            return False
        c = r[0] * r[0] + r[1] * r[1] - self.diameter * self.diameter
        time = -c / (np.sqrt(b * b - (u[0] * u[0] + u[1] * u[1]) * c) - b)
        if not 0 <= time <= self.dt:
            return False
        self.p[i] -= self.v[i] * time
        self.p[j] -= self.v[j] * time
        nx, ny = self.p[j] - self.p[i]
        distance = np.sqrt(nx * nx + ny * ny)
        self.apply_law(i, j, nx / distance, ny / distance)
        self.push(i, *(self.v[i] * time))
        self.push(j, *(self.v[j] * time))
        return True

    def apply_law(self, i: int, j: int, nx: Any, ny: Any) -> None:
        """Change the velocities along the unit vector n from i to j."""
        along_i = self.v[i, 0] * nx + self.v[i, 1] * ny
        along_j = self.v[j, 0] * nx + self.v[j, 1] * ny
        if self.settings.law == "elastic":
            exchanged = (along_j - along_i) * self.exchange if along_j < along_i else self.real(0)
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
