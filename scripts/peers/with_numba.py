"""The report's algorithm as in yardstick.cpp, compiled by Numba. A list of a cell is a row of one array."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from peers.engine import Plan, Run, Start

IN_A_CELL = 8
"""Discs that a cell one diameter wide can hold: 4 that do not overlap, and room for those that do."""


@njit(cache=True)
def reflect(place, speed, low, high, walls, first):
    """Clamp a coordinate between two walls and turn its velocity round if it points outward."""
    if place < low:
        place = low
        if speed < 0:
            speed = -speed
            walls[first] += 2.0 * speed
    elif place > high:
        place = high
        if speed > 0:
            walls[first + 1] += 2.0 * speed
            speed = -speed
    return place, speed


@njit(cache=True)
def move(discs, dt, width, height, radius, walls):
    for i in range(len(discs)):
        x = discs[i, 0] + discs[i, 2] * dt
        y = discs[i, 1] + discs[i, 3] * dt
        discs[i, 0], discs[i, 2] = reflect(x, discs[i, 2], radius, width - radius, walls, 0)
        discs[i, 1], discs[i, 3] = reflect(y, discs[i, 3], radius, height - radius, walls, 2)


@njit(cache=True)
def fill(discs, cells, held, x_scale, y_scale):
    """Fill the lists of the cells; False if one has no room."""
    columns, rows = held.shape
    held[:] = 0
    for i in range(len(discs)):
        column = min(max(int(discs[i, 0] * x_scale), 0), columns - 1)
        row = min(max(int(discs[i, 1] * y_scale), 0), rows - 1)
        if held[column, row] == IN_A_CELL:
            return False
        cells[column, row, held[column, row]] = i
        held[column, row] += 1
    return True


@njit(cache=True)
def collide(discs, a, b, diameter):
    """Push two overlapping discs apart and let them part by the elastic law."""
    x = discs[b, 0] - discs[a, 0]
    y = discs[b, 1] - discs[a, 1]
    square = x * x + y * y
    if square >= diameter * diameter or square == 0:
        return
    distance = math.sqrt(square)
    nx, ny = x / distance, y / distance
    half = (diameter - distance) / discs.dtype.type(2)
    discs[a, 0] -= nx * half
    discs[a, 1] -= ny * half
    discs[b, 0] += nx * half
    discs[b, 1] += ny * half
    approach = (discs[b, 2] - discs[a, 2]) * nx + (discs[b, 3] - discs[a, 3]) * ny
    if approach < 0:
        discs[a, 2] += approach * nx
        discs[a, 3] += approach * ny
        discs[b, 2] -= approach * nx
        discs[b, 3] -= approach * ny


@njit(cache=True)
def resolve(discs, cells, held, column, diameter):
    columns, rows = held.shape
    for row in range(rows):
        for k in range(held[column, row]):
            a = cells[column, row, k]
            for c in range(max(column - 1, 0), min(column + 2, columns)):
                for r in range(max(row - 1, 0), min(row + 2, rows)):
                    for m in range(held[c, r]):
                        b = cells[c, r, m]
                        if a != b:
                            collide(discs, a, b, diameter)


@njit(cache=True)
def advance(discs, cells, held, dt, frames, width, height, radius, walls):
    """Frames of the report's algorithm; False if a cell has no room for a disc."""
    columns, rows = held.shape
    for _ in range(frames):
        move(discs, dt, width, height, radius, walls)
        if not fill(discs, cells, held, columns / width, rows / height):
            return False
        for column in range(columns):
            resolve(discs, cells, held, column, radius + radius)
    return True


class Engine(Run):
    """The twin with a start in it."""

    def __init__(self, start: Start, plan: Plan):
        real = np.dtype(plan.precision).type
        self._discs = np.hstack([start.position, start.velocity]).astype(real)
        shape = tuple(max(1, int(side / (2 * start.radius))) for side in (start.width, start.height))
        self._cells = np.zeros((*shape, IN_A_CELL), dtype=np.int32)
        self._held = np.zeros(shape, dtype=np.int32)
        self._numbers = [real(value) for value in (plan.dt, start.width, start.height, start.radius)]
        self.impulses = np.zeros(4)

    def run(self, frames: int) -> None:
        dt, width, height, radius = self._numbers
        if not advance(self._discs, self._cells, self._held, dt, frames, width, height, radius, self.impulses):
            raise ArithmeticError(f"a cell holds more than {IN_A_CELL} discs: they overlap deeply; use a shorter step")

    def state(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return self._discs[:, :2].astype(np.float64), self._discs[:, 2:].astype(np.float64)
