"""The elastic law for all contacts of a frame at once, in vectorised NumPy."""

import numpy as np
from numpy.typing import NDArray
from peers.engine import Plan, Run, Start


class Engine(Run):
    """Discs kept in the order of the cells, so that the candidates of each are two ranges."""

    def __init__(self, start: Start, plan: Plan):
        real = np.dtype(plan.precision).type
        self._position = start.position.astype(real)
        self._velocity = start.velocity.astype(real)
        self._dt, self._diameter = real(plan.dt), real(2 * start.radius)
        self._low = np.full(2, start.radius, dtype=real)
        self._high = np.array([start.width - start.radius, start.height - start.radius], dtype=real)
        self._shape = tuple(max(1, int(side / (2 * start.radius))) for side in (start.width, start.height))
        self._scale = (np.array(self._shape) / [start.width, start.height]).astype(real)
        self._counting, self.impulses = plan.counting, np.zeros(4)

    def run(self, frames: int) -> None:
        for _ in range(frames):
            self._move()
            first = self._sort()
            self._collide(*self._pairs(first))

    def _move(self) -> None:
        position, velocity = self._position, self._velocity
        position += velocity * self._dt
        below, above = position < self._low, position > self._high
        if self._counting:
            for axis in range(2):
                into = velocity[:, axis][below[:, axis] & (velocity[:, axis] < 0)]
                self.impulses[2 * axis] -= 2 * into.sum(dtype=np.float64)
                into = velocity[:, axis][above[:, axis] & (velocity[:, axis] > 0)]
                self.impulses[2 * axis + 1] += 2 * into.sum(dtype=np.float64)
        speed = np.abs(velocity)
        np.copyto(velocity, speed, where=below)
        np.copyto(velocity, -speed, where=above)
        np.clip(position, self._low, self._high, out=position)

    def _sort(self) -> NDArray[np.intp]:
        """Sort the discs by cell; returns the first disc of each cell, with a ring of empty cells around the box."""
        columns, rows = self._shape
        place = (self._position * self._scale).astype(np.int32)
        np.minimum(place, [columns - 1, rows - 1], out=place)
        cell = (place[:, 0] + 1) * (rows + 2) + place[:, 1] + 1
        order = np.argsort(cell, kind="stable")
        self._position, self._velocity = self._position[order], self._velocity[order]
        self._cell = cell[order]
        held = np.bincount(cell, minlength=(columns + 2) * (rows + 2))
        return np.concatenate(([0], np.cumsum(held)))

    def _pairs(self, first: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Overlapping pairs, each once: with later discs of the own and the next cell, and with the next column."""
        discs, cell, below = np.arange(len(self._cell)), self._cell, self._shape[1] + 2
        ranges = ((discs + 1, first[cell + 2]), (first[cell + below - 1], first[cell + below + 2]))
        found = []
        for begin, end in ranges:
            one, other = discs, begin
            while True:
                more = other < end[one] if len(one) < len(discs) else other < end
                one, other = one[more], other[more]
                if not len(one):
                    break
                apart = self._position[other] - self._position[one]
                near = np.einsum("ij,ij->i", apart, apart) < self._diameter**2
                found.append((one[near], other[near]))
                other = other + 1
        if not found:
            return np.empty(0, np.intp), np.empty(0, np.intp)
        return np.concatenate([pair[0] for pair in found]), np.concatenate([pair[1] for pair in found])

    def _collide(self, one: NDArray[np.intp], other: NDArray[np.intp]) -> None:
        apart = self._position[other] - self._position[one]
        distance = np.sqrt(np.einsum("ij,ij->i", apart, apart))
        normal = apart / np.maximum(distance, np.finfo(distance.dtype).tiny)[:, None]
        push = normal * ((self._diameter - distance) / 2)[:, None]
        approach = np.einsum("ij,ij->i", self._velocity[other] - self._velocity[one], normal)
        change = normal * np.minimum(approach, 0)[:, None]
        for what, by in ((self._position, -push), (self._velocity, change)):
            np.add.at(what, one, by)
            np.subtract.at(what, other, by)

    def state(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return self._position.astype(np.float64), self._velocity.astype(np.float64)
