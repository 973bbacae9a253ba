"""Which worker writes which disc in which phase: no disc has two writers, and no worker reads what another writes.

The compiled kernels themselves are watched. A frame is played phase by phase, as `step` does; in each phase every
worker plays its part on a copy of the block as it was at the start of the phase, and what differs afterwards is what it
has written. Then each plays once more on a copy in which whatever the others have written is not a number: had it read
any of that, its own part would come out differently.
"""

from typing import NamedTuple

import numpy as np
import pytest
from support.scenes import ZOO, crowd, gas, simulate, zoo

from mpsim.engine.workers.worker import kernel_arguments
from mpsim.kernels import layout
from mpsim.kernels.features.hooks import after_binning, prepare_first_step
from mpsim.kernels.frame.contacts import resolve_columns
from mpsim.kernels.frame.giants import resolve_giants
from mpsim.kernels.frame.motion import move
from mpsim.kernels.frame.sorting import bin_discs, count_cells, sort

WORKERS = 3

DISCS = tuple(f"{buffer}.{field}" for buffer in "ab" for field in layout.Discs._fields)
WATCHED = (*DISCS, "start", "outbox", "exits")
"""Arrays in which nobody may write where another one writes or reads in the same phase."""

EVERYTHING = "gravity acceleration giants masses lossy obstacles absorbing piston periodic-x"


class Clash(NamedTuple):
    """Two workers met in an array in a phase; `kind` is "written twice" or "read"."""

    phase: str
    array: str
    kind: str
    slots: tuple[int, ...]


class Watched:
    """A simulation whose frames are played by hand, worker by worker."""

    def __init__(self, sim, workers=WORKERS):
        solver = sim._solver
        self.clashes: list[Clash] = []
        self.writes = 0
        self._solver, self._workers = solver, workers
        self._block = solver._block
        self._block.arrays["control"].workers = workers
        solver._deal(workers)

    @property
    def _arrays(self):
        return self._block.arrays

    def frame(self, guarded=True):
        """Play one frame of one step."""
        control = self._arrays["control"]
        front, back = (1, 0) if control.live else (0, 1)
        self._phase("move", self._move(front))
        assert not control.signals[layout.BAD]
        control.steps += 1
        prepare_first_step(self._arrays)
        self._phase("sort", self._sort(front, back))
        team = self._arrays["team"]
        for worker in range(self._workers):
            team[worker].low, team[worker].high = team[worker].clock
        if guarded:
            self._phase("even columns", self._columns(back, 0))
            self._phase("odd columns", self._columns(back, 1))
        else:
            self._phase("all columns", self._interleaved(back))
        if "giants" in self._arrays:
            buffers, features, parameters = self._views(back)
            start = self._arrays["start"]
            resolve_giants(buffers[back], start, features, parameters, self._arrays["control"], None, 0)
        control.live ^= 1
        control.done += 1

    def _views(self, _):
        arguments = kernel_arguments(self._block, 0)
        return (arguments.a, arguments.b), arguments.features, arguments.parameters

    def _move(self, front):
        def play(worker):
            buffers, features, parameters = self._views(front)
            arrays, discs = self._arrays, buffers[front]
            control, team = arrays["control"], arrays["team"]
            low, high = team[worker].low, team[worker].high
            assert move(discs, low, high, features, parameters, control, team[worker], None)
            bin_discs(discs, low, high, parameters, control)
            after_binning(discs, low, high, features, control)
            count_cells(discs, arrays["start"], arrays["outbox"], arrays["sent"][worker], team, worker, control)

        return play

    def _sort(self, front, back):
        def play(worker):
            buffers, _, _ = self._views(front)
            arrays = self._arrays
            team = arrays["team"]
            ends = sort(
                buffers[front], buffers[back], arrays["start"], arrays["outbox"], team, arrays["sent"], worker,
                arrays["control"],
            )  # fmt: skip
            team[worker].clock[:] = ends  # not read by anybody in this phase

        return play

    def _columns(self, back, parity):
        def play(worker):
            first = self._arrays["team"][worker].first_column
            self._resolve(back, first + (first + parity) % 2, self._arrays["team"][worker].last_column, 2)

        return play

    def _interleaved(self, back):
        def play(worker):
            self._resolve(back, worker, self._arrays["control"].columns, self._workers)

        return play

    def _resolve(self, back, first, last, step):
        buffers, features, parameters = self._views(back)
        control, start = self._arrays["control"], self._arrays["start"]
        resolve_columns(buffers[back], start, first, last, step, features, control, parameters, None, 0)

    def _phase(self, name, play):
        """Let every worker play its part, apart from the others and then in sequence, and note where two have met."""
        arrays = self._arrays
        before = {key: array.copy() for key, array in arrays.items()}
        written, results = [], []
        for worker in range(self._workers):
            play(worker)
            written.append({key: _differs(arrays[key], before[key]) for key in WATCHED if key in arrays})
            results.append({key: arrays[key].copy() for key in written[-1]})
            self._put(before)
        for key in written[0]:
            twice = np.sum([one[key] for one in written], axis=0) > 1
            self.writes += int(sum(one[key].sum() for one in written))
            self._note(name, key, "written twice", twice)
        for worker in range(self._workers):
            self._poison([one for other, one in enumerate(written) if other != worker], written[worker])
            play(worker)
            for key, mine in written[worker].items():
                self._note(name, key, "read", mine & _differs(arrays[key], results[worker][key]))
            self._put(before)
        for worker in range(self._workers):
            play(worker)

    def _poison(self, others, mine):
        for key, own in mine.items():
            theirs = np.any([one[key] for one in others], axis=0) & ~own
            array = self._arrays[key]
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
    with simulate(scene, method="grid", unguarded=not guarded, **settings) as ordinary:
        ordinary.run(frames=frames)
        expected = ordinary.digest()
    with simulate(scene, method="grid", unguarded=not guarded, **settings) as sim:
        watched = _with_room_for_workers(sim)
        for _ in range(frames):
            watched.frame(guarded)
        if guarded:
            assert sim.digest() == expected, "frames played by hand are not those of a run"
        return watched


