"""Sweeps: points and seeds, rows in their order, executors, the table, the file, what fails, what is refused."""

import functools
import hashlib
import itertools
import json
import math
import os
import platform
import signal
import threading
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from enum import Enum

import numba
import numpy as np
import pytest
from support.processes import Script, assert_clean, run_script, wait_until
from support.scenes import gas as drawn
from support.swept import deadly, double, gas, noted, process_pool

import mpsim
from mpsim import InputError, Settings, sweep
from mpsim.errors import OutputError

pytestmark = pytest.mark.plain

SCENE = drawn(12, 0.2)
GRID, SEEDS = {"packing": [0.1, 0.3]}, 2


def rows_of(table):
    return [(row.point, row.run, row.seed, row.values) for row in table.rows]


@pytest.fixture(scope="module")
def expected():
    return rows_of(sweep(gas, GRID, SEEDS))


# --- points and seeds


WIDE = {"count": [8, 12, 16], "packing": [0.1, 0.3], "law": ["elastic", "reflect"]}


@pytest.mark.parametrize(
    "other",
    [
        {name: WIDE[name] for name in ("law", "count", "packing")},
        WIDE | {"count": [4, *WIDE["count"]]},
        WIDE | {"packing": [0.1, 0.2, 0.3]},
        WIDE | {"law": ["other", "reflect", "elastic"]},
    ],
    ids=["names in another order", "a first value", "one between", "a last axis changed"],
)
def test_seeds_are_of_points_and_not_of_their_places_in_the_grid(other):
    """The control: nearly all points of the grid have another place in the other one."""
    old, new = (
        {
            (frozenset(row.point.items()), row.run): (place, row.seed)
            for place, row in enumerate(sweep(lambda **all_of_it: {}, grid, seeds).rows)
        }
        for grid, seeds in ((WIDE, 3), (other, 4))
    )
    assert {key: new[key][1] for key in old} == {key: seed for key, (_, seed) in old.items()}
    assert len({seed for _, seed in new.values()}) == len(new) >= len(old) == 36
    assert sum(new[key][0] == place for key, (place, _) in old.items()) <= 4


def test_the_seed_is_that_of_the_documented_rule():
    """Computed here from the rule in words; the order of the names is not in it."""
    seed = int.from_bytes(hashlib.blake2b(b'{"a":1,"b":[0.5,"x"]} 3', digest_size=8).digest(), "big") >> 1
    for grid in ({"a": [1], "b": [(0.5, "x")]}, {"b": [[0.5, "x"]], "a": [np.float64(1)]}):
        row = sweep(lambda a, b, seed: {"given": seed}, grid, 4).rows[3]
        assert row.seed == row.values["given"] == seed < 2**63


class Colour(Enum):
    RED = 1


@dataclass(frozen=True)
class Shape:
    side: float
    name: str = "square"


def test_any_values_are_points_and_are_handed_over_as_they_are(tmp_path):
    values = [
        None, True, False, 1, 0.5, math.inf, math.nan, "True", "1", (1, 2), ("a", None), {"a": 1}, Colour.RED,
        Shape(1.0), Shape(1.0, "cube"), Settings(dt=0.1), Settings(), SCENE, 2**70, tmp_path, "\ud800",
    ]  # fmt: skip
    got = []
    for _ in range(2):  # the second time from the file
        table = sweep(lambda value: {"is_it": got.append(value)}, {"value": values}, path=tmp_path / "kept")
        assert all(row.point["value"] is value for row, value in zip(table.rows, values, strict=True))
    assert {id(value) for value in got} == {id(value) for value in values}
    assert len(got) == len(values), "and nothing was called twice"


def test_values_that_a_repr_rounds_are_different_points():
    one, other = (Shape(np.array([side])) for side in (1.0, 1.0 + 1e-12))
    assert repr(one) == repr(other)
    found = sweep(lambda x: {"y": x.side[0]}, {"x": [one, other]})
    assert [row.values["y"] for row in found.rows] == [1.0, 1.0 + 1e-12]


