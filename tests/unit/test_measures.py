"""Measures gathered along a run, and the exact solver behind the same door as the others."""

import numpy as np
import pytest
from support.compare import assert_same_bits
from support.scenes import gas, simulate

import mpsim

COUNTED = ["pressure", "pressure_virial", "collision_rate", "overlap", "largest_overlap"]
SAMPLED = ["kinetic_energy", "temperature", "speed_kurtosis"]


@pytest.mark.parametrize("method", ["naive", "grid", "parallel", "event"])
def test_gathering_changes_no_bit(method):
    scene = gas(300, 0.4)
    with simulate(scene, method=method, workers=2) as plain, simulate(scene, method=method, workers=2) as measured:
        plain.run(frames=200)
        report = measured.run(frames=120, measures=COUNTED + SAMPLED)
        measured.run(frames=80)
        assert_same_bits(measured.state, plain.state, f"{method} with measures")
    assert list(report.measures) == COUNTED + SAMPLED
    assert report.measures["temperature"].value == pytest.approx(1)


def test_measures_do_not_depend_on_the_workers():
    values = set()
    for workers in (1, 2, 3):
        with simulate(gas(2000, 0.5), method="parallel", workers=workers) as sim:
            report = sim.run(frames=100, measures=COUNTED)
        values.add(tuple(report.measures[name].value for name in COUNTED))
    assert len(values) == 1


def test_walls_and_virial_agree_for_the_exact_solver():
    with simulate(gas(100, 0.3), method="event", dt=1.0) as sim:
        sim.run(frames=50)
        measures = sim.run(frames=3000, measures=["pressure", "pressure_virial"]).measures
    walls, virial = measures["pressure"], measures["pressure_virial"]
    assert abs(walls.value - virial.value) < 4 * walls.error


def test_an_unknown_measure_is_refused_with_a_suggestion():
    with simulate(gas(10, 0.2), method="grid") as sim, pytest.raises(mpsim.InputError, match="Did you mean 'pressure'"):
        sim.run(frames=1, measures=["presure"])


def test_a_measure_that_was_not_recorded_says_how_to_record_it():
    with simulate(gas(10, 0.2), method="grid") as sim:
        report = sim.run(frames=1)
    with pytest.raises(mpsim.NotRecordedError, match=r"pressure was not recorded.*measures=\['pressure'\]"):
        report.measures["pressure"]


def test_the_virial_is_refused_under_gravity():
    scene = gas(10, 0.2, gravity=(0, -1))
    with simulate(scene, method="grid") as sim, pytest.raises(mpsim.InputError, match="gravity"):
        sim.run(frames=1, measures=["pressure_virial"])


@pytest.mark.parametrize(
    ("features", "settings", "word"),
    [
        ({}, {"law": "reflect"}, "reflect"),
        ({}, {"precision": "float32"}, "float32"),
        ({"acceleration": np.ones((10, 2))}, {}, "acceleration per disc"),
    ],
)
def test_what_cannot_be_exact_is_refused_by_name(features, settings, word):
    with pytest.raises(mpsim.InputError, match=word):
        simulate(
            gas(10, 0.2) if not features else mpsim.Scene.random(count=10, packing=0.2, radius=0.5, **features),
            method="event",
            **settings,
        )


def test_an_overlapping_start_of_the_exact_solver_names_the_worst_pair():
    position = [[1, 1], [1.9, 1], [5, 5], [5.5, 5]]
    scene = mpsim.Scene(width=8, height=8, position=position, velocity=np.zeros((4, 2)), radius=0.5)
    with pytest.raises(mpsim.InputError, match=r"discs 2 and 3 overlap by 0\.5"):
        simulate(scene, method="event")


def test_stopping_and_growing_the_exact_solver():
    scene = gas(50, 0.2)
    with simulate(scene, method="event") as whole, simulate(scene, method="event") as cut:
        whole.run(frames=300)
        for frames in (1, 2, 97, 200):
            cut.run(frames=frames)
        assert_same_bits(cut.state, whole.state, "cut into four runs")
        assert cut.time == whole.time == pytest.approx(3)
        before = cut.state.position[0]
        with pytest.raises(mpsim.InputError, match="overlap"):
            cut.add(before, [0, 0])
        assert cut.count == 50
        cut.run(frames=10)
        cut_again = cut.digest()
        whole.run(frames=10)
        assert whole.digest() == cut_again


def test_a_loss_of_energy_that_would_never_end_is_guarded_and_said():
    position = [[0.5 + k, 0.5] for k in range(3)]
    position[0][0], position[2][0] = 0.5, 5.0
    position[1][0] = 2.5
    scene = mpsim.Scene(
        width=6, height=1.5, position=position, velocity=[[1, 0], [0, 0], [-1, 0]], radius=0.5, restitution=0.02
    )
    with simulate(scene, method="event", dt=1.0) as sim, pytest.warns(mpsim.GuardWarning, match="guard"):
        report = sim.run(frames=20)
    assert report.guarded > 0
