"""One contact in one frame against numbers that can be worked by hand: discs, walls, pistons, obstacles, open edges."""

import math

import numpy as np
import pytest
from support.scenes import simulate

import mpsim
from mpsim import FixedDisc, Polyline, Scene

pytestmark = [pytest.mark.plain, pytest.mark.filterwarnings("ignore::mpsim.FastWarning")]

SHORT = 1e-9
"""A frame in which nothing moves to speak of."""


def after(scene, dt, frames=1, **settings):
    """State after a frame."""
    with simulate(scene, method=settings.pop("method", "naive"), dt=dt, **settings) as sim:
        sim.run(frames=frames)
        return sim.state


# --- two discs


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
    scene = Scene(width=20, height=20, position=[(0, 0), offset], velocity=[(1, 2), (-1, 3)], radius=0.5,
                  boundary="periodic")  # fmt: skip
    state = after(scene, 1e-30, law=law, precision=precision)
    apart = np.diff(state.unwrapped.astype(float), axis=0)[0]
    apart -= 20 * np.round(apart / 20)
    assert np.hypot(*apart) == pytest.approx(1, rel=1e-5)
    assert (apart != 0).all(), "along no axis of the box"
    assert (state.velocity**2).sum() == pytest.approx(15, rel=1e-5)


def lifted(mass, contact):
    """A disc on the floor and another 0.625 above it: height of both, and energies before and after."""
    scene = Scene(width=10, height=10, radius=0.5, gravity=(0, -8.0), position=[(5, 0.5), (5.375, 1.0)],
                  velocity=[(0, 0), (3, 4)], mass=mass)  # fmt: skip
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
    scene = Scene(width=7.25, height=9, position=[(0, 4)], velocity=[(way, 0)], radius=0.5,
                  boundary=("periodic", "walls"))  # fmt: skip
    state = after(scene, 1.0, precision=precision)
    assert 0 <= state.position[0, 0] < 7.25
    assert state.image[0].tolist() == [math.floor(way / 7.25) if abs(way) > 1e-9 else 0, 0]
    assert state.unwrapped[0, 0] == pytest.approx(way, rel=1e-6, abs=1e-6)


# --- obstacles

LINE, PEG = Polyline([(5, 5), (15, 5)]), FixedDisc((5, 5), 0.5)
THICK = Polyline([(5, 5), (15, 5)], 0.5)


@pytest.mark.parametrize(
    ("obstacle", "place", "velocity", "restitution", "then", "now"),
    [
        (LINE, (10, 5.3), (1, -2), 0.5, (10, 5.6), (1, 1)),
        (THICK, (10, 5.6), (1, -2), 1.0, (10, 5.9), (1, 2)),
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
    scene = Scene(**box, position=[start], velocity=[velocity])
    state = after(scene, 1.0, contact="impact")
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