def test_equal_values_are_one_point_and_objects_without_a_name_are_none():
    same = [[1, 1.0, np.int8(1), np.float32(1)], [(1, 2), [1.0, 2]], [0, -0.0], [Shape(1.0), Shape(1.0)]]
    for one, other in itertools.chain.from_iterable(map(itertools.pairwise, same)):
        with pytest.raises(InputError, match=r"^grid\['x'\] must hold different values; got .* more than once"):
            sweep(double, {"x": [one, other]})
    with pytest.raises(InputError, match=r"^grid\['x'\] must hold None, .*; got <object .* make the object in the fun"):
        sweep(double, {"x": [object()]})


def test_functions_of_all_kinds_are_called():
    class Called:
        def __call__(self, x):
            return {"y": x}

    for function in (Called(), Called().__call__, functools.partial(lambda x, k: {"y": x * k}, k=1)):
        assert sweep(function, {"x": [5]}).rows[0].values == {"y": 5}


# --- results and failures


def test_a_failed_run_is_a_row_with_its_error_and_the_others_go_on():
    def root(x):
        if x in (4, 5):
            raise {4: SystemExit("enough"), 5: KeyError}[x]
        return {"root": math.sqrt(x)}

    told = []
    table = sweep(root, {"x": [1, -1, 4, 5, 9]}, progress=lambda *words: told.append(words))
    failures = ["ValueError: math domain error", "SystemExit: enough", "KeyError"]
    assert [row.failure for row in table.rows] == [None, *failures, None]
    assert [row.values for row in table.rows] == [{"root": 1.0}, {}, {}, {}, {"root": 3.0}]
    assert table.failed == table.rows[1:4]
    assert "3 failed" in repr(table)
    assert [done for done, of, _ in told if of == 5] == [0, 1, 2, 3, 4, 5]
    assert [told[0][2], told[-1][2]] == ["runs", "runs, 3 failed"]


def test_results_of_all_kinds_of_scalars_are_plain():
    given = {
        "numpy": np.float32(0.5), "integer": np.int64(3), "truth": np.bool_(True), "text": np.str_("a"),
        "zero": np.array(2.5), "nan": math.nan, "infinite": -np.inf, "none": None, "large": 2**80,
        "measure": mpsim.measure.Measure(2.5, 0.5, 9),
    }  # fmt: skip
    (row,) = sweep(lambda x: given, {"x": [1]}).rows
    assert math.isnan(row.values.pop("nan"))
    assert row.values == {
        "numpy": 0.5, "integer": 3, "truth": True, "text": "a", "zero": 2.5, "infinite": -math.inf, "none": None,
        "large": 2**80, "measure": 2.5, "measure_error": 0.5,
    }  # fmt: skip
    assert {type(value) for value in row.values.values()} == {float, int, bool, str, type(None)}


@pytest.mark.parametrize(
    ("result", "text"),
    [
        (3.5, "the result of the function must be a dictionary.*; got 3.5, a float. Return {'name': value}"),
        ({"a": np.zeros(2)}, "the result 'a' must be a number, a text, True, .*; got array.*keep arrays in a file"),
        ({"x": 2}, "the names of results must be texts, and not those of parameters.*; got 'x'"),
    ],
)
def test_a_result_that_is_no_row_ends_a_sweep(result, text, tmp_path):
    with pytest.raises(InputError, match=text), ThreadPoolExecutor(1) as executor:
        sweep(lambda x: {"y": x} if x == 1 else result, {"x": [1, 2, 3]}, executor=executor, path=tmp_path / "kept")
    assert (tmp_path / "kept").read_text().count('"failure": null') == 1, "runs before it are kept"


# --- what is refused


