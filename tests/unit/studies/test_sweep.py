"""Sweeps in threads: points, seeds, rows, what fails, and what is refused."""

import functools
import hashlib
import itertools
import json
import math
import re
import sys
import threading
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
import pytest
from support.swept import double, gas

import mpsim
from mpsim import InputError, sweep
from mpsim.studies import executors
from mpsim.studies.sweep_points import canonical, points_of, seed_of, text_of

PACKINGS = {"packing": [0.1, 0.3]}


def by_point(table):
    return {(tuple(row.point.items()), row.run): (row.seed, row.values) for row in table.rows}


def test_rows_come_in_the_order_of_the_grid_whatever_the_order_in_which_runs_end():
    last = threading.Event()

    def waits(a, b):
        if (a, b) == (2, "y"):
            last.set()
        assert a == 2 or last.wait(10)
        return {"both": f"{a}{b}"}

    with ThreadPoolExecutor(4) as executor:
        table = sweep(waits, {"a": [1, 2], "b": ["x", "y"]}, executor=executor)
    assert [row.values["both"] for row in table.rows] == ["1x", "1y", "2x", "2y"]


def test_another_value_another_seed_or_another_order_changes_no_other_row():
    table = sweep(gas, PACKINGS, 2)
    more = sweep(gas, {"packing": [0.2, 0.3, 0.1]}, [5, 1, 0])
    old, new = by_point(table), by_point(more)
    assert {key: new[key] for key in old} == old
    assert len({seed for seed, _ in new.values()}) == len(new) == 9
    assert len({values["x"] for _, values in new.values()}) == 9, "the control: seeds make different runs"


WIDE = {"count": [8, 12, 16], "packing": [0.1, 0.3], "law": ["elastic", "reflect"]}


@pytest.mark.parametrize(
    "other",
    [
        {name: WIDE[name] for name in ("law", "count", "packing")},
        {name: values[::-1] for name, values in WIDE.items()},
        WIDE | {"count": [4, *WIDE["count"]]},
        WIDE | {"packing": [0.1, 0.2, 0.3]},
        WIDE | {"law": ["other", "reflect", "elastic"]},
    ],
    ids=["names in another order", "values backwards", "a first value", "one between", "a last axis changed"],
)
def test_seeds_are_of_points_and_not_of_their_places_in_the_grid(other):
    """The control: nearly all points of the grid have another place in the other one."""
    old, new = (
        {(frozenset(each.values.items()), each.run): (place, each.seed) for place, each in enumerate(points)}
        for points in (points_of(WIDE, 3), points_of(other, [2, 1, 0]))
    )
    assert {key: new[key][1] for key in old} == {key: seed for key, (_, seed) in old.items()}
    assert len({seed for _, seed in new.values()}) == len(new) >= len(old) == 36
    assert sum(new[key][0] == place for key, (place, _) in old.items()) <= 4


def test_the_seed_is_that_of_the_documented_rule():
    """Computed here from the rule in words; the order of the names is not in it."""
    hashed = hashlib.blake2b(b'{"a":1,"b":[0.5,"x"]} 3', digest_size=8).digest()
    expected = int.from_bytes(hashed, "big") >> 1
    for grid in ({"a": [1], "b": [(0.5, "x")]}, {"b": [[0.5, "x"]], "a": [np.float64(1)]}):
        (row,) = sweep(lambda a, b, seed: {"given": seed}, grid, [3]).rows
        assert row.seed == row.values["given"] == expected < 2**63


def test_seeds_are_uniform_over_their_range():
    seeds = np.array([seed_of({"n": n}, run) for n in range(500) for run in range(4)], dtype=float) / 2.0**63
    counts = np.histogram(seeds, 20, (0, 1))[0]
    assert ((counts - 100) ** 2 / 100).sum() < 45.3, "chi squared of 19 degrees of freedom: 1 in 1500 by chance"


class Colour(Enum):
    RED = 1


@dataclass(frozen=True)
class Shape:
    side: float
    name: str = "square"
    note: str = field(default="", compare=False)


def test_any_values_are_points_and_are_handed_over_as_they_are(tmp_path):
    values = [
        None, True, False, 1, 0.5, math.inf, math.nan, "True", "1", (1, 2), ("a", None), {"a": 1}, Colour.RED,
        Shape(1.0), Shape(1.0, "cube"), mpsim.Settings(dt=0.1), mpsim.Settings(), mpsim.Scene.load("gas"), 2**70,
        tmp_path, "\ud800",
    ]  # fmt: skip
    got = []
    for _ in range(2):  # the second time from the file
        table = sweep(lambda value: {"is_it": got.append(value)}, {"value": values}, path=tmp_path / "kept")
        assert all(row.point["value"] is value for row, value in zip(table.rows, values, strict=True))
    assert {id(value) for value in got} == {id(value) for value in values}
    assert len(got) == len(values), "and nothing was called twice"


