"""Standard errors against what other starts show, pressures by component, rates in heaps: each with its control."""

import numpy as np
import pytest
from support.scenes import scene_of

import mpsim
from mpsim.measure import reference

pytestmark = pytest.mark.plain


def runs(packing, boundary, collisions, seeds, names, sensors=()):
    """Measures of one run each from so many starts, and the impulses on these walls in each frame."""
    series, found, rate = [], [], reference.enskog_rate(packing)
    for seed in range(seeds):
        scene = mpsim.Scene.random(count=64, packing=packing, radius=0.5, seed=seed, boundary=boundary)
        walls = [mpsim.Sensor(wall=wall) for wall in sensors]
        with mpsim.Simulation(scene, mpsim.Settings(method="event", dt=collisions / rate / 1000)) as sim:
            sim.run(until=20 / rate)
            found.append(sim.run(frames=1000, measures=["pressure", *names], observe=walls).measures)
        series.append([wall.impulse for wall in walls])
    return found, series


def over_claimed(found, errors=None):
    """Scatter of settled values over the root mean square of their errors, or of others."""
    errors = [measure.error for measure in found if measure.settled] if errors is None else errors
    assert len(errors) > 0.6 * len(found)
    scatter = np.std([measure.value for measure in found if measure.settled], ddof=1)
    return scatter / np.sqrt(np.mean(np.square(errors)))


@pytest.mark.long
@pytest.mark.parametrize("boundary", ["walls", "periodic"])
@pytest.mark.parametrize("packing", [0.02, 0.3, 0.6])
@pytest.mark.parametrize("collisions", [200, 2000])
def test_errors_are_those_of_other_starts(packing, boundary, collisions):
    """150 starts know a scatter to 6 %: the bounds are those of the table of the docs, 0.8 and 1.25, and two of these.

    Of short runs in a closed box the wall pressure is not settled from packing 0.3 on, and claims no error.
    """
    names = ["pressure_virial", "pressure_xx", "pressure_yy", "collision_rate", "speed_kurtosis"]
    found, _ = runs(packing, boundary, collisions, 150, names)
    if boundary == "periodic" or packing == 0.02 or collisions == 2000:
        names.append("pressure")
    else:
        assert not any(run["pressure"].settled for run in found)
        assert all(run["pressure"].upper for run in found)
    ratios = {name: over_claimed([run[name] for run in found]) for name in names}
    assert all(0.7 < ratio < 1.4 for ratio in ratios.values()), ratios


@pytest.mark.parametrize(
    ("method", "mass", "change"), [("naive", None, 1.0), ("grid", (1.0, 3.0), 1.5), ("event", (1.0, 3.0), 1.5)]
)
def test_the_impulse_of_one_collision_is_counted_by_component(method, mass, change):
    """Discs of mass 1, or 1 and 3, that meet along n = (0.6, 0.8) at speed 1: |dp| = 2 mu.

    The motion, and what the masses carry, is known as well: P_ab A = sum m v_a v_b + sum r_a dp_b / time.
    """
    n = np.array([0.6, 0.8])
    places = np.array([-0.55, 0.55])[:, None] * n + 5
    scene = scene_of(places, [0.5 * n, -0.5 * n], 10, 10, mass=mass, boundary="periodic")
    names = ["pressure_xx", "pressure_xy", "pressure_yy"]
    with mpsim.Simulation(scene, mpsim.Settings(method=method, dt=0.01)) as sim:
        report = sim.run(frames=40, measures=names)
        end = sim.state
    assert report.collisions == 1
    masses, momentum = scene.masses, scene.masses @ scene.velocity
    for name, (a, b) in zip(names, ((0, 0), (0, 1), (1, 1)), strict=True):
        carried = [(masses * v[:, a] * v[:, b]).sum() for v in (scene.velocity, end.velocity)]
        drift = momentum[a] * momentum[b] / masses.sum()
        found = report.measures[name].value * 100 * 0.4
        low, high = sorted((each - drift) * 0.4 for each in carried)
        assert low - 0.02 * change <= found - change * n[a] * n[b] <= high + 0.02 * change, name


