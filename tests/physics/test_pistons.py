"""A wall that moves, and edges that absorb: closed forms of one disc, work, and discs without room."""

import math
import re

import numpy as np
import pytest
from support.scenes import after, exactly, scene_of, simulate, state_after

import mpsim
from mpsim import InputError, Piston, Scene
from mpsim.measure import independent_average

pytestmark = pytest.mark.plain


def one(position, velocity, piston, width=11.0, height=3.0, **features):
    return scene_of([position], [velocity], width, height, piston=piston, **features)


# --- one disc


@pytest.mark.parametrize("how", [{"method": "event"}, {"method": "naive", "contact": "impact"}], ids=str)
@pytest.mark.parametrize("wall", ["left", "right", "bottom", "top"])
def test_a_disc_between_a_wall_and_a_piston_keeps_its_adiabatic_invariant(wall, how):
    """At each impact L (v - V) is the same: L_n = L_0 (v_0 - V) / (v_n - V), v_n = v_0 + 2 n V."""
    start, v, speed, bounces = 10.0, 3.0, 0.25, 9
    sign, across = (1 if wall in ("left", "bottom") else -1), wall in ("bottom", "top")
    stop = 11.0 - 1.5 if sign > 0 else 1.5
    place, velocity, size = [6.0, 1.5], [-3.0 * sign, 0.4], {"width": 11.0, "height": 3.0}  # on its way to the piston
    if across:
        place, velocity, size = place[::-1], velocity[::-1], {"width": 3.0, "height": 11.0}
    until = (5.5 if sign > 0 else 4.5) / (v + speed)  # when it first meets it, at L_0
    first = start - speed * until
    last = first * (v + speed) / (v + (2 * bounces + 1) * speed)
    until += (first - last) / speed
    frames = 400 if "contact" in how else 1
    with simulate(
        one(place, velocity, Piston(wall, sign * speed, stop), **size), dt=(until + 1e-9) / frames, **how
    ) as sim:
        sim.run(frames=frames)
        found, now = sim.state, sim.time
    after, axis = v + 2 * (bounces + 1) * speed, int(across)
    assert found.velocity[0, axis] == pytest.approx(sign * after, rel=1e-12)
    assert abs(found.velocity[0, 1 - axis]) == pytest.approx(0.4, rel=1e-14)
    met = found.box[("left", "right", "bottom", "top").index(wall)] - sign * speed * (now - until) + sign * 0.5
    assert found.position[0, axis] == pytest.approx(met + sign * after * (now - until), abs=1e-9)
    assert after - v > 1, "the control: each impact has added 0.5"


def test_a_ball_on_a_floor_that_rises_bounces_as_on_one_at_rest_and_then_as_on_it():
    gravity, rise, height = 1.0, 0.2, 1.0
    relative = math.sqrt(rise**2 + 2 * gravity * height)
    period, first = 2 * relative / gravity, (relative - rise) / gravity
    scene = one((2.0, 0.5 + height), (0.0, 0.0), Piston("bottom", rise, 1.0), width=4.0, height=20.0,
                gravity=(0, -gravity))  # fmt: skip
    top = rise * (first + period / 2) + 0.5 + relative**2 / 2
    for settings in ({"method": "event"}, {"method": "naive", "contact": "impact"}):
        frames = 1 if settings["method"] == "event" else 100
        with simulate(scene, dt=(first + period / 2) / frames, **settings) as sim:  # the top of a bounce
            sim.run(frames=frames)
            assert sim.state.velocity[0, 1] == pytest.approx(rise, abs=1e-12)
            assert sim.state.position[0, 1] == pytest.approx(top, abs=1e-12)
    # The floor stops at 5, in the second bounce; what the ball then has it keeps.
    found = state_after(scene, 1, method="event", dt=20.0)
    assert first + period < 5 < first + 2 * period
    energy = 0.5 * (relative + rise) ** 2 + gravity * rise * (first + period)
    assert 0.5 * found.velocity[0, 1] ** 2 + gravity * (found.position[0, 1] - 0.5) == pytest.approx(energy, rel=1e-13)


