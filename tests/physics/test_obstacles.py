"""Discs among obstacles against closed forms, by the exact and the stepped solvers, with a control each."""

import math

import numpy as np
import pytest
from support.scenes import after, exactly, scene_of, simulate, state_after

import mpsim
from mpsim import FixedDisc, Polyline, Scene

pytestmark = pytest.mark.plain


def one(position, velocity, obstacles, radius=0.5, side=20.0, **features):
    return scene_of([position], [velocity], side, side, radius=radius, obstacles=obstacles, **features)


# --- one disc


@pytest.mark.parametrize("angle", [1.0, 0.4, 0.23])
def test_a_ball_leaves_a_wedge_as_the_unfolded_line_does(angle):
    """Mirrored in each wall that it meets, the wedge stands still and the path is a straight line."""
    apex, radius, long, until = np.array([2.0, 10.0]), 0.1, 18.0, 9.0
    half = 0.5 * angle
    arms = [apex + long * np.array([math.cos(turn), math.sin(turn)]) for turn in (half, -half)]
    wedge = Polyline([arms[0].tolist(), apex.tolist(), arms[1].tolist()])
    # The centre moves in the same wedge, whose apex lies further inside.
    inner = apex + np.array([radius / math.sin(half), 0.0])
    start, velocity = np.array([5.0, 0.2]), np.array([-1.0, 0.13])
    found = state_after(one(inner + start, velocity, wedge, radius), 1, method="event", dt=until).position[0]
    line = start + until * velocity
    turn = math.atan2(line[1], line[0]) % (2 * math.pi)
    if velocity[1] * start[0] - velocity[0] * start[1] < 0 and turn > math.atan2(*start[::-1]):
        turn -= 2 * math.pi
    # In the unfolded plane the path has turned through so many wedges; each second one is seen in a mirror.
    folds = math.floor((turn + half) / angle)
    image = (turn - folds * angle) * (-1 if folds % 2 else 1)
    error = np.abs(found - inner - math.hypot(*line) * np.array([math.cos(image), math.sin(image)])).max()
    assert abs(folds) >= 3
    assert error < 1e-12, "a wedge wider by a thousandth would send it further aside than that"


def test_a_ball_on_top_of_a_peg_bounces_in_the_time_of_its_fall():
    height, gravity = 1.7, 1.3
    period = 2 * math.sqrt(2 * height / gravity)
    for beside, bounces in ((0.0, 20), (1e-9, 10)):
        scene = one((10.0 + beside, 8.5 + height), (0, 0), FixedDisc((10.0, 6.0), 2.0), gravity=(0, -gravity))
        x, y = state_after(scene, bounces, method="event", dt=period).position[0]
        if beside:
            assert abs(x - 10.0) > 1e-3, "beside the top it is thrown aside, further at each bounce: the control"
        else:
            assert x == 10.0
            assert abs(y - 8.5 - height) < 1e-12


def test_restitution_of_an_obstacle_takes_the_same_part_of_each_fall():
    e, height = 0.8, 2.0
    for obstacle in (FixedDisc((5.0, 2.0), 1.0), Polyline([(2, 2.9), (8, 2.9)], 0.2)):
        scene = one((5.0, 3.5 + height), (0, 0), obstacle, gravity=(0, -1.0), wall_restitution=e)
        fall = math.sqrt(2 * height)
        with exactly(scene, dt=fall * (1 + 2 * e + e**2)) as sim:  # the top of the second bounce
            sim.run(frames=1)
            assert sim.state.position[0, 1] - 3.5 == pytest.approx(e**4 * height, rel=1e-12)


def test_a_ball_rolls_off_the_end_of_a_ledge_round_its_corner():
    """Along a thin level wall without friction it keeps its speed; past the end it falls along its parabola."""
    ledge, speed = Polyline([(2.0, 5.0), (8.0, 5.0)]), 3.0  # fast enough to leave the corner at once: v^2 > g R
    scene = one((7.9, 5.5), (speed, 0), ledge, gravity=(0, -1.0))
    late = (7.9 + 2.0 * speed - 8.0) / speed
    with simulate(scene, method="event", dt=2.0, contact_time=1e-4) as sim:
        with pytest.warns(mpsim.errors.GuardWarning):
            sim.run(frames=1)
        assert sim.state.position[0] == pytest.approx([7.9 + 2.0 * speed, 5.5 - 0.5 * late**2], abs=1e-3)


