"""The result of a sweep: a table with one row for each run."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np

from mpsim.core import checks
from mpsim.core.optional_packages import imported
from mpsim.core.plain import json_text
from mpsim.core.table_files import CSV, JSON, demand_parquet, write_parquet, written
from mpsim.errors import InputError

TABLE = "the table of a sweep"

VERSIONS = ("mpsim", "numpy", "numba", "python")
"""What has versions in each row."""

OWN: tuple[str, ...] = ("run", "seed", "wall_seconds", "failure", *(f"{name}_version" for name in VERSIONS))
"""Columns that every sweep has, besides those of the grid and of the results."""

Scalar = bool | int | float | str | None


@dataclass(frozen=True)
class SweepRow:
    """One run of a sweep.

    Attributes:
        point: values of the parameters, as the grid gave them.
        run: number of the run at this point, from 0 on.
        seed: that the run was given; None without seeds.
        values: its results by name; empty if it failed.
        failure: why it failed, as "ValueError: ..."; None if it did not.
        traceback: the last lines of the traceback of a failure; "" without any.
        wall_seconds: time that it took [s]; NaN if that is unknown.
        versions: of mpsim, numpy, numba and python, where it ran.
    """

    point: dict[str, Any]
    run: int
    seed: int | None
    values: dict[str, Scalar]
    failure: str | None = None
    traceback: str = ""
    wall_seconds: float = math.nan
    versions: dict[str, str] = field(default_factory=dict[str, str])

    def record(self) -> dict[str, Scalar]:
        """The row as plain values by column name; what is not a number, text or truth value is given as its repr."""
        found: dict[str, Scalar] = {name: plain(value) for name, value in self.point.items()}
        found |= {"run": self.run, "seed": found.get("seed", self.seed), **self.values}
        found["wall_seconds"] = self.wall_seconds
        versions = {f"{name}_version": self.versions.get(name) for name in VERSIONS}
        return {**found, "failure": self.failure, **versions}


@checks.known_names_of_methods
@dataclass(frozen=True, repr=False)
class Sweep:
    """The rows of a sweep, in the order of the grid: its last name changes fastest, and the runs of a point in it.

    Attributes:
        function: what was run, by name.
        parameters: names of the grid.
        rows: one for each run, failed ones included.
        units: units by the name of a column, where known; "1" means dimensionless.

    >>> import mpsim
    >>> def area(width, height):
    ...     return {"area": width * height}
    >>> table = mpsim.sweep(area, {"width": [1.0, 2.0], "height": [3.0, 0.0]}, units={"area": "length^2"})
    >>> table
    <Sweep: 4 runs of area over width, height>
    >>> [(row.point["width"], row.point["height"], row.values["area"]) for row in table.rows]
    [(1.0, 3.0, 3.0), (1.0, 0.0, 0.0), (2.0, 3.0, 6.0), (2.0, 0.0, 0.0)]
    >>> table.to_csv().splitlines()[0].split(",")[:5]
    ['width', 'height', 'run', 'seed', 'area [length^2]']
    """

    function: str
    parameters: tuple[str, ...]
    rows: tuple[SweepRow, ...]
    units: dict[str, str] = field(default_factory=dict[str, str])

    @property
    def results(self) -> tuple[str, ...]:
        """Names of the results, in the order in which the rows have them."""
        return tuple(dict.fromkeys(name for row in self.rows for name in row.values))

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns of the table: parameters, run, seed, results, wall_seconds, failure, versions."""
        return tuple(dict.fromkeys((*self.parameters, *OWN[:2], *self.results, *OWN[2:])))

    @property
    def failed(self) -> tuple[SweepRow, ...]:
        """The rows whose run failed."""
        return tuple(row for row in self.rows if row.failure is not None)

    @property
    def versions(self) -> dict[str, tuple[str, ...]]:
        """Versions of mpsim, numpy, numba and python that made the rows: one of each, unless a file mixes several."""
        found = {name: {row.versions[name] for row in self.rows if name in row.versions} for name in VERSIONS}
        return {name: tuple(sorted(each)) for name, each in found.items()}

    def to_csv(self, path: str | Path | None = None) -> str:
        """The table as CSV, one line for each run; also written to `path`, if given.

        The header of a column whose unit is known is "name [unit]". Missing results of failed runs are empty.

        Raises:
            InputError: if the path has the ending of another format.
            OutputError: if the file cannot be written.
        """
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        columns = self.columns
        writer.writerow([f"{name} [{self.units[name]}]" if name in self.units else name for name in columns])
        for row in self.rows:
            record = row.record()
            writer.writerow([record.get(name) for name in columns])
        return written(text.getvalue(), path, TABLE, CSV)

    def to_json(self, path: str | Path | None = None) -> str:
        """The table as JSON: function, parameters, units, versions, and rows of plain values; also written to `path`.

        Numbers that are not finite become null.

        Raises:
            InputError: if the path has the ending of another format.
            OutputError: if the file cannot be written.
        """
        values = {"function": self.function, "parameters": self.parameters, "units": self.units}
        values |= {"versions": self.versions, "rows": [row.record() for row in self.rows]}
        return written(json_text(values) + "\n", path, TABLE, JSON)

    def to_pandas(self) -> Any:
        """The table as a pandas.DataFrame, one line for each run; its `attrs` hold units and versions.

        Raises:
            OutputError: if pandas is not installed.
        """
        pandas, columns = _library("pandas", "a DataFrame"), self.columns
        records = [row.record() for row in self.rows]
        frame = pandas.DataFrame({name: [record.get(name) for record in records] for name in columns})
        versions = {name: list(each) for name, each in self.versions.items()}
        frame.attrs = {"function": self.function, "units": dict(self.units), "versions": versions}
        return frame

    def to_parquet(self, path: str | Path) -> None:
        """Write the table to `path` as a Parquet file through pandas, which keeps units and versions in its `attrs`.

        A column that mixes texts with numbers is written as texts.

        Raises:
            InputError: if the path does not end in .parquet.
            OutputError: if pandas or pyarrow is not installed, or the file cannot be written.
        """
        demand_parquet()
        frame = self.to_pandas()
        records = [row.record() for row in self.rows]
        for name in self.columns:
            given = [record.get(name) for record in records]
            kinds = {_kind(value) for value in given if value is not None}
            if len(kinds) > 1 or "long" in kinds:
                frame[name] = [None if value is None else str(value) for value in given]
        write_parquet(frame, path, TABLE)

    def to_xarray(self) -> Any:
        """The results as an xarray.Dataset: a dimension for each parameter, and `run` for the runs of a point.

        Each result is a variable with its unit as the attribute `units`; so are seed, wall_seconds and failure. Results
        that a run lacks are NaN, or None if the result is not a number. If the values of a parameter are neither all
        numbers nor all texts, they become texts.

        Raises:
            OutputError: if xarray is not installed.
        """
        xarray = _library("xarray", "a Dataset")
        records = [row.record() for row in self.rows]
        axes = {name: {_key(record[name]): record[name] for record in records} for name in (*self.parameters, "run")}
        places = {name: {key: place for place, key in enumerate(axis)} for name, axis in axes.items()}
        where = tuple(np.array([places[name][_key(record[name])] for record in records]) for name in axes)
        shape = tuple(map(len, axes.values()))
        variables: dict[str, Any] = {}
        for name in (*self.results, "seed", "wall_seconds", "failure"):
            if name in axes:
                continue
            values = [record.get(name) for record in records]
            if name == "seed" and not any(value is not None for value in values):
                continue
            variables[name] = (tuple(axes), _array(values, where, shape), self._unit(name))
        labels = {name: (name, _coordinate(list(axes[name].values())), self._unit(name)) for name in axes}
        attributes = {"function": self.function}
        attributes |= {f"{name}_version": ", ".join(each) for name, each in self.versions.items()}
        return xarray.Dataset(variables, labels, attributes)

    def _unit(self, name: str) -> dict[str, str]:
        return {"units": self.units[name]} if name in self.units else {}

    def __repr__(self) -> str:
        failed = f", {len(self.failed)} failed" if self.failed else ""
        return f"<Sweep: {len(self.rows)} runs of {self.function} over {', '.join(self.parameters)}{failed}>"


