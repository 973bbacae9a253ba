"""Runs windows of the exact solver and compares each tile with a simulation of the whole box.

A window is played from the present of a simulation, and nothing is taken over: the simulation stays as it is. It may
have any length and halo, where the solver's own end with a lap of the calendar at the latest.
"""

import contextlib
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import mpsim
from mpsim.engine.solvers import event_block
from mpsim.engine.solvers.event_tiles import Tiling, tiling_of
from mpsim.engine.workers.tiles import TileArguments, arguments_of
from mpsim.kernels.compiling import compiled
from mpsim.kernels.events import records, windows
from mpsim.kernels.events.records import number_of_partner
from mpsim.kernels.events.windows import copy_disc, copy_event

NEVER = np.iinfo(np.int64).max
"""A deadline [ns] that does not come."""


@contextlib.contextmanager
def divided(columns: int, rows: int = 1) -> Iterator[None]:
    """Simulations that are made in here have so many tiles; (1, 1): they are played as a whole."""
    event_block.tiling_of = lambda *_: Tiling(columns, rows)  # type: ignore[assignment]
    try:
        yield
    finally:
        event_block.tiling_of = tiling_of


def windows_of(sim: mpsim.Simulation) -> NDArray[np.int64]:
    """Windows that a simulation has played, those of them again in shorter ones, and by one worker; shape (3,)."""
    plan = _solver_of(sim).block.arrays.get("plan")
    return np.zeros(3, np.int64) if plan is None else np.array([plan.windows, plan.again, plan.as_one])


def _solver_of(sim: mpsim.Simulation) -> Any:
    return sim._open_solver()  # type: ignore[attr-defined]


# --- what is compiled ---------------------------------------------------------------------------------------------


@compiled
def play_all(whole, features, box, shared, own):
    """Play all tiles of a planned window. Returns whether they agree."""
    windows.play_tiles(whole, features, box, shared, own, 0, NEVER)
    return windows.all_agree(shared.tiles, shared.plan, box)


@compiled
def play_one(number, whole, features, box, shared, own):
    """Play one tile of a planned window; its discs, with those in the halo, are then in the worker's own store."""
    windows.play_one(number, whole, features, box, shared, own, 0)


@compiled
def read(store, cells, disc, event, here):
    """Copy the discs in so many cells of a store to where their numbers say, partners by number."""
    for cell in range(cells):
        i = store.cell_head[cell]
        while i >= 0:
            number = store.event[i].number
            copy_disc(store.disc[i], disc[number])
            copy_event(store.event[i], event[number])
            event[number].partner = number_of_partner(store.event[i].partner, store.event)
            here[number] = True
            i = store.cell_next[i]


# --- tiles --------------------------------------------------------------------------------------------------------


class Found(NamedTuple):
    """Discs at the end of a window, in the order of the scene, N of them.

    position: where they are, shape (N, 2) [length]; zero for those that are not here.
    bits: their records, shape (N, bytes); here: which of them are in the store that was read, shape (N,).
    """

    position: NDArray[np.float64]
    bits: NDArray[np.uint8]
    here: NDArray[np.bool_]

    def differs(self, truth: "Found") -> NDArray[np.bool_]:
        """Which discs are not here, or not as they are in truth, to the bit: shape (N,)."""
        return ~(self.here & (self.bits == truth.bits).all(axis=1))


class Tiles:
    """The tiles of a simulation by the exact solver without fields, which is divided and has run for a frame."""

    def __init__(self, sim: mpsim.Simulation):
        solver = _solver_of(sim)
        _, box, features = solver._system
        self._arguments: TileArguments = arguments_of(solver._block.arrays, features, box)

    @property
    def cells(self) -> tuple[int, int]:
        """Columns and rows of the box."""
        box = self._arguments.box
        return int(box.columns), int(box.rows)

    @property
    def edges(self) -> NDArray[np.int64]:
        """First column and row of each tile's own, and those behind its last ones: shape (tiles, 2, 2)."""
        tiles = self._arguments.shared.tiles
        return np.stack([tiles["own_first"], tiles["own_first"] + tiles["own"]], axis=1)

    def play(self, length: float, halo: int) -> tuple[bool, int]:
        """Play a window of such a length [time], with a halo of so many cells: do tiles agree, and their own events."""
        return self._play(self._planned(length, halo))

    def all_events(self, length: float, halo: int) -> int:
        """Events of all tiles in such a window, those in their halos too. Of a box without periodic edges."""
        planned = self._planned(length, 0)
        tiles = planned.shared.tiles  # each has its halo for its own, so that all counts
        first, end = np.maximum(self.edges[:, 0] - halo, 0), np.minimum(self.edges[:, 1] + halo, self.cells)
        tiles["own_first"], tiles["own"] = first, end - first
        return self._play(planned)[1]

    def of_tile(self, number: int, length: float, halo: int) -> Found:
        """What a tile and its halo hold at the end of such a window."""
        planned = self._planned(length, halo)
        play_one(number, *planned)
        return self._read(planned)

    def true(self, length: float) -> Found:
        """The same of a tile that is the whole box."""
        planned = self._planned(length, 0)
        shared = planned.shared
        shared.plan.tiles[:] = 1
        one = shared.tiles[:1].copy()
        one["own_first"], one["own"], one["first"], one["count"] = 0, self.cells, 0, len(planned.whole.disc)
        planned = planned._replace(shared=shared._replace(tiles=one))
        play_one(0, *planned)
        return self._read(planned)

    def _planned(self, length: float, halo: int) -> TileArguments:
        """Arguments of a window, with a plan of their own."""
        shared = self._arguments.shared
        plan, times = shared.plan.copy(), shared.times.copy()
        plan.halo, plan.frames, plan.ends_lap, plan.next[0] = halo, 0, 0, 0
        times.until = times.reached + length
        return self._arguments._replace(shared=shared._replace(plan=plan, times=times, tiles=shared.tiles.copy()))

    @staticmethod
    def _play(planned: TileArguments) -> tuple[bool, int]:
        agreed = play_all(*planned)
        return bool(agreed), int(planned.shared.counts[0].events)

    @staticmethod
    def _read(planned: TileArguments) -> Found:
        """The discs in a worker's own store."""
        store, count = planned.own.store, len(planned.whole.disc)
        disc, event, here = np.zeros(count, records.DISC), np.zeros(count, records.EVENT), np.zeros(count, bool)
        read(store, int(np.prod(store.region.here)), disc, event, here)
        bits = np.concatenate([each.view(np.uint8).reshape(count, -1) for each in (disc, event)], axis=1)
        flight = planned.shared.times.until - planned.whole.clock.origin - disc["last_update"]
        position = disc["position"] + np.where(here, flight, 0.0)[:, None] * disc["velocity"]
        number = np.argsort(planned.whole.order)  # of each disc of the scene
        return Found(position[number], bits[number], here[number])
