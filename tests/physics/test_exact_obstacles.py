"""The exact solver with obstacles: closed forms, conservation, reversal, and the stepped solver as its step shrinks."""

import math

import numpy as np
import pytest
from support.exact import Run
from support.scenes import simulate

import mpsim
from mpsim import FixedDisc, Polyline
from mpsim.core.state import State
from mpsim.measure import observables

pytestmark = pytest.mark.slow

PEGS = [FixedDisc((x + 0.13, y), 0.5) for x in (4, 8, 12) for y in (3, 7, 11)]
BENT = Polyline([(1.0, 9.0), (6.0, 9.5), (9.0, 8.9), (9.0, 8.0)], 0.2)


def exactly(scene, dt=1.0, **settings):
    return mpsim.Simulation(scene, mpsim.Settings(method="event", dt=dt, **settings))


def one(position, velocity, obstacles, radius=0.5, side=20.0, **features):
    return mpsim.Scene(width=side, height=side, position=[position], velocity=[velocity], radius=radius,
                       obstacles=obstacles, **features)  # fmt: skip


def energy(state, scene):
    gravity = np.zeros(2) if scene.gravity is None else scene.gravity
    mass = scene.masses
    return 0.5 * mass @ (state.velocity**2).sum(axis=1) - (mass[:, None] * state.position * gravity).sum()


# --- closed forms


@pytest.mark.parametrize("angle", [1.0, 0.7, 0.4, 0.23])
def test_a_ball_leaves_a_wedge_as_the_unfolded_line_does(angle, figures):
    """Mirrored in each wall that it meets, the wedge stands still and the path is a straight line."""
    apex, radius, long = np.array([2.0, 10.0]), 0.1, 18.0
    half = 0.5 * angle
    arms = [apex + long * np.array([math.cos(turn), math.sin(turn)]) for turn in (half, -half)]
    wedge = Polyline([arms[0].tolist(), apex.tolist(), arms[1].tolist()])
    # The centre moves in the same wedge, whose apex lies further inside.
    inner = apex + np.array([radius / math.sin(half), 0.0])
    position, velocity = inner + np.array([5.0, 0.2]), np.array([-1.0, 0.13])
    until = 9.0
    with exactly(one(position, velocity, wedge, radius), dt=until) as sim:
        sim.run(frames=1)
        found = sim.state
    line = position - inner + until * velocity
    folds, turn = 0, math.atan2(line[1], line[0]) % (2 * math.pi)
    # In the unfolded plane the path has turned through so many wedges; each second one is seen in a mirror.
    start = math.atan2(*(position - inner)[::-1])
    crossed = velocity[1] * (position - inner)[0] - velocity[0] * (position - inner)[1] < 0
    if crossed and turn > start:
        turn -= 2 * math.pi
    folds = math.floor((turn + half) / angle)
    image = turn - folds * angle
    image = -image if folds % 2 else image
    expected = inner + math.hypot(*line) * np.array([math.cos(image), math.sin(image)])
    error = np.abs(found.position[0] - expected).max()
    assert abs(folds) >= 3
    assert error < 1e-12
    # Negative control: a wedge that is wider by a thousandth sends it elsewhere.
    assert abs(folds) * angle * 1e-3 * math.hypot(*line) > 1e3 * error
    figures.note("wedge", "exact", f"place after {abs(folds)} bounces", "0", f"{error:.0e}", "angle + 0.1 %: > 1e-3")


def test_a_ball_on_top_of_a_peg_bounces_in_the_time_of_its_fall(figures):
    height, gravity = 1.7, 1.3
    period = 2 * math.sqrt(2 * height / gravity)
    peg = FixedDisc((10.0, 6.0), 2.0)
    scene = one((10.0, 8.5 + height), (0, 0), peg, gravity=(0, -gravity))
    with exactly(scene, dt=period) as sim:
        for _ in range(20):
            sim.run(frames=1)
            assert sim.state.position[0, 0] == 10.0
        error = abs(sim.state.position[0, 1] - (8.5 + height))
    assert error < 1e-12
    # Negative control: beside the top it is thrown aside, further at each bounce.
    with exactly(one((10.0 + 1e-9, 8.5 + height), (0, 0), peg, gravity=(0, -gravity)), dt=period) as sim:
        sim.run(frames=10)
        assert abs(sim.state.position[0, 0] - 10.0) > 1e-3
    figures.note("dropped on a peg", "exact", "height after 20 bounces", "0", f"{error:.0e}", "1e-9 beside: thrown off")