def pair(x, z=0, seed=0):
    return {"y": x}


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ((double, {}), "grid must be a dictionary of lists, by the name of at least one parameter; got {}"),
        ((double, {"x": []}), r"grid\['x'\] must hold 1 to 1,000,000 values; got none"),
        ((double, {"x": 3}), r"grid\['x'\] must be a list of values; got 3. Write \[value\]"),
        ((double, {"x": range(100_000_000)}), r"grid\['x'\] must hold 1 to 1,000,000 values; got more"),
        ((double, dict.fromkeys("xyz", range(1000))), "grid must have at most 1,000,000 runs, .*; got 1,000,000,000"),
        ((gas, {"packings": [1]}), "grid, .*, must give gas its arguments by name, packing, seed; got packings "),
        ((gas, {"packing": [0.1]}), "grid, .* arguments .*; got packing .*'seed'.*and a 'seed' by seeds="),
        ((double, {"x": [1]}, 2), "grid, .*, must give double its arguments by name, x; got x, seed"),
        ((pair, {"x": [1], "seed": [1]}, 2), "grid must have .* none of run, seed.*got 'seed'"),
        ((pair, {"x": [1]}, 0), "seeds must be a whole number from 1 to 1000000; got 0"),
        ((SCENE, {"dt": [1]}), "function must be a function; got <Scene"),
        ((double, {"x": [1]}, None, None, "/no/such/folder"), "path must be a file in a folder that can be written to"),
    ],
)  # fmt: skip
def test_what_is_refused_before_anything_runs(arguments, text):
    with pytest.raises(InputError, match=f"^{text}"):
        sweep(*arguments)


# --- executors


def test_threads_give_the_same_rows_and_a_result_that_an_executor_loses_is_a_failed_row(expected):
    class Losing(ThreadPoolExecutor):
        def submit(self, task, /, *arguments):
            future = super().submit(task, *arguments)
            if arguments[1].get("x") == 2:
                future = Future()
                future.set_exception(ConnectionError("the worker is gone"))
            return future

    with Losing(2) as executor:
        assert rows_of(sweep(gas, GRID, SEEDS, executor)) == expected
        table = sweep(double, {"x": [1, 2, 3]}, executor=executor)
    assert [row.failure for row in table.rows] == [None, "ConnectionError: the worker is gone", None]
    with pytest.raises(InputError, match=r"^executor must accept tasks; got Losing.*not shut down"):
        sweep(double, {"x": [1]}, executor=executor)


def test_an_executor_holds_a_bounded_number_of_tasks():
    """Each future is looked at a few times, whatever else is pending: `wait` would look at all for each one.

    Runs end in another order than they began; rows stand in that of the grid.
    """
    submitted, finished, most, looks, held = 0, 0, 0, 0, []

    class Watched(Future):
        def __getattribute__(self, name):
            nonlocal looks
            looks += 1
            return super().__getattribute__(name)

    class Counting(ThreadPoolExecutor):
        def submit(self, task, /, *arguments):
            nonlocal submitted, most
            submitted, future = submitted + 1, Watched()
            most = max(most, submitted - finished)
            held.append((future, task, arguments))
            if submitted % 1000 == 0:  # the last one first
                while held:
                    last, task, arguments = held.pop()
                    last.set_result(task(*arguments))
            return future

    def count(done, of, what):
        nonlocal finished
        finished = done

    with Counting(1) as executor:
        table = sweep(double, {"x": range(6000)}, executor=executor, progress=count)
    assert [row.values["y"] for row in table.rows] == list(range(0, 12_000, 2))
    assert 1000 <= most <= 5000
    assert 6000 < looks < 100 * 6000


@pytest.mark.slow
def test_processes_give_the_same_rows_refuse_what_pickle_cannot_send_and_may_die(expected, tmp_path):
    with process_pool(1) as executor:
        assert rows_of(sweep(gas, GRID, SEEDS, executor)) == expected
        for function in (lambda x: {"y": x}, functools.partial(noted, folder=threading.Lock())):
            with pytest.raises(InputError, match=r"^function and the values of the grid must be what pickle can send"):
                sweep(function, {"x": [1, 2]}, executor=executor)
        assert sweep(double, {"x": [1]}, executor=executor).rows[0].values == {"y": 2}, "the pool is as it was"
        table = sweep(deadly, {"x": [1, 2, 3, 4, 5]}, executor=executor, path=tmp_path / "kept")
    assert [row.values for row in table.rows] == [{"y": 2}, {"y": 4}, {}, {}, {}]
    assert all(row.failure.startswith("BrokenProcessPool: ") for row in table.failed)
    with process_pool(1) as executor:
        again = sweep(deadly, {"x": [1, 2, 4, 5]}, executor=executor, path=tmp_path / "kept")
    assert [row.values["y"] for row in again.rows] == [2, 4, 8, 10]


