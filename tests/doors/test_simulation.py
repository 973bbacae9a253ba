"""A simulation from its start to its end: what it takes, what `auto` chooses, how it grows, stops and closes."""

import time

import numpy as np
import pytest
from support.processes import assert_clean, run_script
from support.scenes import crowd, gas, simulate

import mpsim
from mpsim import InputError, Scene, Settings, Simulation

pytestmark = pytest.mark.compiled

METHODS = ["naive", "grid", "parallel", "event"]


USES = {
    "run": lambda sim: sim.run(frames=1),
    "state": lambda sim: sim.state,
    "add": lambda sim: sim.add([1, 1], [0, 0]),
    "set": lambda sim: sim.set(0, velocity=(0, 0)),
    "save": lambda sim: sim.save("run"),
    "count": lambda sim: sim.count,
}


@pytest.mark.parametrize("method", METHODS)
def test_a_closed_simulation_says_so_at_every_door(method):
    with simulate(gas(20, 0.2), method=method, workers=2) as sim:
        sim.run(frames=3)
    sim.close()  # a second time
    for use in USES.values():
        with pytest.raises(mpsim.errors.ClosedError, match=r"closed after frame 3.*no state.*`with` block"):
            use(sim)
    assert "closed after frame 3" in repr(sim)
    assert sim.frame == 3


@pytest.mark.parametrize("method", [*METHODS, "auto"])
def test_an_empty_scene_runs_is_saved_and_can_grow(method, tmp_path):
    box = Scene(width=5, height=5, position=np.empty((0, 2)), velocity=np.empty((0, 2)), radius=0.5)
    with simulate(box, method=method, workers=2) as sim:
        report = sim.run(frames=5)
        assert (report.frames, report.collisions, sim.state.position.shape) == (5, 0, (0, 2))
        path = sim.save(tmp_path / "run")
    with Simulation.resume(path) as sim:
        sim.add([2, 2], [1, 0])
        sim.add(np.empty((0, 2)), np.empty((0, 2)))
        sim.run(frames=100)
        assert sim.state.position[0].tolist() == pytest.approx([3, 2])


def test_auto_chooses_the_bits_by_the_number_of_discs_and_the_speed_by_the_machine():
    for count, methods in ((50, ["naive"]), (190, ["grid"]), (5000, ["grid", "parallel"])):
        scene = gas(count, 0.3)
        with Simulation(scene, Settings(workers=2)) as sim, Simulation(scene, Settings(method=methods[0])) as same:
            report = sim.run(frames=60)
            same.run(frames=60)
            assert sim.digest() == same.digest()
        assert report.method in methods
        assert (report.workers > 1) == (report.method == "parallel")
    with simulate(gas(40, 0.3), method="grid", workers=3) as sim:
        assert sim.run(frames=1).workers == 1


@pytest.mark.parametrize(("saved", "other"), [("grid", "naive"), ("event", "grid"), ("auto", "grid")])
def test_a_checkpoint_goes_on_by_a_method_with_the_same_bits_only(saved, other, tmp_path):
    with simulate(gas(30, 0.3), method=saved) as sim:
        sim.run(frames=5)
        path = sim.save(tmp_path / "run")
    with pytest.raises(InputError, match=f"{saved}.*which have the same bits; got '{other}'"):
        Simulation.resume(path, method=other)


def test_a_disc_added_inside_an_exact_frame_keeps_the_counts_of_that_frame():
    """Two discs that never meet: what both walls got in the frame is known from their speeds."""

    def stop(done, of):
        raise KeyboardInterrupt

    scene = Scene(width=5, height=5000, position=[[2, 2]], velocity=[[1, 0]], radius=0.5)
    with simulate(scene, method="event", dt=1e5) as sim:
        with pytest.raises(KeyboardInterrupt):
            sim.run(frames=1, progress=stop)
        assert 100 < sim.time < 9e4
        sim.add([2, 20], [0, 0])
        pressure = sim.run(frames=1, measures=["pressure"]).measures["pressure"].value
    assert pressure * 2 * (5 + 5000) == pytest.approx(2 / 4, rel=1e-3), "one disc to and fro in a free length of 4"


