"""The trade: what each candidate costs and how wrong it is, as a table that can be trusted and reproduced."""

import csv
import io
import json
import re
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest
from support.processes import assert_clean, run_script
from support.scenes import gas
from support.selection import long_but

import mpsim
from mpsim import Scene, Settings, tradeoff
from mpsim.measure.registry import ERRORS
from mpsim.studies import cost, ensemble, preliminary

COARSE, FINE = Settings(dt=0.1, method="grid"), Settings(dt=0.02, method="grid")
PUSH = Settings(dt=0.05, method="grid", contact="push")
REFLECT = Settings(dt=0.05, method="grid", contact="push", law="reflect")
EXACT = Settings(method="event")
CANDIDATES = [COARSE, FINE, PUSH, REFLECT, EXACT]


@pytest.fixture(scope="module")
def table():
    return tradeoff(gas(40, 0.3), CANDIDATES, until=30, replicas=4)


def errors_of(table):
    return [row.errors for row in table.rows]


# What a table holds


def test_there_is_a_row_per_candidate_in_their_order_with_a_cost_and_every_error(table):
    assert [row.settings for row in table.rows] == CANDIDATES
    assert table.measures == ERRORS
    assert table.reference == "the exact solver"
    for row in table.rows:
        assert tuple(row.errors) == ERRORS
        assert 0 < row.cost.low <= row.cost.median <= row.cost.high
        assert row.cost.memory > 0
        assert (row.cost.method, row.cost.workers) == (row.settings.method, 1)


def test_a_longer_step_is_cheaper_and_more_wrong(table):
    coarse, fine = table.rows[:2]
    assert coarse.cost.median < fine.cost.median / 2
    for name in ("overlap", "largest_overlap", "trajectory"):
        assert coarse.errors[name].value > 2 * fine.errors[name].value, name
    assert coarse.errors["overlap"].resolved
    assert fine.errors["overlap"].resolved


def test_the_exact_solver_differs_from_itself_by_nothing(table):
    exact, reflect = table.rows[-1].errors, table.rows[3].errors
    assert [name for name, each in exact.items() if abs(each.value) > 1e-12] == []
    wrong = [name for name, each in reflect.items() if each.resolved]
    assert {"momentum_drift", "overlap", "trajectory"} <= set(wrong), "the control: a wrong law is seen to be wrong"


def test_momentum_is_kept_to_rounding_but_by_reflect(table):
    drifts = [row.errors["momentum_drift"].value for row in table.rows]
    assert max(drifts[:3] + drifts[4:]) < 1e-9
    assert drifts[3] > 1e-3, "the control"


def test_a_pressure_is_the_difference_of_averages_that_can_be_run_again(quick):
    """By hand: start 0 is the scene as it is, the others are `another`, run to `until`; so are the reference's."""
    scene = gas(10, 0.3)
    (row,) = tradeoff(scene, [PUSH], until=60, measures=["pressure"], replicas=2).rows
    values = []
    for settings, count in ((PUSH, 2), (Settings(method="event", dt=0.1), 4)):
        found = []
        for start in [scene, *map(scene.redrawn, range(1, count))]:
            with mpsim.Simulation(start, settings) as sim:
                found.append(sim.run(until=60, measures=["pressure"]).measures["pressure"].value)
        values.append(np.mean(found))
    assert row.errors["pressure"].value == pytest.approx(values[0] / values[1] - 1, rel=0.02)
    assert row.errors["pressure"].span == (0.0, 1.0)


# Reproducible, wherever it runs


@pytest.mark.slow
def test_a_row_alone_is_the_row_among_others(quick):
    scene, chosen = gas(20, 0.3), [COARSE, PUSH, EXACT]
    together = tradeoff(scene, chosen, until=10, replicas=2)
    turned = tradeoff(scene, chosen[::-1], until=10, replicas=2)
    assert errors_of(turned) == errors_of(together)[::-1]
    for index, settings in enumerate(chosen):
        assert errors_of(tradeoff(scene, settings, until=10, replicas=2)) == [together.rows[index].errors]
    other = tradeoff(scene, COARSE, until=11, replicas=2)
    assert errors_of(other) != [together.rows[0].errors], "the control: another length is another row"