# --- the table


def measured(a, b, seed):
    if a == 2 and b is None:
        raise ValueError("no such case")
    found = {"size": a + 0.5, "count": a, "even": a % 2 == 0, "word": f"<{b}>"}
    return found | ({"late": math.nan} if a == 2 else {})


@pytest.fixture(scope="module")
def table():
    return sweep(measured, {"a": [1, 2], "b": ["x", None, (1, 2)]}, 2)


COLUMNS = ("run", "seed", "a", "b", "wall_seconds", "failure", "size", "count", "even", "word", "late")


@pytest.mark.slow
def test_pandas_has_types_and_versions_and_makes_parquet_and_xarray(table, tmp_path):
    import pandas  # noqa: PLC0415 - which takes a second

    frame = table.to_pandas()
    assert tuple(frame.columns) == COLUMNS
    assert frame["a"].dtype == frame["run"].dtype == frame["seed"].dtype == np.int64
    assert (len(frame), frame["size"].isna().sum()) == (12, 2)
    assert (frame["b"][4], frame["failure"][8]) == ("(1, 2)", "ValueError: no such case")
    here = {"mpsim": mpsim.__version__, "numpy": np.__version__, "numba": numba.__version__}
    assert frame.attrs["versions"] == here | {"python": platform.python_version()}
    seeded = sweep(lambda seed: {"y": seed}, {"seed": [3, 4]}).to_pandas()
    assert tuple(seeded.columns) == ("run", "seed", "wall_seconds", "failure", "y"), "a parameter is a column once"
    assert seeded["seed"].tolist() == [3, 4]
    frame.to_parquet(tmp_path / "table.parquet")
    again = pandas.read_parquet(tmp_path / "table.parquet")
    assert (tuple(again.columns), again.attrs) == (COLUMNS, frame.attrs)
    assert again["size"].tolist()[:2] == [1.5, 1.5]
    data = frame.fillna({"b": "None"}).set_index(["a", "b", "run"]).to_xarray()
    assert dict(data.sizes) == {"a": 2, "b": 3, "run": 2}
    assert np.isnan(data["size"].sel(a=2, b="None")).all()
    assert data["seed"].sel(a=2, b="x", run=1).item() == table.rows[7].seed


# --- the file of a sweep: what is in it is not run again


@pytest.fixture
def kept(tmp_path):
    return tmp_path / "kept.jsonl"


@pytest.fixture
def noting(tmp_path):
    return functools.partial(noted, folder=str(tmp_path))


def calls_in(folder):
    path = folder / "calls"
    found = [int(line) for line in path.read_text().split()] if path.exists() else []
    path.unlink(missing_ok=True)
    return sorted(found)


def test_what_is_there_is_not_run_again_whatever_else_the_grid_has_now(noting, kept, tmp_path):
    first = sweep(noting, {"x": [1, 2]}, path=kept)
    assert calls_in(tmp_path) == [1, 2]
    assert sweep(noting, {"x": [2, 1]}, path=kept).rows == first.rows[::-1]
    assert calls_in(tmp_path) == []
    more = sweep(noting, {"x": [3, 2.0]}, path=str(kept))
    assert calls_in(tmp_path) == [3]
    assert [row.values["y"] for row in more.rows] == [6, 4]
    sweep(noting, {"x": [1, 2, 3]}, path=kept)
    assert calls_in(tmp_path) == [], "rows of values that were left out for a while are still there"