def test_the_mean_free_path_of_a_lorentz_gas_is_that_of_chernov():
    """pi A / P: the free area, and the perimeter that a centre can meet."""
    side, radius, bar = 3.0, 0.1, 0.8
    obstacles = [FixedDisc((1.5, 1.5), 0.5), Polyline([(0.2, 0.3), (0.2 + bar, 0.3)], 0.2)]
    area = side**2 - math.pi * 0.6**2 - math.pi * 0.2**2 - 2 * 0.2 * bar
    perimeter = 2 * math.pi * (0.6 + 0.2) + 2 * bar
    expected, paths = math.pi * area / perimeter, []
    for seed in range(6):
        angle, met = 2 * math.pi * (seed + 0.31) / 6, mpsim.Collisions()
        scene = one((2.6, 2.5), (math.cos(angle), math.sin(angle)), obstacles, radius, side, boundary="periodic")
        with exactly(scene, dt=400.0) as sim:
            sim.run(frames=1, observe=met)
            assert abs(np.hypot(*sim.state.velocity[0]) - 1) < 1e-12
        paths.append(400.0 / len(met.table))
    mean, error = np.mean(paths), np.std(paths, ddof=1) / math.sqrt(6)
    assert error / expected < 0.08
    assert abs(mean - expected) < 4 * error
    assert abs(mean - math.pi * area / (perimeter - 2 * bar)) > 4 * error, "without the bar's straight sides: longer"


BOUNCED_ON = {"slope": Polyline([(0, 0.8), (8, 1.2)], 0.2), "pegs": [FixedDisc((k + 0.5, 1), 0.5) for k in range(8)]}


@pytest.mark.parametrize("name", BOUNCED_ON)
def test_bounces_on_obstacles_keep_their_energy(name):
    """Exact parabolas, exact bounces, on walls of any shape. Push loses energy at each."""
    kept, (dt, until) = {}, (0.01, 15.0) if name == "pegs" else (0.03, 30.0)
    for how in ("impact", "push", "event"):
        scene = scene_of([[4.1, 6.5]], [[0.3, 0]], 8, 40, gravity=(0, -1.0), obstacles=BOUNCED_ON[name])
        settings = {"method": "event", "dt": until} if how == "event" else {"method": "naive", "contact": how, "dt": dt}
        state = after(scene, until, **settings)
        kept[how] = ((state.velocity**2).sum() / 2 + state.position[0, 1]) / (0.3**2 / 2 + 6.5) - 1
    assert max(abs(kept["impact"]), abs(kept["event"])) < 1e-11
    assert kept["push"] < -0.002, "the control"


@pytest.mark.parametrize(("count", "part"), [(1, 0.98), pytest.param(60, 0.3, marks=pytest.mark.long)])
def test_no_disc_passes_a_thin_wall_at_less_than_its_radius_in_a_frame_or_a_third_of_it_in_a_crowd(count, part):
    """In a crowd contacts, which come after the obstacles, move a disc into a wall: at 0.45 R a few do pass.

    At eight times the speed they pass: the control.
    """
    for factor in (0.5, 4):
        rng, beyond = np.random.default_rng(0), 0
        angle = rng.random(count) * 2 * math.pi
        position = Scene.random(count=count, width=9.5, height=10, radius=0.5, seed=0).position
        scene = Scene(
            width=20, height=10, radius=0.5, obstacles=[Polyline([(10, 0), (10, 10)]), FixedDisc((5, 5), 0.05)],
            position=position, velocity=100 * factor * part * np.stack([np.cos(angle), np.sin(angle)], axis=1),
        )  # fmt: skip
        with simulate(scene, method="naive", dt=0.01, contact="impact", law="reflect") as sim:
            for _ in range(30):
                sim.run(frames=20)
                beyond = max(beyond, int((sim.state.position[:, 0] > 10).sum()))
        assert (beyond > 0) == (factor == 4)


# --- across borders


LINE = Polyline([(6, 0), (6, 8)], thickness=0.4)


@pytest.mark.parametrize("method", ["naive", "grid", "event"])
def test_a_disc_bounces_off_the_image_of_a_long_line(method):
    """It meets the end of the line at y = 0 from y = 9.9, at a normal that is known."""
    scene = scene_of([[3, 9.9]], [[1, 0]], 12, 10, radius=0.3, boundary=("walls", "periodic"), obstacles=LINE)
    normal = np.array([-np.sqrt(0.5**2 - 0.1**2), -0.1]) / 0.5
    with simulate(scene, method=method, contact="impact", dt=0.05) as sim:
        sim.run(until=2.5)
        assert sim.state.velocity.tolist() == [[1, 0]]
        sim.run(until=2.6)
        assert sim.state.velocity[0] == pytest.approx([1, 0] - 2 * normal[0] * normal, abs=1e-9)


