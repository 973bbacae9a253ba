"""Which worker writes which disc in which phase: no disc has two writers, and no worker reads what another writes.

The kernels themselves are watched. A frame is played phase by phase, as `step` does; in each phase every
worker plays its part on a copy of the block as it was at the start of the phase, and what differs afterwards is what it
has written. Then each plays once more on a copy in which whatever the others have written is not a number: had it read
any of that, its own part would come out differently.
"""

import dataclasses
from functools import partial
from typing import NamedTuple

import numpy as np
import pytest
from support.scenes import ZOO, crowd, digest_after, gas, simulate, zoo

from mpsim.engine.feature_arrays import fill_features
from mpsim.engine.workers.worker import kernel_arguments
from mpsim.kernels import records
from mpsim.kernels.features.hooks import prepare_first_step
from mpsim.kernels.frame.contacts import resolve_columns, resolve_giants
from mpsim.kernels.frame.sorting import begin_sort, list_emigrants, move_and_bin
from mpsim.kernels.frame.stepping import resolve_inside

pytestmark = [pytest.mark.plain, pytest.mark.filterwarnings("ignore::mpsim.errors.EmitterWarning")]

WORKERS = 3

DISCS = tuple(f"{buffer}.{field}" for buffer in "ab" for field in records.Discs._fields)
WATCHED = (*DISCS, *records.Changes._fields, "start", "exits")
"""Arrays in which nobody may write where another one writes or reads in the same phase; and the limits of the box."""

EVERYTHING = "gravity acceleration giants masses lossy obstacles absorbing piston periodic-x"


class Clash(NamedTuple):
    """Two workers met in an array in a phase; `kind` is "written twice" or "read"."""

    phase: str
    array: str
    kind: str
    slots: tuple[int, ...]


class Watched:
    """A simulation whose frames are played by hand, worker by worker."""

    waits_for_walls = True

    def __init__(self, sim, workers=WORKERS):
        solver = sim._solver
        self.clashes: list[Clash] = []
        self.writes = self.merges = 0
        self._sorted: dict[int, tuple[int, int, bool]] = {}
        self._even: dict[int, int] = {}
        self._odd: dict[int, int] = {}
        self._solver, self._workers = solver, workers
        self._block = solver.block
        control = self._block.arrays["control"]
        control.workers = control.members = workers
        solver._deal(workers)

    @property
    def _arrays(self):
        return self._block.arrays

    def frame(self, guarded=True):
        """Play one frame of one step."""
        control = self._arrays["control"]
        front, back = (1, 0) if control.live else (0, 1)
        self._phase("move", partial(self._move, front))
        assert not control.signals[records.BAD]
        sort, own_columns = partial(self._sort, front, back), partial(self._own_columns, front, back)
        if "piston" in self._arrays and self.waits_for_walls:  # all wait until worker 0 has moved the wall
            self._phase("sort", sort)
            self._phase("own columns", own_columns)
        else:
            self._phase("sort", sort, own_columns)
        team = self._arrays["team"]
        for worker in range(self._workers):
            team[worker].low, team[worker].high, merging = self._sorted[worker]
            self.merges += merging
        if guarded:
            self._phase("even columns", partial(self._even_columns, back))
            self._phase("odd columns", partial(self._odd_columns, back))
        else:
            self._phase("all columns", partial(self._interleaved, back))
        if "giants" in self._arrays:
            buffers, its = self._views()
            resolve_giants(buffers[back], its.start, its.features, its.parameters, its.control, its.tally, 0)
        control.live ^= 1
        control.done += 1

    def _views(self):
        arguments = kernel_arguments(self._block, 0)
        return (arguments.a, arguments.b), arguments

    def _move(self, front, worker):
        buffers, its = self._views()
        discs, spare, mine = buffers[front], buffers[1 - front], its.team[worker]
        assert move_and_bin(discs, spare, its.changes, its.features, its.parameters, its.control, mine, its.tally)
        list_emigrants(discs, its.changes, its.sent[worker], its.team, worker, its.control)

    def _sort(self, front, back, worker):
        buffers, its = self._views()
        if worker == 0:
            its.control.steps += 1
            its.control.in_order = 1
            prepare_first_step(self._arrays)
        common = buffers[front], buffers[back], its.start, its.changes, its.team, its.sent, worker
        self._sorted[worker] = begin_sort(*common, its.control)

    def _own_columns(self, front, back, worker):
        buffers, its = self._views()
        common = buffers[front], buffers[back], its.start, its.changes, *self._sorted[worker]
        rest = its.features, its.parameters, its.control, its.team, its.tally, its.times, worker, 0
        self._even[worker], self._odd[worker], _ = resolve_inside(*common, *rest)

    def _even_columns(self, back, worker):
        self._resolve(back, worker, self._even[worker], self._arrays["team"][worker].last_column)

    def _odd_columns(self, back, worker):
        mine = self._arrays["team"][worker]
        first, last = mine.first_column, mine.last_column
        self._resolve(back, worker, first, min(first + first % 2, last))
        self._resolve(back, worker, self._odd[worker], last)

    def _interleaved(self, back, worker):
        self._resolve(back, worker, worker, self._arrays["control"].columns, self._workers)

    def _resolve(self, back, worker, first, last, step=2):
        buffers, its = self._views()
        rest = its.features, its.parameters, its.control, its.team[worker], its.tally, its.times, 0
        resolve_columns(records.EVEN, first, last, step, buffers[back], its.start, *rest)

    def _watched(self):
        arrays = {key: self._arrays[key] for key in WATCHED if key in self._arrays}
        return {**arrays, "limit": self._arrays["parameters"].limit}

    def _phase(self, name, *plays):
        """Let every worker play its parts, apart from the others and then in sequence, and note where two have met."""

        def play(worker):
            for part in plays:
                part(worker)

        before = {key: array.copy() for key, array in self._arrays.items()}
        start = {key: array.copy() for key, array in self._watched().items()}
        written, results = [], []
        for worker in range(self._workers):
            play(worker)
            results.append({key: array.copy() for key, array in self._watched().items()})
            written.append({key: _differs(array, start[key]) for key, array in results[-1].items()})
            self._put(before)
        for key in written[0]:
            twice = np.sum([one[key] for one in written], axis=0) > 1
            self.writes += int(sum(one[key].sum() for one in written))
            self._note(name, key, "written twice", twice)
        for worker in range(self._workers):
            self._poison([one for other, one in enumerate(written) if other != worker], written[worker])
            play(worker)
            for key, mine in written[worker].items():
                self._note(name, key, "read", mine & _differs(self._watched()[key], results[worker][key]))
            self._put(before)
        for part in plays:
            for worker in range(self._workers):
                part(worker)

    def _poison(self, others, mine):
        for key, own in mine.items():
            theirs = np.any([one[key] for one in others], axis=0) & ~own
            array = self._watched()[key]
            # Numbers of cells and slots are indices: a poisoned one must not lead out of the block.
            array[theirs] = np.nan if array.dtype.kind == "f" else 0

    def _put(self, before):
        for key, array in self._arrays.items():
            for name in array.dtype.names or (...,):  # of a record each field, of an array the whole
                array[name] = before[key][name]

    def _note(self, phase, key, kind, where):
        if where.any():
            self.clashes.append(Clash(phase, key, kind, tuple(np.flatnonzero(where)[:5].tolist())))


