"""Measures gathered along a run: which a scene has, and what they are."""

import numpy as np
import pytest
from support.compare import assert_same_bits
from support.scenes import gas, simulate
from support.selection import long_but
from support.sessions import room
from support.tiles import first_free_place

import mpsim
from mpsim import Emitter, FixedDisc, InputError, Piston, Scene, State
from mpsim.kernels import records
from mpsim.measure import counted, run_averages

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


DRIFTS = ["energy_drift", "momentum_drift"]


def values(report):
    return {name: repr(measure) for name, measure in report.measures.items()}  # in which NaN equals NaN


@pytest.mark.parametrize("method", ["naive", "grid", "parallel", "event"])
def test_measures_from_a_start_on_are_those_of_a_run_that_begins_there(method):
    scene, names = gas(300, 0.4), COUNTED + SAMPLED + DRIFTS
    with simulate(scene, method=method, workers=2) as whole, simulate(scene, method=method, workers=2) as parts:
        start = 70.5 * whole.settings.dt  # inside a frame: the next one counts
        found = whole.run(frames=200, measures=names, start=start)
        parts.run(frames=71)
        expected = parts.run(frames=129, measures=names)
        assert values(found) == values(expected)
        assert (found.frames, expected.frames) == (200, 129)
        again = whole.run(frames=100, measures=names, start=start)
        assert values(again) == values(parts.run(frames=100, measures=names)), "a start that is over counts all"
    with simulate(scene, method=method, workers=2) as all_of_it:
        assert values(all_of_it.run(frames=200, measures=names)) != values(expected), "negative control"


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"start": 0.1}, "start needs measures, which are taken from then on; got start=0.1 and none"),
        ({"start": 0.1, "measures": []}, "start needs measures"),
        ({"start": -1.0, "measures": "pressure"}, ">= 0 [time]; got"),
        ({"start": float("nan"), "measures": "pressure"}, ">= 0 [time]; got"),
        ({"start": "late", "measures": "pressure"}, ">= 0 [time]; got"),
        ({"start": 0.2, "measures": "pressure"}, "start must lie before the end of the run, at time 0.2; got 0.2"),
        ({"start": float("inf"), "measures": "pressure"}, "start must be"),
    ],
)
def test_a_start_without_a_frame_to_measure_is_refused(arguments, text):
    with simulate(gas(10, 0.2), method="grid", dt=0.01) as sim:
        with pytest.raises(mpsim.InputError) as refused:
            sim.run(frames=20, **arguments)
        assert text in str(refused.value)
        assert sim.frame == 0
        sim.run(frames=0, measures="pressure", start=0.0)


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
    with pytest.raises(mpsim.errors.NotRecordedError, match=r"pressure was not recorded.*measures=\['pressure'\]"):
        report.measures["pressure"]


def test_the_virial_is_refused_under_gravity():
    scene = gas(10, 0.2, gravity=(0, -1))
    with simulate(scene, method="grid") as sim, pytest.raises(mpsim.InputError, match="gravity"):
        sim.run(frames=1, measures=["pressure_virial"])


def scene_of(**changes):
    arguments = {"width": 10.0, "height": 8.0, "position": [[2, 2], [5, 5]], "velocity": np.ones((2, 2)), "radius": 0.5}
    return Scene(**(arguments | changes))


VIRIALS = ["pressure_virial", "pressure_xx", "pressure_yy"]