# --- chains: one surface, whose joints are felt only where it bends

LENGTH, SPEED = 40.0, 5.0
STEPPED = [("naive", "push"), ("naive", "impact"), ("grid", "impact")]


def along(angle, pieces, side=1, middle=(20.0, 15.0)):
    """A straight chain through the middle of the box, and unit vectors along it and towards the disc's side."""
    t = np.array([math.cos(angle), math.sin(angle)])
    points = np.array(middle) + np.linspace(-LENGTH / 3, LENGTH / 3, pieces + 1)[:, None] * t
    return mpsim.Polyline(points), t, side * np.array([-t[1], t[0]])


def slide(chain, t, n, *, radius=0.25, pull=10.0, lift=0.0, boundary="walls", until=4.0, more=None, **settings):
    """A disc beside the middle of the box, its speed along a chain, pulled towards it: its state after some time."""
    start = np.array([20.0, 15.0]) + (radius + lift) * n - LENGTH / 4 * t
    with simulate(
        mpsim.Scene(
            width=LENGTH, height=30, position=[start], velocity=[SPEED * t], radius=radius, gravity=tuple(-pull * n),
            obstacles=chain, boundary=boundary, **(more or {}),
        ),
        **{"dt": 0.02, **settings},
    ) as sim:  # fmt: skip
        sim.run(until=until)
        return sim.state


@pytest.mark.parametrize(
    ("pieces", "wall_restitution", "method", "contact"),
    [(1, 0.5, *STEPPED[0]), (40, 0.0, *STEPPED[1]), (40, 1.0, *STEPPED[0]), (400, 0.5, *STEPPED[1])],
)
def test_a_smooth_disc_keeps_its_speed_along_a_straight_chain(pieces, wall_restitution, method, contact):
    """From either side, level or not, thrown onto it or laid, under both laws, also if larger than segments."""
    for angle, side, lift, radius, law in (
        (0.0, 1, 0, 0.25, "elastic"),
        (0.3, -1, 0.01, 0.25, "reflect"),
        (2.5, 1, 0.3, 1.5, "elastic"),
        (0.7, 1, 0.1, 0.25, "reflect"),
    ):
        chain, t, n = along(angle, pieces, side)
        state = slide(
            chain, t, n, lift=lift, radius=radius, method=method, contact=contact, law=law,
            more={"wall_restitution": wall_restitution},
        )  # fmt: skip
        place, speed = (state.position[0] - (20, 15)), state.velocity[0] @ t
        assert abs(speed / SPEED - 1) < 1e-9, f"{speed} along it, {SPEED} before"
        assert place @ n > 0.9 * radius, "it has left the chain's side"
        assert place @ t == pytest.approx(4 * SPEED - LENGTH / 4, rel=1e-9)


@pytest.mark.parametrize(("method", "contact"), STEPPED[::2])
def test_a_level_chain_moves_discs_as_one_segment_does_rough_ones_too(method, contact):
    rough = {"wall_friction": 0.3, "tangential_restitution": 0.5, "spin": 2.0, "wall_restitution": 0.5}
    for more in ({"wall_restitution": 0.5}, rough):
        one, chain = (
            slide(*along(0.0, pieces), lift=0.2, method=method, contact=contact, more=more) for pieces in (1, 97)
        )
        assert chain.position == pytest.approx(one.position, rel=1e-11)
        assert chain.velocity == pytest.approx(one.velocity, rel=1e-11, abs=1e-11)
    assert abs(chain.velocity[0, 0] / SPEED - 1) > 0.01, "friction has done nothing, which tests little"