def test_where_nothing_has_happened_an_error_says_how_much_could():
    scene = mpsim.Scene.random(count=4, width=200, height=200, radius=0.5, seed=1)
    with mpsim.Simulation(scene, mpsim.Settings(method="grid", dt=0.1)) as sim:
        found = sim.run(until=20, measures=["pressure", "collision_rate", "overlap"]).measures
    for name in ("pressure", "collision_rate"):
        assert (found[name].value, found[name].settled, found[name].upper) == (0, False, True)
        assert repr(found[name]).startswith("0(<")
    assert repr(found["overlap"]) == "0(?)"
    ideal = 4 * 0.5 * (scene.velocity**2).sum() / 4 / 200**2
    assert ideal < found["pressure"].error < 100 * ideal, "it leaves room for the pressure of an ideal gas"
    assert 0 < reference.enskog_rate(4 * np.pi / 4 / 200**2) < found["collision_rate"].error
    bath = scene._replace(thermostat=mpsim.Thermostat(1.0, 0.01))
    with mpsim.Simulation(bath, mpsim.Settings(method="grid", dt=0.1)) as sim:
        found = sim.run(until=10, measures=["pressure", "contact_rate"]).measures
    assert [(each.settled, each.upper) for each in found.values()] == [(False, False)] * 2, "a bath leaves no bound"


VIRIALS = ["pressure", "pressure_virial", "pressure_xx", "pressure_yy", "pressure_xy"]


@pytest.mark.parametrize("method", ["event", "naive"])
def test_where_nobody_has_collided_only_what_keeps_is_known(method):
    """What discs carry is not zero, and has not changed; the energy could have, with losses."""
    scene = mpsim.Scene.random(count=4, width=200, height=200, radius=0.5, seed=3, boundary="periodic")
    with mpsim.Simulation(scene, mpsim.Settings(method=method, dt=0.05)) as sim:
        report = sim.run(frames=200, measures=[*VIRIALS, "speed_kurtosis", "temperature", "kinetic_energy"])
    found = report.measures
    assert report.collisions == 0
    for name in ("pressure", "pressure_virial"):
        assert (found[name].settled, found[name].upper) == (False, True)
        excess = 2 * np.pi / 200**2 * found[name].value
        assert 0 < excess < found[name].error < found[name].value, "room for the second virial coefficient"
    for name in (*VIRIALS[2:], "speed_kurtosis"):
        assert not found[name].settled, name
        assert np.isnan(found[name].error), name
    for name in ("temperature", "kinetic_energy"):
        assert found[name].settled, "it cannot change"
        assert found[name].error < 1e-12
    with mpsim.Simulation(scene._replace(restitution=0.9), mpsim.Settings(method=method, dt=0.05)) as sim:
        found = sim.run(frames=40, measures=["kinetic_energy", "temperature"]).measures
    assert not any(each.settled for each in found.values()), "with losses it could have changed"


@pytest.mark.slow
def test_a_pressure_of_a_few_collisions_is_not_settled():
    """It claimed 0.509(0) after none, and 0.73(22) after one, of 1.46."""
    scene = mpsim.Scene.random(count=20, packing=0.4, radius=0.5, seed=1, boundary="periodic")
    few = 0
    with mpsim.Simulation(scene, mpsim.Settings(method="event", dt=0.002)) as sim:
        for _ in range(12):
            report = sim.run(frames=60, measures=[*VIRIALS, "speed_kurtosis"])
            for name, measure in report.measures.items():
                assert report.collisions >= 16 or not measure.settled, (name, report.collisions, measure)
            if report.collisions < 16:
                few += 1
                assert report.measures["pressure"].upper
                assert report.measures["pressure"].value + 2 * report.measures["pressure"].error > 1.46
        longer = sim.run(frames=20_000, measures=VIRIALS).measures
    assert few > 3
    assert all(measure.settled for measure in longer.values()), "the control"
    assert abs(longer["pressure"].deviation(1.4612)) < 4