def test_settings_that_change_speed_alone_share_their_errors(quick):
    scene = gas(20, 0.3)
    one, two, naive = tradeoff(
        scene,
        [COARSE, Settings(dt=0.1, method="parallel", workers=2), Settings(dt=0.1, method="naive")],
        until=10,
        replicas=2,
    ).rows
    assert one.errors == two.errors != naive.errors


@pytest.mark.slow
@pytest.mark.parametrize("elsewhere", long_but(["processes", "dask"], "processes"))
def test_any_executor_gives_the_errors_of_threads_to_the_bit(elsewhere, request, quick):
    executor = request.getfixturevalue(elsewhere)
    arguments = (gas(20, 0.3, gravity=(0, -0.5)), [COARSE, REFLECT], 10)
    there = tradeoff(*arguments, replicas=2, executor=executor)
    assert errors_of(there) == errors_of(tradeoff(*arguments, replicas=2))


ON_RANKS = """
import json, os
from dataclasses import astuple
from mpi4py.futures import MPIPoolExecutor
from mpsim import Settings, tradeoff
from mpsim.studies import cost
from support.scenes import gas

made = {"median": 2.0, "low": 1.0, "high": 3.0, "memory": 100.0, "method": "grid", "workers": 1}
cost.measure = lambda *_: dict(made)

if __name__ == "__main__":
    candidates = [Settings(dt=0.1, method="grid"), Settings(dt=0.05, method="grid", contact="push", law="reflect")]
    with MPIPoolExecutor() as executor:
        submitted, submit = [], executor.submit
        executor.submit = lambda *task: submitted.append(task) or submit(*task)
        there = tradeoff(gas(20, 0.3, gravity=(0, -0.5)), candidates, 10, replicas=2, executor=executor)
        assert len(submitted) >= 4, "its runs were handed over"
        assert executor.submit(os.getpid).result() != os.getpid()
    print(json.dumps([{name: str(astuple(each)) for name, each in row.errors.items()} for row in there.rows]))
"""


@pytest.mark.slow
def test_ranks_of_mpi_give_the_errors_of_threads_to_the_bit(quick):
    mpiexec = str(Path(sys.executable).with_name("mpiexec"))
    outcome = run_script(ON_RANKS, prefix=(mpiexec, "-n", "2"), flags=("-W", "error", "-m", "mpi4py.futures"))
    assert_clean(outcome)
    here = tradeoff(gas(20, 0.3, gravity=(0, -0.5)), [COARSE, REFLECT], 10, replicas=2)
    exact = [{name: str(astuple(each)) for name, each in errors.items()} for errors in errors_of(here)]
    assert json.loads(outcome.out) == exact


class Recording(ThreadPoolExecutor):
    """An executor that knows how many of its tasks are running."""

    def __init__(self):
        super().__init__(2)
        self.running, self.most, self.tasks, self.lock = 0, 0, 0, threading.Lock()

    def submit(self, task, /, *arguments):
        return super().submit(self.counted, task, *arguments)

    def counted(self, task, *arguments):
        with self.lock:
            self.running, self.tasks = self.running + 1, self.tasks + 1
            self.most = max(self.most, self.running)
        try:
            return task(*arguments)
        finally:
            with self.lock:
                self.running -= 1


def test_costs_are_measured_alone_one_after_the_other_here_when_all_accuracy_runs_are_over(monkeypatch):
    timings, inside, measure = [], [], cost.measure

    def watched(scene, settings, until, whole):
        inside.append(settings)
        timings.append((executor.running, len(inside), threading.current_thread(), settings))
        try:
            return measure(scene, settings, until, whole)
        finally:
            inside.pop()

    monkeypatch.setattr(cost, "measure", watched)
    with Recording() as executor:
        table = tradeoff(gas(20, 0.3), [COARSE, PUSH, EXACT], until=5, replicas=3, executor=executor)
    assert timings == [(0, 1, threading.main_thread(), each) for each in (COARSE, PUSH, EXACT)]
    assert executor.tasks == 2 * 3 + 2 * 3 + 3 * 8, "the reference's runs (of which EXACT's are some), two candidates'"
    assert all(not each.measurable or each.exact for each in table.rows[2].errors.values()), "and EXACT errs nowhere"
    assert executor.most == 2, "the control: accuracy runs do overlap"