def test_equal_values_are_one_point_and_new_fields_with_defaults_change_none():
    same = [[1, 1.0, np.int8(1), np.float32(1)], [(1, 2), [1.0, 2]], [0, -0.0], [Shape(1), Shape(1.0, note="other")]]
    for group in same:
        for one, other in itertools.pairwise(group):
            assert canonical("x", one) == canonical("x", other)
            with pytest.raises(InputError, match=r"^grid\['x'\] must hold different values; got .* more than once"):
                sweep(double, {"x": [one, other]})
    assert canonical("x", Shape(2.5)) == {"dataclass": f"{__name__}.Shape", "side": 2.5}, "without its default name"
    assert len({text_of({"x": canonical("x", value)}) for value in (True, 1, "1", None, [1])}) == 5, "the control"


def test_a_failed_run_is_a_row_with_its_error_and_the_others_go_on():
    def root(x):
        if x == 4:
            raise SystemExit("enough")
        return {"root": math.sqrt(x)}

    table = sweep(root, {"x": [1, -1, 4, 9]})
    assert [row.failure for row in table.rows] == [None, "ValueError: math domain error", "SystemExit: enough", None]
    assert [row.values for row in table.rows] == [{"root": 1.0}, {}, {}, {"root": 3.0}]
    assert 'return {"root": math.sqrt(x)}' in table.failed[0].traceback
    assert len(table.failed) == 2
    assert "2 failed" in repr(table)


def test_an_error_without_a_text_and_one_whose_text_raises_are_told():
    class Broken(Exception):  # noqa: N818
        def __str__(self):
            raise ValueError

    def fails(kind):
        raise (Broken if kind else KeyError)

    table = sweep(fails, {"kind": [False, True]})
    assert [row.failure for row in table.rows] == ["KeyError", "Broken: its text cannot be had"]


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
        (None, "the result of the function must be a dictionary of numbers.*; got None, a NoneType"),
        (3.5, "the result of the function must be a dictionary.*; got 3.5, a float. Return {'name': value}"),
        (mpsim.Scene.load("gas"), "got <Scene.* a Scene.*To run scenes, say how long: until="),
        ({"a": [1]}, "the result 'a' must be a number, a text, True, False or None; got .1., a list"),
        ({"a": np.zeros(2)}, "the result 'a' must be a number.*; got array.*keep arrays in a file"),
        ({"a": 1j}, "the result 'a' must be a number.*; got 1j, a complex"),
        ({1: 2}, "the names of results must be texts; got 1"),
        ({"x": 2}, "the names of results must not be those of parameters.*; got 'x'"),
        ({"failure": 2}, "the names of results must not be those of.*; got 'failure'"),
    ],
)
def test_a_result_that_is_no_row_ends_a_sweep_without_any_but_is_a_failed_row_beside_others(result, text):
    with pytest.raises(InputError, match=text):
        sweep(lambda x: result, {"x": [1, 2]})
    with ThreadPoolExecutor(1) as executor:
        table = sweep(lambda x: {"y": x} if x == 1 else result, {"x": [1, 2, 3]}, executor=executor)
    assert [row.failure is None for row in table.rows] == [True, False, False]
    assert table.rows[1].failure.startswith("InputError: the ")


def takes(x, *, seed=0):
    return {"y": x}


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ((double, {}), "grid must hold at least one parameter; got none"),
        ((double, [1, 2]), r"grid must be a dictionary of lists.*; got \[1, 2\]"),
        ((double, {1: [2]}), "grid must have names of parameters as its keys; got 1"),
        ((double, {"x": []}), r"grid\['x'\] must hold at least one value; got none"),
        ((double, {"x": 3}), r"grid\['x'\] must be a list of values; got 3. Write \[value\]"),
        ((double, {"x": "grid"}), r"grid\['x'\] must be a list of values; got 'grid'"),
        ((double, {"x": [object]}), r"grid\['x'\] must hold None, True or False.*; got <class 'object'>, a type"),
        ((double, {"x": range(100_000_000)}), r"grid\['x'\] must have at most 10,000,000 values"),
        ((gas, {"packings": [1]}), r"grid\['packings'\] must be an argument of gas.*Did you mean 'packing'"),
        ((gas, {"packing": [0.1]}), "grid must hold every argument that gas needs.*it lacks seed.*ask for seeds"),
        ((double, {"x": [1]}, 2), "function must take an argument 'seed' where seeds are asked for; double takes x"),
        ((takes, {"x": [1], "seed": [1]}, 2), "grid must not have the names run, seed.*got 'seed'"),
        ((takes, {"x": [1]}, 0), "seeds must be a whole number from 1 to 1000000; got 0"),
        ((takes, {"x": [1]}, True), "seeds must be a whole number from 1 to 1000000; got True"),
        ((takes, {"x": [1]}, []), r"seeds must be a number of runs, or different numbers of them; got \[\]"),
        ((takes, {"x": [1]}, [1, 1]), r"seeds must be a number of runs, or different numbers of them; got \[1, 1\]"),
        ((takes, {"x": [1]}, [-1]), "a number in seeds must be a whole number from 0 to .*; got -1"),
        ((takes, {"x": [1]}, 2, ThreadPoolExecutor), "executor must be a concurrent.futures.Executor; got type"),
        ((takes, {"x": [1]}, 2, 4), "executor must be a concurrent.futures.Executor; got int. Use ProcessPool"),
        ((7, {"x": [1]}), "function must be a function, an mpsim.Scene, or the name or path of one; got 7"),
        ((takes, {"dt": [1]}), r"grid\['dt'\] must be an argument of takes.*To run the scene.*until="),
    ],
)  # fmt: skip
def test_what_is_refused_before_anything_runs(arguments, text):
    with pytest.raises(InputError, match=f"^{text}"):
        sweep(*arguments)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"units": ["m"]}, "units must be a dictionary of texts by the name of a column; got"),
        ({"units": {"y": 1}}, "units must be a dictionary of texts"),
        ({"progress": 3}, "progress must be True, False or a function"),
        ({"retry_failed": 1}, "retry_failed must be True or False; got 1"),
        ({"path": 7}, "path must be a file in a folder that can be written to; got 7"),
        ({"path": "/no/such/folder"}, "path must be a file in a folder that can be written to; got '/no/such/folder'"),
    ],
)
def test_options_are_checked(options, text):
    with pytest.raises(InputError, match=f"^{text}"):
        sweep(double, {"x": [1]}, **options)


