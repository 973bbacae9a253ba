"""Contacts of a few discs against closed forms: to rounding with `event` and `impact`; `push` is the control.

`push` finds the normal, the place and the speed of a contact up to a frame late.
"""

import decimal
import math

import numpy as np
import pytest
from support.scenes import scene_of, simulate, state_after

import mpsim
from mpsim import FixedDisc, Polyline, Scene

pytestmark = [pytest.mark.plain, pytest.mark.filterwarnings("ignore::mpsim.FastWarning")]

ROUNDING = 1e-12


# --- two discs that meet once


def met_once(settings, features, offset, shift):
    """Misses of velocities, places, energy lost and momentum."""
    features = {"radius": 0.5, "mass": 1.0, "restitution": 1.0, "boundary": "walls"} | features
    radii, mass = (np.broadcast_to(features[name], 2).astype(float) for name in ("radius", "mass"))
    position = np.array([[3.0 + shift, 5.0], [6.0, 5.0 + offset]])
    velocity = np.array([[1.5, 0.1], [-0.5, -0.2]] if features["boundary"] == "periodic" else [[1.5, 0.0], [0.0, 0.0]])
    if features["boundary"] == "periodic":  # the place of the contact lies on the border
        position[:, 0] += 5.6
    if np.ndim(features["mass"]) == 0:
        features = {name: value for name, value in features.items() if name != "mass"}
    scene = Scene(width=10, height=10, position=position % 10, velocity=velocity, **features)
    r, u, reach = position[1] - position[0], velocity[1] - velocity[0], radii.sum()
    b, c = r @ u, r @ r - reach**2
    time = c / (-b + math.sqrt(b * b - u @ u * c))
    normal = (r + u * time) / reach
    e, reduced = features["restitution"], mass.prod() / mass.sum()
    after = velocity + (1 + e) * reduced * (u @ normal) * np.outer([1 / mass[0], -1 / mass[1]], normal)
    with simulate(scene, **settings) as sim:
        report = sim.run(until=2.5)
        state, end = sim.state, sim.time
    assert report.collisions == 1
    away = state.position - position - velocity * time - after * (end - time)
    away -= 10 * np.round(away / 10) * (features["boundary"] == "periodic")
    lost = (mass[:, None] * (velocity**2 - state.velocity**2)).sum() / 2
    return [
        np.abs(state.velocity - after).max(),
        np.abs(away).max(),
        abs(lost - (1 - e**2) / 2 * reduced * (u @ normal) ** 2),
        np.abs(mass @ (state.velocity - velocity)).max(),
    ]


def worst(settings, **features):
    """Worst of contacts at two angles that begin at three phases of a frame."""
    phases = [(offset, phase * settings["dt"] / 4) for offset in (0.1, 0.7) for phase in range(3)]
    return np.max([met_once(settings, features, *each) for each in phases], axis=0)


ALIKE = {
    "equal": {},
    "masses, lossy": {"mass": [1.0, 4.0], "restitution": 0.6},
    "sizes": {"radius": [0.5, 0.3], "mass": [2.0, 5.0], "restitution": 0.0},
    "through a border": {"radius": [0.5, 0.3], "mass": [2.0, 5.0], "boundary": "periodic"},
}
EXACT = {
    "naive": {"method": "naive", "contact": "impact", "dt": 0.05},
    "grid": {"method": "grid", "contact": "impact", "dt": 0.05},
    "event": {"method": "event", "dt": 2.5},
}


@pytest.mark.parametrize(
    ("name", "method"),
    [(name, method) for name in ALIKE for method in EXACT if method != "grid" or name in ("sizes", "through a border")],
)
def test_two_discs_part_as_the_closed_form_says(name, method):
    found = worst(EXACT[method], **ALIKE[name])
    assert max(found) < ROUNDING, f"velocity, place, energy, momentum are off by {found}"