def test_a_piston_sweeps_up_discs_at_rest_at_twice_its_speed_and_not_after_its_stop():
    scene = scene_of([[3.0, 1.0], [6.0, 3.0], [9.5, 5.0]], width=12, height=6, piston=Piston("left", 1.0, 6.0))
    for settings in ({"method": "event", "dt": 5.8}, {"method": "grid", "contact": "impact", "dt": 0.0725}):
        state = after(scene, 5.8, **settings)
        assert state.velocity.tolist() == [[2.0, 0.0], [2.0, 0.0], [0.0, 0.0]]
        assert state.position[:2, 0] == pytest.approx([3.0 + 2 * 3.3, 6.0 + 2 * 0.3], abs=1e-12)
        assert state.box == pytest.approx((5.8, 12.0, 0.0, 6.0))
    state = state_after(scene, 1, method="event", dt=30.0)
    assert state.box == (6.0, 12.0, 0.0, 6.0)
    assert (state.velocity**2).sum() == 8.0
    assert state.position[:, 0].min() >= 6.5


def test_a_disc_that_is_on_the_wall_when_it_stops_stays_inside():
    """Slow discs in contact at the moment of the stop, at many places: none is lost behind it."""
    for part in np.linspace(0.0, 1.0, 11):
        scene = one((2.5 + part, 1.5), (0.0, 0.0), Piston("left", 0.5, 3.0 - part * 1e-16))
        assert 3.5 - 1e-12 <= state_after(scene, 1, method="event", dt=40.0).position[0, 0] <= 10.5


def hit(wall, phase, **how):
    """(position, velocity) inwards at time 2, and at the end of the closed form, of a disc that meets a wall once.

    The wall is at rest at 2 + 0.5 sin(phase) from its edge until it oscillates, from the time 0.1 on.
    """
    edge = ("left", "right", "bottom", "top").index(wall)
    axis, sign = edge // 2, 1 - 2 * (edge % 2)
    turned, size = (lambda x, y: ((x, y), (y, x))[axis]), ((11.0, 3.0), (3.0, 11.0))[axis]
    motion = mpsim.Oscillation(turned(0.5 * sign, 0.0), period=7.0, phase=phase, start=0.1)
    place = turned(5.0 if sign > 0 else 6.0, 1.5)
    piston = Piston(wall, motion=motion, start=2.0 if sign > 0 else 9.0)
    state = after(one(place, turned(-3.0 * sign, 0.4), piston, *size), 2.0, **how)
    x, v = state.position[0, axis], state.velocity[0, axis]
    turns = 2 * math.pi / 7
    angle = lambda t: turns * max(t - 0.1, 0) + phase  # noqa: E731
    early, late = 0.0, 2.0
    for _ in range(60):
        time = (early + late) / 2
        early, late = (time, late) if 5 - 3 * time - 0.5 > 2 + 0.5 * math.sin(angle(time)) else (early, time)
    speed = 3 + 2 * 0.5 * turns * math.cos(angle(early))
    return np.array([x if sign > 0 else 11 - x, sign * v]), np.array([5 - 3 * early + speed * (2 - early), speed])


def test_a_disc_meets_a_wall_that_oscillates_where_and_as_fast_as_the_wall_then_is():
    """`event` to rounding, `impact` to second order in dt, over many phases of the contact in a step."""
    phases = np.linspace(0, 5.7, 20)
    for number, phase in enumerate(phases):
        found, expected = hit(("left", "right", "bottom", "top")[number % 4], phase, method="event", dt=0.5)
        assert np.abs(found - expected).max() < 1e-9
    errors = []
    for dt in (0.1, 0.05, 0.025):
        each = [np.subtract(*hit("top", phase, method="naive", contact="impact", dt=dt)) for phase in phases]
        errors.append(np.sqrt(np.mean(np.square(each))))
    assert min(np.log2(errors[:-1]) - np.log2(errors[1:])) > 1.8, errors
    assert errors[-1] < 1e-4


BREATHING = [
    Piston("right", motion=mpsim.Path([0, 1, 3, 4], [(0, 0), (-1, 0), (0.5, 0), (0, 0)]), start=8.0),
    Piston("top", motion=mpsim.Oscillation((0, 0.5), period=1.5), start=6.0),
    Piston("left", 0.25, 0.5),
]