def test_a_ball_rolls_off_the_end_of_a_ledge_round_its_corner():
    """Along a thin level wall without friction it keeps its speed; past the end it falls along its parabola."""
    ledge, speed = Polyline([(2.0, 5.0), (8.0, 5.0)]), 3.0  # fast enough to leave the corner at once: v^2 > g R
    with exactly(one((7.9, 5.5), (speed, 0), ledge, gravity=(0, -1.0)), dt=2.0) as sim:
        with pytest.warns(mpsim.errors.GuardWarning):
            sim.run(frames=1)
        found = sim.state.position[0]
    late = (7.9 + 2.0 * speed - 8.0) / speed
    assert found[0] == pytest.approx(7.9 + 2.0 * speed, abs=1e-6)
    assert found[1] == pytest.approx(5.5 - 0.5 * late**2, abs=1e-5)


@pytest.mark.long
def test_restitution_of_an_obstacle_takes_the_same_part_of_each_fall():
    e, height = 0.8, 2.0
    scene = one((5.0, 3.5 + height), (0, 0), FixedDisc((5.0, 2.0), 1.0), gravity=(0, -1.0), wall_restitution=e)
    fall = math.sqrt(2 * height)
    with exactly(scene, dt=fall * (1 + 2 * e + e**2)) as sim:  # the top of the second bounce
        sim.run(frames=1)
        assert sim.state.position[0, 1] - 3.5 == pytest.approx(e**4 * height, rel=1e-12)


def test_the_mean_free_path_of_a_lorentz_gas_is_that_of_chernov(figures):
    """pi A / P: the free area, and the perimeter that a centre can meet. A disc as a point, a peg as large as both."""
    side, reach, bar = 3.0, 0.6, 0.8
    capsules = [(1.5, 1.5, 1.5, 1.5, 0.5), (0.2, 0.3, 0.2 + bar, 0.3, 0.1)]
    area = side**2 - math.pi * reach**2 - math.pi * 0.2**2 - 2 * 0.2 * bar
    perimeter = 2 * math.pi * (reach + 0.2) + 2 * bar
    expected, paths = math.pi * area / perimeter, []
    for seed in range(16):
        angle = 2 * math.pi * (seed + 0.31) / 16
        run = Run([[2.6, 2.5]], [[math.cos(angle), math.sin(angle)]], side, side, 0.1, periodic=(True, True),
                  capsules=capsules)  # fmt: skip
        run.advance(4e4)
        paths.append(4e4 / run.count("walls"))
        assert abs(np.hypot(*run.state()[1][0]) - 1) < 1e-11
    mean, error = np.mean(paths), np.std(paths, ddof=1) / 4
    assert error / expected < 5e-3
    assert abs(mean - expected) < 4 * error
    # Negative control: without the bar's straight sides it would be longer.
    assert abs(mean - math.pi * area / (perimeter - 2 * bar)) > 10 * error
    figures.note(
        "Lorentz gas", "exact", "mean free path", f"{expected:.4f}", f"{mean:.4f}({error * 1e4:.0f})", "no bar"
    )


@pytest.mark.long
def test_a_ball_spun_by_a_peg_keeps_its_angular_momentum_about_the_point_of_contact():
    peg = FixedDisc((10.0, 10.0), 1.0)
    scene = one((5.0, 10.9), (2.0, 0.0), peg, wall_friction=0.3, spin=[1.5])
    with exactly(scene, dt=4.0) as sim:
        sim.run(frames=1)
        found = sim.state
    ny = 0.9 / 1.5
    n = np.array([-math.sqrt(1 - ny**2), ny])
    t = np.array([-n[1], n[0]])
    pressed, slip = -2 * (scene.velocity[0] @ n), scene.velocity[0] @ t - 0.5 * 1.5
    impulse = -math.copysign(min(abs(slip) / 3, 0.3 * pressed), slip)
    assert np.abs(found.velocity[0] - (scene.velocity[0] + pressed * n + impulse * t)).max() < 1e-14
    assert found.spin[0] == pytest.approx(1.5 - 2 * impulse / 0.5, abs=1e-14)


# --- many discs