@pytest.mark.parametrize("name", ["equal", "masses, lossy"])
def test_push_misses_them_by_a_multiple_of_its_step(name):
    """Negative control of the test above. Energy and momentum alone are right if nothing is lost."""
    coarse, fine = (worst({"method": "naive", "contact": "push", "dt": dt}, **ALIKE[name]) for dt in (0.04, 0.02))
    assert fine[:2].min() > 1e-3
    assert 1.5 < coarse[0] / fine[0] < 2.5, "first order in dt"
    assert 1.5 < coarse[1] / fine[1] < 2.5
    assert (fine[2] > 1e-3) == ("lossy" in name)
    assert fine[3] < ROUNDING, "any contact keeps momentum"


def test_the_time_of_an_impact_has_all_digits():
    """Against 60 digits, of slow and fast, grazing and head-on pairs, just above contact or far away."""
    decimal.getcontext().prec = 60
    rng, found, control = np.random.default_rng(3), 0.0, 0.0
    for gap in np.geomspace(1e-6, 6.0, 24):
        angle, miss, distance = rng.uniform(0, 7), rng.uniform(-0.9, 0.9), 1.0 + gap
        speed, turn = 10 ** rng.uniform(-3, 3), math.asin(miss / distance)
        places = 8.0 + np.array([[0, 0], [distance * math.cos(angle), distance * math.sin(angle)]])
        u = -speed * np.array([math.cos(angle + turn), math.sin(angle + turn)])
        met, until = mpsim.Collisions(), 1.01 * distance / speed
        scene = Scene(width=16, height=16, position=places, velocity=[[0, 0], u], radius=0.5)
        with simulate(scene, method="event", dt=until) as sim:
            sim.run(frames=1, observe=met)
        rx, ry = (decimal.Decimal(places[1][k]) - decimal.Decimal(places[0][k]) for k in (0, 1))
        ux, uy = (decimal.Decimal(each) for each in u.tolist())
        misses = []
        for reach in (decimal.Decimal(1), decimal.Decimal(1) + decimal.Decimal("1e-11")):
            b, c, u2 = rx * ux + ry * uy, rx * rx + ry * ry - reach * reach, ux * ux + uy * uy
            exact = c / (-b + (b * b - u2 * c).sqrt())
            condition = max(1.0, float((rx * rx + ry * ry) / c))  # r^2 - 1 has the rounding of the coordinates
            misses.append(abs(float((decimal.Decimal(float(met.table["time"][0])) - exact) / exact)) / condition)
        found, control = max(found, misses[0]), max(control, misses[1])
    assert found < 3e-15
    assert control > 1e-12, "a diameter larger by 1e-11 must fail"


@pytest.mark.parametrize(("method", "precision"), [("naive", "float32"), ("grid", "float32"), ("grid", "float64")])
def test_a_pair_is_visited_once_so_no_contact_undoes_itself(method, precision):
    """Under `reflect` a second visit would mirror both velocities back: in float32 after 48 % of contacts.

    For after a push rounding leaves an overlap in as many pairs.
    """
    rng, count = np.random.default_rng(5), 64
    place = np.stack(np.divmod(np.arange(count), 8), axis=1) * 3.0 + 2
    angle = rng.random(count) * 2 * math.pi
    n = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    position, velocity = np.concatenate([place, place + 0.99 * n]), np.concatenate([n, -n]) * 1e-3
    scene = Scene(width=26, height=26, position=position, velocity=velocity, radius=0.5)
    with simulate(scene, dt=1e-3, method=method, law="reflect", precision=precision) as sim:
        assert sim.run(frames=1).collisions == count
        assert np.allclose(sim.state.velocity, -velocity, atol=1e-8)


@pytest.mark.parametrize(
    ("boundary", "law", "method", "contact", "precision"),
    [("walls", "elastic", "naive", "push", "float32"), ("periodic", "reflect", "grid", "impact", "float64")],
)
def test_discs_at_one_point_part_in_all_directions(boundary, law, method, contact, precision):
    """More than a box 4 wide has room for in a line, at rest or with the same velocity."""
    for velocity in ([0.0, 0.0], [1.0, 0.5]):
        scene = scene_of([[2.0, 2.0]] * 6, [velocity] * 6, 4, 4, boundary=boundary)
        state = state_after(scene, 60, method=method, contact=contact, law=law, precision=precision, dt=0.01)
        position = np.asarray(state.position, float)
        apart = position[:, None] - position
        apart -= 4 * np.round(apart / 4) * (boundary == "periodic")
        nearest = np.hypot(*np.moveaxis(apart, -1, 0))[np.triu_indices(6, 1)].min()
        assert nearest > 0.99, f"two discs are {nearest} apart, of diameter 1"


