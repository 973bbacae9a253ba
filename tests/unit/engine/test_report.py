"""Report: shapes and sums of the times, counts, and what ran."""

import csv
import re
import sys

import numpy as np
import pandas
import pytest
from support.scenes import crowd, gas, simulate

import mpsim
from mpsim.engine import coordinator
from mpsim.kernels.layout import PHASES
from mpsim.measure.run_averages import Measures

LAYOUTS = [("naive", 1), ("grid", 1), ("parallel", 1), ("parallel", 3)]


@pytest.mark.parametrize(("method", "workers"), LAYOUTS)
def test_times_have_the_documented_shapes_and_add_up(method, workers):
    frames = 5000
    with simulate(gas(100, 0.4), method=method, workers=workers) as sim:
        report = sim.run(frames=frames // (10 if workers > 1 else 1))
    frames = report.frames
    assert (report.method, report.workers) == (method, workers)
    assert report.frame_seconds.shape == (frames,)
    assert report.frame_seconds.dtype == np.float64
    assert set(report.phase_seconds) == set(PHASES)
    for name, seconds in report.phase_seconds.items():
        assert seconds.shape == (frames, workers), name
        assert (seconds >= 0).all(), name
    total = sum(report.phase_seconds.values())
    assert np.allclose(total[:, 0], report.frame_seconds)
    assert total.sum(axis=0) == pytest.approx(report.frame_seconds.sum(), rel=0.5), "workers share the frame's time"
    if workers == 1:
        assert not report.phase_seconds["wait"].any(), "one worker waits for nobody"


@pytest.mark.parametrize(("method", "workers"), LAYOUTS)
def test_a_report_counts_the_contacts_of_its_own_run(method, workers):
    with simulate(crowd(100, 0.8, seed=1), method=method, workers=workers) as sim:
        parts = [sim.run(frames=frames).collisions for frames in (1, 0, 5, 14)]
    with simulate(crowd(100, 0.8, seed=1), method=method, workers=workers) as sim:
        assert sim.run(frames=20).collisions == sum(parts) > 100
    assert parts[1] == 0


def test_frame_times_are_wall_times():
    import time  # noqa: PLC0415

    with simulate(gas(3000, 0.4), method="grid") as sim:
        sim.run(frames=10)
        start = time.perf_counter()
        report = sim.run(frames=200)
        took = time.perf_counter() - start
    assert 0.5 * took < report.frame_seconds.sum() <= took


def test_the_memory_of_each_process_and_of_the_block_is_reported():
    with simulate(gas(1000, 0.4), method="parallel", workers=3) as sim:
        report = sim.run(frames=5)
    assert len(report.memory_bytes) == 3
    assert min(report.memory_bytes) > 10**6
    assert report.block_bytes > 1000 * 2 * 4 * 8


def test_a_million_float32_discs_need_at_most_100_bytes_each():
    from mpsim.engine.workers.arrays import block_arrays, grid_for  # noqa: PLC0415

    grid = grid_for(10**6, 1401, 1401, 1.0, "float32")
    arrays = block_arrays(10**6, grid, 2, "float32", {}, False)
    assert sum(spec.nbytes for spec in arrays.values()) <= 100 * 10**6


def test_no_frames_make_an_empty_report():
    with simulate(gas(20, 0.2), method="grid") as sim:
        report = sim.run(frames=0)
    assert (report.frames, report.collisions, report.frame_seconds.shape) == (0, 0, (0,))
    assert repr(report) == "<Report: 0 frames by grid>"


def test_the_text_of_a_report_and_of_a_simulation_say_what_ran():
    with simulate(gas(1000, 0.3), method="parallel", workers=2, dt=0.5) as sim:
        report = sim.run(frames=3)
        assert repr(sim) == "<Simulation: 1000 discs by parallel, frame 3, time 1.5>"
    assert repr(report).startswith("<Report: 3 frames by parallel on 2 workers, median ")


def test_the_text_of_a_report_has_its_measures_with_their_errors():
    with simulate(gas(20, 0.2), method="grid") as sim:
        report = sim.run(frames=400, measures=["collision_rate"])
    assert repr(report) == f"<Report: {report.summary}, collision_rate {report.measures['collision_rate']!r}>"
    assert re.search(r"collision_rate \d+\.\d+\([<>]?\d+\)>$", repr(report))


def test_a_report_tells_how_long_kernels_were_compiled_before_it(monkeypatch):
    """Since the simulation was made, or since its last report; nothing where all kernels were there."""
    with simulate(gas(20, 0.2), method="grid") as sim:
        sim.run(frames=1)
    monkeypatch.setattr(coordinator, "compile_seconds", lambda: 100.0)
    with simulate(gas(20, 0.2), method="grid") as sim:
        monkeypatch.setattr(coordinator, "compile_seconds", lambda: 112.25)
        first, second = sim.run(frames=3), sim.run(frames=3)
    assert (first.compile_seconds, second.compile_seconds) == (12.25, 0.0)
    assert "us a frame, 12.2 s of compiling before, " in repr(first)
    assert "compiling" not in repr(second)


def test_kernels_that_are_there_cost_no_time():
    with simulate(gas(20, 0.2), method="grid") as sim:
        sim.run(frames=1)
    with simulate(gas(20, 0.2), method="grid") as sim:
        assert sim.run(frames=1).compile_seconds == 0.0


def test_auto_reports_what_it_chose():
    for count, methods in ((50, {"naive"}), (190, {"grid"}), (5000, {"grid", "parallel"})):
        with mpsim.Simulation(gas(count, 0.3), mpsim.Settings(workers=2)) as sim:
            report = sim.run(frames=60)
        assert report.method in methods
        assert (report.workers > 1) == (report.method == "parallel")


@pytest.mark.parametrize("method", ["grid", "parallel", "auto"])
def test_discs_may_be_added_while_progress_is_reported(method):
    """`auto` goes from one process to several on the way, so that the number of workers changes during the run."""
    place = np.stack(np.divmod(np.arange(900), 30), axis=1) * 1.5 + 1
    scene = mpsim.Scene(width=46, height=46, position=place[:150], velocity=np.ones((150, 2)), radius=0.5)

    def add(done, of):
        if sim.count < 900:
            sim.add(place[sim.count : sim.count + 150], np.zeros((150, 2)))

    with simulate(scene, method=method, workers=2) as sim:
        report = sim.run(frames=20_000 if method == "auto" else 5_000, progress=add)
        assert sim.count > 500
    assert report.frame_seconds.shape == (report.frames,)
    assert {seconds.shape for seconds in report.phase_seconds.values()} <= {(report.frames, 1), (report.frames, 2)}


def test_more_frames_than_fit_the_block_are_all_timed():
    from mpsim.engine.workers.arrays import MOST_FRAMES  # noqa: PLC0415

    with simulate(gas(5, 0.1), method="naive") as sim:
        report = sim.run(frames=3 * MOST_FRAMES + 1)
    assert report.frames == 3 * MOST_FRAMES + 1
    assert (report.frame_seconds > 0).mean() > 0.99


def test_one_frame_one_disc_and_one_collision_are_no_plurals(tmp_path):
    facing = mpsim.Scene(width=4, height=4, position=[(1, 2), (3, 2)], velocity=[(1, 0), (-1, 0)], radius=0.5)
    with simulate(facing, method="naive", dt=0.55) as sim:
        report = sim.run(frames=1)
    assert report.summary.startswith("1 frame by naive, median ")
    assert report.summary.endswith(" 1 collision")


def test_times_as_csv_are_those_of_the_report(tmp_path):
    with simulate(gas(200, 0.4), method="parallel", workers=2) as sim:
        report = sim.run(frames=7)
    text = report.to_csv(tmp_path / "times.csv", first_frame=11)
    assert (tmp_path / "times.csv").read_text() == text
    rows = list(csv.DictReader(text.splitlines()))
    assert [row["frame"] for row in rows] == [str(frame) for frame in range(11, 18)]
    assert [float(row["seconds"]) for row in rows] == report.frame_seconds.tolist()
    for name, seconds in report.phase_seconds.items():
        for worker in (0, 1):
            column = [float(row[f"{name.replace(' ', '_')}_{worker}"]) for row in rows]
            assert column == seconds[:, worker].tolist()
    with pytest.raises(mpsim.errors.OutputError, match="a table of times must be a file that can be written; got "):
        report.to_csv(tmp_path / "none" / "times.csv")


def test_times_as_parquet_are_those_of_csv(tmp_path):
    with simulate(gas(20, 0.2), method="grid") as sim:
        report = sim.run(frames=7, measures=["temperature"])
    report.to_parquet(tmp_path / "times.parquet")
    found = pandas.read_parquet(tmp_path / "times.parquet")
    rows = list(csv.DictReader(report.to_csv().splitlines()))
    assert list(found.columns) == list(rows[0])
    assert found.to_dict("records") == [{name: float(value) for name, value in row.items()} for row in rows]
    assert found.attrs["measures"]["temperature"]["value"] == report.measures["temperature"].value
    with pytest.raises(mpsim.InputError, match=r"a table of times must .*Use 'times\.csv', or to_parquet\."):
        report.to_csv(tmp_path / "times.parquet")
    with pytest.raises(mpsim.errors.OutputError, match="a table of times must be a file that can be written; got "):
        report.to_parquet(tmp_path / "none" / "times.parquet")


def test_waiting_is_the_part_of_the_time_at_barriers():
    phases = {name: np.full((4, 2), 1.0) for name in PHASES}
    phases["wait"] = np.full((4, 2), 6.0)
    report = mpsim.Report(np.full(4, 10.0), phases, 0, "parallel", 2, (1, 1), 1, Measures(), 0)
    assert report.waiting == 0.6


def test_measures_of_no_frames_are_unknown():
    with simulate(gas(20, 0.2), method="grid") as sim:
        measures = sim.run(frames=0, measures=["pressure", "temperature", "largest_overlap", "energy_drift"]).measures
    assert all(np.isnan(measure.value) for measure in measures.values())
    assert len(measures) == 4


def test_a_report_becomes_a_table_of_pandas(monkeypatch):
    with simulate(gas(20, 0.2)) as sim:
        report = sim.run(frames=5, measures=["temperature"])
    frame = report.to_pandas()
    assert frame.index.tolist() == [1, 2, 3, 4, 5]
    assert frame["seconds"].tolist() == report.frame_seconds.tolist()
    assert report.to_csv().splitlines()[0].split(",") == ["frame", *frame.columns]
    assert frame.attrs["measures"]["temperature"]["value"] == report.measures["temperature"].value
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(mpsim.errors.OutputError, match=r"a DataFrame needs the package pandas.*`, or use to_csv"):
        report.to_pandas()