@pytest.mark.parametrize("how", [{"method": "event"}, {"method": "parallel"}, {"method": "naive"}], ids=str)
def test_several_walls_move_at_once_and_no_disc_is_ever_behind_one(how, tmp_path):
    """Whoever computes it, and whether it was saved on the way; the walls are where the scene has them."""
    scene = Scene.random(count=30, width=9, height=7, radius=0.3, seed=3, piston=BREATHING, inside=(0.5, 0.5, 7, 5))
    ends = set()
    for workers in (1, 2) if how["method"] != "naive" else (1,):
        with simulate(scene, dt=0.02, workers=workers, **how) as sim:
            for _ in range(8):
                sim.run(frames=25)
                (low, high), state = sim.scene.walls_at(sim.time), sim.state
                assert state.box == (low[0], high[0], low[1], high[1])
                assert (np.clip(state.position, low + 0.3, high - 0.3) == state.position).all()
                if sim.frame == 100:
                    sim.save(tmp_path / "run")
                    assert low[0] == 0.5
                    assert scene.starting_from(state, sim.time).box == state.box
            ends.add(sim.digest())
        with mpsim.Simulation.resume(tmp_path / "run") as again:
            again.run(frames=100)
            ends.add(again.digest())
    assert len(ends) == 1
    with pytest.raises(InputError, match="time must be finite in a scene with a wall that never rests; got inf"):
        scene.walls_at(math.inf)
    with pytest.raises(InputError, match=r"time must be that of the state, in which the top piston is at .*; got 0"):
        scene.starting_from(mpsim.State(state.position, state.velocity, box=(*state.box[:3], 6.3)))


# --- no room


WEDGE = mpsim.Polyline([[5, 1], [3, 3], [5, 5]], thickness=0.4)
ACROSS = mpsim.Polyline([[2, 0], [2, 6]], thickness=0.4)


def pressed(stop=2.0, position=(6.0, 3.0), velocity=(0.1, 0.03), **features):
    """A piston that comes from the right at a speed of 0.5, until it is at `stop`."""
    return one(position, velocity, Piston("right", -0.5, stop), width=12.0, height=6.0, **features)


@pytest.mark.slow  # ten thousand bounces
@pytest.mark.parametrize(
    ("features", "at"),
    [
        ({"obstacles": ACROSS}, 3.2),
        pytest.param({"obstacles": WEDGE, "velocity": (0.0, 0.0)}, 4.49, marks=pytest.mark.long),
        pytest.param({"obstacles": ACROSS, "wall_restitution": 0.5}, 3.2, marks=pytest.mark.long),
    ],
    ids=["before an obstacle", "in a wedge", "with losses"],
)
@pytest.mark.filterwarnings("ignore::mpsim.errors.GuardWarning")
def test_a_disc_that_is_crushed_is_an_error_that_names_it_and_what_to_do(features, at):
    """It would meet both without end."""
    with exactly(pressed(**features), dt=0.5) as sim, pytest.raises(mpsim.errors.StalledError) as caught:
        sim.run(frames=60)
    found = re.match(
        r"disc 0 is crushed in frame \d+ between (the right wall|obstacles\[0\]) and (?!\1)(?:the right wall|obstacles"
        r"\[0\]): the piston, now at (.*) and on its way to [12], leaves it no room, and has driven it to a speed of 5"
        r"[.\d]*e\+03, more than 10000 times any at the start\. Let the piston stop earlier, or make room for the "
        r"discs before it\.$",
        str(caught.value),
    )
    assert found, caught.value
    assert float(found[2]) == pytest.approx(at, abs=0.01)


@pytest.mark.slow
def test_a_disc_with_just_enough_room_lives_on():
    """The control: in a gap that shrinks to a hundredth it becomes as much faster, and stays so."""
    state = state_after(pressed(3.25, (6.0, 3.0), (-1.0, 0.0), obstacles=ACROSS), 60, method="event", dt=0.5)
    assert 20 < abs(state.velocity[0, 0]) < 500
    assert 2.7 <= state.position[0, 0] <= 2.75 + 1e-12


def test_a_fast_disc_that_is_added_is_not_taken_for_one_that_is_crushed(tmp_path):
    """A hundred thousand times as fast as all at the start, also after the run was saved."""
    with exactly(pressed(5.0), dt=0.001) as sim:
        sim.run(frames=1)
        sim.add((8.0, 1.0), (5e4, 0.0))
        assert sim.run(frames=1).frames == 1
        sim.save(tmp_path / "fast")
    with mpsim.Simulation.resume(tmp_path / "fast") as sim:
        assert sim.run(frames=1).frames == 1
        assert np.abs(sim.state.velocity).max() >= 5e4


# --- many discs


def breathed(period, seed):
    """T/T0 after half a period of a piston that goes in and comes out, and after all of it."""
    piston = Piston("right", motion=mpsim.Oscillation((-1.5, 0), period, phase=-math.pi / 2), start=6.5)
    scene, energy = Scene.random(count=40, width=8, height=9.7, radius=0.15, seed=seed, piston=piston), []
    with exactly(scene, dt=period / 2) as sim:
        for _ in range(2):
            sim.run(frames=1)
            energy.append((sim.state.velocity**2).sum())
    return np.array(energy) / (scene.velocity**2).sum()