def test_values_come_back_as_they_were(kept):
    given = {"infinite": -math.inf, "tiny": 5e-324, "third": 1 / 3, "large": 2**70, "none": None, "truth": True,
             "text": "\u00e9\n", "empty": ""}  # fmt: skip
    first, found = (sweep(lambda x: given | {"nan": math.nan}, {"x": [1]}, path=kept).rows[0].values for _ in range(2))
    assert str(found.pop("nan")) == str(first.pop("nan")) == "nan"
    assert found == first == given
    assert [type(value) for value in found.values()] == [type(value) for value in given.values()]


def odd(x):
    if x == 0:
        return {"name": "a\udcff"}
    raise ValueError("z" * 10_000_000 if x == 1 else "no file \udcff")


def test_lone_surrogates_and_long_errors_are_written_out(kept):
    table = sweep(odd, {"x": [0, 1, 2]}, path=kept)
    assert kept.stat().st_size < 20_000, "an error of 10 MB is cut"
    assert sweep(odd, {"x": [0]}, path=kept).rows == table.rows[:1]


def test_failed_runs_are_run_again(kept, tmp_path):
    def once(x):
        if not (tmp_path / "well").exists():
            raise ValueError(f"not yet {x}")
        return {"y": x}

    (failed,) = sweep(once, {"x": [1]}, path=kept).rows
    assert failed.failure == "ValueError: not yet 1"
    (tmp_path / "well").touch()
    (done,) = sweep(once, {"x": [1]}, path=kept).rows
    (tmp_path / "well").unlink()
    assert sweep(once, {"x": [1]}, path=kept).rows[0] == done, "the later row counts"
    assert done.values == {"y": 1}


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ((double, {"x": [1]}), 'has function "pair", and this sweep function "double"'),
        ((functools.partial(pair, z=2), {"x": [1]}), r"has function .*this sweep function .*'z': 2"),
        ((pair, {"x": [1], "z": [2]}), r'has parameters \["x"\], and this sweep parameters \["x", "z"\]'),
        ((pair, {"x": [1]}, 2), "has seeded false, and this sweep seeded true"),
    ],
)
def test_the_file_of_another_sweep_is_refused_by_name_and_left_alone(arguments, text, kept):
    sweep(pair, {"x": [1]}, path=kept)
    before = kept.read_bytes()
    with pytest.raises(InputError, match=rf"^path must be a file of the same sweep, or none yet; .*kept.jsonl {text}"):
        sweep(*arguments, path=kept)
    assert kept.read_bytes() == before


@pytest.mark.parametrize("cut", [1, 60])
def test_a_last_line_that_was_cut_off_is_dropped(cut, noting, kept, tmp_path):
    sweep(noting, {"x": [1, 2, 3]}, path=kept)
    whole = kept.read_bytes()
    calls_in(tmp_path)
    kept.write_bytes(whole[:-cut])
    assert [row.values["y"] for row in sweep(noting, {"x": [1, 2, 3]}, path=kept).rows] == [2, 4, 6]
    assert len(calls_in(tmp_path)) == 1
    sweep(noting, {"x": [1, 2, 3]}, path=kept)
    assert kept.read_bytes().count(b"\n") == 4


@pytest.mark.parametrize("text", ["notes\n", '{"format": "mpsim sweep 1"}\n', "\n"])
def test_a_file_that_is_no_sweep_is_refused_and_left_alone(text, kept):
    kept.write_text(text)
    with pytest.raises(
        InputError, match=r"^path must be a file of (an earlier|the same) sweep, or none yet; .*kept.jsonl "
    ):
        sweep(double, {"x": [1]}, path=kept)
    assert kept.read_text() == text


@pytest.mark.parametrize("line", ["{", "{}", '{"point": {}, "run": "a"}', "\x00\x00"])
def test_damage_in_the_middle_is_refused_with_its_line(line, kept):
    sweep(double, {"x": [1, 2]}, path=kept)
    head, _, second = kept.read_text().splitlines()
    kept.write_text(f"{head}\n{line}\n{second}\n")
    with pytest.raises(InputError, match=r"cannot be read as one \(line 2"):
        sweep(double, {"x": [1, 2]}, path=kept)