def test_discs_added_to_a_full_box_are_found():
    places = np.array([[0.5 + i // 6, 0.5 + i % 6] for i in range(36)])
    full = {"width": 6, "height": 6, "radius": 0.5, "restitution": 0.5, "wall_restitution": 0.5}
    with simulate(Scene(**full, position=places, velocity=np.zeros((36, 2))), method="grid", on_fast="error") as sim:
        sim.add([(1, 1), (3, 3), (5, 5)], np.zeros((3, 2)))
        with pytest.raises(mpsim.TooFastError, match="discs are pressed into each other: at time"):
            sim.run(frames=5000)
        assert sim.frame == 4096


# --- what a checkpoint holds


def test_a_lattice_is_a_few_numbers_in_a_checkpoint_and_a_lattice_again_when_read(tmp_path):
    scene = Scene.lattice(count=5000, packing=0.4, radius=0.5, seed=2, duration=3.0)
    with simulate(scene, method="grid") as sim:
        sim.run(frames=3)
        path, digest = sim.save(tmp_path / "run.mpsim"), sim.digest()
    with np.load(path) as file:
        assert [name for name in file.files if name.startswith("scene.")] == ["scene.radius"]
        assert (file["solver.radii"].shape, file["solver.masses"].shape) == ((), ()), "equal ones are one number"
    assert path.stat().st_size < 33 * scene.count, "the positions and velocities of now"
    with Simulation.resume(path) as sim:
        assert (sim.scene._on_lattice, sim.scene.digest()) == (scene._on_lattice, scene.digest())
        assert (sim.scene.duration, sim.digest()) == (3.0, digest)
        assert (len(sim.radii), sim.masses.sum()) == (5000, 5000)


# --- reports

LAYOUTS = [("grid", 1), ("event", 1), ("parallel", 3)]


@pytest.mark.parametrize(("method", "workers"), LAYOUTS)
def test_times_have_the_documented_shapes_and_add_up(method, workers):
    with simulate(gas(100, 0.4), method=method, workers=workers) as sim:
        sim.run(frames=10)
        start = time.perf_counter()
        report = sim.run(frames=500)
        took = time.perf_counter() - start
    assert (report.method, report.workers, report.frames) == (method, workers, 500)
    assert (report.frame_seconds.shape, report.frame_seconds.dtype) == ((500,), np.float64)
    assert 0 < report.frame_seconds.sum() <= took
    assert {"wait", "move"} <= set(report.phase_seconds)
    for name, seconds in report.phase_seconds.items():
        assert seconds.shape == (500, workers), name
        assert (seconds >= 0).all(), name
    total = sum(report.phase_seconds.values())
    assert total[:, 0] == pytest.approx(report.frame_seconds)
    assert total.sum(axis=0) == pytest.approx(report.frame_seconds.sum(), rel=0.5), "workers share the frame's time"
    waits = report.phase_seconds["wait"].sum()
    assert (waits == 0) == (workers == 1), "one worker waits for nobody"
    assert report.waiting == pytest.approx(waits / total.sum())
    assert len(report.memory_bytes) == workers
    assert min(report.memory_bytes) > 10**6
    assert report.block_bytes > 100 * 2 * 4 * 8


@pytest.mark.parametrize(("method", "workers"), LAYOUTS)
def test_a_report_counts_the_contacts_of_its_own_run(method, workers):
    scene = gas(100, 0.6) if method == "event" else crowd(100, 0.8, seed=1)
    with simulate(scene, dt=0.03, method=method, workers=workers) as sim:
        parts = [sim.run(frames=frames).collisions for frames in (1, 0, 5, 14)]
    with simulate(scene, dt=0.03, method=method, workers=workers) as sim:
        assert sim.run(frames=20).collisions == sum(parts) > 100
    assert parts[1] == 0


def test_the_texts_say_what_ran():
    with simulate(gas(1000, 0.3), method="parallel", workers=2, dt=0.5) as sim:
        report = sim.run(frames=3)
        assert repr(sim) == "<Simulation: 1000 discs by parallel, frame 3, time 1.5>"
    assert repr(report).startswith("<Report: 3 frames by parallel on 2 workers, median ")
    with simulate(gas(20, 0.2), method="grid") as sim:
        names = ["pressure", "temperature", "largest_overlap", "energy_drift"]
        measures = sim.run(frames=0, measures=names).measures
        assert [each for each in measures if np.isnan(measures[each].value)] == names, "of no frames"
        empty, report = sim.run(frames=0), sim.run(frames=400, measures=["collision_rate"])
    assert repr(empty) == "<Report: 0 frames by grid>"
    assert (empty.frames, empty.collisions, empty.frame_seconds.shape) == (0, 0, (0,))
    assert repr(report) == f"<Report: {report.summary}, collision_rate {report.measures['collision_rate']!r}>"
    facing = Scene(width=4, height=4, position=[(1, 2), (3, 2)], velocity=[(1, 0), (-1, 0)], radius=0.5)
    with simulate(facing, method="naive", dt=0.55) as sim:
        report = sim.run(frames=1)
    assert report.summary.startswith("1 frame by naive, median ")
    assert report.summary.endswith(" 1 collision")


FIRST = """
import logging, sys
logging.basicConfig(level=logging.INFO, stream=sys.stdout, format="%(levelname)s %(message)s")
import mpsim
scene = mpsim.Scene.random(count=30, packing=0.5, radius=0.5, seed=1)
with mpsim.Simulation(scene, mpsim.Settings(method="naive")) as sim:
    print(sim.run(frames=1))
    print(sim.run(frames=1).compile_seconds)
"""


@pytest.mark.long
@pytest.mark.timeout(600)
def test_a_first_run_says_what_it_compiles_and_a_second_one_nothing(tmp_path):
    first, second = (run_script(FIRST, env={"NUMBA_CACHE_DIR": str(tmp_path)}, bound=240) for _ in range(2))
    for outcome in (first, second):
        assert_clean(outcome)
    assert "INFO mpsim: compiling the loops for this scene, once; about" in first.out
    assert " s of compiling before, " in first.out
    assert first.out.endswith("0.0\n")
    assert "compiling" not in second.out
