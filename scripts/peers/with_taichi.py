"""Taichi on CPU threads: a grid of cells with room for a few discs, all contacts of a frame at once."""

import numpy as np
import taichi as ti  # pyright: ignore[reportMissingImports]
from numpy.typing import NDArray
from peers.engine import Plan, Run, Start

IN_A_CELL = 8
"""Discs that a cell one diameter wide can hold: 4 that do not overlap, and room for those that do."""


@ti.data_oriented
class Gas:
    """Fields and kernels. Each thread changes its own discs only, from what all were before."""

    def __init__(self, start: Start, plan: Plan, real):
        count = start.count
        self.dt, self.radius, self.counting = plan.dt, start.radius, plan.counting
        self.width, self.height = start.width, start.height
        self.columns, self.rows = (max(1, int(side / (2 * start.radius))) for side in (start.width, start.height))
        self.x, self.v, self.new_x, self.new_v = (ti.Vector.field(2, real, shape=count) for _ in range(4))
        self.held = ti.field(ti.i32, shape=(self.columns, self.rows))
        self.cells = ti.field(ti.i32, shape=(self.columns, self.rows, IN_A_CELL))
        self.walls = ti.field(ti.f64, shape=4)
        self.full = ti.field(ti.i32, shape=())

    @ti.func
    def cell_of(self, x):
        column = ti.min(ti.max(int(x[0] * (self.columns / self.width)), 0), self.columns - 1)
        row = ti.min(ti.max(int(x[1] * (self.rows / self.height)), 0), self.rows - 1)
        return ti.Vector([column, row])

    @ti.kernel
    def frame(self):  # noqa: PLR0912 - what Taichi compiles as one
        for cell in ti.grouped(self.held):
            self.held[cell] = 0
        for i in self.x:
            x, v = self.x[i] + self.v[i] * self.dt, self.v[i]
            for axis in ti.static(range(2)):
                low, high = self.radius, ti.static((self.width, self.height)[axis]) - self.radius
                if x[axis] < low:
                    x[axis] = low
                    if v[axis] < 0:
                        v[axis] = -v[axis]
                        if ti.static(self.counting):
                            ti.atomic_add(self.walls[2 * axis], ti.cast(2 * v[axis], ti.f64))
                elif x[axis] > high:
                    x[axis] = high
                    if v[axis] > 0:
                        if ti.static(self.counting):
                            ti.atomic_add(self.walls[2 * axis + 1], ti.cast(2 * v[axis], ti.f64))
                        v[axis] = -v[axis]
            self.x[i], self.v[i] = x, v
            cell = self.cell_of(x)
            k = ti.atomic_add(self.held[cell], 1)
            if k < IN_A_CELL:
                self.cells[cell, k] = i
            else:
                self.full[None] = 1
        for i in self.x:
            x, v, cell = self.x[i], self.v[i], self.cell_of(self.x[i])
            new_x, new_v = x, v
            for c in range(ti.max(cell[0] - 1, 0), ti.min(cell[0] + 2, self.columns)):
                for r in range(ti.max(cell[1] - 1, 0), ti.min(cell[1] + 2, self.rows)):
                    for k in range(ti.min(self.held[c, r], IN_A_CELL)):
                        j = self.cells[c, r, k]
                        apart = self.x[j] - x
                        square = apart.norm_sqr()
                        if j != i and square < 4 * self.radius**2 and square > 0:
                            distance = ti.sqrt(square)
                            normal = apart / distance
                            new_x -= normal * (self.radius - distance / 2)
                            new_v += normal * ti.min((self.v[j] - v).dot(normal), 0.0)
            self.new_x[i], self.new_v[i] = new_x, new_v
        for i in self.x:
            self.x[i], self.v[i] = self.new_x[i], self.new_v[i]


class Engine(Run):
    """The kernels with a start in them."""

    def __init__(self, start: Start, plan: Plan):
        real = ti.f32 if plan.precision == "float32" else ti.f64
        ti.init(arch=ti.cpu, cpu_max_num_threads=plan.threads, default_fp=real, log_level=ti.ERROR)
        self._gas = Gas(start, plan, real)
        number = np.dtype(plan.precision)
        self._gas.x.from_numpy(start.position.astype(number))
        self._gas.v.from_numpy(start.velocity.astype(number))

    def run(self, frames: int) -> None:
        for _ in range(frames):
            self._gas.frame()
        ti.sync()
        if self._gas.full[None]:
            raise ArithmeticError(f"a cell holds more than {IN_A_CELL} discs: they overlap deeply; use a shorter step")

    def state(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return self._gas.x.to_numpy().astype(np.float64), self._gas.v.to_numpy().astype(np.float64)

    def walls(self) -> NDArray[np.float64]:
        return self._gas.walls.to_numpy()

    def close(self) -> None:
        ti.reset()
