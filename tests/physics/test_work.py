"""The work of surfaces that move: against the energy that discs gain, impulses as logged, and closed forms."""

import numpy as np
import pytest

import mpsim
from mpsim import Circle, FixedDisc, Oscillation, Piston, Polyline, Rotation, Scene, Simulation, Translation

pytestmark = pytest.mark.plain

EXACT = {"method": "event", "dt": 0.25}
STEPS = {"method": "grid", "contact": "impact", "dt": 1 / 64}
PUSH = {**STEPS, "contact": "push"}
HEART = Circle((6, 6), 5, inside=True)
ROTOR = Polyline([(4, 6), (8, 6)], motion=Rotation((6, 6), rate=1.5))
BREATH = Piston("left", motion=Oscillation((0.5, 0), 1.5, phase=0.5), start=0.7)
FLOOR = Piston("bottom", motion=Oscillation((0, 0.5), 1.5), start=0.7)

SURFACES = {
    "a piston": ({"piston": Piston("right", -2, 8)}, {"right"}),
    "two pistons": ({"piston": [Piston("top", -2, 9), BREATH]}, {"top", "left"}),
    "a rotor beside a peg": ({"obstacles": [FixedDisc((2, 6), 0.5), ROTOR], "mass": np.tile([1.0, 3.0], 15)}, {1}),
    "a container": ({"obstacles": Circle((6, 6), 5, inside=True, motion=Oscillation((0.5, 0.3), 2))}, {0}),
}


def gas(**surfaces):
    return Scene.random(count=30, width=12, height=12, radius=0.4, temperature=2.0, seed=3, inside=HEART, **surfaces)


@pytest.mark.parametrize("how", [EXACT, STEPS, PUSH], ids=["event", "impact", "push"])
@pytest.mark.parametrize("name", SURFACES)
def test_the_work_of_surfaces_is_what_an_elastic_gas_gains(name, how):
    surfaces, movers = SURFACES[name]
    scene, sensor = gas(**surfaces), mpsim.Sensor(wall="right")
    with Simulation(scene, mpsim.Settings(**how)) as sim:
        before = mpsim.measure.kinetic_energy(sim.state, scene)
        sim.run(until=1.0, observe=sensor)
        gained, work = mpsim.measure.kinetic_energy(sim.state, scene) - before, sim.work
    assert work.keys() == movers
    assert all(abs(each) > 0.1 for each in work.values())
    assert sum(work.values()) == pytest.approx(gained, rel=1e-9)
    assert name != "a piston" or 2 * sensor.impulse.sum() == pytest.approx(gained, rel=1e-9)


@pytest.mark.parametrize("how", [EXACT, STEPS], ids=["event", "impact"])
def test_work_is_impulse_times_velocity_of_the_material_with_friction_belts_and_losses(how):
    """Of the impulses that are logged, friction included; losses are not in it."""
    belt = FixedDisc((6, 2.5), 1, surface_velocity=-2.0)
    rough = {"wall_friction": 0.4, "restitution": 0.8, "wall_restitution": 0.7, "tangential_restitution": 0.5}
    scene, seen = gas(obstacles=[ROTOR, belt], **rough), mpsim.Collisions()
    with Simulation(scene, mpsim.Settings(**how)) as sim:
        sim.run(until=1.0, observe=seen)
        work = sim.work
    expected = [0.0, 0.0]
    for row in seen.table[seen.table["kind"] == 2]:
        (x, y), impulse = row["place"], row["impulse"] + row["tangential_impulse"]
        velocities = 1.5 * np.array([6 - y, x - 6]), -2.0 * np.array([2.5 - y, x - 6])
        expected[row["j"]] += impulse @ velocities[row["j"]]
    assert min(map(abs, expected)) > 0.05
    assert [work[0], work[1]] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("how", [EXACT, STEPS, PUSH], ids=["event", "impact", "push"])
def test_a_belt_does_its_speed_times_the_impulse_that_sets_a_disc_in_motion(how):
    disc = {"position": [[3, 1.6]], "velocity": [[0, -1]], "radius": 0.5, "wall_friction": 0.25, "mass": [2.0]}
    for points, sign in (([(0, 1), (12, 1)], 1), ([(12, 1), (0, 1)], -1)):
        scene = Scene(width=12, height=6, obstacles=Polyline(points, surface_velocity=1.5), **disc)
        with Simulation(scene, mpsim.Settings(**how)) as sim:
            sim.run(until=0.5)
            assert sim.state.velocity[0] == pytest.approx([sign * 0.25 * 2, 1], abs=1e-12)
            assert sim.work == pytest.approx({0: 1.5 * 2 * 0.25 * 2}, rel=1e-12)