def plain(value: Any) -> Scalar:
    """A value of the grid as a table shows it."""
    found: Any = cast("Any", value).item() if isinstance(value, np.generic) else value
    return found if found is None or isinstance(found, bool | int | float | str) else repr(found)


def _library(name: str, what: str) -> Any:
    return imported(name, what, "sweep", "use to_csv or to_json, which need nothing")


def _key(value: Scalar) -> tuple[str, Scalar]:
    """A value that is equal only to one of its kind: True is not 1, and NaN is NaN."""
    return (_kind(value), "nan") if isinstance(value, float) and math.isnan(value) else (_kind(value), value)


def _kind(value: Scalar) -> str:
    if isinstance(value, int) and not isinstance(value, bool) and not -(2**63) <= value < 2**63:
        return "long"
    if value is None:
        return "none"
    return "bool" if isinstance(value, bool) else "text" if isinstance(value, str) else "number"


def _coordinate(values: list[Any]) -> Any:
    kinds = {_kind(value) for value in values}
    return np.array(values) if kinds in ({"number"}, {"text"}, {"bool"}) else np.array([str(each) for each in values])


def _array(values: list[Any], where: tuple[Any, ...], shape: tuple[int, ...]) -> Any:
    """The values at their places: whole numbers or truth values if each place has one, else float64, else objects."""
    kinds = {_kind(value) for value in values}
    whole = len(values) == math.prod(shape)
    if kinds == {"number"} and whole:
        array = np.empty(shape, np.array(values).dtype)
    elif kinds == {"bool"} and whole:
        array = np.empty(shape, bool)
    elif kinds <= {"number", "none"} and "number" in kinds:
        array, values = np.full(shape, np.nan), [math.nan if value is None else value for value in values]
    else:
        array = np.full(shape, None, object)
    array[where] = values
    return array


def checked_units(units: Any, known: Mapping[str, str]) -> dict[str, str]:
    """Units by the name of a column: the known ones, and those given by the caller."""
    if units is None:
        return dict(known)
    given = cast("Mapping[Any, Any]", units)
    if not isinstance(units, Mapping) or not all(isinstance(each, str) for pair in given.items() for each in pair):
        raise InputError(
            f"units must be a dictionary of texts by the name of a column; got {checks.brief(units)}. "
            "Write {'pressure': 'mass/time^2'}."
        )
    return {**known, **given}