def test_paths_that_are_no_files_are_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for name in ("pipe", ""):
        with pytest.raises(InputError, match=r"^path must be a file"):
            sweep(double, {"x": [1]}, path=tmp_path / name)


def test_two_sweeps_on_one_file_at_once_are_refused_in_one_process_and_in_two(kept):
    def inner(x):
        with pytest.raises(
            InputError, match=r"^path must be a file that no other sweep has; .*is being written"
        ) as found:
            sweep(double, {"x": [1]}, path=kept)
        done = run_script(
            f"import mpsim; from support.swept import double; mpsim.sweep(double, {{'x': [1]}}, path={str(kept)!r})",
            warm=True,
        )
        assert "InputError: path must be a file that no other sweep has" in done.err
        return {"text": str(found.value)}

    (row,) = sweep(inner, {"x": [1]}, path=kept).rows
    assert row.failure is None, row.failure
    sweep(inner, {"x": [1]}, path=kept)


def test_a_disk_without_room_is_an_error_and_leaves_whole_lines(kept, monkeypatch):
    sweep(double, {"x": [1]}, path=kept)
    before, write = kept.read_bytes(), os.write

    def full(descriptor, content):
        if content.startswith(b'{"point"'):
            return write(descriptor, content[:30])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "write", full)
    with pytest.raises(
        OutputError, match=r"^the file of a sweep must have room on its disk; .*No space left on device"
    ):
        sweep(double, {"x": [1, 2]}, path=kept)
    monkeypatch.undo()
    assert kept.read_bytes() == before


INTERRUPTED = """
import functools, sys, threading
from concurrent.futures import ThreadPoolExecutor
import mpsim
from support.swept import gated

print("ready")
executor = {executor}
try:
    mpsim.sweep(functools.partial(gated, folder={folder!r}), {{"x": list(range(6))}}, executor=executor, path={kept!r},
                progress=lambda done, of, what: print(done))
except (KeyboardInterrupt, SystemExit) as error:
    print(type(error).__name__)
"""


def interrupted(text, number, executor, kept, folder):
    """The points that a sweep has kept to which a signal comes within its second run."""
    calls = folder / "calls"
    text += INTERRUPTED.format(executor=executor, folder=str(folder), kept=str(kept))
    with Script(text + "executor and executor.shutdown()\n", warm=True) as script:
        assert [script.line() for _ in range(3)] == ["ready", "0", "1"]
        assert wait_until(lambda: calls.exists() and len(calls.read_text().split()) >= 2, 20)
        script.send(number)
        assert script.line() == ("KeyboardInterrupt" if number == signal.SIGINT else "SystemExit")
        (folder / "go1").touch()
        assert_clean(script.finish())
    assert calls_in(folder) == [0, 1]
    return [json.loads(row)["point"]["x"] for row in kept.read_text().splitlines()[1:]]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_cancels_what_has_not_begun_and_keeps_what_has(number, kept, tmp_path):
    for x in (0, 3, 4, 5):
        (tmp_path / f"go{x}").touch()
    assert interrupted("", number, "ThreadPoolExecutor(1)", kept, tmp_path) == [0]


RELEASING = """
import os, pathlib, signal
def pressed(*_):
    pathlib.Path({go!r}).touch()
    raise KeyboardInterrupt

os.environ["PYTHON_CPU_COUNT"] = "1"
signal.signal(signal.SIGINT, pressed)
"""
"""Ctrl-C, upon which the run that goes on may end."""


def test_of_its_own_threads_a_sweep_waits_and_keeps_what_they_finish(kept, tmp_path):
    (tmp_path / "go0").touch()
    assert interrupted(RELEASING.format(go=str(tmp_path / "go1")), signal.SIGINT, "None", kept, tmp_path) == [0, 1]