@pytest.mark.parametrize("how", [EXACT, STEPS, PUSH], ids=["event", "impact", "push"])
@pytest.mark.parametrize("speed", [-1.0, 0.5])
def test_work_at_an_inelastic_hit_is_without_the_loss_and_negative_where_the_wall_gives_way(speed, how):
    wall = Polyline([(9, 0), (9, 6)], motion=Translation((speed, 0), stop=2))
    one = {"position": [[8, 3]], "velocity": [[2, 0]], "radius": 0.5, "wall_restitution": 0.5}
    with Simulation(Scene(width=12, height=6, obstacles=wall, **one), mpsim.Settings(**how)) as sim:
        sim.run(until=0.75)
        assert sim.state.velocity[0, 0] == pytest.approx(2 - 1.5 * (2 - speed), abs=1e-12)
        assert sim.work == pytest.approx({0: -1.5 * (2 - speed) * speed}, rel=1e-12)


def test_the_work_of_steps_comes_to_that_of_event_in_second_order():
    def work(place, frames, **how):
        piston = Piston("right", motion=Oscillation((-1, 0), 5, phase=0.3), start=7.5)
        disc = {"position": [[place, 3]], "velocity": [[2, 0.2]], "radius": 0.5}
        with Simulation(
            Scene(width=12, height=6, piston=piston, **disc), mpsim.Settings(dt=1.5 / frames, **how)
        ) as sim:
            sim.run(frames=frames)
            return sim.work["right"]

    errors = []
    for frames in (10, 20, 40):
        places = 4 + np.linspace(0, 3.5 * 1.5 / frames, 8, endpoint=False)  # so that it meets it at all times of a step
        exact = [work(each, 1, method="event") for each in places]
        assert min(map(abs, exact)) > 0.05
        steps = [work(each, frames, method="naive", contact="impact") for each in places]
        errors.append(np.abs(np.subtract(steps, exact)).max())
    assert np.polyfit(np.log([4, 2, 1]), np.log(errors), 1)[0] > 1.8, errors


BATHS = {
    "a thermostat": ({"thermostat": mpsim.Thermostat(3.0, rate=2.0)}, {"thermostat"}),
    "thermal walls": (
        {"thermal_walls": mpsim.ThermalWalls(left=9.0, right=5.0), "piston": FLOOR},
        {"left", "right", "bottom"},
    ),
}


@pytest.mark.parametrize("how", [EXACT, STEPS, PUSH], ids=["event", "impact", "push"])
@pytest.mark.parametrize("name", BATHS)
def test_baths_have_entries_of_their_own_and_losses_are_what_is_missing(name, how):
    baths, givers = BATHS[name]
    for restitution in (1.0, 0.8):
        scene = gas(**baths, restitution=restitution, mass=np.tile([1.0, 3.0], 15))
        with Simulation(scene, mpsim.Settings(**how)) as sim:
            before = mpsim.measure.kinetic_energy(sim.state, scene)
            sim.run(until=3.0)
            gained, work = mpsim.measure.kinetic_energy(sim.state, scene) - before, sim.work
        assert work.keys() == givers
        assert all(abs(each) > 0.1 for each in work.values())
        given = sum(work.values())
        assert given == pytest.approx(gained, rel=1e-9) if restitution == 1 else given > 1.05 * gained


@pytest.mark.parametrize("how", [EXACT, STEPS], ids=["event", "grid"])
def test_work_is_kept_in_files_and_snapshots_and_when_its_obstacle_goes(how, tmp_path):
    with Simulation(gas(obstacles=[FixedDisc((2, 6), 0.5)]), mpsim.Settings(**how)) as sim:
        assert sim.work == sim.run(frames=1).work == {}, "nothing moves"
        drum = sim.add_wall(Circle((6, 6), 5.6, inside=True, motion=Oscillation((0.4, 0.1), 0.5)))
        sim.run(until=0.5)
        snap, before = sim.snapshot(), sim.work[drum]
        path = sim.save(tmp_path / "run")
        report = sim.run(until=1.0)
        work = sim.work
        assert report.work == {1: work[1] - before}
        assert work[1] != before != 0
        sim.restore(snap)
        assert sim.work == {1: before}
        sim.add_wall(Polyline([(0, 0), (1, 0)], motion=Translation((1, 0), stop=1)))
        assert sim.work == {1: before, 2: 0.0}
        sim.change(obstacles=[])
        sim.run(until=0.75)
        assert sim.work == {1: before}
    with Simulation.resume(path) as sim:
        assert sim.work == {1: before}
        sim.run(until=1.0)
        assert sim.work == work