@pytest.mark.long
def test_a_gas_that_is_compressed_slowly_and_let_out_again_has_its_temperature():
    """The control: of a piston as fast as the discs it is heated for good."""
    middle, end = np.mean([breathed(400.0, seed) for seed in range(4)], axis=0)
    assert middle > 1.4
    assert end == pytest.approx(1, abs=0.01)
    assert breathed(8.0, 0)[1] > 1.1


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::mpsim.FastWarning")
def test_a_slow_piston_keeps_temperature_times_area():
    """T A is constant in two dimensions (gamma = 2) for an ideal gas; d ln T = -Z d ln A for discs, A for centres."""
    radius, count, side = 0.1, 200, 40.0

    def gained(speed, seed):
        """Energy after a right wall has halved the box, over that at the start."""
        scene = Scene.random(count=count, width=side, height=side / 2, radius=radius, seed=seed)
        scene = scene._replace(piston=Piston("right", -speed, side / 2))
        return (after(scene, side / 2 / speed, dt=0.02).velocity ** 2).sum() / (scene.velocity**2).sum()

    slow = independent_average([gained(0.02, seed) for seed in range(3)])
    area = [(width - 2 * radius) * (side / 2 - 2 * radius) for width in (side, side / 2)]
    covered = 2 * count * math.pi * radius**2  # Z = 1 / (1 - 2 eta) at this order: the area that is left to move in
    expected = (area[0] - covered) / (area[1] - covered)
    assert abs(slow.value / expected - 1) < 3 * slow.error / expected + 0.01
    fast = gained(2.0, 0)
    assert fast > 1.5 * expected, f"a piston as fast as the discs must heat by more; got {fast}"


# --- walls that run along themselves

SHEARED = [{"method": "event", "dt": 0.25}, {"method": "naive", "contact": "impact"}, {"method": "grid"}]


@pytest.mark.parametrize("how", SHEARED, ids=str)
@pytest.mark.parametrize("wall", ["left", "right", "bottom", "top"])
def test_a_wall_that_runs_takes_a_disc_along_as_one_at_rest_slows_it(wall, how):
    """Seen from the wall both are the same; its work is its velocity times the impulse of friction."""
    axis, sign = int(wall in ("bottom", "top")), -1.0 if wall in ("left", "bottom") else 1.0
    there, past = sign * np.eye(2)[axis], np.eye(2)[1 - axis]

    def hit(velocity, **piston):
        scene = one((2, 2), velocity, Piston(wall, **piston) if piston else None, 4.0, 4.0, wall_friction=0.05)
        with simulate(scene, **{"dt": 1 / 64, **how}) as sim:
            sim.run(until=0.5)
            return sim.state.velocity[0], float(sim.state.spin[0]), sim.work

    (taken, spin, work), (slowed, turned, _) = hit(4 * there, surface_velocity=1.5), hit(4 * there - 1.5 * past)
    assert taken == pytest.approx(-4 * there + 0.05 * 8 * past, abs=1e-12), "along its axis: mu times the normal change"
    assert (*slowed + 1.5 * past, turned) == pytest.approx((*taken, spin), abs=1e-12)
    assert abs(spin) == pytest.approx(2 * 0.4 / 0.5, abs=1e-12)
    assert work == pytest.approx({wall: 1.5 * 0.4}, rel=1e-12)


@pytest.mark.parametrize("how", SHEARED, ids=str)
def test_a_perfectly_rough_gas_between_walls_that_run_gains_their_work(how):
    belts = [Piston("top", surface_velocity=2.0), Piston("bottom", 0.5, 2.0, surface_velocity=-2.0)]
    rough = {"wall_friction": np.inf, "friction": np.inf, "tangential_restitution": 1.0}
    box = {"count": 40, "width": 12, "height": 9, "radius": 0.3, "boundary": ("periodic", "walls"), "seed": 5}
    scene = Scene.random(piston=belts, **box, **rough)
    energies = []
    with simulate(scene, **{"dt": 1 / 128, **how}) as sim:
        for _ in range(2):
            sim.run(until=sim.time + 2.0)
            energies.append(mpsim.measure.kinetic_energy(sim.state, scene) - sum(sim.work.values()))
        assert min(sim.work["top"], sim.work["bottom"]) > 1
    assert energies == pytest.approx([40.0, 40.0], rel=1e-9)


