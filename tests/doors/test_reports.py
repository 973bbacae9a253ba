"""Reports as tables: text, pandas and Parquet hold the same times of frames, phases and workers."""

import csv
import sys

import pytest
from support.scenes import gas, simulate

import mpsim


@pytest.fixture(scope="module")
def report():
    with simulate(gas(20, 0.2), method="grid") as sim:
        return sim.run(frames=7, measures=["temperature"])


@pytest.mark.parametrize("workers", [1, 2])
def test_times_as_csv_are_those_of_the_report(workers, tmp_path):
    with simulate(gas(200, 0.4), method="parallel", workers=workers) as sim:
        report = sim.run(frames=3)
    text = report.to_csv(tmp_path / "times.csv", first_frame=11)
    assert (tmp_path / "times.csv").read_text() == text
    rows = list(csv.DictReader(text.splitlines()))
    assert [row["frame"] for row in rows] == ["11", "12", "13"]
    assert [float(row["seconds"]) for row in rows] == report.frame_seconds.tolist()
    for name, seconds in report.phase_seconds.items():
        for worker in range(report.workers):  # one in plain Python
            assert [float(row[f"{name.replace(' ', '_')}_{worker}"]) for row in rows] == seconds[:, worker].tolist()


@pytest.mark.slow
def test_the_table_of_pandas_is_that_of_csv(report, monkeypatch):
    rows, found = list(csv.DictReader(report.to_csv().splitlines())), report.to_pandas().reset_index()
    assert list(found.columns) == list(rows[0])
    assert found.to_dict("records") == [{name: float(value) for name, value in row.items()} for row in rows]
    assert found.attrs["measures"]["temperature"]["value"] == report.measures["temperature"].value
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(mpsim.errors.OutputError, match=r"a DataFrame needs the package pandas.*`, or use to_csv"):
        report.to_pandas()


def test_places_that_cannot_be_written_are_refused(report, tmp_path):
    with pytest.raises(mpsim.InputError, match=r"a table of times must .*Use 'times\.csv'\."):
        report.to_csv(tmp_path / "times.parquet")
    with pytest.raises(mpsim.errors.OutputError, match="a table of times must be a file that can be written; got "):
        report.to_csv(tmp_path / "none" / "times.csv")
