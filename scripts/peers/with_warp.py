"""Warp on the CPU (one thread): its hash grid, all contacts of a frame at once, launches recorded once."""

# pyright: reportInvalidTypeForm=false, reportMissingImports=false

import numpy as np
import warp as wp
from numpy.typing import NDArray

from peers.engine import Plan, Run, Start

wp.config.quiet = True


@wp.kernel
def move(
    x: wp.array(dtype=wp.vec3), v: wp.array(dtype=wp.vec3), dt: float, low: wp.vec2, high: wp.vec2,
    counting: int, walls: wp.array(dtype=wp.float64),
):  # fmt: skip
    i = wp.tid()
    place = x[i] + v[i] * dt
    speed = v[i]
    for axis in range(2):
        if place[axis] < low[axis]:
            place[axis] = low[axis]
            if speed[axis] < 0.0:
                speed[axis] = -speed[axis]
                if counting != 0:
                    wp.atomic_add(walls, 2 * axis, wp.float64(2.0 * speed[axis]))
        elif place[axis] > high[axis]:
            place[axis] = high[axis]
            if speed[axis] > 0.0:
                if counting != 0:
                    wp.atomic_add(walls, 2 * axis + 1, wp.float64(2.0 * speed[axis]))
                speed[axis] = -speed[axis]
    x[i] = place
    v[i] = speed


@wp.kernel
def collide(
    grid: wp.uint64, x: wp.array(dtype=wp.vec3), v: wp.array(dtype=wp.vec3), diameter: float,
    new_x: wp.array(dtype=wp.vec3), new_v: wp.array(dtype=wp.vec3),
):  # fmt: skip
    i = wp.hash_grid_point_id(grid, wp.tid())
    place = x[i]
    speed = v[i]
    to_x = place
    to_v = speed
    query = wp.hash_grid_query(grid, place, diameter)
    j = int(0)  # noqa: UP018, RUF046 - a variable, not a constant, of the kernel
    while wp.hash_grid_query_next(query, j):
        apart = x[j] - place
        square = wp.dot(apart, apart)
        if j != i and square < diameter * diameter and square > 0.0:
            distance = wp.sqrt(square)
            normal = apart / distance
            to_x -= normal * ((diameter - distance) * 0.5)
            to_v += normal * wp.min(wp.dot(v[j] - speed, normal), 0.0)
    new_x[i] = to_x
    new_v[i] = to_v


class Engine(Run):
    """The kernels with a start in them. Single precision."""

    def __init__(self, start: Start, plan: Plan):
        wp.init()
        self._diameter = 2 * start.radius
        columns, rows = (max(1, int(side / self._diameter)) for side in (start.width, start.height))
        self._grid = wp.HashGrid(columns + 2, rows + 2, 1, device="cpu")
        self._x, self._v = (
            wp.array(np.pad(a, ((0, 0), (0, 1))).astype(np.float32), dtype=wp.vec3, device="cpu")
            for a in (start.position, start.velocity)
        )
        new_x, new_v = wp.zeros_like(self._x), wp.zeros_like(self._v)
        self._walls = wp.zeros(4, dtype=wp.float64, device="cpu")
        low = wp.vec2(start.radius, start.radius)
        high = wp.vec2(start.width - start.radius, start.height - start.radius)
        moved = [self._x, self._v, plan.dt, low, high, int(plan.counting), self._walls]
        met = [self._grid.id, self._x, self._v, self._diameter, new_x, new_v]
        self._move = wp.launch(move, dim=start.count, inputs=moved, device="cpu", record_cmd=True)
        self._collide = wp.launch(collide, dim=start.count, inputs=met, device="cpu", record_cmd=True)
        self._new = new_x, new_v

    def run(self, frames: int) -> None:
        for _ in range(frames):
            self._move.launch()
            self._grid.build(self._x, self._diameter)
            self._collide.launch()
            wp.copy(self._x, self._new[0])
            wp.copy(self._v, self._new[1])

    def state(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return self._x.numpy()[:, :2].astype(np.float64), self._v.numpy()[:, :2].astype(np.float64)

    def walls(self) -> NDArray[np.float64]:
        return self._walls.numpy().astype(np.float64)