def heap(dt, restitution, gravity=(0.0, -1.0)):
    """Rate at which contacts are resolved of 6 discs, a heap where they are lossy and heavy."""
    scene = mpsim.Scene.random(
        count=6, width=3, height=7, radius=0.5, seed=3, gravity=gravity, restitution=restitution,
        wall_restitution=restitution,
    )  # fmt: skip
    with mpsim.Simulation(scene, mpsim.Settings(method="naive", dt=dt, on_fast="warn")) as sim:
        sim.run(until=8)
        if restitution < 1 and any(gravity):
            with pytest.raises(mpsim.InputError, match=r"'collision_rate' only without losses under gravity.*contact_"):
                sim.run(until=10, measures=["collision_rate"])
            return sim.run(until=10, measures=["contact_rate"]).measures["contact_rate"].value
        found = sim.run(until=18, measures=["contact_rate", "collision_rate"]).measures
    assert found["contact_rate"] == found["collision_rate"]
    return found["collision_rate"].value


@pytest.mark.filterwarnings("ignore::mpsim.FastWarning")
def test_contacts_of_a_heap_are_counted_in_each_step_and_are_no_collisions():
    assert heap(0.04, 0.5) / heap(0.08, 0.5) > 1.3
    assert heap(0.02, 1.0, (0, 0)) / heap(0.04, 1.0, (0, 0)) == pytest.approx(1, abs=0.3), "the control: a gas"


def runs_in_bath(bath, before, time, seeds=40):
    """What runs of 16 discs in a bath state, and the errors of their energies from these series alone."""
    found, control = [], []
    for seed in range(seeds):
        scene = mpsim.Scene.random(count=16, packing=0.1, radius=0.5, seed=seed, **bath).redrawn(seed)
        energy = mpsim.measure.Series(mpsim.measure.kinetic_energy, every=5)
        gathered = mpsim.Correlations(every=5, longest=1)
        with mpsim.Simulation(scene, mpsim.Settings(method="grid", dt=0.1)) as sim:
            sim.run(until=before)
            names = ["pressure", "contact_rate", "pressure_xx", "kinetic_energy", "overlap"]
            run = sim.run(until=before + time, measures=names, observe=[energy, gathered]).measures
        found.append({**run, "velocity": gathered.velocity[0]})
        control.append(mpsim.measure.block_average(energy.value))
    return found, control


def rms_deviation(measures):
    """Of (value - mean) / error."""
    values, errors = np.array([(each.value, each.error) for each in measures]).T
    return np.sqrt(np.mean(((values - values.mean()) / errors) ** 2))


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::mpsim.FastWarning")
@pytest.mark.parametrize(
    ("bath", "memory", "memories"),
    [
        ({"thermostat": mpsim.Thermostat(1.0, 0.04)}, 25, 2),
        ({"thermal_walls": mpsim.ThermalWalls(left=1.0)}, 14, 1),  # a disc hits it every 21 on average
    ],
    ids=["thermostat", "thermal wall"],
)
def test_errors_in_a_weak_bath_know_how_slowly_it_changes_the_energy(bath, memory, memories):
    """A run of one or two memories of the bath cannot know its error from itself: it said 3 to 10 times too little.

    Its error may be too large, as how the measures follow the energy is hardly known either.
    """
    found, control = runs_in_bath(bath, before=3 * memory, time=memories * memory)
    assert not any(measure.settled or measure.upper for run in found for measure in run.values())
    rms = {name: rms_deviation([run[name] for run in found]) for name in found[0]}
    assert all(0.4 < each < 1.45 for each in rms.values()), rms
    assert rms_deviation(control) > 2.5, "the control: an error from the series alone"