REFUSED = {
    "gravity": ({"gravity": (0, -1)}, [*VIRIALS], "gravity and acceleration"),
    "obstacles": ({"obstacles": FixedDisc((8, 8), 1)}, [*VIRIALS, "momentum_drift"], "obstacles"),
    "losses": ({"restitution": 0.9}, [*VIRIALS], "losses"),
    "losses under gravity": (
        {"restitution": 0.9, "gravity": (0, -1)}, [*VIRIALS, "collision_rate"], ""),
    "losses at walls under acceleration": (
        {"wall_restitution": 0.9, "acceleration": np.ones((2, 2))}, [*VIRIALS, "collision_rate"], ""),
    "sizes": ({"radius": [0.5, 0.4]}, [*VIRIALS], "several sizes"),
    "sizes, channel": ({"radius": [0.5, 0.4], "boundary": ("walls", "periodic")}, [*VIRIALS], "several sizes"),
    "piston": ({"piston": Piston("left", 1, 3)}, ["pressure", *VIRIALS, "energy_drift"], "piston"),
    "absorbing": (
        {"absorbing": "left"},
        [*VIRIALS, "collision_rate", "contact_rate", "energy_drift", "momentum_drift"],
        "absorbing edges",
    ),
    "no wall": (
        {"absorbing": ["left", "right", "bottom", "top"]},
        ["pressure", *VIRIALS, "collision_rate", "contact_rate", "energy_drift",
         "momentum_drift"],
        "absorbing edges",
    ),
    "emitters": (
        {"emitters": Emitter((8, 6), (0, 0), every=1)},
        [*VIRIALS, "collision_rate", "contact_rate", "energy_drift", "momentum_drift"],
        "emitters",
    ),
    "emitters of masses": (
        {"mass": 2.0, "emitters": Emitter((8, 6), (0, 0), every=1, mass=1.0)},
        [*VIRIALS, "collision_rate", "contact_rate", "energy_drift", "momentum_drift", "kinetic_energy", "temperature"],
        "",
    ),
    "falling round": (
        {"gravity": (0, -1), "boundary": ("walls", "periodic")}, [*VIRIALS, "energy_drift"], ""),
    "periodic": ({"boundary": "periodic"}, [], ""),
    "periodic, sizes": ({"boundary": "periodic", "radius": [0.5, 0.4]}, [], ""),
    "periodic, losses": ({"boundary": "periodic", "restitution": 0.9}, ["pressure", *VIRIALS], "losses"),
    "periodic, obstacles": (
        {"boundary": "periodic", "obstacles": FixedDisc((8, 7), 1)},
        ["pressure", *VIRIALS, "momentum_drift"],
        "obstacles",
    ),
    "channel": ({"boundary": ("periodic", "walls")}, [], ""),
    "masses": ({"mass": [1.0, 9.0]}, [], ""),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_a_scene_has_the_measures_that_mean_something_in_it_and_no_others(case):
    changes, names, word = REFUSED[case]
    scene = scene_of(**changes)
    reasons = {name: run_averages.refusal(name, scene) for name in run_averages.NAMES}
    smooth = [] if all(scene.periodic) and VIRIALS[0] not in names else ["pressure_xy"]  # walls take up none
    assert {name for name, reason in reasons.items() if reason} == {*names, *smooth}
    for name in names:
        with pytest.raises(InputError) as raised:
            run_averages.checked([name], scene)
        text = str(raised.value)
        assert text.startswith(f"measures may hold {name!r} only")
        assert word in text


def test_masses_of_added_discs_are_asked_for():
    with pytest.raises(InputError, match=r"'temperature' only where the scene holds the mass of every disc; it has 2"):
        run_averages.checked("temperature", scene_of(mass=2.0), count=3)
    assert run_averages.checked("temperature", scene_of(), count=3) == ("temperature",)


def counts_of(**values):
    counts = np.zeros(4, records.COUNTS)
    for name, value in values.items():
        counts[name] = value
    return counts


def test_pressure_is_that_on_the_walls_that_there_are():
    counts = counts_of(wall=(9.0, 7.0, 3.0, 5.0))
    for changes, expected in (
        ({}, 24 / 36),
        ({"boundary": ("periodic", "walls")}, 8 / 20),
        ({"boundary": ("walls", "periodic")}, 16 / 16),
        ({"absorbing": "left"}, 15 / 28),
    ):
        run = counted.Run(scene_of(**changes), 2, 0.5)
        assert counted.pressure(counts, run).value == pytest.approx(expected / 0.5)


def test_the_virial_of_a_torus_has_no_margins_and_counts_the_largest_diameter():
    counts, scene = counts_of(virial=3.0), scene_of(boundary="periodic", radius=[0.5, 0.25])
    run = counted.Run(scene, 2, 0.5, kinetic_energy=7.0)
    assert counted.pressure(counts, run).value == pytest.approx((7 + 3 * 1.0 / (2 * 0.5)) / 80)
    channel = counted.Run(scene_of(boundary=("periodic", "walls")), 2, 0.5, kinetic_energy=7.0)
    assert counted.pressure_virial(counts, channel).value == pytest.approx((14 + 6) / (10 * 8 + 7 * 10))


def test_absorbed_discs_do_not_slow_down_those_that_press_on_the_walls():
    """Without a hit, the error is that of one hit at the speed of the discs present."""
    errors = []
    for present in ([True], [True, False]):
        count = len(present)
        scene = scene_of(position=[[5, 4], [2, 2]][:count], velocity=np.zeros((count, 2)), absorbing="left")
        state = State(scene.position, np.array([[0.3, 0.4], [0, 0]])[:count], present=np.array(present))
        averages = run_averages.RunAverages(("pressure",), 200, scene, lambda look, state=state: look(state))
        averages.take(np.zeros(200, records.COUNTS), 200)
        found = averages.measures(counted.Run(scene, scene.count, 0.1))["pressure"]
        assert found.value == 0
        assert not found.settled
        errors.append(found.error)
    assert errors[1] == errors[0] > 0


@pytest.mark.slow
@pytest.mark.parametrize("method", long_but(["grid", "event"], "grid"))
@pytest.mark.parametrize(
    ("change", "lost"),
    [
        (None, set()),  # the control
        (lambda sim: sim.kick(0, (0.5, 0.0)), {"pressure_virial", "energy_drift"}),
        (lambda sim: sim.change(restitution=0.5), {"pressure_virial", "pressure_xx", "energy_drift"}),
        *(pytest.param(*each, marks=pytest.mark.long) for each in [
            (lambda sim: sim.change(gravity=(0.0, -1.0)), {"pressure_virial", "pressure_xx", "energy_drift"}),
            (lambda sim: sim.remove([3, 4]), {"pressure_virial", "pressure_xx", "energy_drift", "collision_rate"}),
            (lambda sim: sim.add(first_free_place(sim.state), (0.0, 0.0), mass=2.0), {
                "pressure_virial", "pressure_xx", "energy_drift", "kinetic_energy"
            }),
        ]),
    ],
)  # fmt: skip
def test_what_a_change_in_the_run_makes_wrong_is_nan_and_nothing_else(method, change, lost):
    names = {"pressure", "pressure_virial", "pressure_xx", "collision_rate", "kinetic_energy", "energy_drift"}

    class Halfway:
        every = 10

        def look(self, sim, collisions):
            if sim.frame == 10 and change is not None:
                change(sim)

    with simulate(room(60, mass=np.linspace(1, 2, 60)), method=method, dt=0.05) as sim:
        found = sim.run(frames=20, measures=names, observe=Halfway()).measures
        assert {name for name in names if np.isnan(found[name].value)} == lost
        again = sim.run(frames=20, measures=["pressure"]).measures
        assert again["pressure"].value > 0
