"""Measures of a state, by hand and by slow twins, and measures of a run: which a scene has, and from when on.

tests/twins/test_measures.py puts states and runs of any kind to all of them.
"""

import math
import sys

import numpy as np
import pytest
from support.compare import values
from support.scenes import At, box_of, gas, scene_of, simulate, state_of

import mpsim
from mpsim import Emitter, FixedDisc, InputError, Piston, State, measure

pytestmark = pytest.mark.plain


def moving(velocity):
    return State(np.zeros_like(velocity, dtype=float), velocity)


# --- overlaps


def test_overlaps_at_one_point_and_of_touching_discs_in_float32_and_of_nobody():
    scene = scene_of([[9, 9], [9, 9]])
    assert measure.overlap(state_of(scene), scene) == measure.Overlap(1, 1.0, 1.0, (0, 1))
    touching = scene_of([[17.3, 11.1], [18.3, 11.1]])
    place = touching.position.astype(np.float32)
    nearer = np.nextafter(place, np.float32([[99, 11.1], [0, 11.1]]))
    for places, pairs in ((nearer, 0), (place - [[0, 0], [1e-3, 0]], 1)):
        assert measure.overlap(State(places.astype(np.float32), touching.velocity), touching).pairs == pairs
    nobody = State(scene.position, scene.velocity, present=np.zeros(2, bool))
    assert measure.overlap(nobody, scene) == measure.Overlap(0, 0.0, 0.0, None)
    assert measure.potential_energy(nobody, scene_of(scene.position, gravity=(0, -1))) == 0


# --- refusals


ONE, POINTS = scene_of([[5, 5]]), gas(20, 0.1, boundary="periodic")
FALLING_ROUND = scene_of([[5, 5]], gravity=(0, -1), boundary=("walls", "periodic"))
SIZES = scene_of([[5, 5], [9, 9], [3, 3]], radius=[0.5, 1.0, 0.25], mass=[2.0, 4.0, 1.0])
P, IN_9 = state_of(POINTS), State([[5, 5]], [[0, 0]], box=(0, 9, 0, 9))
P_IN_BOX = State(P.position, P.velocity, image=np.zeros((20, 2), int), box=POINTS.box)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: measure.temperature(moving(np.zeros((0, 2))), ONE), "temperature needs at least 1 disc; got 0"),
        (lambda: measure.kinetic_energy(moving([[1, math.nan]]), ONE), r"velocity of a state\[0, 1\] is nan"),
        (lambda: measure.speed_kurtosis(moving([[0, 0]])), "needs a disc that moves"),
        (lambda: measure.mean_squared_displacement(P, P_IN_BOX), r"image flags \(State.image\) in both"),
        (lambda: measure.potential_energy(state_of(FALLING_ROUND), FALLING_ROUND), "along a periodic axis.*walls"),
        (lambda: measure.temperature(P, SIZES), "needs one mass of the scene per disc; got 3 and 20 discs"),
        (lambda: measure.overlap(IN_9, ONE), "whose box is 9 x 9; got one of 20"),
    ],
)  # fmt: skip
def test_what_a_measure_cannot_take_is_refused_by_name(call, words):
    with pytest.raises(InputError, match=words):
        call()


def test_without_freud_the_error_says_how_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "freud", None)
    with pytest.raises(mpsim.errors.NotMeasurableError, match="pip install freud-analysis"):
        measure.to_freud(P, POINTS)


# --- measures of runs

VIRIALS = ["pressure_virial", "pressure_xx", "pressure_yy"]
COUNTED = ["pressure", "collision_rate", "contact_rate", "overlap", "largest_overlap"]
SAMPLED = ["kinetic_energy", "temperature", "speed_kurtosis"]
DRIFTS = ["energy_drift", "momentum_drift"]
NAMES = [*COUNTED, *VIRIALS, "pressure_xy", *SAMPLED, *DRIFTS]
FLOWING = [*VIRIALS, "collision_rate", "contact_rate", "energy_drift", "momentum_drift"]

