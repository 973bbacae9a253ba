"""The table of a sweep: CSV, JSON, pandas, Parquet, xarray; units and versions; what without the packages."""

import csv
import io
import json
import math
import platform
import sys

import numba
import numpy as np
import pandas
import pytest

import mpsim
from mpsim import sweep
from mpsim.errors import OutputError


def measured(a, b, seed):
    if a == 2 and b is None:
        raise ValueError("no such case")
    found = {"size": a + 0.5, "count": a, "even": a % 2 == 0, "word": f"<{b}>"}
    return found | ({"late": math.nan} if a == 2 else {})


@pytest.fixture(scope="module")
def table():
    grid = {"a": [1, 2], "b": ["x", None, (1, 2)]}
    return sweep(measured, grid, 2, units={"a": "length", "size": "length", "nowhere": "time"})


COLUMNS = (
    "a", "b", "run", "seed", "size", "count", "even", "word", "late", "wall_seconds", "failure", "mpsim_version",
    "numpy_version", "numba_version", "python_version",
)  # fmt: skip


def test_columns_are_parameters_seeds_results_and_versions(table):
    assert table.columns == COLUMNS
    assert table.units == {"a": "length", "size": "length", "wall_seconds": "s"}, "a unit of nothing is left out"
    here = {"mpsim": mpsim.__version__, "numpy": np.__version__, "numba": numba.__version__}
    here["python"] = platform.python_version()
    assert table.rows[0].versions == here
    assert table.versions == {name: (version,) for name, version in here.items()}


def test_csv_has_a_line_for_each_run_with_units_in_its_head(table, tmp_path):
    text = table.to_csv(tmp_path / "table.csv")
    assert (tmp_path / "table.csv").read_text() == text
    head, *lines = csv.reader(io.StringIO(text))
    assert [word.split(" [")[0] for word in head] == list(COLUMNS)
    assert [word for word in head if "[" in word] == ["a [length]", "size [length]", "wall_seconds [s]"]
    assert len(lines) == 12
    first, failed = dict(zip(COLUMNS, lines[0], strict=True)), dict(zip(COLUMNS, lines[8], strict=True))
    assert (first["a"], first["b"], first["size"], first["even"], first["failure"]) == ("1", "x", "1.5", "False", "")
    assert (failed["size"], failed["failure"]) == ("", "ValueError: no such case")
    assert lines[4][1] == "(1, 2)"


def test_a_file_that_ends_as_another_format_does_is_refused(table, tmp_path):
    with pytest.raises(
        mpsim.InputError, match=r"a sweep must be a file that ends in \.csv or \.txt here; got .*s\.xlsx"
    ):
        table.to_csv(tmp_path / "s.xlsx")
    with pytest.raises(mpsim.InputError, match=r"must be a file that ends in \.json or \.txt here; .*Use 's\.json'\."):
        table.to_json(tmp_path / "s.csv")
    with pytest.raises(mpsim.InputError, match=r"must be a file that ends in \.parquet here; .*Use 's\.parquet'\."):
        table.to_parquet(tmp_path / "s.csv")
    assert not list(tmp_path.iterdir())


def test_json_has_plain_values(table, tmp_path):
    found = json.loads(table.to_json(tmp_path / "table.json"))
    assert json.loads((tmp_path / "table.json").read_text()) == found
    assert found["parameters"] == ["a", "b"]
    assert found["units"]["size"] == "length"
    assert found["versions"]["mpsim"] == [mpsim.__version__]
    assert [row["seed"] for row in found["rows"]] == [row.seed for row in table.rows]
    assert found["rows"][6]["late"] is None, "JSON has no NaN"


def test_pandas_has_types_units_and_versions(table):
    frame = table.to_pandas()
    assert tuple(frame.columns) == COLUMNS
    assert len(frame) == 12
    assert frame["a"].dtype == frame["run"].dtype == frame["seed"].dtype == np.int64
    assert frame["size"].isna().sum() == 2
    assert frame.attrs["units"] == table.units
    assert frame.attrs["versions"]["numpy"] == [np.__version__]


def test_parquet_comes_back_with_units_and_mixed_columns_as_texts(table, tmp_path):
    table.to_parquet(tmp_path / "table.parquet")
    frame = pandas.read_parquet(tmp_path / "table.parquet")
    assert tuple(frame.columns) == COLUMNS
    assert frame.attrs["units"] == table.units
    assert frame["size"].tolist()[:2] == [1.5, 1.5]
    mixed = sweep(lambda a: {"what": a}, {"a": [1, "one", True, None, 2**70, 0.5]})
    mixed.to_parquet(tmp_path / "mixed.parquet")
    found = pandas.read_parquet(tmp_path / "mixed.parquet")["what"]
    assert [None if pandas.isna(each) else each for each in found] == ["1", "one", "True", None, str(2**70), "0.5"]


def test_xarray_has_a_dimension_for_each_parameter(table):
    data = table.to_xarray()
    assert dict(data.sizes) == {"a": 2, "b": 3, "run": 2}
    assert data["a"].values.tolist() == [1, 2]
    assert data["b"].values.tolist() == ["x", "None", "(1, 2)"]
    assert data["size"].attrs == {"units": "length"}
    assert data["a"].attrs == {"units": "length"}
    assert np.isnan(data["size"].sel(a=2, b="None")).all()
    assert (data["size"].sel(a=1) == 1.5).all()
    assert data["word"].sel(a=2, b="x", run=1).item() == "<x>"
    assert data["seed"].dtype == np.int64
    assert data["seed"].sel(a=2, b="x", run=1).item() == table.rows[7].seed
    assert data.attrs["numba_version"] == numba.__version__


def test_values_that_are_equal_but_of_other_kinds_have_their_own_places():
    data = sweep(lambda a: {"kind": type(a).__name__}, {"a": [True, 1, "1", math.nan]}).to_xarray()
    assert data["kind"].values[:, 0].tolist() == ["bool", "int", "str", "float"]
    assert data["a"].values.tolist() == ["True", "1", "1", "nan"]


def test_a_seed_that_is_a_parameter_is_a_column_once():
    table = sweep(lambda seed: {"y": seed}, {"seed": [3, 4]})
    assert table.columns[:3] == ("seed", "run", "y")
    assert [row.record()["seed"] for row in table.rows] == [3, 4]
    assert dict(table.to_xarray().sizes) == {"seed": 2, "run": 1}


@pytest.mark.parametrize(
    ("missing", "method", "what"),
    [
        ("pandas", "to_pandas", "DataFrame"),
        ("pyarrow", "to_parquet", "Parquet file"),
        ("xarray", "to_xarray", "Dataset"),
    ],
)
def test_without_a_package_an_error_says_which_and_what_to_do(missing, method, what, table, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, missing, None)
    arguments = (tmp_path / "table.parquet",) if method == "to_parquet" else ()
    with pytest.raises(OutputError, match=rf"{what} needs the package {missing},.*mpsim\[sweep\]"):
        getattr(table, method)(*arguments)
    assert table.to_csv()


@pytest.mark.parametrize("method", ["to_csv", "to_json", "to_parquet"])
def test_a_table_that_cannot_be_written_is_an_error(method, table, tmp_path):
    with pytest.raises(
        OutputError, match=r"^the table of a sweep must be a file that can be written; got .*No such file"
    ):
        getattr(table, method)(tmp_path / "nowhere" / f"table.{method[3:]}")
