"""The table of a trade-off study: what it holds, that it can be computed again, its files, and what is refused.

How errors follow from runs is in test_errors_of_averages.py.
"""

import csv
import dataclasses
import io
import itertools
import math
import re
import threading
import time
from concurrent.futures import Executor, Future, ThreadPoolExecutor

import numpy as np
import pytest
from support.campaign import COARSE, FINE, PIECES, PUSH, REFLECT, SCENE, UNTIL, Costs, MadeUp, start
from support.scenes import gas, scene_of
from support.swept import process_pool

import mpsim
from mpsim import Scene, Settings, tradeoff

EXACT = Settings(method="event")
CANDIDATES = [COARSE, FINE, PUSH, REFLECT, EXACT]
ERRORS = (
    "pressure", "collision_rate", "energy_drift", "momentum_drift", "overlap", "largest_overlap", "speed_distribution",
    "trajectory", "missed_collisions",
)  # fmt: skip

pytestmark = [pytest.mark.compiled, pytest.mark.filterwarnings("ignore::mpsim.FastWarning")]


class Here(Executor):
    """Does each task at once, in the thread that asks for it, and keeps it with its result."""

    def __init__(self):
        self.done = []

    def submit(self, task, /, *arguments):
        future = Future()
        future.set_result(task(*arguments))
        self.done.append((arguments, future.result()))
        return future