# --- one contact after the other


def cradle(settings, gap, restitution, against=False):
    """Newton's cradle of six. Misses of the last disc's speed and place, and the largest speed of another disc."""
    x = np.array([2.0] + [5 + k * (1 + gap) for k in range(5)])
    order = slice(None, None, -1) if against else slice(None)
    position, velocity = np.stack([x, np.full(6, 1.5)], axis=1)[order], np.zeros((6, 2))
    velocity[5 if against else 0, 0] = 1.0
    scene = Scene(width=40, height=3, radius=0.5, restitution=restitution, position=position, velocity=velocity)
    kept = (1 + restitution) / 2
    struck = 2 + sum(gap / kept**k for k in range(1, 5))
    with simulate(scene, **settings) as sim:
        sim.run(until=struck + 0.3)
        state, end = sim.state, sim.time
    speeds, last = state.velocity[order, 0], state.position[order][-1, 0]
    return abs(speeds[-1] - kept**5), abs(last - x[-1] - (end - struck) * kept**5), np.abs(speeds[:-1]).max()


@pytest.mark.parametrize(("gap", "restitution"), [(0.0, 1.0), (1e-9, 0.9), (0.1, 0.9)])
def test_only_the_last_disc_of_a_cradle_leaves(gap, restitution):
    """Contacts one after the other in the same frame too, as long as they come in the order of the discs."""
    for method, settings in {
        "impact": EXACT["naive"],
        "event": {"method": "event", "dt": 2.7, "contact_time": 1e-15},
    }.items():
        speed, place, others = cradle(settings, gap, restitution)
        assert max(speed, place) < ROUNDING, f"{method}: the last disc's speed and place are off by {speed}, {place}"
        assert restitution < 1 or others < ROUNDING, f"another disc moves, at {others}"
    late = cradle({"method": "naive", "contact": "push", "dt": 0.02}, gap, restitution)[1]
    assert 0.02 / 4 < late < 0.02, f"push must be late by a part of a frame; got {late}"


def test_a_cradle_struck_against_the_order_of_the_discs_needs_a_pass_per_contact():
    settings = {"method": "naive", "contact": "impact", "dt": 0.02}
    assert max(cradle({**settings, "passes": 5}, 0.0, 1.0, against=True)) < ROUNDING
    assert 0.005 < cradle(settings, 0.0, 1.0, against=True)[1] < 0.1, "one pass is late by a frame per contact at most"


@pytest.mark.parametrize("power", [0, 1])
def test_collisions_of_two_discs_and_a_wall_count_the_digits_of_pi(power):
    counted = []
    for mass in (100.0**power, 2 * 100.0**power):
        met = mpsim.Collisions()
        scene = scene_of([[3, 0.5], [8, 0.5]], [[0, 0], [-1, 0]], 300, 1, radius=[0.4, 0.5], mass=[1.0, mass])
        with simulate(scene, method="event", dt=100.0) as sim:
            report = sim.run(frames=1, observe=met)
        counted.append(len(met.table))
        assert report.collisions == (len(met.table) + 1) // 2, "a wall meets the light disc as often, or once less"
    assert counted[0] == math.floor(math.pi * 10**power)
    assert counted[1] == math.ceil(math.pi / math.atan(1 / math.sqrt(2 * 100.0**power))) - 1
    assert counted[1] != counted[0], "the control: twice the mass counts differently"