def crowd(gravity, boundary="walls", **features):
    return mpsim.Scene.random(count=50, width=16, height=14, radius=0.4, seed=3, obstacles=[*PEGS, BENT],
                              gravity=gravity, boundary=boundary, **features)  # fmt: skip


@pytest.mark.parametrize(
    ("gravity", "boundary"), [(None, "walls"), pytest.param((0.0, -1.0), ("periodic", "walls"), marks=pytest.mark.long)]
)
def test_energy_is_kept_and_no_disc_ever_enters_an_obstacle(gravity, boundary, figures):
    scene = crowd(gravity, boundary)
    with exactly(scene, dt=2.0) as sim:
        before = energy(sim.state, scene)
        for _ in range(25):
            sim.run(frames=1)
            state = sim.state
            assert scene.deepest(state.position, scene.radii - 1e-12) is None
            assert observables.overlap(state, scene).largest < 1e-12
        drift = abs(energy(sim.state, scene) / before - 1)
    assert drift < 1e-12
    # Negative control: losses of a millionth at obstacles would show.
    lossy = crowd(gravity, boundary, wall_restitution=1 - 1e-6)
    with exactly(lossy, dt=50.0) as sim:
        sim.run(frames=1)
        assert energy(sim.state, lossy) < before * (1 - 1e-6)
    figures.note("obstacles", "exact", f"energy drift, {boundary}", "0", f"{drift:.0e}", "e = 1 - 1e-6: > 1e-6")


@pytest.mark.parametrize("gravity", [None, (0.1, -1.0)])
def test_a_run_among_obstacles_goes_back_when_it_is_turned_round(gravity):
    scene = crowd(gravity)
    with exactly(scene) as there:
        assert there.run(until=1.5).collisions > 20
        state = there.state
    with exactly(scene.starting_from(State(state.position, -state.velocity))) as back:
        back.run(until=1.5)
        error = observables.trajectory_error(back.state, State(scene.position, scene.velocity), scene)
    assert error.largest < 1e-8


def deviations(scene, until, steps, **settings):
    """Exact state, and the rms errors of stepped runs of so many steps."""
    with exactly(scene, dt=until) as sim:
        sim.run(frames=1)
        exact = sim.state
    errors = []
    for number in steps:
        with simulate(scene, method="grid", dt=until / number, **settings) as sim:
            sim.run(frames=number)
            errors.append(observables.trajectory_error(sim.state, exact, scene).rms)
    return exact, errors


def test_the_stepped_solver_comes_to_it_as_its_step_shrinks(figures):
    """Under gravity: the first order in dt. Without, contact `impact` is exact for one contact a step."""
    scene, until = crowd((0.3, -1.0)), 0.75
    exact, errors = deviations(scene, until, (400, 1600, 6400), contact="impact")
    assert errors[0] / errors[2] > 8, f"16 times shorter steps: errors {errors}"
    assert errors[2] < 1e-3
    # Negative control: without the bent wall it comes to something else.
    other = mpsim.Scene(width=16, height=14, position=scene.position, velocity=scene.velocity, radius=0.4,
                        obstacles=PEGS, gravity=(0.3, -1.0))  # fmt: skip
    with exactly(other, dt=until) as sim:
        sim.run(frames=1)
        assert observables.trajectory_error(sim.state, exact, scene).rms > 100 * errors[2]
    figures.note("obstacles", "exact", "rms error of grid, dt / 16", "1/16", f"{errors[2] / errors[0]:.3f}", "no bar")
    _, (error,) = deviations(crowd(None), until, (1600,), contact="impact")
    assert error < 1e-9


@pytest.mark.long
def test_where_obstacles_are_listed_does_not_matter():
    """Other cells, and squares of several of them."""
    place, speed = [[2.6, 2.5], [0.4, 1.1]], [[0.3, -1.0], [0.7, 0.2]]
    capsules = [(1.5, 1.5, 1.5, 1.5, 0.5), (0.2, 0.3, 1.0, 0.3, 0.1)]
    ends = []
    for cells in ((1, 1), (2, 3), (8, 8), (11, 5)):
        run = Run(place, speed, 3.0, 3.0, 0.1, capsules=capsules, gravity=(0.0, -1.0), cells=cells)
        run.advance(3.0)
        ends.append(run.state()[0])
    assert max(np.abs(end - ends[0]).max() for end in ends) < 1e-9