@pytest.fixture(scope="module", autouse=True)
def quick_clock():
    """A clock that is quick to read on any machine, of which studies ask after every frame."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(time, "thread_time", time.perf_counter)
        yield


@pytest.fixture(scope="module")
def studied():
    """A table, and the arguments and results of its runs."""
    here = Here()
    return tradeoff(gas(20, 0.5), CANDIDATES, until=4, replicas=2, executor=here), here.done


@pytest.fixture(scope="module")
def table(studied):
    return studied[0]


@pytest.fixture(scope="module")
def costs(tmp_path_factory):
    return Costs(tmp_path_factory.mktemp("costs"))


def errors_of(table):
    return [row.errors for row in table.rows]


def overlapping(settings, number):
    """Overlaps that grow with the step."""
    return {"overlap": np.full(PIECES, settings.dt * (1 + 1e-3 * (number % 5)))}


# --- what it holds


def test_there_is_a_row_per_candidate_in_their_order_with_a_cost_and_every_error(table):
    assert [row.settings for row in table.rows] == CANDIDATES
    assert set(table.measures) == set(ERRORS)
    assert (table.reference, table.until, table.contact_time) == ("the exact solver", 4, None)
    for row in table.rows:
        assert tuple(row.errors) == table.measures
        assert 0 < row.cost.low <= row.cost.median <= row.cost.high
        assert row.cost.memory > 0
        assert (row.cost.method, row.cost.workers) == (row.settings.method, 1)
    coarse, fine = table.rows[:2]
    for name in ("overlap", "trajectory"):
        assert coarse.errors[name].value > 2 * fine.errors[name].value, name


def test_the_exact_solver_differs_from_itself_by_nothing(table):
    exact, reflect = table.rows[-1].errors, table.rows[3].errors
    assert [name for name, each in exact.items() if abs(each.value) > 1e-12] == []
    wrong = [name for name, each in reflect.items() if each.resolved]
    assert "trajectory" in wrong, "the control: a wrong law is seen to be wrong"
    with pytest.raises(mpsim.InputError, match="measure must be one of 'pressure', "):
        table.frontier("presure")
    drifts = [row.errors["momentum_drift"].value for row in table.rows]
    assert max(drifts[:3] + drifts[4:]) < 1e-9
    assert drifts[3] > 1e-3


def test_a_pressure_is_the_difference_of_averages_that_can_be_run_again(table):
    """By hand: start 0 is the scene as it is, the others are drawn again; the reference has twice as many."""
    values, scene = [], gas(20, 0.5)
    for settings, count in ((PUSH, 2), (dataclasses.replace(EXACT, dt=0.1), 4)):
        found = []
        for each in [scene, *map(scene.redrawn, range(1, count))]:
            with mpsim.Simulation(each, settings) as sim:
                found.append(sim.run(until=4, measures=["pressure"]).measures["pressure"].value)
        values.append(np.mean(found))
    assert table.rows[2].errors["pressure"].value == pytest.approx(values[0] / values[1] - 1, rel=1e-9)
    assert table.rows[2].errors["pressure"].span == (0.0, 1.0)
    assert table.starts == "other starts of the same kind"


def test_trajectories_are_compared_from_states_along_a_run(studied):
    """By hand: positions after the short time against those of the exact solver, in diameters."""
    table, done = studied
    settings, distances, missed, total = COARSE, [], [], 0
    starts = [each for (_, chosen, *rest), _ in done if chosen == settings for each in rest
              if isinstance(each, tuple) and isinstance(each[0], mpsim.State)]  # fmt: skip
    frames = round(table.short / settings.dt)
    for each in starts:
        scene, states, met = gas(20, 0.5).starting_from(*each), [], []
        for way, count in ((settings, frames), (Settings(method="event", dt=frames * settings.dt), 1)):
            with mpsim.Simulation(scene, way) as sim:
                met.append(sim.run(frames=count).collisions)
                states.append(sim.state)
        distances.append(mpsim.measure.trajectory_error(*states, scene).rms)
        missed.append(met[1] - met[0])
        total += met[1]
    errors = table.rows[0].errors
    assert len(starts) >= 4
    assert errors["trajectory"].value == pytest.approx(np.mean(distances), rel=1e-9)
    assert errors["trajectory"].error == pytest.approx(np.std(distances, ddof=1) / math.sqrt(len(starts)), rel=1e-9)
    assert errors["missed_collisions"].value == pytest.approx(sum(missed) / total, rel=1e-9)


@pytest.mark.long
def test_short_runs_begin_where_what_moves_is_at_their_time():
    piston = mpsim.Piston("right", start=18.0, motion=mpsim.Oscillation((1.0, 0.0), period=5.0))
    scene = Scene.random(count=20, width=20, height=20, radius=0.5, inside=(0.5, 0.5, 15, 19.5), piston=piston)
    table = tradeoff(scene, [Settings(dt=0.02, method="naive")], until=4, replicas=2, measures=["trajectory"])
    assert table.rows[0].failure is None
    assert table.rows[0].errors["trajectory"].value < 0.1


def test_the_default_candidates_have_each_contact_law_precision_and_method(costs, tmp_path):
    dts = (0.2, 0.1, 0.05, 0.02, 0.01)
    words = ("naive", "grid", "parallel", "auto"), ("elastic", "reflect"), ("impact", "push"), (1, 2), (1, 2)
    every = [
        Settings(method=method, law=law, contact=contact, passes=passes, substeps=substeps, dt=dt, precision=precision)
        for method, law, contact, passes, substeps in itertools.product(*words)
        for dt in dts
        for precision in ("float32", "float64")
    ]
    path = costs.write(tmp_path / "kept.json", [EXACT, *every], lambda settings: 1 / settings.dt)
    found = tradeoff(SCENE, measures="overlap", executor=MadeUp(overlapping), path=path, replicas=2, **costs.how)
    chosen = [row.settings for row in found.rows]
    assert len(set(chosen)) == len(chosen) >= 20
    assert {each.method for each in chosen} == {"event", "naive", "grid", "parallel", "auto"}
    for name, values in (("contact", {"push", "impact"}), ("law", {"elastic", "reflect"}), ("passes", {1, 2}),
                         ("precision", {"float32", "float64"})):  # fmt: skip
        assert {getattr(each, name) for each in chosen} == values
    assert found.rows[0].label == "event"
    assert "auto impact float32 dt=0.05" in {row.label for row in found.rows}


# --- the same wherever it runs


def test_a_row_alone_is_the_row_among_others_and_threads_give_the_same_to_the_bit(tmp_path):
    costs = Costs(tmp_path, until=1.0)

    def study(candidates, name, **how):
        path = costs.write(tmp_path / name, [COARSE, PUSH], lambda settings: 1 / settings.dt)
        return errors_of(
            tradeoff(SCENE, candidates, measures=["overlap", "trajectory"], path=path, replicas=2, **costs.how | how)
        )

    threads = threading.active_count()
    together = study([COARSE, PUSH], "a")
    assert threading.active_count() == threads, "none is left"
    assert study(PUSH, "b", executor=Here()) == together[1:] != together[:1]


@pytest.mark.slow
def test_processes_give_the_errors_of_threads_to_the_bit():
    with process_pool(2) as executor:
        there = tradeoff(gas(20, 0.3), [COARSE, REFLECT], 10, replicas=2, executor=executor)
    assert errors_of(there) == errors_of(tradeoff(gas(20, 0.3), [COARSE, REFLECT], 10, replicas=2))


def test_settings_that_change_speed_alone_share_their_runs(costs, tmp_path):
    candidates = [COARSE, Settings(dt=0.1, method="parallel", workers=2), Settings(dt=0.1, method="naive")]
    path = costs.write(tmp_path / "kept.json", candidates, lambda settings: 1 / settings.dt)
    made = MadeUp(lambda settings, number: {"overlap": 0.1 + np.random.default_rng(len(made.asked)).random(PIECES)})
    found = tradeoff(SCENE, candidates, measures="overlap", executor=made, path=path, replicas=2, **costs.how)
    one, two, naive = errors_of(found)
    assert one == two != naive
    assert len(made.asked) == 4 + 2 + 2


class Kept(ThreadPoolExecutor):
    """Keeps its tasks."""

    def submit(self, task, /, *arguments):
        self.tasks = [*getattr(self, "tasks", []), super().submit(task, *arguments)]
        return self.tasks[-1]


def test_costs_are_measured_alone_here_when_all_accuracy_runs_are_over():
    told = []

    def progress(done, of, what):
        running = sum(each.running() for each in getattr(executor, "tasks", []))
        told.append((done, of, what, running, threading.current_thread()))

    with Kept(2) as executor:
        tradeoff(SCENE, [COARSE, EXACT], until=3, replicas=2, executor=executor, progress=progress)
    assert len(executor.tasks) == 2 * 2 + 2 + 2 * 8, (
        "the reference's runs, of which EXACT's are some, and a candidate's"
    )
    assert max(each[3] for each in told) > 1, "the control: accuracy runs do overlap"
    assert told[0][:3] == (0, 1, "preliminary run")
    assert [each[:3] for each in told[1:-3]] == [(done, 22, "accuracy") for done in range(1, 23)]
    assert told[-3:] == [(done, 2, "timing", 0, threading.main_thread()) for done in range(3)]


# --- references


def too_slow(readings):
    """A clock of a thread that jumps far ahead after so many readings, and stands."""
    left = itertools.count(readings, -1)
    return lambda: 0.0 if next(left) > 0 else 1e6


def test_a_scene_that_the_exact_solver_is_too_slow_for_is_compared_with_the_finest_run(monkeypatch):
    how = {"until": 2, "measures": "overlap", "replicas": 2}
    monkeypatch.setattr(time, "thread_time", too_slow(1))
    found = tradeoff(SCENE, [COARSE], executor=MadeUp(overlapping), starts=start, **how)
    assert re.match(r"two passes at dt=\S+, the finest affordable run, because the exact solver is not usable: its pre",
                    found.reference)  # fmt: skip
    assert found.reference in str(found).replace("\n", " ")
    assert found.rows[0].errors["overlap"].systematic > 0, "its own uncertainty counts"
    ticks = itertools.count(0, 1000)
    monkeypatch.setattr(time, "thread_time", lambda: next(ticks))
    with pytest.raises(mpsim.InputError, match=r"preliminary run takes less than 20 s.*Take a smaller scene"):
        tradeoff(SCENE, [COARSE], **how)


# --- starts


def test_starts_are_of_the_kind_of_the_scene_or_the_same_ones_displaced():
    def starts_of(scene, starts=None):
        asked = []

        class Asking(MadeUp):
            def submit(self, run, scene, settings, /, *rest):
                asked.append(scene)
                return super().submit(run, scene, settings, *rest)

        law = Asking(lambda settings, number: {"overlap": np.full(PIECES, 0.1 + 0.01 * (len(asked) % 3))})
        table = tradeoff(scene, COARSE, 1.0, "overlap", starts=starts, executor=law, replicas=2)
        return table.starts, [each.digest() for each in asked[:4]]

    scene = SCENE
    name, kind = starts_of(scene)
    assert name == "other starts of the same kind"
    assert kind == [each.digest() for each in (scene, *map(scene.redrawn, (1, 2, 3)))]
    name, same = starts_of(scene, "same")
    assert name == "this start, each disc displaced by up to 0.001 of a diameter"
    assert same[0] == kind[0]
    assert len(set(same)) == 4


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ([1, 2], r"starts must be .*; got \[1, 2\]"),
        (lambda number: number, "starts must give Scenes; for 0 it gave int"),
        ("kind", "another start needs a scene that was drawn at random"),
    ],
)
def test_what_is_no_start_is_refused(given, text):
    with pytest.raises(mpsim.InputError, match=text):
        tradeoff(Scene.load("cradle"), COARSE, 1.0, starts=given)


# --- files, tables, failures


@pytest.fixture
def kept(costs, tmp_path):
    """A function that makes a study with a file, of so many discs of made-up runs; and what it asked for."""

    def study(path=None, **how):
        made = MadeUp(overlapping)
        study.asked = made.asked
        path = path or tmp_path / "kept.json"
        path.exists() or costs.write(path, [COARSE, FINE, PUSH], lambda settings: 1 / settings.dt)
        how = {"candidates": [COARSE], "measures": "overlap", "replicas": 2, **costs.how, **how}
        return tradeoff(how.pop("scene", SCENE), executor=made, path=path, **how)

    return study


def test_what_is_in_the_file_is_not_run_again(kept, tmp_path):
    first = kept()
    assert len(kept.asked) == 4 + 2
    again, more = kept(), kept(candidates=[COARSE, FINE], replicas=3)
    assert again.rows[0].record() == first.rows[0].record()
    assert {number for settings, number in kept.asked if settings == COARSE} == {2}
    assert more.rows[0].cost == first.rows[0].cost
    assert [path.name for path in tmp_path.iterdir()] == ["kept.json"]


@pytest.mark.parametrize(
    "other",
    [
        {"scene": SCENE.redrawn(1)},
        {"until": 3.0},
        {"starts": lambda number: SCENE.redrawn(number + 1)},
        {"contact_time": 0.01},
    ],
    ids=["scene", "length", "starts", "contact time"],
)
def test_a_file_of_another_study_is_refused(other, kept, tmp_path):
    kept()
    before = (tmp_path / "kept.json").read_bytes()
    with pytest.raises(mpsim.InputError, match=r"file of the same trade-off study, .*kept.json has"):
        kept(**other)
    assert (tmp_path / "kept.json").read_bytes() == before


@pytest.mark.parametrize("text", ["[]", '{"title": 1}', None])
def test_a_damaged_file_is_refused(text, kept, tmp_path):
    kept()
    path = tmp_path / "bad.json"
    head = (tmp_path / "kept.json").read_text().split("\n", 1)[0]
    path.write_text(f"{head}\n{{}}\n" if text is None else text)
    with pytest.raises(mpsim.InputError, match=r"bad.json cannot be read as one \("):
        kept(path)


def test_a_run_that_fails_is_a_row_with_its_reason_and_is_tried_again_if_it_was_the_machine(kept, costs, tmp_path):
    failing = {"failure": "DivergedError: disc 0 is not finite in frame 0"}

    def law(settings, number):
        return failing if settings == FINE else overlapping(settings, number)

    path = costs.write(tmp_path / "kept.json", [COARSE, FINE], lambda settings: 1 / settings.dt)
    how = {"measures": "overlap", "replicas": 2, "path": path, **costs.how}
    found = tradeoff(SCENE, [FINE, COARSE], executor=MadeUp(law), **how)
    failed, good = found.rows
    assert (failed.failure, failed.cost, failed.errors) == (failing["failure"], None, {})
    assert good.failure is None
    assert "failed: DivergedError" in str(found)
    assert found.frontier("overlap") == [good]
    assert next(csv.DictReader(io.StringIO(found.to_csv())))["failure"] == failed.failure
    assert kept(path, candidates=[FINE]).rows[0].failure == failed.failure, "it is in the file"
    failing |= {"failure": "MemoryError: none", "machine": True}
    path.unlink()
    costs.write(path, [COARSE, FINE], lambda settings: 1 / settings.dt)
    assert tradeoff(SCENE, [FINE], executor=MadeUp(law), **how).rows[0].failure == "MemoryError: none"
    assert kept(path, candidates=[FINE]).rows[0].failure is None


@pytest.mark.slow
def test_a_table_goes_to_pandas(table):
    frame = table.to_pandas()
    assert tuple(frame.columns) == table.columns
    assert frame["dt"].tolist() == [row.settings.dt for row in table.rows]


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"measures": ["presure"]}, "measures must be one of .*got 'presure'. Did you mean 'pressure'"),
        ({"path": "a\0b"}, "path must be a file in a folder that can be written to; got"),
        ({"candidates": []}, "candidates must hold at least one Settings"),
        ({"candidates": [COARSE, "grid"]}, r"candidates\[1\] must be an mpsim.Settings; got str"),
        ({"until": 1e12}, r"^until must be at most \S+, in which a disc flies 1e\+11 diameters; got 1e"),
        ({"replicas": 1}, "replicas must be a whole number from 2"),
        ({"scene": Scene(width=5, height=5, position=[[2, 2]], velocity=[[0, 0]], radius=0.5)}, "moves; got <Scene: 1"),
        ({"scene": Scene(width=2, height=2, position=[], velocity=[], radius=0.5)}, r"moves; got <Scene: 0 discs"),
        (
            {"scene": scene_of([], [], 9, 9, emitters=mpsim.Emitter((2, 2), (3, 2), every=5))},
            r"emitters\[0\] counts frames \(every=5\).*Use Emitter\(interval=",
        ),
    ],
)  # fmt: skip
def test_a_wrong_argument_is_refused_by_name(arguments, text):
    with pytest.raises(mpsim.InputError, match=text):
        tradeoff(**({"scene": SCENE, "candidates": [COARSE], "until": UNTIL} | arguments))