@pytest.mark.parametrize(
    ("walls", "gravity"), [({}, None), ({"wall_restitution": 0.5}, None), ({}, -4.0), ({"absorbing": "left"}, None)]
)
def test_a_disc_that_an_impact_throws_at_a_wall_bounces_in_the_same_step(walls, gravity):
    """Two discs at rest and at speed 8 over a wall: the first reaches the wall within the step of the contact.

    Touching after 1/128 they exchange velocities, so the first goes on where the second came from, one diameter lower:
    1/8 over the wall at the start, 1/8 beyond it after the step of 1/32; under gravity it falls at sqrt(65) and flies
    up its parabola, and through an open edge it leaves.
    """
    axis, e = int(gravity is not None), walls.get("wall_restitution", 1.0)
    position, velocity = np.full((2, 2), 5.0), np.zeros((2, 2))
    position[:, axis], velocity[1, axis] = (0.5 + 1 / 16, 0.5 + 1 / 16 + 1 + 1 / 16), -8
    scene = scene_of(position, velocity, gravity=gravity and (0.0, gravity), **walls)
    found = {}
    for contact in ("impact", "push"):
        sensor = mpsim.Sensor(wall="bottom" if axis else "left")
        with simulate(scene, method="naive", dt=1 / 32, contact=contact) as sim:
            sim.run(frames=1, observe=sensor)
            found[contact] = sim.state.position[:, axis] - 0.5, sim.state.velocity[:, axis], sensor.impulse.sum()
            if "absorbing" in walls:
                sim.run(frames=1)
                assert sim.absorbed.tolist() == [True, False]
    if "absorbing" in walls:
        return
    place, speed, impulse = found["impact"]
    landing = 8.0 if gravity is None else math.sqrt(65)
    since = 1 / 64 if gravity is None else 1 / 32 - (landing - 8) / 4
    pull = 0.0 if gravity is None else gravity
    assert place[0] == pytest.approx(landing * e * since + pull * since**2 / 2, abs=ROUNDING)
    assert speed[0] == pytest.approx(landing * e + pull * since, abs=ROUNDING)
    assert impulse == pytest.approx(landing * (1 + e), abs=1e-8)
    place, speed, impulse = found["push"]
    if gravity is None:
        assert (place[0], speed[0], impulse) == (0, -8, 0), "the control stops at the wall, still on its course"
    else:
        assert (speed**2 / 2 + 4 * place).sum() < 37, "the control lacks the energy 32 + 4 (1/16 + 9/8 - 1/128)"


@pytest.mark.parametrize("pull", [0.0, 0.4])
@pytest.mark.parametrize("method", ["grid", "event"])
def test_the_time_place_and_impulse_of_a_bounce_are_those_of_touching(method, pull):
    """At each wall, straight or on a parabola; `push`, the control, knows the end of the step only."""
    touch = 3.5 / 1.5 if pull == 0 else (-1.5 + math.sqrt(1.5**2 + 2 * pull * 3.5)) / pull
    for number, (axis, sign) in enumerate([(0, -1), (0, 1), (1, -1), (1, 1)]):
        velocity, gravity, place = np.zeros(2), np.zeros(2), np.full(2, 4.0)
        velocity[axis], gravity[axis] = 1.5 * sign, pull * sign
        scene = scene_of([[4, 4]], [velocity], 8, 8, gravity=gravity if pull else None)
        for contact in ("impact", "push"):
            met = mpsim.Collisions()
            with simulate(scene, method=method, contact=contact, dt=0.3) as sim:
                sim.run(until=3.0, observe=met)
            (row,) = met.table[:1]
            assert (row["kind"], row["i"], row["j"]) == (1, 0, number)
            exact = contact == "impact" or method == "event"
            assert (abs(row["time"] - touch) < ROUNDING) == exact
            if exact:
                place[axis] += 4 * sign
                assert row["place"] == pytest.approx(place, abs=ROUNDING)
                assert row["impulse"][axis] == pytest.approx(-2 * sign * (1.5 + pull * touch), abs=ROUNDING)
                place[axis] = 4.0


# --- one disc

DT = 1 / 64


def run(scene, frames, **settings):
    """State after so many frames of 1/64."""
    with simulate(scene, **{"dt": DT, "method": "grid", **settings}) as sim:
        sim.run(frames=frames)
        assert sim.time == frames * sim.settings.dt
        return sim.state


def test_a_pushed_disc_repeats_its_flight_between_two_walls_exactly():
    """From wall to wall it is 7 length units, 56 frames; the frame after is spent turning round at the wall."""
    scene = scene_of([[7.5, 4]], [[-1, 0]], 8, 8)
    for frames, x, v in ((56, 0.5, -1), (57, 0.5, 1), (57 + 56, 7.5, 1), (114, 7.5, -1)):
        state = run(scene, frames, dt=1 / 8)
        assert (state.position.tolist(), state.velocity.tolist()) == ([[x, 4]], [[v, 0]]), f"after {frames} frames"