def test_no_thread_is_left(quick):
    before = threading.active_count()
    tradeoff(gas(20, 0.3), [COARSE], until=5, replicas=2)
    assert threading.active_count() == before


def test_progress_is_told_what_is_done(quick):
    told = []
    tradeoff(gas(20, 0.3), [COARSE], until=5, replicas=2, measures="pressure", progress=lambda *it: told.append(it))
    runs = [(done, 6, "accuracy") for done in range(1, 7)]
    assert told == [(0, 1, "preliminary run"), *runs, (1, 1, "timing")]


# Scenes of every kind


def lone(velocity, **features):
    return Scene(width=5, height=5, position=[[2, 2]], velocity=[velocity], radius=0.5, **features)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "reference"),
    [
        (lone([1, 0.3]), "the exact solver"),
        (lone([0, 0], gravity=(0, -1)), "the exact solver"),
        (gas(20, 0.3, restitution=0.9, wall_restitution=0.8), "the exact solver"),
        (gas(20, 0.3, gravity=(0.5, -1)), "the exact solver"),
        (gas(20, 0.3, acceleration=((0.0, -1.0),) * 20), "two passes at dt=.*is not usable: .*acceleration per disc"),
        (
            Scene(width=5, height=5, position=[[2, 2], [2.5, 2]], velocity=[[0, 0], [1, 1]], radius=0.5),
            "two passes at dt=.*finest affordable.*is not usable: .*discs 0 and 1 overlap",
        ),
    ],
    ids=["one disc", "one that falls", "lossy", "gravity", "acceleration", "overlapping"],
)
def test_every_scene_has_a_table_and_says_what_it_is_compared_with(scene, reference, quick):
    found = tradeoff(scene, [COARSE], until=4, replicas=2)
    assert found.rows[0].failure is None
    assert all(np.isfinite(each.value) == each.measurable for each in found.rows[0].errors.values())
    assert any(each.measurable for each in found.rows[0].errors.values())
    assert re.match(reference, found.reference), found.reference
    assert found.reference in str(found).replace("\n", " ")


@pytest.mark.parametrize("scene", [Scene(width=2, height=2, position=[], velocity=[], radius=0.5), lone([0, 0])])
def test_a_scene_in_which_nothing_moves_is_refused(scene):
    with pytest.raises(mpsim.InputError, match=r"something moves; got <Scene: . discs?"):
        tradeoff(scene, [COARSE])


def test_a_scene_that_the_exact_solver_is_too_slow_for_is_compared_with_the_finest_run(quick, monkeypatch):
    look = preliminary._observe

    def slow(scene, settings, *rest):
        if settings.method == "event":
            preliminary._time_limit(-1.0)(0, 1)
        return look(scene, settings, *rest)

    monkeypatch.setattr(preliminary, "_observe", slow)
    found = tradeoff(gas(20, 0.3), [COARSE], until=2, replicas=2)
    assert re.match(
        "two passes at dt=.*, the finest affordable run, because the exact solver is not usable: its", found.reference
    )
    monkeypatch.setattr(preliminary, "STEPPED_SECONDS", -1.0)
    with pytest.raises(mpsim.InputError, match=r"preliminary run takes less than -1 s.*Take a smaller scene"):
        tradeoff(gas(20, 0.3), [COARSE], until=2)


@pytest.mark.long
@pytest.mark.timeout(900)
def test_a_hundred_thousand_discs_take_minutes_at_most():
    started = time.process_time()
    found = tradeoff(mpsim.Scene.random(count=100_000, packing=0.3, radius=0.5), [COARSE, FINE], replicas=4)
    assert [row.failure for row in found.rows] == [None, None]
    assert time.process_time() - started < 240, "seconds of all threads together"


