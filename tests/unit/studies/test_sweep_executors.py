"""Sweeps through executors of every kind: the same rows, and what becomes of functions and processes that fail."""

import functools
import json
import os
import sys
import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import pytest
from support.executors import process_pool
from support.processes import assert_clean, run_script
from support.swept import deadly, double, gas, noted

from mpsim import InputError, sweep
from mpsim.errors import SweepWarning
from mpsim.studies import executors

GRID, SEEDS = {"packing": [0.1, 0.3]}, 2


def rows_of(table):
    return [(row.point, row.run, row.seed, row.values) for row in table.rows]


@pytest.fixture(scope="module")
def expected():
    return rows_of(sweep(gas, GRID, SEEDS))


@pytest.fixture
def threads():
    with ThreadPoolExecutor(2) as executor:
        yield executor


@pytest.mark.parametrize("kind", ["threads", "processes"])
def test_every_executor_gives_the_same_rows_to_the_bit(kind, request, expected):
    assert rows_of(sweep(gas, GRID, SEEDS, request.getfixturevalue(kind))) == expected


def process(x):
    time.sleep(0.05)
    return {"pid": os.getpid()}


@pytest.mark.slow
def test_dask_gives_the_same_rows_takes_lambdas_and_refuses_what_nobody_can_send(dask, expected):
    assert rows_of(sweep(gas, GRID, SEEDS, dask)) == expected
    used = {row.values["pid"] for row in sweep(process, {"x": range(8)}, executor=dask).rows}
    assert len(used) == 2
    assert os.getpid() not in used
    table = sweep(lambda x: {"y": x + 0.5}, {"x": [1, 2]}, executor=dask)
    assert [row.values for row in table.rows] == [{"y": 1.5}, {"y": 2.5}]
    lock = threading.Lock()
    with pytest.raises(InputError, match=r"^function and the values of the grid must be what pickle can send"):
        sweep(lambda x: {"y": lock.locked()}, {"x": [1, 2]}, executor=dask)


MPI = """
import json
from mpi4py import MPI
from mpi4py.futures import MPIPoolExecutor
import mpsim
from support.swept import double, gas

def rank(x):
    return {"rank": MPI.COMM_WORLD.rank}

if __name__ == "__main__":
    with MPIPoolExecutor() as executor:
        table = mpsim.sweep(gas, {"packing": [0.1, 0.3]}, 2, executor, "kept")
        print(json.dumps([(row.point, row.run, row.seed, row.values) for row in table.rows]))
        ranks = mpsim.sweep(rank, {"x": list(range(20))}, executor=executor)
        print(sorted({row.values["rank"] for row in ranks.rows}))
        try:
            mpsim.sweep(lambda x: {"y": x}, {"x": [1]}, executor=executor)
        except mpsim.InputError as error:
            print(error)
    try:
        mpsim.sweep(double, {"x": [1]}, executor=executor)
    except mpsim.InputError as error:
        print(error)
"""


@pytest.mark.slow
def test_mpi_gives_the_same_rows_on_ranks_of_its_own(expected):
    mpiexec = str(Path(sys.executable).with_name("mpiexec"))
    outcome = run_script(MPI, prefix=(mpiexec, "-n", "2"), flags=("-W", "error", "-m", "mpi4py.futures"))
    assert_clean(outcome)
    rows, ranks, unpicklable, closed = outcome.out.splitlines()
    assert [tuple(row) for row in json.loads(rows)] == expected
    assert ranks == "[1]", "and none on the rank of the script"
    assert unpicklable.startswith("function and the values of the grid must be what pickle can send"), unpicklable
    assert closed.startswith("executor must accept tasks; got MPIPoolExecutor"), closed


@pytest.mark.parametrize("what", ["function", "value"])
def test_what_pickle_cannot_send_is_refused_before_anything_runs(what, processes, tmp_path):
    function = (lambda x: {"y": x}) if what == "function" else functools.partial(noted, folder=threading.Lock())
    with pytest.raises(InputError, match=r"^function and the values of the grid must be what pickle can send.*; got "):
        sweep(function, {"x": [1, 2]}, executor=processes, path=None)
    assert sweep(double, {"x": [1]}, executor=processes).rows[0].values == {"y": 2}, "the pool is as it was"


def test_a_process_that_ends_breaks_its_pool_and_the_rows_of_the_others_are_kept(tmp_path):
    grid, kept = {"x": [1, 2, 3, 4, 5]}, tmp_path / "kept"
    with process_pool(1) as executor, pytest.warns(SweepWarning) as warned:
        table = sweep(deadly, grid, executor=executor, path=kept)
    assert [row.values for row in table.rows] == [{"y": 2}, {"y": 4}, {}, {}, {}]
    assert all(row.failure.startswith("BrokenProcessPool: ") for row in table.failed)
    assert str(warned[0].message).startswith("the executor broke, and 3 runs failed with it: BrokenProcessPool")
    assert warned[0].filename == __file__
    with process_pool(1) as executor:
        again = sweep(deadly, {"x": [1, 2, 4, 5]}, executor=executor, path=kept)
    assert [row.values["y"] for row in again.rows] == [2, 4, 8, 10]


class Wandering(ThreadPoolExecutor):
    """Loses the results of some tasks."""

    def submit(self, task, /, *arguments):
        if arguments[1]["x"] == 2:
            future = Future()
            future.set_exception(ConnectionError("the worker is gone"))
            return future
        return super().submit(task, *arguments)


def test_a_result_that_an_executor_loses_is_a_failed_row():
    with Wandering(1) as executor:
        table = sweep(double, {"x": [1, 2, 3]}, executor=executor)
    assert [row.failure for row in table.rows] == [None, "ConnectionError: the worker is gone", None]


def test_an_executor_holds_a_bounded_number_of_tasks(monkeypatch):
    monkeypatch.setattr(executors, "MOST_SUBMITTED", 3)
    submitted, finished, most = 0, 0, 0

    class Counting(ThreadPoolExecutor):
        def submit(self, task, /, *arguments):
            nonlocal submitted, most
            submitted += 1
            most = max(most, submitted - finished)
            return super().submit(task, *arguments)

    def count(done, of, what):
        nonlocal finished
        finished = done

    with Counting(1) as executor:
        table = sweep(double, {"x": range(20)}, executor=executor, progress=count)
    assert [row.values["y"] for row in table.rows] == list(range(0, 40, 2))
    assert most == 3