@pytest.mark.parametrize("settings", [{"method": "event"}, {"contact": "impact"}], ids=str)
def test_a_disc_is_mirrored_at_a_wall_at_any_part_of_a_frame(settings):
    """After 1/8 + 1/32 past each wall it is as far on its way back; `push` would have stopped at the wall."""
    state = run(scene_of([[7, 4]], [[1, 0]], 8, 8), 21, **{"dt": 1 / 32, **settings})
    assert (state.position.tolist(), state.velocity.tolist()) == ([[7.5 - 5 / 32, 4]], [[-1, 0]])
    state = run(scene_of([[7, 4]], [[1, 0]], 8, 8), 3, **{"dt": 1 / 4, **settings})
    assert (state.position.tolist(), state.velocity.tolist()) == ([[7.25, 4]], [[-1, 0]])


@pytest.mark.parametrize("method", ["naive", "grid", "event"])
def test_a_corner_turns_both_components(method):
    state = run(scene_of([[7, 1]], [[2, -2]], 8, 8), 17, method=method)
    back = 1 / 32 if method == "event" else 0
    assert state.position.tolist() == [[7.5 - back, 0.5 + back]]
    assert state.velocity.tolist() == [[-2, 2]]


def test_free_fall_with_push_is_first_order_in_dt_and_exact_without():
    """Against y = y_0 + g t^2 / 2 the error is g t dt / 2, of y_n = y_0 + g dt^2 n (n + 1) / 2. Substeps are frames."""
    g, t, scene = -2.0, 1.0, scene_of([[4, 7]], width=8, height=8, gravity=(0, -2.0))
    for settings, part in (({"contact": "push"}, 0.5), ({"contact": "impact"}, 0.0), ({"method": "event"}, 0.0)):
        errors = [7 + g * t**2 / 2 - run(scene, n, dt=t / n, **settings).position[0, 1] for n in (16, 32)]
        assert errors == [-g * t * (t / n) * part for n in (16, 32)], settings
    assert run(scene, 16, dt=DT * 4, substeps=4).digest() == run(scene, 64).digest()


def test_accelerations_of_each_disc_and_gravity_add_up():
    places, own = [[2, 2], [4, 4], [6, 6]], [[1, 0], [0, -1], [0, 0]]
    assert run(scene_of(places, width=8, height=8, acceleration=own), 64).velocity.tolist() == own
    both = run(scene_of(places, width=8, height=8, acceleration=own, gravity=(0, 1)), 64)
    assert both.velocity.tolist() == [[1, 1], [0, 0], [0, 1]]


# --- one contact

SHORT = 1e-9  # a frame in which nothing moves to speak of


def after(scene, dt, **settings):
    """State after a frame."""
    return state_after(scene, 1, **{"method": "naive", "dt": dt, **settings})


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize(
    ("law", "velocities", "changes"),
    [
        ("elastic", [(0, 0), (0, 0)], [(0, 0), (0, 0)]),
        ("elastic", [(5, 10), (5, -5)], [(-7.2, -9.6), (7.2, 9.6)]),  # they exchange 11 and -1 along (0.6, 0.8)
        ("reflect", [(5, 10), (5, -5)], [(-13.2, -17.6), (1.2, 1.6)]),  # each loses twice its part along it
        ("elastic", [(-5, -10), (5, 5)], [(0, 0), (0, 0)]),  # they part already
        ("reflect", [(-5, -10), (5, 5)], [(13.2, 17.6), (-8.4, -11.2)]),  # which this law turns round too
    ],
)
@pytest.mark.parametrize("swapped", [False, True])
def test_a_push_parts_discs_and_a_law_changes_their_velocities(swapped, law, velocities, changes, precision):
    """Centres 5 apart of discs of diameter 6: each moves 0.5 along the line of centres, (0.6, 0.8)."""
    order = [1, 0] if swapped else [0, 1]
    places, expected = np.array([(50, 50), (53, 54)]), np.array([(49.7, 49.6), (53.3, 54.4)])
    scene = Scene(width=100, height=100, position=places[order], velocity=np.array(velocities)[order], radius=3)
    state = after(scene, SHORT, law=law, precision=precision)
    rel = 1e-5 if precision == "float32" else 1e-7
    assert state.position[order] == pytest.approx(expected, rel=rel)
    assert state.velocity[order] == pytest.approx(np.add(velocities, changes), rel=rel, abs=1e-7)


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("law", ["elastic", "reflect"])
@pytest.mark.parametrize("offset", [(0, 0), (1e-30, 0), (5e-324, 5e-324), (1e-7, 1e-7)])
def test_centres_at_nearly_one_point_part_by_a_diameter_and_keep_their_energy(offset, law, precision):
    scene = scene_of([(0, 0), offset], [(1, 2), (-1, 3)], boundary="periodic")
    state = after(scene, 1e-30, law=law, precision=precision)
    apart = np.diff(state.unwrapped.astype(float), axis=0)[0]
    apart -= 20 * np.round(apart / 20)
    assert np.hypot(*apart) == pytest.approx(1, rel=1e-5)
    assert (apart != 0).all(), "along no axis of the box"
    assert (state.velocity**2).sum() == pytest.approx(15, rel=1e-5)