# What goes wrong


@pytest.mark.slow
def test_a_candidate_that_blows_up_is_a_row_with_its_reason(quick):
    bad = Settings(dt=4e18, method="grid", precision="float32")
    found = tradeoff(gas(20, 0.3, gravity=(0, -10)), [bad, COARSE], until=2, replicas=2)
    failed, good = found.rows
    assert failed.failure.startswith("DivergedError: disc 0 is not finite in frame 0")
    assert (failed.cost, failed.errors) == (None, {})
    assert good.failure is None
    assert "failed: DivergedError" in str(found)
    assert "failed: DivergedError" in found._repr_html_()
    assert found.frontier("pressure") == [good]
    assert next(csv.DictReader(io.StringIO(found.to_csv())))["failure"] == failed.failure


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"measures": ["presure"]}, "measures must be one of .*got 'presure'. Did you mean 'pressure'"),
        ({"measures": []}, "measures must name at least one"),
        ({"measures": 5}, "measures must be a list of names of errors; got 5"),
        ({"candidates": []}, "candidates must hold at least one Settings"),
        ({"candidates": 5}, "candidates must be a list of mpsim.Settings; got 5"),
        ({"candidates": [COARSE, "grid"]}, r"candidates\[1\] must be an mpsim.Settings; got str"),
        ({"until": 0}, "until must be a finite number > 0"),
        ({"until": float("nan")}, "until must be a finite number > 0"),
        ({"replicas": 1}, "replicas must be a whole number from 2"),
        ({"executor": "processes"}, "executor must be a concurrent.futures.Executor; got str"),
        ({"scene": "gas"}, "scene must be an mpsim.Scene; got str"),
        ({"path": "/nowhere/at/all.json"}, "path must be a file in a folder that can be written to"),
    ],
)
def test_bad_input_is_refused_by_name(arguments, text, quick):
    with pytest.raises(mpsim.InputError, match=text):
        tradeoff(**({"scene": gas(20, 0.3), "candidates": [COARSE], "until": 1.0} | arguments))


@pytest.mark.slow
def test_a_candidate_that_the_scene_cannot_be_run_with_is_named(quick):
    scene = gas(20, 0.3, acceleration=((0.0, -1.0),) * 20)
    with pytest.raises(mpsim.InputError, match=r"candidates\[1\] \(event\) cannot run this scene: .*acceleration"):
        tradeoff(scene, [COARSE, EXACT], until=1)


# What is written and kept


def test_csv_and_json_are_written_where_asked(tmp_path, table):
    (tmp_path / "t.csv").write_text("old")
    assert table.to_csv(tmp_path / "t.csv") == (tmp_path / "t.csv").read_text()
    assert table.to_json(str(tmp_path / "t.json")) == (tmp_path / "t.json").read_text()
    assert tuple(table.to_csv().splitlines()[0].split(",")) == table.columns


def test_what_the_machine_failed_at_is_tried_again_and_what_the_candidate_failed_at_is_not(
    tmp_path, quick, monkeypatch
):
    scene, path = gas(20, 0.3), tmp_path / "kept.json"
    run = ensemble.long_run
    monkeypatch.setattr(ensemble, "long_run", lambda *_: {"failure": "MemoryError: none", "machine": True})
    assert tradeoff(scene, [COARSE], until=2, replicas=2, path=path, measures="pressure").rows[0].failure
    monkeypatch.setattr(ensemble, "long_run", run)
    assert tradeoff(scene, [COARSE], until=2, replicas=2, path=path, measures="pressure").rows[0].failure is None


def test_the_table_goes_to_pandas_and_xarray(table):
    frame, data = table.to_pandas(), table.to_xarray()
    assert tuple(frame.columns) == table.columns
    assert frame["dt"].tolist() == [row.settings.dt for row in table.rows] == data["dt"].to_numpy().tolist()
    assert data.sizes == {"candidate": len(table.rows)}