def _with_room_for_workers(sim):
    """The block of a simulation on several workers, without the workers."""
    solver = sim._solver
    solver.choice = type(solver.choice)("grid", (WORKERS,))
    snapshot = solver.snapshot()
    old, solver._block = solver._block, solver._next_block(max(solver.count, 1), solver._radii)
    solver._fill(solver._block)
    old.close()
    solver._enter(snapshot)
    return Watched(sim)


SCENES = {
    "dense gas": lambda: gas(400, 0.7, seed=1),
    "crowd": lambda: crowd(300, 0.9, seed=2),
    "few columns": lambda: crowd(40, 0.9, seed=3),
    "everything": lambda: zoo(EVERYTHING, count=60),
    **{name: (lambda name=name: zoo(ZOO[name], count=60)) for name in ("giants", "periodic", "absorbing")},
}


@pytest.mark.filterwarnings("ignore::mpsim.EmitterWarning")  # one of everything's emitters finds its place taken
@pytest.mark.parametrize("name", SCENES)
def test_no_disc_has_two_writers_in_a_phase_and_none_is_read_while_it_is_written(name, figures):
    watched = watch(SCENES[name](), frames=8)
    assert watched.clashes == []
    assert watched.writes > 1000
    figures.note(
        "R13",
        f"parallel on {WORKERS}",
        f"discs with two writers, or read while written, in a phase: {name}",
        0,
        f"0 of {watched.writes:,} writes",
    )


def test_without_odd_and_even_passes_discs_have_two_writers(figures):
    """The control: the demonstration of the race, on the same scene by the same checker."""
    watched = watch(gas(400, 0.7, seed=1), frames=8, guarded=False)
    assert {(clash.phase, clash.kind) for clash in watched.clashes} == {("all columns", "written twice")}
    figures.note(
        "R13", f"parallel on {WORKERS}", "control: unguarded=True", "clashes", f"{len(watched.clashes)} clashes"
    )


def test_a_worker_that_reads_what_another_writes_is_noticed():
    """The control of the second half: each worker takes over the place of the next one's first disc."""
    with simulate(gas(400, 0.7, seed=1), method="grid") as sim:
        watched = _with_room_for_workers(sim)

        def play(worker):
            x = watched._arrays["a.x"]
            x[worker] = x[(worker + 1) % WORKERS] + 1

        watched._phase("a phase", play)
        assert {(clash.array, clash.kind) for clash in watched.clashes} == {("a.x", "read")}