def test_an_executor_that_was_shut_down_is_refused():
    executor = ThreadPoolExecutor(1)
    executor.shutdown()
    with pytest.raises(InputError, match=r"^executor must accept tasks; got ThreadPoolExecutor.*not shut down"):
        sweep(double, {"x": [1]}, executor=executor)


def test_functions_of_all_kinds_are_called():
    class Method:
        def here(self, x):
            return {"y": x}

        def __call__(self, x):
            return {"y": x}

    kinds = [
        Method().here,
        Method(),
        functools.partial(lambda x, k: {"y": x * k}, k=1),
        lambda **any_: {"y": any_["x"]},
    ]
    for function in kinds:
        assert sweep(function, {"x": [5]}).rows[0].values == {"y": 5}


def test_progress_counts_runs_and_failures(capsys, monkeypatch):
    calls = []
    sweep(lambda x: {"y": 1 / x}, {"x": [2, 1, 0]}, progress=lambda *words: calls.append(words))
    assert [call[:2] for call in calls] == [(0, 3), (1, 3), (2, 3), (3, 3)]
    assert calls[0][2] == "runs"
    assert calls[3][2] == "runs, 1 failed"
    sweep(double, {"x": [1, 2]}, progress=True)
    assert re.fullmatch(r"2 of 2: runs(, [\d.,e+]+/s)?\n", capsys.readouterr().err)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    sweep(double, {"x": [1, 2]}, progress=True)
    assert re.search(r"runs \[#+\] 2/2", capsys.readouterr().err)


class Watched(Future):
    """A future that counts how often anything of it is asked for."""

    looks = 0

    def __getattribute__(self, name):
        Watched.looks += 1
        return super().__getattribute__(name)


class Waiting(Executor):
    """Has done nothing until it holds as many tasks as it gets at a time, and ends them one by one, the last first."""

    def __init__(self, most):
        self.most, self.left, self.held = most, 10_000, []

    def submit(self, task, /, *arguments):
        future = Watched()
        self.held.append((future, task, arguments))
        self.left -= 1
        if len(self.held) == self.most or not self.left:
            while self.held:
                last, task, arguments = self.held.pop()
                last.set_result(task(*arguments))
        return future


@pytest.mark.slow
def test_ten_thousand_points_are_each_in_their_place_and_looked_at_a_few_times(monkeypatch):
    """Whatever else is pending: one that looks at all of that for each run that ends looks a thousand times as often.

    The control: `wait` of concurrent.futures, which does.
    """
    Watched.looks, most = 0, 1000
    monkeypatch.setattr(executors, "MOST_SUBMITTED", most)
    table = sweep(double, {"x": range(10_000)}, executor=Waiting(most))
    assert [(row.point["x"], row.values["y"]) for row in table.rows] == [(x, 2 * x) for x in range(10_000)]
    assert 10_000 < Watched.looks < 100 * 10_000
    pending, Watched.looks = [Watched() for _ in range(most)], 0
    for future in pending:
        future.set_result(0)
        wait(pending, return_when=FIRST_COMPLETED)
    assert Watched.looks > 100 * most


def test_the_text_of_a_point_is_json():
    assert json.loads(json.dumps(canonical("x", {"a": (1, None)}))) == {"dict": {"a": [1, None]}}