def _differs(array, other):
    """Where two arrays differ."""
    return ~((array == other) | (np.isnan(array) & np.isnan(other)))


def watch(scene, frames, guarded=True, **settings):
    """Clashes and number of writes in so many frames; the state must be that of an ordinary run."""
    settings |= {"method": "grid", "unguarded": not guarded}
    expected = digest_after(scene, frames, **settings)
    with simulate(scene, **settings) as sim:
        watched = _with_room_for_workers(sim)
        for _ in range(frames):
            watched.frame(guarded)
        if guarded:
            assert sim.digest() == expected, "frames played by hand are not those of a run"
        return watched


def _with_room_for_workers(sim):
    """The block of a simulation on several workers, without the workers."""
    solver = sim._solver
    solver.choice = dataclasses.replace(solver.choice, workers=(WORKERS,))
    snapshot = solver.snapshot()
    with solver._team.moving_to(solver._next_block(max(solver.count, 1), solver.radii)) as block:
        block.create()
        block.arrays["team"]["bad_slot"] = -1
        fill_features(block.arrays, solver._scene)
    solver._team.take()
    solver._enter(snapshot)
    return Watched(sim)


SCENES = {
    "dense gas": lambda: gas(150, 0.7, seed=1),
    "few columns": lambda: crowd(40, 0.9, seed=3),
    "everything": lambda: zoo(EVERYTHING, count=60),
    "giants": lambda: zoo(ZOO["giants"], count=60),
}


@pytest.mark.filterwarnings("ignore::mpsim.errors.FastWarning")  # of crowds that something presses
@pytest.mark.parametrize("name", SCENES)
def test_no_disc_has_two_writers_in_a_phase_and_none_is_read_while_it_is_written(name):
    watched = watch(SCENES[name](), frames=4)
    assert watched.clashes == []
    assert watched.writes > 500
    assert watched.merges > 0 or name == "few columns", "the order must have been repaired, too"


def test_without_odd_and_even_passes_discs_have_two_writers():
    """The control: the demonstration of the race, by the same checker."""
    watched = watch(gas(200, 0.7, seed=1), frames=4, guarded=False)
    assert {(clash.phase, clash.kind) for clash in watched.clashes} == {("all columns", "written twice")}


def test_a_wall_that_moves_while_contacts_read_its_place_is_noticed():
    """The control of the barrier after it."""
    with simulate(zoo(EVERYTHING, count=100), method="grid") as sim:
        watched = _with_room_for_workers(sim)
        watched.waits_for_walls = False
        for _ in range(6):
            watched.frame()
        assert {clash.kind for clash in watched.clashes} == {"read"}


def test_a_worker_that_reads_what_another_writes_is_noticed():
    """The control of the second half: each worker takes over the place of the next one's first disc."""
    with simulate(gas(60, 0.7, seed=1), method="grid") as sim:
        watched = _with_room_for_workers(sim)

        def play(worker):
            x = watched._arrays["a.x"]
            x[worker] = x[(worker + 1) % WORKERS] + 1

        watched._phase("a phase", play)
        assert {(clash.array, clash.kind) for clash in watched.clashes} == {("a.x", "read")}
