"""Discs among obstacles against closed forms, by the exact and the stepped solvers, with a control each."""

import math

import numpy as np
import pytest
from support.scenes import simulate

import mpsim
from mpsim import FixedDisc, Polyline, Scene

pytestmark = pytest.mark.plain


def exactly(scene, dt=1.0):
    return simulate(scene, method="event", dt=dt)


def one(position, velocity, obstacles, radius=0.5, side=20.0, **features):
    return Scene(width=side, height=side, position=[position], velocity=[velocity], radius=radius,
                 obstacles=obstacles, **features)  # fmt: skip


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
    with exactly(one(inner + start, velocity, wedge, radius), dt=until) as sim:
        sim.run(frames=1)
        found = sim.state.position[0]
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
        with exactly(scene, dt=period) as sim:
            sim.run(frames=bounces)
            x, y = sim.state.position[0]
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
        scene = Scene(width=8, height=40, radius=0.5, gravity=(0, -1.0), position=[[4.1, 6.5]], velocity=[[0.3, 0]],
                      obstacles=BOUNCED_ON[name])  # fmt: skip
        settings = {"method": "event", "dt": until} if how == "event" else {"method": "naive", "contact": how, "dt": dt}
        with simulate(scene, **settings) as sim:
            sim.run(until=until)
            state = sim.state
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
    scene = Scene(width=12, height=10, position=[[3, 9.9]], velocity=[[1, 0]], radius=0.3,
                  boundary=("walls", "periodic"), obstacles=LINE)  # fmt: skip
    normal = np.array([-np.sqrt(0.5**2 - 0.1**2), -0.1]) / 0.5
    with simulate(scene, method=method, contact="impact", dt=0.05) as sim:
        sim.run(until=2.5)
        assert sim.state.velocity.tolist() == [[1, 0]]
        sim.run(until=2.6)
        assert sim.state.velocity[0] == pytest.approx([1, 0] - 2 * normal[0] * normal, abs=1e-9)