def lifted(mass, contact):
    """A disc on the floor and another 0.625 above it: height of both, and energies before and after."""
    scene = scene_of([(5, 0.5), (5.375, 1.0)], [(0, 0), (3, 4)], 10, 10, gravity=(0, -8.0), mass=mass)
    state = after(scene, SHORT, contact=contact)
    energies = (mass @ ((v**2).sum(axis=1) / 2 + 8.0 * p[:, 1]) for p, v in
                ((scene.position, scene.velocity), (state.position, state.velocity)))  # fmt: skip
    return state.position[:, 1], *energies


@pytest.mark.parametrize("mass", [(1.0, 1.0), (4.0, 1.0)])
def test_a_lift_against_gravity_is_paid_for_by_the_speed_of_parting(mass):
    """3/8 are missing along (0.6, 0.8). The floor does not yield, so the upper disc's half is a lift."""
    (height, before, now), (pushed, _, control) = (lifted(np.array(mass), how) for how in ("impact", "push"))
    assert height == pytest.approx(pushed, abs=1e-7)
    assert height[0] == pytest.approx(0.5, abs=1e-7)
    assert height[1] > 1.05
    assert now == pytest.approx(before, rel=1e-7)
    assert control > before + 0.5, "a push that nobody pays must show"


# --- walls


@pytest.mark.parametrize(("restitution", "height", "speed"), [(1.0, 3.5 / 9, 3.0), (0.5, 1.5 / 9, 1.0), (0.0, 0, 0)])
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("side", [1, -1])
def test_a_bounce_goes_back_to_the_wall_and_on(side, axis, restitution, height, speed):
    """Thrown off the wall at 4 under a pull of 9, it is back after 8/9, and has 1/9 of the frame left."""
    pull, velocity, place = np.zeros(2), np.zeros(2), np.array([5.0, 5.0])
    pull[axis], velocity[axis], place[axis] = -9 * side, 4 * side, 0.5 if side == 1 else 9.5
    box = {"width": 10, "height": 10, "radius": 0.5, "gravity": pull, "wall_restitution": restitution}
    state = after(Scene(**box, position=[place], velocity=[velocity]), 1.0, contact="impact")
    assert state.position[0, axis] == pytest.approx(place[axis] + side * height, abs=1e-14)
    assert state.velocity[0, axis] == pytest.approx(side * speed, abs=1e-13)


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("way", [0.0, -2.5, -1e-20, 8.0, 3 * 7.25, 1e6 * 7.25, -1e5 * 7.25])
def test_a_place_comes_back_into_a_periodic_box_with_its_periods_counted(way, precision):
    scene = scene_of([(0, 4)], [(way, 0)], 7.25, 9, boundary=("periodic", "walls"))
    state = after(scene, 1.0, precision=precision)
    assert 0 <= state.position[0, 0] < 7.25
    assert state.image[0].tolist() == [math.floor(way / 7.25) if abs(way) > 1e-9 else 0, 0]
    assert state.unwrapped[0, 0] == pytest.approx(way, rel=1e-6, abs=1e-6)