@pytest.mark.parametrize(("thickness", "method", "contact"), [(0.0, *STEPPED[0]), (0.2, *STEPPED[1])])
def test_walls_that_end_on_a_floor_do_not_stick_out_of_it(thickness, method, contact):
    """Below it, or in line with it and joined but for rounding, whichever is given first."""
    for angle, side in ((0.0, 1), (2.5, -1)):
        floor, t, n = along(angle, 1, side)
        places = np.array(floor.points[0]) + np.linspace(0.2, 26.5, 58)[:, None] * t
        below = [mpsim.Polyline([place, place - 4 * n + t], thickness) for place in places]
        cut = np.stack([places[:-1], places[1:] + 1e-15 * np.sign(n)], axis=1)  # which rounds some of them only
        for number, obstacles in enumerate(
            (
                [*below, mpsim.Polyline(floor.points, thickness)],
                [mpsim.Polyline(floor.points, thickness), *below],
                [mpsim.Polyline(each, thickness) for each in [*cut, (floor.points[0], places[0]), places[-2:]]],
            )
        ):
            state = slide(
                obstacles, t, n, lift=thickness / 2, method=method, contact=contact, until=3.0,
                more={"wall_restitution": 0.5},
            )  # fmt: skip
            assert abs(state.velocity[0] @ t / SPEED - 1) < 1e-9, (angle, number)


@pytest.mark.parametrize(("method", "contact"), STEPPED[:2])
def test_there_is_no_joint_where_a_ring_or_a_line_through_a_border_closes(method, contact):
    """Nor where two Polylines meet, in whichever direction each is given."""
    ring = mpsim.Polyline([(20, 15), (39, 15), (39, 25), (1, 25), (1, 15), (20, 15)])
    through = mpsim.Polyline([(0, 15), (13, 15), (LENGTH, 15)])
    parts = [mpsim.Polyline([(0, 15), (13, 15)]), mpsim.Polyline([(LENGTH, 15), (13, 15)])]
    t = np.array([1.0, 0.0])
    for n in (np.array([0.0, 1.0]), np.array([0.0, -1.0])):
        state = slide(ring, t, n, lift=1e-3, method=method, contact=contact, until=3.0)
        assert abs(state.velocity[0, 0] / SPEED - 1) < 1e-9
        for line in (through, parts):
            state = slide(
                line, t, n, lift=1e-3, method=method, contact=contact, until=9.0, boundary=("periodic", "walls")
            )
            assert abs(state.velocity[0, 0] / SPEED - 1) < 1e-9
            assert state.image[0, 0] == 1, "it did not pass the border"


@pytest.mark.parametrize("shift", [0.0, 0.7])
def test_a_corner_that_sticks_out_is_met_like_a_disc_of_no_size(shift):
    """Under `impact`, along the normal at touch; and so is the end of a chain."""
    corner, radius = np.array([10.0, 10.0]), 0.5
    velocity = np.array([-3.0, -2.0])
    for points in ([(2, 10), corner, (10, 2)], [(2, 7), corner]):
        for offset in (-0.3, 0.0, 0.2):
            t = velocity / np.hypot(*velocity)
            across = offset * np.array([-t[1], t[0]])
            touch = corner + across - math.sqrt(radius**2 - offset**2) * t
            normal = (touch - corner) / radius
            start = touch - velocity * (0.5 + 0.02 * shift)
            scene = scene_of([start], [velocity], radius=radius, obstacles=[mpsim.Polyline(points)])
            with simulate(scene, method="naive", contact="impact", dt=0.02) as sim:
                sim.run(until=1.0)
                after = velocity - 2 * (velocity @ normal) * normal
                assert sim.state.velocity[0] == pytest.approx(after, rel=1e-12)
                place = touch + after * (sim.time - 0.5 - 0.02 * shift)
                assert sim.state.position[0] == pytest.approx(place, rel=1e-12)


@pytest.mark.parametrize(("method", "contact"), STEPPED[::2])
@pytest.mark.parametrize(("bend", "kept"), [(0.2, math.cos(0.2)), (-0.2, 1.0)], ids=["rises", "falls"])
def test_a_bend_that_rises_takes_the_speed_across_it_and_one_that_falls_takes_none(bend, kept, method, contact):
    """Without restitution and gravity. It is the control of the others: a joint of 0.2 radians is felt."""
    line = mpsim.Polyline([(5, 15), (20, 15), (20 + 15 * math.cos(bend), 15 + 15 * math.sin(bend))])
    state = slide(
        line, np.array([1.0, 0.0]), np.array([0.0, 1.0]), pull=0.0, method=method, contact=contact,
        more={"wall_restitution": 0.0},
    )  # fmt: skip
    assert np.hypot(*state.velocity[0]) == pytest.approx(SPEED * kept, rel=1e-12)
    assert math.atan2(state.velocity[0, 1], state.velocity[0, 0]) == pytest.approx(max(bend, 0.0), abs=1e-12)