@pytest.mark.parametrize("how", SHEARED, ids=str)
def test_work_is_counted_for_walls_that_run_far_faster_than_discs_begin(how):
    """Also where they alone set discs in motion; at 0 the wall is at rest."""
    found = {}
    for speed in (1.5, 0.0):
        scene = scene_of([[2, 1]], [[0, 0]], 4, 4, wall_friction=0.05, piston=Piston("bottom", surface_velocity=speed))
        with simulate(scene, **{"dt": 1 / 64, **how}) as sim:
            sim.run(frames=1)
            sim.set(0, velocity=(0, -4))
            sim.run(until=0.5)
            found[speed] = sim.work, sim.state.velocity[0].tolist()
    assert found[1.5][0] == pytest.approx({"bottom": 1.5 * 0.05 * 8}, rel=1e-9)
    assert found[0.0] == ({}, [0.0, 4.0])


def test_walls_that_run_and_drive_a_disc_in_a_corner_without_end_are_named():
    belts = [Piston("top", surface_velocity=2), Piston("right", surface_velocity=1)]
    rough = {"wall_friction": np.inf, "tangential_restitution": 1}
    scene = scene_of([[5, 5]], [[1, 0.3]], 10, 10, radius=0.3, piston=belts, **rough)
    with exactly(scene) as sim, pytest.raises(mpsim.errors.StalledError, match=r"disc 0 is driven to .* in a corner"):
        sim.run(until=100)


# --- edges that absorb: times and places of leaving in closed form


def closed(scene):
    """The same discs between walls: the control."""
    return scene_of(scene.position, scene.velocity, scene.width, scene.height, radius=scene.radius)


@pytest.mark.parametrize("edge", ["left", "right", "bottom", "top"])
def test_a_disc_leaves_at_the_instant_at_which_it_touches(edge):
    """It is there a rounding before, and away a rounding after; then it rests there, whatever gravity does."""
    sign, axis = (1 if edge in ("right", "top") else -1), int(edge in ("bottom", "top"))
    velocity, gravity = [0.3, 0.3], [0.1, 0.1]
    velocity[axis], gravity[axis] = 1.5 * sign, 0.4 * sign
    scene = scene_of([[4, 4]], [velocity], 8, 8, gravity=gravity, absorbing=edge)
    touch = (-1.5 + math.sqrt(1.5**2 + 2 * 0.4 * 3.5)) / 0.4
    for late in (-1e-12, 1e-12, 50.0):
        with exactly(scene, dt=touch + late) as sim:
            sim.run(frames=1)
            assert sim.absorbed.tolist() == [late > 0]
            assert sim.state.present.tolist() == [late < 0]
            assert sim.state.position[0, axis] == pytest.approx(4 + 3.5 * sign, abs=1e-11)
            assert sim.state.position[0, 1 - axis] == pytest.approx(4 + 0.3 * touch + 0.05 * touch**2, abs=1e-11)
            assert (sim.state.velocity[0] == 0).all() == (late > 0)
    with simulate(scene, method="grid", contact="impact", dt=touch / 20) as sim:
        assert sim.run(frames=19).frames == 19
        assert not sim.absorbed.any()
        sim.run(frames=2)
        assert sim.absorbed.all()
        assert sim.state.position[0, axis] == pytest.approx(4 + 3.5 * sign, abs=0.3)


@pytest.mark.parametrize("settings", [{"method": "event", "dt": 2.0}, {"method": "grid", "dt": 0.05}], ids=str)
def test_what_has_left_meets_no_disc(settings):
    """The first leaves at 1; the second would have met it at its place later, and leaves at 3."""
    scene = scene_of([[6.5, 1.5], [4.5, 1.5]], [[1, 0], [1, 0]], 8, 3, absorbing="right")
    with simulate(scene, **settings) as sim:
        assert sim.run(until=2.0).collisions == 0
        assert sim.absorbed.tolist() == [True, False]
        assert sim.run(until=4.0).collisions == 0
        assert sim.absorbed.all()
        assert sim.state.position[:, 0] == pytest.approx([7.5, 7.5], abs=0.06)
    with simulate(closed(scene), **settings) as sim:
        assert sim.run(until=4.0).collisions == 1, "the control: at a wall the first comes back and meets the second"


def test_a_disc_added_later_finds_those_that_have_left_away():
    """Also where another lies on them now."""
    scene = scene_of([[6.5, 1.5], [2.0, 1.5]], [[1, 0], [0, 0]], 8, 3, absorbing="right", gravity=(0.0, 0.0))
    with exactly(scene, dt=2.0) as sim:
        sim.run(frames=1)
        sim.add([7.4, 1.5], [-1.0, 0.0])
        assert sim.absorbed.tolist() == [True, False, False]
        assert sim.run(frames=3).collisions == 1
        assert sim.state.velocity[:, 0].tolist() == [0.0, 1.0, 0.0], "the second is back from the wall"