# --- obstacles

LINE, PEG = Polyline([(5, 5), (15, 5)]), FixedDisc((5, 5), 0.5)


@pytest.mark.parametrize(
    ("obstacle", "place", "velocity", "restitution", "then", "now"),
    [
        (LINE, (10, 5.3), (1, -2), 0.5, (10, 5.6), (1, 1)),
        (Polyline([(5, 5), (15, 5)], 0.5), (10, 5.6), (1, -2), 1.0, (10, 5.9), (1, 2)),
        (LINE, (15.4, 5), (-1, 0), 1.0, (15.6, 5), (1, 0)),
        (LINE, (10, 5.5), (1, -2), 1.0, (10, 5.5), (1, -2)),
        (PEG, (5.48, 5.64), (-3, -4), 1.0, (5.72, 5.96), (3, 4)),
        (PEG, (4.4, 5.6), (2, 0), 1.0, (4.144, 5.792), (-0.56, 1.92)),  # touched at (-0.8, 0.6), 0.1 ago
    ],
    ids=["lossy side", "thick side", "end", "in touch", "peg aslant", "peg grazed"],
)
def test_an_impact_on_an_obstacle_happens_where_they_touched(obstacle, place, velocity, restitution, then, now):
    start = np.array(place, float) - velocity
    box = {"width": 20, "height": 20, "radius": 0.5, "obstacles": obstacle, "wall_restitution": restitution}
    state = after(Scene(**box, position=[start], velocity=[velocity]), 1.0, contact="impact")
    assert state.position[0] == pytest.approx(then, abs=1e-13)
    assert state.velocity[0] == pytest.approx(now, abs=1e-13)


@pytest.mark.parametrize("contact", ["push", "impact"])
@pytest.mark.parametrize(
    ("obstacle", "place", "velocity", "then"),
    [
        (LINE, (10, 5.25), (0, 1e-3), (10, 5.5)),  # it does not approach: it is only put out
        (LINE, (10, 5.0), (0, 0), (10, 5.5)),
        (PEG, (5, 5), (0, 0), (5, 6)),
        (FixedDisc((1, 10), 5.0), (0.5, 10), (0, 0), (15.5, 10)),  # beyond a periodic border
    ],
    ids=["parting", "on a level line", "in a peg", "beyond a border"],
)
def test_a_disc_in_an_obstacle_is_put_across_it(obstacle, place, velocity, then, contact):
    box = {"width": 20, "height": 20, "radius": 0.5, "obstacles": obstacle, "boundary": "periodic"}
    state = after(Scene(**box, position=[place], velocity=[velocity]), SHORT, contact=contact)
    assert state.position[0] == pytest.approx(then, abs=1e-11)
    assert state.velocity[0].tolist() == list(velocity)
    assert state.image[0].tolist() == [-1 if then[0] > 15 else 0, 0]


# --- flights of the exact method under gravity


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("depth", [1e-3, 1e-9, -1e-9])
def test_grazes_are_found_where_they_are_deep_and_left_out_where_they_miss(depth, axis):
    """The top of the flight is below the peg at time 1.1; from there the overlap is depth - (v^2 / R + g) s^2 / 2."""
    place, velocity, pull = (-0.7 * 1.1, -0.5 - 1.1**2 / 2 + depth), (0.7, 1.1), (0, -1.0)
    turned = [each[::-1] if axis == 0 else each for each in (place, velocity, pull)]
    scene = Scene(width=20, height=20, radius=0.25, position=[np.add((10, 10), turned[0])], velocity=[turned[1]],
                  gravity=turned[2], obstacles=FixedDisc((10, 10), 0.25))  # fmt: skip
    seen = mpsim.Collisions(between="obstacles")
    with simulate(scene, method="event", dt=2.0) as sim:
        sim.run(frames=1, observe=seen)
    times = seen.table["time"]
    assert len(times) == (depth > 0)
    if depth > 0:
        expected = 1.1 - math.sqrt(2 * depth / (0.7**2 / 0.5 + 1.0))
        assert times[0] == pytest.approx(expected, abs=2e-2 * math.sqrt(depth))