REFUSED = {
    "gravity": ({"gravity": (0, -1)}, [*VIRIALS], "gravity and acceleration"),
    "obstacles": ({"obstacles": FixedDisc((8, 8), 1)}, [*VIRIALS, "momentum_drift"], "obstacles"),
    "a container": ({"obstacles": mpsim.Circle((4, 4), 4, inside=True)}, ["pressure", *VIRIALS, "momentum_drift"], ""),
    "a wall that runs": ({"piston": Piston("left", surface_velocity=1), "wall_friction": 0.5},
                         [*VIRIALS, *DRIFTS], ""),
    "losses under gravity": ({"restitution": 0.9, "gravity": (0, -1)}, [*VIRIALS, "collision_rate"], ""),
    "sizes": ({"radius": [0.5, 0.4]}, [*VIRIALS], "several sizes"),
    "piston": ({"piston": Piston("left", 1, 3)}, ["pressure", *VIRIALS, "energy_drift"], "piston"),
    "absorbing": ({"absorbing": "left"}, FLOWING, "absorbing edges"),
    "no wall": ({"absorbing": ["left", "right", "bottom", "top"]}, ["pressure", *FLOWING], "absorbing edges"),
    "emitters": ({"emitters": Emitter((8, 6), (0, 0), every=1)}, FLOWING, "emitters"),
    "emitters of masses": ({"mass": 2.0, "emitters": Emitter((8, 6), (0, 0), every=1, mass=1.0)},
                           [*FLOWING, "kinetic_energy", "temperature"], ""),
    "falling round": ({"gravity": (0, -1), "boundary": ("walls", "periodic")}, [*VIRIALS, "energy_drift"], ""),
    "periodic, sizes": ({"boundary": "periodic", "radius": [0.5, 0.4]}, [], ""),
    "periodic, losses": ({"boundary": "periodic", "restitution": 0.9}, ["pressure", *VIRIALS], "losses"),
    "periodic, obstacles": ({"boundary": "periodic", "obstacles": FixedDisc((8, 7), 1)},
                            ["pressure", *VIRIALS, "momentum_drift"], "obstacles"),
    "channel": ({"boundary": ("periodic", "walls")}, [], ""),
    "rough discs": ({"friction": 0.5}, [*VIRIALS], "friction"),
    "rough walls": ({"wall_friction": 0.5}, [*VIRIALS, "momentum_drift"], ""),
    "bath": ({"thermostat": mpsim.Thermostat(2.0, 0.5)}, ["pressure_virial", *DRIFTS], "thermostat"),
    "thermal walls": ({"thermal_walls": mpsim.ThermalWalls(left=2.0)}, ["pressure_virial", *DRIFTS], "thermal walls"),
    "an obstacle that moves": ({"obstacles": FixedDisc((8, 6), 1, motion=mpsim.Oscillation((0.5, 0), 1.0))},
                               [*VIRIALS, *DRIFTS], ""),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_a_scene_has_the_measures_that_mean_something_in_it_and_no_others(case):
    changes, names, word = REFUSED[case]
    scene = box_of(position=[[2, 2], [5, 5]], velocity=np.ones((2, 2)), **changes)
    smooth = [] if all(scene.periodic) and VIRIALS[0] not in names else ["pressure_xy"]  # walls take up none
    texts = {}
    with simulate(scene, method="naive") as sim:
        for name in NAMES:
            try:
                sim.run(frames=0, measures=name)
            except InputError as error:
                texts[name] = str(error)
    assert texts.keys() == {*names, *smooth}
    assert all(text.startswith(f"measures may hold {name!r} only") for name, text in texts.items())
    assert all(word in texts[name] for name in names)


def drifts(scene, frames, **settings):
    """energy_drift and momentum_drift of a run."""
    with simulate(scene, **settings) as sim:
        measures = sim.run(frames=frames, measures=DRIFTS).measures
    return measures["energy_drift"].value, measures["momentum_drift"].value


def test_balances_by_hand():
    """A fall by push is n g dt^2/2 too low: -0.2 of 2 in a time of 1; a bounce at 1/2 leaves a quarter of the energy.

    Under `reflect` a disc at rest stays at rest and the other turns round: 2 m v = 4 over the speeds, 2, and 0.5.
    """
    energy, momentum = drifts(box_of(position=[[5, 4]], velocity=[[0, 0]], gravity=(0, -2)), 10, dt=0.1, method="naive")
    assert (energy, momentum) == (pytest.approx(-0.1, rel=1e-12), pytest.approx(0, abs=1e-14))
    bounce = box_of(position=[[8.5, 1.5]], velocity=[[2, 0]], wall_restitution=0.5)
    for method in ("grid", "event"):
        energy, momentum = drifts(bounce, 8, dt=0.25, method=method, contact="impact")
        assert (energy, momentum) == (pytest.approx(-0.375), pytest.approx(0, abs=1e-9))
    hit = box_of(position=[[4, 5], [5.5, 5]], velocity=[[2, 0], [0, 0]])
    assert drifts(hit, 5, dt=0.1, method="naive", law="reflect")[1] == pytest.approx(4, rel=1e-9)
    assert drifts(hit, 5, dt=0.1, method="naive", law="elastic")[1] < 1e-12
    assert drifts(box_of(position=[[4, 5]], velocity=[[0, 0]]), 3, dt=0.1, method="naive") == (0, 0)


@pytest.mark.parametrize("method", ["grid", "event"])
def test_measures_from_a_start_on_are_those_of_a_run_that_begins_there_and_change_no_bit(method):
    scene, names = gas(12, 0.4), [*COUNTED, *SAMPLED, *DRIFTS]
    plain, whole, parts = (simulate(scene, method=method) for _ in range(3))
    with plain, whole, parts:
        start = 7.5 * whole.settings.dt  # inside a frame: the next one counts
        found = whole.run(frames=40, measures=names, start=start)
        parts.run(frames=8)
        expected = parts.run(frames=32, measures=names)
        assert values(found) == values(expected)
        assert (found.frames, list(found.measures)) == (40, names)
        again = whole.run(frames=10, measures=names, start=start)
        assert values(again) == values(parts.run(frames=10, measures=names)), "a start that is over counts all"
        assert values(plain.run(frames=40, measures=names)) != values(expected), "the control"
        plain.run(frames=10)
        assert plain.digest() == whole.digest() == parts.digest()


def test_measures_that_cannot_be_taken_are_refused():
    with simulate(gas(8, 0.2), method="naive", dt=0.01) as sim:
        for arguments, text in (
            ({"start": 0.1}, "start needs measures, which are taken from then on; got start=0.1 and none"),
            ({"start": 0.2, "measures": "pressure"}, r"start must lie before the end of the run, at time 0\.2; got 0"),
        ):
            with pytest.raises(InputError, match=text):
                sim.run(frames=20, **arguments)
        assert sim.frame == 0
        report = sim.run(frames=1, measures="temperature")
        with pytest.raises(mpsim.errors.NotRecordedError, match=r"pressure was not recorded.*measures=\['pressure'\]"):
            report.measures["pressure"]


def test_what_has_left_does_not_count_in_a_run():
    """Half of the discs leave at once: the temperature is that of the others, which fly on for ever."""
    with simulate(box_of(position=[[2, 2], [5, 6]], velocity=[[0, -50], [3, 0]], absorbing="bottom"),
                  method="naive", contact="impact") as sim:  # fmt: skip
        sim.run(until=0.5)
        found = sim.run(frames=60, measures=SAMPLED).measures
        assert [found[name].value for name in SAMPLED] == pytest.approx([4.5, 4.5, 1], rel=1e-12)
        sim.remove(1)
        assert np.isnan(sim.run(frames=3, measures=["temperature"]).measures["temperature"].value), "of nobody"


@pytest.mark.parametrize(
    ("change", "lost"),
    [
        (lambda sim: None, set()),  # the control
        (lambda sim: sim.kick(0, (0.5, 0.0)), {"pressure_virial", "energy_drift"}),
        (lambda sim: sim.change(gravity=(0.0, -1.0)), {"pressure_virial", "pressure_xx", "energy_drift"}),
        (lambda sim: sim.remove([3, 4]), {"pressure_virial", "pressure_xx", "energy_drift", "collision_rate"}),
        (lambda sim: sim.add((2.0, sim.scene.height - 2), (0.0, 0.0), mass=2.0),
         {"pressure_virial", "pressure_xx", "energy_drift", "kinetic_energy"}),
    ],
    ids=["nothing", "kick", "gravity", "remove", "add"],
)  # fmt: skip
def test_what_a_change_in_the_run_makes_wrong_is_nan_and_nothing_else(change, lost):
    names = {"pressure", "pressure_virial", "pressure_xx", "collision_rate", "kinetic_energy", "energy_drift"}
    below = gas(16, 0.35, seed=3)
    scene = scene_of(below.position, below.velocity, below.width, below.height + 6, mass=np.linspace(1, 2, 16))
    with simulate(scene, method="naive", dt=0.05) as sim:
        found = sim.run(frames=20, measures=names, observe=At(10, change)).measures
        assert {name for name in names if np.isnan(found[name].value)} == lost
        if sim.count > 16:
            with pytest.raises(InputError, match=r"only where the scene holds the mass of every disc; it has 16"):
                sim.run(frames=1, measures="temperature")
